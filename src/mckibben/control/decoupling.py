"""Decoupled control of angle and stiffness by exact linearisation of a model of the joint."""

from __future__ import annotations

from typing import cast

import equinox as eqx
from jaxtyping import ArrayLike

from mckibben.control.base import Measurement, Setpoint
from mckibben.control.feedback import Feedback
from mckibben.control.linearisation import LinearisedState, LinearisingControl
from mckibben.control.model_based import FrictionShare, ModelBasedControl
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.errors import RangeError
from mckibben.joint.geometry import Pair
from mckibben.units import PositiveTime


class DecouplingControl(ModelBasedControl[LinearisedState], LinearisingControl):
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

    impedance
        Whether the joint is a spring of its stiffness about its reference, with 0.55 of critical damping, for contact
        (Hogan 1985), in place of feedback that rejects every disturbance. A push then feels the stiffness within 15 %
        up to the resonance of inertia and stiffness. Friction is compensated as the observer predicts it: what
        `friction_in_observer` leaves of it is felt as well.

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
    impedance: bool = eqx.field(kw_only=True, static=True, default=False)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.impedance and any(self.model.springs):
            message = "DecouplingControl: an impedance has the stiffness of the setpoint, and one muscle alone has none"
            raise RangeError(message, field="impedance", value=True, remedy="leave it out, or use two muscles")

    def init(self, measurement: Measurement) -> LinearisedState:
        return self.init_linearised((measurement.angle,), measurement.pressures)

    def step(
        self, state: LinearisedState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[LinearisedState, Pair]:
        state, commands = self.steer(state, (setpoint,), (measurement.angle,), measurement.pressures, period)
        return state, cast(Pair, commands)
