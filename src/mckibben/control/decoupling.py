"""Angle and stiffness made independent of each other by inverting a model of the joint."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.adaptation import Adapted, LawAdaptation, strengthened
from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.course import Course, followed, standing
from mckibben.control.feedback import Feedback
from mckibben.control.inversion import Chosen, map_at, pressures_between, torque_first
from mckibben.control.observer import Motion, Observer, PressureObserver
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, friction
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.checks import check_kind, check_positive
from mckibben.numerics.elementary import exp
from mckibben.numerics.many import apart
from mckibben.plant import Load

Scalar = Float[Array, ""]


class DecouplingState(NamedTuple):
    """What the observers believe, what was commanded, how the wish moves, what feedback and muscles remember.

    And what is told: the estimate of the stiffness [N*m/rad], the disturbance and friction torques [N*m], and whether a
    wish was cut off.
    """

    motion: Motion
    pressures: Pair
    commands: Pair
    course: Course
    feedback: Any
    memories: friction.Memories
    estimate: Scalar
    disturbance: Scalar
    friction: Scalar
    saturated: Array
    adapted: Adapted | tuple[()]


class DecouplingControl(Controller):
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

    model: AntagonisticJoint
    load: Load
    feedback: Feedback
    observer: Observer
    pressure_observer: PressureObserver = PressureObserver()
    valve_time_constant: float = eqx.field(kw_only=True, default=0.02)
    minimum_tension: float = eqx.field(kw_only=True, default=5.0)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)
    adaptation: LawAdaptation | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        check_kind(
            "DecouplingControl",
            model=(self.model, AntagonisticJoint),
            load=(self.load, Load),
            feedback=(self.feedback, Feedback),
            observer=(self.observer, Observer),
            pressure_observer=(self.pressure_observer, PressureObserver),
        )
        if self.adaptation is not None:
            check_kind("DecouplingControl", adaptation=(self.adaptation, LawAdaptation))
        check_positive("DecouplingControl", "s", zero=True, valve_time_constant=self.valve_time_constant)
        check_positive("DecouplingControl", "N", zero=True, minimum_tension=self.minimum_tension)
        if self.friction_compensation and not friction.has_friction(self.model):
            raise RangeError(
                "DecouplingControl: no muscle of its model has friction to make up for",
                remedy="give the model's muscles a MaxwellSlip, or leave friction_compensation out",
            )

    def init(self, measurement: Measurement) -> DecouplingState:
        angle, pressures = measurement
        torque, estimate = self.model.torque_and_stiffness(angle, pressures)
        nothing = jnp.zeros_like(angle)
        return DecouplingState(
            motion=self.observer.init(angle, self._acceleration(angle, nothing, torque)),
            pressures=pressures,
            commands=pressures,
            course=standing(angle),
            feedback=self.feedback.init(nothing),
            memories=friction.unstressed(self.model, angle, pressures) if self.friction_compensation else ((), ()),
            estimate=estimate,
            disturbance=nothing,
            friction=nothing,
            saturated=jnp.asarray(False),
            adapted=() if self.adaptation is None else self.adaptation.init(self.model, self.load, angle, pressures),
        )

    def step(
        self, state: DecouplingState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DecouplingState, Pair]:
        angle = measurement.angle
        inertia, lag = self.load.total_inertia, self.feedback.lag
        share = self._share(period)
        pressures = self.pressure_observer.step(state.pressures, state.commands, measurement.pressures, share, period)

        adapted, model = self._adapted(state.adapted, measurement, period)
        torque, estimate = apart(model.torque_and_stiffness, angle, pressures, witness=period)
        memories, rubbing = self._friction(state.memories, setpoint.angle, pressures)
        known = self._acceleration(angle, state.motion.velocity, torque + rubbing)
        motion = self.observer.step(state.motion, angle, known, period)
        course = followed(state.course, setpoint.angle, period)

        error, rate = setpoint.angle - angle, course.velocity - motion.velocity
        memory, correction = self.feedback.step(state.feedback, error, rate, period)
        acceleration = course.ahead(lag, period) + correction - motion.disturbance
        there = motion.angle + lag * motion.velocity
        resisting = self.load.gravity_torque(there) - self.load.damping * motion.velocity
        wanted = inertia * acceleration - resisting - rubbing

        speed = (1 - exp(-jnp.asarray(period) / lag)) / share
        choose = functools.partial(self._choose, model)
        chosen = apart(choose, there, pressures, wanted, setpoint.stiffness, speed, witness=period)
        (pressure1, pressure2), (wished1, wished2) = pressures, chosen.pressures
        commands = self._held((pressure1 + speed * (wished1 - pressure1), pressure2 + speed * (wished2 - pressure2)))

        memory = self.feedback.realised(memory, (wanted - chosen.torque) / inertia, period)
        disturbance = inertia * motion.disturbance
        return (
            DecouplingState(
                motion,
                pressures,
                commands,
                course,
                memory,
                memories,
                estimate,
                disturbance,
                rubbing,
                chosen.cut,
                adapted,
            ),
            commands,
        )

    def telemetry(self, state: DecouplingState) -> dict[str, Scalar]:
        told = {
            "stiffness_estimate": state.estimate,
            "saturated": state.saturated,
            "velocity_estimate": state.motion.velocity,
            "disturbance_estimate": state.disturbance,
            "friction_compensation": state.friction,
        }
        if not isinstance(state.adapted, Adapted):
            return told
        strength1, strength2 = state.adapted.strengths
        return {**told, "strength1_estimate": strength1, "strength2_estimate": strength2}

    def _adapted(
        self, adapted: Adapted | tuple[()], measurement: Measurement, period: ArrayLike
    ) -> tuple[Adapted | tuple[()], AntagonisticJoint]:
        """What is believed of the muscles now, and the model with it.

        From the pressures as measured: what an observer makes of them is off where its valve is not the true one.
        """
        if self.adaptation is None or not isinstance(adapted, Adapted):
            return adapted, self.model
        adapted = self.adaptation.step(adapted, self.model, self.load, *measurement, period)
        return adapted, strengthened(self.model, adapted.strengths)

    def _acceleration(self, angle: ArrayLike, velocity: ArrayLike, torque: ArrayLike) -> Scalar:
        """What the model expects [rad/s^2]."""
        moving = torque + self.load.gravity_torque(angle) - self.load.damping * velocity
        return jnp.asarray(moving / self.load.total_inertia)

    def _friction(
        self, memories: friction.Memories, wish: ArrayLike, pressures: Pair
    ) -> tuple[friction.Memories, Scalar]:
        """What the model's muscles remember along the wish [rad], and the torque [N*m] of their friction there."""
        if not self.friction_compensation:
            return memories, jnp.zeros_like(pressures[0])
        memories = friction.settled(self.model, memories, wish, pressures)
        return memories, friction.friction_torque(self.model, memories, wish, 0.0, pressures)

    def _share(self, period: ArrayLike) -> Scalar:
        """The part of a step that a valve is believed to do in a period."""
        lag = jnp.asarray(self.valve_time_constant)
        return jnp.where(lag > 0, 1 - exp(-jnp.asarray(period) / jnp.where(lag > 0, lag, 1.0)), 1.0)

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

    def _held(self, commands: Pair) -> Pair:
        """The commands, which rounding may have taken past a limit."""
        (low1, low2), (high1, high2) = pressure_limits_of(self.model)
        return jnp.clip(commands[0], low1, high1), jnp.clip(commands[1], low2, high2)
