"""Computed torque with the stiffness of all joints: pressures of all muscles by a bounded quadratic program."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Sequence
from typing import Annotated, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import AirVolume, air_volumes, delay_periods
from mckibben.component.base import Inherited
from mckibben.component.columns import Label
from mckibben.control.base import Setpoint, ValveModel
from mckibben.control.bounded_allocation import BoundedSolution, allocate_pairs, bounded_least_squares
from mckibben.control.feedback import Feedback
from mckibben.control.model_based import Valves, mean_commands
from mckibben.control.observer import ExtendedStateObserver, MotionEstimate, Observer, PressureObserver
from mckibben.control.reference import ReferenceDerivatives
from mckibben.control.robot_control import RobotController
from mckibben.errors import RangeError
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.dynamics import joint_equations
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.terms import joint_terms
from mckibben.muscle import SpringLaw
from mckibben.numerics.elementary import exp, floating
from mckibben.numerics.spatial import total
from mckibben.statics.posture import check_affine
from mckibben.units import CommandDelay, Force, Gravity, bar

Scalar = Float[Array, ""]

_TORQUE = 30.0  # weight of the torques, relative to the errors of the stiffness
_CENTRED = 1e-3  # weight of the distance from the middle of the range, which selects among equal solutions


class ComputedTorqueState(NamedTuple):
    """Estimates of the motion and of the valves, the references so far, and the last allocation."""

    motions: tuple[MotionEstimate, ...]
    derivatives: tuple[ReferenceDerivatives, ...]
    feedback: tuple[PyTree, ...]
    pressures: tuple[Scalar, ...]
    valves: tuple[PyTree, ...]
    sent: tuple[tuple[Scalar, ...], ...]  # commands on their way [Pa], the last first
    allocation: BoundedSolution
    stiffness: tuple[Scalar, ...]  # of the model [N*m/rad]


class _Coming(NamedTuple):
    """Motion, pressures and valves at a sample, or predicted at the arrival of the next commands."""

    angles: tuple[Scalar, ...]
    velocities: tuple[Scalar, ...]
    pressures: tuple[Scalar, ...]
    valves: tuple[PyTree, ...]


class ComputedTorque(RobotController):
    r"""Computed torque, and the stiffness of all joints, by the pressures of all muscles.

    The torques for the accelerations of references and feedback follow from a model of the robot, with its base at rest
    and its foot in the air,

    .. math:: \tau = M(q)\,(\ddot q_r + a(e, \dot e) - \hat d) + h(q, \dot q) + c\,\dot q

    at the angles to be expected after the lag T of the feedback. Torques T p + t and stiffness K p + k of the joints
    are affine in the pressures of taut muscles, and the pressures those of

    .. math:: \min_p\; W^2 \| T p + t - \tau \|^2 + \sum_i \Big( \frac{K_i p + k_i}{K_{r,i}} - 1 \Big)^2,
              \qquad \underline p \le p \le \overline p

    with muscles taut, below their ratings, and within what the valves reach; torques have priority by their weight. An
    active set is continued from period to period. ``allocation_gap`` is a certificate: no pressures have errors whose
    sum of squares is smaller by more. Where the muscles are a pair of each joint, their pressures follow in closed
    form, as those of `DecouplingControl`. Laws are affine in pressure, and tendons rigid.

    Parameters
    ----------
    feedback
        Outer loop of each joint: `PolePlacement` or `SlidingMode`.
    observer, pressure_observer
        Observers of the motion of each joint with its disturbance, and of the pressures.
    robot, valve, gravity, command_delay
        Models of robot and valves, g [m/s^2], and delay of the commands [s] over which the motion is predicted; in a
        file, by default, those of the plant. No joint is locked.
    minimum_tension
        Lower limit of each muscle's tension [N].
    impedance
        Whether each joint is a critically damped spring of its stiffness about its reference, for contact (Hogan 1985),
        in place of feedback that rejects every disturbance.

    References
    ----------
    J. Y. S. Luh, M. W. Walker and R. P. C. Paul, Resolved-acceleration control of mechanical manipulators, IEEE Trans.
    Automatic Control 25, 1980 (computed torque); O. Harkegard, Efficient active set algorithms for solving constrained
    least squares problems in aircraft control allocation, CDC 2002.
    """

    short_name = "computed_torque"
    telemetry_labels: ClassVar = {
        "allocation_gap": Label("1", "bound on the squared error of torques and stiffness above the least possible"),
    }

    feedback: Feedback
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()
    robot: Annotated[Robot, Inherited(lambda scope: scope["robot"])] = eqx.field(kw_only=True)
    valve: ValveModel = eqx.field(kw_only=True)
    command_delay: Annotated[CommandDelay | None, Inherited(lambda scope: scope.get("command_delay"))] = eqx.field(
        kw_only=True, default=None
    )
    gravity: Gravity = eqx.field(kw_only=True, default=9.81)
    minimum_tension: Force = eqx.field(kw_only=True, default=5.0)
    impedance: bool = eqx.field(kw_only=True, default=False, static=True)
    periods: int = eqx.field(kw_only=True, default=0, static=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_affine(self.robot)
        for joint in self.robot.joints:
            if joint.locked is not None:
                remedy = "unlock it, or give each joint its own of `controllers`"
                raise RangeError(f"{joint.name} is locked", field="robot", value=joint.name, remedy=remedy)
        if not (self.valve.holds_air or self.valve.lag is not None):
            remedy = "give the controller a `valve` with a time_constant"
            raise RangeError("the response of the valve is unknown", field="valve", remedy=remedy)

    def with_period(self, period: float) -> Self:
        prepared = super().with_period(period)
        if self.command_delay is None:
            return prepared
        return dataclasses.replace(prepared, periods=delay_periods(self.command_delay, period))

    def init(self, measurement: RobotMeasurement) -> ComputedTorqueState:
        angles, pressures = tuple(map(floating, measurement.angles)), tuple(map(floating, measurement.pressures))
        zero = jnp.zeros_like(angles[0])
        still = (zero,) * len(angles)
        known = self._accelerations(angles, still, pressures, 0.0)
        terms = joint_terms(self.robot, angles)
        return ComputedTorqueState(
            tuple(map(self.observer.init, angles, known)),
            tuple(map(ReferenceDerivatives.init, angles)),
            tuple(map(self.feedback.init, still)),
            pressures,
            tuple(self.valve.for_muscle(i).init_model(pressure) for i, pressure in enumerate(pressures)),
            (pressures,) * (self.periods + 1),
            BoundedSolution(tuple(pressure / bar for pressure in pressures), (zero,) * len(pressures), zero),
            terms.stiffness_at(pressures),
        )

    def step(
        self,
        state: ComputedTorqueState,
        setpoint: Sequence[Setpoint],
        measurement: RobotMeasurement,
        period: ArrayLike,
    ) -> tuple[ComputedTorqueState, tuple[Array, ...]]:
        lag = self.feedback.lag
        lead = period / (1 - exp(-jnp.asarray(period) / lag))  # with which sampled pressures follow a ramp exactly
        now, motions = self._updated(state, measurement, period)
        derivatives = tuple(of.update(own.angle, period) for of, own in zip(state.derivatives, setpoint, strict=True))
        coming, ahead = now, derivatives
        if self.command_delay is not None:
            coming = self._predicted(now, motions, state.sent, period)
            ahead = tuple(of.after(self.command_delay) for of in derivatives)
        expected = tuple(angle + lead * rate for angle, rate in zip(coming.angles, coming.velocities, strict=True))
        made = joint_equations(self.robot, expected, coming.velocities, self.gravity)
        terms = joint_terms(self.robot, expected)
        valves = self._valves(coming)
        lower, upper, swings = self._window(terms.tension, valves, period)
        torques, feedback = list(made.bias), []
        for i, (reference, own) in enumerate(zip(ahead, setpoint, strict=True)):
            error, rate = reference.angle - coming.angles[i], reference.velocity - coming.velocities[i]
            torque_rate = sum(jnp.abs(gain) * swings[m] for m, (_, gain) in terms.torque[i].items()) / (2 * lag)
            jerk = torque_rate / (2 * made.matrix[i][i])  # half of it is for the feedback
            held, correction = self.feedback.step(state.feedback[i], error, rate, jerk, period)
            feedback.append(held)
            acceleration = reference.acceleration_after(lead, period)
            if self.impedance:
                damping = 2 * jnp.sqrt(own.stiffness * made.matrix[i][i])
                torques[i] = torques[i] + own.stiffness * error + damping * rate
            else:
                acceleration = acceleration + correction - motions[i].disturbance
            torques[i] = torques[i] + self.robot.joints[i].damping * coming.velocities[i]
            torques = [torque + row[i] * acceleration for torque, row in zip(torques, made.matrix, strict=True)]
        stiffness = [own.stiffness for own in setpoint]
        if self.robot.has_disjoint_pairs:
            springs = [self.robot.pair(joint).springs for joint in range(len(torques))]
            allocation = allocate_pairs(terms, torques, stiffness, lower, upper, springs)
        else:
            allocation = bounded_least_squares(
                *terms.errors(torques, stiffness, _TORQUE, _CENTRED, lower, upper),
                tuple(limit / bar for limit in lower),
                tuple(limit / bar for limit in upper),
                state.allocation,
            )
        targets = tuple(value * bar for value in allocation.values)
        short = [wanted - given for wanted, given in zip(torques, terms.torque_at(targets), strict=True)]
        feedback = [
            self.feedback.track(held, torque / made.matrix[i][i], period)
            for i, (held, torque) in enumerate(zip(feedback, short, strict=True))
        ]
        commands = valves.commands_toward(targets, lag, period)
        return ComputedTorqueState(
            motions,
            derivatives,
            tuple(feedback),
            now.pressures,
            now.valves,
            (commands, *state.sent[: self.periods]),
            allocation,
            terms.stiffness_at(now.pressures),
        ), commands

    def telemetry(self, state: ComputedTorqueState) -> dict[str, PyTree]:
        muscles = zip(self.robot.all_muscles, state.allocation.active, strict=True)
        held = [active for muscle, active in muscles if not isinstance(muscle.law, SpringLaw)]
        return {
            "stiffness_estimate": state.stiffness,
            "disturbance_estimate": tuple(motion.disturbance for motion in state.motions),
            "allocation_gap": state.allocation.gap,
            "saturated": functools.reduce(operator.or_, [one != 0 for one in held]),
        }

    def _accelerations(
        self, angles: Sequence[Array], rates: Sequence[Array], pressures: Sequence[Array], period: ArrayLike
    ) -> tuple[Array, ...]:
        """Mean accelerations [rad/s^2] of the joints by the model in a time [s]; damping is that at its end."""
        made = joint_equations(self.robot, angles, rates, self.gravity)
        torques = self.robot.torques(angles, pressures)
        driven, damped = [], [list(row) for row in made.matrix]
        for i, (torque, joint, rate) in enumerate(zip(torques, self.robot.joints, rates, strict=True)):
            driven.append(torque - joint.damping * rate)
            damped[i][i] = total(damped[i][i], joint.damping * period)
        return tuple(made._replace(matrix=damped).accelerations(driven))

    def _updated(
        self, state: ComputedTorqueState, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[_Coming, tuple[MotionEstimate, ...]]:
        """Estimates after a further sample."""
        rates = tuple(motion.velocity for motion in state.motions)
        age = 0.0 if self.command_delay is None else self.command_delay / jnp.asarray(period)
        arrived = mean_commands(state.sent, age, age + 1) if self.periods else state.sent[0]
        last = _Coming(tuple(measurement.angles), rates, state.pressures, state.valves)
        pressures, valves = self._valves(last).predict(arrived, period)
        pressures = self.pressure_observer.step(pressures, measurement.pressures, period)
        known = self._accelerations(measurement.angles, rates, pressures, period)
        motions = tuple(
            self.observer.step(motion, angle, acceleration, period)
            for motion, angle, acceleration in zip(state.motions, measurement.angles, known, strict=True)
        )
        angles = tuple(motion.angle for motion in motions)
        return _Coming(angles, tuple(motion.velocity for motion in motions), pressures, valves), motions

    def _valves(self, at: _Coming) -> Valves:
        """Model of the valves at an estimate."""
        air: Sequence[AirVolume | None] = (None,) * len(at.pressures)
        if self.valve.holds_air:
            dead = [self.valve.for_muscle(i).attached_volume for i in range(len(at.pressures))]
            air = air_volumes(self.robot.routed_muscles(at.angles), at.velocities, at.pressures, dead_volumes=dead)
        muscles = enumerate(self.robot.all_muscles)
        ranges = [self.valve.for_muscle(i).command_range(muscle.domain) for i, muscle in muscles]
        return Valves(self.valve, at.pressures, at.valves, air, tuple(zip(*ranges, strict=True)))

    def _predicted(
        self,
        now: _Coming,
        motions: Sequence[MotionEstimate],
        sent: tuple[tuple[Scalar, ...], ...],
        period: ArrayLike,
    ) -> _Coming:
        """Motion and pressures when the next commands arrive."""
        steps = max(self.periods, 1)
        late = jnp.asarray(self.command_delay)
        delay, step = late / period, late / steps
        means = [mean_commands(sent, delay * (1 - (k + 1) / steps), delay * (1 - k / steps)) for k in range(steps)]

        def advance(at: _Coming, commands: Sequence[Array]) -> tuple[_Coming, None]:
            following, valves = self._valves(at).predict(commands, step)
            middle = tuple((one + other) / 2 for one, other in zip(at.pressures, following, strict=True))
            midway = tuple(angle + step / 2 * rate for angle, rate in zip(at.angles, at.velocities, strict=True))
            rates = [
                own + motion.disturbance
                for own, motion in zip(self._accelerations(midway, at.velocities, middle, step), motions, strict=True)
            ]
            angles = tuple(
                angle + step * (velocity + step / 2 * rate)
                for angle, velocity, rate in zip(at.angles, at.velocities, rates, strict=True)
            )
            velocities = tuple(v + step * rate for v, rate in zip(at.velocities, rates, strict=True))
            return _Coming(angles, velocities, following, valves), None

        return lax.scan(advance, now, tuple(jnp.stack(side) for side in zip(*means, strict=True)))[0]

    def _window(
        self, tension: Sequence[tuple[PyTree, PyTree]], valves: Valves, period: ArrayLike
    ) -> tuple[tuple[Array, ...], tuple[Array, ...], list[ArrayLike]]:
        """Limits of the pressures [Pa]: taut, rated and within reach of the valves; and widths of that reach."""
        covered = 1 - exp(-jnp.asarray(period) / self.feedback.lag)
        lower, upper, swings = [], [], []
        muscles = zip(self.robot.all_muscles, tension, valves.pressures, valves.attainable(period), strict=True)
        for (muscle, (offset, gain), pressure, reach), least, most in zip(muscles, *valves.commands, strict=True):
            if isinstance(muscle.law, SpringLaw):
                lower.append(jnp.zeros_like(pressure))
                upper.append(jnp.zeros_like(pressure))
                swings.append(0.0)
                continue
            slowest, fastest = ((limit - pressure) / covered for limit in reach(pressure))
            rated = (muscle.specimen.force_limit - offset) / gain
            high = jnp.minimum(jnp.minimum(rated, most), pressure + fastest)
            low = jnp.maximum((self.minimum_tension - offset) / gain, muscle.domain.pressure_min)
            upper.append(jnp.maximum(high, least))
            lower.append(jnp.minimum(jnp.maximum(low, pressure + slowest), upper[-1]))
            swings.append(fastest - slowest)
        return tuple(lower), tuple(upper), swings
