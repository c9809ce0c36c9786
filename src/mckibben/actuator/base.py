"""Actuators: how the pressure in a muscle follows its command."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.columns import Labelled
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, RigidTendon
from mckibben.joint.antagonistic import NO_STATES, MuscleStates
from mckibben.muscle import Domain
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import exp

Scalar = Float[Array, ""]

_MOST_PERIODS = 100  # of a command delay
_ROUNDING = 1e-9  # periods


class AirState(NamedTuple):
    """State of the actuator of each muscle, and the gauge pressure [Pa] of the reservoir where there is one."""

    valves: tuple[Any, ...]
    reservoir: Any = ()


class AirVolume(NamedTuple):
    """Volume [m^3] of the air of a muscle, its rate [m^3/s] at constant pressure, and derivative by it [m^3/Pa]."""

    volume: Array
    rate: Array
    by_pressure: Array | None = None

    def effective(self, index: ArrayLike, pressure: ArrayLike) -> Array:
        """Return the volume [m^3] for `pressure_rate` at an absolute pressure [Pa]."""
        return self.volume if self.by_pressure is None else self.volume + index * pressure * self.by_pressure


def air_volumes(
    joint: AntagonisticJoint,
    angle: ArrayLike,
    velocity: ArrayLike,
    pressures: tuple[Scalar, Scalar],
    states: MuscleStates = NO_STATES,
    dead_volume: ArrayLike = 0.0,
) -> tuple[AirVolume, AirVolume]:
    """Return the volumes of the air in the muscles of a joint, dead volume [m^3] included, at a velocity [rad/s]."""

    def volumes(angle: ArrayLike, pressures: tuple[Scalar, Scalar]) -> tuple[Array, Array]:
        contraction1, contraction2 = joint.contractions(angle, pressures, states)
        specimen1, specimen2 = joint.muscle1.specimen, joint.muscle2.specimen
        return specimen1.volume(contraction1) + dead_volume, specimen2.volume(contraction2) + dead_volume

    at, slopes = value_and_derivative(lambda angle: volumes(angle, pressures), angle)
    by_pressure: Any = (None, None)
    if not isinstance(joint.tendon, RigidTendon):
        ones = jax.tree.map(jnp.ones_like, pressures)
        by_pressure = jax.jvp(lambda held: volumes(angle, held), (pressures,), (ones,))[1]
    volume1, volume2 = map(AirVolume, at, (slope * velocity for slope in slopes), by_pressure)
    return volume1, volume2


def lag_fraction(time_constant: ArrayLike, duration: ArrayLike) -> Scalar:
    """Part of a step that a first-order lag, 0 for none, covers within a time [s]."""
    lag = jnp.asarray(time_constant)
    return jnp.where(lag > 0, 1 - exp(-jnp.asarray(duration) / jnp.where(lag > 0, lag, 1.0)), 1.0)


def delay_periods(command_delay: ArrayLike, period: float) -> int:
    """Return the control periods [s] that hold the commands within a delay [s], the longest of several delays.

    Raises `RangeError` for more than 100.
    """
    longest = float(np.max(command_delay))
    periods = math.ceil(longest / period - _ROUNDING)
    if periods > _MOST_PERIODS:
        raise RangeError(
            f"a command delay of {longest:g} s is {periods} control periods of {period:g} s",
            field="command_delay",
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


class Actuator(Labelled, Component):
    """Response of the pressures of the muscles to their commands; one for each muscle, all alike.

    The state of an actuator is the pressure, and what it holds beside it (`init`). Derive a closed form over a
    constant command from `Valve`, and one whose pressures follow from mass flow and volume from `AirValve`.
    Other packages ask for the properties below, never for the class.

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
    reservoir_volume = None
    """Volume [m^3] of air at the inlets, None for a constant pressure there."""

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

    @abc.abstractmethod
    def init(self, pressure: Scalar) -> Any:
        """Return the state that holds a pressure [Pa], without the pressure itself."""

    @abc.abstractmethod
    def rates(
        self,
        pressures: Sequence[Scalar],
        states: AirState | tuple[()],
        commands: Sequence[ArrayLike],
        volumes: Callable[[], Sequence[AirVolume]],
    ) -> tuple[tuple[Array, ...], AirState | tuple[()]]:
        """Return the time derivatives of the pressures [Pa/s] and of the states of all muscles."""

    def model_lag(self, joint: AntagonisticJoint) -> Any:
        """Return the first-order time constant [s] of small changes in a joint; None if unknown."""
        return self.lag

    def init_model(self, pressure: Scalar) -> Any:
        """Return the state of a controller's model at rest at a pressure [Pa]."""
        return ()

    def predict(
        self, pressure: Scalar, state: Any, command: ArrayLike, air: AirVolume | None, duration: ArrayLike
    ) -> tuple[Scalar, Any]:
        """Return the pressure [Pa] and the state of the model a time [s] later, under a constant command [Pa].

        `air` is the volume of the muscle, given to actuators that have `holds_air`.
        """
        return pressure + lag_fraction(self.lag, duration) * (command - pressure), state

    def attainable(
        self,
        pressure: Scalar,
        state: Any,
        commands: tuple[ArrayLike, ArrayLike],
        air: AirVolume | None,
        duration: ArrayLike,
    ) -> Attainable:
        """Return the pressures that the lowest and the highest command [Pa] reach within a time [s]."""
        fraction = lag_fraction(self.lag, duration)
        return Attainable(1 - fraction, fraction * commands[0], fraction * commands[1])

    def command_toward(
        self, pressure: Scalar, state: Any, target: ArrayLike, air: AirVolume | None, lag: ArrayLike, period: ArrayLike
    ) -> Scalar:
        """Return the command [Pa] of a control period [s] by which the pressure approaches a target [Pa].

        The pressure follows with a lag [s]: within a period it covers the part 1 - exp(-period / lag) of the way.
        """
        speed = (1 - exp(-jnp.asarray(period) / lag)) / lag_fraction(self.lag, period)
        return pressure + speed * (target - pressure)

    def fastest_rate_in(self, volume: float) -> float:
        """Return a bound on the rates [1/s] of the integrated states with an air volume [m^3]."""
        return 0.0

    def telemetry(
        self, state: AirState | tuple[()], commands: Sequence[ArrayLike], pressures: Sequence[ArrayLike]
    ) -> dict[str, Array]:
        """Return quantities of a run, by name, from the states, commands [Pa] and pressures [Pa] of both muscles."""
        return {}

    def init_states(self, pressures: tuple[Scalar, ...]) -> AirState | tuple[()]:
        """Return the states that hold the pressures [Pa] of all muscles; empty if there are none beside these."""
        states = tuple(map(self.init, pressures))
        return AirState(states) if jax.tree.leaves(states) else ()

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        """Return the pressure [Pa] right after a new command [Pa]."""
        return jnp.asarray(pressure)

    def command_range(self, rated: Domain) -> tuple[ArrayLike, ArrayLike]:
        """Return the lowest and the highest command [Pa] of a muscle: its rated pressures, and the supply if known."""
        supply = getattr(self, "supply", None)
        highest = rated.pressure_max if supply is None else jnp.minimum(jnp.asarray(rated.pressure_max), supply)
        return rated.pressure_min, highest

    def clip_command(self, command: ArrayLike, rated: Domain) -> Float[Array, "..."]:
        """Return a command within its range for a muscle."""
        return jnp.clip(jnp.asarray(command), *self.command_range(rated))


def held_states(states: AirState | tuple[()], count: int) -> tuple[Any, ...]:
    """Return the state of each of a number of actuators; empty ones for actuators without."""
    return states.valves if isinstance(states, AirState) else ((),) * count
