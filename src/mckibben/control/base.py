"""Interfaces of controllers: configuration with explicit state."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component, check_fields
from mckibben.component.checks import check_within
from mckibben.control.reference import Samples, Signal, as_signal, terms
from mckibben.joint import Measurement
from mckibben.units import Angle, Stiffness

Scalar = Float[Array, ""]

_ANGLE, _STIFFNESS = (kind.__metadata__[0] for kind in (Angle, Stiffness))  # type: ignore[attr-defined]


class Setpoint(NamedTuple):
    """Reference at an instant: angle [rad] and stiffness [N*m/rad]."""

    angle: Scalar
    stiffness: Scalar


class Reference(Component):
    """Reference of the joint's angle [rad] and stiffness [N*m/rad] over time; a plain number is a constant."""

    angle: Any = eqx.field(converter=as_signal)  # a signal, or another function of time by `jax.numpy`
    stiffness: Any = eqx.field(converter=as_signal)

    def __check_init__(self) -> None:
        for signal, quantity in ((self.angle, _ANGLE), (self.stiffness, _STIFFNESS)):
            for part in terms(signal):
                if isinstance(part, Samples):
                    lower, upper = quantity.limits
                    check_within("Samples", lower, upper, quantity.unit, values=part.values)
                elif isinstance(part, Signal):
                    check_fields(part, quantity)

    def __call__(self, time: ArrayLike) -> Setpoint:
        """Setpoint at each time [s]."""
        return Setpoint(self.angle(time), self.stiffness(time))


class Controller(Component):
    """Interface from measurements to pressure commands.

    A controller may hold a model of the joint, never the plant. The simulation owns time: it calls `init` once and
    `step` once a control period.
    """

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
