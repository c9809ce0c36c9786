"""The record of a run, and the run as a simulation result."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mckibben.control.base import Setpoint
from mckibben.muscle import NoCreep, NoFriction
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.realtime.config import Reading
from mckibben.rig.record import Column
from mckibben.rig.recorder import Recorder
from mckibben.simulation import Reach, Result, compiled_trajectory
from mckibben.simulation.loop import Record
from mckibben.simulation.result import attributes

_TOGETHER = 50  # rows that go to the recorder at once: 50 ms of 1 kHz
_LONGEST = 0.1  # s that a row waits for others, where they are not as many


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
    ("answered_at", "s", "float64"),
    ("volts_angle", "V", "float64"),
    ("volts_pressure1", "V", "float64"),
    ("volts_pressure2", "V", "float64"),
    ("angle", "rad", "float64"),
    ("pressure1", "Pa", "float64"),
    ("pressure2", "Pa", "float64"),
    ("desired_angle", "rad", "float64"),
    ("desired_stiffness", "N*m/rad", "float64"),
    ("command1", "Pa", "float64"),
    ("command2", "Pa", "float64"),
    ("limited", "1", "float64"),
)
_TIME, _ANSWERED, _VOLTS, _READING, _WISH, _COMMAND = 2, 4, 5, 8, 11, 13
_TELEMETRY = len(_OWN)


def columns(telemetry: Sequence[str]) -> list[Column]:
    """The columns of a record: ours, and what the controller reports under names of their own."""
    reported = [Column(f"controller_{name}", attributes(name).get("units", "")) for name in telemetry]
    return [*(Column(*one) for one in _OWN), *reported]


class Rows:
    """Rows on their way to a recorder. What a sample has not got is NaN."""

    def __init__(self, recorder: Recorder, telemetry: Sequence[str]) -> None:
        self._recorder = recorder
        self._names = [column.name for column in columns(telemetry)]
        self._table: NDArray[np.float64] = np.full((_TOGETHER, len(self._names)), np.nan)
        self._filled = 0

    def begin(self, sample: int, phase: int, time: float, volts: Sequence[float], read_at: float) -> int:
        """A row for a sample, to which the rest is added; those before it may go."""
        if self._filled == _TOGETHER or (self._filled and time - self._table[0, _TIME] > _LONGEST):
            self.flush()
        row = self._filled
        self._table[row, :_ANSWERED] = (sample, phase, time, read_at)
        self._table[row, _VOLTS : _VOLTS + 3] = volts
        self._filled = row + 1
        return row

    def measured(self, row: int, reading: Reading) -> None:
        """What it means."""
        self._table[row, _READING : _READING + 3] = reading

    def commanded(
        self,
        row: int,
        wish: Sequence[float] | NDArray[np.float64],
        commands: tuple[float, float],
        limited: bool,
        telemetry: NDArray[np.float64] | None = None,
    ) -> None:
        """What was wished for, and what the valves were told."""
        table = self._table
        table[row, _WISH], table[row, _WISH + 1] = wish
        table[row, _COMMAND], table[row, _COMMAND + 1] = commands
        table[row, _COMMAND + 2] = limited
        if telemetry is not None:
            table[row, _TELEMETRY:] = telemetry

    def answered(self, row: int, time: float) -> None:
        """When they were told."""
        self._table[row, _ANSWERED] = time

    def flush(self) -> None:
        """Hand over what there is."""
        if not self._filled:
            return
        full, self._filled = self._table[: self._filled], 0
        table: dict[str, Any] = {name: full[:, i] for i, name in enumerate(self._names)}
        self._recorder.append(table)
        self._table[:] = np.nan

    def event(self, kind: str, text: str, **data: Any) -> None:
        """Note that something happened."""
        self._recorder.event(kind, text, **data)


_PREFIX = "controller_"


def measured_result(
    columns: Mapping[str, NDArray[Any]], plant: JointPlant, reach: Reach, period: float, *, scenario: str = ""
) -> Result | None:
    """What a record says of its run, one value a control period; None if there was none.

    Angle and pressures are as measured. Stiffness, torque, forces and contractions are what the laws of the plant's
    muscles make of them, without friction and creep, whose state cannot be measured. The velocity is that between
    neighbouring samples. How far a change of the stiffness moved the angle would take a second run, and what goes
    in and out as air cannot be told from the noise of the pressures: there is neither ``coupling`` nor ``air``.

    Parameters
    ----------
    columns
        Of a record.
    plant
        What the joint is believed to be.
    reach
        Of the reference.
    period
        The control period [s].
    scenario
        Text to keep with the result.
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
    record = Record(state, table["command1"], table["command2"], table["limited"] != 0, telemetry)  # type: ignore[arg-type]
    wishes = Setpoint(table["desired_angle"], table["desired_stiffness"])  # type: ignore[arg-type]
    nothing = np.full(count, np.nan)
    moved = compiled_trajectory(numeric(_by_laws(plant)), wishes, record, nothing)  # type: ignore[arg-type]
    moved = moved._replace(air1=nothing, air2=nothing)  # type: ignore[arg-type]
    band = reach.lowest[:count], reach.highest[:count]
    return Result.of(moved, period, band=band, telemetry=telemetry, scenario=scenario)


def _every_period(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The rows without gaps: where a sample or a command is missing, the one before was in force."""
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
