"""Controller of a planned jump: its commands over the time of the plan, which touchdown sets."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.columns import Label
from mckibben.errors import RangeError
from mckibben.leg.control import LegController
from mckibben.leg.plant import LegMeasurement
from mckibben.numerics.batching import RANK
from mckibben.numerics.elementary import floating
from mckibben.units import Instant, PositiveTime, ShortTime, Tension, ms

Scalar = Float[Array, ""]


class PlannedState(NamedTuple):
    """Time of the plan [s], and whether the foot has landed."""

    time: Scalar
    landed: Array


class PlannedControl(LegController):
    """Commands of a plan, as a table over its time, which touchdown sets.

    In flight the time of the plan advances to that of its touchdown at most; when the foot touches the ground, it is
    set to that time. Thus an early and a late landing have the planned commands.

    Parameters
    ----------
    commands
        Gauge pressures [Pa] of the muscles, one row per time.
    interval
        Time between two rows [s]; commands are linear between them.
    take_off, touchdown
        Times of the plan [s].
    blanking
        Time after take-off [s] in which contact is not a touchdown.
    threshold
        Force [N] on the foot that counts as contact.
    """

    telemetry_labels: ClassVar = {"plan_time": Label("s", "time of the plan")}

    commands: Any = eqx.field(converter=floating, metadata={RANK: 2})
    interval: PositiveTime
    take_off: Instant
    touchdown: Instant
    blanking: ShortTime = 20 * ms
    threshold: Tension = 2.0

    def __check_init__(self) -> None:
        super().__check_init__()
        shape = np.shape(self.commands)
        if len(shape) < 2 or shape[-2] < 2:
            raise RangeError(
                f"commands of the shape {shape}",
                field="commands",
                value=shape,
                remedy="give one row for each time of the plan, two at least",
            )

    def init(self, measurement: LegMeasurement) -> PlannedState:
        return PlannedState(jnp.zeros_like(measurement.ground_force), jnp.asarray(False))

    def step(
        self, state: PlannedState, time: ArrayLike, measurement: LegMeasurement, period: ArrayLike
    ) -> tuple[PlannedState, tuple[Array, ...]]:
        touching = measurement.ground_force > self.threshold
        flying = (state.time > self.take_off + self.blanking) & ~state.landed
        held = jnp.where(touching, self.touchdown, jnp.minimum(state.time, self.touchdown))
        now = jnp.where(flying, held, state.time)
        rows, columns = self.commands.shape
        at = jnp.clip((now + period / 2) / self.interval, 0.0, rows - 1.0)  # at the middle of the period
        index = jnp.minimum(at.astype(int), rows - 2)
        before, after = lax.dynamic_slice(self.commands, (index, 0), (2, columns))
        part = at - index
        commands = tuple(before[i] + part * (after[i] - before[i]) for i in range(columns))
        return PlannedState(now + period, state.landed | (flying & touching)), commands

    def telemetry(self, state: PlannedState) -> dict[str, Array]:
        return {"plan_time": state.time}
