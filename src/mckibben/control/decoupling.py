"""Decoupled control of angle and stiffness by exact linearisation of a model of the joint."""

from __future__ import annotations

import dataclasses
from typing import Annotated, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import Attainable
from mckibben.control.allocation import keep_taut, linearise, pressure_range, prioritise_torque
from mckibben.control.base import Measurement, Setpoint
from mckibben.control.feedback import Feedback
from mckibben.control.model_based import Estimates, ModelBasedControl, Valves
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.control.reference import ReferenceDerivatives
from mckibben.errors import RangeError
from mckibben.joint import TorqueStiffnessMap
from mckibben.joint.geometry import Pair
from mckibben.numerics.compiled import cached_trace
from mckibben.numerics.elementary import exp
from mckibben.units import Percent, PositiveTime

Scalar = Float[Array, ""]
FrictionShare = Annotated[float, Percent("1", "%", 0, 100)]

_SECOND_ZERO = 6.63  # of the weights of a smoothed reference
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


class DecouplingState(NamedTuple):
    """Estimates, and the state of the feedback."""

    estimates: Estimates
    feedback: PyTree


class DecouplingControl(ModelBasedControl[DecouplingState]):
    r"""Exact linearisation: pressures that give a commanded acceleration and stiffness at once.

    A `Feedback` adds an acceleration to that of the reference. The torque for it (`Load.required_torque`) and the
    stiffness setpoint give pressures by the inverse of the map from (p1, p2) to (torque, stiffness), affine at a given
    angle (`AntagonisticJoint.affine_map`; for other laws the secant, one Newton step per period):

    .. math::

        \tau_c = I\,(\ddot\theta_r(t + T) + a(e, \dot e) - \hat d) + c\,\hat\omega - \tau_g(\theta_T) - \tau_f,
        \quad (\tau_c, K_r) \to p_c \;\text{at}\; \theta_T = \theta + T\hat\omega

    The commands make the pressures follow with the lag T of the feedback, shorter or longer than that of the valves,
    for which it places its poles (`Actuator.command_toward` of the model of the valves). For valves of first order with
    the time constant :math:`\tau_v`

    .. math:: p_{command} = p + \frac{1 - e^{-h/T}}{1 - e^{-h/\tau_v}} (p_c - p)

    and for valves with air the opening follows from the mass flow for the rate of the pressure, at the volume of the
    muscle and its rate. p is the estimate of a `PressureObserver`, so that a shortfall of a valve is commanded again.

    Within the limits, the torque has priority over the stiffness.

    Parameters
    ----------
    model, load
        Models of the joint, and of inertia, damping and gravity.
    feedback
        Outer loop: `PolePlacement` or `SlidingMode`.
    observer
        `VelocityObserver`, or `ExtendedStateObserver`, which observes the disturbance too (active disturbance
        rejection).
    pressure_observer
        Filter of the measured pressures.
    valve
        Model of the valves; by default a `FirstOrderValve` of 20 ms.
    minimum_tension
        Lower limit of each muscle's tension [N].
    friction_compensation
        Whether to compensate the friction of the model's muscles along the reference.
    friction_in_observer
        Share of the friction, 0 to 1, that the observer predicts along the estimated motion, the rest along the
        reference. The stiffness of presliding is then not a disturbance that it has to follow. A joint that sticks
        beside its setpoint keeps a static error, which an `integral` of the feedback removes; muscles with less
        friction than the model hunt if the share is too large. Default: none, at no cost.
    command_delay
        Delay of the commands [s], over which the model predicts (`StatePrediction`); in a file, by default, that of
        the plant.
    preview
        Time [s] for which the reference is known beyond the delay, and over which it is smoothed: the joint begins to
        move before a step (`smoothing_weights`). The setpoint of a step is that `samples_ahead` control periods later.
        Default: none.
    stiffness_amplitude
        Amplitude [rad] of the motion whose stiffness is controlled, friction of the model's muscles included
        (`AntagonisticJoint.secant_stiffness`). Default: the isobaric stiffness.

    References
    ----------
    A. Isidori, Nonlinear Control Systems, 3rd ed., Springer 1995, ch. 5 (exact linearisation); J. Han, From PID to
    active disturbance rejection control, IEEE Trans. Industrial Electronics 56, 2009.
    """

    short_name = "decoupling"

    feedback: Feedback
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()
    friction_in_observer: FrictionShare | None = eqx.field(kw_only=True, default=None)
    preview: PositiveTime | None = eqx.field(kw_only=True, static=True, default=None)
    samples_ahead: int = eqx.field(kw_only=True, static=True, default=0)
    lead: int = eqx.field(kw_only=True, static=True, default=0)  # control periods within the delay

    def with_period(self, period: float) -> Self:
        prepared = super().with_period(period)
        if self.preview is None:
            return prepared
        lead, half = self.whole_periods(period), max(round(self.preview / period), 2)
        return dataclasses.replace(prepared, lead=lead, samples_ahead=lead + half)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.friction_in_observer is not None and not self.friction_compensation:
            raise RangeError(
                "DecouplingControl: friction_in_observer without friction_compensation; nothing would compensate the "
                "friction, which the estimated disturbance then leaves out",
                field="friction_in_observer",
                value=self.friction_in_observer,
                remedy="set friction_compensation too",
            )

    def init_coming(self, angle: Scalar, stiffness: Scalar) -> PyTree:
        if self.preview is None:
            return ()
        constant = jnp.zeros(2 * (self.samples_ahead - self.lead) + 1)
        return Setpoint(constant + angle, constant + stiffness)

    def _follow(self, last: Estimates, setpoint: Setpoint, period: ArrayLike) -> tuple[ReferenceDerivatives, PyTree]:
        if self.preview is None:
            return super()._follow(last, setpoint, period)
        coming = jax.tree.map(lambda samples, value: jnp.append(samples[1:], value), last.coming, setpoint)
        return last.reference.update(self._smoothed(coming).angle, period), coming

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

    def init(self, measurement: Measurement) -> DecouplingState:
        return DecouplingState(self.init_estimates(measurement), self.feedback.init(jnp.zeros_like(measurement.angle)))

    def step(
        self, state: DecouplingState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DecouplingState, Pair]:
        lag = self.feedback.lag
        estimates, expected = self.update(state.estimates, setpoint, measurement, period)
        setpoint, position, ahead, valves = expected
        motion, reference = ahead.motion, ahead.reference
        angle = motion.angle + lag * motion.velocity
        affine, lower, upper, torque_rate = self._attainable(angle, valves, period)

        error, rate = setpoint.angle - position, reference.velocity - motion.velocity
        jerk = self._jerk(torque_rate, reference, estimates.stiffness)
        feedback, correction = self.feedback.step(state.feedback, error, rate, jerk, period)
        acceleration = reference.acceleration_after(lag, period) + correction - motion.disturbance
        torque = self.load.required_torque(angle, motion.velocity, acceleration) - ahead.friction

        stiffness = setpoint.stiffness - ahead.added_stiffness
        allocation = prioritise_torque(affine, torque, stiffness, lower, upper, self.model.springs)
        commands = valves.commands_toward(allocation.pressures, lag, period)

        feedback = self.feedback.track(feedback, (torque - allocation.torque) / self.load.total_inertia, period)
        estimates = estimates._replace(sent=(commands, *estimates.sent[:-1]), saturated=allocation.saturated)
        return DecouplingState(estimates, feedback), commands

    def telemetry(self, state: DecouplingState) -> dict[str, Scalar]:
        return self.estimates_telemetry(state.estimates)

    @cached_trace
    def _attainable(
        self, angle: Scalar, valves: Valves, period: ArrayLike
    ) -> tuple[TorqueStiffnessMap, Pair, Pair, Scalar]:
        """Torque and stiffness over the pressures at an angle [rad], their limits, and the torque's rate [N*m/s]."""
        lowest, highest = pressure_range(self.model, angle, self.minimum_tension)
        covered = 1 - exp(-jnp.asarray(period) / self.feedback.lag)  # part of the way in a period

        def window(i: int, attainable: Attainable) -> tuple[Scalar, Scalar, Scalar]:
            pressure = valves.pressures[i]
            slowest, fastest = ((limit - pressure) / covered for limit in attainable(pressure))
            upper = jnp.minimum(jnp.minimum(highest[i], valves.commands[1][i]), pressure + fastest)
            return jnp.minimum(jnp.maximum(lowest[i], pressure + slowest), upper), upper, fastest - slowest

        reach1, reach2 = valves.attainable(period)
        (lower1, upper1, swing1), (lower2, upper2, swing2) = window(0, reach1), window(1, reach2)
        affine = linearise(self.model, angle, keep_taut(valves.pressures, lowest))
        _, t1, t2 = affine.torque
        rate = (jnp.abs(t1) * swing1 + jnp.abs(t2) * swing2) / (2 * self.feedback.lag)
        return affine, (lower1, lower2), (upper1, upper2), rate

    def _jerk(self, torque_rate: Scalar, reference: ReferenceDerivatives, stiffness: Scalar) -> Scalar:
        """Rate of the acceleration [rad/s^3] that the valves leave to the feedback, above that of the reference."""
        stiffness, inertia = stiffness + self.load.gravity_stiffness(reference.angle), self.load.total_inertia
        needed = jnp.abs(inertia * reference.jerk + stiffness * reference.velocity)
        return jnp.maximum(_SHARE * (torque_rate - needed), _LEAST * torque_rate) / inertia
