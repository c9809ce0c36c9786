"""Physical checks of measured points: what no muscle does is a question, not a number.

A muscle pulls; its force rises with the pressure and falls with the contraction, and is about linear in the pressure and
quadratic in the contraction (Chou and Hannaford, IEEE Trans. Robotics and Automation 12 (1996) 90).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.raw import Floats
from mckibben.dataset.table import Question, question
from mckibben.errors import Problem
from mckibben.muscle import air
from mckibben.units import bar, mm, percent

if TYPE_CHECKING:
    from mckibben.dataset.isobaric import IsobaricDataset
    from mckibben.muscle import Specimen

_PRESSURES = 0.5 * bar, 12 * bar  # highest pressure of a test
_CONTRACTIONS = -6 * percent, 45 * percent, 16 * percent  # least, largest taut, and largest first one
_DIAMETERS = 1.7 * mm, 80 * mm  # implied by force and pressure
_SMALL = 0.05  # of the largest force: below, the muscle may be slack
_UNEXPLAINED = 0.3  # of the variance of taut forces
_ATMOSPHERE = 0.75 * bar, 1.6 * bar  # pressure at which the force begins, if pressures are absolute
_UNIT = (
    "check the unit in the header, or name it: columns={'HEADER': 'force_N'} (command line: --column 'HEADER=force_N')"
)
_MOST = 3000  # points that are compared in pairs


@dataclass(frozen=True)
class Points:
    """Points of a test in the order of its rows: pressure [Pa], contraction [-], force [N], the line of each,
    and the force before an offset was subtracted.
    """

    pressure: Floats
    contraction: Floats
    force: Floats
    lines: NDArray[np.int64]
    measured: Floats
    slack_force: float = 0.0

    @property
    def taut(self) -> NDArray[np.bool_]:
        """Mask of points whose force is clearly that of a taut muscle."""
        return self.force > max(_SMALL * self.force.max(initial=0.0), self.slack_force)

    @property
    def levels(self) -> list[NDArray[np.intp]]:
        """Rows of about the same pressure, from the lowest up."""
        order = np.argsort(self.pressure, kind="stable")
        gaps = np.diff(self.pressure[order]) > 0.03 * self.pressure.max()
        return np.split(order, np.flatnonzero(gaps) + 1)

    def named(self, row: int) -> str:
        """Values of a point as text."""
        p, c, f = self.pressure[row] / bar, self.contraction[row] / percent, self.force[row]
        return f"{p:.3g} bar, {c:.3g} %, {f:.4g} N"


def questions_of_points(points: Points, specimen: Specimen | None = None) -> list[Question]:
    """Questions that the numbers raise; only those of ranges where these are impossible."""
    if not len(points.force):
        return [Question(Problem("has no rows of numbers"))]
    asked = list(_sign(points)) or list(_ranges(points, specimen))
    if asked:
        return asked
    checks: Sequence[Callable[[Points], Iterator[Question]]] = (
        _summaries,
        _integers,
        _copies,
        _saturated,
        _trend,
        _exchanged,
        _outliers,
        _repeats,
        _zeros,
        _held,
        _counted,
        _reach,
        _offsets,
        _few_slack,
    )
    return [asked for check in checks for asked in check(points)]


def _sign(points: Points) -> Iterator[Question]:
    force = points.force
    limit = _SMALL * np.abs(force).max()
    negative, positive = int((force < -limit).sum()), int((force > limit).sum())
    if negative:
        text = f"{negative} of {len(force)} forces are negative, down to {force.min():.4g} N, but a muscle only pulls"
        remedy = "turn the sign: force_sign=-1 (command line: --column 'HEADER=-force_N')"
        asked = question("sign", text, field="force", remedy=remedy)
        yield asked if negative <= positive else Question(Problem(text, field="force", remedy=remedy))


def _ranges(points: Points, specimen: Specimen | None) -> Iterator[Question]:
    """Units and signs by orders of magnitude."""
    pressure, contraction, force = points.pressure, points.contraction, points.force
    low, high = _PRESSURES
    if not low <= pressure.max() <= high or pressure.min() < -0.3 * bar:
        text = (
            f"pressures of {pressure.min() / bar:.3g} to {pressure.max() / bar:.3g} bar are not those of a muscle test"
        )
        yield question("range", text, field="pressure", remedy=_UNIT)
    least, most, first = _CONTRACTIONS
    taut = contraction[points.taut] if points.taut.any() else contraction
    if (
        contraction.min() < least
        or taut.max() > most
        or contraction.min() > first
        or 0 < np.abs(contraction).max() < 0.01
    ):
        text = f"contractions of {contraction.min() / percent:.3g} to {taut.max() / percent:.3g} % are not those of a muscle test"
        yield question(
            "range",
            text,
            field="contraction",
            remedy=f"{_UNIT}, and its sign, and initial_length (command line: --initial-length)",
        )
    at = int(np.argmax(force))
    if not (force[at] > 0 and pressure[at] > 0):
        yield question(
            "range",
            "no force is above 0" if force[at] <= 0 else "the largest force is at no pressure",
            field="force",
            remedy=_UNIT,
        )
        return
    diameter, known = air.implied_diameter(force[at] / pressure[at]), specimen.initial_diameter if specimen else None
    smallest, largest = (known * ratio for ratio in air.USUAL_DIAMETERS) if known else _DIAMETERS
    if not smallest <= diameter <= largest:
        whose = f", but {specimen.name} has {known / mm:.3g} mm" if known and specimen else ""
        text = f"{force[at]:.4g} N at {pressure[at] / bar:.3g} bar is the force of a muscle of about {diameter / mm:.2g} mm diameter{whose}"
        yield question("range", text, field="force", remedy=_UNIT)


def _resolution(values: Floats) -> float:
    """Largest power of ten of which all values are multiples."""
    steps = 10.0 ** np.arange(np.floor(np.log10(max(np.abs(values).max(), 1e-300))), -9, -1)
    return next(
        (
            float(step)
            for step in steps
            if np.allclose(values, step * np.round(values / step), rtol=0, atol=1e-6 * step)
        ),
        0.0,
    )


def _summaries(points: Points) -> Iterator[Question]:
    """Rows that are the mean, median or deviation of the rows of their block, of all before them, or after the first."""
    rows = np.column_stack([points.pressure / bar, points.contraction / percent, points.force])
    count = len(rows)
    if not 4 <= count <= _MOST:
        return
    tolerance = 0.6 * np.array([max(_resolution(column), 1e-9) for column in rows.T])
    jumps = np.abs(np.diff(rows[:, 1], prepend=rows[0, 1])) > 0.5 * np.ptp(rows[:, 1])
    jumps |= np.abs(np.diff(rows[:, 0], prepend=rows[0, 0])) > 0.03 * rows[:, 0].max()
    start, begun = 0, 0
    for row in range(count):
        begun, start = (start, row) if jumps[row] else (begun, start)
        if not points.taut[row]:
            continue
        parts = [rows[begin:row] for begin in {0, begun, start} if row - begin > 2] + [rows[row + 1 :]] * (row < 2)
        parts += [rows[: row - 1]] * (row > 4)
        for part in parts:
            close = any(np.all(np.abs(statistic - rows[row]) <= tolerance) for statistic in _statistics(part))
            if close and np.all(np.ptp(part[:, 1:], axis=0) > 0.1 * np.ptp(rows[:, 1:], axis=0)):
                text = "equals the mean, median, range or deviation of other rows: a summary is not a measurement"
                yield question("rows", text, line=int(points.lines[row]), remedy="leave it out of the file")
                return


def _statistics(part: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    low, high = part.min(axis=0), part.max(axis=0)
    return [
        part.mean(axis=0),
        np.median(part, axis=0),
        part.std(axis=0),
        part.std(axis=0, ddof=1),
        low,
        high,
        high - low,
        part.sum(axis=0),
    ]


def _integers(points: Points) -> Iterator[Question]:
    """Single rows of integers among decimals: numbers of channels, full scales, zeros after a restart."""
    rows = np.column_stack([points.pressure / bar, points.contraction / percent, points.force])
    whole = np.all(np.abs(rows - np.round(rows)) < 1e-9, axis=1)
    zeros = np.all(rows == 0, axis=1) & (np.count_nonzero(rows[:, 0] < 0.02 * rows[:, 0].max()) < 3)
    if np.allclose(rows[0], (1, 2, 3)):
        yield question(
            "rows",
            "looks like numbers of channels (1, 2, 3)",
            line=int(points.lines[0]),
            remedy="leave it out of the file",
        )
        return
    few = np.flatnonzero(whole if np.count_nonzero(whole) <= max(1, 0.05 * len(rows)) else zeros)
    decimals = np.mean(np.abs(points.force - np.round(points.force)) > 1e-9)
    ends = [row for row in few if row in (0, len(rows) - 1) or zeros[row]]
    ends = [row for row in ends if zeros[row] or _is_off(points, row)]
    if len(few) and decimals > 0.7 and ends:
        text = f"has integers alone ({points.named(ends[0])}), unlike the others: is it a measurement?"
        yield question("rows", text, line=int(points.lines[ends[0]]), remedy="leave it out of the file")


def _is_off(points: Points, row: int) -> bool:
    """Whether a point is far off the plane through the others."""
    design = np.column_stack([np.ones(len(points.force)), points.pressure / bar, points.contraction / percent])
    others = np.arange(len(points.force)) != row
    plane, *_ = np.linalg.lstsq(design[others], points.force[others], rcond=None)
    residual = np.abs(points.force - design @ plane)
    return bool(residual[row] > 1.5 * residual[others].max())


def _copies(points: Points) -> Iterator[Question]:
    """Rows that repeat earlier ones, four or more in the same order."""
    rows = np.column_stack([points.pressure, points.contraction, points.force])
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    earlier = first[inverse.ravel()]
    copied = (earlier < np.arange(len(rows))) & points.taut
    follows = copied[1:] & copied[:-1] & (np.diff(earlier) == 1)
    lengths = np.diff(np.flatnonzero(np.diff(follows, prepend=False, append=False)))[::2]
    if len(lengths) and lengths.max() >= 3:
        text = f"{np.count_nonzero(copied)} of {len(rows)} rows repeat others in the same order: copies make intervals too narrow"
        yield question("rows", text, remedy="leave the copies out of the file")


def _saturated(points: Points) -> Iterator[Question]:
    """Largest values that repeat, or that are reached under very different conditions."""
    for name, values, scale, unit in (
        ("force", points.force, 1.0, "N"),
        ("pressure", points.pressure, bar, "bar"),
        ("contraction", points.contraction, percent, "%"),
    ):
        levels, counts = np.unique(values, return_counts=True)
        others = counts[:-1][levels[:-1] > 0.1 * levels[-1]].max(initial=1)
        if name == "pressure":
            counts[-1], others = (3, 1) if _is_cut_off(values) else (0, 1)
        if len(levels) > 2 and counts[-1] > max(2 * others, 2):
            remedy = (
                f"leave such rows out: in a recipe largest_force: {values.max():g} N"
                if name == "force"
                else "leave such rows out of the file"
            )
            text = f"the largest {name}, {values.max() / scale:.4g} {unit}, repeats: is the sensor saturated?"
            yield question("saturation", text, field=name, remedy=remedy)
            return
    top = np.flatnonzero(points.force >= 0.97 * points.force.max())
    if len(top) > 200 or len(top) == len(points.force):
        return
    shorter = points.contraction[top, None] - points.contraction[top]
    stroke, weaker = np.ptp(points.contraction), points.pressure[top] > 1.15 * points.pressure[top, None]
    apart = (weaker & (shorter > 0.1 * stroke)) | (
        (shorter > max(0.25 * stroke, 2.5 * percent)) & (1.05 * points.pressure[top] >= points.pressure[top, None])
    )
    if apart.any():
        one, other = np.argwhere(apart)[0]
        text = f"forces within 3 % of the largest are reached at {points.named(top[one])} and {points.named(top[other])}: is the sensor saturated?"
        yield question(
            "saturation",
            text,
            field="force",
            remedy=f"leave such rows out: in a recipe largest_force: {0.97 * points.force.max():.4g} N",
        )


def _is_cut_off(values: Floats) -> bool:
    """Whether the highest level has one value, while the others scatter."""
    ordered = np.sort(values)
    *others, top = np.split(ordered, np.flatnonzero(np.diff(ordered) > 0.05 * ordered[-1]) + 1)
    others = [level for level in others if len(level) > 3]
    share = np.mean(top == top[-1])
    scatter = [len(np.unique(level)) for level in others]
    if len(top) < 4 or not others or min(scatter) < 2:
        return False
    rare = min(scatter) > 2 and all(np.mean(level == level[-1]) < 0.35 + 0.2 * (share > 0.85) for level in others)
    return bool(share == 1 or (rare and share > (0.6 if len(top) > 5 else 0.75)))


def _trend(points: Points) -> Iterator[Question]:
    """Force that falls with the pressure or rises with the contraction, or does not depend on them."""
    taut = points.taut
    p, c, f = (
        values[taut] - values[taut].mean()
        for values in (points.pressure / bar, points.contraction / percent, points.force)
    )
    if len(f) < 4 or np.ptp(f) < 0.15 * points.force.max():
        return
    slopes = np.linalg.lstsq(np.column_stack([p, c]), f, rcond=None)[0]
    rest = f - np.column_stack([p, c]) @ slopes
    still = [
        np.ptp(values) < 0.02 * np.abs(whole).max()
        for values, whole in ((p, points.pressure / bar), (c, points.contraction / percent))
    ]
    wrong = (
        (slopes[0] <= 0 and not still[0]) or (slopes[1] >= 0 and not still[1]) or rest @ rest > _UNEXPLAINED * (f @ f)
    )
    if wrong:
        text = "the force does not rise with the pressure and fall with the contraction: columns may be exchanged, or a sign wrong"
        yield question(
            "order",
            text,
            field="force",
            remedy="check columns, the sign of the contraction and the direction of a displacement",
        )


def _exchanged(points: Points) -> Iterator[Question]:
    """Contraction without load that is proportional to the pressure, as the force at full length is."""
    free = [level[np.argmin(points.force[level])] for level in points.levels]
    pressure, reached = points.pressure[free], points.contraction[free]
    slack = points.force[free] <= _SMALL * points.force.max()
    if slack.all() and len(free) > 2 and pressure.min() > 0 and points.force.max() < 50:
        ratio = reached / pressure
        if ratio.min() > 0 and ratio.max() < 1.15 * ratio.min():
            text = "without load, the contraction is proportional to the pressure, as the force at full length is: are the columns exchanged?"
            yield question("order", text, field="contraction", remedy="check the headers of force and contraction")


def _surface(points: Points) -> tuple[NDArray[np.intp], Floats]:
    """Taut rows, and their residuals from a force linear in pressure and quadratic in contraction."""
    rows = np.flatnonzero(points.taut)
    p, c = points.pressure[rows] / bar, points.contraction[rows] / percent
    terms = np.column_stack([np.ones_like(p), p, c, p * c, c * c, p * c * c, p * p])
    scale = 1 / np.maximum(points.force[rows], 0.1 * points.force.max())
    weights = scale.copy()
    for _ in range(4):  # single points must not bend the surface
        solution = np.linalg.lstsq(terms * weights[:, None], points.force[rows] * weights, rcond=None)[0]
        residual = points.force[rows] - terms @ solution
        spread = np.median(np.abs(residual * scale)) + 1e-9
        weights = scale / np.maximum(1.0, np.abs(residual * scale) / (3 * spread))
    return rows, residual


def _outliers(points: Points) -> Iterator[Question]:
    """Single points far off the surface through the others, and pressures far from all levels."""
    rows, residual = _surface(points) if np.count_nonzero(points.taut) > 11 else (np.empty(0, np.intp), np.empty(0))
    if len(rows):
        share = np.abs(residual) / np.maximum(points.force[rows], 0.15 * points.force.max())
        usual = np.quantile(share, 0.8)
        far = np.flatnonzero(share > max(4 * usual, 0.12))
        if 0 < len(far) <= max(3, 0.1 * len(rows)):
            worst = rows[far[np.argmax(share[far])]]
            text = f"{len(far)} of {len(points.force)} points are off the surface through the others, most {points.named(worst)}"
            yield question("order", text, line=int(points.lines[worst]), field="force", remedy="check these rows")
            return
        if usual > 0.25:
            yield question(
                "order",
                f"forces scatter by {100 * usual:.0f} % about a smooth surface: are they of one muscle?",
                field="force",
                remedy="check the rows",
            )
            return
    levels = [level for level in points.levels if len(level) > 2]
    alone = [int(level[0]) for level in points.levels if len(level) == 1]
    if len(levels) > 1 and len(alone) == 1 and 0 < alone[0] < len(points.force) - 1:
        beside = [points.pressure[alone[0] + step] for step in (-1, 1)]
        if abs(beside[0] - beside[1]) < 0.03 * points.pressure.max():
            yield question(
                "order",
                f"the pressure of {points.named(alone[0])} is far from those around it",
                line=int(points.lines[alone[0]]),
                remedy="check this row",
            )


def _repeats(points: Points) -> Iterator[Question]:
    """Forces at the same pressure and contraction that differ by more than friction and creep."""
    places = np.column_stack(
        [np.round(points.pressure / (0.01 * points.pressure.max())), np.round(points.contraction / 0.1 / percent)]
    )
    _, place = np.unique(places, axis=0, return_inverse=True)
    place = place.ravel()
    high, low = np.full(place.max() + 1, -np.inf), np.full(place.max() + 1, np.inf)
    np.maximum.at(high, place, points.force)
    np.minimum.at(low, place, points.force)
    several = (np.bincount(place) > 1) & (high > 0.15 * points.force.max())
    apart = several & (high - low > np.maximum(0.3 * high, 0.15 * points.force.max()))
    if apart.sum() > 2 and 2 * apart.sum() >= several.sum():
        row = int(np.argmax(apart[place]))
        text = f"forces at {points.named(row)} differ by {high[place[row]] - low[place[row]]:.4g} N, and as much elsewhere: several muscles, or a stuck sensor?"
        yield question("order", text, field="force", remedy="read the rows of one muscle")


def _zeros(points: Points) -> Iterator[Question]:
    """Forces or contractions of exactly 0 where the muscle cannot be slack, or at its full length."""
    force, contraction, pressure = points.force, points.contraction, points.pressure
    for row in np.flatnonzero(points.measured == 0)[:_MOST]:
        longer = (force > 0.1 * force.max()) & (contraction >= contraction[row]) & (pressure <= 1.01 * pressure[row])
        if longer.any():
            text = (
                f"the force is 0 ({points.named(row)}), but the muscle pulls at less pressure and a larger contraction"
            )
            yield question(
                "rows", text, line=int(points.lines[row]), field="force", remedy="leave rows without a measurement out"
            )
            return
    at = np.flatnonzero(points.measured == 0)
    least = max(0.01 * force.max(), 3 * _resolution(points.measured))
    for step in (-1, 1):
        rows = at[(at + 2 * step >= 0) & (at + 2 * step < len(force))]
        near, far = rows + step, rows + 2 * step
        with np.errstate(all="ignore"):
            ratio = (contraction[rows] - contraction[near]) / (contraction[near] - contraction[far])
            line = force[near] + (force[near] - force[far]) * ratio
        level = np.abs(pressure[[near, far]] - pressure[rows]).max(axis=0) <= 0.05 * pressure[rows]
        lost = rows[level & (ratio > 0) & (ratio <= 1.5) & (line > np.maximum(least, 0.1 * force[near]))]
        clear = (0.03 if len(at) <= max(3, 0.02 * len(force)) else 0.1) * force.max()
        lost = lost[force[lost + step] > clear]
        if lost.size:
            text = f"the force is 0 ({points.named(lost[0])}), but the line through its neighbours is clearly above"
            yield question("rows", text, line=int(points.lines[lost[0]]), field="force", remedy="leave it out")
            return
    for row in np.flatnonzero(contraction == 0)[:_MOST]:
        same = np.abs(pressure - pressure[row]) < 0.02 * pressure.max()
        stronger = same & (contraction > 0.3 * contraction.max()) & (force > force[row] + 0.01 * force.max())
        if stronger.any():
            text = f"the contraction is 0 ({points.named(row)}), but a shorter muscle pulls more at this pressure"
            yield question("rows", text, line=int(points.lines[row]), field="contraction", remedy="check these rows")
            return


def _held(points: Points) -> Iterator[Question]:
    """Forces or pressures that stand still for some rows while the muscle moves."""
    moved = np.abs(np.diff(points.contraction)) > 0.3 * percent
    same = (np.diff(points.force) == 0) & moved & points.taut[1:]
    runs = np.diff(np.flatnonzero(np.diff(same, prepend=False, append=False)))[::2]
    often = np.mean(same) > 0.2 and _resolution(points.force) < 0.01 * points.force.max()
    if len(runs) and (runs.max() >= 2 or often) and len(np.unique(points.force)) > len(points.force) / 3:
        row = int(np.argmax(same))
        yield question(
            "rows",
            f"the force stands still from {points.named(row)} on, although the muscle moved",
            line=int(points.lines[row]),
            field="force",
            remedy="check these rows",
        )


def _counted(points: Points) -> Iterator[Question]:
    """Columns that a spreadsheet counted up, and pressures that stand still while forces differ."""
    steps, moves = np.diff(points.pressure), np.diff(points.contraction)
    reversals = np.count_nonzero(np.diff(np.sign(moves[np.abs(moves) > 0.1 * np.median(np.abs(moves))])))
    if steps.any() and len(steps) > 3 and np.allclose(steps, steps[0], rtol=1e-6, atol=0) and reversals > 1:
        text = f"each row has {steps[0] / bar:.3g} bar more than the one before, although the muscle reversed: was it counted up?"
        yield question("rows", text, field="pressure", remedy="check the column")


def _reach(points: Points) -> Iterator[Question]:
    """A contraction at which the force would end that no muscle reaches."""
    stroke = np.ptp(points.contraction)
    wide = [
        level
        for level in points.levels
        if len(level) > 3 and np.ptp(points.contraction[level]) >= max(0.5 * stroke, 5 * percent)
    ]
    if wide:
        rows = max(wide, key=lambda level: points.force[level].mean())
        slope, start = np.polyfit(points.contraction[rows], points.force[rows], 1)
        if slope < 0 and -slope * np.ptp(points.contraction[rows]) > 0.15 * start and -start / slope > 0.45:
            text = f"the force would end at a contraction of {-start / slope / percent:.2g} %, but muscles contract by 20 to 35 %"
            yield question(
                "zero",
                text,
                field="contraction",
                remedy=f"{_UNIT}, initial_length (command line: --initial-length), and the zero of the load cell",
            )


def _offsets(points: Points) -> Iterator[Question]:
    """Forces that begin at the pressure of the atmosphere, or that remain without pressure."""
    force, pressure, contraction = points.force, points.pressure, points.contraction
    used = (force > max(0.15 * force.max(), points.slack_force)) & (
        contraction <= contraction.min() + 0.6 * np.ptp(contraction)
    )
    stroke = np.ptp(contraction) or 1.0
    p, eps = pressure[used] / bar, (contraction[used] - contraction.min()) / stroke
    design = np.column_stack([p, np.ones(len(p)), eps, p * eps, p * eps**2])[:, : 5 if np.ptp(contraction) else 2]
    if (
        contraction.min() > 0.5 * percent
        or len(p) <= design.shape[1] + 1
        or len(np.unique(np.round(p / (0.05 * p.max())))) < 3
    ):
        return
    solution = np.linalg.lstsq(design, force[used], rcond=None)[0]
    residual = force[used] - design @ solution
    covariance = np.linalg.pinv(design.T @ design) * (residual @ residual) / (len(p) - design.shape[1])
    slope, start = solution[:2]
    if slope <= 0:
        return
    begin = -start / slope
    gradient = np.array([begin, 1.0]) / slope
    error = float(np.sqrt(gradient @ covariance[:2, :2] @ gradient))
    low, high = _ATMOSPHERE
    if (
        pressure.min() >= 0.7 * bar
        and low <= (begin + error) * bar
        and (begin - error) * bar <= high
        and begin > 2.5 * error
    ):
        text = f"the force at the initial length begins at about {begin:.2g} bar: are the pressures absolute?"
        remedy = "name it: columns={'HEADER': 'pressure_bar_abs'}, ambient=101300.0 (command line: --column 'HEADER=pressure_bar_abs' --ambient '101.3 kPa')"
        yield question("gauge", text, field="pressure", remedy=remedy)
        return
    ends = np.array([1.0, 0.0]), np.array([1.0, eps.max()])
    pulls = (
        np.array([solution[1 : 1 + len(end)] @ end for end in ends])
        if design.shape[1] > 2
        else np.array([start, start])
    )
    errors = (
        np.array([np.sqrt(end @ covariance[1:3, 1:3] @ end) for end in ends]) if design.shape[1] > 2 else np.zeros(2)
    )
    alike = pulls.max() - errors.max() < 1.5 * pulls.min()
    if np.all(pulls > np.maximum(0.05 * force.max(), 2.5 * errors)) and alike and pulls.max() < 0.6 * force.max():
        text = f"without pressure, a force of about {pulls.mean():.3g} N would remain at all contractions: an offset of the load cell?"
        yield question(
            "zero", text, field="force", remedy="subtract it in the file, or measure points of the slack muscle"
        )


def _few_slack(points: Points) -> Iterator[Question]:
    """Two to four points that show an offset of the load cell, too few for an estimate."""
    largest, ends = points.force.max(), []
    for level in points.levels:
        rows = level[np.argsort(points.contraction[level], kind="stable")]
        force, contraction = points.force[rows], points.contraction[rows]
        for count in range(min(4, len(rows) - 2), 1, -1):
            flat = np.ptp(force[-count:]) <= 0.01 * largest and force[-count - 1] - force[-1] > 0.04 * largest
            if flat and contraction[-1] - contraction[-count] > 0.5 * percent:
                ends += rows[-count:].tolist()
                break
    mean = float(points.force[ends].mean()) if ends else 0.0
    if ends and mean > max(0.02 * largest, points.slack_force) and mean <= points.force.min() + 0.01 * largest:
        text = f"the force at the {len(ends)} largest contractions is about {mean:.3g} N at each: an offset of the load cell?"
        yield question(
            "zero",
            text,
            field="force",
            remedy="subtract it in the file, or measure five or more points of the slack muscle",
        )


def questions_of_labels(dataset: IsobaricDataset) -> Iterator[Question]:
    """Set pressures far from the measured ones, and directions that are the reverse of the motion."""
    table = dataset.table
    if "set_pressure" in table:
        apart = np.abs(table["set_pressure"].to_numpy() - dataset.pressure) > 0.2 * dataset.pressure.max()
        if apart.any():
            at = int(np.argmax(apart))
            text = f"{np.count_nonzero(apart)} set pressures are far from the measured ones, first {dataset.levels[at] / bar:.3g} bar at {dataset.pressure[at] / bar:.3g} bar"
            yield question("order", text, field="set_pressure", remedy="check its unit, or ignore the column")
    if "direction" in table:
        label = table["direction"].to_numpy()
        steps = np.diff(dataset.contraction)
        steps[np.diff(dataset.levels) != 0] = 0
        used = (label[1:] == label[:-1]) & (np.abs(steps) > 0.2 * percent)
        for word, sign in (("loading", 1), ("unloading", -1)):
            if np.count_nonzero(same := used & (label[1:] == word)) < 3 or np.mean(sign * steps[same] > 0) < 0.9:
                return
        text = "the contraction grows in loading and falls in unloading: loading is being stretched"
        yield question("order", text, field="direction", remedy="exchange the words")
