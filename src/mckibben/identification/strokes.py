"""The course of an isobaric test: which way the muscle was drawn to each point, and when."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError

_SAME = 1.0  # Pa: levels that are nearer are one
_FEWEST = 4  # points on a way from which anything about friction can be learned
_WRONG = 0.05  # of the moves may be against their direction: labels at turns are a matter of taste
_FLIPS = 0.3  # turns a move; a stroke has a few moves at least
_SEEN = 3.0  # standard errors: a smaller gap between the directions is none
_SLACK = 2  # slack points that tell the sensor's zero of a way


@dataclass(frozen=True, eq=False)
class Strokes:
    """The ways of a test, one for each time that a pressure was set.

    Attributes
    ----------
    place
        Shape (points, ways): the row of the dataset that each point of a way is, in the order of time; short ways are
        filled up with their last row.
    counts
        Shape (ways,): how many points each really has.
    side
        Shape (ways,): of the band on which each begins; 1 stretched, -1 let go.
    length
        Shape (rows,): of the muscle [m].
    step
        The median move [m].
    """

    place: NDArray[np.int64] = field(repr=False)
    counts: NDArray[np.int64]
    side: NDArray[np.float64]
    length: NDArray[np.float64] = field(repr=False)
    step: float

    @property
    def travel(self) -> NDArray[np.float64]:
        """The move [m] to each point of a way from the one before, shape (points, ways); 0 at the first."""
        length = self.length[self.place]
        return np.diff(length, axis=0, prepend=length[:1])

    @property
    def ways(self) -> list[NDArray[np.int64]]:
        """The rows of each way in the order of time."""
        return [self.place[:count, way] for way, count in enumerate(self.counts)]

    def scattered(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values by point and way, shape (points, ways, ...), as rows of the dataset, shape (rows, ...)."""
        rows = np.empty((len(self.length), *values.shape[2:]))
        for way, place in enumerate(self.ways):
            rows[place] = values[: len(place), way]
        return rows

    @classmethod
    def of(cls, means: IsobaricDataset) -> Strokes:
        """The course of a dataset of plateau means.

        Raises
        ------
        IdentificationError
            If it has no directions, or only one, or no initial length, or rows in an order that is no test's.
        """
        table = means.table
        if "direction" not in table or len(means.directions) < 2:
            which = f"{means.directions[0]} alone" if len(means.directions) else "no directions"
            raise IdentificationError(
                f"the dataset has {which}: hysteresis is what loading and unloading differ by",
                remedy="measure in both directions, and give the direction of each point",
            )
        if "initial_length" not in table.attrs:
            raise IdentificationError(
                "the initial length is not known: friction changes sides over a length, not a contraction",
                remedy="give the dataset its initial_length",
            )
        length = table.attrs["initial_length"] * (1 - means.contraction)
        order = np.argsort(table["time"].to_numpy(), kind="stable") if "time" in table else np.arange(len(means))
        ends = np.flatnonzero(np.abs(np.diff(means.levels[order])) > _SAME) + 1
        ways = np.split(order, ends)
        if np.median([len(way) for way in ways]) < _FEWEST:
            raise IdentificationError(
                f"{len(means)} points make {len(ways)} ways at constant pressure: too short to show friction",
                remedy="give the nominal pressure of each point (set_pressure), and rows in the order of the test",
            )
        loading = table["direction"].to_numpy() == "loading"
        moves = np.concatenate([np.diff(length[way]) for way in ways])
        labels = np.concatenate([loading[way[1:]] for way in ways])
        moved = np.abs(moves) > 1e-9
        wrong = int(np.count_nonzero(moved & ((moves > 0) != labels)))
        if wrong > _WRONG * np.count_nonzero(moved) or not moved.any():
            raise IdentificationError(
                f"{wrong} of {np.count_nonzero(moved)} moves go against the direction of their point: the rows are not "
                "in the order of the test",
                value=wrong,
                remedy="give the time of each point, or rows in the order in which they were measured",
            )
        flips = sum(int(np.count_nonzero(np.diff(loading[way]))) for way in ways)
        if flips > _FLIPS * np.count_nonzero(moved):
            raise IdentificationError(
                f"the direction changes {flips} times in {np.count_nonzero(moved)} moves: the rows are not in the "
                "order of the test",
                value=flips,
                remedy="give the time of each point, or rows in the order in which they were measured",
            )
        longest = max(map(len, ways))
        place = np.stack([np.pad(way, (0, longest - len(way)), mode="edge") for way in ways], axis=1)
        side = np.array([-1.0 if loading[way[0]] else 1.0 for way in ways])
        counts = np.array([len(way) for way in ways])
        return cls(place, counts, side, length, float(np.median(np.abs(moves[moved]))))


@dataclass(frozen=True, eq=False)
class DriftBasis:
    """What the drift of a sensor may look like: offset = points @ amplitudes.

    Attributes
    ----------
    points
        Shape (rows, amplitudes).
    time
        Shape (knots,): between them it is straight [s].
    at_knots
        Shape (knots, amplitudes): the same there.
    """

    points: NDArray[np.float64]
    time: NDArray[np.float64]
    at_knots: NDArray[np.float64]

    @classmethod
    def candidates(cls, strokes: Strokes, means: IsobaricDataset) -> list[DriftBasis]:
        """No drift, a straight line and, from the simplest to the freest, a knot for each way that has slack points.

        Slack points tell where the sensor's zero is; without them the line begins at 0. Without times there is none.

        Examples
        --------
        >>> data = IsobaricDataset.of(
        ...     pressure=[1e5] * 8, contraction=[0, 0.1, 0.2, 0.3, 0.3, 0.2, 0.1, 0], force=[80, 40, 10, 0] * 2,
        ...     direction=["unloading"] * 4 + ["loading"] * 4, time=np.arange(8.0), initial_length=0.2)
        >>> none, line = DriftBasis.candidates(Strokes.of(data), data)
        >>> line.points.ravel()
        array([0., 1., 2., 3., 4., 5., 6., 7.])
        """
        none = cls(np.empty((len(means), 0)), np.empty(0), np.empty((0, 0)))
        if "time" not in means.table:
            return [none]
        time, slack = means.table["time"].to_numpy(), means.slack
        ends = np.array([time.min(), time.max()])
        if ends[0] == ends[1]:
            return [none]
        seen = [way for way in strokes.ways if np.count_nonzero(slack[way]) >= _SLACK]
        knots = np.unique([float(time[way][slack[way]].mean()) for way in seen])
        if len(knots) < 2:
            return [none, cls((time - ends[0])[:, None], ends, ends[:, None] - ends[0])]
        return [none, cls(_hats(time, ends), ends, np.eye(2)), cls(_hats(time, knots), knots, np.eye(len(knots)))]

    @property
    def zeroed(self) -> bool:
        """Whether it has an offset of its own, which only slack points tell."""
        return self.points.shape[1] > 1


def _hats(time: NDArray[np.float64], knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Straight lines between knots, going on as they are beyond the outer ones; shape (points, knots)."""
    left = np.clip(np.searchsorted(knots, time) - 1, 0, len(knots) - 2)
    part = (time - knots[left]) / (knots[left + 1] - knots[left])
    basis = np.zeros((len(time), len(knots)))
    rows = np.arange(len(time))
    basis[rows, left] = 1 - part
    basis[rows, left + 1] = part
    return basis


def _gaps(means: IsobaricDataset, taut: NDArray[np.bool_]) -> NDArray[np.float64]:
    """How far loading is above unloading [N], at each pressure and contraction that has both."""
    keys = np.stack([means.levels.round(-2), means.contraction.round(5)], axis=1)
    place = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    loading = means.table["direction"].to_numpy() == "loading"
    sides = [taut & loading, taut & ~loading]
    counts = [np.bincount(place, side, place.max() + 1) for side in sides]
    both = (counts[0] > 0) & (counts[1] > 0)
    first, second = (np.bincount(place, side * means.force, place.max() + 1)[both] for side in sides)
    return first / counts[0][both] - second / counts[1][both]


def half_gap(means: IsobaricDataset, taut: NDArray[np.bool_]) -> float:
    """Half the usual gap between the directions at the same pressure and contraction [N], for a first guess.

    Parameters
    ----------
    means
        With directions.
    taut
        Shape (rows,): the points to look at.

    Raises
    ------
    IdentificationError
        If no points were measured in both directions, or they do not differ.
    """
    gaps = _gaps(means, taut)
    if len(gaps) < 2:
        raise IdentificationError(
            f"{len(gaps)} taut points were measured at the same pressure and contraction in both directions",
            value=len(gaps),
            lower=2,
            remedy="go back over the same positions, and give nominal pressures (set_pressure)",
        )
    middle, error = float(np.median(gaps)), 1.25 * float(np.std(gaps)) / np.sqrt(len(gaps))
    if not middle > _SEEN * error:
        raise IdentificationError(
            f"loading is {middle:.2g} N above unloading, with a standard error of {error:.2g} N: the data show no "
            "hysteresis",
            value=middle,
            unit="N",
            remedy="take the law alone (`identify`), or measure with less noise",
        )
    return middle / 2
