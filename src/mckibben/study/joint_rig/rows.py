"""The rows of a joint's record: one a sample, handed to the recorder some dozens at a time."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.rig.chunks import Column
from mckibben.rig.recorder import Recorder
from mckibben.simulation.result import attributes
from mckibben.study.joint_rig.wiring import Reading

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
