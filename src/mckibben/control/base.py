"""What a controller is: configuration; its state is a value that goes in and comes out."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.reference import Signal, as_signal
from mckibben.joint import Measurement

Scalar = Float[Array, ""]


class Setpoint(NamedTuple):
    """What is wanted now: angle [rad] and stiffness [N*m/rad]."""

    angle: Scalar
    stiffness: Scalar


class Reference(eqx.Module):
    """What is wanted over time: the joint's angle [rad] and its stiffness [N*m/rad] at once.

    A plain number is a constant.
    """

    angle: Signal = eqx.field(converter=as_signal)
    stiffness: Signal = eqx.field(converter=as_signal)

    def __call__(self, time: ArrayLike) -> Setpoint:
        """The wish at each time [s]."""
        return Setpoint(self.angle(time), self.stiffness(time))


class Controller(eqx.Module):
    """Measurements in, pressure commands out. It may hold a model of the joint, never the plant.

    The simulation alone owns time: it calls `init` once and `step` once a control period.
    """

    @abc.abstractmethod
    def init(self, measurement: Measurement) -> Any:
        """The state before the first step; it takes over from the pressures as they are."""

    @abc.abstractmethod
    def step(
        self, state: Any, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[Any, tuple[Scalar, Scalar]]:
        """The next state, and the commands [Pa] to hold over the coming control period [s]."""

    @abc.abstractmethod
    def telemetry(self, state: Any) -> dict[str, Scalar]:
        """What is worth recording each period, by name.

        At least ``stiffness_estimate`` [N*m/rad]; ``saturated`` where it cuts its own commands off at a limit.
        """


class Loop(eqx.Module):
    """One scalar feedback loop, a part of a controller."""

    @abc.abstractmethod
    def init(self, desired: ArrayLike, measured: ArrayLike, output: ArrayLike) -> Any:
        """The state before the first step, such that a loop without error goes on with `output`."""

    @abc.abstractmethod
    def step(
        self, state: Any, desired: ArrayLike, measured: ArrayLike, sensitivity: ArrayLike, period: ArrayLike
    ) -> tuple[Any, Scalar]:
        """The next state and the output.

        Parameters
        ----------
        state
            From `init` or the last step.
        desired, measured
            Wish and measurement of the controlled quantity.
        sensitivity
            The model's static change of the controlled quantity per change of the output; loops may ignore it.
        period
            The control period [s].
        """

    @abc.abstractmethod
    def realised(self, state: Any, output: ArrayLike, realised: ArrayLike, period: ArrayLike) -> Any:
        """The state once it is known what could be realised of the output: anti-windup."""

    @abc.abstractmethod
    def telemetry(self, state: Any) -> dict[str, Scalar]:
        """What is worth recording each period, by name."""
