"""Common base of all plants: actuators, sensors, delayed commands, and the integration over a control period."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator.base import Actuator, AirState, AirVolume, delay_periods
from mckibben.component.base import Component
from mckibben.errors import RangeError, SimulationError
from mckibben.joint import Measurement
from mckibben.muscle import Muscle, MuscleState
from mckibben.numerics.calculus import rk4
from mckibben.numerics.elementary import floating
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, Sensors
from mckibben.units import CommandDelay

STABILITY_LIMIT = 2.785
"""Largest product of step and mode on the negative real axis at which the classical Runge-Kutta method is stable."""

MOST_SUBSTEPS = 1000
"""Largest number of integration steps per control period."""

_SLOWER = {
    "the motion": "less damping and stiffness, or more inertia",
    "the friction of the ground": "a ground with a higher slip speed",
    "the air": "a valve with less conductance, a wider band, a slower spool or regulator, or more dead volume",
}
_ROUNDING = 1e-9

Scalar = Float[Array, ""]

Angles = ArrayLike | Sequence[ArrayLike]
"""Angles [rad] of one joint, as an array, or one of each joint."""


class IOState(NamedTuple):
    """State of sensors and disturbance, constant over a control period."""

    sample: Scalar
    disturbance: Any
    sensors: Any


class State(Protocol):
    """State of a plant: a named tuple of positions, velocities, and these; parts that a plant lacks have no leaves."""

    @property
    def pressures(self) -> tuple[Scalar, ...]: ...
    @property
    def muscles(self) -> tuple[MuscleState, ...]: ...
    @property
    def io(self) -> IOState | tuple[()]: ...
    @property
    def air(self) -> AirState | tuple[()]: ...
    @property
    def friction(self) -> Any: ...
    @property
    def sent(self) -> tuple[tuple[Scalar, ...], ...]: ...

    _fields: ClassVar[tuple[str, ...]]

    @property
    def _replace(self) -> Callable[..., Any]: ...
    def __getitem__(self, index: Any, /) -> Any: ...


S = TypeVar("S", bound=State)


class Motion(NamedTuple):
    """Integrated part of a state, or its rate."""

    position: Any
    velocity: Any
    creep: tuple[Any, ...] = ((), ())  # of the muscles [N, Pa]
    pressures: tuple[Scalar, ...] = ()  # with an actuator that `holds_air` [Pa]
    air: AirState | tuple[()] = ()  # likewise, the state of the valves

    @classmethod
    def of(cls, state: State) -> Motion:
        """Return the integrated part of a state."""
        pressures = state.pressures if isinstance(state.air, AirState) else ()
        return cls(state[0], state[1], tuple(muscle.creep for muscle in state.muscles), pressures, state.air)

    def applied_to(self, state: S, pressures: tuple[Scalar, ...]) -> S:
        """Return a state with this motion, and other pressures [Pa] unless they are part of it."""
        position, velocity = state._fields[:2]
        held = zip(state.muscles, self.creep, strict=True)
        return state._replace(
            **{position: self.position, velocity: self.velocity},
            pressures=self.pressures or pressures,
            muscles=tuple(MuscleState(muscle.friction, creep) for muscle, creep in held),
            air=self.air,
        )


class Plant(Component, Generic[S]):
    """Bodies moved by muscles, with actuators, sensors, disturbances and a delay of the commands.

    Commands are constant over a control period. Within it, the motion is integrated in steps of equal length, by
    default of the classical method of Runge and Kutta; pressures follow in closed form, or, with air, are integrated
    along. After each step `project` updates the internal states of friction and creep, by which no force changes.

    Parameters
    ----------
    sensors
        Model of the sensors, read once in a control period; perfect by default.
    command_delay
        Time from a command to the valves [s]; a delay that is no multiple of the control period mixes two commands.
    delay_periods
        Its length in control periods, set by `with_period`.
    """

    sensors: Sensors = eqx.field(kw_only=True, default=PerfectSensors())
    command_delay: CommandDelay | None = eqx.field(kw_only=True, default=None)
    delay_periods: int = eqx.field(kw_only=True, default=0, static=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        count = self._valve.muscle_count
        if count is not None and count != len(self.muscles):
            message = f"{type(self).__name__}: a {type(self._valve).__name__} is for {count} muscles, "
            message += f"and there are {len(self.muscles)}"
            raise RangeError(message, field="valve", remedy="give an actuator that all muscles have")

    @property
    def _valve(self) -> Actuator:
        """The field `valve` of each plant, in its own order of arguments."""
        return self.valve  # type: ignore[attr-defined]

    @property
    @abc.abstractmethod
    def muscles(self) -> tuple[Muscle, ...]:
        """All muscles, in the order of commands and pressures."""

    @property
    @abc.abstractmethod
    def disturbances(self) -> tuple[Disturbance, ...]:
        """Disturbances of all joints."""

    @abc.abstractmethod
    def true_measurement(self, state: S) -> Measurement:
        """Return what perfect sensors measure: angle [rad] and gauge pressures [Pa]."""

    @abc.abstractmethod
    def disturbing_torque(self, time: ArrayLike) -> Any:
        """Return the torque [N*m] of the disturbances at a time [s] since the start."""

    @property
    def stability_limit(self) -> float:
        """Largest product of an integration step and the fastest rate."""
        return STABILITY_LIMIT

    @abc.abstractmethod
    def rate(self, state: S) -> Motion:
        """Return the time derivative of the motion at the pressures of a state."""

    @abc.abstractmethod
    def project(self, state: S) -> S:
        """Return the state after an integration step with updated internal states; no force changes by it."""

    @abc.abstractmethod
    def air_volumes(self, state: S) -> Sequence[AirVolume]:
        """Return the volume of the air of each muscle, dead volume included, at the velocity of a state."""

    @abc.abstractmethod
    def init_muscles(self, state: S) -> tuple[MuscleState, ...]:
        """Return the relaxed states of the muscles at the positions and pressures of a state."""

    @abc.abstractmethod
    def init_friction(self, state: S) -> Any:
        """Return the unstressed states of the friction of the joints at the positions of a state."""

    @abc.abstractmethod
    def fastest_rates(self, angles: Angles, stiffness: ArrayLike | None = 0.0) -> dict[str, float]:
        """Return the rates [1/s] that integration steps must resolve by their cause, near angles [rad]."""

    def needed_substeps(self, angles: Angles, stiffness: ArrayLike | None, period: float) -> int:
        """Return the least number of integration steps in a period [s] that resolves the fastest rate of the plant.

        At the extreme angles [rad] of a joint, with a stiffness [N*m/rad], or at the angles of all joints of a robot.
        Raises `SimulationError` if there is none up to 1000.
        """
        needed = max(self.fastest_rates(angles, stiffness).values()) * period / self.stability_limit
        if not needed <= MOST_SUBSTEPS:
            self.check_substeps(angles, stiffness, period, MOST_SUBSTEPS)
        return max(math.ceil(needed * (1 - _ROUNDING)), 1) if math.isfinite(needed) else 1

    def check_substeps(self, angles: Angles, stiffness: ArrayLike | None, period: float, substeps: int) -> None:
        """Raise `SimulationError` if integration steps do not resolve the fastest rate, as for `needed_substeps`."""
        what, fastest = max(self.fastest_rates(angles, stiffness).items(), key=lambda item: item[1])
        needed = fastest * period / self.stability_limit
        if math.isfinite(needed) and needed > substeps * (1 + _ROUNDING):
            raise SimulationError(
                f"integration steps of {period / substeps * 1e3:g} ms do not resolve {what}: "
                f"{period / needed * 1e3:.2g} ms would",
                field="substeps",
                value=substeps,
                lower=math.ceil(needed),
                remedy=f"give at least {math.ceil(needed)} substeps, a shorter control period, or "
                f"{_SLOWER.get(what, 'a softer or slower component')}",
            )

    def begin(self, start: Any) -> Any:
        """Return the state of a start; by default a start is a state."""
        return start

    def with_last_step(self, state: S, step: ArrayLike) -> S:
        """Return a state from which steps of a length [s] take fewer evaluations; by default the state."""
        return state

    def observe(self, state: S) -> Any:
        """Return what a run records of a state at the start of a control period; by default the state."""
        return state

    def telemetry(self, state: S, commands: Sequence[ArrayLike], period: ArrayLike) -> dict[str, Array]:
        """Return further quantities of a control period [s], at whose start commands [Pa] are sent, by name."""
        return {}

    @property
    def has_ideal_io(self) -> bool:
        """Whether sensors are perfect and there is no disturbance."""
        quiet = all(isinstance(disturbance, NoDisturbance) for disturbance in self.disturbances)
        return isinstance(self.sensors, PerfectSensors) and quiet

    def with_period(self, period: float) -> Self:
        """Return the plant with states for commands on their way, a period [s] each; `RangeError` for more than 100."""
        if self.command_delay is None:
            return self
        return dataclasses.replace(self, delay_periods=delay_periods(self.command_delay, period))

    def sample(self, state: S, period: ArrayLike) -> tuple[S, Any]:
        """Return the state at the start of a control period [s], with its disturbance, and the measurement.

        The disturbance [N*m] holds until the next sample.
        """
        true, io = self.true_measurement(state), state.io
        if not isinstance(io, IOState):
            return state, true
        sensors, measured = self.sensors.measure(io.sensors, io.sample, true)
        disturbance = self.disturbing_torque(io.sample * period)
        return state._replace(io=IOState(io.sample + 1, disturbance, sensors)), measured

    def clip_commands(self, commands: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] within the rated pressures and the supply, or openings within -1..1."""
        rated = (muscle.specimen.domain for muscle in self.muscles)
        muscles = enumerate(zip(commands, rated, strict=False))  # `clip_commands` of each plant checks the count
        return tuple(self._valve.for_muscle(i).clip_command(*muscle) for i, muscle in muscles)

    def apply_commands(self, state: S, commands: Sequence[ArrayLike]) -> S:
        """Return the state right after new commands [Pa]."""
        if self._valve.holds_air:
            return state
        muscles = enumerate(zip(state.pressures, commands, strict=True))
        return state._replace(
            pressures=tuple(self._valve.for_muscle(i).after_command(*muscle) for i, muscle in muscles)
        )

    def arriving(self, state: S, commands: Sequence[ArrayLike], period: ArrayLike) -> tuple[ArrayLike, ...]:
        """Return the mean commands [Pa] at the valves in a control period [s], at whose start new ones are sent."""
        if not state.sent:
            return tuple(commands)
        late = jnp.minimum(jnp.asarray(self.command_delay) / period, len(state.sent))
        shares = [jnp.maximum(1 - jnp.abs(late - number), 0.0) for number in range(len(state.sent) + 1)]
        return tuple(
            sum(share * jnp.asarray(command) for share, command in zip(shares, side, strict=True))
            for side in zip(commands, *state.sent, strict=True)
        )

    def follow(self, state: S, commands: Sequence[ArrayLike], period: ArrayLike, substeps: int) -> S:
        """Return the state after a control period [s] at whose start commands [Pa] are sent to the valves.

        With a `command_delay` the valves receive earlier commands, which the state holds.
        """
        sent = (tuple(commands), *state.sent)[: len(state.sent)]
        after = self.advance(state._replace(sent=()), self.arriving(state, commands, period), period, substeps)
        return after._replace(sent=sent)

    def advance(self, state: S, commands: Sequence[ArrayLike], duration: ArrayLike, substeps: int) -> S:
        """Return the state after a duration [s] under constant commands [Pa], by integration steps of equal length."""
        step, valve = duration / substeps, self._valve
        one_step = self._step_with_air if valve.holds_air else self._step

        def integrate(_: Array, state: S) -> S:
            return one_step(valve, state, commands, step)

        return lax.fori_loop(0, substeps, integrate, self.apply_commands(state, commands))

    def _step(self, valve: Actuator, state: S, commands: Sequence[ArrayLike], step: ArrayLike) -> S:
        """State after a step [s] with the pressures of a closed form."""

        def rate(motion: Motion, *pressures: Scalar) -> Motion:
            return self.rate(motion.applied_to(state, pressures))

        end, held = valve.all_after(state.pressures, state.air, commands, step)
        middle, _ = valve.all_after(state.pressures, state.air, commands, step / 2)
        state = state._replace(air=())
        rolled = len(self.muscles) > 2  # as fast, and compiled in half the time
        motion = rk4(rate, Motion.of(state), step, (state.pressures, middle, end), rolled=rolled)
        return self.project(motion.applied_to(state, end))._replace(air=held)

    def _step_with_air(self, valve: Actuator, state: S, commands: Sequence[ArrayLike], step: ArrayLike) -> S:
        """State after a step [s] in which motion and air are integrated together."""
        assert isinstance(state.air, AirState)
        state = state._replace(air=valve.before_steps(state.air, commands, state.pressures, step))

        def rate(motion: Motion) -> Motion:
            at = motion.applied_to(state, state.pressures)
            assert isinstance(at.air, AirState)
            pressures, air = valve.air_rate(at.pressures, at.air, commands, self.air_volumes(at))
            return self.rate(at)._replace(pressures=pressures, air=air)

        motion = rk4(rate, Motion.of(state), step, rolled=True)
        return self.project(motion.applied_to(state, state.pressures))

    def commands_for(self, state: S, rates: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] at which the pressures change at rates [Pa/s]; infinite if there are none."""
        muscles = enumerate(zip(state.pressures, rates, strict=True))
        valve = self._valve
        if not valve.holds_air:
            return tuple(valve.for_muscle(i).command_for(*muscle) for i, muscle in muscles)
        volumes = self.air_volumes(state)
        return tuple(valve.for_muscle(i).command_for(*muscle, volumes[i]) for i, muscle in muscles)

    def complete_state(self, state: S) -> S:
        """Return a state with initial values for the internal states, the io state and the commands that it lacks."""
        pairs = zip(state.muscles, self.init_muscles(state), strict=True)
        zero = jnp.zeros_like(floating(jax.tree.leaves(state[1])[0]))
        io, air = state.io, state.air
        if io == () and not self.has_ideal_io:
            torque = jax.tree.map(jnp.zeros_like, self.disturbing_torque(zero))
            io = IOState(zero, torque, self.sensors.init(self.true_measurement(state)))
        state = state._replace(
            muscles=tuple(MuscleState(*map(_given_or, *pair)) for pair in pairs),
            io=io,
            air=self._valve.init_states(tuple(map(floating, state.pressures))) if air == () else air,
            friction=self.init_friction(state) if state.friction == () else state.friction,
        )
        if state.sent == () and self.delay_periods:
            state = state._replace(sent=(self._holding(state, zero),) * self.delay_periods)
        return state

    def _holding(self, state: S, zero: Scalar) -> tuple[Array, ...]:
        """Commands [Pa] at which the pressures stay; the opening 0 of valves with `direct` commands."""
        zeros = (zero,) * len(state.pressures)
        return zeros if self._valve.direct else self.clip_commands(self.commands_for(state, zeros))


def _given_or(values: tuple[Array, ...], initial: tuple[Array, ...]) -> tuple[Array, ...]:
    return values if len(values) else initial
