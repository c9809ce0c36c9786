"""State estimation, and prediction over the delay of the commands, shared by the controllers with a model."""

# No `from __future__ import annotations`: equinox does not see an AbstractVar written as text.

import dataclasses
import functools
import math
import operator
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator import Actuator, AirVolume, FirstOrderValve
from mckibben.actuator.base import Point, air_volumes, delay_periods
from mckibben.component.base import Inherited
from mckibben.component.columns import Label
from mckibben.control.allocation import command_limits
from mckibben.control.base import (
    Controller,
    JointModel,
    LoadModel,
    Measurement,
    Setpoint,
    State,
    ValveModel,
    check_valve_model,
)
from mckibben.control.observer import MotionEstimate, Observer, PressureObserver
from mckibben.control.reference import ReferenceDerivatives
from mckibben.errors import ParameterError, RangeError
from mckibben.joint.antagonistic import NO_STATES, MuscleStates
from mckibben.joint.geometry import Pair
from mckibben.units import AngleScale, CommandDelay, Force, ms

Scalar = Float[Array, ""]

_LEAST_STEPS, _LONGEST_STEP = 2, 4 * ms  # of the prediction
_ROUNDING = 1e-9  # steps


class Valves(NamedTuple):
    """Model of the valves at their estimated pressures [Pa] and states, and the range of their commands [Pa].

    Tuples are over muscles, for functions of a joint pairs.
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
        wanted = (valve.command_toward(at, target, lag, period) for valve, at, target in self._muscles(targets))
        return tuple(map(jnp.clip, wanted, *self.commands))

    def _muscles(self, values: Iterable[Any]) -> Iterator[tuple[Actuator, Point, Any]]:
        """Actuator of each muscle, its state, and its value."""
        points = map(Point, self.pressures, self.states, self.air)
        for i, (at, value) in enumerate(zip(points, values, strict=True)):
            yield self.model.for_muscle(i), at, value


class Estimates(NamedTuple):
    """Estimates at a sample, and the commands given then."""

    motion: MotionEstimate
    pressures: Pair
    reference: ReferenceDerivatives  # at the newest setpoint
    coming: PyTree  # what is known of the reference ahead
    muscles: MuscleStates  # of the model, along the reference
    moved: MuscleStates  # of the model, along the estimated motion
    torque: Scalar  # of the model's muscles at the estimated pressures, without friction [N*m]
    stiffness: Scalar  # of the model, for the amplitude of the controller [N*m/rad]
    added_stiffness: Scalar  # minus the isobaric one [N*m/rad]
    friction: Scalar  # compensated torque [N*m]
    resistance: Scalar  # torque of the friction with which the motion is predicted [N*m]
    sent: tuple[Pair, ...]  # commands on their way [Pa], the last first
    actuators: tuple[PyTree, PyTree]  # states of the model of the valves
    saturated: Array


class Expected(NamedTuple):
    """Predicted setpoint, angle [rad] and estimates at the arrival of the next commands, and the valves there."""

    setpoint: Setpoint
    angle: Scalar  # measured, or predicted over the delay
    estimates: Estimates
    valves: Valves


class StatePrediction(Controller[State]):
    r"""Base of controllers that estimate the state by a model of joint, load and valves, and predict it over a delay.

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
    model: JointModel
    load: LoadModel
    valve: ValveModel = eqx.field(kw_only=True, default=FirstOrderValve(0.02))
    command_delay: Annotated[CommandDelay | None, Inherited(lambda scope: scope.get("command_delay"))] = eqx.field(
        kw_only=True, default=None
    )
    periods: int | None = eqx.field(kw_only=True, default=None, static=True)
    steps: int = eqx.field(kw_only=True, default=_LEAST_STEPS, static=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_valve_model(type(self).__name__, self.valve, self.model)

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

    def init_estimates(self, measurement: Measurement) -> Estimates:
        """Estimates before the first step, at rest."""
        angle, pressures = measurement
        torque, stiffness, added = self._torque_and_stiffness(angle, pressures)
        zero = jnp.zeros_like(angle)
        muscles = self.model.init_state(angle, pressures) if self.friction_compensation else NO_STATES
        return Estimates(
            motion=self.observer.init(angle, self.load.acceleration(angle, zero, torque)),
            pressures=pressures,
            reference=ReferenceDerivatives.init(angle),
            coming=self.init_coming(angle, stiffness),
            muscles=muscles,
            moved=NO_STATES if self.friction_in_observer is None else muscles,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
            friction=zero,
            resistance=zero,
            sent=(pressures,) * (self._periods + 1),
            actuators=tuple(self.valve.for_muscle(i).init_model(pressures[i]) for i in (0, 1)),  # type: ignore
            saturated=jnp.asarray(False),
        )

    def update(
        self, last: Estimates, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[Estimates, Expected]:
        """Estimates after a further sample, and their prediction at the arrival of the next commands."""
        angle = measurement.angle
        delay = self._delay / jnp.asarray(period)
        arrived = mean_commands(last.sent, delay, delay + 1) if self._periods else last.sent[0]
        valves = self._valves(angle, last.motion.velocity, last.pressures, last.actuators)
        predicted, actuators = valves.predict(arrived, period)
        pressures = self.pressure_observer.step(predicted, measurement.pressures, period)
        torque, stiffness, added = self._torque_and_stiffness(angle, pressures)
        reference, coming = self._follow(last, setpoint, period)
        ahead, setpoint = self._at_arrival(reference, coming, setpoint, period)
        muscles, friction_torque = self._friction(last.muscles, ahead.angle, pressures)
        moved, resistance = last.moved, friction_torque
        if (share := self.friction_in_observer) is not None:
            moved, along = self._friction(moved, last.motion.angle + period * last.motion.velocity, pressures)
            resistance = share * along + (1 - share) * friction_torque
        known = self.load.acceleration(angle, last.motion.velocity, torque + resistance)
        estimates = last._replace(
            motion=self.observer.step(last.motion, angle, known, period),
            pressures=pressures,
            reference=reference,
            coming=coming,
            muscles=muscles,
            moved=moved,
            actuators=actuators,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
            friction=friction_torque,
            resistance=resistance,
        )
        expected = estimates
        if self._periods:
            expected = self._predicted(estimates, period)
            angle = expected.motion.angle
        expected = expected._replace(reference=ahead)
        now = self._valves(angle, expected.motion.velocity, expected.pressures, expected.actuators)
        return estimates, Expected(setpoint, angle, expected, now)

    def foresee(self, state: State, setpoint: Setpoint, period: ArrayLike) -> State:
        estimates: Estimates = state.estimates  # type: ignore[attr-defined]
        reference, coming = self._follow(estimates, setpoint, period)
        return state._replace(estimates=estimates._replace(reference=reference, coming=coming))  # type: ignore

    def init_coming(self, angle: Scalar, stiffness: Scalar) -> PyTree:
        """Return what is known of the reference ahead at the start, at a constant angle [rad] and stiffness [N*m/rad].

        None of it without preview.
        """
        return ()

    def _follow(self, last: Estimates, setpoint: Setpoint, period: ArrayLike) -> tuple[ReferenceDerivatives, PyTree]:
        """Derivatives at a further setpoint, and what is known of the reference ahead."""
        return last.reference.update(setpoint.angle, period), ()

    def _at_arrival(
        self, reference: ReferenceDerivatives, coming: PyTree, setpoint: Setpoint, period: ArrayLike
    ) -> tuple[ReferenceDerivatives, Setpoint]:
        """Reference and setpoint at the arrival of the next commands."""
        ahead = reference.after(self._delay) if self._periods else reference
        return ahead, setpoint._replace(angle=ahead.angle)

    def _predicted(self, estimates: Estimates, period: ArrayLike) -> Estimates:
        """Estimates when the next commands arrive."""
        steps = self.steps
        delay, step = self._delay / jnp.asarray(period), jnp.asarray(self._delay) / steps
        pairs = [
            mean_commands(estimates.sent, delay * (1 - (k + 1) / steps), delay * (1 - k / steps)) for k in range(steps)
        ]
        commands = jnp.stack([first for first, _ in pairs]), jnp.stack([second for _, second in pairs])
        motion = estimates.motion

        def advance(state: tuple[Scalar, Scalar, Pair, PyTree], commands: Pair) -> tuple[PyTree, None]:
            angle, velocity, pressures, actuators = state
            midway = angle + step / 2 * velocity  # one evaluation of the geometry
            valves = self._valves(midway, velocity, pressures, actuators)
            following, actuators = valves.predict(commands, step)
            middle = tuple((first + second) / 2 for first, second in zip(pressures, following, strict=True))
            torque = self.model.torque(midway, (middle[0], middle[1])) + estimates.resistance
            acceleration = self.load.acceleration(midway, velocity, torque) + motion.disturbance
            moved = angle + step * (velocity + step / 2 * acceleration)
            return (moved, velocity + step * acceleration, following, actuators), None

        start = motion.angle, motion.velocity, estimates.pressures, estimates.actuators
        (angle, velocity, pressures, actuators), _ = lax.scan(advance, start, commands)
        torque, stiffness, added = self._torque_and_stiffness(angle, pressures)
        return estimates._replace(
            motion=motion._replace(angle=angle, velocity=velocity),
            pressures=pressures,
            actuators=actuators,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
        )

    def estimates_telemetry(self, estimates: Estimates) -> dict[str, Scalar]:
        """Signals to record, by name."""
        return {
            "stiffness_estimate": estimates.stiffness,
            "saturated": estimates.saturated,
            "velocity_estimate": estimates.motion.velocity,
            "disturbance_estimate": self.load.dynamic_torque(0.0, estimates.motion.disturbance),
            "friction_compensation": estimates.friction,
        }

    def _valves(self, angle: ArrayLike, velocity: ArrayLike, pressures: Pair, states: tuple[PyTree, PyTree]) -> Valves:
        """Model of the valves at a motion of the joint."""
        valve: Any = self.valve
        air: Any = (None, None)
        if valve.holds_air:
            dead1, dead2 = (valve.for_muscle(i).attached_volume for i in (0, 1))
            air = air_volumes(self.model.routes(angle), (velocity,), pressures, dead_volumes=(dead1, dead2))
        return Valves(valve, pressures, states, air, command_limits(self.model, valve))

    def _torque_and_stiffness(self, angle: ArrayLike, pressures: Pair) -> tuple[Scalar, Scalar, Scalar]:
        """Torque [N*m] and controlled stiffness of the model, and its difference from the isobaric one [N*m/rad]."""
        torque, isobaric = self.model.evaluate(angle, pressures)
        if self.stiffness_amplitude is None:
            return torque, isobaric, jnp.zeros_like(isobaric)
        stiffness = self.model.stiffness_for(angle, pressures, self.stiffness_amplitude)
        return torque, stiffness, stiffness - isobaric

    def _friction(self, muscles: MuscleStates, angle: ArrayLike, pressures: Pair) -> tuple[MuscleStates, Scalar]:
        """Internal states of the model's muscles after a motion to an angle [rad], and their friction torque [N*m]."""
        if not self.friction_compensation:
            return muscles, jnp.zeros_like(pressures[0])
        torque = self.model.friction_torque(angle, None, pressures, muscles)  # the same before and after the update
        return self.model.update_state(muscles, angle, pressures), torque


class ModelBasedControl(StatePrediction[State]):
    """Base of controllers whose commands follow from a model of joint, load and valves."""

    minimum_tension: Force = eqx.field(kw_only=True, default=5.0)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)
    stiffness_amplitude: AngleScale | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.friction_compensation and not self.model.has_friction:
            raise RangeError(
                f"{type(self).__name__}: no muscle of its model has friction to compensate",
                remedy="give the model's muscles a MaxwellSlip, or leave friction_compensation out",
            )


def mean_commands(sent: tuple[tuple[Scalar, ...], ...], newest: ArrayLike, oldest: ArrayLike) -> Any:
    """Return the mean commands [Pa] between two ages, in control periods; the last sent has an age of up to 1."""
    span = jnp.maximum(jnp.asarray(oldest) - newest, 1e-9)
    shares = [
        jnp.clip((jnp.minimum(oldest, age + 1.0) - jnp.maximum(newest, float(age))) / span, 0.0, 1.0)
        for age in range(len(sent))
    ]
    weighed = [tuple(share * command for command in commands) for share, commands in zip(shares, sent, strict=True)]
    return tuple(functools.reduce(operator.add, side) for side in zip(*weighed, strict=True))
