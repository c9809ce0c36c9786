"""State estimation, and prediction over the delay of the commands, shared by the controllers with a model."""

# No `from __future__ import annotations`: equinox does not see an AbstractVar written as text.

import abc
import dataclasses
import functools
import math
import operator
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator import Actuator, AirVolume, FirstOrderValve
from mckibben.actuator.base import Point, air_volumes, delay_periods
from mckibben.component.base import Inherited
from mckibben.component.columns import Label
from mckibben.control.base import (
    Controller,
    DiscreteTimeSystem,
    JointModel,
    LoadModel,
    Setpoint,
    State,
    ValveModel,
    check_valve_model,
)
from mckibben.control.mechanics import HingeMechanics, Mechanics, Scalars
from mckibben.control.observer import MotionEstimate, Observer, PressureObserver
from mckibben.control.reference import ReferenceDerivatives
from mckibben.errors import ParameterError, RangeError
from mckibben.joint.route import init_states, update_states
from mckibben.muscle import MuscleState
from mckibben.muscle.friction import FrictionState
from mckibben.numerics.elementary import floating
from mckibben.units import AngleScale, CommandDelay, Force, Percent, ms

Scalar = Float[Array, ""]

_LEAST_STEPS, _LONGEST_STEP = 2, 4 * ms  # of the prediction
_ROUNDING = 1e-9  # steps

FrictionShare = Annotated[float, Percent("1", "%", 0, 100)]


class Valves(NamedTuple):
    """Model of the valves at their estimated pressures [Pa] and states, and the range of their commands [Pa].

    Tuples are over muscles.
    """

    model: Actuator
    pressures: Any
    states: Any
    air: Sequence[AirVolume | None]
    commands: Any

    def predict(self, commands: Sequence[ArrayLike], duration: ArrayLike) -> tuple[Any, Any]:
        """Return the pressures [Pa] and states a time [s] later, under constant commands [Pa]."""
        predicted = [valve.predict(at, command, duration) for valve, at, command in self._muscles(commands)]
        return tuple(pressure for pressure, _ in predicted), tuple(state for _, state in predicted)

    def attainable(self, duration: ArrayLike) -> Any:
        """Return the pressures that can be reached within a time [s]."""
        ranges = zip(*self.commands, strict=True)
        return tuple(valve.attainable(at, commands, duration) for valve, at, commands in self._muscles(ranges))

    def commands_toward(self, targets: Sequence[ArrayLike], lag: ArrayLike, period: ArrayLike) -> Any:
        """Return the commands [Pa] of a control period [s] that lead the pressures to targets [Pa] with a lag [s]."""
        commands = (valve.command_toward(at, target, lag, period) for valve, at, target in self._muscles(targets))
        return tuple(map(jnp.clip, commands, *self.commands))

    def _muscles(self, values: Iterable[Any]) -> Iterator[tuple[Actuator, Point, Any]]:
        """Actuator of each muscle, its state, and its value."""
        points = map(Point, self.pressures, self.states, self.air)
        for i, (at, value) in enumerate(zip(points, values, strict=True)):
            yield self.model.for_muscle(i), at, value


class SlipStates(NamedTuple):
    """Internal states of the friction of muscles and joints; () for those without."""

    muscles: tuple[MuscleState, ...] = ()
    joints: tuple[FrictionState, ...] = ()


class Estimates(NamedTuple):
    """Estimates at a sample, and the commands given then; tuples are over joints, or muscles."""

    motion: tuple[MotionEstimate, ...]
    pressures: Scalars
    reference: tuple[ReferenceDerivatives, ...]  # at the newest setpoints
    coming: tuple[PyTree, ...]  # what is known of the references ahead
    slips: SlipStates  # of the model, along the references
    moved: SlipStates  # of the model, along the estimated motion
    torque: Scalars  # of the model's muscles at the estimated pressures, without friction [N*m]
    stiffness: Scalars  # of the model, for the amplitude of the controller [N*m/rad]
    added_stiffness: Scalars  # minus the isobaric one [N*m/rad]
    friction: Scalars  # compensated torque [N*m]
    resistance: Scalars  # torque of the friction with which the motion is predicted [N*m]
    sent: tuple[Scalars, ...]  # commands on their way [Pa], the last first
    actuators: tuple[PyTree, ...]  # states of the model of the valves
    saturated: Array

    def of_joint(self) -> Any:
        """Return the estimates of a single joint, without tuples over joints."""
        over_muscles = {"pressures", "sent", "actuators", "saturated", "slips", "moved"}
        return self._replace(**{name: getattr(self, name)[0] for name in set(self._fields) - over_muscles})


class Expected(NamedTuple):
    """Predicted setpoints, angles and estimates at the arrival of the next commands, and the valves there."""

    setpoints: tuple[Setpoint, ...]
    angles: Scalars  # measured, or predicted over the delay
    estimates: Estimates
    valves: Valves


class _Motion(NamedTuple):
    angles: Scalars
    rates: Scalars
    pressures: Scalars
    actuators: tuple[PyTree, ...]


class StatePrediction(DiscreteTimeSystem[State]):
    r"""Base of controllers that estimate the state by a model of mechanics and valves, and predict it over a delay.

    A command arrives at the valves after the delay d. An observer estimates motion, pressures and disturbance from the
    measurement and the commands that have arrived; the model then predicts the motion and the pressures over d with the
    commands on their way and a constant disturbance, and the controller acts on these, with the setpoint of the angle
    extrapolated by the derivatives of its samples:

    .. math:: \theta_r(t + d) \approx \theta_r + d\,\dot\theta_r + \tfrac12 d^2\,\ddot\theta_r

    The delay need not be a multiple of the control period.

    References
    ----------
    O. J. M. Smith, A controller to overcome dead time, ISA Journal 6, 1959; with a state observer, so that disturbances
    and unstable loads are predicted too: A. Z. Manitius and A. W. Olbrot, Finite spectrum assignment problem for
    systems with delays, IEEE Trans. Automatic Control 24, 1979.
    """

    telemetry_labels: ClassVar = {
        "velocity_estimate": Label("rad/s", "controller's estimate of the angular velocity"),
        "disturbance_estimate": Label("N*m", "controller's estimate of the disturbance torque"),
        "friction_compensation": Label("N*m", "friction torque compensated by the controller"),
    }

    # Fields of controllers that compensate friction.
    friction_compensation = False
    friction_in_observer = None

    observer: eqx.AbstractVar[Observer]
    pressure_observer: eqx.AbstractVar[PressureObserver]
    valve: eqx.AbstractVar[Actuator]
    command_delay: eqx.AbstractVar[float | None]
    periods: int | None = eqx.field(kw_only=True, default=None, static=True)
    steps: int = eqx.field(kw_only=True, default=_LEAST_STEPS, static=True)
    if TYPE_CHECKING:  # of a `DelayCompensation` that of the inner controller
        stiffness_amplitude: Any

    def __check_init__(self) -> None:
        super().__check_init__()
        name, muscles = type(self).__name__, self.mechanics.muscles
        check_valve_model(name, self.valve, muscles)
        rough = any(muscle.has_friction for muscle in muscles) or any(self.mechanics.frictions)
        if self.friction_compensation and not rough:
            raise RangeError(
                f"{name}: no muscle of its model has friction to compensate",
                field="friction_compensation",
                remedy="give the model's muscles a MaxwellSlip, or leave friction_compensation out",
            )
        if self.friction_in_observer is not None and not self.friction_compensation:
            raise RangeError(
                f"{name}: friction_in_observer without friction_compensation; nothing would compensate the friction, "
                "which the estimated disturbance then leaves out",
                field="friction_in_observer",
                value=self.friction_in_observer,
                remedy="set friction_compensation too",
            )

    @property
    @abc.abstractmethod
    def mechanics(self) -> Mechanics:
        """Model of joints and muscles."""

    def with_period(self, period: float) -> Self:
        prepared = super().with_period(period)
        periods = delay_periods(self._delay, period, "controller.command_delay")
        steps = max(math.ceil(periods * period / _LONGEST_STEP - _ROUNDING), _LEAST_STEPS)
        return dataclasses.replace(prepared, periods=periods, steps=min(steps, periods))

    def whole_periods(self, period: float) -> int:
        """Control periods [s] within the delay, the shortest of several."""
        return math.floor(float(np.min(self._delay)) / period + _ROUNDING)

    @property
    def _delay(self) -> ArrayLike:
        """Delay of the commands [s], 0 for none."""
        return 0.0 if self.command_delay is None else self.command_delay

    @property
    def _periods(self) -> int:
        """Control periods that hold the commands on their way."""
        if self.periods is None and self.command_delay is not None:
            raise ParameterError(
                f"{type(self).__name__}: the control period is unknown, and with it the commands on their way",
                remedy="use controller.with_period(period)",
            )
        return self.periods or 0

    def init_estimates(self, angles: Sequence[ArrayLike], pressures: Sequence[ArrayLike]) -> Estimates:
        """Estimates before the first step, at rest at angles [rad] and pressures [Pa]."""
        angles, pressures = tuple(map(floating, angles)), tuple(map(floating, pressures))
        torque, stiffness, added = self._torque_and_stiffness(angles, pressures)
        still = (jnp.zeros_like(angles[0]),) * len(angles)
        modelled = self.mechanics.accelerations(angles, still, torque, 0.0)
        slips = self._init_slips(angles, pressures)
        return Estimates(
            motion=tuple(map(self.observer.init, angles, modelled)),
            pressures=pressures,
            reference=tuple(map(ReferenceDerivatives.init, angles)),
            coming=tuple(map(self.init_coming, angles, stiffness)),
            slips=slips,
            moved=SlipStates() if self.friction_in_observer is None else slips,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
            friction=still,
            resistance=still,
            sent=(pressures,) * (self._periods + 1),
            actuators=tuple(self.valve.for_muscle(i).init_model(pressure) for i, pressure in enumerate(pressures)),
            saturated=jnp.asarray(False),
        )

    def update(
        self,
        last: Estimates,
        setpoints: Sequence[Setpoint],
        angles: Scalars,
        measured: Scalars,
        period: ArrayLike,
    ) -> tuple[Estimates, Expected]:
        """Estimates after a further sample [rad, Pa], and their prediction at the arrival of the next commands."""
        delay, rates = self._delay / jnp.asarray(period), tuple(motion.velocity for motion in last.motion)
        arrived = mean_commands(last.sent, delay, delay + 1) if self._periods else last.sent[0]
        valves = self._valves(_Motion(angles, rates, last.pressures, last.actuators))
        predicted, actuators = valves.predict(arrived, period)
        pressures = self.pressure_observer.step(predicted, measured, period)
        torque, stiffness, added = self._torque_and_stiffness(angles, pressures)
        reference, coming = self._followed(last, setpoints, period)
        joints = zip(reference, coming, setpoints, strict=True)
        ahead, there = zip(*(self._at_arrival(*joint, period) for joint in joints), strict=True)
        slips, friction = self._friction(last.slips, [reference.angle for reference in ahead], pressures)
        moved, resistance = last.moved, friction
        if (share := self.friction_in_observer) is not None:
            moving = [motion.angle + period * motion.velocity for motion in last.motion]
            moved, along = self._friction(moved, moving, pressures)
            resistance = _sums([share * torque for torque in along], [(1 - share) * torque for torque in friction])
        modelled = self.mechanics.accelerations(angles, rates, _sums(torque, resistance), period)
        observed = zip(last.motion, angles, modelled, strict=True)
        estimates = last._replace(
            motion=tuple(self.observer.step(*joint, period) for joint in observed),
            pressures=pressures,
            reference=reference,
            coming=coming,
            slips=slips,
            moved=moved,
            actuators=actuators,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
            friction=friction,
            resistance=resistance,
        )
        expected = estimates
        if self._periods:
            expected = self._predicted(estimates, period)
            angles = tuple(motion.angle for motion in expected.motion)
        expected = expected._replace(reference=ahead)
        rates = tuple(motion.velocity for motion in expected.motion)
        now = self._valves(_Motion(angles, rates, expected.pressures, expected.actuators))
        return estimates, Expected(there, angles, expected, now)

    def foresee(self, state: State, setpoint: PyTree, period: ArrayLike) -> State:
        """Return the state before the first step after one of the setpoints that precede that of this step."""
        estimates: Estimates = state.estimates  # type: ignore[attr-defined]
        setpoints = (setpoint,) if isinstance(setpoint, Setpoint) else setpoint
        reference, coming = self._followed(estimates, setpoints, period)
        return state._replace(estimates=estimates._replace(reference=reference, coming=coming))  # type: ignore

    def _followed(
        self, last: Estimates, setpoints: Sequence[Setpoint], period: ArrayLike
    ) -> tuple[tuple[ReferenceDerivatives, ...], tuple[PyTree, ...]]:
        """Derivatives at further setpoints, and what is known of the references ahead."""
        joints = zip(last.reference, last.coming, setpoints, strict=True)
        reference, coming = zip(*(self._follow(*joint, period) for joint in joints), strict=True)
        return reference, coming

    def init_coming(self, angle: Scalar, stiffness: Scalar) -> PyTree:
        """Return what is known of the reference ahead at the start, at a constant angle [rad] and stiffness [N*m/rad].

        None of it without preview.
        """
        return ()

    def _follow(
        self, last: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, PyTree]:
        """Derivatives at a further setpoint of a joint, and what is known of its reference ahead."""
        return last.update(setpoint.angle, period), ()

    def _at_arrival(
        self, reference: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, Setpoint]:
        """Reference and setpoint of a joint at the arrival of the next commands."""
        ahead = reference.after(self._delay) if self._periods else reference
        return ahead, setpoint._replace(angle=ahead.angle)

    def _predicted(self, estimates: Estimates, period: ArrayLike) -> Estimates:
        """Estimates when the next commands arrive."""
        steps, mechanics = self.steps, self.mechanics
        delay, step = self._delay / jnp.asarray(period), jnp.asarray(self._delay) / steps
        means = [
            mean_commands(estimates.sent, delay * (1 - (k + 1) / steps), delay * (1 - k / steps)) for k in range(steps)
        ]
        disturbances = [motion.disturbance for motion in estimates.motion]

        def advance(at: _Motion, commands: Scalars) -> tuple[_Motion, None]:
            midway = _moved(at.angles, at.rates, step / 2)  # one evaluation of the geometry
            following, actuators = self._valves(at._replace(angles=midway)).predict(commands, step)
            middle = tuple((first + second) / 2 for first, second in zip(at.pressures, following, strict=True))
            torques = _sums(mechanics.torques(midway, middle), estimates.resistance)
            accelerations = _sums(mechanics.accelerations(midway, at.rates, torques, step), disturbances)
            angles = _moved(at.angles, _moved(at.rates, accelerations, step / 2), step)
            return _Motion(angles, _moved(at.rates, accelerations, step), following, actuators), None

        motion = estimates.motion
        angles, rates = zip(*((of.angle, of.velocity) for of in motion), strict=True)
        start = _Motion(angles, rates, estimates.pressures, estimates.actuators)
        end = lax.scan(advance, start, tuple(map(jnp.stack, zip(*means, strict=True))))[0]
        torque, stiffness, added = self._torque_and_stiffness(end.angles, end.pressures)
        joints = zip(motion, end.angles, end.rates, strict=True)
        return estimates._replace(
            motion=tuple(of._replace(angle=angle, velocity=rate) for of, angle, rate in joints),
            pressures=end.pressures,
            actuators=end.actuators,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
        )

    def estimates_telemetry(self, estimates: Estimates) -> dict[str, PyTree]:
        """Signals to record, by name."""
        motion, form = estimates.motion, self.mechanics.like_joints
        angles, still = [of.angle for of in motion], [jnp.zeros_like(of.angle) for of in motion]
        rows = self.mechanics.equations(angles, still).matrix
        disturbances = [sum(a * of.disturbance for a, of in zip(row, motion, strict=True)) for row in rows]
        return {
            "stiffness_estimate": form(estimates.stiffness),
            "saturated": estimates.saturated,
            "velocity_estimate": form([of.velocity for of in motion]),
            "disturbance_estimate": form(disturbances),
            "friction_compensation": form(estimates.friction),
        }

    def _valves(self, at: _Motion) -> Valves:
        """Model of the valves at a motion."""
        valve, muscles = self.valve, self.mechanics.muscles
        valves = [valve.for_muscle(i) for i in range(len(muscles))]
        air: Sequence[AirVolume | None] = (None,) * len(muscles)
        if valve.holds_air:
            dead = [muscle.attached_volume for muscle in valves]
            air = air_volumes(self.mechanics.routes_at(at.angles), at.rates, at.pressures, dead_volumes=dead)
        ranges = [actuator.command_range(muscle.domain) for actuator, muscle in zip(valves, muscles, strict=True)]
        commands = tuple(tuple(map(floating, limits)) for limits in zip(*ranges, strict=True))
        return Valves(valve, at.pressures, at.actuators, air, commands)

    def _torque_and_stiffness(self, angles: Scalars, pressures: Scalars) -> tuple[Scalars, Scalars, Scalars]:
        """Torque [N*m] and controlled stiffness of the model, and its difference from the isobaric one [N*m/rad]."""
        mechanics, amplitude = self.mechanics, self.stiffness_amplitude
        torque, isobaric = mechanics.evaluate(angles, pressures)
        if amplitude is None:
            return torque, isobaric, tuple(map(jnp.zeros_like, isobaric))
        stiffness = mechanics.stiffness_for(angles, pressures, amplitude)
        return torque, stiffness, tuple(secant - slope for secant, slope in zip(stiffness, isobaric, strict=True))

    def _init_slips(self, angles: Scalars, pressures: Scalars) -> SlipStates:
        """Unstressed friction of muscles and joints; muscles of the model do not creep."""
        if not self.friction_compensation:
            return SlipStates()
        joints = zip(self.mechanics.frictions, angles, strict=True)
        return SlipStates(
            tuple(state._replace(creep=()) for state in init_states(self.mechanics.routes_at(angles), pressures)),
            tuple(() if friction is None else friction.initial(angle) for friction, angle in joints),
        )

    def _friction(self, slips: SlipStates, angles: Sequence[Array], pressures: Scalars) -> tuple[SlipStates, Scalars]:
        """States of the friction after a motion to angles [rad], and its torques [N*m], the same before and after."""
        torques: list[Any] = [jnp.zeros_like(angle) for angle in angles]
        if not self.friction_compensation:
            return slips, tuple(torques)
        routes, joints = self.mechanics.routes_at(angles), []
        for route, pressure, state in zip(routes, pressures, slips.muscles, strict=True):
            if state.friction:
                force = route.forces(pressure, state, None)[0] - route.tension(pressure)
                for joint, slope in route.slopes.items():
                    torques[joint] = torques[joint] - slope * force
        for i, (friction, held) in enumerate(zip(self.mechanics.frictions, slips.joints, strict=True)):
            if friction is not None:
                torques[i] = torques[i] - friction.resisting_torque(held, angles[i])
                held = friction.project(held, angles[i])
            joints.append(held)
        return SlipStates(update_states(routes, slips.muscles, pressures), tuple(joints)), tuple(torques)


class PairPrediction(StatePrediction[State], Controller[State]):
    """Base of controllers of a joint that predict with a model of joint and load."""

    model: JointModel
    load: LoadModel
    valve: ValveModel = eqx.field(kw_only=True, default=FirstOrderValve(0.02))
    command_delay: Annotated[CommandDelay | None, Inherited(lambda scope: scope.get("command_delay"))] = eqx.field(
        kw_only=True, default=None
    )

    @property
    def mechanics(self) -> HingeMechanics:
        return HingeMechanics(self.model, self.load)


class ModelBasedControl(PairPrediction[State]):
    """Base of controllers whose commands follow from a model of joint, load and valves."""

    minimum_tension: Force = eqx.field(kw_only=True, default=5.0)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)
    stiffness_amplitude: AngleScale | None = eqx.field(kw_only=True, default=None)


def _sums(first: Sequence[Array], second: Sequence[Array]) -> Scalars:
    return tuple(map(operator.add, first, second))


def _moved(values: Sequence[Array], rates: Sequence[Array], time: ArrayLike) -> Scalars:
    """Values after a time [s] at constant rates."""
    return tuple(value + time * rate for value, rate in zip(values, rates, strict=True))


def mean_commands(sent: tuple[tuple[Scalar, ...], ...], newest: ArrayLike, oldest: ArrayLike) -> Any:
    """Return the mean commands [Pa] between two ages, in control periods; the last sent has an age of up to 1."""
    span = jnp.maximum(jnp.asarray(oldest) - newest, 1e-9)
    shares = [
        jnp.clip((jnp.minimum(oldest, age + 1.0) - jnp.maximum(newest, float(age))) / span, 0.0, 1.0)
        for age in range(len(sent))
    ]
    weighed = [tuple(share * command for command in commands) for share, commands in zip(shares, sent, strict=True)]
    return tuple(functools.reduce(operator.add, side) for side in zip(*weighed, strict=True))
