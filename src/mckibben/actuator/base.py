"""Actuators: how the pressure in a muscle follows its command."""

from __future__ import annotations

import abc
import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.columns import Labelled
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, RigidTendon
from mckibben.joint.route import Route
from mckibben.muscle import NO_STATE, Domain, MuscleState
from mckibben.muscle.air import ATMOSPHERE, TEMPERATURE, exchange_rate, mass_flow, pressure_rate
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import Number, exp, floating

State: TypeAlias = Any
"""State of a valve, a tree of numbers that its class defines; () for none."""

Scalar = Float[Array, ""]

CommandRange = tuple[ArrayLike, ArrayLike]
"""Lowest and highest command [Pa]."""

_MOST_PERIODS = 100  # of a command delay
_ROUNDING = 1e-9  # periods


class AirState(NamedTuple):
    """State of the actuator of each muscle, gauge pressure [Pa] of the reservoir, and temperatures [K] of the air.

    Without a reservoir, or with polytropic air, these are empty.
    """

    valves: tuple[State, ...]
    reservoir: State = ()
    temperatures: tuple[State, ...] = ()


def state_of_muscle(states: AirState | tuple[()], index: int) -> tuple[State, State]:
    """Return the state of the actuator of a muscle, and the temperature [K] of its air; () for none."""
    if not isinstance(states, AirState):
        return (), ()
    return states.valves[index], states.temperatures[index] if states.temperatures else ()


def at_room_temperature(content: Array, states: AirState | tuple[()], index: int) -> Array:
    """Return the content of a muscle, computed for room temperature, for the temperature that its air has."""
    temperature = state_of_muscle(states, index)[1]
    return content * (TEMPERATURE / temperature) if jax.tree.leaves(temperature) else content


class AirVolume(NamedTuple):
    """Volume [m^3] of the air of a muscle, its rate [m^3/s] at constant pressure, and derivative by it [m^3/Pa]."""

    volume: Array
    rate: Array
    by_pressure: Array | None = None

    def effective(self, index: ArrayLike, pressure: ArrayLike) -> Array:
        """Return the volume [m^3] for `pressure_rate` at an absolute pressure [Pa].

        It is V + n p dV/dp with the polytropic index n: a muscle in series with a spring takes up more air, as its
        volume grows with the pressure.

        >>> round(float(AirVolume(2e-5, 0.0, 1e-11).effective(1.2, 5e5)), 8)
        2.6e-05
        """
        return self.volume if self.by_pressure is None else self.volume + index * pressure * self.by_pressure


class Point(NamedTuple):
    """Operating point of a muscle's actuator in a controller's model: pressure [Pa], state, air if it `holds_air`."""

    pressure: Scalar
    state: State = ()
    air: AirVolume | None = None


def air_volumes(
    routes: Sequence[Route],
    rates: Sequence[ArrayLike],
    pressures: Sequence[ArrayLike],
    states: Sequence[MuscleState] | None = None,
    dead_volumes: Sequence[ArrayLike] | None = None,
) -> tuple[AirVolume, ...]:
    """Return the volumes of the air in muscles, dead volumes [m^3] included, at rates [rad/s] of the joints."""
    count = len(routes)
    states = (NO_STATE,) * count if states is None else states
    dead_volumes = (0.0,) * count if dead_volumes is None else dead_volumes

    def air(route: Route, pressure: ArrayLike, state: MuscleState, dead_volume: ArrayLike) -> AirVolume:
        def volume(path: Array, pressure: ArrayLike) -> Array:
            contraction = route.tendon.contraction(route.muscle, path, pressure, state)
            return route.muscle.specimen.volume(contraction) + dead_volume

        at, slope = value_and_derivative(lambda path: volume(path, pressure), route.path)
        by_pressure = None
        if not isinstance(route.tendon, RigidTendon):
            by_pressure = value_and_derivative(lambda p: volume(route.path, p), pressure)[1]
        return AirVolume(at, slope * route.rate(rates), by_pressure)

    return tuple(map(air, routes, pressures, states, dead_volumes))


def lag_fraction(time_constant: ArrayLike, duration: ArrayLike) -> Scalar:
    """Part 1 - exp(-t / T) of a step that a first-order lag T [s], 0 for none, covers within a time t [s].

    >>> [round(float(lag_fraction(lag, 0.02)), 4) for lag in (0.02, 0.0)]
    [0.6321, 1.0]
    """
    lag = jnp.asarray(time_constant)
    return jnp.where(lag > 0, 1 - exp(-jnp.asarray(duration) / jnp.where(lag > 0, lag, 1.0)), 1.0)


def delay_periods(command_delay: ArrayLike, period: float, field: str = "command_delay") -> int:
    """Return the control periods [s] that hold the commands within a delay [s], the longest of several delays.

    Raises `RangeError` for more than 100, with the field that has the delay.

    >>> delay_periods(2.4e-3, 1e-3)
    3
    """
    longest = float(np.max(command_delay))
    periods = math.ceil(longest / period - _ROUNDING)
    if periods > _MOST_PERIODS:
        raise RangeError(
            f"a command delay of {longest:g} s is {periods} control periods of {period:g} s",
            field=field,
            value=longest,
            upper=_MOST_PERIODS * period,
            unit="s",
            remedy=f"give at most {_MOST_PERIODS} periods",
        )
    return periods


class Attainable(NamedTuple):
    """Pressures that an actuator can reach from a pressure p within a time: from keep p + lower to keep p + upper."""

    keep: Scalar
    lower: Scalar  # [Pa]
    upper: Scalar  # [Pa]

    def __call__(self, pressure: ArrayLike) -> tuple[Scalar, Scalar]:
        """Return the lowest and the highest pressure [Pa]."""
        return self.keep * pressure + self.lower, self.keep * pressure + self.upper


class Reservoir(NamedTuple):
    r"""Air at the inlets of all valves, filled from the supply through a line.

    .. math:: \dot p = \frac{n R T}{V} (\dot m_\mathrm{line} - \dot m_\mathrm{drawn})

    with the flow of the line by ISO 6358 (`mckibben.muscle.air`).
    """

    volume: Number  # [m^3]
    conductance: Number  # C of the line [m^3/(s*Pa)]
    supply: Number  # gauge pressure [Pa]
    critical_ratio: Number
    index: Number  # polytropic

    def rate(self, pressure: ArrayLike, drawn: ArrayLike) -> Array:
        """Return the rate [Pa/s] of the gauge pressure [Pa] while the valves draw a mass flow [kg/s]."""
        inlet = ATMOSPHERE + pressure
        line = mass_flow(self.conductance, self.critical_ratio, self.supply + ATMOSPHERE, inlet)
        return pressure_rate(self.index, inlet, line - drawn, self.volume, 0.0)

    def fastest_rate(self, conductance: float) -> float:
        """Return a bound on the rate [1/s] with valves of a conductance [m^3/(s*Pa)], all together."""
        total = float(self.conductance) + conductance
        return exchange_rate(float(self.index), float(self.critical_ratio), total, float(self.volume))


class Actuator(Labelled, Component):
    """Response of the pressures of the muscles to their commands.

    `for_muscle` gives the actuator of each muscle; all are alike unless it is overridden. The state of an actuator
    consists of the pressure and its internal state (`init`). Derive actuators with a closed form for a constant command
    from `Valve`, and those whose pressures follow from mass flow and volume from `AirValve`. Other packages use the
    properties below, and never test the class.

    A controller may have an actuator as its model of the valves: it uses `init_model`, `predict`, `attainable` and
    `command_toward`. By default these are a first-order response with the time constant `lag`.
    """

    default_class = "first_order"
    holds_air = False
    """Whether the pressures are integrated with the volumes of the muscles."""
    holds_pressure = True
    """Whether the pressure is a state; else it is the command."""
    is_first_order = False
    """Whether the response has one time constant [s], the field `time_constant`."""
    direct = False
    """Whether commands are openings -1..1 in place of pressures."""
    dead_volume = 0.0
    """Volume [m^3] of tube and fittings between actuator and muscle."""
    wall_conductance = None
    """Conductance h A [W/K] for heat from the wall of a muscle to its air; None for air without a temperature."""
    muscle_count: ClassVar[int | None] = None
    """Number of muscles that it is made for, None for any."""

    def for_muscle(self, index: int) -> Any:
        """Return the actuator of a muscle, numbered from 0."""
        return self

    def for_muscles(self, names: Sequence[str]) -> Actuator:
        """Return the actuator of muscles with names, in their order; `RangeError` if one has none."""
        return self

    @property
    def attached_volume(self) -> ArrayLike:
        """Volume [m^3] of tube and fittings that has the pressure of the muscle."""
        return self.dead_volume

    @property
    def reservoir(self) -> Reservoir | None:
        """Air at the inlets of all valves, None for a constant pressure there."""
        return None

    @property
    def lag(self) -> Any:
        """First-order time constant [s] in a controller's model; None if unknown."""
        return None

    @property
    def is_linear(self) -> bool:
        """Whether commands are affine in pressures and their rates."""
        return False

    @property
    def switches(self) -> bool:
        """Whether the state changes at integration steps, so that it has no time derivative."""
        return False

    def averaged(self) -> Actuator:
        """Return the actuator with the mean flow of valves that switch, for linearisation."""
        return self

    @abc.abstractmethod
    def init(self, pressure: Scalar) -> State:
        """Return the internal state at a constant pressure [Pa], without the pressure itself."""

    def rates(
        self,
        pressures: Sequence[Scalar],
        states: AirState | tuple[()],
        commands: Sequence[ArrayLike],
        volumes: Callable[[], Sequence[AirVolume]],
    ) -> tuple[tuple[Array, ...], AirState | tuple[()]]:
        """Return the time derivatives of the pressures [Pa/s] and of the states of all muscles."""
        if self.holds_air:
            assert isinstance(states, AirState)
            return self.air_rate(pressures, states, commands, volumes())
        return value_and_derivative(lambda t: self.all_after(pressures, states, commands, t), jnp.zeros(()))[1]

    def all_after(
        self,
        pressures: Sequence[Scalar],
        states: AirState | tuple[()],
        commands: Sequence[ArrayLike],
        elapsed: ArrayLike,
    ) -> tuple[tuple[Array, ...], AirState | tuple[()]]:
        """Return the pressures [Pa] and states of all muscles a time [s] later; see `Valve.after`."""
        muscles = zip(pressures, held_states(states, len(pressures)), commands, strict=True)
        responses = [self.for_muscle(i).after(*muscle, elapsed) for i, muscle in enumerate(muscles)]
        return tuple(response for response, _ in responses), AirState(
            tuple(response for _, response in responses)
        ) if states else ()

    def air_rate(
        self, pressures: Sequence[Scalar], air: AirState, commands: Sequence[ArrayLike], volumes: Sequence[AirVolume]
    ) -> tuple[tuple[Array, ...], AirState]:
        """Return the rates of the pressures [Pa/s] of all muscles, and of the state; see `AirActuator.muscle_rates`."""
        muscles, reservoir = [], self.reservoir
        for i, muscle in enumerate(zip(pressures, air.valves, commands, volumes, strict=True)):
            valve, temperature = self.for_muscle(i), state_of_muscle(air, i)[1]
            inlet = ATMOSPHERE + (valve.supply if reservoir is None else air.reservoir)
            muscles.append(valve.muscle_rates(*muscle, inlet, temperature))
        rates, valves, flows, warming = zip(*muscles, strict=True)
        filled = () if reservoir is None else reservoir.rate(air.reservoir, functools.reduce(operator.add, flows, 0.0))
        return rates, AirState(valves, filled, warming if air.temperatures else ())

    def before_steps(
        self, air: AirState, commands: Sequence[ArrayLike], pressures: Sequence[ArrayLike], step: ArrayLike
    ) -> AirState:
        """Return the states of all muscles before an integration step [s]; see `AirActuator.before_step`."""
        muscles = enumerate(zip(air.valves, commands, pressures, strict=True))
        return air._replace(valves=tuple(self.for_muscle(i).before_step(*muscle, step) for i, muscle in muscles))

    def model_lag(self, joint: AntagonisticJoint, index: int | None = None) -> Any:
        """Return the first-order time constant [s] of small changes in a joint, at one muscle; None if unknown.

        A valve with air determines it from its flow and the volume of the muscle in the middle of its domain.
        """
        return self.lag

    def init_model(self, pressure: Scalar) -> State:
        """Return the state of a controller's model at rest at a pressure [Pa]."""
        return ()

    def predict(self, at: Point, command: ArrayLike, duration: ArrayLike) -> tuple[Scalar, State]:
        """Return the pressure [Pa] and the state of the model a time [s] later, under a constant command [Pa]."""
        return at.pressure + lag_fraction(self.lag, duration) * (command - at.pressure), at.state

    def attainable(self, at: Point, commands: CommandRange, duration: ArrayLike) -> Attainable:
        """Return the pressures that the lowest and the highest command [Pa] reach within a time [s].

        A controller that allocates pressures keeps within them.
        """
        fraction = lag_fraction(self.lag, duration)
        return Attainable(1 - fraction, fraction * commands[0], fraction * commands[1])

    def command_toward(self, at: Point, target: ArrayLike, lag: ArrayLike, period: ArrayLike) -> Scalar:
        """Return the command [Pa] of a control period [s] by which the pressure approaches a target [Pa].

        The pressure follows with a lag [s]: within a period it covers the part 1 - exp(-period / lag) of the way.
        """
        speed = (1 - exp(-jnp.asarray(period) / lag)) / lag_fraction(self.lag, period)
        return at.pressure + speed * (target - at.pressure)

    def fastest_rate_in(self, volume: float) -> float:
        """Return a bound on the rates [1/s] of the integrated states with an air volume [m^3].

        Integration steps resolve it; 0 for a response in closed form, which does not limit the step.
        """
        return 0.0

    def signals(self, state: State, command: ArrayLike, pressure: ArrayLike) -> dict[str, Array]:
        """Return quantities of a run at the actuator of one muscle, by name without the number of the muscle."""
        return {}

    def telemetry(
        self, state: AirState | tuple[()], commands: Sequence[ArrayLike], pressures: Sequence[ArrayLike]
    ) -> dict[str, Array]:
        """Return quantities of a run, by name, from the states, commands [Pa] and pressures [Pa] of all muscles.

        They are the `signals` of each muscle and the temperature [K] of its air, followed by its number, and the
        pressure [Pa] of the reservoir.
        """
        signals: dict[str, Array] = {}
        for i, muscle in enumerate(zip(held_states(state, len(pressures)), commands, pressures, strict=True)):
            signals |= {f"{name}{i + 1}": value for name, value in self.for_muscle(i).signals(*muscle).items()}
        if isinstance(state, AirState):
            signals |= {
                f"temperature{i}": muscle
                for i, muscle in enumerate(state.temperatures, 1)
                if not isinstance(muscle, tuple)
            }
        return signals if self.reservoir is None else {**signals, "reservoir": state.reservoir}  # type: ignore[union-attr]

    def init_states(self, pressures: tuple[Scalar, ...]) -> AirState | tuple[()]:
        """Return the states that hold the pressures [Pa] of all muscles, with the reservoir at its supply pressure.

        The air has room temperature. Empty if there are none in addition to the pressures.
        """
        states = tuple(self.for_muscle(i).init(pressure) for i, pressure in enumerate(pressures))
        if not (self.holds_air or jax.tree.leaves(states)):
            return ()
        reservoir = self.reservoir
        inlet = () if reservoir is None else jnp.full_like(floating(pressures[0]), reservoir.supply)
        conductances = [self.for_muscle(i).wall_conductance for i in range(len(pressures))]
        temperatures = tuple(
            () if conductance is None else jnp.full_like(floating(pressure), TEMPERATURE)
            for conductance, pressure in zip(conductances, pressures, strict=True)
        )
        return AirState(states, inlet, temperatures if jax.tree.leaves(temperatures) else ())

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        """Return the pressure [Pa] right after a new command [Pa]."""
        return jnp.asarray(pressure)

    def command_range(self, rated: Domain) -> CommandRange:
        """Return the lowest and the highest command [Pa] of a muscle: its rated pressures, and the supply if known."""
        supply = getattr(self, "supply", None)
        highest = rated.pressure_max if supply is None else jnp.minimum(jnp.asarray(rated.pressure_max), supply)
        return rated.pressure_min, highest

    def clip_command(self, command: ArrayLike, rated: Domain) -> Float[Array, "..."]:
        """Return a command within its range for a muscle, by `command_range`.

        A supply of 5 bar limits a muscle rated for 8 bar:

        >>> from mckibben import FirstOrderValve
        >>> float(FirstOrderValve(0.02, supply=5e5).clip_command(7e5, Domain(pressure_min=0.0, pressure_max=8e5)))
        500000.0
        """
        return jnp.clip(jnp.asarray(command), *self.command_range(rated))


def held_states(states: AirState | tuple[()], count: int) -> tuple[State, ...]:
    """Return the state of each of a number of actuators; empty ones for actuators without states."""
    return states.valves if isinstance(states, AirState) else ((),) * count
