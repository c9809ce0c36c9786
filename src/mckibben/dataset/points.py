"""What became of the samples of a recording: points, and everything that was left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mckibben.dataset.glued import glued
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.units import factor, show

_GAP = 10  # usual intervals
_NAMED = 5  # places that a note names


@dataclass(frozen=True, eq=False)
class Points:
    """The points of a recording, with an account of all its samples.

    Attributes
    ----------
    dataset
        What `identify` takes.
    samples
        How many of the recording's samples made each point, shape (points,).
    counts
        Samples by what became of them; they add up to the recording.
    notes
        What was found in the record: gaps, ends of a sensor's range, levels that were not reached.
    """

    dataset: IsobaricDataset
    samples: NDArray[np.int64] = field(repr=False)
    counts: Mapping[str, int]
    notes: tuple[str, ...]

    def describe(self) -> str:
        """The account as text: samples by what became of them, and the notes."""
        return account(self.counts, self.notes)


class Ledger:
    """What becomes of each sample, as it is found out; the first reason counts."""

    def __init__(self, table: xr.Dataset, gap: float | None) -> None:
        self.table = table
        self.reasons: list[str] = ["used"]
        self.of = np.full(table.sizes["sample"], -1, np.int8)
        self.notes: list[str] = []
        self.broken = self._breaks(gap)
        for name in ("pressure", "force"):
            self._ends(name)

    def put(self, where: NDArray[np.bool_] | NDArray[np.int64] | slice, reason: str) -> None:
        """Say of samples what became of them, where it is not said yet."""
        if reason not in self.reasons:
            self.reasons.append(reason)
        part = self.of[where]
        self.of[where] = np.where(part < 0, self.reasons.index(reason), part)

    def counts(self, rest: str) -> dict[str, int]:
        """Samples by what became of them; all that nothing was said of are the rest."""
        self.put(self.of < 0, rest)
        found = np.bincount(self.of, minlength=len(self.reasons))
        return {reason: int(n) for reason, n in zip(self.reasons, found, strict=True) if n or reason == "used"}

    def _breaks(self, gap: float | None) -> NDArray[np.bool_]:
        """Samples that do not follow the one before: after a gap, or with a clock that went back."""
        time = self.table["time"].to_numpy()
        steps = np.diff(time)
        broken = np.zeros(len(time), bool)
        forward = steps[steps > 0]
        if not len(forward):
            return broken
        longest = _GAP * float(np.median(forward)) if gap is None else gap
        for what, where in (("gap", steps > longest), ("clock went back", steps < 0)):
            places = np.flatnonzero(where)
            if len(places):
                shown = ", ".join(f"{time[at]:.6g} to {time[at + 1]:.6g} s" for at in places[:_NAMED])
                more = f" and {len(places) - _NAMED} more" if len(places) > _NAMED else ""
                self.notes.append(f"{what}: {shown}{more}; nothing is joined across")
                broken[places + 1] = True
        return broken

    def _ends(self, name: str) -> None:
        """Leave out what sticks to the floor or the ceiling of a channel."""
        values = self.table[name].to_numpy()
        for end, where in glued(values).items():
            value = values.min() if end == "floor" else values.max()
            unit = "bar" if name == "pressure" else "N"
            runs = int(np.count_nonzero(np.diff(where.view(np.int8), prepend=0) == 1))
            times = f"{runs} times" if runs > 1 else "once"
            held = f"{name} sticks to {show(float(value), unit)}, the {end} of its channel, {times}"
            self.notes.append(f"{held}: {int(where.sum())} samples are left out")
            self.put(where, f"at the {end} of {name}")


def account(counts: Mapping[str, int], notes: tuple[str, ...] | list[str]) -> str:
    """Counts and notes as text.

    >>> print(account({"used": 90, "moving": 10}, ["gap: 1 to 2 s; nothing is joined across"]))
    100 samples: 90 used, 10 moving
    gap: 1 to 2 s; nothing is joined across
    """
    parts = ", ".join(f"{count} {reason}" for reason, count in counts.items())
    return "\n".join([f"{sum(counts.values())} samples: {parts}", *notes])


def check(name: str, value: float, unit: str, *, may_be_zero: bool = False) -> None:
    """Refuse an argument that is not above 0.

    Raises
    ------
    RangeError
        If it is not, or not finite.
    """
    if not (np.isfinite(value) and (value > 0 or (may_be_zero and value == 0))):
        shown = f"{value / factor(unit):g}" + ("" if unit == "1" else f" {unit}")
        what = "below" if may_be_zero else "not above"
        raise RangeError(f"{name} {shown} is {what} 0", value=value, lower=0.0, unit=unit)
