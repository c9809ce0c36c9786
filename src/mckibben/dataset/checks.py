"""Physical checks of measured points: what no muscle does is a question, not a number.

A muscle pulls; its force rises with the pressure and falls with the contraction, and is about linear in the pressure
and quadratic in the contraction (Chou and Hannaford, IEEE Trans. Robotics and Automation 12 (1996) 90).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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

Rows = NDArray[np.intp]

_PRESSURES = 0.5 * bar, 12 * bar  # highest pressure of a test
_CONTRACTIONS = -6 * percent, 45 * percent, 16 * percent  # least, largest taut, and largest first one
_DIAMETERS = 1.7 * mm, 80 * mm  # implied by force and pressure
_SMALL = 0.05  # of the largest force: below, the muscle may be slack
_UNEXPLAINED = 0.3  # of the variance of taut forces
_ATMOSPHERE = 0.75 * bar, 1.6 * bar  # pressure at which the force begins, if pressures are absolute
_MANY = 50_000  # points that are compared; of more, every second, third ...
_MOST = 3000  # points that are compared in pairs
_UNIT = "check the unit: columns={'HEADER': 'force_N'} (command line: --column 'HEADER=force_N')"
_REMEDIES = {
    "range": f"{_UNIT}, the sign, and initial_length (command line: --initial-length)",
    "rows": "leave these rows out of the file",
    "order": "check these rows and the headers",
    "zero": "subtract the offset in the file, or measure five or more points of the slack muscle",
    "gauge": "name it pressure_bar_abs (command line: --column 'HEADER=pressure_bar_abs' --ambient '101.3 kPa')",
    "saturation": "leave such rows out (in a recipe: largest_force)",
    "sign": "turn the sign: force_sign=-1 (command line: --column 'HEADER=-force_N')",
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
    measured
        Force before an offset was subtracted [N].
    slack_force
        Force up to which the muscle counts as slack [N].
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
    def table(self) -> NDArray[np.float64]:
        """Pressure [bar], contraction [%] and force [N], shape (points, 3)."""
        return np.column_stack([self.pressure / bar, self.contraction / percent, self.force])

    @property
    def levels(self) -> list[Rows]:
        """Rows of about the same pressure, from the lowest up."""
        order = np.argsort(self.pressure, kind="stable")
        gaps = np.diff(self.pressure[order]) > 0.03 * self.pressure.max()
        return np.split(order, np.flatnonzero(gaps) + 1)

    def every(self, step: int) -> Points:
        """Every second point, say."""
        pressure, contraction, force = self.pressure[::step], self.contraction[::step], self.force[::step]
        return Points(pressure, contraction, force, self.lines[::step], self.measured[::step], self.slack_force)

    def ask(self, topic: str, text: str, row: int | None = None, field: str = "") -> Question:
        """A question, about a row."""
        place = "" if row is None else " at {:.3g} bar, {:.3g} %, {:.4g} N".format(*self.table[row])
        line = None if row is None else int(self.lines[row])
        return question(topic, f"{text}{place}", line=line, field=field, remedy=_REMEDIES[topic])


def questions_of_points(points: Points, specimen: Specimen | None = None) -> list[Question]:
    """Questions that the numbers raise; only those of sign and ranges where there are any."""
    if not len(points.force):
        return [Question(Problem("has no rows of numbers"))]
    checks: tuple[Callable[[Points], Iterator[Question]], ...]
    checks = (
        _summaries,
        _integers,
        _copies,
        _repeated_top,
        _same_top,
        _trend,
        _exchanged,
        _outliers,
        _strays,
        _repeats,
    )
    checks += (_zeros, _weak_zeros, _held, _counted, _reach, _offsets, _few_slack)
    asked = list(_sign(points)) or list(_ranges(points, specimen))
    if (step := 1 + len(points.force) // _MANY) > 1:
        points = points.every(step)
    return asked or [asked for check in checks for asked in check(points)]


def _sign(points: Points) -> Iterator[Question]:
    force = points.force
    limit = _SMALL * np.abs(force).max()
    negative, positive = np.count_nonzero(force < -limit), np.count_nonzero(force > limit)
    if negative:
        text = f"{negative} of {len(force)} forces are negative, down to {force.min():.4g} N, but a muscle only pulls"
        asked = points.ask("sign", text, field="force")
        yield asked if negative <= positive else Question(Problem(text, field="force", remedy=_REMEDIES["sign"]))


def _ranges(points: Points, specimen: Specimen | None) -> Iterator[Question]:
    """Units and signs by orders of magnitude."""
    pressure, contraction, force = points.pressure, points.contraction, points.force
    low, high = pressure.min() / bar, pressure.max() / bar
    if not _PRESSURES[0] <= pressure.max() <= _PRESSURES[1] or low < -0.3:
        yield points.ask(
            "range", f"pressures of {low:.3g} to {high:.3g} bar are unusual for a muscle", field="pressure"
        )
    least, most, first = _CONTRACTIONS
    taut = contraction[points.taut] if points.taut.any() else contraction
    low, high = contraction.min(), taut.max()
    if low < least or high > most or low > first or 0 < np.abs(contraction).max() < 0.01:
        text = f"contractions of {low / percent:.3g} to {high / percent:.3g} % are unusual for a muscle"
        yield points.ask("range", text, field="contraction")
    at = int(np.argmax(force))
    if not (force[at] > 0 and pressure[at] > 0):
        yield points.ask("range", "no point has a force and a pressure above 0", field="force")
        return
    diameter, known = air.implied_diameter(force[at] / pressure[at]), specimen.initial_diameter if specimen else None
    smallest, largest = (known * ratio for ratio in air.USUAL_DIAMETERS) if known else _DIAMETERS
    if not smallest <= diameter <= largest:
        whose = f", but {specimen.name} has {known / mm:.3g} mm" if known and specimen else ""
        text = f"the largest force is that of a muscle of about {diameter / mm:.2g} mm diameter{whose},"
        yield points.ask("range", text, at, "force")


def _resolution(values: Floats) -> float:
    """Largest power of ten of which all values are multiples."""
    steps = 10.0 ** np.arange(np.floor(np.log10(max(np.abs(values).max(), 1e-300))), -9, -1)
    rounded = (step for step in steps if np.allclose(values, step * np.round(values / step), rtol=0, atol=1e-6 * step))
    return float(next(rounded, 1e-9))


def _summaries(points: Points) -> Iterator[Question]:
    """Rows that are the mean, median or deviation of their block, of all rows before them, or after the first."""
    rows, begun, start = points.table, 0, 0
    if not 4 <= len(rows) <= _MOST:
        return
    tolerance = 0.6 * np.array([_resolution(column) for column in rows.T])
    jumps = np.abs(np.diff(rows[:, 1], prepend=rows[0, 1])) > 0.5 * np.ptp(rows[:, 1])
    jumps |= np.abs(np.diff(rows[:, 0], prepend=rows[0, 0])) > 0.03 * rows[:, 0].max()
    for row in range(len(rows)):
        begun, start = (start, row) if jumps[row] else (begun, start)
        parts = [rows[begin:row] for begin in {0, begun, start} if row - begin > 2]
        parts += [rows[row + 1 :]] * (row < 2) + [rows[: row - 1]] * (row > 4)
        varied = [part for part in parts if np.all(np.ptp(part[:, 1:], axis=0) > 0.1 * np.ptp(rows[:, 1:], axis=0))]
        close = (np.all(np.abs(value - rows[row]) <= tolerance) for part in varied for value in _statistics(part))
        if points.taut[row] and any(close):
            yield points.ask("rows", "equals the mean, median, range or deviation of other rows:", row)
            return


def _statistics(part: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    low, high = part.min(axis=0), part.max(axis=0)
    moments = [part.mean(axis=0), np.median(part, axis=0), part.std(axis=0), part.std(axis=0, ddof=1)]
    return [*moments, low, high, high - low, part.sum(axis=0)]


def _integers(points: Points) -> Iterator[Question]:
    """Single rows of integers among decimals: numbers of channels, full scales, zeros after a restart."""
    rows = points.table
    whole = np.all(np.abs(rows - np.round(rows)) < 1e-9, axis=1)
    alone = np.count_nonzero(rows[:, 0] < 0.02 * rows[:, 0].max()) < 3
    zeros = np.all(rows == 0, axis=1) & alone
    few = np.count_nonzero(whole) <= max(1, 0.05 * len(rows))
    decimals = np.mean(np.abs(points.force - np.round(points.force)) > 1e-9) > 0.7
    ends = np.isin(np.arange(len(rows)), [0, len(rows) - 1]) & whole & few
    for row in np.flatnonzero((ends | zeros) & decimals).tolist():
        if zeros[row] or _is_off(points, row) or np.allclose(rows[row], (1, 2, 3)):
            yield points.ask("rows", "has integers alone, unlike the others:", row)
            return
    if np.allclose(rows[0], (1, 2, 3)):
        yield points.ask("rows", "looks like numbers of channels:", 0)


def _is_off(points: Points, row: int) -> bool:
    """Whether a point is far off the plane through the others."""
    design = np.column_stack([np.ones(len(points.force)), points.table[:, :2]])
    others = np.arange(len(points.force)) != row
    plane, *_ = np.linalg.lstsq(design[others], points.force[others], rcond=None)
    residual = np.abs(points.force - design @ plane)
    return bool(residual[row] > 1.5 * residual[others].max())


def _copies(points: Points) -> Iterator[Question]:
    """Rows that repeat earlier ones, four or more in the same order."""
    _, first, inverse = np.unique(points.table, axis=0, return_index=True, return_inverse=True)
    earlier = first[inverse.ravel()]
    copied = (earlier < np.arange(len(earlier))) & points.taut
    follows = copied[1:] & copied[:-1] & (np.diff(earlier) == 1)
    if _longest_run(follows) >= 3:
        yield points.ask("rows", f"{np.count_nonzero(copied)} of {len(copied)} rows repeat others in the same order")


def _longest_run(mask: NDArray[np.bool_]) -> int:
    return int(np.diff(np.flatnonzero(np.diff(mask, prepend=False, append=False)))[::2].max(initial=0))


def _repeated_top(points: Points) -> Iterator[Question]:
    """Largest values that repeat more than others do."""
    for name, values in (("force", points.force), ("contraction", points.contraction), ("pressure", points.pressure)):
        levels, counts = np.unique(values, return_counts=True)
        others = counts[:-1][levels[:-1] > 0.1 * levels[-1]].max(initial=1)
        repeats = counts[-1] > max(2 * others, 2) if name != "pressure" else _is_cut_off(values)
        if len(levels) > 2 and repeats:
            at = int(np.argmax(values))
            yield points.ask("saturation", f"the largest {name} repeats: is the sensor saturated, first", at, name)
            return


def _same_top(points: Points) -> Iterator[Question]:
    """Forces near the largest that are reached under very different conditions."""
    top = np.flatnonzero(points.force >= 0.97 * points.force.max())
    if len(top) > 200 or len(top) == len(points.force):
        return
    pressure, shorter = points.pressure[top], points.contraction[top, None] - points.contraction[top]
    stroke = np.ptp(points.contraction)
    apart = (pressure > 1.15 * pressure[:, None]) & (shorter > 0.1 * stroke)
    apart |= (shorter > max(0.25 * stroke, 2.5 * percent)) & (1.05 * pressure >= pressure[:, None])
    if apart.any():
        at = int(top[np.argwhere(apart)[0][0]])
        yield points.ask(
            "saturation", "forces of very different points are within 3 % of the largest, one", at, "force"
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
    usual = max(np.mean(level == level[-1]) for level in others)
    rare = min(scatter) > 2 and usual < (0.55 if share > 0.85 else 0.35)
    return bool(share == 1 or (rare and share > (0.6 if len(top) > 5 else 0.75)))


def _trend(points: Points) -> Iterator[Question]:
    """Force that falls with the pressure or rises with the contraction, or does not depend on them."""
    rows = points.table[points.taut]
    if len(rows) < 4 or np.ptp(rows[:, 2]) < 0.15 * points.force.max():
        return
    centred = rows - rows.mean(axis=0)
    slopes = np.linalg.lstsq(centred[:, :2], centred[:, 2], rcond=None)[0]
    rest = centred[:, 2] - centred[:, :2] @ slopes
    moves = np.ptp(rows[:, :2], axis=0) >= 0.02 * np.abs(points.table[:, :2]).max(axis=0)
    unexplained = rest @ rest > _UNEXPLAINED * (centred[:, 2] @ centred[:, 2])
    if (slopes[0] <= 0 and moves[0]) or (slopes[1] >= 0 and moves[1]) or unexplained:
        text = (
            "the force does not rise with the pressure and fall with the contraction: exchanged columns, a wrong sign?"
        )
        yield points.ask("order", text, field="force")


def _exchanged(points: Points) -> Iterator[Question]:
    """Contraction without load that is proportional to the pressure, as the force at full length is."""
    free = [level[np.argmin(points.force[level])] for level in points.levels]
    pressure, reached = points.pressure[free], points.contraction[free]
    slack = np.all(points.force[free] <= _SMALL * points.force.max())
    if slack and len(free) > 2 and pressure.min() > 0 and points.force.max() < 50:
        ratio = reached / pressure
        if ratio.min() > 0 and ratio.max() < 1.15 * ratio.min():
            yield points.ask(
                "order", "the contraction without load is proportional to the pressure: exchanged columns?"
            )


def _outliers(points: Points) -> Iterator[Question]:
    """Points far off a surface through the others, linear in pressure and quadratic in contraction."""
    rows = np.flatnonzero(points.taut)
    if len(rows) < 12:
        return
    p, c, force = points.table[rows].T
    terms = np.column_stack([np.ones_like(p), p, c, p * c, c * c, p * c * c, p * p])
    scale = 1 / np.maximum(force, 0.1 * points.force.max())
    weights, residual = scale, force
    for _ in range(4):  # single points must not bend the surface
        solution = np.linalg.lstsq(terms * weights[:, None], force * weights, rcond=None)[0]
        residual = np.abs(force - terms @ solution)
        spread = np.median(residual * scale) + 1e-9
        weights = scale / np.maximum(1.0, residual * scale / (3 * spread))
    share = residual / np.maximum(force, 0.15 * points.force.max())
    usual = np.quantile(share, 0.8)
    far = share > max(4 * usual, 0.12)
    if 0 < np.count_nonzero(far) <= max(3, 0.1 * len(rows)):
        worst = int(rows[np.argmax(share)])
        yield points.ask("order", f"{np.count_nonzero(far)} points are off the surface through the others, most", worst)
    elif usual > 0.25:
        yield points.ask("order", f"forces scatter by {100 * usual:.0f} %: are they of one muscle?", field="force")


def _strays(points: Points) -> Iterator[Question]:
    """A single pressure far from those of the rows around it."""
    alone = [int(level[0]) for level in points.levels if len(level) == 1]
    wide = sum(len(level) > 2 for level in points.levels) > 1
    if wide and len(alone) == 1 and 0 < alone[0] < len(points.force) - 1:
        before, after = points.pressure[alone[0] - 1], points.pressure[alone[0] + 1]
        if abs(before - after) < 0.03 * points.pressure.max():
            yield points.ask("order", "the pressure is far from those around it", alone[0])


def _repeats(points: Points) -> Iterator[Question]:
    """Forces at the same pressure and contraction that differ by more than friction and creep."""
    steps = 0.01 * points.table[:, 0].max(), 0.1
    _, place = np.unique(np.round(points.table[:, :2] / steps), axis=0, return_inverse=True)
    place = place.ravel()
    high, low = np.full(place.max() + 1, -np.inf), np.full(place.max() + 1, np.inf)
    np.maximum.at(high, place, points.force)
    np.minimum.at(low, place, points.force)
    several = (np.bincount(place) > 1) & (high > 0.15 * points.force.max())
    apart = several & (high - low > np.maximum(0.3 * high, 0.15 * points.force.max()))
    if apart.sum() > 2 and 2 * apart.sum() >= several.sum():
        at = int(np.argmax(apart[place]))
        yield points.ask("order", "forces at one pressure and contraction differ by more than friction, such as", at)


def _zeros(points: Points) -> Iterator[Question]:
    """Forces of exactly 0 where the muscle cannot be slack.

    It pulls at less pressure and a larger contraction, or, as the force is convex, a line of two neighbours is above.
    """
    force, contraction, pressure = points.force, points.contraction, points.pressure
    at = np.flatnonzero(points.measured == 0)[:_MOST]
    taut = force > 0.1 * force.max()
    longer = (contraction >= contraction[at, None]) & (pressure <= 1.01 * pressure[at, None]) & taut
    lost = set(at[longer.any(axis=1)].tolist())
    clear = (0.03 if len(at) <= max(3, 0.02 * len(force)) else 0.1) * force.max()
    for step in (-1, 1):
        rows = at[(at + 2 * step >= 0) & (at + 2 * step < len(force))]
        near, far = rows + step, rows + 2 * step
        with np.errstate(all="ignore"):
            ratio = (contraction[rows] - contraction[near]) / (contraction[near] - contraction[far])
            line = force[near] + (force[near] - force[far]) * ratio
        level = np.abs(pressure[[near, far]] - pressure[rows]).max(axis=0) <= 0.05 * pressure[rows]
        least = np.maximum(max(0.01 * force.max(), 3 * _resolution(points.measured)), 0.1 * force[near])
        lost |= set(rows[level & (ratio > 0) & (ratio <= 1.5) & (line > least) & (force[near] > clear)].tolist())
    if lost:
        yield points.ask(
            "rows", f"{len(lost)} forces are 0 where the muscle cannot be slack, first", min(lost), "force"
        )


def _weak_zeros(points: Points) -> Iterator[Question]:
    """Contractions of exactly 0 where a shorter muscle pulls more."""
    for row in np.flatnonzero(points.contraction == 0)[:_MOST].tolist():
        same = np.abs(points.pressure - points.pressure[row]) < 0.02 * points.pressure.max()
        shorter = points.contraction > 0.3 * points.contraction.max()
        if np.any(same & shorter & (points.force > points.force[row] + 0.01 * points.force.max())):
            yield points.ask("rows", "the contraction is 0, but a shorter muscle pulls more", row, "contraction")
            return


def _held(points: Points) -> Iterator[Question]:
    """Forces that stand still for some rows while the muscle moves."""
    moved = np.abs(np.diff(points.contraction)) > 0.3 * percent
    same = (np.diff(points.force) == 0) & moved & points.taut[1:]
    often = np.mean(same) > 0.2 and _resolution(points.force) < 0.01 * points.force.max()
    varied = len(np.unique(points.force)) > len(points.force) / 3
    if varied and (_longest_run(same) >= 2 or often):
        yield points.ask("rows", "the force stands still although the muscle moved,", int(np.argmax(same)), "force")


def _counted(points: Points) -> Iterator[Question]:
    """Pressures that a spreadsheet counted up while the muscle reversed."""
    steps, moves = np.diff(points.pressure), np.diff(points.contraction)
    large = moves[np.abs(moves) > 0.1 * np.median(np.abs(moves))] if len(moves) else moves
    equal = len(steps) > 3 and steps.any() and np.allclose(steps, steps[0], rtol=1e-6, atol=0)
    if equal and np.count_nonzero(np.diff(np.sign(large))) > 1:
        yield points.ask("rows", "the pressure rises by one step from row to row: was it counted up?", field="pressure")


def _reach(points: Points) -> Iterator[Question]:
    """A contraction at which the force would end that no muscle reaches."""
    stroke = max(0.5 * np.ptp(points.contraction), 5 * percent)
    wide = [level for level in points.levels if len(level) > 3 and np.ptp(points.contraction[level]) >= stroke]
    if wide:
        rows = max(wide, key=lambda level: float(points.force[level].mean()))
        slope, start = np.polyfit(points.contraction[rows], points.force[rows], 1)
        if slope < 0 and -slope * np.ptp(points.contraction[rows]) > 0.15 * start and -start / slope > 0.45:
            text = f"the force would end at a contraction of {-start / slope / percent:.2g} %: a wrong unit or length?"
            yield points.ask("zero", text, field="contraction")


def _offsets(points: Points) -> Iterator[Question]:
    """Forces that begin at the pressure of the atmosphere, or that remain without pressure.

    Least squares with p (a + b eps + c eps^2) + d + e eps, in which d and e eps are 0 without an offset.
    """
    force, pressure, contraction = points.force, points.pressure, points.contraction
    stroke = np.ptp(contraction)
    used = (force > max(0.15 * force.max(), points.slack_force)) & (contraction <= contraction.min() + 0.6 * stroke)
    p, eps = pressure[used] / bar, (contraction[used] - contraction.min()) / (stroke or 1.0)
    design = np.column_stack([p, np.ones(len(p)), eps, p * eps, p * eps**2])[:, : 5 if stroke else 2]
    few = len(p) <= design.shape[1] + 1 or len(np.unique(np.round(20 * p / p.max()))) < 3
    if contraction.min() > 0.5 * percent or few:
        return
    solution = np.linalg.lstsq(design, force[used], rcond=None)[0]
    residual = force[used] - design @ solution
    covariance = np.linalg.pinv(design.T @ design) * (residual @ residual) / (len(p) - design.shape[1])
    if solution[0] <= 0:
        return
    begin = -solution[1] / solution[0]
    gradient = np.array([begin, 1.0]) / solution[0]
    error = float(np.sqrt(gradient @ covariance[:2, :2] @ gradient))
    low, high = _ATMOSPHERE
    near = low <= (begin + error) * bar and (begin - error) * bar <= high
    if pressure.min() >= 0.7 * bar and near and begin > 2.5 * error:
        text = f"the force at the initial length begins at about {begin:.2g} bar: are the pressures absolute?"
        yield points.ask("gauge", text, field="pressure")
        return
    ends = np.array([[1.0, 0.0], [1.0, eps.max()]])[:, : design.shape[1] - 1]
    part = slice(1, 1 + ends.shape[1])
    pulls, errors = ends @ solution[part], np.sqrt(np.einsum("ei,ij,ej->e", ends, covariance[part, part], ends))
    alike = pulls.max() - errors.max() < 1.5 * pulls.min()
    if np.all(pulls > np.maximum(0.05 * force.max(), 2.5 * errors)) and alike and pulls.max() < 0.6 * force.max():
        text = f"a force of about {pulls.mean():.3g} N would remain without pressure: an offset of the load cell?"
        yield points.ask("zero", text, field="force")


def _few_slack(points: Points) -> Iterator[Question]:
    """Two to four points that show an offset of the load cell, too few for an estimate."""
    largest, ends = points.force.max(), []
    for level in points.levels:
        rows = level[np.argsort(points.contraction[level], kind="stable")]
        force, contraction = points.force[rows], points.contraction[rows]
        for count in range(min(4, len(rows) - 2), 1, -1):
            flat = np.ptp(force[-count:]) <= 0.01 * largest and force[-count - 1] - force[-1] > 0.04 * largest
            if flat and contraction[-1] - contraction[-count] > 0.5 * percent:
                ends += force[-count:].tolist()
                break
    mean = float(np.mean(ends)) if ends else 0.0
    if mean > max(0.02 * largest, points.slack_force) and mean <= points.force.min() + 0.01 * largest:
        text = f"the force at the {len(ends)} largest contractions is about {mean:.3g} N: an offset of the load cell?"
        yield points.ask("zero", text, field="force")


def questions_of_labels(dataset: IsobaricDataset) -> Iterator[Question]:
    """Set pressures far from the measured ones, and directions that are the reverse of the motion."""
    table, level = dataset.table, dataset.levels
    if np.any(apart := np.abs(level - dataset.pressure) > 0.2 * dataset.pressure.max(initial=0.0)):
        text = f"{np.count_nonzero(apart)} set pressures are far from the measured ones"
        yield question("order", text, field="set_pressure", remedy="check its unit, or ignore the column")
    if "direction" in table:
        label = table["direction"].to_numpy()
        steps = np.where(np.diff(level) == 0, np.diff(dataset.contraction), 0.0)
        used = (label[1:] == label[:-1]) & (np.abs(steps) > 0.2 * percent)
        signs = [sign * steps[used & (label[1:] == word)] > 0 for word, sign in (("loading", 1), ("unloading", -1))]
        if all(len(wrong) > 2 and wrong.mean() > 0.9 for wrong in signs):
            text = "the contraction grows in loading and falls in unloading, but loading is being stretched"
            yield question("order", text, field="direction", remedy="exchange the words")
