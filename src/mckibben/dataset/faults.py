"""Faults of sensors that show in samples over time: what no muscle does from one moment to the next."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.checks import SLACK, motion_side, residuals_of
from mckibben.dataset.isobaric import IsobaricDataset, format_list
from mckibben.dataset.preprocessing import with_notes
from mckibben.dataset.raw import Floats
from mckibben.dataset.segmentation import alternation, going_on, runs, usual_interval
from mckibben.dataset.table import Question, question
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.units import atm, bar, kPa, percent, show

if TYPE_CHECKING:
    import xarray as xr

LOST = "samples are lost"
"""Begin of the notes on faults, which are warnings, too."""
_DWELL = 1.0  # s
_REPEATS = 0.4  # share of samples that equal the one before: in white noise, of a converter coarser than the noise
_MOST_STAYS = 4  # more are how the signal rests
_MOVES = {"pressure": 50 * kPa, "contraction": 2 * percent}
"""Changes of one of these, the other at rest, which the force of a taut muscle follows."""
_RESTS = {"pressure": 10 * kPa, "contraction": 0.2 * percent}
_LAGS = 40  # blocks
_FEWEST = 4  # points before and after an offset
_JUMPED = "leave out the samples before or after it, where a sensor was stuck or changed its zero"
_REMEDY = "shift its column against the others, or record again"


def changes_at_once(force: Floats, size: int, most: float) -> bool:
    """Whether a force at constant pressure and length changes more at once than at first: creep only slows down.

    Parameters
    ----------
    force
        Shape (samples,) [N].
    size
        Number of samples whose means are compared.
    most
        Change that is none [N].

    >>> [changes_at_once(force, 10, 5.0) for force in (np.repeat([100.0, 60.0], 50), 100 * np.exp(-np.arange(100) / 9))]
    [True, False]
    """
    if (count := len(force) // size) < 3:
        return False
    means = force[: count * size].reshape(count, size).mean(axis=1)
    steps = np.abs(np.diff(means))
    at = 1 + int(np.argmax(steps[1:]))
    apart = abs(means[: at + 1].mean() - means[at + 1 :].mean())
    return bool(steps[at] > 2 * steps[0] and min(steps[at], apart) > most)


def offset_from(dataset: IsobaricDataset) -> Iterator[Question]:
    """Question about points in the order of a test, from one of which on a sensor has another zero.

    Least squares of the taut points, thinned, with ``F = p (a + b eps + c eps^2 + d p) + e + f eps`` and friction in
    either way, from one point on with another plane. It halves the residuals, by a tenth of the largest force on
    average, and is no extrapolation: the residuals without it are a tenth of this step or more. From 2 % on it is the
    zero of a load cell if it is the same at all points: what a muscle changes follows its pressure.
    """
    points = _thinned(dataset)
    force, basis = points.force, _plane_terms(points, points.pressure)
    fits = [(float(np.sum(residuals_of(force, basis) ** 2)), 0, 0.0)]
    for at in _changes(points, basis):
        after = (np.arange(len(force)) >= at)[:, None] * basis[:, :3]
        solution = np.linalg.lstsq(np.column_stack([basis, after]), force, rcond=None)[0]
        left = force - np.column_stack([basis, after]) @ solution
        fits.append((float(left @ left), at, float(np.mean(after[at:] @ solution[-3:]))))
    least, at, step = min(fits)
    scatter = np.sqrt(fits[0][0] / max(len(force), 1))
    alike = np.column_stack([basis, np.asarray(np.arange(len(force)) >= at, np.float64)])
    same = step and float(np.sum(residuals_of(force, alike) ** 2)) < 1.1 * least
    lowest = (0.02 if same else 0.1) * force.max()
    if 4 * least < fits[0][0] and lowest < abs(step) < min(force.max(), 10 * scatter):
        text = f"from {points.table['time'].to_numpy()[at]:.6g} s on, forces differ by {step:.3g} N from those before"
        yield question(f"{text} at equal pressure and length: has a sensor another zero?", "order", remedy=_JUMPED)


def turned_absolute(dataset: IsobaricDataset) -> Iterator[Question]:
    """Question about points in the order of a test, from one of which on, or before it, the pressure is absolute.

    Also where that is a change of the pressure: one atmosphere less halves the residuals of `offset_from`, and a tenth
    of it more or less does not fit as well. The lowest pressure alone cannot be told from a law that bends there.
    """
    points = _thinned(dataset)
    force, pressure = points.force, points.pressure

    def error(at: int, before: bool, offset: float) -> float:
        absolute = (np.arange(len(force)) < at) == before
        return float(np.sum(residuals_of(force, _plane_terms(points, pressure - offset * absolute)) ** 2))

    changes = _changes(points, _plane_terms(points, pressure))
    tried = [(error(at, before, atm), at, before) for at, before in product(changes, (False, True))]
    least, at, before = min(tried, default=(np.inf, 0, False))
    if 4 * least < error(0, False, 0.0) and least < min(error(at, before, share * atm) for share in (0.9, 1.1)):
        where = f"{'before' if before else 'from'} {points.table['time'].to_numpy()[at]:.6g} s{'' if before else ' on'}"
        text = f"{where}, pressures are one atmosphere above the others, by the forces: are they absolute?"
        yield question(text, "order", field="pressure", remedy=_JUMPED)


def _thinned(dataset: IsobaricDataset, *, most: int = 200) -> IsobaricDataset:
    """About `most` of the taut points, in their order."""
    taut = np.flatnonzero(dataset.force > SLACK * dataset.force.max(initial=0.0))
    return dataset.select(np.isin(np.arange(len(dataset)), taut[:: max(1, len(taut) // most)]))


def _changes(points: IsobaricDataset, basis: Floats) -> range:
    """Points from which on a sensor may have another zero; none of few points."""
    return range(_FEWEST, len(points) - _FEWEST if len(points) > 2 * basis.shape[1] else 0)


def _plane_terms(points: IsobaricDataset, pressure: Floats) -> Floats:
    """Terms of the force at pressures [Pa], and of friction; the first three are a plane."""
    pressure, contraction = pressure / bar, points.contraction
    side, ones = motion_side(points), np.ones_like(pressure)
    side = 0 * ones if side is None else side
    products = pressure * contraction, pressure * contraction**2, pressure**2, side, side * pressure
    return np.column_stack([ones, contraction, pressure, *products])


def without_faults(table: xr.Dataset) -> tuple[xr.Dataset, NDArray[np.int_], list[Question]]:
    """Samples over time without those of a stuck sensor, and within a second of a clock that was set back.

    Returns
    -------
    Table, whose `preprocessing` says what is left out, the rows that are left, and questions about other faults.
    """
    time, lost, notes = table["time"].to_numpy(), np.zeros(table.sizes["point"], bool), list[str]()
    signals = RecordedSignals(table := table.assign(time=("point", going_on(time))))
    back = np.flatnonzero(np.diff(time) < 0) + 1
    near = round(_DWELL / signals.interval)
    parts = {f"the {name} is stuck": spans for name, spans in signals.stuck.items() if spans}
    parts |= {"the clock went back": [slice(max(at - near, 0), at + near) for at in back]} if len(back) else {}
    for reason, spans in parts.items():
        for span in spans:
            lost[span] = True
        notes.append(f"{LOST}, as {reason}: {places(time, spans)}")
    for note in notes:
        warnings.warn(note, McKibbenWarning, stacklevel=user_level())
    return with_notes(table, notes).isel(point=~lost), np.flatnonzero(~lost), signals.questions()


def places(time: Floats, spans: Sequence[slice]) -> str:
    """Begin and end of spans of samples, as text."""
    shown = [f"{time[span.start]:.6g} to {time[min(span.stop, len(time)) - 1]:.6g} s" for span in spans]
    return format_list(np.array(shown), most=5)


class RecordedSignals:
    """Signals of a recording, and their means over blocks of a quarter of a second.

    Parameters
    ----------
    table
        Samples with time [s], pressure [Pa], contraction [-] if it is known, and force [N].

    Raises
    ------
    RangeError
        If the time does not advance.
    """

    def __init__(self, table: xr.Dataset) -> None:
        self.time = time = table["time"].to_numpy()
        self.values = values = {name: table[name].to_numpy() for name in (*_MOVES, "force") if name in table}
        self.interval, self.gaps = usual_interval(np.diff(time))
        if not self.interval:
            remedy = "give its sample rate when reading it; a file with the newest sample first has to be reversed"
            raise RangeError("the time of the recording does not advance", field="time", remedy=remedy)
        self.size = max(1, round(_DWELL / 4 / self.interval))
        self.edges = np.arange(0, max(len(time) - self.size + 1, 1), self.size)
        sizes = np.diff(self.edges, append=len(time))
        self.means = {name: np.add.reduceat(part, self.edges) / sizes for name, part in values.items()}

    @functools.cached_property
    def stuck(self) -> dict[str, list[slice]]:
        """Samples of a second or more in which a signal stays that should not.

        Its noise ends; or it is the force of a taut muscle while pressure or length alone changes. Weights that are
        typed in stay on purpose.
        """
        stuck: dict[str, list[slice]] = {name: [] for name in self.values}
        for name, values in self.values.items():
            begins, lengths = runs(values)
            heights = values[begins]
            stays = lengths * self.interval >= _DWELL
            others = lengths[~stays]
            if len(others) <= 2 * np.count_nonzero(stays):  # typed in
                continue
            repeats = 1 - len(others) / others.sum()
            noisy = repeats < _REPEATS < alternation(np.diff(heights[~stays])) and np.count_nonzero(stays) < _MOST_STAYS
            noisy &= lengths * np.log(max(repeats, 1e-9)) < 2 * np.log(1e-6 / len(values))  # no chance, in half of them
            inside = (heights > values.min()) & (heights < values.max())  # else saturated
            taut = heights > values.min() + SLACK * np.ptp(values)
            for at in np.flatnonzero(stays):
                part = slice(begins[at], begins[at] + lengths[at])
                if (noisy[at] and inside[at]) or (name == "force" and taut[at] and self._moves(part)):
                    stuck[name].append(part)
        return stuck

    def _moves(self, part: slice) -> bool:
        """Whether pressure or contraction alone changes in samples, within a second or in all."""
        blocks = slice(-(-part.start // self.size), part.stop // self.size)
        still = np.zeros(max(blocks.stop - blocks.start, 0))
        parts = {name: self.means.get(name, still)[blocks] for name in _MOVES}
        for span in (4, len(still) - 1):
            changes = {name: np.abs(part[span:] - part[:-span]) for name, part in parts.items() if span > 0}
            for name, other in (("pressure", "contraction"), ("contraction", "pressure")) if changes else ():
                if np.any((changes[name] > _MOVES[name]) & (changes[other] < _RESTS[other])):
                    return True
        return False

    def questions(self) -> list[Question]:
        """Questions about a signal that is late, or that jumps while the others rest."""
        return [*self._late(), *self._jumps()]

    def _late(self) -> Iterator[Question]:
        """Signal that changes earlier or later than the others.

        Least squares of the changes of the force from block to block, or of the contraction where weights hang, with
        those of the others. A delay explains half of the variance, and leaves less than half of what is left at once.
        Several delays of one signal are those of a periodic motion: then they have to leave less also by a block more
        or less, and it is the shortest of those that leave no more than twice the least.
        """
        means = self._at_equal_times()
        steps = {name: np.diff(part) for name, part in means.items()}
        if len(steps["force"]) < 4 * _LAGS or not all(map(np.any, steps.values())):
            return
        lags = range(-_LAGS, _LAGS + 1)
        for response in [name for name in ("force", "contraction") if name in steps]:
            trials = {(name, lag): _unexplained(means, response, name, lag) for name in steps for lag in lags}
            at_once = min(share for (_, lag), share in trials.items() if abs(lag) < 2)
            least = min(trials.values())
            if 2 * least < min(1.0, at_once) and (delay := _delay(trials, min(1.0, at_once))):
                name, lag = delay
                seconds = show(abs(lag) * self.size * self.interval, "s", 2)
                text = f"{name} and the other signals are {seconds} apart: is {'it' if lag > 0 else 'another'} late?"
                yield question(text, "order", field=name, remedy=_REMEDY)
            if 2 * min(least, at_once) < 1:
                return

    def _at_equal_times(self) -> dict[str, Floats]:
        """Means over blocks of equal times, without gaps: intervals of samples may differ."""
        steps = np.where(self.gaps, self.interval, np.diff(self.time))
        time = np.append(0.0, np.cumsum(steps))
        width = self.size * self.interval
        edges = np.arange(0, time[-1], width)
        areas = {name: np.cumsum(steps * (part[1:] + part[:-1]) / 2) for name, part in self.values.items()}
        return {name: np.diff(np.interp(edges, time, np.append(0.0, area))) / width for name, area in areas.items()}

    def _jumps(self, listed: int = 1000) -> Iterator[Question]:
        """Pressure or contraction that jumps from one sample to the next, while the others of a taut muscle stay."""
        force = self.values["force"]
        taut, most = force.min() + SLACK * np.ptp(force), 0.02 * np.ptp(force)
        for name in _MOVES.keys() & self.values.keys():
            values, others = self.values[name], [other for other in self.values if other != name]
            jumps = np.flatnonzero((np.abs(np.diff(values)) > _MOVES[name]) & ~self.gaps) + 1
            for span in chain.from_iterable(self.stuck.values()):
                jumps = jumps[(jumps < span.start) | (jumps > span.stop)]
            for at in jumps[:listed]:
                near = [slice(max(at - 3 * self.size, 0), at), slice(at, at + 3 * self.size)]
                level = {key: [part[rows].mean() for rows in near] for key, part in self.values.items()}
                stays = all(abs(np.diff(level[other])[0]) < {**_RESTS, "force": most}[other] for other in others)
                rests = max(np.ptp(values[rows]) for rows in near) < _MOVES[name]
                if stays and rests and abs(np.diff(level[name])[0]) > _MOVES[name] and min(level["force"]) > taut:
                    step = show(float(values[at] - values[at - 1]), "bar" if name == "pressure" else "%", 3)
                    text = f"{name} jumps by {step} at {self.time[at]:.6g} s, and no other signal follows"
                    yield question(text, "order", field=name, remedy=_JUMPED)
                    break


def _delay(trials: Mapping[tuple[str, int], float], most: float) -> tuple[str, int] | None:
    """Signal and its delay, of which less than half of a share is left; None for a periodic motion alone."""
    beside = {(name, lag): [trials.get((name, lag + block), 1.0) for block in (-1, 1)] for name, lag in trials}
    lowest = {trial: share for trial, share in trials.items() if share <= min(beside[trial])}
    fitting = [trial for trial, share in lowest.items() if share <= 2 * min(trials.values())]
    chosen = min(fitting, key=lambda trial: abs(trial[1]))
    delays = [trial for trial, share in lowest.items() if trial[0] == chosen[0] and 2 * share < most]
    return chosen if len(delays) == 1 or (delays and min(beside[chosen]) < most) else None


def _unexplained(means: Mapping[str, Floats], response: str, late: str, lag: int) -> float:
    """Share of the variance of the changes of a signal that the others leave, one of them shifted by a lag."""
    shifted = {name: np.roll(part, -lag) if name == late else part for name, part in means.items()}
    shifted = {name: part[_LAGS:-_LAGS] for name, part in shifted.items()}
    steps = {name: np.diff(part) for name, part in shifted.items()}
    others = [name for name in steps if name != response]
    columns = [steps[name] for name in others]
    columns += [steps[name] * shifted[other][:-1] for name, other in product(others, others)]
    basis = np.column_stack(columns)
    scale = np.abs(basis).max(axis=0)
    rest = residuals_of(steps[response], basis / np.where(scale > 0, scale, 1.0))
    return float(rest @ rest) / float(steps[response] @ steps[response] or 1.0)
