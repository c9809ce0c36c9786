"""Loading paths of a test at constant pressures, loads or lengths, and the force along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Bools, Floats, Ints
from mckibben.identification.grouping import RESOLUTION, at_fixed_lengths, held_values, holds, row_numbers
from mckibben.units import bar, show

_NEAR = 0.2  # of a step: positions as close are the same, with noise of the length
TURN_TRAVELS = (None, 0.0, 1.0)  # m: as measured, none, or farther than any presliding length
_HELD_REMEDY = (
    "give the nominal pressure of each point (set_pressure), or the loads that were held (a column such as set_force_N)"
)
_ORDER_REMEDY = "give the time of each point, or rows in the order in which they were measured"


class NoHysteresisError(IdentificationError):
    """Loading and unloading do not differ significantly."""


@dataclass(frozen=True, eq=False)
class LoadingPaths:
    """Loading paths of a test: the points at constant pressure, or at a constant load, in temporal order.

    At fixed lengths, at each of which the pressure is changed, all points are one path: friction stays as the last
    motion left it.

    Attributes
    ----------
    place
        Row of each point of each path, shape (points, paths); shorter paths repeat their last row.
    counts
        Number of points of each path, shape (paths,).
    side
        Direction before the first point of each path: 1 for stretching, -1 for shortening, shape (paths,).
    length
        Length of each row [m], monotone along strokes, shape (rows,).
    step
        Median distance of successive points [m].
    turns
        1 or -1 at a loading or unloading row at the position of the row of the other direction before it, or behind
        that; else 0.
    turn_travel
        Travel [m] of the friction to these rows: 0 if the muscle rested there, as a distance of noise would reverse
        friction with a short presliding length; far if it overshot them and came back. None: the measured distance.
    """

    place: Ints = field(repr=False)
    counts: Ints
    side: Floats
    length: Floats = field(repr=False)
    step: float
    turns: Floats = field(repr=False)
    turn_travel: float | None = None

    @property
    def travel(self) -> Floats:
        """Displacement [m] seen by the friction, shape (points, paths)."""
        turns = self.turns[self.place]
        if self.turn_travel is None:
            return self.displacement
        return np.where(turns == 0, self.displacement, self.turn_travel * turns)

    @property
    def displacement(self) -> Floats:
        """Displacement [m] to each point from the previous one, shape (points, paths); 0 at the first."""
        length = self.length[self.place]
        return np.diff(length, axis=0, prepend=length[:1])

    @property
    def rows(self) -> list[Ints]:
        """Rows of each path in temporal order."""
        return [self.place[:count, path] for path, count in enumerate(self.counts)]

    @property
    def label(self) -> Ints:
        """Path of each row, shape (rows,)."""
        return self.scattered(np.broadcast_to(np.arange(float(len(self.counts))), self.place.shape)).astype(np.int64)

    def stroke(self, means: IsobaricDataset) -> Ints:
        """Stroke of each row, shape (rows,): the rows of a path between reversals."""
        loading = means.table["direction"].to_numpy() == "loading"
        stroke, count = np.empty(len(self.length), np.int64), 0
        for rows in self.rows:
            stroke[rows] = count + np.cumsum(np.diff(loading[rows], prepend=loading[rows[:1]]))
            count = stroke[rows[-1]] + 1
        return stroke

    def loop(self, means: IsobaricDataset) -> Ints:
        """Loop of each row, shape (rows,), from 0 without gaps: two successive strokes of a path."""
        stroke, path = self.stroke(means), self.label
        first = np.array([stroke[rows[0]] for rows in self.rows])
        return row_numbers([path, (stroke - first[path]) // 2])

    def at_reversal(self, means: IsobaricDataset) -> Bools:
        """Ends of strokes at a reversal, where rate and direction are unknown, shape (rows,).

        The farthest row was measured before or after the turn.
        """
        strokes, ends = self.stroke(means), np.zeros(len(self.length), bool)
        for rows in self.rows:
            changes = np.diff(strokes[rows]) != 0
            ends[rows] = np.append(self.turns[rows].any(), changes) | np.append(changes, self.turns[rows].any())
        return ends

    def rate(self, means: IsobaricDataset, *, ratio: float = 1.3) -> Floats | None:
        """Rate of the length [m/s], shape (rows,); None without times, or at one speed.

        Points that are means of samples were measured at rest. Speeds differ if the quotient of their quartiles exceeds
        `ratio`: else viscous friction looks like dry friction.
        """
        if "time" not in means.table or "force_spread" in means.table or at_fixed_lengths(means):
            return None
        time, rate = means.table["time"].to_numpy(), np.zeros(len(self.length))
        strokes, ends = self.stroke(means), self.at_reversal(means)
        for rows in self.rows:
            if len(rows) > 1 and (np.diff(time[rows]) <= 0).any():
                return None
            for stroke in np.split(rows, np.flatnonzero(np.diff(strokes[rows])) + 1):
                inside = stroke[:-1] if ends[stroke[-1]] else stroke  # the farthest row may be behind the turn
                rate[inside] = _derivative(self.length[inside], time[inside])
        moving = moving_rates(rate)
        if not len(moving):
            return None
        slow, fast = np.quantile(moving, [0.25, 0.75])
        return rate if fast > ratio * slow else None

    def scattered(self, values: Floats) -> Floats:
        """Values by point and path, shape (points, paths, ...), as rows of the dataset, shape (rows, ...)."""
        scattered = np.empty((len(self.length), *values.shape[2:]))
        for path, place in enumerate(self.rows):
            scattered[place] = values[: len(place), path]
        return scattered

    @classmethod
    def of(cls, means: IsobaricDataset, *, fewest: int = 4) -> LoadingPaths:
        """Loading paths of a dataset; raises `IdentificationError` if it has none.

        Paths of fewer than `fewest` points show no friction.
        """
        table, fixed = means.table, at_fixed_lengths(means)
        if "direction" not in table or len(means.directions) < 2:
            which = f"{means.directions[0]} alone" if len(means.directions) else "no directions"
            raise IdentificationError(
                f"the dataset has {which}: hysteresis is the difference between loading and unloading",
                remedy="measure in both directions, and give the direction of each point",
            )
        if "initial_length" not in table.attrs:
            raise IdentificationError(
                "the initial length is unknown: friction depends on displacements, not on contraction",
                remedy="give initial_length (command line: --initial-length '180 mm')",
            )
        length = table.attrs["initial_length"] * (1 - means.contraction)
        order = in_time(means)
        if fixed:
            held = holds(means, order)
            length = (np.bincount(held, length) / np.bincount(held))[held]
        ends = [] if fixed else np.flatnonzero(np.diff(held_values(means)[order])) + 1
        paths = np.split(order, ends)
        if np.median(np.concatenate([np.full(len(path), len(path)) for path in paths])) < fewest:
            raise IdentificationError(
                f"{len(means)} points make {len(paths)} paths at constant pressure or load: too short to show friction",
                remedy=f"{_HELD_REMEDY}, and rows in the order of the test",
            )
        loading = table["direction"].to_numpy() == "loading"
        measured = length
        length = _monotone(length, paths, loading)
        moves = np.concatenate([np.diff(length[path]) for path in paths])
        if not fixed:
            _check_order(measured, length, paths, loading)
        longest = max(map(len, paths))
        place = np.stack([np.pad(path, (0, longest - len(path)), mode="edge") for path in paths], axis=1)
        side = np.array([-1.0 if loading[path[0]] else 1.0 for path in paths])
        counts = np.array([len(path) for path in paths])
        step = float(np.median(np.abs(moves[moves != 0])))
        return cls(place, counts, side, length, step, _turns(length, paths, loading))


def _check_order(
    measured: Floats,
    length: Floats,
    paths: Sequence[Ints],
    loading: Bools,
    *,
    most_backwards: float = 0.01,
    most_reversals: float = 0.3,
) -> None:
    """Refuse rows whose lengths or directions are not in the order of a test; `length` is monotone along strokes.

    Noise moves a length against its direction by a share `most_backwards` of the range of the lengths, and a test has a
    share `most_reversals` of reversals in its moves, at most.
    """
    count = sum(int(np.count_nonzero(np.diff(length[path]))) for path in paths)
    backwards = float(np.sqrt(np.mean((length - measured) ** 2)))
    reversals = sum(int(np.count_nonzero(np.diff(loading[path]))) for path in paths)
    text = ""
    if backwards > most_backwards * np.ptp(measured):
        text = f"the length moves against the direction of the points, by {show(backwards, 'mm', 3)} (RMS)"
    elif reversals > most_reversals * count or not count:
        text = f"the direction changes {reversals} times in {count} moves"
    if text:
        raise IdentificationError(f"{text}: the rows are not in the order of the test", remedy=_ORDER_REMEDY)


def _turns(length: Floats, paths: Sequence[Ints], loading: Bools) -> Floats:
    """1 or -1 at a row of another direction than the row before it, at its position or behind it; else 0.

    The muscle moves on from there: where a held load sticks over several rows, its turn was measured.
    """
    turns = np.zeros(len(length))
    for path in paths:
        move, turn = np.diff(length[path]), np.diff(loading[path].astype(float))
        size = np.abs(move)
        following = np.append(size[1:], size[-1:])
        near = size <= _NEAR * np.minimum(np.append(size[:1], size[:-1]), following)
        moves_on = following > _NEAR * np.median(size)
        turns[path[1:]] = np.where((near | (move * turn < 0)) & moves_on, turn, 0.0)
    return turns


def moving_rates(rate: Floats, *, least: float = 1e-3) -> Floats:
    """Absolute rates [m/s] of points at which the muscle moves: faster than the share `least` of the highest rate."""
    speed = np.abs(rate)
    return speed[speed > least * speed.max(initial=0.0)]


def _derivative(values: Floats, time: Floats, *, most: float = 0.1) -> Floats:
    """Derivative by central differences over one and two steps, whose errors of second order cancel (Richardson).

    The correction is at most a share `most`: beside a rest, the second step is from before it.
    """
    if len(values) < 2:
        return np.zeros(len(values))
    rate = np.gradient(values, time)
    if len(values) > 4:
        wide = np.empty(len(values))
        wide[::2], wide[1::2] = (np.gradient(values[first::2], time[first::2]) for first in (0, 1))
        limit = most * np.abs(rate[2:-2])
        rate[2:-2] += np.clip((rate[2:-2] - wide[2:-2]) / 3, -limit, limit)
    return rate


def _monotone(length: Floats, paths: Sequence[Ints], loading: Bools) -> Floats:
    """Closest lengths [m] that rise in loading and fall in unloading strokes: noise would reverse the friction."""
    from scipy.optimize import isotonic_regression  # takes 0.3 s to import

    monotone = length.copy()
    for path in paths:
        for stroke in np.split(path, np.flatnonzero(np.diff(loading[path])) + 1):
            monotone[stroke] = isotonic_regression(length[stroke], increasing=bool(loading[stroke[0]])).x
    return monotone


@dataclass(frozen=True, eq=False)
class DriftBasis:
    """Basis of a piecewise linear sensor drift: offset = points @ amplitudes, mean rate = slope @ amplitudes."""

    points: Floats
    slope: Floats

    @classmethod
    def candidates(cls, paths: LoadingPaths, means: IsobaricDataset) -> list[DriftBasis]:
        """No drift and, of two paths or more with slack points, unless they are clipped, a knot for each.

        Without them, a line if each level is visited again later: else a drift is not told from what the model lacks.
        """
        none = cls(np.empty((len(means), 0)), np.empty(0))
        if "time" not in means.table or not np.ptp(means.table["time"].to_numpy()):
            return [none]
        time, slack = means.table["time"].to_numpy(), means.slack & (not clipped(means))
        knots = np.unique([float(time[path][slack[path]].mean()) for path in paths.rows if slack[path].any()])
        if len(knots) < 2:
            levels = np.unique([held_values(means)[path[0]] for path in paths.rows], return_counts=True)[1]
            line = cls((time - time.min())[:, None], np.ones(1))
            return [none, line] if levels.min() > 1 else [none]
        from scipy.interpolate import make_interp_spline  # takes 0.3 s to import

        centred, hats = knots - knots.mean(), make_interp_spline(knots, np.eye(len(knots)), k=1)
        return [none, cls(hats(time), centred / (centred @ centred))]

    def with_creep(self, means: IsobaricDataset, tension: Floats, time_constant: float) -> DriftBasis:
        """Basis with the part of the tension that has not yet followed its changes before a point [N].

        The muscle moved midway between successive points, and follows by an exponential.
        """
        order, column, memory = in_time(means), np.zeros(len(means)), 0.0
        decays = np.exp(-np.diff(means.table["time"].to_numpy()[order]) / (2 * time_constant))
        for row, decay, change in zip(order[1:], decays, np.diff(tension[order]), strict=True):
            memory = decay * (decay * memory + change)
            column[row] = memory
        return DriftBasis(np.column_stack([self.points, column]), np.append(self.slope, 0.0))


def clipped(means: IsobaricDataset, *, share: float = 0.25) -> bool:
    """True if the forces of the slack points end at a floor, as in a reading that is never negative.

    More than a `share` of them then have exactly the lowest force.
    """
    slack = means.force[means.slack]
    return bool(len(slack)) and int(np.count_nonzero(slack == slack.min())) > max(1.0, share * len(slack))


def in_time(means: IsobaricDataset) -> Ints:
    """Rows in the order of the test."""
    table = means.table
    return np.argsort(table["time"].to_numpy(), kind="stable") if "time" in table else np.arange(len(means))


def with_last_motion(means: IsobaricDataset) -> IsobaricDataset:
    """Points of a test at fixed lengths with the direction of the last motion; those of others as they are."""
    if not at_fixed_lengths(means) or len(means.directions) < 2:
        return means
    direction, word = means.table["direction"].to_numpy().copy(), ""
    for row in in_time(means):
        direction[row] = word = direction[row] or word
    return IsobaricDataset(means.table.assign(direction=("point", direction)))


def _half_gap(means: IsobaricDataset, rows: Bools | Ints, degree: int) -> tuple[float, float, int]:
    """Half the force of loading minus that of unloading [N], its standard error and degrees of freedom.

    It is the coefficient of the direction of some rows beside a polynomial of a degree in the contraction and, if their
    pressures differ, another one times the pressure.
    """
    place, pressure = means.contraction[rows], means.pressure[rows] / bar
    side = np.where(means.table["direction"].to_numpy()[rows] == "loading", 1.0, -1.0)
    powers = np.vander(place, degree + 1)
    by_pressure = powers * pressure[:, None] if len(np.unique(means.levels[rows])) > 1 else powers[:, :0]
    basis = np.concatenate([powers, by_pressure, side[:, None]], axis=1)
    freedom = len(basis) - basis.shape[1]
    if freedom < 1:
        remedy = f"measure at {basis.shape[1] + 1} points or more"
        raise NoHysteresisError(f"{len(basis)} taut points show no friction", value=len(basis), remedy=remedy)
    factor, force = np.linalg.qr(basis).R, means.force[rows]
    solution = np.linalg.lstsq(basis, force, rcond=None)[0]
    noise = float(np.sqrt(np.sum((force - basis @ solution) ** 2) / freedom))
    return float(solution[-1]), noise / abs(float(factor[-1, -1])), freedom


def half_gap_of_lengths(means: IsobaricDataset, taut: Bools, *, last: bool = False) -> tuple[float, float, int]:
    """As `loop_half_width`, by the first points of fixed lengths, or the last ones, with the degrees of freedom.

    At first the friction is as the motion left it; then the frame yields to the force, which may release it. Errors are
    common to the points of a length. The polynomial has as high a degree, up to four, as leaves two degrees of freedom.
    """
    order = in_time(means)[taut[in_time(means)]]
    order = order[::-1] if last else order
    rows = order[np.unique(holds(means, in_time(means))[order], return_index=True)[1]]
    lengths = len(np.unique(np.round(means.contraction[rows] / RESOLUTION)))
    degree = min(4, lengths - 1, (len(rows) - 3) // min(2, len(np.unique(means.levels[rows]))) - 1)
    if degree < 2:
        remedy = "move to more lengths, from both sides, and start each at the same pressure"
        raise NoHysteresisError(f"{len(rows)} lengths show no friction", value=len(rows), remedy=remedy)
    return _half_gap(means, rows, degree)


def loop_half_width(means: IsobaricDataset, taut: Bools) -> tuple[float, float]:
    """Half-difference [N] between the directions at the same pressure and contraction, and its standard error.

    The error is that of a normal distribution with the same interval for 95 %.

    It is the regression coefficient of the direction beside a force that is cubic in the contraction and affine in the
    pressure; at fixed lengths, that of `half_gap_of_lengths`. Its significance is tested by the one-sided t quantile of
    three standard errors of many points or, as lengths are few, by the interval for 95 %.

    Raises
    ------
    NoHysteresisError
        If the difference is not significant.
    IdentificationError
        If loading is significantly below unloading.
    """
    directed, fixed = taut & (means.table["direction"].to_numpy() != ""), at_fixed_lengths(means)
    middle, error, freedom = half_gap_of_lengths(means, directed) if fixed else _half_gap(means, directed, 3)
    from scipy.special import stdtrit

    if not abs(middle) > float(stdtrit(freedom, 0.975 if fixed else 0.99865)) * error:
        raise NoHysteresisError(
            f"loading is {2 * middle:.2g} N above unloading, with a standard error of {2 * error:.2g} N ({freedom} "
            "degrees of freedom): the data show no hysteresis",
            value=2 * middle,
            unit="N",
            remedy=f"fit the law alone (`identify`), or measure {'at more lengths' if fixed else 'with less noise'}",
        )
    if middle < 0:
        message = f"loading is {-2 * middle:.2g} N below unloading, which friction cannot be"
        remedy = (
            "loading is being stretched, unloading is shortening; if they are exchanged: columns={'loading': "
            "'unloading', 'unloading': 'loading'} (command line: --column loading=unloading --column unloading=loading)"
        )
        raise IdentificationError(message, value=2 * middle, unit="N", remedy=remedy)
    return middle, error * float(stdtrit(freedom, 0.975) / stdtrit(np.inf, 0.975))
