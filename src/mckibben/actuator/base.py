"""Actuators: how the pressure in a muscle follows its command."""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import Domain

Scalar = Float[Array, ""]


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


class Actuator(Component):
    """Response of the pressures of the muscles to their commands; one for each muscle, all alike.

    The state of an actuator is the pressure, and what it holds beside it (`init`). Derive a closed form over a
    constant command from `Valve`, and one whose pressures follow from mass flow and volume from `AirValve`.
    Other packages ask for the properties below, never for the class.
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
        """Return the first-order time constant [s] for a controller's model of a joint; None if unknown."""
        return None

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
