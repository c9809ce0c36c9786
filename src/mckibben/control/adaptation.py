"""Adaptation of the law: how strong the muscles are, told from pressures and motion while they work."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.antagonistic import MuscleStates
from mckibben.joint.geometry import Pair
from mckibben.muscle import scaled_law
from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import exp, floating, sincos
from mckibben.units import Bandwidth, Mass, PositiveTorque, Share, StrengthSpread

Scalar = Float[Array, ""]

_STAGES = 3
_FIRST = 8.0  # time constants of the filter: so long it has to do with the noise of the first sample
_BOUND = 3.0  # prior standard deviations: further away an estimate is not taken
_WIDEST = 0.3  # of a spread: three of it leave a muscle some strength


class Adapted(NamedTuple):
    """What is believed of the muscles and the load, and what is remembered for it.

    Attributes
    ----------
    strengths
        Of muscles 1 and 2, against the law of the model [-].
    mass
        What the load's second mass is more than believed [kg].
    friction
        The friction of both muscles against that of the model [-]; 1 where the model has none.
    deviations
        Of what is estimated: off its prior mean, in prior standard deviations.
    covariance
        Of these, row by row.
    filtered
        Each signal behind one, two and three lags.
    before
        The signals behind three lags a period ago, and the angle two periods ago.
    muscles
        Internal states of the model's muscles along the measured angle.
    age
        How long it has listened, in time constants of the filter.
    """

    strengths: Pair
    mass: Scalar
    friction: Scalar
    deviations: tuple[Scalar, ...]
    covariance: tuple[tuple[Scalar, ...], ...]
    filtered: tuple[tuple[Scalar, ...], ...]
    before: tuple[Scalar, ...]
    muscles: MuscleStates
    age: Scalar


class LawAdaptation(eqx.Module):
    r"""Recursive least squares on measured pressures and motion.

    The equation of motion is linear in the strengths of the muscles, in what is not known of the load, and in the size
    of the friction:

    .. math::

        I\ddot\theta + c\dot\theta - \tau_g = s_2\tau_2 - s_1\tau_1 + \phi\,\tau_f + \Delta m\,(l_2 g
        \sin(\theta_h - \theta) - l_2^2\ddot\theta)

    All its terms pass the same filter of three lags, :math:`(\lambda/(s+\lambda))^3`, behind which the measured angle
    has two derivatives. Each period moves the estimates by least squares, begun with the model's own values and how
    sure they are, and weighted with how wrong the equation may be. So they do not leave the model without evidence; and
    where motion cannot tell strength from load (a heavier load and stronger muscles move alike) they stay.

    Parameters
    ----------
    strength_spread
        Standard deviation of what a muscle is stronger or weaker than its law [-]; at most 0.3, so that no muscle is
        ever believed to have no force.
    mass_spread
        That of the load's second mass [kg]; 0 where the load is known.
    friction_spread
        That of the friction, as a part of the model's [-]; 0 where it is known, or the model has none.
    torque_error
        How wrong the equation may be [N*m].
    bandwidth
        lambda [rad/s].

    References
    ----------
    K. J. Astrom and B. Wittenmark, Adaptive Control, 2nd ed., Addison-Wesley 1995, ch. 2 (recursive least squares,
    filtered regressors).
    """

    strength_spread: StrengthSpread = 0.06
    mass_spread: Mass = 0.0
    friction_spread: Share = 0.6
    torque_error: PositiveTorque = 0.05
    bandwidth: Bandwidth = 30.0

    def __check_init__(self) -> None:
        check_positive("LawAdaptation", strength_spread=self.strength_spread)
        check_within("LawAdaptation", 0.0, _WIDEST, strength_spread=self.strength_spread)
        check_positive("LawAdaptation", "kg", zero=True, mass_spread=self.mass_spread)
        check_positive("LawAdaptation", zero=True, friction_spread=self.friction_spread)
        check_positive("LawAdaptation", "N*m", torque_error=self.torque_error)
        check_positive("LawAdaptation", "rad/s", bandwidth=self.bandwidth)

    def init(self, model: AntagonisticJoint, load: Load, angle: ArrayLike, pressures: Pair) -> Adapted:
        """Before the first period, at rest at a measured angle [rad] and pressures [Pa]: the model as it is."""
        angle = floating(angle)
        muscles = model.init_state(angle, pressures)
        signals = self._signals(model, load, muscles, angle, pressures)
        nothing, one = jnp.zeros_like(angle), jnp.ones_like(angle)
        count = len(signals) - 2
        return Adapted(
            strengths=(one, one),
            mass=nothing,
            friction=one,
            deviations=(nothing,) * count,
            covariance=tuple(tuple(one if i == j else nothing for j in range(count)) for i in range(count)),
            filtered=tuple((signal,) * _STAGES for signal in signals),
            before=(*signals, signals[0]),
            muscles=muscles,
            age=nothing,
        )

    def step(
        self,
        adapted: Adapted,
        model: AntagonisticJoint,
        load: Load,
        angle: ArrayLike,
        pressures: Pair,
        period: ArrayLike,
    ) -> Adapted:
        """What is believed after one more period [s].

        Parameters
        ----------
        adapted
            What was believed.
        model, load
            As believed before any of it.
        angle, pressures
            Measured [rad], [Pa].
        period
            The control period [s].
        """
        angle = floating(angle)
        muscles = model.update_state(adapted.muscles, angle, pressures)
        signals = self._signals(model, load, muscles, angle, pressures)
        passed = 1 - exp(-jnp.asarray(self.bandwidth) * period)
        pairs = zip(adapted.filtered, signals, strict=True)
        filtered = tuple(_filtered(stages, signal, passed) for stages, signal in pairs)
        now = tuple(each[-1] for each in filtered)
        # Differences of the angle are those of the middle of three samples; so are the other signals.
        ahead, (here, *others, behind) = now[0], adapted.before
        velocity, acceleration = (ahead - behind) / (2 * period), (ahead - 2 * here + behind) / period**2
        net, torque1, torque2, hung, *rubbing = others
        inertia, damping = load.total_inertia, load.damping
        columns = [
            -self.strength_spread * torque1,
            self.strength_spread * torque2,
            self.mass_spread * (hung - load.distance2**2 * acceleration),
            *(self.friction_spread * each for each in rubbing),
        ]
        unexplained = inertia * acceleration + damping * velocity - net - (torque2 - torque1) - sum(rubbing)
        # Errors last as long as the filter remembers: so many samples count as one.
        age = adapted.age + self.bandwidth * period
        variance = self.torque_error**2 * 2 / (self.bandwidth * period)
        columns = [jnp.where(age > _FIRST, each, 0.0) for each in columns]
        deviations, covariance = _learned(adapted.deviations, adapted.covariance, columns, unexplained, variance)
        taken = [jnp.clip(each, -_BOUND, _BOUND) for each in deviations]
        return Adapted(
            strengths=(1 + self.strength_spread * taken[0], 1 + self.strength_spread * taken[1]),
            mass=self.mass_spread * taken[2],
            friction=1 + self.friction_spread * taken[3] if rubbing else jnp.ones_like(angle),
            deviations=deviations,
            covariance=covariance,
            filtered=filtered,
            before=(*now, here),
            muscles=muscles,
            age=age,
        )

    def _signals(
        self, model: AntagonisticJoint, load: Load, muscles: MuscleStates, angle: Scalar, pressures: Pair
    ) -> tuple[Scalar, ...]:
        """Angle [rad] and torques [N*m]: gravity, both muscles, a kilogram more, friction where the model has it."""
        contraction1, contraction2 = model.contractions(angle, pressures)
        arm1, arm2 = model.geometry.paths_and_arms(angle)[1]
        torque1 = model.muscle1.tension(contraction1, pressures[0]) * arm1
        torque2 = model.muscle2.tension(contraction2, pressures[1]) * arm2
        (sine, cosine), (hanging_sine, hanging_cosine) = sincos(angle), sincos(load.hanging_angle)
        sign = 1.0 if load.hanging else -1.0
        hung = sign * load.distance2 * load.gravity * (hanging_sine * cosine - hanging_cosine * sine)
        signals = (angle, load.gravity_torque(angle), torque1, torque2, hung)
        if not model.has_friction:
            return signals
        return (*signals, model.friction_torque(angle, 0.0, pressures, muscles))


def strengthened(model: AntagonisticJoint, strengths: Pair) -> AntagonisticJoint:
    """The model with muscles that are so many times as strong."""
    muscle1, muscle2 = (
        dataclasses.replace(muscle, law=scaled_law(muscle.law, strength))
        for muscle, strength in zip((model.muscle1, model.muscle2), strengths, strict=True)
    )
    return dataclasses.replace(model, muscle1=muscle1, muscle2=muscle2)


def _filtered(stages: tuple[Scalar, ...], signal: Scalar, passed: Scalar) -> tuple[Scalar, ...]:
    """What stands behind each of the lags after one more sample."""
    found = []
    for stage in stages:
        signal = stage + passed * (signal - stage)
        found.append(signal)
    return tuple(found)


def _learned(
    means: tuple[Scalar, ...],
    covariance: tuple[tuple[Scalar, ...], ...],
    columns: list[Scalar],
    unexplained: Scalar,
    variance: ArrayLike,
) -> tuple[tuple[Scalar, ...], tuple[tuple[Scalar, ...], ...]]:
    """One step of recursive least squares: mean and covariance after an equation columns . mean = unexplained."""
    count = range(len(means))
    spread = [sum(covariance[i][j] * columns[j] for j in count) for i in count]
    total = sum(columns[i] * spread[i] for i in count) + variance
    off = unexplained - sum(columns[i] * means[i] for i in count)
    gains = [each / total for each in spread]
    return (
        tuple(means[i] + gains[i] * off for i in count),
        tuple(tuple(covariance[i][j] - gains[i] * spread[j] for j in count) for i in count),
    )
