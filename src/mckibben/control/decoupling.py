"""Angle and stiffness made independent of each other by inverting a model of the joint."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.allocation import Chosen, map_at, pressures_between, torque_first
from mckibben.control.base import Measurement, Setpoint
from mckibben.control.feedback import Feedback
from mckibben.control.model_based import Beliefs, ModelBasedControl
from mckibben.control.observer import Observer, PressureObserver
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.batching import apart
from mckibben.numerics.checks import check_kind
from mckibben.numerics.elementary import exp

Scalar = Float[Array, ""]


class DecouplingState(NamedTuple):
    """What is believed and was commanded, and what the feedback remembers."""

    beliefs: Beliefs
    feedback: Any


class DecouplingControl(ModelBasedControl):
    r"""Exact linearisation: the pressures that give, by a model, the wanted acceleration and stiffness at once.

    A `Feedback` asks for an acceleration beside that of the wish. The torque for it, and the wished stiffness, are
    turned into pressures by the inverse of the map from (p1, p2) to (torque, stiffness), which is affine at a given
    angle (`AntagonisticJoint.affine_map`; for other laws it is taken as a secant, one Newton step a period):

    .. math::

        \tau_w = I\,(\ddot\theta_r(t + T) + a(e, \dot e) - \hat d) + c\,\hat\omega - \tau_g(\theta_T) - \tau_f,
        \quad (\tau_w, K_r) \to p_w \;\text{at}\; \theta_T = \theta + T\hat\omega

    and the valves, believed to lag by :math:`\tau_v`, are driven so that the pressures follow with the lag T of the
    feedback, whether that is shorter or longer than their own:

    .. math:: p_{command} = p + \frac{1 - e^{-h/T}}{1 - e^{-h/\tau_v}} (p_w - p)

    p is measured (and passes a `PressureObserver`), so that what a valve did not do is asked for again. T is a part of
    the design, not a delay left over: inverting at the angle where the joint will be makes
    :math:`T \dot a + a = \ddot\theta_r(t + T) + a(e, \dot e)` exact, for which the feedback has placed its poles.

    The torque comes first: where torque and stiffness cannot both be had, the pressures are those of the line of
    constant torque that come nearest to the stiffness. The limits are those of the pressures (now, and as far as a
    command within them can move a pressure in time), of the specimens' rated force, and a tension that no muscle goes
    below. So no command leaves the limits, a muscle does not go slack, and a step of the stiffness moves both pressures
    along one straight line on which the torque stays, however slow the valves are.

    The velocity is not measured: an `Observer` has it, and what the model has wrong if it is an
    `ExtendedStateObserver` (then this is active disturbance rejection control). It is told the torque that the model
    gives at the *measured* pressures, so that neither lag nor limits wind it up.

    Parameters
    ----------
    model
        What it believes of the joint.
    load
        What it believes of inertia, damping and gravity.
    feedback
        The outer loop: `PolePlacement` or `SlidingMode`.
    observer
        `VelocityObserver` or `ExtendedStateObserver`.
    pressure_observer
        What it makes of the pressures' sensors.
    valve_time_constant
        tau_v [s], as it believes; 0 for valves without lag.
    minimum_tension
        Below which no muscle shall go [N].
    friction_compensation
        Whether to make up for the friction of the model's muscles, drawn along the wish as `FrictionCompensation` does.
        The observer is told of it; around this controller that wrapper would make up for friction twice.
    adaptation
        Corrects the strength of the model's muscles on line; none unless given.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.control import ExtendedStateObserver, PolePlacement
    >>> knee, load = catalog.joint("knee-table-2"), catalog.load("knee-table-2")
    >>> control = DecouplingControl(knee, load, PolePlacement(bandwidth=80.0), ExtendedStateObserver(bandwidth=250.0))
    >>> round(float(control.feedback.lag), 5)
    0.00417

    References
    ----------
    A. Isidori, Nonlinear Control Systems, 3rd ed., Springer 1995, ch. 5 (exact linearisation); J. Han, From PID to
    active disturbance rejection control, IEEE Trans. Industrial Electronics 56, 2009.
    """

    feedback: Feedback
    observer: Observer
    pressure_observer: PressureObserver = PressureObserver()

    def __check_init__(self) -> None:
        check_kind("DecouplingControl", feedback=(self.feedback, Feedback))

    @property
    def observers(self) -> tuple[Observer, PressureObserver]:
        return self.observer, self.pressure_observer

    def init(self, measurement: Measurement) -> DecouplingState:
        return DecouplingState(self.believed_first(measurement), self.feedback.init(jnp.zeros_like(measurement.angle)))

    def step(
        self, state: DecouplingState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DecouplingState, Pair]:
        angle = measurement.angle
        inertia, lag = self.load.total_inertia, self.feedback.lag
        beliefs, model = self.believed(state.beliefs, setpoint, measurement, period)
        motion, pressures, course = beliefs.motion, beliefs.pressures, beliefs.course

        error, rate = setpoint.angle - angle, course.velocity - motion.velocity
        memory, correction = self.feedback.step(state.feedback, error, rate, period)
        acceleration = course.ahead(lag, period) + correction - motion.disturbance
        there = motion.angle + lag * motion.velocity
        resisting = self.load.gravity_torque(there) - self.load.damping * motion.velocity
        wanted = inertia * acceleration - resisting - beliefs.friction

        speed = (1 - exp(-jnp.asarray(period) / lag)) / self.share(period)
        choose = functools.partial(self._choose, model)
        chosen = apart(choose, there, pressures, wanted, setpoint.stiffness, speed, witness=period)
        (pressure1, pressure2), (wished1, wished2) = pressures, chosen.pressures
        commands = self.held((pressure1 + speed * (wished1 - pressure1), pressure2 + speed * (wished2 - pressure2)))

        memory = self.feedback.realised(memory, (wanted - chosen.torque) / inertia, period)
        return DecouplingState(beliefs._replace(commands=commands, saturated=chosen.cut), memory), commands

    def telemetry(self, state: DecouplingState) -> dict[str, Scalar]:
        return self.told(state.beliefs)

    def _choose(
        self,
        model: AntagonisticJoint,
        angle: Scalar,
        pressures: Pair,
        torque: Scalar,
        stiffness: Scalar,
        speed: Scalar,
    ) -> Chosen:
        """The pressures [Pa] wanted at an angle [rad], which commands within limits can bring about in time."""
        lowest, highest = pressures_between(model, angle, self.minimum_tension)
        low, high = pressure_limits_of(model)

        def window(i: int) -> tuple[Scalar, Scalar, Scalar]:
            """Lowest and highest pressure of a muscle, and the nearest to where it is that keeps it taut."""
            pressure = pressures[i]
            upper = jnp.minimum(highest[i], pressure + (high[i] - pressure) / speed)
            lower = jnp.maximum(lowest[i], pressure + (low[i] - pressure) / speed)
            return jnp.minimum(lower, upper), upper, jnp.maximum(pressure, lowest[i])

        (lower1, upper1, taut1), (lower2, upper2, taut2) = window(0), window(1)
        affine = map_at(model, angle, (taut1, taut2))
        return torque_first(affine, torque, stiffness, (lower1, lower2), (upper1, upper2))
