"""Exact linearisation of joints: pressures that give commanded accelerations and stiffness at once."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.control.base import Setpoint
from mckibben.control.bounded_allocation import BoundedSolution, allocate_bounded, allocate_pairs
from mckibben.control.feedback import Feedback
from mckibben.control.mechanics import Scalars
from mckibben.control.model_based import Estimates, StatePrediction, Valves
from mckibben.control.reference import ReferenceDerivatives
from mckibben.mechanism.terms import JointTerms
from mckibben.numerics.elementary import exp

# No `from __future__ import annotations`: equinox does not see an AbstractVar written as text.

Scalar = Float[Array, ""]

_SECOND_ZERO = 6.63  # of the weights of a smoothed reference
_DAMPING = 0.55  # of a joint with an impedance, relative to critical: it feels as stiff as asked up to its resonance
_SHARE, _LEAST = 0.5, 0.05  # of the rate of the torque, for the feedback


def smoothing_weights(half: int) -> np.ndarray:
    r"""Weights of the samples of a reference, from `half` before to `half` after, that smooth it without a lag.

    With the preview P the smoothed reference y follows r by the least
    :math:`\int (y - r)^2 + \dddot y^2 / \omega^6 \, dt`, a Butterworth filter forwards and backwards in time,

    .. math:: \frac{y}{r} = \frac{1}{1 + (\omega_r / \omega)^6}, \quad
              w \propto e^{-x} + 2 e^{-x/2} \cos(\sqrt 3 x / 2 - \pi / 3), \quad x = \omega |t|

    whose weights are cut at their second zero, :math:`\omega = 6.63 / P`, and corrected so that a parabola stays one.

    >>> weights, times = smoothing_weights(50), np.arange(-50, 51)
    >>> print(abs(round(float(weights @ times**2), 9)), round(float(weights @ np.cos(0.02 * times)), 2))
    0.0 1.0

    References
    ----------
    M. Tomizuka, Optimal continuous finite preview problem, IEEE Trans. Automatic Control 20, 1975.
    """
    times = np.arange(-half, half + 1) / half
    x = _SECOND_ZERO * np.abs(times)
    weights = np.exp(-x) + 2 * np.exp(-x / 2) * np.cos(np.sqrt(3) / 2 * x - np.pi / 3)
    zeroth, second, fourth = (float(weights @ times**power) for power in (0, 2, 4))
    return weights * (fourth - second * times**2) / (zeroth * fourth - second**2)


class LinearisedState(NamedTuple):
    """Estimates, states of the feedback of each joint, and the last quadratic program."""

    estimates: Estimates
    feedback: tuple[PyTree, ...]
    solution: PyTree


class LinearisingControl(StatePrediction[LinearisedState]):
    """Base of controllers of angles and stiffness at once: exact linearisation of the mechanics, for any joints.

    See `DecouplingControl` and `ComputedTorque`, which give the mechanics.
    """

    feedback: eqx.AbstractVar[Feedback]
    minimum_tension: eqx.AbstractVar[float]
    preview: eqx.AbstractVar[float | None]
    impedance: eqx.AbstractVar[bool]
    samples_ahead: int = eqx.field(kw_only=True, static=True, default=0)
    lead: int = eqx.field(kw_only=True, static=True, default=0)  # control periods within the delay

    def with_period(self, period: float) -> Self:
        self.feedback.check_period(period)
        prepared = super().with_period(period)
        if self.preview is None:
            return prepared
        lead, half = self.whole_periods(period), max(round(self.preview / period), 2)
        return dataclasses.replace(prepared, lead=lead, samples_ahead=lead + half)

    def init_coming(self, angle: Scalar, stiffness: Scalar) -> PyTree:
        if self.preview is None:
            return ()
        constant = jnp.zeros(2 * (self.samples_ahead - self.lead) + 1)
        return Setpoint(constant + angle, constant + stiffness)

    def _follow(
        self, last: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, PyTree]:
        if self.preview is None:
            return super()._follow(last, coming, setpoint, period)
        coming = jax.tree.map(lambda samples, value: jnp.append(samples[1:], value), coming, setpoint)
        return last.update(self._smoothed(coming).angle, period), coming

    def _at_arrival(
        self, reference: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, Setpoint]:
        if self.preview is None:
            return super()._at_arrival(reference, coming, setpoint, period)
        ahead = reference.after(self._delay - self.lead * jnp.asarray(period))
        return ahead, Setpoint(ahead.angle, self._smoothed(coming).stiffness)

    def _smoothed(self, coming: Setpoint) -> Setpoint:
        """Setpoint at the last sample within the delay."""
        weights = jnp.asarray(smoothing_weights(self.samples_ahead - self.lead))
        middle = coming.angle[self.samples_ahead - self.lead]  # differences: a constant stays one to the last bit
        stiffness = coming.stiffness[self.samples_ahead - self.lead]
        return Setpoint(
            middle + jnp.dot(weights, coming.angle - middle), stiffness + jnp.dot(weights, coming.stiffness - stiffness)
        )

    def init_linearised(self, angles: Sequence[ArrayLike], pressures: Sequence[ArrayLike]) -> LinearisedState:
        """State before the first step, at rest at angles [rad] and pressures [Pa]."""
        estimates = self.init_estimates(angles, pressures)
        feedback = tuple(self.feedback.init(jnp.zeros_like(motion.angle)) for motion in estimates.motion)
        solution = () if self.mechanics.is_paired else BoundedSolution.at(estimates.pressures)
        return LinearisedState(estimates, feedback, solution)

    def steer(
        self,
        state: LinearisedState,
        setpoints: Sequence[Setpoint],
        angles: Scalars,
        pressures: Scalars,
        period: ArrayLike,
    ) -> tuple[LinearisedState, Scalars]:
        """Return the next state and the commands [Pa] after measured angles [rad] and pressures [Pa]."""
        estimates, expected = self.update(state.estimates, setpoints, angles, pressures, period)
        ahead, lead = expected.estimates, self._lead(period)
        angles = tuple(motion.angle + lead * motion.velocity for motion in ahead.motion)
        rates = tuple(motion.velocity for motion in ahead.motion)
        terms, lower, upper, torque_rates = self._attainable(angles, expected.valves, period)
        estimates = estimates._replace(stiffness=self._stiffness(estimates, terms))
        equations = self.mechanics.equations(angles, rates)
        friction = ahead.resistance if self.impedance else ahead.friction
        torques = [bias - torque for bias, torque in zip(equations.bias, friction, strict=True)]
        feedback = []
        for i, (setpoint, reference) in enumerate(zip(expected.setpoints, ahead.reference, strict=True)):
            error, rate = setpoint.angle - expected.angles[i], reference.velocity - rates[i]
            inertia, acceleration = equations.matrix[i][i], reference.acceleration_after(lead, period)
            if self.impedance:
                damping = 2 * _DAMPING * jnp.sqrt(setpoint.stiffness * inertia)
                torques[i] = torques[i] + setpoint.stiffness * error + damping * rate
                feedback.append(state.feedback[i])
            else:
                needed = jnp.abs(inertia * reference.jerk + estimates.stiffness[i] * reference.velocity)
                jerk = jnp.maximum(_SHARE * (torque_rates[i] - needed), _LEAST * torque_rates[i]) / inertia
                held, correction = self.feedback.step(state.feedback[i], error, rate, jerk, period)
                acceleration = acceleration + correction - ahead.motion[i].disturbance
                feedback.append(held)
            torques = [torque + row[i] * acceleration for torque, row in zip(torques, equations.matrix, strict=True)]
        stiffness = [to.stiffness - added for to, added in zip(expected.setpoints, ahead.added_stiffness, strict=True)]
        limits = lower, upper, [muscle.law.is_passive for muscle in self.mechanics.muscles]
        if self.mechanics.is_paired:
            allocation = allocate_pairs(terms, torques, stiffness, *limits)
        else:
            allocation = allocate_bounded(terms, torques, stiffness, *limits, state.solution)
        commands = expected.valves.commands_toward(allocation.pressures, self.feedback.lag, period)
        for i, (needed, attained) in enumerate(zip(torques, allocation.torques, strict=True)):
            feedback[i] = self.feedback.track(feedback[i], (needed - attained) / equations.matrix[i][i], period)
        sent = (commands, *estimates.sent[:-1])
        estimates = estimates._replace(sent=sent, saturated=allocation.saturated)
        return LinearisedState(estimates, tuple(feedback), allocation.solution), commands

    def telemetry(self, state: LinearisedState) -> dict[str, PyTree]:
        return self.estimates_telemetry(state.estimates)

    def _stiffness(self, estimates: Estimates, terms: JointTerms) -> Scalars:
        """Estimated stiffness [N*m/rad]."""
        return estimates.stiffness

    def _lead(self, period: ArrayLike) -> ArrayLike:
        """Time [s] after which sampled pressures that follow with the lag of the feedback meet a ramp of targets."""
        return period / (1 - exp(-jnp.asarray(period) / self.feedback.lag))

    def _attainable(
        self, angles: Scalars, valves: Valves, period: ArrayLike
    ) -> tuple[JointTerms, Scalars, Scalars, list[PyTree]]:
        """Terms at angles [rad], limits of the pressures [Pa] in a period, and rates of the torques [N*m/s]."""
        terms, lowest, highest = self.mechanics.allocation_terms(angles, valves.pressures, self.minimum_tension)
        covered = 1 - exp(-jnp.asarray(period) / self.feedback.lag)  # part of the way in a period
        lower, upper, swings = [], [], []
        muscles = zip(lowest, highest, valves.commands[1], valves.pressures, valves.attainable(period), strict=True)
        for low, high, most, pressure, attainable in muscles:
            slowest, fastest = ((limit - pressure) / covered for limit in attainable(pressure))
            upper.append(jnp.minimum(jnp.minimum(high, most), pressure + fastest))
            lower.append(jnp.minimum(jnp.maximum(low, pressure + slowest), upper[-1]))
            swings.append(fastest - slowest)
        rates = [
            sum(jnp.abs(gain) * swings[m] for m, (_, gain) in row.items()) / (2 * self.feedback.lag)
            for row in terms.torque
        ]
        return terms, tuple(lower), tuple(upper), rates
