"""Record of a run, the run as a simulation result, and its timing."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from mckibben.component.columns import attributes
from mckibben.control.base import Setpoint
from mckibben.muscle import NoCreep, NoFriction
from mckibben.plant import JointPlant, PlantState
from mckibben.result import Column, Listing
from mckibben.simulation import Feasibility, SimulationResult, compute_trajectory
from mckibben.simulation.loop import Record
from mckibben.storage import mcap


class JointReading(NamedTuple):
    """Reading of a joint.

    Attributes
    ----------
    angle
        Measured angle [rad].
    pressure1, pressure2
        Measured gauge pressures [Pa].
    """

    angle: float
    pressure1: float
    pressure2: float


class Phase(enum.IntEnum):
    """The parts of a run."""

    PROBING = -1
    RAISING = 0
    SETTLING = 1
    RUN = 2
    VENTING = 3


_OWN = (
    ("time", "s", "float64"),
    ("sample", "1", "int64"),
    ("phase", "1", "int8"),
    ("read_at", "s", "float64"),
    ("commanded_at", "s", "float64"),
    ("angle", "rad", "float64"),
    ("pressure1", "Pa", "float64"),
    ("pressure2", "Pa", "float64"),
    ("desired_angle", "rad", "float64"),
    ("desired_stiffness", "N*m/rad", "float64"),
    ("command1", "Pa", "float64"),
    ("command2", "Pa", "float64"),
    ("limited", "1", "float64"),
)
COMMANDED_AT, READING, REFERENCE, COMMANDS = 4, slice(5, 8), slice(8, 10), slice(10, 13)
"""Places in a row."""


def columns(telemetry: Sequence[str]) -> list[mcap.Column]:
    """Columns of a record; the telemetry of the controller has the prefix ``controller_``.

    Without a command, those from `commanded_at` on are NaN, but for the reading.
    """
    reported = [mcap.Column(f"controller_{name}", attributes(name).get("units", "")) for name in telemetry]
    return [*(mcap.Column(*column) for column in _OWN), *reported]


_PREFIX = "controller_"


def measured_result(
    columns: Mapping[str, NDArray[Any]],
    plant: JointPlant,
    reach: Feasibility,
    period: float,
    stiffness_amplitude: float | None,
    *,
    scenario: str = "",
) -> SimulationResult | None:
    """Return the result of a recorded run; None without a run.

    Parameters
    ----------
    columns
        Columns of the record, shape (rows,).
    plant, reach
        Plant, by whose laws stiffness, torque and forces are computed, and feasibility of the reference.
    period
        Control period [s].
    stiffness_amplitude
        Amplitude of the motion that the stiffness is of [rad]; None for that of an infinitely small one.
    scenario
        Text of the scenario.
    """
    whole = _every_period(columns)
    run = whole["phase"] == Phase.RUN
    count = int(run.sum())
    if count < 2:
        return None
    table = {name: values[run] for name, values in whole.items()}
    telemetry = {name.removeprefix(_PREFIX): table[name] for name in table if name.startswith(_PREFIX)}
    telemetry |= {"saturated": telemetry["saturated"] != 0} if "saturated" in telemetry else {}
    velocity: Any = np.gradient(table["angle"], period)
    angle, pressure1, pressure2 = (cast(Any, table[name]) for name in ("angle", "pressure1", "pressure2"))
    state = PlantState(angle, velocity, (pressure1, pressure2))
    record = Record(state, (table["command1"], table["command2"]), table["limited"] != 0, telemetry)  # type: ignore[arg-type]
    references = Setpoint(table["desired_angle"], table["desired_stiffness"])  # type: ignore[arg-type]
    nothing = np.full(count, np.nan)
    moved = compute_trajectory(_by_laws(plant), references, record, nothing, stiffness_amplitude)
    moved = moved._replace(air=(nothing, nothing))  # type: ignore[arg-type]
    band = reach.lowest[:count], reach.highest[:count]
    resolution = float(plant.sensors.angle_resolution)
    result = SimulationResult.of(
        moved, period, band=band, telemetry=telemetry, scenario=scenario, angle_resolution=resolution
    )
    return dataclasses.replace(result, feasibility=reach)


def _every_period(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
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


def _by_laws(plant: JointPlant) -> JointPlant:
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
    def of(cls, columns: Mapping[str, NDArray[Any]], period: float) -> Timing:
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
