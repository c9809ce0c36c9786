"""Physical checks of measured points: what no muscle does is a question, not a number.

A muscle pulls; its force rises with the pressure and falls with the contraction, and is about linear in the pressure
and quadratic in the contraction (Chou and Hannaford, IEEE Trans. Robotics and Automation 12 (1996) 90).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.preprocessing import contraction_rate, held_loads, level_means, pressure_levels
from mckibben.dataset.raw import Floats
from mckibben.dataset.segmentation import runs
from mckibben.dataset.table import Question, question
from mckibben.errors import McKibbenWarning, Problem
from mckibben.muscle import air
from mckibben.units import bar, mm, percent

if TYPE_CHECKING:
    from mckibben.dataset.isobaric import IsobaricDataset
    from mckibben.muscle import Specimen

_UNIT = "check the unit: columns={'HEADER': 'force_UNIT'} (command line: --column 'HEADER=force_UNIT')"
_TURNED = "turn the sign: columns={'HEADER': '-force_N'} (command line: --column 'HEADER=-force_N')"
SLACK, _TAUT = 0.05, 0.15  # of the largest force: up to which a muscle may be slack, and from which it is not
_RANK = 1e-9  # of the largest singular value: less is rounding
_SHORTENS, _STRETCHED = ("unloading", "filling"), ("loading", "venting")  # or would, at a fixed length
_REMEDIES = {
    "range": f"{_UNIT}, the sign, and initial_length (command line: --initial-length)",
    "rows": "leave these rows out of the file",
    "shift": "correct these rows in the file, which may be absolute or have another zero",
    "order": "check these rows, the headers, and the signs of lengths and angles",
    "zero": "subtract the offset in the file, or measure five or more points of the slack muscle",
    "gauge": "name it pressure_bar_abs (command line: --column 'HEADER=pressure_bar_abs' --read 'ambient=101.3 kPa')",
    "saturation": "leave such rows out: largest_force=950.0 (command line: --read 'largest_force=950 N')",
    "sign": _TURNED,
    "stretched": f"{_TURNED}, or correct initial_length (command line: --initial-length)",
}


@dataclass(frozen=True)
class Points:
    """Points of a test in the order of its rows.

    Attributes
    ----------
    pressure, contraction, force
        Shape (points,): gauge pressure [Pa], contraction [-], force [N].
    lines
        Line of each point in its file.
    slack_force
        Force up to which the muscle counts as slack [N].
    held
        Whether the forces are loads that were held, as of hanging weights: then the contraction was measured.
    side
        Shape (points,): 1 where the muscle shortens, -1 where it is stretched, 0 where that is not known.
    rate
        Shape (points,): rate of the contraction [1/s], NaN where it is not known, as at reversals.
    timed
        Whether the points are of a recording, in which creep and friction of rests shift forces as well.
    scatter
        Force up to which points may be off the surface, a share of the largest.
    """

    pressure: Floats
    contraction: Floats
    force: Floats
    lines: NDArray[np.int64]
    slack_force: float = 0.0
    held: bool = False
    side: Floats | None = None
    rate: Floats | None = None
    timed: bool = False
    scatter: float = 0.0

    @property
    def taut(self) -> NDArray[np.bool_]:
        """Mask of points whose force is a load, or above 5 % of the largest, and thus clearly that of a taut muscle."""
        return self.held | (self.force > max(SLACK * self.force.max(initial=0.0), self.slack_force))

    @property
    def table(self) -> Floats:
        """Pressure [bar], contraction [%] and force [N], shape (points, 3)."""
        return np.column_stack([self.pressure / bar, self.contraction / percent, self.force])

    def every(self, step: int) -> Points:
        """Every second point, say."""
        columns = {name: values[::step] for name, values in vars(self).items() if isinstance(values, np.ndarray)}
        return replace(self, **columns)

    def ask(self, topic: str, text: str, row: int | None = None, field: str = "", remedy: str = "") -> Question:
        """A question, about a row, with the remedy of its topic or of another."""
        place = "" if row is None else " at {:.3g} bar, {:.3g} %, {:.4g} N".format(*self.table[row])
        line = None if row is None else int(self.lines[row])
        return question(f"{text}{place}", topic, line=line, field=field, remedy=_REMEDIES[remedy or topic])


def motion_side(dataset: IsobaricDataset) -> Floats | None:
    """Return 1 where the muscle shortens, -1 where it is stretched, 0 where that is not known, shape (points,).

    None without directions.
    """
    words = [dataset.table[name].to_numpy() for name in ("direction", "phase") if name in dataset.table]
    signs = [np.isin(word, _SHORTENS) - 1.0 * np.isin(word, _STRETCHED) for word in words]
    return np.sum(signs, axis=0) if signs else None


def questions_of(
    dataset: IsobaricDataset, lines: ArrayLike, specimen: Specimen | None = None, scatter: float = 0.0
) -> list[Question]:
    """Questions that the numbers and labels of a dataset raise.

    Parameters
    ----------
    lines
        Shape (points,): line of each point in its file.
    specimen
        Muscle whose diameter the largest force has to fit; default: any muscle.
    scatter
        Force up to which points may be off the surface, a share of the largest.
    """
    slack, held = dataset.table.attrs["slack_force"], held_loads(dataset.table) is not None
    columns = dataset.pressure, dataset.contraction, dataset.force, np.asarray(lines)
    points = Points(
        *columns, slack, held, motion_side(dataset), contraction_rate(dataset.table), "time" in dataset.table, scatter
    )
    return [*questions_of_points(points, specimen), *_labels(dataset)]


def questions_of_points(points: Points, specimen: Specimen | None = None, *, most: int = 3000) -> list[Question]:
    """Questions that the numbers raise; only those of sign and ranges where there are any.

    Parameters
    ----------
    points
        Points in the order of their rows.
    specimen
        As for `questions_of`.
    most
        Number of points that are compared with each other; of more, every second, third ... is taken.

    Examples
    --------
    >>> pressure, contraction = (grid.ravel() for grid in np.meshgrid([1e5, 2e5, 3e5], np.linspace(0.0, 0.15, 6)))
    >>> force = 2.6e-3 * pressure * (1 - contraction / 0.26) ** 2
    >>> rows = np.arange(1, 19)
    >>> questions_of_points(Points(pressure, contraction, force, rows))
    []
    >>> [question.topic for question in questions_of_points(Points(pressure, contraction, force + 200, rows))]
    ['zero']
    """
    if not len(points.force):
        return [Question(Problem("has no rows of numbers"))]
    if asked := list(_sign(points)) or list(_ranges(points, specimen)):
        return asked
    points = points.every(1 + len(points.force) // most)
    checks = _copies, _saturated, _counted, _surface, _exchanged, _offsets
    questions = [asked for check in checks for asked in check(points)]
    return [*questions, *_shifted(points, warn=not questions)]


def _sign(points: Points) -> Iterator[Question]:
    """Forces that are negative: an offset, or if most are and do not rise with the pressure, a wrong sign."""
    force, rise = points.force, (points.pressure - points.pressure.mean()) @ points.force
    limit = SLACK * np.abs(force).max()
    negative, positive = np.count_nonzero(force < -limit), np.count_nonzero(force > limit)
    if negative:
        text = f"{negative} of {len(force)} forces are negative, down to {force.min():.4g} N, but a muscle only pulls"
        yield points.ask("sign" if negative <= positive or rise > 0 else "", text, field="force", remedy="sign")


def _ranges(points: Points, specimen: Specimen | None) -> Iterator[Question]:
    """Units and signs by orders of magnitude: pressures, contractions, and the diameter that the force implies."""
    pressure, contraction, force = points.pressure, points.contraction, points.force
    low, high = pressure.min() / bar, pressure.max() / bar
    if not 1 <= high <= 12 or low < -0.3:
        text = f"pressures of {low:.3g} to {high:.3g} bar are unusual for a muscle"
        yield points.ask("range", text, field="pressure")
    low = contraction.min() / percent
    high = contraction[points.taut].max(initial=contraction.min()) / percent
    if not -6 <= low <= 16 or high > 40 or 0 < np.abs(contraction).max() < 1 * percent:
        text = f"contractions of {low:.3g} to {high:.3g} % are unusual for a muscle"
        yield points.ask("range", text, field="contraction", remedy="stretched" if low < 0 >= high else "range")
    at = int(np.argmax(np.where(pressure > 0, force, 0)))
    if not (force[at] > 0 and pressure[at] > 0):
        yield points.ask("range", "no point has a force and a pressure above 0", field="force")
        return
    diameter = air.implied_diameter(force[at] / pressure[at], contraction[at])
    known = specimen.initial_diameter if specimen else None
    smallest, largest = (known * ratio for ratio in air.USUAL_DIAMETERS) if known else air.DIAMETERS
    if not smallest <= diameter <= largest:
        whose = f", but {specimen.name} has {known / mm:.3g} mm: is it in kgf or lbf?" if known and specimen else ""
        text = f"the largest force is that of a muscle of about {diameter / mm:.2g} mm diameter{whose},"
        yield points.ask("range", text, at, "force")


def _copies(points: Points) -> Iterator[Question]:
    """Rows that are no measurements of their own.

    Blocks of rows that repeat others, zeros of all columns, numbers or ranges of channels in the first row, and a first
    or last row, of the table or of a pressure, that equals the mean, median or deviation of the others to the last
    decimal. No muscle pulls most where it is shortest, at any pressure.
    """
    rows = points.table
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    earlier = first[inverse.ravel()]
    copied = (earlier < np.arange(len(rows))) & points.taut
    on = copied[1:] & copied[:-1] & (np.diff(earlier) == 1)
    if np.count_nonzero(on) > max(2, 2 * np.count_nonzero(copied[:-1] & ~on)):  # repeats of coarse readings end at once
        text = f"{np.count_nonzero(copied)} of {len(rows)} rows repeat others in the same order, first"
        yield points.ask("rows", text, int(np.argmax(copied)))
    zeros = np.flatnonzero(~rows.any(axis=1))
    if 0 < len(zeros) < 3 and np.count_nonzero(rows[:, 0] == 0) == len(zeros):
        yield points.ask("rows", "all numbers of a row are 0: a restart?", int(zeros[0]))
    if np.allclose(rows[0], (1, 2, 3)):
        yield points.ask("rows", "looks like numbers of channels:", 0)
    if len(rows) > 1 and np.all(rows[0] > rows[1:].max(axis=0)):
        yield points.ask("rows", "exceeds all others in pressure, contraction and force, as ranges of channels do:", 0)
    level = pressure_levels(points.pressure)
    parts = [np.arange(len(rows)), *(np.flatnonzero(level == pressure) for pressure in np.unique(level))]
    summaries = (row for part in parts for order in (part, part[::-1]) for row in _summaries(points, order))
    if (row := next(summaries, None)) is not None:
        yield points.ask("rows", "equals the mean, median or deviation of other rows:", row)


def _summaries(points: Points, order: NDArray[np.int64]) -> Iterator[int]:
    """First of up to four rows at the end of others that are their averages, deviations and ends.

    They may have fewer decimals than the others.
    """
    rows, averages = points.table[order], (np.mean, np.median, np.std, partial(np.std, ddof=1))
    usual = [_resolution(column) for column in rows.T]
    for count in range(1, min(5, len(rows) - 2)):
        others, last = rows[:-count], rows[-count:]
        coarsest = 1.0 if count == 1 else 10.0  # bar, % and N: a lone row may agree by chance
        tolerance = 0.6 * np.maximum(usual, np.minimum(_last_decimal(last[None]), coarsest))
        values = [of(others, axis=0) for of in (*averages, np.min, np.max)]
        values.insert(0, values[3] / np.sqrt(len(others)))  # standard error
        equal = [np.all(np.abs(value - last) <= tolerance, axis=1) for value in values]
        average = np.any(equal[:5], axis=0)
        if (average & points.taut[order[-count:]]).any() and np.any(equal, axis=0).all() and np.ptp(others[:, 2]):
            yield int(order[-count])


def _resolution(values: Floats) -> float:
    """Power of ten of the last decimal of numbers, or their least difference where another unit was written.

    >>> _resolution(np.array([1.25, 3.0])), _resolution(np.array([120.0, 50.0])), _resolution(0.9765625 * np.arange(4))
    (0.01, 10.0, 0.9765625)
    """
    if step := float(_last_decimal(values)):
        return step
    differences = np.diff(np.unique(values))
    return float(differences[differences > 1e-9].min(initial=np.inf))


def _last_decimal(values: Floats) -> Floats:
    """Power of ten, from 1e3 to 1e-5, of the last decimal of all numbers along the first axis; 0 if they have more."""
    steps = 10.0 ** -np.arange(-3, 6).reshape(-1, *np.ones(values.ndim, int))
    error = 1e-6 * steps + 2e-16 * np.abs(values).max(initial=0.0)
    rounded = np.abs(values - steps * np.round(values / steps)) <= error
    return np.max(steps[:, 0] * rounded.all(axis=1), axis=0)


def _saturated(points: Points) -> Iterator[Question]:
    """Readings at the end of a sensor's range.

    The largest force repeats, or forces within 3 % of it belong to points of which one has 15 % more pressure and is
    shorter; or the highest pressure repeats more often than those of other levels (binomial test, 1 %), while not all
    pressures repeat, as set ones do. Or a force stays in five rows, and no other in two.
    """
    from scipy.special import bdtrc

    level = pressure_levels(points.pressure)
    parts = [points.pressure[level == value] for value in np.unique(level[np.isfinite(level)])]
    *others, last = [(np.count_nonzero(part == part.max()), len(part)) for part in parts if len(part) > 3] or [(0, 1)]
    usual = [count / size for count, size in others]
    some = np.unique(points.pressure, return_counts=True)[1].min() == 1
    if others and some and max(usual) < 1 and bdtrc(last[0] - 1, last[1], np.mean(usual)) < 0.01:
        text = "the highest pressure repeats, and the others scatter: is the sensor saturated, first"
        yield points.ask("saturation", text, int(np.argmax(points.pressure)), "pressure")
    if points.held:  # the forces are not those of a sensor
        return
    begins, lengths = runs(points.force)
    stays = lengths * points.taut[begins]
    if np.count_nonzero(stays > 1) == 1 and 4 < stays.max() < len(points.force):  # else a weight
        first = int(begins[stays.argmax()])
        yield points.ask("rows", "the force stays for 5 rows or more: was the sensor stuck, first", first)
    top = np.flatnonzero(points.force >= 0.97 * points.force.max())
    pressure, stroke = points.pressure[top], np.ptp(points.contraction)
    shorter = points.contraction[top, None] - points.contraction[top]
    apart = (pressure > 1.15 * pressure[:, None]) & (shorter > 0.1 * stroke)
    counts = np.unique(points.force[points.taut], return_counts=True)[1]
    repeats = len(counts) > 2 and counts[-1] > max(2, 2 * max(counts[:-1]))
    if len(top) < len(points.force) and (apart.any() or repeats):
        text = "forces of very different points are within 3 % of the largest: is the sensor saturated, first"
        yield points.ask("saturation", text, int(top[np.argmax(apart.any(axis=1))]), "force")


def _counted(points: Points) -> Iterator[Question]:
    """Pressures that a spreadsheet counted up while the muscle reversed."""
    steps, moves = np.diff(points.pressure), np.diff(points.contraction)
    large = moves[np.abs(moves) > 0.1 * np.median(np.abs(moves))] if len(moves) else moves
    equal = len(steps) > 3 and steps.any() and np.allclose(steps, steps[0], rtol=1e-6, atol=0)
    if equal and np.count_nonzero(np.diff(np.sign(large))) > 1:
        yield points.ask("rows", "the pressure rises by one step from row to row: was it counted up?", field="pressure")


def _surface(points: Points) -> Iterator[Question]:
    """Slopes and residuals of ``F = p (a + b x + c x^2) + d + e x + f exp(-6 x)`` of the taut points, x up to 1.

    The force has to rise with the pressure and to fall with the contraction, as the plane through the points shows. A
    point is off the surface if it differs by a quarter of its force, and by four times as much as 80 % of the
    points do. Slack points count only where another one, at no more pressure and no longer, pulls, or where a lone one
    would be taut by the surface. With known rates, friction and a damper by direction are added, and other points do
    not count.

    Where loads are held, the contraction has to rise with the pressure and to fall with the load, and it differs by a
    quarter of its range, by the mean slope over such a distance; friction depends on p and x, and a muscle that is
    stretched may be stiff.
    """
    from scipy.linalg import orth

    rows, taut, largest = points.table, np.flatnonzero(points.taut), points.force.max()
    if 6 * len(taut) < len(rows):
        yield points.ask("order", "nearly all forces are below 5 % of the largest,", int(np.argmax(points.force)))
    if len(taut) < 4 or np.ptp(rows[taut, 2]) < _TAUT * largest:
        return
    falls_with, measured = (2, 1) if points.held else (1, 2)
    plane = force_plane(rows[taut, falls_with], rows[taut, 0], rows[taut, measured])
    if min(plane.falls, plane.rises) < -1 or plane.share < 1 / 2:
        text = "the force does not rise with the pressure and fall with the contraction"
        yield points.ask("order", f"{text}: exchanged columns, a wrong sign?", field="force")
    p, x = rows[:, 0], rows[:, 1] / np.abs(rows[:, 1]).max(initial=1e-9)
    terms = _surface_terms(p, x)[0]
    moving = np.ones(len(rows), bool) if points.rate is None or points.held else np.isfinite(points.rate)
    if points.held and points.side is not None:
        terms = np.column_stack([terms, points.side, points.side * p, points.side * x])
    elif not moving.all() and 2 * np.count_nonzero(moving) > len(rows):
        rate, taut = np.nan_to_num(points.rate), np.flatnonzero(points.taut & moving)  # type: ignore[arg-type]
        terms = np.column_stack([terms, np.sign(rate), rate, np.abs(rate)])
    else:
        moving[:] = True
    if len(taut) < 2 * terms.shape[1]:
        return
    scale = 1 / np.maximum(rows[taut, 2], 0.1 * largest)
    weights = scale
    for _ in range(4):  # single points must not bend the surface
        solution = np.linalg.lstsq(terms[taut] * weights[:, None], rows[taut, 2] * weights, rcond=None)[0]
        apart = np.abs(rows[:, 2] - terms @ solution)
        weights = scale / np.maximum(1.0, apart[taut] * scale / (3 * np.median(apart[taut] * scale) + 1e-9))
    share = apart / np.maximum(rows[:, 2], _TAUT * largest)
    leverage = np.sum(np.square(orth(terms[taut, :6] * scale[:, None], _RANK)), axis=1)
    left_out = apart[taut] / np.maximum(1 - leverage, 1e-6)  # residual of a fit without the point
    most = np.maximum(np.median(rows[taut, 2]), 0.25 * rows[taut, 2])
    if points.held:
        shorter, longer = (np.clip(x + 0.25 * sign * np.ptp(x), x.min(), x.max()) for sign in (1, -1))
        forces = (_surface_terms(p, at)[0] @ solution[:6] for at in (shorter, longer))
        slope = np.abs(np.subtract(*forces)) / (shorter - longer)
        share = apart / np.maximum(slope, 1e-9) / np.ptp(x)
        most = np.where(x[taut] < 0, np.inf, slope[taut] * np.ptp(x))
        share[x < 0] = 0.0
    usual = np.quantile(share[taut], 0.8)
    level = np.where(np.isnan(level := pressure_levels(points.pressure)), points.pressure, level)
    stronger = (level[:, None] >= level) & (rows[:, None, 1] <= rows[:, 1])
    stronger &= rows[:, 2] > rows[:, None, 2] + 0.03 * largest
    lone = (np.count_nonzero(~points.taut) < 3) & (terms @ solution > 0.06 * largest)
    far = (points.taut | stronger.any(axis=1) | lone) & (share > max(4 * usual, 0.25))
    far[taut] |= left_out > most
    far &= moving & (apart > points.scatter * largest)
    if far.any():
        worst = int(np.argmax(np.where(far, share, 0)))
        yield points.ask("order", f"{np.count_nonzero(far)} off the surface through the other points, most", worst)


def _surface_terms(p: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Terms of the surface at pressures and relative contractions, and their derivatives by both, (points, 6) each."""
    ones, zeros, decayed = np.ones_like(p), np.zeros_like(p), np.exp(-6 * x)
    terms = p, p * x, p * x * x, ones, x, decayed
    by_pressure = ones, x, x * x, zeros, zeros, zeros
    by_contraction = zeros, p, 2 * p * x, zeros, ones, -6 * decayed
    first, second, third = (np.column_stack(columns) for columns in (terms, by_pressure, by_contraction))
    return first, second, third


def _shifted(points: Points, *, warn: bool) -> Iterator[Question]:
    """Question about a shift that no muscle does, and of means exceeds the scatter of their forces, or a warning."""
    shift = shift_of(points)
    if shift is None or shift.change < points.scatter * points.force.max():
        return
    if shift.certain:
        yield points.ask("order", f"the {shift.text}:", shift.row, shift.name, "shift")
    elif warn:
        text = f"line {int(points.lines[shift.row])}: {shift.text}, or the muscle changed, as in its first strokes"
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())


class Shift(NamedTuple):
    """Shift of a quantity from a row on: its name, text, change of forces [N], and whether no muscle does the same."""

    row: int
    name: str
    text: str
    change: float
    certain: bool


def shift_of(points: Points, *, fewest: int = 24, least: float = 0.02) -> Shift | None:
    """Shift of pressures, contractions or forces from some row on: another zero, a gauge that became absolute.

    It halves the residuals of the surface, and changes forces by a share `least` of the largest. First strokes and
    creep are in proportion to the pressure, as a pressure that is shifted by less than 0.5 bar, or a contraction by
    less than 0.5 %; no muscle changes its force alike at all pressures. A shift between two loads is certain if more
    than one load is on either side, and five in all, as two or three fit any law.
    """
    taut = np.flatnonzero(points.taut)
    if len(taut) < fewest or (points.timed and not points.scatter):
        return None
    side = np.zeros(len(points.force)) if points.side is None else points.side
    rows, side = points.table[taut], side[taut]
    usual, largest = np.median(np.abs(_linearised(rows, side)[0])), points.force.max()
    shifts = [_shift(rows, side, quantity) for quantity in range(2 if points.held else 3)]
    quantity = int(np.argmin([shift.rmse for shift in shifts]))
    row, size, change, _, median = shifts[quantity]
    if median > 0.5 * usual or change < least * largest:
        return None
    if points.held:
        loads = level_means(rows[:, 2], 0.01 * largest)
        before, after = (len(np.unique(part)) for part in (loads[:row], loads[row:]))
        if loads[row - 3] != loads[row + 2] and (min(before, after) < 2 or before + after < 5):
            return None
    name, unit = (("pressure", "bar"), ("contraction", "%"), ("force", "N"))[quantity]
    text = f"{name}s from this row on are shifted by {size:+.3g} {unit}"
    return Shift(int(taut[row]), name, text, change, abs(size) >= (0.5, 0.5, 0.0)[quantity])


class _Shift(NamedTuple):
    """Row from which a quantity is shifted, by how much, also in force [N]; and residuals [N] without it."""

    row: int
    size: float
    change: float
    rmse: float
    median: float


def _shift(measured: Floats, side: Floats, quantity: int, *, steps: int = 8) -> _Shift:
    """Shift of a measured quantity, a column of pressure, contraction and force, that reduces the residuals most.

    By Gauss-Newton steps: the row is that of the first, of which no more than three rows are before or after it.
    """
    corrected, row, size, most = measured.copy(), 0, 0.0, np.ptp(measured[:, quantity])
    for _ in range(steps):
        residuals, basis, slopes = _linearised(corrected, side)
        slope = slopes[:, quantity]
        product, shared, square = (
            np.cumsum(values[::-1], axis=0)[::-1]  # of all rows from one on
            for values in (slope * residuals, slope[:, None] * basis, slope**2)
        )
        apart = np.maximum(square - np.sum(shared**2, axis=1), 1e-6 * square + 1e-12)
        row = row or int(np.argmax((product**2 / apart)[3:-3])) + 3
        size = float(np.clip(size - product[row] / apart[row], -most, most))
        corrected[row:, quantity] = measured[row:, quantity] - size
    residuals, _, slopes = _linearised(corrected, side)
    residuals, change = np.abs(residuals), float(np.max(np.abs(size * slopes[:, quantity])))
    return _Shift(row, size, change, float(np.sqrt(np.mean(residuals**2))), float(np.median(residuals)))


def _linearised(measured: Floats, side: Floats) -> tuple[Floats, Floats, Floats]:
    """Residuals of the surface, quadratic in the pressure and with friction by direction; its basis and its slopes.

    Shapes (points,), (points, terms) and (points, 3), slopes of modelled less measured force.
    """
    from scipy.linalg import orth

    p, force, scale = measured[:, 0], measured[:, 2], np.abs(measured[:, 1]).max(initial=1e-9)
    x = measured[:, 1] / scale
    terms, by_pressure, by_contraction = _surface_terms(p, x)
    squares, zeros = p[:, None] ** 2 * terms[:, 3:5], np.zeros((len(p), 1))
    all_terms = np.column_stack([terms, squares, side, side * p, side * x])
    basis, solution = np.asarray(orth(all_terms, _RANK)), np.linalg.lstsq(all_terms, force, _RANK)[0]
    slopes = [
        np.column_stack([by_pressure, 2 * p[:, None] * terms[:, 3:5]]) @ solution[:8],
        np.column_stack([by_contraction, zeros, p**2]) @ solution[:8] / scale,
        np.full(len(p), -1.0),
    ]
    return force - basis @ (basis.T @ force), basis, np.column_stack(slopes)


class ForcePlane(NamedTuple):
    """Plane through forces over contraction and pressure.

    Attributes
    ----------
    falls, rises
        How far it falls with the contraction and rises with the pressure, in half widths of a 95 % interval: below -1
        or above 1 significantly.
    share
        Share of the variance of the force that it explains.
    """

    falls: float
    rises: float
    share: float


def force_plane(contraction: Floats, pressure: Floats, force: Floats) -> ForcePlane:
    """Plane through forces by least squares, shape (points,) each.

    By partial correlation: the t value of a slope is that of the residuals of force and regressor given the other.
    """
    from scipy.special import stdtrit

    ones, total, freedom = np.ones_like(force), float(np.sum((force - force.mean()) ** 2)), len(force) - 3
    if not total or freedom < 1:
        return ForcePlane(0.0, 0.0, 0.0)
    left = float(np.sum(residuals_of(force, np.column_stack([ones, contraction, pressure])) ** 2))

    def ratio(values: Floats, other: Floats) -> float:
        basis = np.column_stack([ones, other])
        own, rest = residuals_of(values, basis), residuals_of(force, basis)
        half = float(stdtrit(freedom, 0.975) * np.sqrt(left / freedom * (own @ own)))
        return float(own @ rest) / half if np.ptp(own) > 1e-9 * np.abs(values).max() else 0.0

    return ForcePlane(-ratio(contraction, pressure), ratio(pressure, contraction), 1 - left / total)


def residuals_of(values: Floats, basis: Floats) -> Floats:
    """Residuals of values, shape (points,), by least squares with a basis, shape (points, columns)."""
    return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])


def _exchanged(points: Points) -> Iterator[Question]:
    """Contraction without load that is proportional to the pressure, as the force at full length is."""
    level = np.nan_to_num(pressure_levels(points.pressure))
    free = [rows[np.argmin(points.force[rows])] for rows in (np.flatnonzero(level == at) for at in np.unique(level))]
    ratio = points.contraction[free] / np.maximum(points.pressure[free], 1.0)
    slack = points.force[free].max() <= SLACK * points.force.max()
    if len(free) > 2 and slack and points.force.max() < 50 and 0 < ratio.max() < 1.15 * ratio.min():
        yield points.ask("order", "the contraction without load is proportional to the pressure: exchanged columns?")


def _offsets(points: Points) -> Iterator[Question]:
    """Forces that begin at the pressure of the atmosphere, or that remain without pressure.

    Least squares with p (a + b eps + c eps^2) + d + e eps, in which d and e eps are 0 without an offset.
    """
    force, pressure, contraction = points.force, points.pressure / bar, points.contraction
    stroke = np.ptp(contraction)
    used = (force > max(_TAUT * force.max(), points.slack_force)) & (contraction <= contraction.min() + 0.6 * stroke)
    p, eps = pressure[used], (contraction[used] - contraction.min()) / (stroke or 1.0)
    design = np.column_stack([p, np.ones(len(p)), eps, p * eps, p * eps**2])[:, : 5 if stroke else 2]
    few = len(p) <= design.shape[1] + 1 or len(np.unique(np.round(20 * p / p.max()))) < 3
    if few or contraction.min() > 0.5 * percent:
        return
    solution = np.linalg.lstsq(design, force[used], rcond=None)[0]
    residual = force[used] - design @ solution
    covariance = np.linalg.pinv(design.T @ design) * (residual @ residual) / (len(p) - design.shape[1])
    begin = -solution[1] / solution[0]
    gradient = np.array([begin, 1.0]) / solution[0]
    error = float(np.sqrt(gradient @ covariance[:2, :2] @ gradient))
    pull, largest = solution[1], force.max()
    if solution[0] > 0 and pressure.min() >= 0.7 and 0.75 - error <= begin <= 1.6 + error and begin > 2.5 * error:
        text = f"the force at the initial length begins at about {begin:.2g} bar: are the pressures absolute?"
        yield points.ask("gauge", text, field="pressure")
        return
    least, falls = max(SLACK * largest, 2.5 * np.sqrt(covariance[1, 1])), -solution[2:3].sum()
    if least < pull < 0.6 * largest and falls < 0.5 * pull:
        text = f"a force of about {pull:.3g} N would remain without pressure: an offset of the load cell?"
        yield points.ask("zero", text, field="force")


def _labels(dataset: IsobaricDataset) -> Iterator[Question]:
    """Set pressures and loads far from the measured ones."""
    table, level = dataset.table, dataset.levels
    for name in ("pressure", "force"):
        measured = table[name].to_numpy()
        nominal = level if name == "pressure" else table.get("set_force", table["force"]).to_numpy()
        if np.any(apart := np.abs(nominal - measured) > 0.2 * measured.max(initial=0.0)):
            text = f"{np.count_nonzero(apart)} set {name}s are far from the measured ones"
            remedy = "check the units of both, or ignore the column"
            yield question(text, "order", field=f"set_{name}", remedy=remedy)
