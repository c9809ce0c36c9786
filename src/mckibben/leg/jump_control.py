"""Commands of a planned jump for its valves, and the controller that gives them over the time of the plan."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.actuator.base import AirVolume
from mckibben.component.columns import Label
from mckibben.errors import RangeError
from mckibben.leg.control import LegController
from mckibben.leg.plant import LegMeasurement, LegPlant
from mckibben.numerics.batching import RANK
from mckibben.numerics.compiled import jit
from mckibben.numerics.elementary import floating
from mckibben.units import Instant, PositiveTime, ShortTime, Tension, ms

Scalar = Float[Array, ""]
Floats = NDArray[np.float64]


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


def planned_commands(
    plant: LegPlant, times: Floats, angles: Floats, pressures: Floats, period: float
) -> tuple[Floats, Floats]:
    """Return commands [Pa] at the times, and the pressures that follow by the model of the valves, (times, muscles)."""
    from scipy.interpolate import make_interp_spline

    fine = period * np.arange(int(np.ceil(times[-1] / period)) + 1)
    within = np.minimum(fine, times[-1])
    paths = [make_interp_spline(times, one)(within) for one in (angles, pressures)]
    rates = np.gradient(paths[0], period, axis=0)
    commands, reached = _valves(plant, paths[0], paths[1], rates, np.asarray(period))
    hats = np.maximum(0.0, 1 - np.abs(fine - times[:, None]) / (times[1] - times[0]))  # means: less would alias
    means = hats @ np.asarray(commands) / hats.sum(axis=1, keepdims=True)
    return means, np.stack([np.interp(times, fine, column) for column in np.asarray(reached).T], -1)


@jit
def _valves(plant: LegPlant, angles: Any, pressures: Any, rates: Any, period: Any) -> tuple[Array, Array]:
    """Commands that lead the pressures along a plan, by the model that controllers have of the valves."""
    leg, valve, dead = plant.leg, plant.valve, plant.valve.attached_volume
    each = [valve.for_muscle(i) for i in range(len(leg.muscles))]
    ranges = [one.command_range(muscle.domain) for one, muscle in zip(each, leg.muscles, strict=True)]

    def volumes(at: Array, rate: Array) -> list[AirVolume | None]:
        if not valve.holds_air:
            return [None] * len(each)

        def held(q: Array) -> Array:
            muscles = [(one.muscle.specimen, one.path) for one in leg.routed_muscles(leg.held(tuple(q)))]
            return jnp.stack([specimen.volume(specimen.contraction_at(path)) for specimen, path in muscles])

        found, slopes = jax.jvp(held, (at,), (rate,))
        return [AirVolume(found[i] + dead, slopes[i]) for i in range(len(each))]

    def advance(state: Any, row: tuple[Array, ...]) -> tuple[Any, tuple[Array, Array]]:
        at, rate, target = row
        following, commands = [], []
        for i, ((pressure, held), air) in enumerate(zip(state, volumes(at, rate), strict=True)):
            command = each[i].command_toward(pressure, held, target[i], air, period, period)
            command = jnp.clip(command, *ranges[i])
            following.append(each[i].predict(pressure, held, command, air, period))
            commands.append(command)
        return following, (jnp.stack(commands), jnp.stack([one for one, _ in state]))

    start = [(pressures[0, i], each[i].init_model(pressures[0, i])) for i in range(len(each))]
    targets = jnp.concatenate([pressures[1:], pressures[-1:]])
    return lax.scan(advance, start, (angles, rates, targets))[1]
