"""The loading path of an isobaric test, and the force along it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.least_squares import design_matrix
from mckibben.muscle import ForceLaw, MaxwellSlip, forces
from mckibben.muscle.friction import NARROWEST, drawn, faded, polygon

_SAME = 1.0  # Pa: levels that are nearer are one
_FEWEST = 4  # points on a way from which anything about friction can be learned
_WRONG = 0.05  # of the moves may be against their direction: labels at turns are a matter of taste
_FLIPS = 0.3  # turns a move; a stroke has a few moves at least
_SEEN = 3.0  # standard errors: a smaller gap between the directions is none
_SLACK = 2  # slack points that tell the sensor's zero of a way


@dataclass(frozen=True, eq=False)
class LoadingPaths:
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
    def approach_labels(self) -> list[NDArray[np.int64]]:
        """The rows of each way in the order of time."""
        return [self.place[:count, way] for way, count in enumerate(self.counts)]

    def scattered(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values by point and way, shape (points, ways, ...), as rows of the dataset, shape (rows, ...)."""
        rows = np.empty((len(self.length), *values.shape[2:]))
        for way, place in enumerate(self.approach_labels):
            rows[place] = values[: len(place), way]
        return rows

    @classmethod
    def of(cls, means: IsobaricDataset) -> LoadingPaths:
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
        approach_labels = np.split(order, ends)
        if np.median([len(way) for way in approach_labels]) < _FEWEST:
            raise IdentificationError(
                f"{len(means)} points make {len(ways)} ways at constant pressure: too short to show friction",
                remedy="give the nominal pressure of each point (set_pressure), and rows in the order of the test",
            )
        loading = table["direction"].to_numpy() == "loading"
        moves = np.concatenate([np.diff(length[way]) for way in approach_labels])
        labels = np.concatenate([loading[way[1:]] for way in approach_labels])
        moved = np.abs(moves) > 1e-9
        wrong = int(np.count_nonzero(moved & ((moves > 0) != labels)))
        if wrong > _WRONG * np.count_nonzero(moved) or not moved.any():
            raise IdentificationError(
                f"{wrong} of {np.count_nonzero(moved)} moves go against the direction of their point: the rows are not "
                "in the order of the test",
                value=wrong,
                remedy="give the time of each point, or rows in the order in which they were measured",
            )
        flips = sum(int(np.count_nonzero(np.diff(loading[way]))) for way in approach_labels)
        if flips > _FLIPS * np.count_nonzero(moved):
            raise IdentificationError(
                f"the direction changes {flips} times in {np.count_nonzero(moved)} moves: the rows are not in the "
                "order of the test",
                value=flips,
                remedy="give the time of each point, or rows in the order in which they were measured",
            )
        longest = max(map(len, approach_labels))
        place = np.stack([np.pad(way, (0, longest - len(way)), mode="edge") for way in approach_labels], axis=1)
        side = np.array([-1.0 if loading[way[0]] else 1.0 for way in approach_labels])
        counts = np.array([len(way) for way in approach_labels])
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
    def candidates(cls, strokes: LoadingPaths, means: IsobaricDataset) -> list[DriftBasis]:
        """No drift, a straight line and, from the simplest to the freest, a knot for each way that has slack points.

        Slack points tell where the sensor's zero is; without them the line begins at 0. Without times there is none.

        Examples
        --------
        >>> data = IsobaricDataset.of(
        ...     pressure=[1e5] * 8, contraction=[0, 0.1, 0.2, 0.3, 0.3, 0.2, 0.1, 0], force=[80, 40, 10, 0] * 2,
        ...     direction=["unloading"] * 4 + ["loading"] * 4, time=np.arange(8.0), initial_length=0.2)
        >>> none, line = DriftBasis.candidates(LoadingPaths.of(data), data)
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
        seen = [way for way in strokes.approach_labels if np.count_nonzero(slack[way]) >= _SLACK]
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


def loop_half_width(means: IsobaricDataset, taut: NDArray[np.bool_]) -> float:
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


FRICTION = ("half_width", "growth", "log_presliding")
"""What is sought of a `MaxwellSlip`: B0 [N], B1 [N/Pa] and the logarithm of s0 [m]."""

_SMALL = 1e-4  # N: a change of the tension for difference quotients
_RELATIVE = 1e-6
_WIDEST = 1e5  # N


@dataclass(frozen=True, eq=False)
class PathDependentModel:
    """Force along the way: law, friction as `MaxwellSlip.along` has it, and an offset in amplitudes.

    Parameters
    ----------
    template
        The law, with values for all of its parameters.
    strokes, means
        The course of a test, and its points.
    drift
        What the sensor's offset may look like.
    used
        Shape (rows,): the points whose residuals count; the way leads through all.
    reference_pressure
        Of the friction [Pa].
    elements
        Of the friction.
    """

    template: ForceLaw
    strokes: LoadingPaths
    means: IsobaricDataset = field(repr=False)
    drift: DriftBasis = field(repr=False)
    used: NDArray[np.bool_] = field(repr=False)
    reference_pressure: float
    elements: int

    @property
    def law_names(self) -> tuple[str, ...]:
        """The parameters of the law, linear ones first."""
        return tuple(p.name for p in type(self.template).parameters())

    def law(self, values: Mapping[str, float]) -> ForceLaw:
        """The law with those of its parameters that are among the values."""
        given = {name: values[name] for name in self.law_names if name in values}
        return dataclasses.replace(self.template, **given)

    def friction(self, values: Mapping[str, float]) -> MaxwellSlip:
        """The friction of these values."""
        return MaxwellSlip(
            values["half_width"],
            float(np.exp(values["log_presliding"])),
            growth=values["growth"],
            reference_pressure=self.reference_pressure,
            elements=self.elements,
        )

    @property
    def shortest(self) -> float:
        """The logarithm of the s0 [m] with which friction has changed sides after one step: below, all is the same."""
        share, stiffness = polygon(self.elements)
        return float(np.log(self.strokes.step / (2 * (share / stiffness).max())))

    def bounds(self, names: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The range of each parameter."""
        given = {p.name: (p.lower, p.upper) for p in type(self.template).shape_parameters}
        given |= {
            "half_width": (NARROWEST, _WIDEST),
            "log_presliding": (self.shortest, float(np.log(10 * np.ptp(self.strokes.length)))),
        }
        lower, upper = zip(*(given.get(name, (-np.inf, np.inf)) for name in names), strict=True)
        return np.array(lower, float), np.array(upper, float)

    def parts(self, values: Mapping[str, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The law's tension and the force of friction [N] at each row, shape (rows,)."""
        tension = self._tension(values)
        return tension, self._friction(tension[:, None], [values])[:, 0]

    def residuals(self, values: Mapping[str, float], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        """Measured minus modelled force [N] at the points used, with the sign that `least_squares` wants: modelled."""
        tension, friction = self.parts(values)
        return (tension + friction + self.drift.points @ offsets - self.means.force)[self.used]

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> NDArray[np.float64]:
        """The derivative of the modelled force at the points used by the named parameters and the offsets."""
        tension = self._tension(values)
        of_law = [name for name in names if name in self.law_names]
        columns = design_matrix(self.law(values), of_law, self.means.contraction, self.means.pressure)
        columns = columns * (tension > 0)[:, None]
        others = [name for name in names if name not in self.law_names]
        # One pass along the way for all difference quotients of the friction.
        by_law = _SMALL / np.maximum(np.abs(columns).max(axis=0, initial=0.0), 1e-300)
        small = np.array([*by_law, *map(self._small, others)])
        moved = [dict(values) for _ in names]
        for k, name in enumerate(others):
            moved[len(of_law) + k][name] += small[len(of_law) + k]
        tensions = np.repeat(tension[:, None], len(names) + 1, axis=1)
        tensions[:, 1 : len(of_law) + 1] += columns * small[: len(of_law)]
        friction = self._friction(np.maximum(tensions, 0.0), [values, *moved])
        slopes = (friction[:, 1:] - friction[:, :1]) / small
        slopes[:, : len(of_law)] += columns
        return np.concatenate([slopes, self.drift.points], axis=1)[self.used]

    def _small(self, name: str) -> float:
        return {"half_width": _RELATIVE, "growth": _RELATIVE / self._pressures, "log_presliding": _RELATIVE}[name]

    @cached_property
    def _pressures(self) -> float:
        return max(float(np.abs(self.means.pressure - self.reference_pressure).max()), 1.0)

    def _tension(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        return np.maximum(forces(self.law(values), self.means.contraction, self.means.pressure), 0.0)

    def _friction(self, tension: NDArray[np.float64], sets: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
        """For each column of tensions and its values, shape (rows, sets)."""
        half_width, growth, log_presliding = (np.array([values[name] for values in sets]) for name in FRICTION)
        above = self.means.pressure - self.reference_pressure
        limit = faded(half_width + growth * above[:, None], tension, np)
        share, stiffness = polygon(self.elements)
        stiffness = stiffness * (half_width / np.exp(log_presliding))[:, None]
        place = self.strokes.place
        deflections = drawn(
            self.strokes.travel[..., None], limit[place], stiffness, share, side=self.strokes.side[:, None]
        )
        return self.strokes.scattered(np.einsum("pwse,se->pws", deflections, stiffness))
