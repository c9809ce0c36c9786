"""Interfaces of controllers: configuration with explicit state."""

from __future__ import annotations

import abc
import dataclasses
import operator
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, Self

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator import Actuator
from mckibben.component.base import Component, Inherited, Units
from mckibben.component.columns import Labelled
from mckibben.control.reference import Signal, as_signal
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Load, Measurement
from mckibben.units import Angle, Stiffness

Scalar = Float[Array, ""]


class Setpoint(NamedTuple):
    """Reference at an instant: angle [rad] and stiffness [N*m/rad]."""

    angle: Scalar
    stiffness: Scalar


class Reference(Component):
    """Reference of the joint's angle [rad] and stiffness [N*m/rad] over time.

    Each is a signal, another function of time by `jax.numpy`, or a plain number, which is a constant.
    """

    angle: Annotated[Signal | Any, Units(signal=Angle)] = eqx.field(converter=as_signal)
    stiffness: Annotated[Signal | Any, Units(signal=Stiffness)] = eqx.field(converter=as_signal)

    def __call__(self, time: ArrayLike) -> Setpoint:
        """Setpoint at each time [s]."""
        return Setpoint(self.angle(time), self.stiffness(time))


JointModel = Annotated[AntagonisticJoint, Inherited(lambda scope: scope["joint"])]
"""A controller's model of the joint; in a file, by default, the joint of the plant."""
LoadModel = Annotated[Load, Inherited(lambda scope: scope["load"])]
"""A controller's model of the load; in a file, by default, that of the plant."""


def _valve_model(scope: Mapping[str, Any]) -> Any:
    """Valve of the plant; `KeyError` if its response is unknown, and a file must give a model of it."""
    valve = scope["valve"]
    if not valve.holds_air and valve.lag is None:
        raise KeyError("valve")
    return valve


ValveModel = Annotated[Actuator, Inherited(_valve_model)]
"""A controller's model of the valves; in a file, by default, the valve of the plant."""


def check_valve_model(owner: str, valve: Actuator, joint: AntagonisticJoint) -> None:
    """Raise `RangeError` if the response of a model of the valves in a joint is unknown."""
    if valve.holds_air:
        for muscle in (joint.muscle1, joint.muscle2):
            muscle.specimen.check_volume(f"a {type(valve).__name__} as the model of the valves")
    elif valve.lag is None:
        message = f"{owner}: the time constant of a {type(valve).__name__} is unknown"
        remedy = "give the controller a `valve` with a time_constant, or the class a property `lag`"
        raise RangeError(message, field="valve", remedy=remedy)


class DiscreteTimeSystem(Labelled, Component):
    """Discrete-time system with explicit state, driven by measurements; the caller determines the time.

    `init` is called once, and `step` once per control period.
    """

    def with_period(self, period: float) -> Self:
        """Return the system for a control period [s], where the size of its state depends on it."""

        def prepared(part: Any) -> Any:
            if type(part) is tuple:
                parts = tuple(map(prepared, part))
                return part if all(map(operator.is_, parts, part)) else parts
            return part.with_period(period) if isinstance(part, DiscreteTimeSystem) else part

        parts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        inner = {name: after for name, part in parts.items() if (after := prepared(part)) is not part}
        return dataclasses.replace(self, **inner) if inner else self

    @abc.abstractmethod
    def init(self, measurement: Any) -> Any:
        """Return the state before the first step."""

    @abc.abstractmethod
    def step(self, state: Any, setpoint: Any, measurement: Any, period: ArrayLike, /) -> tuple[Any, tuple[Any, ...]]:
        """Return the next state, and the outputs for the coming control period [s]."""

    def telemetry(self, state: Any) -> dict[str, Array]:
        """Return the signals to record each period, by name."""
        return {}


class Controller(DiscreteTimeSystem):
    """Interface from a setpoint and measurements of a joint to pressure commands.

    A controller may hold a model of the joint, never the plant.
    """

    default_class = "position_stiffness"
    stiffness_amplitude = None
    """Amplitude [rad] of the motion whose stiffness is controlled; None for the isobaric stiffness."""

    @abc.abstractmethod
    def init(self, measurement: Measurement) -> Any:
        """Return the state before the first step, for a bumpless start from the measured pressures."""

    @abc.abstractmethod
    def step(
        self, state: Any, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[Any, tuple[Scalar, Scalar]]:
        """Return the next state, and the commands [Pa] for the coming control period [s]."""

    @abc.abstractmethod
    def telemetry(self, state: Any) -> dict[str, Scalar]:
        """Return the signals to record each period, by name.

        At least ``stiffness_estimate`` [N*m/rad]; ``saturated`` where the controller limits its own commands.
        """


class Loop(Component):
    """Scalar feedback loop, a part of a controller."""

    default_class = "pid"

    @abc.abstractmethod
    def init(self, setpoint: ArrayLike, measured: ArrayLike, output: ArrayLike) -> Any:
        """Return the state from which a loop without error continues with `output`."""

    @abc.abstractmethod
    def step(
        self, state: Any, setpoint: ArrayLike, measured: ArrayLike, sensitivity: ArrayLike, period: ArrayLike
    ) -> tuple[Any, Scalar]:
        """Return the next state and the output, one control period [s] later.

        `sensitivity` is the static gain of the model, controlled quantity per output; loops may ignore it.
        """

    @abc.abstractmethod
    def track(self, state: Any, output: ArrayLike, achieved: ArrayLike, period: ArrayLike) -> Any:
        """Return the state after an output of which only `achieved` was possible (anti-windup)."""

    @abc.abstractmethod
    def telemetry(self, state: Any) -> dict[str, Scalar]:
        """Return the signals to record each period, by name."""
