"""Dither of the commands, which lets an estimate in service tell the stiffness of a joint that moves little."""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.reference import Multisine
from mckibben.joint.geometry import Pair
from mckibben.numerics.elementary import floating
from mckibben.units import Frequency, Pressure

Scalar = Float[Array, ""]


class DitherState(NamedTuple):
    """State of the inner controller, and time since the start [s]."""

    inner: PyTree
    time: Scalar


class Dither(Controller[DitherState]):
    """Wrapper that adds sines to the differential pressure of any controller's commands.

    Parameters
    ----------
    controller
        The controller.
    amplitude
        Of each muscle's command [Pa], the sum of those of all sines.
    frequencies
        Of the sines [Hz], with phases of a low crest (M. Schroeder, 1970).
    """

    short_name = "dither"

    controller: Controller = eqx.field(kw_only=True)
    amplitude: Pressure = eqx.field(kw_only=True)
    frequencies: tuple[Frequency, ...] = eqx.field(kw_only=True, default=(1.0, 1.7, 2.6, 3.7))

    def init(self, measurement: Measurement) -> DitherState:
        return DitherState(self.controller.init(measurement), jnp.zeros_like(floating(measurement.angle)))

    def step(
        self, state: DitherState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DitherState, Pair]:
        inner, (first, second) = self.controller.step(state.inner, setpoint, measurement, period)
        count = len(self.frequencies)
        phases = tuple(math.pi * k * k / count % (2 * math.pi) for k in range(count))
        added = Multisine((self.amplitude / count,) * count, self.frequencies, phases)(state.time)
        return DitherState(inner, state.time + period), (first - added, second + added)

    @property
    def samples_ahead(self) -> int:  # type: ignore[override]
        return self.controller.samples_ahead

    def foresee(self, state: DitherState, setpoint: Setpoint, period: ArrayLike) -> DitherState:
        return state._replace(inner=self.controller.foresee(state.inner, setpoint, period))

    def telemetry(self, state: DitherState) -> dict[str, Scalar]:
        return self.controller.telemetry(state.inner)
