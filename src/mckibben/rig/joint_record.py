"""Record of a run, the run as a simulation result, and its timing."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.component.columns import attributes
from mckibben.control.base import Setpoint
from mckibben.muscle import MuscleState, NoCreep, NoFriction
from mckibben.plant import JointPlant, Plant, PlantState
from mckibben.result import Column, Listing, Remark
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import rated_commands
from mckibben.simulation import Feasibility, SimulationResult
from mckibben.simulation.result import columns_of_run
from mckibben.simulation.trajectories import Record
from mckibben.storage import mcap


class Phase(enum.IntEnum):
    """The parts of a run."""

    PROBING = -1
    RAISING = 0
    SETTLING = 1
    RUN = 2
    VENTING = 3


_SAMPLE = (
    ("time", "s", "float64"),
    ("sample", "1", "int64"),
    ("phase", "1", "int8"),
    ("read_at", "s", "float64"),
    ("commanded_at", "s", "float64"),
)
COMMANDED_AT = 4
"""Place in a row."""


class RowLayout(NamedTuple):
    """Places of the readings, the references and the commands in a row; `limited` follows the commands."""

    readings: slice
    references: slice
    commands: slice

    @classmethod
    def of(cls, channels: Channels) -> RowLayout:
        """Layout of the rows of a rig."""
        joints, muscles = len(channels.joints), len(channels.muscles)
        first, second = len(_SAMPLE) + joints + muscles, len(_SAMPLE) + 3 * joints + muscles
        return cls(slice(len(_SAMPLE), first), slice(first, second), slice(second, second + muscles))


def columns(telemetry: Sequence[str], channels: Channels = Channels()) -> list[mcap.Column]:  # noqa: B008
    """Columns of a record; the telemetry of the controller has the prefix ``controller_``.

    Without a command, those from `commanded_at` on are NaN, but for the reading.
    """
    kind, unit = channels.joint_type, channels.joint_type.unit
    parts = (
        (channels.by_joint("angle"), unit("rad")),
        (channels.by_muscle("pressure"), "Pa"),
        (channels.by_joint("desired_angle"), unit("rad")),
        (channels.by_joint("desired_stiffness"), unit("N*m/rad")),
        (channels.by_muscle("command"), "Pa"),
        (("limited",), "1"),
        *(((f"{_PREFIX}{name}",), attributes(name.partition(".")[0], kind).get("units", "")) for name in telemetry),
    )
    values = (mcap.Column(name, unit, "float64") for names, unit in parts for name in names)
    return [*(mcap.Column(*column) for column in _SAMPLE), *values]


_PREFIX = "controller_"


class MeasuredRun(NamedTuple):
    """Columns of a record in the run of the reference, without gaps, and the telemetry of the controller."""

    table: dict[str, NDArray[np.float64]]
    telemetry: dict[str, NDArray[np.float64]]

    @classmethod
    def of(cls, columns: Mapping[str, NDArray[np.float64]]) -> MeasuredRun | None:
        """Run of a record; None if it did not begin."""
        whole = _every_period(columns)
        run = whole["phase"] == Phase.RUN
        if int(run.sum()) < 2:
            return None
        table = {name: values[run] for name, values in whole.items()}
        telemetry = {name.removeprefix(_PREFIX): table[name] for name in table if name.startswith(_PREFIX)}
        telemetry |= {"saturated": telemetry["saturated"] != 0} if "saturated" in telemetry else {}
        return cls(table, telemetry)

    def rows(self, names: Sequence[str]) -> tuple[NDArray[np.float64], ...]:
        """Columns by name."""
        return tuple(self.table[name] for name in names)


def measured_run(
    columns: Mapping[str, NDArray[np.float64]],
    plant: Plant,
    start: PlantState,
    channels: Channels,
    period: float,
    *,
    reach: Feasibility | None = None,
    stiffness_amplitude: float | None = None,
    scenario: str = "",
    notes: Sequence[Remark] = (),
) -> SimulationResult | None:
    """Return the result of a recorded run; None without a run.

    Parameters
    ----------
    columns
        Columns of the record, shape (rows,).
    plant, start
        Plant, by whose laws stiffness and forces are computed, and its state at the start.
    channels, period
        Names of joints and muscles, and control period [s].
    reach
        Feasibility of the reference of a joint.
    stiffness_amplitude
        Amplitude of the motion that the stiffness is of [rad]; None for that of an infinitely small one.
    scenario, notes
        Text of the scenario, and what it does not attain.
    """
    run = MeasuredRun.of(columns)
    if run is None:
        return None
    angles, readings = run.rows(channels.by_joint("angle")), run.rows(channels.by_muscle("pressure"))
    air = [highest > 0 for _, highest in rated_commands(plant)]  # without it, a reading is noise
    pressures = tuple(reading * filled for reading, filled in zip(readings, air, strict=True))
    velocities = tuple(np.gradient(angle, period) for angle in angles)
    states = _states((plant, start), (angles, velocities, pressures))
    telemetry: dict[str, PyTree] = {}
    for name, values in run.telemetry.items():
        quantity, of, _ = name.partition(".")
        telemetry[quantity] = (*telemetry.get(quantity, ()), values) if of else values
    record = Record(states, run.rows(channels.by_muscle("command")), run.table["limited"] != 0, telemetry)  # type: ignore[arg-type]
    desired = zip(*(run.rows(channels.by_joint(f"desired_{name}")) for name in ("angle", "stiffness")), strict=True)
    like, unknown = plant.mechanism.like_joints, np.full(len(run.table["time"]), np.nan)
    setpoints = like([Setpoint(*pair) for pair in desired])  # type: ignore[arg-type]
    without_step = like([unknown] * len(angles))
    band = reach and dataclasses.replace(
        reach, lowest=reach.lowest[: unknown.size], highest=reach.highest[: unknown.size]
    )
    measured = columns_of_run(plant, setpoints, record, lambda: without_step, stiffness_amplitude, band, "auto")
    airs = [name for name in measured if name.startswith("air")]  # noise of the pressures would count as air
    measured |= dict.fromkeys(airs, [unknown] * len(pressures) if channels.is_named else unknown)
    return SimulationResult(
        measured,
        period,
        scenario,
        angle_resolution=float(plant.sensors.angle_resolution),
        feasibility=reach,
        notes=lambda: [*notes],
        joints=plant.mechanism.joint_names,
        muscles=plant.mechanism.muscle_names,
        joint_type=plant.mechanism.joint_type,
    )


@compiled
def _states(base: tuple[Plant, PlantState], lanes: PyTree) -> PlantState:
    """States at angles [rad], velocities [rad/s] and pressures [Pa], over the last axis, with the base at its start."""
    plant, start = base
    angles, velocities, pressures = lanes
    like = plant.mechanism.like_joints
    position, velocity = like(angles, start.position), like(velocities, start.velocity)
    muscles, friction = (MuscleState((), ()),) * len(pressures), ()
    bare = start._replace(position=position, velocity=velocity, pressures=pressures, muscles=muscles, friction=friction)
    return plant.complete_state(bare)


def _every_period(columns: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Columns without gaps: a missing sample or command has the previous value."""
    sample = columns["sample"]
    if not sample.size:
        return dict(columns)
    rows = np.searchsorted(sample, np.arange(sample[0], sample[-1] + 1), side="right") - 1
    filled = {}
    for name, values in columns.items():
        there = np.isfinite(values)
        last = np.maximum.accumulate(np.where(there, np.arange(values.size), 0))
        filled[name] = values[last][rows]
    return filled


def by_laws(plant: JointPlant) -> JointPlant:
    """The plant without friction and creep."""
    joint = plant.joint
    muscle1, muscle2 = (
        dataclasses.replace(muscle, friction=NoFriction(), creep=NoCreep()) for muscle in (joint.muscle1, joint.muscle2)
    )
    return dataclasses.replace(plant, joint=dataclasses.replace(joint, muscle1=muscle1, muscle2=muscle2))


PERCENTILES = {"median": 50, "95 %": 95, "99.9 %": 99.9, "worst": 100}
"""Percentiles of the times of a loop, by title."""


def percentiles(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """The `PERCENTILES` of times of shape (times,); NaN of none."""
    return np.percentile(times, [*PERCENTILES.values()]) if times.size else np.full(len(PERCENTILES), np.nan)


class Timing(NamedTuple):
    """Timing of the closed loop of a run.

    Attributes
    ----------
    periods
        Number of periods.
    missed
        Periods in which the command from their sample did not reach the valves before their end.
    skipped, dropped
        Of these: without a command, because the loop was late and took the next sample; lost by the device.
    lateness, work, jitter
        `PERCENTILES` [s] of the times from a sample to its reading by the loop; from the reading to the commands; and
        of the absolute differences between the time between commands and the period.
    """

    periods: int
    missed: int
    skipped: int
    dropped: int
    lateness: NDArray[np.float64]
    work: NDArray[np.float64]
    jitter: NDArray[np.float64]

    def listing(self, priority: str) -> Listing:
        """Table of the percentiles; its title has the missed deadlines, and the priority of the process."""
        title = (
            f"{self.missed} of {self.periods} deadlines missed ({self.skipped} periods skipped, "
            f"{self.dropped} samples dropped), {priority}"
        )
        spreads = {
            "sample to loop": self.lateness,
            "loop to valves": self.work,
            "jitter between commands": self.jitter,
        }
        values = zip(PERCENTILES, zip(*spreads.values(), strict=True), strict=True)
        times = {name: (Column("s", name, "us"), list(row)) for name, row in values}
        return Listing(title, {"time": (Column(), list(spreads)), **times})

    @classmethod
    def of(cls, columns: Mapping[str, NDArray[np.float64]], period: float) -> Timing:
        """Return the timing of the closed loop in the columns of a record.

        Parameters
        ----------
        columns
            Columns by name, shape (rows,).
        period
            Control period [s].
        """
        closed = np.isin(columns["phase"], (Phase.SETTLING, Phase.RUN))
        sample, taken, had, out = (
            columns[name][closed].astype(float) for name in ("sample", "time", "read_at", "commanded_at")
        )
        answered = np.isfinite(out)
        periods = int(sample[-1] - sample[0] + 1) if sample.size else 0
        in_time = answered & (out <= taken + period * (1 + 1e-9))
        with np.errstate(invalid="ignore"):
            between = np.diff(out[answered])
        return cls(
            periods=periods,
            missed=periods - int(in_time.sum()),
            skipped=int((~answered).sum()),
            dropped=periods - sample.size,
            lateness=percentiles((had - taken)[answered]),
            work=percentiles((out - had)[answered]),
            jitter=percentiles(np.abs(between - period)),
        )
