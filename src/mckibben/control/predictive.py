"""Angle and stiffness by looking ahead: the best way within what the muscles can do, worked out anew each period."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.course import Course, followed, standing
from mckibben.control.horizon import Bent, Outlook, Policy, later, planned, steady
from mckibben.control.inversion import map_at, pressures_between
from mckibben.control.observer import ExtendedStateObserver, Motion, Observer, PressureObserver
from mckibben.errors import RangeError
from mckibben.joint import AffineMap, AntagonisticJoint, TorqueStiffnessMap, friction
from mckibben.joint.attainable import is_affine, pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.checks import check_kind, check_positive, check_within
from mckibben.numerics.elementary import exp
from mckibben.numerics.many import apart
from mckibben.plant import Load
from mckibben.units import bar, deg

Scalar = Float[Array, ""]

_REMEMBERED = 0.1  # s: over how long the frequency of a wish is told
_STILL = 1e-6  # rad^2/s^2: a wish that moves less has no frequency
_ASIDE = 0.02  # rad: where the model is asked a second time, to tell how it changes with the angle
_EVEN = 0.3  # of stage over valve: below it the share of a stage is told by a series


class PredictiveState(NamedTuple):
    """What the observers believe, what was commanded, how the wish moves, the plan, and what the muscles remember.

    Of how the wish swings there are the means over the last moments of jerk times velocity and of velocity squared; the
    plan is a policy over the horizon, for pressures in bar. And what is told: the estimate of the stiffness [N*m/rad],
    the disturbance and friction torques [N*m], and whether the next stage ends at a limit.
    """

    motion: Motion
    pressures: Pair
    commands: Pair
    course: Course
    swing: Pair
    plan: Policy
    memories: friction.Memories
    estimate: Scalar
    disturbance: Scalar
    friction: Scalar
    saturated: Array


class Surroundings(NamedTuple):
    """What a model says of the joint at an angle, and how it changes with the angle.

    Attributes
    ----------
    torque, softening
        Torque over the pressures, of taut muscles, and how it falls with the angle.
    stiffness, stiffness_slope
        The same of the stiffness, and how it grows.
    lowest, highest, lowest_slope, highest_slope
        Limits of the pressures.
    """

    torque: AffineMap
    softening: AffineMap
    stiffness: AffineMap
    stiffness_slope: AffineMap
    lowest: Pair
    highest: Pair
    lowest_slope: Pair
    highest_slope: Pair


class PredictiveControl(Controller):
    r"""Model predictive control: of all ways to go within the attainable, the one that costs least.

    Each period the way over the next `horizon` is sought that makes least of

    .. math::

        \int \frac{1}{\theta_s^2} \Big(e^2 + d(d - 2)\Big(\frac{\dot e^2}{\omega_c^2}
        + \frac{\ddot e^2}{\omega_c^4}\Big) + \frac{\dddot e^2}{\omega_c^6}\Big)
        + \frac{1}{K_s^2} \Big((K - K_r)^2 + \frac{\dot K^2}{\omega_K^2}\Big) \, dt, \quad e = \theta - \theta_r

    and the first command of it is given. The joint is predicted by its model: torque and stiffness affine in the
    pressures (for other laws by a secant, anew each period), to second order in the angle; valves of first order. The
    acceleration of the wish goes on as that of a sine whose frequency is told from its last moments, for a controller
    is given no future; its stiffness stays, and so does the disturbance that the observer sees.

    What the pressures may be is what the joint can attain: within the law's pressures and the rated force, and above a
    tension that no muscle goes below, at the angle where the joint will be then; and from each to the next only what a
    valve can do. Commands are within the law's pressures.

    Where no limit is met in the horizon this is, but for the length of a stage, the linear loop

    .. math:: \dddot e + d\,\omega_c \ddot e + d\,\omega_c^2 \dot e + \omega_c^3 e = 0, \quad
              \dot K = \omega_K (K_r - K)

    each apart from the other, and the length of the horizon does not matter. Where one is, angle and stiffness are
    given up for each other as their errors weigh: with a small :math:`\theta_s / K_s`, as it is unless given, the
    torque comes first.

    The way is found by control-limited differential dynamic programming (`mckibben.control.horizon`): a Newton step or
    a few from the plan of the last period. There is no integral that could wind up: the observer is told the torque
    that the model gives at the measured pressures.

    Parameters
    ----------
    model
        What it believes of the joint.
    load
        What it believes of inertia, damping and gravity.
    observer
        `ExtendedStateObserver`, or `VelocityObserver`, with which the error of a wrong model stays.
    pressure_observer
        What it makes of the pressures' sensors.
    bandwidth
        omega_c of the angle [rad/s].
    stiffness_bandwidth
        omega_K of the stiffness [rad/s].
    damping
        d, from 2 (the poles of the angle are a Butterworth pattern: quick, with 8 % of overshoot) to 3 (all at one
        place: none, and valves may be slower than believed).
    angle_scale, stiffness_scale
        Errors that weigh the same: theta_s [rad] and K_s [N*m/rad]. Only their ratio counts.
    horizon
        How far it looks [s].
    stages
        Into how many stages the horizon is divided; a stage is never shorter than the control period.
    iterations
        Newton steps a period.
    valve_time_constant
        tau_v [s], as it believes; 0 for valves without lag.
    minimum_tension
        Below which no muscle shall go [N].
    friction_compensation
        Whether to make up for the friction of the model's muscles, drawn along the wish as `FrictionCompensation` does.
        The observer is told of it; around this controller that wrapper would make up for friction twice.

    Examples
    --------
    >>> from mckibben import catalog
    >>> knee, load = catalog.joint("knee-table-2"), catalog.load("knee-table-2")
    >>> PredictiveControl(knee, load, bandwidth=60.0).stages
    12

    References
    ----------
    Y. Tassa, N. Mansard and E. Todorov, Control-limited differential dynamic programming, ICRA 2014; the cost at the
    end of the horizon after D. Q. Mayne et al., Constrained model predictive control: stability and optimality,
    Automatica 36, 2000.
    """

    model: AntagonisticJoint
    load: Load
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()
    bandwidth: float = eqx.field(kw_only=True, default=80.0)
    stiffness_bandwidth: float = eqx.field(kw_only=True, default=200.0)
    damping: float = eqx.field(kw_only=True, default=2.25)
    angle_scale: float = eqx.field(kw_only=True, default=0.01 * deg)
    stiffness_scale: float = eqx.field(kw_only=True, default=0.5)
    horizon: float = eqx.field(kw_only=True, default=0.06)
    stages: int = eqx.field(kw_only=True, static=True, default=12)
    iterations: int = eqx.field(kw_only=True, static=True, default=1)
    valve_time_constant: float = eqx.field(kw_only=True, default=0.02)
    minimum_tension: float = eqx.field(kw_only=True, default=5.0)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)

    def __check_init__(self) -> None:
        name = "PredictiveControl"
        check_kind(
            name,
            model=(self.model, AntagonisticJoint),
            load=(self.load, Load),
            observer=(self.observer, Observer),
            pressure_observer=(self.pressure_observer, PressureObserver),
        )
        check_positive(name, "rad/s", bandwidth=self.bandwidth, stiffness_bandwidth=self.stiffness_bandwidth)
        check_within(name, 2.0, 3.0, damping=self.damping)
        check_positive(name, "rad", angle_scale=self.angle_scale)
        check_positive(name, "N*m/rad", stiffness_scale=self.stiffness_scale)
        check_positive(name, "s", horizon=self.horizon)
        check_positive(name, stages=self.stages, iterations=self.iterations)
        check_positive(name, "s", zero=True, valve_time_constant=self.valve_time_constant)
        check_positive(name, "N", zero=True, minimum_tension=self.minimum_tension)
        if self.friction_compensation and not friction.has_friction(self.model):
            raise RangeError(
                f"{name}: no muscle of its model has friction to make up for",
                remedy="give the model's muscles a MaxwellSlip, or leave friction_compensation out",
            )

    def init(self, measurement: Measurement) -> PredictiveState:
        angle, pressures = measurement
        torque, estimate = self.model.torque_and_stiffness(angle, pressures)
        nothing = jnp.zeros_like(angle)
        return PredictiveState(
            motion=self.observer.init(angle, self._acceleration(angle, nothing, torque)),
            pressures=pressures,
            commands=pressures,
            course=standing(angle),
            swing=(nothing, nothing),
            plan=steady((pressures[0] / bar, pressures[1] / bar), self.stages),
            memories=friction.unstressed(self.model, angle, pressures) if self.friction_compensation else ((), ()),
            estimate=estimate,
            disturbance=nothing,
            friction=nothing,
            saturated=jnp.asarray(False),
        )

    def step(
        self, state: PredictiveState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[PredictiveState, Pair]:
        angle = measurement.angle
        pressures = self.pressure_observer.step(
            state.pressures, state.commands, measurement.pressures, self._share(period), period
        )
        torque, estimate = apart(self.model.torque_and_stiffness, angle, pressures, witness=period)
        memories, rubbing = self._friction(state.memories, setpoint.angle, pressures)
        known = self._acceleration(angle, state.motion.velocity, torque + rubbing)
        motion = self.observer.step(state.motion, angle, known, period)
        course = followed(state.course, setpoint.angle, period)
        fresh = 1 - exp(-jnp.asarray(period) / _REMEMBERED)
        along, moving = state.swing
        along = along + fresh * (course.jerk * course.velocity - along)
        moving = moving + fresh * (course.velocity**2 - moving)

        around = apart(self._around, angle, pressures, witness=period)
        other = motion.disturbance + rubbing / self.load.total_inertia
        duration = jnp.maximum(jnp.asarray(self.horizon) / self.stages, period)
        outlook = self._outlook(
            around, angle, other, course, -along / (moving + _STILL), setpoint.stiffness, duration, period
        )

        # The state now, as errors against the wish, in units of the outlook.
        unit, pole = jnp.asarray(self.angle_scale), jnp.asarray(self.bandwidth)
        _, velocity, acceleration, _ = outlook.wish
        known = self._acceleration(angle, motion.velocity, torque)
        start = (
            (angle - setpoint.angle) / unit,
            motion.velocity / (pole * unit) - velocity,
            (known + other) / (pole**2 * unit) - acceleration,
            (estimate - setpoint.stiffness) / self.stiffness_scale,
        )
        here = pressures[0] / bar, pressures[1] / bar
        plan = later(state.plan, jnp.minimum(period / duration, 1.0))
        plan, ((next1, next2), held) = planned(outlook, start, here, plan, self.iterations)

        commands = self._held(
            (
                bar * (here[0] + (next1 - here[0]) / outlook.share),
                bar * (here[1] + (next2 - here[1]) / outlook.share),
            )
        )
        disturbance = self.load.total_inertia * motion.disturbance
        return (
            PredictiveState(
                motion,
                pressures,
                commands,
                course,
                (along, moving),
                plan,
                memories,
                estimate,
                disturbance,
                rubbing,
                held,
            ),
            commands,
        )

    def telemetry(self, state: PredictiveState) -> dict[str, Scalar]:
        return {
            "stiffness_estimate": state.estimate,
            "saturated": state.saturated,
            "velocity_estimate": state.motion.velocity,
            "disturbance_estimate": state.disturbance,
            "friction_compensation": state.friction,
        }

    def _outlook(
        self,
        around: Surroundings,
        angle: Scalar,
        other: Scalar,
        course: Course,
        swing: Scalar,
        stiffness: ArrayLike,
        duration: Scalar,
        period: ArrayLike,
    ) -> Outlook:
        """What is ahead, without units: time in 1/omega_c, errors in their scales, pressures in bar."""
        load, turn, pole = self.load, jnp.asarray(self.angle_scale), jnp.asarray(self.bandwidth)
        inertia, scale = load.total_inertia, jnp.asarray(self.stiffness_scale)
        push = 1 / (inertia * pole**2 * turn)
        gravity = load.gravity_torque(angle)
        by_angle = zip((1.0, bar, bar), around.torque, around.softening, around.stiffness_slope, strict=True)
        acceleration = [
            Bent(push * part * value, -push * part * turn * fall, -push * part * turn**2 * change)
            for part, value, fall, change in by_angle
        ]
        value, slope, bend = acceleration[0]
        acceleration[0] = Bent(
            value + push * (gravity + inertia * other),
            slope - push * turn * load.gravity_stiffness(angle),
            bend - push * turn**2 * gravity,
        )
        stiffnesses = [
            Bent(part * value / scale, part * turn * slope / scale)
            for part, value, slope in zip((1.0, bar, bar), around.stiffness, around.stiffness_slope, strict=True)
        ]
        value, slope, bend = stiffnesses[0]
        stiffnesses[0] = Bent(value - stiffness / scale, slope, bend)

        def limit(values: Pair, slopes: Pair) -> tuple[Bent, Bent]:
            return Bent(values[0] / bar, turn * slopes[0] / bar), Bent(values[1] / bar, turn * slopes[1] / bar)

        (low1, low2), (high1, high2) = pressure_limits_of(self.model)
        # Differences are as old as the samples between which they were taken.
        now = course.ahead(0.0, period)
        velocity = course.velocity + period / 2 * now
        share, early = self._stage(duration)
        return Outlook(
            stage=pole * duration,
            early=early,
            share=share,
            damping=jnp.asarray(self.damping),
            slowness=(pole / self.stiffness_bandwidth) ** 2,
            acceleration=tuple(acceleration),  # type: ignore[arg-type]
            stiffness=tuple(stiffnesses),  # type: ignore[arg-type]
            drag=load.damping / (inertia * pole),
            wish=(
                (course.angle - angle) / turn,
                velocity / (pole * turn),
                now / (pole**2 * turn),
                course.jerk / (pole**3 * turn),
            ),
            swing=jnp.clip(swing, 0.0, (jnp.pi / (self.stages * duration)) ** 2) / pole**2,
            lowest=limit(around.lowest, around.lowest_slope),
            highest=limit(around.highest, around.highest_slope),
            least=(low1 / bar, low2 / bar),
            most=(high1 / bar, high2 / bar),
        )

    def _around(self, angle: Scalar, pressures: Pair) -> Surroundings:
        """What the model says of the joint about an angle [rad] and pressures [Pa]."""

        def at(angle: Scalar) -> tuple[TorqueStiffnessMap, Pair, Pair]:
            lowest, highest = pressures_between(self.model, angle, self.minimum_tension)
            return map_at(self.model, angle, _taut(pressures, lowest)), lowest, highest

        both = lax.map(at, jnp.stack([angle, angle + _ASIDE]))  # a loop: half of the code to compile
        (torque, stiffness), lowest, highest = jax.tree.map(lambda values: values[0], both)
        (_, stiffness_slope), *limit_slopes = jax.tree.map(lambda values: (values[1] - values[0]) / _ASIDE, both)
        softening = stiffness
        if not is_affine(self.model):  # a secant across the stop of a spring says nothing of other pressures
            nothing = jnp.zeros_like(angle)
            softening = AffineMap(stiffness(_taut(pressures, lowest)), nothing, nothing)
            stiffness_slope = AffineMap(nothing, nothing, nothing)
        return Surroundings(torque, softening, stiffness, stiffness_slope, lowest, highest, *limit_slopes)

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

    def _share(self, duration: ArrayLike) -> Scalar:
        """The part of a step that a valve is believed to do in a time [s]."""
        lag = jnp.asarray(self.valve_time_constant)
        return jnp.where(lag > 0, 1 - exp(-jnp.asarray(duration) / jnp.where(lag > 0, lag, 1.0)), 1.0)

    def _stage(self, duration: Scalar) -> tuple[Scalar, Pair]:
        """That of a stage [s], and how early in it the pressures change: see `Outlook`."""
        share, lag = self._share(duration), jnp.asarray(self.valve_time_constant)
        ratio = duration / jnp.where(lag > 0, lag, duration / 10)
        series = ratio / 12 - ratio**3 / 720
        even = ratio < _EVEN
        once, twice = 1 / share - 1 / ratio, (1 - 2 / ratio) / share + 2 / ratio**2
        first, second = jnp.where(even, 0.5 + series, once), jnp.where(even, 1 / 3 + series + ratio**2 / 360, twice)
        return share, (jnp.where(lag > 0, first, 1.0), jnp.where(lag > 0, second, 1.0))

    def _held(self, commands: Pair) -> Pair:
        """The commands, which rounding may have taken past a limit."""
        (low1, low2), (high1, high2) = pressure_limits_of(self.model)
        return jnp.clip(commands[0], low1, high1), jnp.clip(commands[1], low2, high2)


def _taut(pressures: Pair, lowest: Pair) -> Pair:
    """The nearest pressures that keep both muscles taut."""
    return jnp.maximum(pressures[0], lowest[0]), jnp.maximum(pressures[1], lowest[1])
