"""Interfaces of controllers: configuration with explicit state."""

from __future__ import annotations

import abc
import dataclasses
import operator
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator import Actuator
from mckibben.component.base import Component, Inherited, Units
from mckibben.component.columns import Labelled
from mckibben.component.schema import inherited_fields, replaced
from mckibben.control.reference import ReferenceDerivatives, Signal, as_signal
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Load, Measurement
from mckibben.muscle import Muscle
from mckibben.units import Angle, Stiffness

Scalar = Float[Array, ""]
State = TypeVar("State")
"""A pytree of arrays that a controller, or a part of one, carries from one control period to the next."""


class Setpoint(NamedTuple):
    """Reference at an instant: angle [rad] and stiffness [N*m/rad]."""

    angle: Scalar
    stiffness: Scalar


class Reference(Component):
    """Reference of the joint's angle [rad] and stiffness [N*m/rad] over time; of a single muscle the angle alone.

    Each is a signal, another function of time by `jax.numpy`, or a plain number, which is a constant.
    """

    aliases: ClassVar = {"position": ("angle",)}

    angle: Annotated[Signal | Any, Units(signal=Angle)] = eqx.field(converter=as_signal)
    stiffness: Annotated[Signal | Any, Units(signal=Stiffness)] = eqx.field(converter=as_signal, default=None)

    def __call__(self, time: ArrayLike) -> Setpoint:
        """Setpoint at each time [s]; NaN for no stiffness."""
        angle = self.angle(time)
        return Setpoint(angle, jnp.full_like(angle, jnp.nan) if self.stiffness is None else self.stiffness(time))

    def finite(self, setpoint: Setpoint) -> Setpoint:
        """Return a setpoint of this reference; that of the stiffness, if there is none, is 0 in place of NaN."""
        return setpoint if self.stiffness is not None else setpoint._replace(stiffness=jnp.zeros_like(setpoint.angle))

    def held(self) -> Reference:
        """Return its first setpoint, held."""
        stiffness = None if self.stiffness is None else float(self.stiffness(0.0))
        return Reference(float(self.angle(0.0)), stiffness)


JointModel = Annotated[AntagonisticJoint, Inherited(lambda scope: scope["joint"])]
"""A controller's model of the joint; in a file, by default, the joint of the plant."""
LoadModel = Annotated[Load, Inherited(lambda scope: scope["load"])]
"""A controller's model of the load; in a file, by default, that of the plant."""


def _valve_model(scope: Mapping[str, Actuator]) -> Actuator:
    """Valve of the plant; `KeyError` if its response is unknown, and a file must give a model of it."""
    valve = scope["valve"]
    if not valve.holds_air and valve.lag is None:
        raise KeyError("valve")
    return valve


ValveModel = Annotated[Actuator, Inherited(_valve_model)]
"""A controller's model of the valves; in a file, by default, the valve of the plant."""


def check_valve_model(owner: str, valve: Actuator, muscles: Sequence[Muscle]) -> None:
    """Raise `RangeError` if the response of a model of the valves at muscles is unknown."""
    if valve.holds_air:
        for muscle in muscles:
            muscle.specimen.check_volume(f"a {type(valve).__name__} as the model of the valves")
    elif valve.lag is None:
        message = f"{owner}: the time constant of a {type(valve).__name__} is unknown"
        remedy = "give the controller a `valve` with a time_constant, or the class a property `lag`"
        raise RangeError(message, field="valve", remedy=remedy)


class DiscreteTimeSystem(Labelled, Component, Generic[State]):
    """Discrete-time system with explicit state, driven by measurements; the caller determines the time.

    `init` is called once, and `step` once per control period.
    """

    follows_reference: ClassVar[bool] = True
    """Whether the setpoints of its steps are those of references; else they are the times [s]."""
    samples_ahead = 0
    """Control periods by which the setpoints of the steps come early."""

    def with_period(self, period: float) -> Self:
        """Return the system for a control period [s], where the size of its state depends on it."""

        def prepared(part: object) -> object:
            if type(part) is tuple:
                parts = tuple(map(prepared, part))
                return part if all(map(operator.is_, parts, part)) else parts
            return part.with_period(period) if isinstance(part, DiscreteTimeSystem) else part

        parts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        inner = {name: after for name, part in parts.items() if (after := prepared(part)) is not part}
        return dataclasses.replace(self, **inner) if inner else self

    @abc.abstractmethod
    def init(self, measurement: PyTree) -> State:
        """Return the state before the first step."""

    @abc.abstractmethod
    def step(
        self, state: State, setpoint: PyTree, measurement: PyTree, period: ArrayLike, /
    ) -> tuple[State, tuple[PyTree, ...]]:
        """Return the next state, and the outputs for the coming control period [s]."""

    def desired_angle(self, setpoint: PyTree) -> PyTree:
        """Return the desired angle [rad] of a setpoint."""
        return setpoint.angle

    def telemetry(self, state: State) -> dict[str, Array]:
        """Return the signals to record each period, by name."""
        return {}

    def foresee(self, state: State, setpoint: PyTree, period: ArrayLike) -> State:
        """Return the state before the first step after one of the setpoints that precede that of this step."""
        return state

    def ahead(self, setpoints: PyTree, period: ArrayLike) -> PyTree:
        """Return the setpoints of the steps of a run, each `samples_ahead`, from those of its control periods [s]."""
        if not (count := self.samples_ahead):
            return setpoints
        return jax.tree.map(lambda values: values[count:], extended(setpoints, count, period))

    def foreseeing(self, state: State, setpoints: PyTree, period: ArrayLike) -> State:
        """Return the state before the first step that knows the setpoints of a run before those of the step."""
        if not (count := self.samples_ahead):
            return state
        first = jax.tree.map(lambda values: values[:count], extended(setpoints, count, period))
        return lax.scan(lambda held, setpoint: (self.foresee(held, setpoint, period), None), state, first)[0]


class Delegated:
    """Field of the controller that a controller wraps, for a class without a field of that name; None without one."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, controller: Controller | None, owner: type) -> float | None:
        inner = [] if controller is None else list(controllers_within(controller))[1:]
        return getattr(inner[0], self.name) if inner else None


def controllers_within(controller: Controller) -> Iterator[Controller]:
    """A controller, and those that it wraps."""
    yield controller
    for part in vars(controller).values():
        if isinstance(part, Controller):
            yield from controllers_within(part)


class Controller(DiscreteTimeSystem[State]):
    """Interface from a setpoint and measurements of a joint to pressure commands.

    A controller may hold a model of the joint, never the plant. One that wraps another in a field controls what that
    one does: `stiffness_amplitude` and `minimum_tension` are those of the inner controller.
    """

    default_class = "position_stiffness"

    stiffness_amplitude = Delegated()
    """Amplitude [rad] of the motion whose stiffness is controlled; None for the isobaric stiffness."""
    minimum_tension = Delegated()
    """Lower limit of each muscle's tension [N]; None without one."""

    @abc.abstractmethod
    def init(self, measurement: Measurement) -> State:
        """Return the state before the first step, for a bumpless start from the measured pressures."""

    @abc.abstractmethod
    def step(
        self, state: State, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[State, tuple[Scalar, Scalar]]:
        """Return the next state, and the commands [Pa] for the coming control period [s]."""

    @abc.abstractmethod
    def telemetry(self, state: State) -> dict[str, Scalar]:
        """Return the signals to record each period, by name.

        At least ``stiffness_estimate`` [N*m/rad]; ``saturated`` where the controller limits its own commands.
        """


def field_of(controller: DiscreteTimeSystem, name: str) -> Any:
    """Return the field of a controller, or of the one that it wraps; None without."""
    own = getattr(controller, name, None)
    return own if own is not None else next((field_of(inner, name) for inner in _inner(controller).values()), None)


def with_fields(controller: DiscreteTimeSystem, fields: Mapping[str, Any]) -> Any:
    """Return a controller with other values of the fields that it, or one that it wraps, has and does not inherit."""
    stated = {name for name, value in vars(controller).items() if value is not None} - inherited_fields(controller)
    own = {name: value for name, value in fields.items() if name in stated}
    return replaced(controller, own | {name: with_fields(inner, fields) for name, inner in _inner(controller).items()})


def _inner(controller: DiscreteTimeSystem) -> dict[str, Controller]:
    return {name: field for name, field in vars(controller).items() if isinstance(field, Controller)}


def extended(setpoints: Setpoint | tuple[Setpoint, ...], count: int, period: ArrayLike) -> Any:
    """Setpoints [rad, N*m/rad], shape (periods, ...), or those of each joint, and further ones, extrapolated."""
    if not isinstance(setpoints, Setpoint):
        return tuple(extended(joint, count, period) for joint in setpoints)
    angle, stiffness = map(jnp.asarray, setpoints)
    last = ReferenceDerivatives.init(angle[0])
    for sample in angle[-4:]:
        last = last.update(sample, period)
    times = jnp.arange(1, count + 1).reshape(-1, *[1] * (angle.ndim - 1)) * period
    held = jnp.broadcast_to(stiffness[-1:], (count, *stiffness.shape[1:]))
    return Setpoint(jnp.concatenate([angle, last.after(times).angle]), jnp.concatenate([stiffness, held]))


class Loop(Component, Generic[State]):
    """Scalar feedback loop, a part of a controller."""

    default_class = "pid"

    @abc.abstractmethod
    def init(self, setpoint: ArrayLike, measured: ArrayLike, output: ArrayLike) -> State:
        """Return the state from which a loop without error continues with `output`."""

    @abc.abstractmethod
    def step(self, state: State, setpoint: ArrayLike, measured: ArrayLike, period: ArrayLike) -> tuple[State, Scalar]:
        """Return the next state and the output, one control period [s] later."""

    @abc.abstractmethod
    def track(self, state: State, output: ArrayLike, achieved: ArrayLike, period: ArrayLike) -> State:
        """Return the state after an output of which only `achieved` was possible (anti-windup)."""

    @abc.abstractmethod
    def telemetry(self, state: State) -> dict[str, Scalar]:
        """Return the signals to record each period, by name."""
