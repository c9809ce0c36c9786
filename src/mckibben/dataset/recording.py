"""Raw recordings of a rig: pressure, force and contraction against time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.checks import check_positive
from mckibben.dataset.points import ExtractedPoints, SampleAccount, extracted_points, format_counts
from mckibben.dataset.preprocessing import pressure_levels
from mckibben.dataset.schema import RECORDED, MeasuredTable, assemble, format_range
from mckibben.dataset.segmentation import approaches, going_on, steady_segments
from mckibben.errors import RangeError
from mckibben.result import draw
from mckibben.units import bar, kPa, percent

if TYPE_CHECKING:
    from mckibben.result import Figure

_STEEPEST = 0.1  # contraction over which no muscle loses more than its largest force
_CONTINUOUS = "fit the samples of loops and sweeps: mk.read_dataset(path) (command line: mckibben identify FILE)"


@dataclass(frozen=True, eq=False, repr=False)
class Recording(MeasuredTable):
    """Samples of a test in the order of time, made by `of` or `read_recording`.

    `plateaus` extracts points where pressure and contraction were constant. A `DatasetError` lists variables that are
    missing, or of the wrong shape, unit or range.

    Attributes
    ----------
    table
        Along ``sample``: ``time`` [s], ``pressure`` [Pa, gauge], ``force`` [N]; where known ``contraction`` [-] and
        ``set_pressure`` [Pa]. Attributes as those of `IsobaricDataset`.

    Examples
    --------
    >>> time = np.arange(0, 8, 0.01)
    >>> record = Recording.of(
    ...     time=time, pressure=np.where(time < 4, 2e5, 3e5), force=np.where(time < 4, 50, 90.0), contraction=0.1
    ... )
    >>> record
    <Recording: 800 samples in 7.99 s, 2..3 bar, 50..90 N, contraction 10 %>
    >>> record.plateaus().dataset.force
    array([50., 90.])
    """

    schema = RECORDED
    word = "recording"

    @classmethod
    def of(
        cls,
        *,
        time: ArrayLike,
        pressure: ArrayLike,
        force: ArrayLike,
        contraction: ArrayLike | None = None,
        set_pressure: ArrayLike | None = None,
        specimen: str = "",
        initial_length: float | None = None,
        source: str = "",
        slack_force: float | None = None,
    ) -> Self:
        """Make a recording from arrays in SI units; raises a `DatasetError` with every problem.

        Parameters
        ----------
        time, pressure, force
            Shape (samples,): [s], gauge [Pa], [N]. Arrays of float64 are not copied.
        contraction, set_pressure
            Shape (samples,), or one number for all: [-], [Pa].
        specimen, initial_length, source
            As for `IsobaricDataset.of`.
        slack_force
            Force [N] up to which the muscle counts as slack; without it, or with 0, `plateaus` estimates it.
        """
        length = np.size(time)
        variables: dict[str, ArrayLike | None] = {"time": time, "pressure": pressure, "force": force}
        for name, values in (("contraction", contraction), ("set_pressure", set_pressure)):
            variables[name] = np.full(length, values) if values is not None and np.ndim(values) == 0 else values
        table = assemble(variables, RECORDED, "recording")
        attrs = {"specimen": specimen, "source": source, "slack_force": slack_force or 0.0}
        return cls(table.assign_attrs(attrs, initial_length=initial_length))

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each sample [s], read-only."""
        return self.table["time"].to_numpy()

    @property
    def contraction(self) -> NDArray[np.float64] | None:
        """Contraction [-], read-only; None where it was not recorded."""
        return self.table["contraction"].to_numpy() if "contraction" in self.table else None

    def plot(self) -> Figure:
        """Return a figure of the samples over time, see `mckibben.report.recording`."""
        return draw("recording", self)

    def __repr__(self) -> str:
        name = self.table.attrs["specimen"]
        parts = [f"{len(self)} samples"]
        if len(self):
            parts[0] += f" in {np.ptp(self.time):.4g} s"
            parts += [f"{format_range(self.pressure / bar)} bar", f"{format_range(self.force)} N"]
            if self.contraction is not None:
                parts.append(f"contraction {format_range(self.contraction / percent)} %")
        return f"<Recording{f' {name!r}' if name else ''}: {', '.join(parts)}>"

    def plateaus(
        self,
        *,
        pressure_tolerance: float = 2 * kPa,
        contraction_tolerance: float = 0.1 * percent,
        dwell: float = 1.0,
        settle: float = 0.0,
        accept: Sequence[str] = (),
    ) -> ExtractedPoints:
        """Points of the steady segments: means of pressure, contraction and force.

        Parameters
        ----------
        pressure_tolerance, contraction_tolerance
            A segment is steady while means over a twentieth of `dwell` stay within this [Pa], [-] of its middle; the
            force may creep.
        dwell
            Minimum duration of a steady segment [s].
        settle
            Initial part of a segment excluded from the means [s], in addition to a twentieth of `dwell` at either end.
        accept
            Topics of questions that are answered with yes, as for `read_dataset`.

        Returns
        -------
        ExtractedPoints
            The dataset has ``force_spread`` and ``time`` (the middle of each segment). ``direction`` is the direction
            of the last motion before a plateau; where the length did not change, ``phase`` says whether the muscle was
            filled or vented. If the recording has no slack force, it and the load cell's offset are estimated from the
            points, as by `read_dataset`. Plateaus in which a sensor is stuck, the clock is set back, or the force
            changes at once are left out, with a warning.

        Raises
        ------
        RangeError
            If an argument is invalid, the contraction is unknown, or no segment was steady for long enough; the error
            lists the samples left out, with reasons.
        DatasetError
            With the questions that the points raise, as for `read_dataset`, and those of signals that are late or jump.
        """
        check_positive("plateaus", "Pa", pressure_tolerance=pressure_tolerance)
        check_positive("plateaus", contraction_tolerance=contraction_tolerance)
        check_positive("plateaus", "s", dwell=dwell, dwell_after_settle=dwell - settle)
        check_positive("plateaus", "s", zero=True, settle=settle)
        if self.contraction is None:
            remedy = "give contraction, where it was fixed (command line: --read 'contraction=10 %'), or lengths"
            raise RangeError("the recording has no contraction", remedy=remedy)
        time, pressure, contraction, force = going_on(self.time), self.pressure, self.contraction, self.force
        account = SampleAccount(self.table)
        interval = account.interval
        if interval > dwell:
            text = f"the samples are {interval:.3g} s apart, more than the dwell of {dwell:.3g} s"
            remedy = (
                "if each row is a point, read the file as points (command line: mckibben identify FILE); otherwise "
                "give a longer dwell (command line: --dwell)"
            )
            raise RangeError(text, field="dwell", value=dwell, lower=interval, unit="s", remedy=remedy)
        account.ask(accept)
        signals = [(pressure, pressure_tolerance), (contraction, contraction_tolerance)]
        least = max(2, int(np.ceil(dwell / interval * (1 - 1e-6))))
        first, last, edge = steady_segments(signals, account.broken | (account.of >= 0), least)
        begins = np.maximum(np.searchsorted(time, time[first] + settle), first + edge)
        # first to last sample plus one interval: each sample stands for one
        whole = (time[last - 1] - time[first] + interval >= dwell * (1 - 1e-6)) & (last - edge > begins)
        first, begins, last = first[whole], begins[whole], last[whole]
        slope = pressure_tolerance / np.abs(pressure).max(initial=1.0) + contraction_tolerance / _STEEPEST
        rest = np.sum(last - first) / len(time)
        sound = account.sound(first, last, edge, 2 * slope * np.abs(force).max())
        first, begins, ends, last = first[sound], begins[sound], last[sound] - edge, last[sound]
        if not len(first):
            text = f"there are no plateaus: nothing is steady for {dwell:g} s\n  {format_counts(account.counts())}"
            remedy = f"{_CONTINUOUS}; of plateaus, give a shorter dwell (--dwell) or larger tolerances (--tolerance)"
            raise RangeError("\n  ".join([text, *account.notes, *account.lost]), value=dwell, unit="s", remedy=remedy)
        used = list(map(slice, begins, ends))
        for part, whole in zip(used, map(slice, first, last), strict=True):
            account.assign_reason(part, "used")
            account.assign_reason(whole, "settling")

        def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
            origin = values[begins]  # subtracted to preserve precision in sums of many samples
            return origin + [(values[part] - values[part.start]).mean() for part in used]

        p, c, f, t = mean(pressure), mean(contraction), mean(force), mean(time)
        if 2 * rest < 1:
            text = f"{1 - rest:.0%} of the samples are in no plateau"
            swept = [max(np.ptp(values) - 20 * tolerance, 0.0) for values, tolerance in signals]
            if np.ptp(p) < 0.1 * swept[0] or np.ptp(c) < 0.1 * swept[1]:
                raise RangeError(f"{text}, as of loops or sweeps", remedy=_CONTINUOUS)
            account.notes.append(f"{text}: {_CONTINUOUS}")
        levels = {"contraction": (c, contraction_tolerance), "pressure": (p, pressure_tolerance)}
        direction, phase = approaches(self.table, account.broken, first, last, levels)
        if "set_pressure" in self.table:
            set_pressure = mean(self.table["set_pressure"].to_numpy())
        else:
            set_pressure = pressure_levels(p)
            if wide := np.count_nonzero(np.isnan(set_pressure)):
                text = f"the pressures of {wide} plateaus follow each other without a step: they get no set pressure"
                account.notes.append(text)
        return extracted_points(
            self.table,
            account,
            ends - begins,
            accept,
            pressure=p,
            contraction=c,
            force=f,
            direction=direction if direction.any() else None,
            phase=phase if phase.any() else None,
            time=t,
            set_pressure=set_pressure,
            force_spread=np.array([force[part].std() for part in used]),
        )
