"""Angle and stiffness by looking ahead: the best way within what the muscles can do, worked out anew each period."""

from __future__ import annotations

import functools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.base import Measurement, Setpoint
from mckibben.control.ddp import Bent, Outlook, Policy, later, planned, steady
from mckibben.control.model_based import Beliefs, ModelBasedControl, Surroundings, surroundings
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.control.reference import Course
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.batching import apart
from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import exp
from mckibben.units import AngleScale, Bandwidth, Count, Iterations, PoleDamping, PositiveTime, StiffnessScale, bar, deg

Scalar = Float[Array, ""]

_REMEMBERED = 0.1  # s: over how long the frequency of a wish is told
_STILL = 1e-6  # rad^2/s^2: a wish that moves less has no frequency
_EVEN = 0.3  # of stage over valve: below it the share of a stage is told by a series


class PredictiveState(NamedTuple):
    """What is believed and was commanded, how the wish swings, and the plan.

    Of how it swings there are the means over the last moments of jerk times velocity and of velocity squared; the plan
    is a policy over the horizon, for pressures in bar.
    """

    beliefs: Beliefs
    swing: Pair
    plan: Policy


class PredictiveControl(ModelBasedControl):
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

    The way is found by control-limited differential dynamic programming (`mckibben.control.ddp`): a Newton step or
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
    adaptation
        Corrects the strength of the model's muscles on line; none unless given.

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

    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()
    bandwidth: Bandwidth = eqx.field(kw_only=True, default=80.0)
    stiffness_bandwidth: Bandwidth = eqx.field(kw_only=True, default=200.0)
    damping: PoleDamping = eqx.field(kw_only=True, default=2.25)
    angle_scale: AngleScale = eqx.field(kw_only=True, default=0.01 * deg)
    stiffness_scale: StiffnessScale = eqx.field(kw_only=True, default=0.5)
    horizon: PositiveTime = eqx.field(kw_only=True, default=0.06)
    stages: Count = eqx.field(kw_only=True, static=True, default=12)
    iterations: Iterations = eqx.field(kw_only=True, static=True, default=1)

    def __check_init__(self) -> None:
        name = "PredictiveControl"
        check_positive(name, "rad/s", bandwidth=self.bandwidth, stiffness_bandwidth=self.stiffness_bandwidth)
        check_within(name, 2.0, 3.0, damping=self.damping)
        check_positive(name, "rad", angle_scale=self.angle_scale)
        check_positive(name, "N*m/rad", stiffness_scale=self.stiffness_scale)
        check_positive(name, "s", horizon=self.horizon)
        check_positive(name, stages=self.stages, iterations=self.iterations)

    @property
    def observers(self) -> tuple[Observer, PressureObserver]:
        return self.observer, self.pressure_observer

    def init(self, measurement: Measurement) -> PredictiveState:
        nothing = jnp.zeros_like(measurement.angle)
        pressure1, pressure2 = measurement.pressures
        plan = steady((pressure1 / bar, pressure2 / bar), self.stages)
        return PredictiveState(self.believed_first(measurement), (nothing, nothing), plan)

    def step(
        self, state: PredictiveState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[PredictiveState, Pair]:
        angle = measurement.angle
        beliefs, model = self.believed(state.beliefs, setpoint, measurement, period)
        motion, pressures, course = beliefs.motion, beliefs.pressures, beliefs.course
        fresh = 1 - exp(-jnp.asarray(period) / _REMEMBERED)
        along, moving = state.swing
        along = along + fresh * (course.jerk * course.velocity - along)
        moving = moving + fresh * (course.velocity**2 - moving)

        look = functools.partial(surroundings, model, minimum_tension=self.minimum_tension)
        around = apart(look, angle, pressures, witness=period)
        other = motion.disturbance + beliefs.friction / self.load.total_inertia
        duration = jnp.maximum(jnp.asarray(self.horizon) / self.stages, period)
        outlook = self._outlook(
            around, angle, other, course, -along / (moving + _STILL), setpoint.stiffness, duration, period
        )

        # The state now, as errors against the wish, in units of the outlook.
        unit, pole = jnp.asarray(self.angle_scale), jnp.asarray(self.bandwidth)
        _, velocity, acceleration, _ = outlook.wish
        known = self.acceleration(angle, motion.velocity, beliefs.torque)
        start = (
            (angle - setpoint.angle) / unit,
            motion.velocity / (pole * unit) - velocity,
            (known + other) / (pole**2 * unit) - acceleration,
            (beliefs.estimate - setpoint.stiffness) / self.stiffness_scale,
        )
        here = pressures[0] / bar, pressures[1] / bar
        plan = later(state.plan, jnp.minimum(period / duration, 1.0))
        plan, ((next1, next2), held) = planned(outlook, start, here, plan, self.iterations)

        commands = self.held(
            (
                bar * (here[0] + (next1 - here[0]) / outlook.share),
                bar * (here[1] + (next2 - here[1]) / outlook.share),
            )
        )
        return PredictiveState(beliefs._replace(commands=commands, saturated=held), (along, moving), plan), commands

    def telemetry(self, state: PredictiveState) -> dict[str, Scalar]:
        return self.told(state.beliefs)

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

    def _stage(self, duration: Scalar) -> tuple[Scalar, Pair]:
        """That of a stage [s], and how early in it the pressures change: see `Outlook`."""
        share, lag = self.share(duration), jnp.asarray(self.valve_time_constant)
        ratio = duration / jnp.where(lag > 0, lag, duration / 10)
        series = ratio / 12 - ratio**3 / 720
        even = ratio < _EVEN
        once, twice = 1 / share - 1 / ratio, (1 - 2 / ratio) / share + 2 / ratio**2
        first, second = jnp.where(even, 0.5 + series, once), jnp.where(even, 1 / 3 + series + ratio**2 / 360, twice)
        return share, (jnp.where(lag > 0, first, 1.0), jnp.where(lag > 0, second, 1.0))
