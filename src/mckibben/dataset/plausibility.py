"""Plausibility of measured points: mistakes of sign, unit and initial length."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import permutations
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.headers import ACCEPTED
from mckibben.dataset.schema import VACUUM
from mckibben.errors import Problem
from mckibben.muscle import Specimen, air
from mckibben.units import bar, factor, mm, percent

Floats = NDArray[np.float64]

_PRESSURES = (0.08 * bar, 0.9 * bar, 12 * bar, 16 * bar)
"""Highest pressure of a muscle test: impossible below, usual from, usual to, impossible above."""
_DIAMETERS = (0.8 * mm, 1.7 * mm, 80 * mm, 120 * mm)
"""Implied diameter: impossible below, usual from, usual to, impossible above. Thin muscles are sold from 1.8 mm."""
_LIKE_SPECIMEN = (*air.USUAL_DIAMETERS, 3.0)  # implied over given diameter: usual from, usual to, impossible above
_STRETCHED, _OVERSTRETCHED, _SHORT, _SHORTEST = -0.05, -0.15, 0.4, 0.5  # contractions of a taut muscle
_LONGER, _PRESSURIZED, _WEAK = -0.005, 0.1, 0.3  # a stretched muscle: contraction, pressure and force over the largest
_FIRST = 0.1  # smallest contraction of a test that begins near the initial length
_COPIED = 4  # repeated rows in the same order that count as copies
_SMALL_FORCE = 0.05  # of the largest one
_CLEARLY = 0.1  # of the largest force: certainly taut
_NOISE = 0.01  # of the largest force
_FEW = 0.02  # of all points, or 3: zeros that are no slack region
_SAME_PRESSURE = 0.05  # largest relative difference of pressures at one level
_EVEN = 1.5  # distance of a point from its neighbor, over the distance between that and the next, at most
_LINE = 0.1  # of the force at the closer point: least value of a line through two points
_REPEATED = 3  # equal largest values that may be saturated
_MOST, _RARE = 0.6, 0.25  # of the rows of a level: repetitions of its largest value, cut off and by chance
_CHANCE = 0.03  # probability of a coincidence that is reported
_UNEXPLAINED = 0.3  # of the variance of the force: more is not a muscle
_APART = 0.05  # of the range of pressures or contractions
_FINE = 1000  # steps of the resolution up to the largest force, where even two equal ones are rare
_STEADY = 0.01  # largest relative change from row to row of a value that marks nothing
REPEATED = 0.01  # of the highest pressure: pressures of repeated points
UNEQUAL = (0.3, 0.15)  # of a force, and of the largest: more than friction and creep
_MANY = 10_000  # values, beyond which marks are compared exactly
_SI = MappingProxyType({"pressure": "Pa", "force": "N"})
LARGEST_FORCE = " with largest_force (command line: --largest-force)"
_LENGTH = "check initial_length (command line: --initial-length)"
_ZERO = "zero_length (command line: --zero-length) of displacements"
_UNIT = (
    "check the unit: arrays are in SI; of a file, correct the unit in its header or in columns={...} "
    "(command line: --column 'HEADER=NAME')"
)


class Findings(NamedTuple):
    """Problems of points that are impossible for a muscle, and warnings for unusual ones."""

    problems: list[Problem]
    warnings: list[str]


def check_points(
    pressure: Floats,
    contraction: Floats,
    force: Floats,
    slack_force: float,
    initial_length: float | None,
    specimen: Specimen | None = None,
    measured: Floats | None = None,
    units: Mapping[str, str] = _SI,
    place: Callable[[int], str] = "row {}".format,
) -> Findings:
    """Check points of a muscle, and of its specimen where it is known; `measured` are forces with their offset.

    `units` are those in which pressure and force were given, `place` names a row, counted from 0.
    """
    problems, warnings = [], []
    measured = force if measured is None else measured
    found = list(check_sign(force))
    if found and found[0][1]:
        problems.append(found[0][0])  # the other numbers are meaningless
    elif len(force):
        for problem, impossible in (
            *found,
            *_ranges(pressure, contraction, force, slack_force, initial_length, specimen, units, place),
            *_clipped("force", measured, 1.0, "N", pressure, contraction),
            *_clipped("pressure", pressure, bar, "bar"),
            *_clipped("contraction", contraction, percent, "%"),
            *_zeros(pressure, contraction, force, measured),
            *_weak_zeros(pressure, contraction, force),
            *_copies(pressure, contraction, force),
        ):
            if impossible:
                problems.append(problem)
            else:
                warnings.append(str(problem))
    return Findings(problems, warnings)


def _ranges(
    pressure: Floats,
    contraction: Floats,
    force: Floats,
    slack_force: float,
    initial_length: float | None = None,
    specimen: Specimen | None = None,
    units: Mapping[str, str] = _SI,
    place: Callable[[int], str] = "row {}".format,
) -> Iterator[tuple[Problem, bool]]:
    """Messages for unusual ranges of points, and whether they are impossible."""
    yield from _contractions(pressure, contraction, force, slack_force, initial_length, place)
    pressures = list(check_pressures(float(pressure.max()), units.get("pressure", "Pa")))
    yield from pressures
    if not any(impossible for _, impossible in pressures):  # the diameter follows from force and pressure
        yield from _forces(pressure, force, specimen, units.get("force", "N"))


def check_sign(force: Floats) -> Iterator[tuple[Problem, bool]]:
    """Message for negative forces, and whether they are impossible."""
    if not len(force):
        return
    limit = _SMALL_FORCE * float(np.abs(force).max())
    negative, positive = int((force < -limit).sum()), int((force > limit).sum())
    if negative > positive:
        text = f"{negative} of {len(force)} forces are negative, down to {force.min():.4g} N, but a muscle only pulls"
        yield Problem(text, field="force", remedy="flip the sign: force_sign=-1 (command line: --force-sign -1)"), True
    elif negative:
        text = f"{negative} of {len(force)} forces are negative, down to {force.min():.4g} N: they count as slack"
        yield Problem(text, field="force", remedy="check these points, and the zero of the load cell"), False


def _contractions(
    pressure: Floats,
    contraction: Floats,
    force: Floats,
    slack_force: float,
    initial: float | None,
    place: Callable[[int], str],
) -> Iterator[tuple[Problem, bool]]:
    low, high = float(contraction.min()), float(contraction[force > slack_force].max(initial=-1.0))
    weak = (contraction < _LONGER) & (pressure > _PRESSURIZED * pressure.max())
    weak &= force * pressure.max() < _WEAK * pressure * force.max()
    if low < _STRETCHED:
        single = f" in {place(int(np.argmin(contraction)))}" if np.count_nonzero(contraction < 0) == 1 else ""
        text = f"contractions begin at {low / percent:.3g} %{single}, but a muscle can be stretched by about 3 % only"
        yield (
            Problem(text, field="contraction", remedy=f"{_LENGTH}, the sign (positive = shorter), and {_ZERO}"),
            low < _OVERSTRETCHED,
        )
    elif np.count_nonzero(weak) > 1:
        text = (
            f"{np.count_nonzero(contraction < 0)} contractions are negative, down to {low / percent:.3g} %, but at "
            f"{np.count_nonzero(weak)} of them the muscle hardly pulls, such as {force[weak].min():.3g} N at "
            f"{pressure[weak][np.argmin(force[weak])] / bar:.3g} bar: it cannot be stretched there"
        )
        yield Problem(text, field="contraction", remedy=f"{_LENGTH}, and {_ZERO}"), False
    elif low > _FIRST:
        longest = f": the longest length measured is {initial * (1 - low) / mm:.4g} mm" if initial else ""
        text = f"contractions begin at {low / percent:.3g} %, not near 0 %{longest}"
        yield Problem(text, field="contraction", remedy=_LENGTH), False
    if high > _SHORT:
        text = f"the muscle pulls at a contraction of {high / percent:.3g} %, but muscles contract by 20 to 35 %"
        yield Problem(text, field="contraction", remedy=f"{_LENGTH}, and the unit"), high > _SHORTEST


def check_pressures(highest: float, unit: str = "Pa") -> Iterator[tuple[Problem, bool]]:
    """Message for an unusual highest pressure [Pa], given in a unit, and whether it is impossible."""
    lowest, least, most, limit = _PRESSURES
    if highest > 0 and not least <= highest <= most:
        text = f"the highest pressure is {highest / bar:.3g} bar, but pneumatic muscles are tested at 1 to 8 bar"
        remedy = _unit_remedy("pressure", highest, unit, lambda value: least <= value <= most)
        yield Problem(text, field="pressure", remedy=remedy, value=highest, unit="Pa"), not lowest <= highest <= limit


def _unit_remedy(quantity: str, value: float, unit: str, fits: Callable[[float], bool]) -> str:
    """Remedy for a value [SI] given in a unit: the units in which it would be usual."""
    number = value / factor(unit)
    fitting = [one for one in ACCEPTED[quantity] if one != unit and fits(number * factor(one))]
    return f"{number:.4g} {unit} would be usual in {' or '.join(fitting[:2])}: {_UNIT}" if fitting else _UNIT


def exchanged(
    numbers: Sequence[Floats], to_si: Sequence[Sequence[Callable[[Floats], Floats]]]
) -> tuple[int, ...] | None:
    """Order in which columns of pressure, contraction and force are those of a muscle, where the given is impossible.

    Each has conversions to SI, first that of its unit. None if no order or more than one is, or the given one is with
    another unit of one column.
    """
    rows = np.flatnonzero(np.isfinite(numbers).all(axis=0))

    def points(order: Sequence[int] = range(3), units: Sequence[int] = (0, 0, 0)) -> list[Floats]:
        return [to_si[place][units[place]](numbers[at][rows]) for place, at in enumerate(order)]

    others = [[unit if one == at else 0 for one in range(3)] for at in range(3) for unit in range(len(to_si[at]))]
    if len(rows) < _COPIED or _is_possible(*points()) or any(_is_muscle(*points(units=units)) for units in others):
        return None
    found = [order for order in permutations(range(3)) if _is_muscle(*points(order))]
    return found[0] if len(found) == 1 else None


def _is_possible(pressure: Floats, contraction: Floats, force: Floats) -> bool:
    """True for points without impossible values."""
    ranges = _ranges(pressure, contraction, force, _SMALL_FORCE * float(np.abs(force).max()))
    impossible = any(wrong for _, wrong in (*check_sign(force), *ranges))
    return bool(pressure.min() > VACUUM and np.abs(contraction).max() < 1 and not impossible)


def _is_muscle(pressure: Floats, contraction: Floats, force: Floats) -> bool:
    """True for possible points whose force rises with pressure and falls with contraction."""
    taut = force > _SMALL_FORCE * np.abs(force).max()
    if np.count_nonzero(taut) < _COPIED or not _is_possible(pressure, contraction, force):
        return False
    centred = [values[taut] - values[taut].mean() for values in (pressure / bar, contraction / percent, force)]
    slopes = np.linalg.lstsq(np.column_stack(centred[:2]), centred[2], rcond=None)[0]
    left = centred[2] - np.column_stack(centred[:2]) @ slopes
    return bool(slopes[0] > 0 > slopes[1] and left @ left < _UNEXPLAINED * (centred[2] @ centred[2]))


_MIXER = np.uint64(0x9E3779B97F4A7C15)  # odd: rows that differ get other numbers, but for rare collisions


def _copies(*columns: Floats) -> Iterator[tuple[Problem, bool]]:
    """Consecutive rows that repeat earlier ones in the same order; equal points of one measurement do not count."""
    import pandas as pd

    words = [np.ascontiguousarray(column).view(np.uint64) for column in columns]
    count = len(words[0])
    mixed = np.zeros(count, np.uint64)
    for column in words:
        mixed = (mixed ^ column ^ (column >> np.uint64(29))) * _MIXER
        mixed ^= mixed >> np.uint64(32)
    codes, _ = pd.factorize(mixed)  # numbered in the order in which they are seen first
    firsts = np.flatnonzero(np.diff(np.maximum.accumulate(codes), prepend=-1))
    earlier = firsts[codes]
    copied = earlier < np.arange(count)
    for column in words:
        copied &= column[earlier] == column
    follows = np.flatnonzero(copied[1:] & copied[:-1] & (np.diff(earlier) == 1))  # and the row after each
    runs = np.split(follows, np.flatnonzero(np.diff(follows) > 1) + 1)
    copies = sum(run.size + 1 for run in runs if run.size + 1 >= _COPIED)
    if copies:
        text = f"{copies} of {count} rows repeat others in the same order: copies make intervals too narrow"
        yield Problem(text, remedy="leave them out"), False


_OVERLOAD = 1e29  # of multimeters: 9.9e37, 9.91e37, 3.4e38
_MARKS = np.array(
    [
        *(10.0**n - 10.0**-m for n in range(2, 7) for m in range(3)),
        999.25,
        *(limit / 10**m for limit in (32767, 32768, 65535) for m in range(3)),  # ends of 16 bits
    ]
)
_ENDS, _WHOLE = (1023, 4095), 0.2  # single ends of 10 and 12 bits, and share of whole numbers: usual among more


def missing_marks(values: Floats) -> tuple[NDArray[np.bool_], bool]:
    """Values such as -9999 or 999.9, which mark missing values, and whether they are far from all other values."""
    size = np.abs(values)
    if not np.fmax.reduce(size, initial=0.0) > _MARKS.min() - 1:
        return np.zeros(len(values), bool), False
    close = np.isclose(size[:, None], _MARKS, rtol=1e-12, atol=0) if len(values) < _MANY else None
    marks = (np.isin(size, _MARKS) if close is None else np.asarray(close.any(axis=1))) | (size >= _OVERLOAD)
    ends = np.isin(size, _ENDS)
    if np.count_nonzero(ends) == 1 and np.mean(np.modf(values)[0] != 0) > 1 - _WHOLE:
        marks |= ends
    usual = ~marks & np.isfinite(values)
    others = values[usual] if marks.any() else values[:0]
    if not others.size:
        return np.zeros(len(values), bool), False
    low, high = float(others.min()), float(others.max())
    distance = np.maximum(low - values[marks], values[marks] - high)
    negative = low >= 0 and bool((values[marks] < 0).all())
    isolated = negative or bool((distance > max(high - low, 0.5 * abs(high))).all())
    if not isolated:
        marks[marks] = (size[marks] >= 100) & ~_continuous(values, marks, usual)
    return marks, isolated


def _continuous(values: Floats, marks: NDArray[np.bool_], usual: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """True for marks close to the other values next to them, such as times and steady pressures.

    One neighbor is enough at the edge of a level: where several values, at least half as many as marks, are as close.
    """
    rows, known = np.flatnonzero(marks), np.flatnonzero(usual)
    after = np.searchsorted(known, rows)
    ends = values[known[[np.clip(after - 1, 0, None), np.clip(after, None, len(known) - 1)]]]
    reach = _STEADY * np.abs(values[rows])
    beside = np.abs(ends - values[rows]) <= reach
    sorted_values, sorted_marks = np.sort(values[usual]), np.sort(values[rows])

    def count(among: Floats) -> NDArray[np.intp]:
        """Number of values within reach of each mark."""
        low, high = values[rows] - reach, values[rows] + reach
        return np.searchsorted(among, high, side="right") - np.searchsorted(among, low)

    at_level = count(sorted_values) >= np.maximum(count(sorted_marks) / 2, _REPEATED)
    return np.all(beside, axis=0) | (np.any(beside, axis=0) & at_level)


def _clipped(
    name: str, values: Floats, unit: float, symbol: str, *conditions: Floats
) -> Iterator[tuple[Problem, bool]]:
    """Message on a largest value that repeats, or occurs more often than others under different conditions."""
    levels, counts = np.unique(values, return_counts=True)
    low = _CLEARLY * levels[-1]  # readings of a slack muscle repeat
    others = counts[:-1][levels[:-1] > low].max(initial=1)
    at = values == levels[-1]
    twice = 3 > others < counts[-1] and any(np.ptp(one[at]) > _APART * np.ptp(one) for one in conditions)
    twice = twice and resolution(values) * _FINE < levels[-1]
    often = counts[-1] > max(2 * others, _REPEATED - 1) or counts[-1] >= 2 * max(others, _REPEATED)
    if len(levels) > 2 and (often or twice or (name == "pressure" and _is_cut_off(values))):
        text = f"the largest {name}, {levels[-1] / unit:.4g} {symbol}, repeats {counts[-1]} times and may be saturated"
        remedy = "check the range of the sensor, and leave out the rows at its end"
        yield Problem(text, field=name, remedy=f"{remedy}{LARGEST_FORCE if name == 'force' else ''}"), False


def _is_cut_off(values: Floats) -> bool:
    """True if all values of the highest level are equal, or most where the largest of no other level repeats as often.

    The other levels have to vary by noise.
    """
    ordered = np.sort(values)
    *others, top = np.split(ordered, np.flatnonzero(np.diff(ordered) > _SAME_PRESSURE * ordered[-1]) + 1)
    others = [level for level in others if len(level) >= _COPIED]
    equal = top[0] == top[-1] and len(top) > _COPIED
    rare = all(np.mean(level == level[-1]) <= _RARE for level in others)
    often = np.count_nonzero(top == top[-1]) >= max(_COPIED, _MOST * len(top))
    varied = all(len(np.unique(level)) > 2 for level in others)
    if not (others and varied and often and (rare or equal)):
        return False
    above = np.mean([np.mean(level > np.median(level)) for level in others])
    pairs = np.mean([(np.sum(np.unique(x, return_counts=True)[1] ** 2) / len(x) - 1) / (len(x) - 1) for x in others])
    none_above, all_equal = (1 - above) ** len(top), pairs ** (len(top) / 2)  # probabilities without a limit
    return bool(none_above < _CHANCE or (equal and all_equal < _CHANCE))


def _zeros(pressure: Floats, contraction: Floats, force: Floats, measured: Floats) -> Iterator[tuple[Problem, bool]]:
    """Message on measured forces of exactly 0 where the muscle cannot be slack."""
    taut, zeros = np.flatnonzero(force > _CLEARLY * force.max()), np.flatnonzero(measured == 0)
    taut = taut[np.argsort(pressure[taut], kind="stable")]
    longest = np.maximum.accumulate(np.append(-np.inf, contraction[taut]))  # of taut points up to a pressure
    below = np.searchsorted(pressure[taut], 1.01 * pressure[zeros], side="right")
    lost = zeros[longest[below] >= contraction[zeros]]
    why = "the muscle pulls at less pressure and a larger contraction"
    if not lost.size:
        lost = _isolated_zeros(pressure, contraction, force, measured)
        why = "neighbors at the same pressure are far from 0"
    if lost.size:
        at = lost[0]
        text = (
            f"{len(lost)} of {len(force)} forces are 0, first at {pressure[at] / bar:.3g} bar and "
            f"{contraction[at] / percent:.3g} %, but {why}"
        )
        yield Problem(text, field="force", remedy="leave out points without a measurement"), False


def _weak_zeros(pressure: Floats, contraction: Floats, force: Floats) -> Iterator[tuple[Problem, bool]]:
    """Message on contractions of 0 with less force than shortened rows next to them, or other rows at 0."""
    stroke, zeros = float(contraction.max()), np.flatnonzero(contraction == 0)
    if not (stroke > 0 and zeros.size):
        return
    sides = [np.clip(zeros + step, 0, len(force) - 1) for step in (-1, 1)]

    def most(rows: NDArray[np.intp]) -> Floats:
        """Largest force of rows up to the pressure of each contraction of 0."""
        rows = rows[np.argsort(pressure[rows], kind="stable")]
        largest = np.maximum.accumulate(np.append(-np.inf, force[rows]))
        return largest[np.searchsorted(pressure[rows], pressure[zeros] + REPEATED * pressure.max(), side="right")]

    shortened = np.minimum(*(contraction[one] for one in sides)) >= stroke / 4
    far = np.flatnonzero(contraction >= stroke / 2)
    weak = shortened & (force[zeros] < most(far) - _NOISE * force.max())
    for one in sides:  # a jump by more than half the stroke at the same pressure
        jump = (contraction[one] >= 0.6 * stroke) & (pressure[one] <= (1 + REPEATED) * pressure[zeros])
        weak |= jump & (force[zeros] < force[one] - _STEADY * force.max())
    (own, overall), others = UNEQUAL, most(zeros)
    weak |= force[zeros] < others - np.maximum(own * others, overall * force.max())
    weak = zeros[weak]
    if weak.size:
        at = weak[0]
        text = (
            f"{len(weak)} of {len(force)} contractions are 0 although the force is that of a shorter muscle at this "
            f"pressure, first {force[at]:.4g} N at {pressure[at] / bar:.3g} bar"
        )
        yield Problem(text, field="contraction", remedy="check these points, and the sensor of the length"), False


def _isolated_zeros(pressure: Floats, contraction: Floats, force: Floats, measured: Floats) -> NDArray[np.intp]:
    """Rows with a measured force of 0 where the line through two neighbors at the same pressure is clearly above 0.

    The force of a muscle, slack or not, is a convex function of the contraction: it is above such a line.
    """
    count, largest = int((measured == 0).sum()), float(force.max())
    if not (count and largest > 0 and pressure.max() > 0):
        return np.array([], np.intp)
    clearly = (3 * _NOISE if count <= max(3, _FEW * len(force)) else _CLEARLY) * largest
    least = max(clearly / 3, 3 * resolution(measured))
    lost = np.zeros(len(force), bool)
    levels = np.clip(np.round(pressure / (2 * _SAME_PRESSURE * pressure.max())), 0, None).astype(np.int16)
    for order in (np.arange(len(force)), np.argsort(levels, kind="stable")):  # as measured, and pressure by pressure
        sorted_force = force[order]
        zeros = np.flatnonzero(measured[order] == 0)
        for step in (-1, 1):
            rows = zeros[(zeros + 2 * step >= 0) & (zeros + 2 * step < len(force))]
            rows = rows[sorted_force[rows + step] > clearly]
            at, near, far = (order[rows + n * step] for n in range(3))
            with np.errstate(all="ignore"):
                ratio = (contraction[at] - contraction[near]) / (contraction[near] - contraction[far])
                line = force[near] + (force[near] - force[far]) * ratio
            apart = np.abs(pressure[[near, far]] - pressure[at]).max(axis=0)
            even = (ratio > 0) & (ratio <= _EVEN) & (apart <= _SAME_PRESSURE * pressure[at])
            lost[at] |= even & (line > np.maximum(least, _LINE * force[near]))
    return np.flatnonzero(lost)


def resolution(force: Floats) -> float:
    """Largest power of ten [N] of which all forces are multiples; 0 below 0.1 N."""
    return next((step for step in (100.0, 10.0, 1.0, 0.1) if np.allclose(force, step * np.round(force / step))), 0.0)


def implied_diameter(pressure: Floats, force: Floats) -> float | None:
    """Diameter of a muscle [m] that exerts the largest force at its initial length; None for a slack muscle."""
    at = int(np.argmax(force))
    if not (force[at] > 0 and pressure[at] > 0):
        return None
    with np.errstate(over="ignore"):
        return air.implied_diameter(force[at] / pressure[at])


def _forces(pressure: Floats, force: Floats, specimen: Specimen | None, unit: str) -> Iterator[tuple[Problem, bool]]:
    at, diameter = int(np.argmax(force)), implied_diameter(pressure, force)
    if diameter is None:
        return
    text = f"{force[at]:.4g} N at {pressure[at] / bar:.3g} bar is the force of a muscle of about {diameter / mm:.2g} mm"
    smallest, least, most, largest = _DIAMETERS
    low, high, limit = _LIKE_SPECIMEN
    given = specimen.initial_diameter if specimen is not None else None
    usual = (low * given, high * given) if given else (least, most)
    # the implied diameter is proportional to the square root of the force
    remedy = _unit_remedy(
        "force", force[at], unit, lambda value: usual[0] <= diameter * math.sqrt(value / force[at]) <= usual[1]
    )
    if not smallest <= diameter <= largest:
        yield Problem(text, field="force", remedy=remedy), True
    elif specimen is not None and given:
        if not low <= diameter / given <= high:
            text = f"{text}, but {specimen.name} has {given / mm:.3g} mm"
            yield Problem(text, field="force", remedy=f"{remedy}; also for pressures"), diameter / given > limit
    elif not least <= diameter <= most:
        yield Problem(text, field="force", remedy=remedy), False
