"""Commands that do not depend on the measurement, for experiments."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Units
from mckibben.control.base import Controller, JointModel, Measurement, Setpoint
from mckibben.control.reference import Signal, as_signal
from mckibben.joint.geometry import Pair
from mckibben.numerics.elementary import floating
from mckibben.units import Pressure

Scalar = Float[Array, ""]

PressureSignal = Annotated[Signal, Units(signal=Pressure)]


class OpenLoopState(NamedTuple):
    """Time since the start [s], and the stiffness by the model [N*m/rad]."""

    time: Scalar
    stiffness: Scalar


class OpenLoopControl(Controller[OpenLoopState]):
    """Commanded pressures over time, independent of the motion: for steps, and for the identification of valves.

    Parameters
    ----------
    pressure1, pressure2
        Commands [Pa] of the muscles: signals, or numbers.
    model
        Model of the joint for the estimate of the stiffness.
    """

    short_name = "open_loop"

    pressure1: PressureSignal = eqx.field(converter=as_signal)
    pressure2: PressureSignal = eqx.field(converter=as_signal)
    model: JointModel

    def init(self, measurement: Measurement) -> OpenLoopState:
        return OpenLoopState(jnp.zeros_like(floating(measurement.angle)), self._stiffness(measurement))

    def step(
        self, state: OpenLoopState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[OpenLoopState, Pair]:
        commands = self.pressure1(state.time), self.pressure2(state.time)
        return OpenLoopState(state.time + period, self._stiffness(measurement)), commands

    def telemetry(self, state: OpenLoopState) -> dict[str, Scalar]:
        return {"stiffness_estimate": state.stiffness}

    def _stiffness(self, measurement: Measurement) -> Scalar:
        return self.model.evaluate(*measurement)[1]
