"""Model predictive control of angle and stiffness within the attainable set."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated, NamedTuple, Self, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import Attainable, lag_fraction
from mckibben.control.allocation import keep_taut, linearise, pressure_range
from mckibben.control.base import Measurement, Setpoint
from mckibben.control.cost import StageCost, StageEnd
from mckibben.control.ddp import HorizonProblem, Policy, Quadratic, State, constant, extrapolate, shift, solve
from mckibben.control.model_based import Estimates, ModelBasedControl, Valves
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.control.reference import ReferenceDerivatives
from mckibben.errors import ParameterError
from mckibben.joint import AffineMap, AntagonisticJoint, TorqueStiffnessMap
from mckibben.joint.attainable import is_affine
from mckibben.joint.geometry import Pair
from mckibben.numerics.calculus import derivative, value_and_derivative
from mckibben.numerics.compiled import cached_trace
from mckibben.numerics.elementary import exp, floating
from mckibben.units import AngleScale, Bandwidth, BoundedInt, Count, PoleDamping, PositiveTime, StiffnessScale, bar, deg

Iterations = Annotated[int, BoundedInt(1, 100)]

Scalar = Float[Array, ""]

_FREQUENCY_MEMORY = 0.1  # s: time constant of the estimate of the reference's frequency
_STILL = 1e-6  # rad^2/s^2, on a hinge: a slower reference has no frequency
_SERIES = 0.3  # stage over valve time constant: below it the hold weights are a series
_RAMP = 1e3  # stages: a lag with which pressures change linearly within a stage
_AT_ONCE = 1e-3  # stages: a lag with which a pressure is at its target at the end of the stage
_ANGLE_STEP = 0.02  # rad, on a hinge: of the finite differences of the local model


class ComingReference(NamedTuple):
    """Known samples of the reference and its derivatives, the next first; leaves of shape (samples_ahead + 1,)."""

    angle: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    stiffness: Array

    def at(self, samples: int | slice, delay: ArrayLike, period: ArrayLike) -> ReferenceDerivatives:
        """Derivatives at some samples, of which the first is the last one within a delay [s], or a little later."""
        first = samples.start if isinstance(samples, slice) else samples
        angle, velocity, acceleration, jerk = (signal[samples] for signal in self[:4])
        there = ReferenceDerivatives(angle, velocity, acceleration, jerk, jnp.full_like(angle, 3.0))
        return there.after(delay - first * jnp.asarray(period))


class PredictiveState(NamedTuple):
    """Estimates, moving averages of the reference, and the policy over the horizon (pressures in bar)."""

    estimates: Estimates
    averages: Pair  # of jerk times velocity and of squared velocity; minus their ratio is the squared frequency
    policy: Policy


class PredictiveControl(ModelBasedControl[PredictiveState]):
    r"""Model predictive control: the trajectory of least cost within the attainable set.

    In each period the cost over the next `horizon` is minimised and the first command applied:

    .. math::

        \int \frac{1}{\theta_s^2} \Big(e^2 + d(d - 2)\Big(\frac{\dot e^2}{\omega_c^2}
        + \frac{\ddot e^2}{\omega_c^4}\Big) + \frac{\dddot e^2}{\omega_c^6}\Big)
        + \frac{1}{K_s^2} \Big((K - K_r)^2 + \frac{\dot K^2}{\omega_K^2}\Big) \, dt, \quad e = \theta - \theta_r

    The prediction model has torque and stiffness affine in the pressures (for other laws the secant) and to second
    order in the angle, and valves of first order; stiffness and disturbance are constant.

    Without active limits this is, up to the duration of a stage and for any horizon, the decoupled linear loop

    .. math:: \dddot e + d\,\omega_c \ddot e + d\,\omega_c^2 \dot e + \omega_c^3 e = 0, \quad
              \dot K = \omega_K (K_r - K)

    The solver is `mckibben.control.ddp`.

    Parameters
    ----------
    model, load, pressure_observer, valve, minimum_tension, friction_compensation
        As for `DecouplingControl`, and so is `stiffness_amplitude`.
    command_delay
        Delay of the commands [s] that the prediction assumes, as for `DecouplingControl`.
    observer
        `ExtendedStateObserver`, or `VelocityObserver`, which leaves the static error of a wrong model.
    bandwidth, stiffness_bandwidth
        omega_c of the angle and omega_K of the stiffness [rad/s].
    damping
        d, from 2 (Butterworth poles of the angle: fast, with 8 % of overshoot) to 3 (a triple pole: no overshoot, and
        robust to slower valves).
    angle_scale, stiffness_scale
        Errors of equal weight: theta_s [rad] and K_s [N*m/rad]. Only their ratio counts.
    horizon
        Prediction horizon [s].
    preview
        Whether the reference is known over delay and horizon: the setpoint of a step is then that `samples_ahead`
        control periods later. Default: the reference is extrapolated.
    cost
        Cost of the stages in addition to that of the errors. Default: none.
    stages
        Stages of the horizon; a stage is never shorter than the control period.
    iterations
        Newton steps per period.

    References
    ----------
    Y. Tassa, N. Mansard and E. Todorov, Control-limited differential dynamic programming, ICRA 2014; the cost at the
    end of the horizon after D. Q. Mayne et al., Constrained model predictive control: stability and optimality,
    Automatica 36, 2000.
    """

    short_name = "predictive"

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
    preview: bool = eqx.field(kw_only=True, static=True, default=False)
    cost: StageCost | None = eqx.field(kw_only=True, default=None)
    samples_ahead: int = eqx.field(kw_only=True, static=True, default=0)
    lead: int = eqx.field(kw_only=True, static=True, default=0)  # control periods within the delay

    def with_period(self, period: float) -> Self:
        prepared = super().with_period(period)
        if not self.preview:
            return prepared
        shortest, longest = (float(reduce(self.horizon)) for reduce in (np.min, np.max))
        if shortest < longest:
            raise ParameterError(
                "PredictiveControl: with preview all runs have one horizon",
                field="horizon",
                remedy="simulate runs of another horizon separately",
            )
        stride = max(round(longest / self.stages / period), 1)
        lead = self.whole_periods(period)
        return dataclasses.replace(prepared, lead=lead, samples_ahead=lead + stride * self.stages)

    def init(self, measurement: Measurement) -> PredictiveState:
        zero = jnp.zeros_like(measurement.angle)
        pressure1, pressure2 = measurement.pressures
        policy = constant((pressure1 / bar, pressure2 / bar), self.stages)
        return PredictiveState(self.init_estimates((measurement.angle,), measurement.pressures), (zero, zero), policy)

    def init_coming(self, angle: Scalar, stiffness: Scalar) -> PyTree:
        constant = jnp.zeros(self.samples_ahead + 1)
        held = ComingReference(*(constant for _ in ComingReference._fields))
        return held._replace(angle=constant + angle, stiffness=constant + stiffness) if self.preview else ()

    def _follow(
        self, last: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, PyTree]:
        reference = last.update(setpoint.angle, period)
        if self.preview:
            newest = ComingReference(*reference[:4], setpoint.stiffness)
            coming = jax.tree.map(lambda samples, value: jnp.append(samples[1:], value), coming, newest)
        return reference, coming

    def _at_arrival(
        self, reference: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, Setpoint]:
        if not self.preview:
            return super()._at_arrival(reference, coming, setpoint, period)
        now = coming.at(self.lead, self._delay, period)
        return now, Setpoint(now.angle, coming.stiffness[self.lead])

    def step(
        self, state: PredictiveState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[PredictiveState, Pair]:
        angles, measured = (measurement.angle,), measurement.pressures
        estimates, expected = self.update(state.estimates, (setpoint,), angles, measured, period)
        (setpoint,), (angle,), ahead, valves = expected
        ahead = ahead.of_joint()
        reference = ahead.reference
        if self._is_alone:  # its stiffness is what the angle determines
            setpoint = setpoint._replace(stiffness=ahead.stiffness)
        new = 1 - exp(-jnp.asarray(period) / _FREQUENCY_MEMORY)
        jerk_velocity, velocity_sq = state.averages
        jerk_velocity = jerk_velocity + new * (reference.jerk * reference.velocity - jerk_velocity)
        velocity_sq = velocity_sq + new * (reference.velocity**2 - velocity_sq)
        frequency_sq = -jerk_velocity / (velocity_sq + _STILL * self.model.joint_type.scale**2)

        local = local_model(self.model, angle, ahead.pressures, minimum_tension=self.minimum_tension)
        stage = jnp.maximum(jnp.asarray(self.horizon) / self.stages, period)
        if self.preview:
            stage = (self.samples_ahead - self.lead) // self.stages * jnp.asarray(period)
        problem = self._problem(
            local, ahead, valves, angle, frequency_sq, setpoint.stiffness - ahead.added_stiffness, stage, period
        )

        pressures = ahead.pressures[0] / bar, ahead.pressures[1] / bar
        policy = shift(state.policy, jnp.minimum(period / stage, 1.0))
        errors = self._errors(problem, ahead, angle, setpoint)
        policy, first = solve(problem, errors, pressures, policy, self.iterations)

        target1, target2 = first.pressures
        commands = valves.commands_toward((bar * target1, bar * target2), _AT_ONCE * stage, stage)
        limited = [limit for limit, spring in zip(first.limited, self.model.springs, strict=True) if not spring]
        estimates = estimates._replace(sent=(commands, *estimates.sent[:-1]), saturated=limited[0] | limited[-1])
        return PredictiveState(estimates, (jerk_velocity, velocity_sq), policy), commands

    @property
    def _is_alone(self) -> bool:
        """Whether one muscle controls the angle alone."""
        return any(self.model.springs)

    def telemetry(self, state: PredictiveState) -> dict[str, Scalar]:
        return self.estimates_telemetry(state.estimates)

    def _errors(
        self, problem: HorizonProblem, estimates: PyTree, angle: Scalar, setpoint: Setpoint
    ) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """State of the problem now: errors of angle, velocity, acceleration and stiffness over their scales."""
        unit, pole = jnp.asarray(self.angle_scale), jnp.asarray(self.bandwidth)
        motion, (_, velocity, acceleration, _) = estimates.motion, (signal[0] for signal in problem.reference)
        modelled = self.load.acceleration(angle, motion.velocity, estimates.torque + estimates.friction)
        return (
            (angle - setpoint.angle) / unit,
            motion.velocity / (pole * unit) - velocity,
            (modelled + motion.disturbance) / (pole**2 * unit) - acceleration,
            (estimates.stiffness - setpoint.stiffness) / self.stiffness_scale,
        )

    def _problem(
        self,
        local: LocalModel,
        estimates: PyTree,
        valves: Valves,
        angle: Scalar,
        frequency_sq: Scalar,
        stiffness: ArrayLike,
        stage: Scalar,
        period: ArrayLike,
    ) -> HorizonProblem:
        """Optimal control problem over the horizon: time in 1/omega_c, errors in their scales, pressures in bar."""
        unit, pole = jnp.asarray(self.angle_scale), jnp.asarray(self.bandwidth)
        per_stiffness = 1 / jnp.asarray(self.stiffness_scale)
        per_acceleration = 1 / (pole**2 * unit)
        zero, stages = jnp.zeros_like(angle), self.stages

        # Eq. 6 is affine in torque and velocity.
        gravity, gravity_slope, gravity_curvature = _second_order(
            lambda at: self.load.acceleration(at, zero, zero), angle
        )
        per_torque = per_acceleration * derivative(lambda torque: self.load.acceleration(angle, zero, torque), zero)
        drag = -derivative(lambda velocity: self.load.acceleration(angle, velocity, zero), zero) / pole
        offset, by_pressure1, by_pressure2 = (
            Quadratic(
                per_torque * size * torque,
                -per_torque * size * unit * torque_stiffness,
                -per_torque * size * unit**2 * stiffness_slope,
            )
            for size, torque, torque_stiffness, stiffness_slope in zip(
                (1.0, bar, bar), local.torque, local.torque_stiffness, local.stiffness_slope, strict=True
            )
        )
        free = gravity + per_torque / per_acceleration * estimates.friction + estimates.motion.disturbance
        acceleration = Quadratic(
            offset.value + per_acceleration * free,
            offset.slope + per_acceleration * unit * gravity_slope,
            offset.curvature + per_acceleration * unit**2 * gravity_curvature,
        )
        offset, stiffness1, stiffness2 = (
            Quadratic(per_stiffness * size * value, per_stiffness * size * unit * slope)
            for size, value, slope in zip((1.0, bar, bar), local.stiffness, local.stiffness_slope, strict=True)
        )
        stiffness_error = offset._replace(value=offset.value - per_stiffness * stiffness)
        if self._is_alone:
            # The stiffness has no share in the cost. A spring's pressure, which its limits set to 0, has one: without
            # it the problem would be singular.
            stiffness_error = Quadratic(zero, zero)
            stiffness1, stiffness2 = (Quadratic(zero + float(spring), zero) for spring in self.model.springs)

        def limits(values: Pair, slopes: Pair) -> tuple[Quadratic, Quadratic]:
            return Quadratic(values[0] / bar, unit * slopes[0] / bar), Quadratic(
                values[1] / bar, unit * slopes[1] / bar
            )

        reach1, reach2 = (
            Attainable(reach.keep, reach.lower / bar, reach.upper / bar) for reach in valves.attainable(stage)
        )
        ramp = _RAMP * stage if valves.model.lag is None else valves.model.lag

        def scaled(reference: ReferenceDerivatives) -> State:
            # Backward differences lag by one period, their velocity by half of one.
            now = reference.acceleration_after(0.0, period)
            return (
                (reference.angle - angle) / unit,
                (reference.velocity + period / 2 * now) / (pole * unit),
                per_acceleration * now,
                reference.jerk / (pole**3 * unit),
            )

        if self.preview:
            each = slice(self.lead, None, (self.samples_ahead - self.lead) // stages)
            reference = scaled(estimates.coming.at(each, self._delay, period))
            setpoints = per_stiffness * (estimates.coming.stiffness[each] - estimates.coming.stiffness[self.lead])
            setpoints = jnp.zeros_like(setpoints) if self._is_alone else setpoints
        else:
            frequency_sq = jnp.clip(frequency_sq, 0.0, (jnp.pi / (stages * stage)) ** 2) / pole**2
            reference = extrapolate(scaled(estimates.reference), pole * stage, frequency_sq, stages)
            setpoints = jnp.zeros_like(reference[0])

        def residuals(y: State, pressures: Pair, reference: State, change: Scalar) -> tuple[Scalar, ...]:
            isobaric = jnp.asarray(stiffness) + change / per_stiffness
            there = StageEnd(
                angle + unit * (reference[0] + y[0]),
                pole * unit * (reference[1] + y[1]),
                (reference[2] + y[2]) / per_acceleration,
                isobaric + y[3] / per_stiffness,
                (bar * pressures[0], bar * pressures[1]),
                Setpoint(angle + unit * reference[0], isobaric),
            )
            return cast(StageCost, self.cost).residuals(there)

        return HorizonProblem(
            stage=pole * stage,
            hold_weights=_hold(floating(ramp), stage),
            damping=jnp.asarray(self.damping),
            bandwidth_ratio_sq=(pole / self.stiffness_bandwidth) ** 2,
            acceleration=(acceleration, by_pressure1, by_pressure2),
            stiffness=(stiffness_error, stiffness1, stiffness2),
            drag=drag,
            reference=reference,
            setpoints=setpoints,
            pressure_lower=limits(local.lowest, local.lowest_slope),
            pressure_upper=limits(local.highest, local.highest_slope),
            attainable=(reach1, reach2),
            residuals=None if self.cost is None else residuals,
        )


def _hold(lag: Scalar, stage: Scalar) -> Pair:
    """Hold weights of a stage [s], for a time constant [s] of the valves: see `HorizonProblem`."""
    fraction = lag_fraction(lag, stage)
    ratio = stage / jnp.where(lag > 0, lag, stage / 10)
    series = ratio / 12 - ratio**3 / 720
    slow = ratio < _SERIES
    first = jnp.where(slow, 0.5 + series, 1 / fraction - 1 / ratio)
    second = jnp.where(slow, 1 / 3 + series + ratio**2 / 360, (1 - 2 / ratio) / fraction + 2 / ratio**2)
    return jnp.where(lag > 0, first, 1.0), jnp.where(lag > 0, second, 1.0)


def _second_order(function: Callable[[Array], Array], x: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Value and first two derivatives."""
    (value, slope), (_, curvature) = value_and_derivative(lambda at: value_and_derivative(function, at), x)
    return value, slope, curvature


class LocalModel(NamedTuple):
    """Expansion of a joint's model about an angle [rad], affine in the pressures [Pa]."""

    torque: AffineMap  # of taut muscles [N*m]
    torque_stiffness: AffineMap  # minus its slope over the angle [N*m/rad]
    stiffness: AffineMap  # [N*m/rad]
    stiffness_slope: AffineMap  # over the angle [N*m/rad^2]
    lowest: Pair
    highest: Pair
    lowest_slope: Pair
    highest_slope: Pair


@cached_trace
def local_model(model: AntagonisticJoint, angle: Scalar, pressures: Pair, *, minimum_tension: ArrayLike) -> LocalModel:
    """Local model about an angle [rad] and pressures [Pa], with limits that keep a tension [N]."""

    def at(angle: Scalar) -> tuple[TorqueStiffnessMap, Pair, Pair]:
        lowest, highest = pressure_range(model, angle, minimum_tension)
        return linearise(model, angle, keep_taut(pressures, lowest)), lowest, highest

    step = _ANGLE_STEP * model.joint_type.scale
    both = lax.map(at, jnp.stack([angle, angle + step]))  # a loop: half of the code to compile
    (torque, stiffness), lowest, highest = jax.tree.map(lambda values: values[0], both)
    (_, stiffness_slope), *limit_slopes = jax.tree.map(lambda values: (values[1] - values[0]) / step, both)
    torque_stiffness = stiffness
    if not is_affine(model):  # a secant across the stop of a spring does not hold at other pressures
        zero = jnp.zeros_like(angle)
        torque_stiffness = AffineMap(stiffness(keep_taut(pressures, lowest)), zero, zero)
        stiffness_slope = AffineMap(zero, zero, zero)
    return LocalModel(torque, torque_stiffness, stiffness, stiffness_slope, lowest, highest, *limit_slopes)
