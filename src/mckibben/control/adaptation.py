"""On-line adaptation of the muscles' strength from pressures and motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from numbers import Real
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.antagonistic import MuscleStates
from mckibben.joint.geometry import Pair
from mckibben.muscle import adjusted_law
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import exp, floating
from mckibben.units import Bandwidth, Duration, Mass, Quantity, Share

StrengthSpread = Annotated[float, Quantity("1", "1", 0, 0.3, open_lower=True)]
PositiveTorque = Annotated[float, Quantity("N*m", "N*m", 0, 1e6, open_lower=True)]

Scalar = Float[Array, ""]
Covariance = tuple[tuple[Scalar, ...], ...]

_LAGS = 3
_SETTLING = 8.0  # time constants of the filter: until the noise of the first sample has decayed
_BOUND = 3.0  # prior standard deviations that limit an estimate


class AdaptationState(NamedTuple):
    """Estimated parameters, their covariance and the states of the filters."""

    strengths: Pair  # of the muscles, relative to the model's law [-]
    mass: Scalar  # mass of the load (`Load.adapted_mass`) minus that of the model [kg]
    friction: Scalar  # relative to the model's [-]
    deviations: tuple[Scalar, ...]  # parameters minus their prior mean, in prior standard deviations
    covariance: Covariance  # of the deviations, by rows
    filtered: tuple[tuple[Scalar, ...], ...]  # each signal behind one, two and three lags
    last: tuple[Scalar, ...]  # signals behind three lags one period ago, and the angle two periods ago
    muscles: MuscleStates  # of the model, along the measured angle
    age: Scalar  # time since the start, in time constants of the filter


class LawAdaptation(Component):
    r"""Recursive least squares on measured pressures and motion.

    The equation of motion (Eq. 6) is linear in the muscles' strengths s, an unknown mass of the load and the magnitude
    phi of the friction:

    .. math::

        I\ddot\theta + c\dot\theta - \tau_g = s_2\tau_2 - s_1\tau_1 + \phi\,\tau_f + \Delta m\,(l_2 g
        \sin(\theta_h - \theta) - l_2^2\ddot\theta)

    All terms pass the same filter of three lags, :math:`(\lambda/(s+\lambda))^3`, behind which the measured angle has
    two derivatives. The prior is the model with the given standard deviations.

    With a `drift_time` the deviations from the model drift: each is a first-order Gauss-Markov process whose stationary
    distribution is the prior,

    .. math:: x \leftarrow a x, \quad P \leftarrow a^2 P + (1 - a^2) I, \quad a = e^{-h / T}

    before each sample, in prior standard deviations.

    Parameters
    ----------
    strength_spread, mass_spread, friction_spread
        Prior standard deviations: of a muscle's strength [-], at most 0.3; of the load's mass [kg] (the second of
        `KneeLoad`); of the friction relative to the model's [-]. 0 for a known mass or friction.
    torque_error
        Standard deviation of the equation's error [N*m].
    bandwidth
        lambda [rad/s].
    drift_time
        Correlation time T [s] of parameters that drift within their prior; None for constant ones.

    References
    ----------
    K. J. Astrom and B. Wittenmark, Adaptive Control, 2nd ed., Addison-Wesley 1995, ch. 2 (recursive least squares,
    filtered regressors); A. Gelb, Applied Optimal Estimation, MIT Press 1974, ch. 3 (Gauss-Markov processes).
    """

    strength_spread: StrengthSpread = 0.06
    mass_spread: Mass = 0.0
    friction_spread: Share = 0.6
    torque_error: PositiveTorque = 0.05
    bandwidth: Bandwidth = 30.0
    drift_time: Duration | None = None

    def check_load(self, load: Load) -> None:
        """Raise `RangeError` if the mass is to be estimated of a load that has none among its parameters."""
        if not load.adapted_mass and isinstance(self.mass_spread, Real | np.ndarray) and np.any(self.mass_spread):
            message = f"LawAdaptation: {type(load).__name__} has no mass to estimate"
            remedy = "leave mass_spread out, or give a load with its mass and length"
            raise RangeError(message, field="mass_spread", value=self.mass_spread, unit="kg", remedy=remedy)

    def init(self, model: AntagonisticJoint, load: Load, angle: ArrayLike, pressures: Pair) -> AdaptationState:
        """Prior, at rest at a measured angle [rad] and pressures [Pa]."""
        angle = floating(angle)
        muscles = model.init_state(angle, pressures)
        signals = self._signals(model, load, muscles, angle, pressures)
        zero, unity = jnp.zeros_like(angle), jnp.ones_like(angle)
        count = len(signals) - 2
        return AdaptationState(
            strengths=(unity, unity),
            mass=zero,
            friction=unity,
            deviations=(zero,) * count,
            covariance=tuple(tuple(unity if i == j else zero for j in range(count)) for i in range(count)),
            filtered=tuple((signal,) * _LAGS for signal in signals),
            last=(*signals, signals[0]),
            muscles=muscles,
            age=zero,
        )

    def step(
        self,
        state: AdaptationState,
        model: AntagonisticJoint,
        load: Load,
        angle: ArrayLike,
        pressures: Pair,
        period: ArrayLike,
    ) -> AdaptationState:
        """Return the estimates after a further sample of angle [rad] and pressures [Pa], for the unadapted model."""
        angle = floating(angle)
        muscles = model.update_state(state.muscles, angle, pressures)
        signals = self._signals(model, load, muscles, angle, pressures)
        fraction = 1 - exp(-jnp.asarray(self.bandwidth) * period)
        pairs = zip(state.filtered, signals, strict=True)
        filtered = tuple(_filter(lags, signal, fraction) for lags, signal in pairs)
        now = tuple(value[-1] for value in filtered)
        # Central differences, and with them the other signals, are those one period ago.
        following, (middle, gravity, gravity_by_mass, torque1, torque2, *friction_torque, preceding) = (
            now[0],
            state.last,
        )
        velocity = (following - preceding) / (2 * period)
        acceleration = (following - 2 * middle + preceding) / period**2
        dynamic, dynamic_by_mass = _with_mass_derivative(load, lambda load: load.dynamic_torque(velocity, acceleration))
        regressors = [
            -self.strength_spread * torque1,
            self.strength_spread * torque2,
            self.mass_spread * (gravity_by_mass - dynamic_by_mass),
            *(self.friction_spread * value for value in friction_torque),
        ]
        residual = dynamic - gravity - (torque2 - torque1) - sum(friction_torque)
        # The filter correlates errors over its time constant: so many samples count as one.
        age = state.age + self.bandwidth * period
        variance = self.torque_error**2 * 2 / (self.bandwidth * period)
        regressors = [jnp.where(age > _SETTLING, value, 0.0) for value in regressors]
        deviations, covariance = self._drift(state.deviations, state.covariance, period)
        deviations, covariance = recursive_least_squares(deviations, covariance, regressors, residual, variance)
        bounded = [jnp.clip(value, -_BOUND, _BOUND) for value in deviations]
        return AdaptationState(
            strengths=(1 + self.strength_spread * bounded[0], 1 + self.strength_spread * bounded[1]),
            mass=self.mass_spread * bounded[2],
            friction=1 + self.friction_spread * bounded[3] if friction_torque else jnp.ones_like(angle),
            deviations=deviations,
            covariance=covariance,
            filtered=filtered,
            last=(*now, middle),
            muscles=muscles,
            age=age,
        )

    def _drift(
        self, deviations: tuple[Scalar, ...], covariance: Covariance, period: ArrayLike
    ) -> tuple[tuple[Scalar, ...], Covariance]:
        """Deviations and their covariance after a period of drift within the prior."""
        if self.drift_time is None:
            return deviations, covariance
        keep = exp(-jnp.asarray(period) / self.drift_time)
        rows = enumerate(covariance)
        return tuple(keep * x for x in deviations), tuple(
            tuple(keep**2 * x + ((1 - keep**2) if i == j else 0.0) for j, x in enumerate(row)) for i, row in rows
        )

    def _signals(
        self, model: AntagonisticJoint, load: Load, muscles: MuscleStates, angle: Scalar, pressures: Pair
    ) -> tuple[Scalar, ...]:
        """Angle [rad]; torques [N*m] of gravity, per kilogram of the second mass, of each muscle and of friction."""
        contraction1, contraction2 = model.contractions(angle, pressures)
        arm1, arm2 = model.geometry.paths_and_arms(angle)[1]
        torque1 = model.muscle1.tension(contraction1, pressures[0]) * arm1
        torque2 = model.muscle2.tension(contraction2, pressures[1]) * arm2
        signals = (angle, *_with_mass_derivative(load, lambda load: load.gravity_torque(angle)), torque1, torque2)
        if not model.has_friction:
            return signals
        return (*signals, model.friction_torque(angle, None, pressures, muscles))


def _with_mass_derivative(load: Load, torque: Callable[[Load], Scalar]) -> tuple[Scalar, Scalar]:
    """Torque of a load [N*m], and its derivative with respect to the mass that is estimated [N*m/kg]."""
    name = load.adapted_mass
    if not name:
        known = torque(load)
        return known, jnp.zeros_like(known)
    return value_and_derivative(lambda mass: torque(dataclasses.replace(load, **{name: mass})), getattr(load, name))


def with_strengths(model: AntagonisticJoint, strengths: Pair) -> AntagonisticJoint:
    """Model whose muscles have given strengths relative to their laws."""
    muscle1, muscle2 = (
        dataclasses.replace(muscle, law=adjusted_law(muscle.law, strength=strength))
        for muscle, strength in zip((model.muscle1, model.muscle2), strengths, strict=True)
    )
    return dataclasses.replace(model, muscle1=muscle1, muscle2=muscle2)


def _filter(lags: tuple[Scalar, ...], signal: Scalar, fraction: Scalar) -> tuple[Scalar, ...]:
    """Outputs of a chain of first-order lags after a further sample."""
    outputs = []
    for lag in lags:
        signal = lag + fraction * (signal - lag)
        outputs.append(signal)
    return tuple(outputs)


def recursive_least_squares(
    means: tuple[Scalar, ...], covariance: Covariance, regressors: list[Scalar], value: Scalar, variance: ArrayLike
) -> tuple[tuple[Scalar, ...], Covariance]:
    """Mean and covariance after an observation value = regressors . means + noise."""
    count = range(len(means))
    cross = [sum(covariance[i][j] * regressors[j] for j in count) for i in count]
    total = sum(regressors[i] * cross[i] for i in count) + variance
    innovation = value - sum(regressors[i] * means[i] for i in count)
    gains = [entry / total for entry in cross]
    return (
        tuple(means[i] + gains[i] * innovation for i in count),
        tuple(tuple(covariance[i][j] - gains[i] * cross[j] for j in count) for i in count),
    )
