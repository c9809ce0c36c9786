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
from mckibben.rig.record import Column
from mckibben.rig.recorder import Recorder
from mckibben.simulation import Feasibility, SimulationResult, compute_trajectory
from mckibben.simulation.loop import Record

_TOGETHER = 50  # rows that go to the recorder at once: 50 ms of 1 kHz
_LONGEST = 0.1  # s that a row waits for others, if they are fewer


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

    RAISING = 0
    SETTLING = 1
    RUN = 2
    VENTING = 3


_OWN = (
    ("sample", "1", "int64"),
    ("phase", "1", "int8"),
    ("time", "s", "float64"),
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
_TIME, _COMMANDED, _READING, _REFERENCE, _COMMAND = 2, 4, 5, 8, 10
_TELEMETRY = len(_OWN)


def columns(telemetry: Sequence[str]) -> list[Column]:
    """Columns of a record; the telemetry of the controller has the prefix ``controller_``."""
    reported = [Column(f"controller_{name}", attributes(name).get("units", "")) for name in telemetry]
    return [*(Column(*one) for one in _OWN), *reported]


class RowBuffer:
    """Buffer of rows before a recorder; missing values are NaN.

    Parameters
    ----------
    recorder
        Recorder with the columns of `columns`.
    telemetry
        Names of the controller's telemetry.
    """

    def __init__(self, recorder: Recorder, telemetry: Sequence[str]) -> None:
        self._recorder = recorder
        self._names = [column.name for column in columns(telemetry)]
        self._table: NDArray[np.float64] = np.full((_TOGETHER, len(self._names)), np.nan)
        self._filled = 0

    def begin(self, sample: int, phase: int, time: float, reading: JointReading, read_at: float) -> int:
        """Begin the row of a sample; return its index.

        Parameters
        ----------
        sample, phase
            Number of the sample, and phase of the run.
        time, read_at
            Times of the sample and of its reading [s].
        reading
            Angle and pressures.
        """
        if self._filled == _TOGETHER or (self._filled and time - self._table[0, _TIME] > _LONGEST):
            self.flush()
        row = self._filled
        self._table[row, :_COMMANDED] = (sample, phase, time, read_at)
        self._table[row, _READING : _READING + 3] = reading
        self._filled = row + 1
        return row

    def commanded(
        self,
        row: int,
        reference: Sequence[float] | NDArray[np.float64],
        commands: tuple[float, float],
        limited: bool,
        telemetry: NDArray[np.float64] | None = None,
    ) -> None:
        """Set reference, commands and telemetry of a row.

        Parameters
        ----------
        row
            Index of the row.
        reference
            Angle [rad] and stiffness [N*m/rad].
        commands, limited
            Commands of both muscles [Pa], and whether they were limited.
        telemetry
            Telemetry of the controller, shape (values,); None without a step of it.
        """
        table = self._table
        table[row, _REFERENCE], table[row, _REFERENCE + 1] = reference
        table[row, _COMMAND], table[row, _COMMAND + 1] = commands
        table[row, _COMMAND + 2] = limited
        if telemetry is not None:
            table[row, _TELEMETRY:] = telemetry

    def commanded_at(self, row: int, time: float) -> None:
        """Set the time at which the valves were set [s]."""
        self._table[row, _COMMANDED] = time

    def flush(self) -> None:
        """Pass all rows to the recorder."""
        if not self._filled:
            return
        full, self._filled = self._table[: self._filled], 0
        table: dict[str, Any] = {name: full[:, i] for i, name in enumerate(self._names)}
        self._recorder.append(table)
        self._table[:] = np.nan

    def event(self, kind: str, text: str, **data: Any) -> None:
        """Record an event."""
        self._recorder.event(kind, text, **data)


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
    moved = moved._replace(air1=nothing, air2=nothing)  # type: ignore[arg-type]
    band = reach.lowest[:count], reach.highest[:count]
    resolution = float(plant.sensors.angle_resolution)
    return SimulationResult.of(
        moved, period, band=band, telemetry=telemetry, scenario=scenario, angle_resolution=resolution
    )


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


class Percentiles(NamedTuple):
    """Percentiles of times [s]: 50, 95, 99.9 and 100 %.

    Examples
    --------
    >>> Percentiles.of(np.arange(101.0)).most
    95.0
    """

    median: float
    most: float
    nearly_all: float
    worst: float

    @classmethod
    def of(cls, times: NDArray[np.float64]) -> Percentiles:
        """Return the percentiles of times [s] of shape (times,); NaN of none."""
        if not times.size:
            return cls(*[float("nan")] * 4)
        return cls(*(float(value) for value in np.percentile(times, (50, 95, 99.9, 100))))

    def to_json(self) -> dict[str, float]:
        """Return them as a JSON object [us]."""
        return dict(zip(("median_us", "p95_us", "p999_us", "worst_us"), (time * 1e6 for time in self), strict=True))


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
        Times [s] from a sample to its reading by the loop; from the reading to the commands; and absolute differences
        between the time between commands and the period.
    """

    periods: int
    missed: int
    skipped: int
    dropped: int
    lateness: Percentiles
    work: Percentiles
    jitter: Percentiles

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
            lateness=Percentiles.of((had - taken)[answered]),
            work=Percentiles.of((out - had)[answered]),
            jitter=Percentiles.of(np.abs(between - period)),
        )

    def to_json(self) -> dict[str, Any]:
        """As a JSON object, times in microseconds."""
        counts = {name: getattr(self, name) for name in ("periods", "missed", "skipped", "dropped")}
        return counts | {name: getattr(self, name).to_json() for name in ("lateness", "work", "jitter")}
