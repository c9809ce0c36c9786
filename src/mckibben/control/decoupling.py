"""Decoupled control of angle and stiffness by exact linearisation of a model of the joint."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.allocation import (
    Allocation,
    clip_commands,
    keep_taut,
    linearise,
    pressure_range,
    prioritise_torque,
)
from mckibben.control.base import Measurement, Setpoint
from mckibben.control.feedback import Feedback
from mckibben.control.model_based import Estimates, ModelBasedControl
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver, lag_fraction
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.compiled import computed_once
from mckibben.numerics.elementary import exp

Scalar = Float[Array, ""]


class DecouplingState(NamedTuple):
    """Estimates, and the state of the feedback."""

    estimates: Estimates
    feedback: Any


class DecouplingControl(ModelBasedControl):
    r"""Exact linearisation: pressures that give a commanded acceleration and stiffness at once.

    A `Feedback` adds an acceleration to that of the reference. The torque for it (`Load.required_torque`) and the
    stiffness setpoint give pressures by the inverse of the map from (p1, p2) to (torque, stiffness), affine at a given
    angle (`AntagonisticJoint.affine_map`; for other laws the secant, one Newton step a period):

    .. math::

        \tau_c = I\,(\ddot\theta_r(t + T) + a(e, \dot e) - \hat d) + c\,\hat\omega - \tau_g(\theta_T) - \tau_f,
        \quad (\tau_c, K_r) \to p_c \;\text{at}\; \theta_T = \theta + T\hat\omega

    The commands to the valves, of time constant :math:`\tau_v`, make the pressures follow with the lag T of the
    feedback, shorter or longer than their own, for which it places its poles:

    .. math:: p_{command} = p + \frac{1 - e^{-h/T}}{1 - e^{-h/\tau_v}} (p_c - p)

    p is the estimate of a `PressureObserver`, so that what a valve did not do is commanded again.

    The torque has priority: where torque and stiffness are not attainable together, the stiffness is the nearest on the
    line of constant torque. Limits: the pressures (now, and within the speed of the valves), the specimens' rated force
    and a minimum tension. A step of the stiffness moves both pressures along a straight line of constant torque,
    however slow the valves.

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
    valve_time_constant
        tau_v [s] of the model; 0 for valves without lag.
    minimum_tension
        Lower limit of each muscle's tension [N].
    friction_compensation
        Whether to compensate the friction of the model's muscles along the reference. The observer accounts for it; do
        not wrap this controller in `FrictionCompensation`.
    adaptation
        On-line correction of the strength of the model's muscles; none unless given.
    valve_adaptation
        On-line estimate of tau_v; none unless given.
    stiffness_amplitude
        Amplitude [rad] of the motion whose stiffness is controlled, friction of the model's muscles included
        (`AntagonisticJoint.secant_stiffness`); the isobaric stiffness unless given.

    References
    ----------
    A. Isidori, Nonlinear Control Systems, 3rd ed., Springer 1995, ch. 5 (exact linearisation); J. Han, From PID to
    active disturbance rejection control, IEEE Trans. Industrial Electronics 56, 2009.
    """

    short_name = "decoupling"
    renamed: ClassVar = {
        "poles": "feedback",
        "sliding": "feedback",
        "velocity_observer": "observer",
        "disturbance_observer": "observer",
    }

    feedback: Feedback
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()

    @property
    def observers(self) -> tuple[Observer, PressureObserver]:
        return self.observer, self.pressure_observer

    def init(self, measurement: Measurement) -> DecouplingState:
        return DecouplingState(self.init_estimates(measurement), self.feedback.init(jnp.zeros_like(measurement.angle)))

    def step(
        self, state: DecouplingState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DecouplingState, Pair]:
        lag = self.feedback.lag
        estimates, model = self.update(state.estimates, setpoint, measurement, period)
        motion, pressures, reference = estimates.motion, estimates.pressures, estimates.reference

        error, rate = setpoint.angle - measurement.angle, reference.velocity - motion.velocity
        feedback, correction = self.feedback.step(state.feedback, error, rate, period)
        acceleration = reference.acceleration_after(lag, period) + correction - motion.disturbance
        angle = motion.angle + lag * motion.velocity
        torque = self.load.required_torque(angle, motion.velocity, acceleration) - estimates.friction

        speed = (1 - exp(-jnp.asarray(period) / lag)) / lag_fraction(self.valve_lag(estimates.valves), period)
        allocation = self._allocate(
            model, angle, pressures, torque, setpoint.stiffness - estimates.added_stiffness, speed
        )
        (p1, p2), (target1, target2) = pressures, allocation.pressures
        commands, _ = clip_commands(self.model, (p1 + speed * (target1 - p1), p2 + speed * (target2 - p2)))  # rounding

        feedback = self.feedback.track(feedback, (torque - allocation.torque) / self.load.total_inertia, period)
        estimates = estimates._replace(commands=commands, saturated=allocation.saturated)
        return DecouplingState(estimates, feedback), commands

    def telemetry(self, state: DecouplingState) -> dict[str, Scalar]:
        return self.estimates_telemetry(state.estimates)

    @computed_once
    def _allocate(
        self, model: AntagonisticJoint, angle: Scalar, pressures: Pair, torque: Scalar, stiffness: Scalar, speed: Scalar
    ) -> Allocation:
        """Pressures [Pa] for a torque and a stiffness at an angle [rad], attainable with commands within limits."""
        lowest, highest = pressure_range(model, angle, self.minimum_tension)
        low, high = pressure_limits_of(model)

        def window(i: int) -> tuple[Scalar, Scalar]:
            """Lower and upper limit of a pressure, within the speed of its valve."""
            upper = jnp.minimum(highest[i], pressures[i] + (high[i] - pressures[i]) / speed)
            return jnp.minimum(jnp.maximum(lowest[i], pressures[i] + (low[i] - pressures[i]) / speed), upper), upper

        (lower1, upper1), (lower2, upper2) = window(0), window(1)
        affine = linearise(model, angle, keep_taut(pressures, lowest))
        return prioritise_torque(affine, torque, stiffness, (lower1, lower2), (upper1, upper2), model.springs)
