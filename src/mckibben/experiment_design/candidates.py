"""Candidate points of the next test, and the evenly spaced design."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.experiment_design.prior import SIGN, AtHand
from mckibben.identification.intervals import force_gradients
from mckibben.muscle import Domain, ForceLaw, Specimen, forces
from mckibben.units import bar, mm, percent

_MOST = 40_000  # states of a grid: beyond it no rig sets so fine


@dataclass(frozen=True)
class Setting:
    """What a rig can set, and what the muscle bears.

    Attributes
    ----------
    box
        Contractions [-] and gauge pressures [Pa] from which to choose.
    contraction_step, pressure_step
        Of the rig [-], [Pa]: states are whole multiples of these.
    lowest_force, highest_force
        What a force must be above to be a measurement, and may not exceed [N].
    """

    box: Domain
    contraction_step: float
    pressure_step: float
    lowest_force: float
    highest_force: float

    def __post_init__(self) -> None:
        for what, step, unit in (
            ("contraction", self.contraction_step, ""),
            ("pressure", self.pressure_step, " Pa"),
        ):
            if not (math.isfinite(step) and step > 0):
                raise RangeError(f"a {what} step of {step:g}{unit} is none", value=step, lower=0.0)


@dataclass(frozen=True, eq=False)
class States:
    """A grid of states, and which of them can be measured.

    Attributes
    ----------
    contractions, pressures
        Shape (contractions,), (pressures,): the axes [-], [Pa], ascending.
    force
        Shape (pressures, contractions): by the law [N].
    allowed
        The same shape: taut, not overloaded, and where the law has a meaning.
    """

    contractions: NDArray[np.float64] = field(repr=False)
    pressures: NDArray[np.float64] = field(repr=False)
    force: NDArray[np.float64] = field(repr=False)
    allowed: NDArray[np.bool_] = field(repr=False)

    @classmethod
    def of(cls, law: ForceLaw, setting: Setting) -> States:
        """All states of a setting.

        Raises
        ------
        RangeError
            If none of them can be measured, or the steps make more than a rig would ever set.
        """
        box = setting.box
        contractions = multiples(float(box.contraction_min), float(box.contraction_max), setting.contraction_step)
        pressures = multiples(float(box.pressure_min), float(box.pressure_max), setting.pressure_step)
        if len(contractions) * len(pressures) > _MOST:
            raise RangeError(
                f"{len(pressures)} pressures x {len(contractions)} contractions are too many to choose from",
                value=len(contractions) * len(pressures),
                upper=_MOST,
                remedy="choose coarser steps or narrower limits",
            )
        grid = contractions[None, :], pressures[:, None]
        force = forces(law, *grid)
        meant = np.asarray(type(law).formula_domain.contains(*grid))
        with np.errstate(invalid="ignore"):
            allowed = np.isfinite(force) & meant & (force > setting.lowest_force) & (force <= setting.highest_force)
        if not allowed.any():
            raise RangeError(
                f"at no state within contraction {_range(box.contraction_min, box.contraction_max, percent)} % and "
                f"pressure {_range(box.pressure_min, box.pressure_max, bar)} bar does the muscle pull with more than "
                f"{setting.lowest_force:.3g} and at most {setting.highest_force:.4g} N",
                remedy="widen the limits, or choose finer steps",
            )
        return cls(contractions, pressures, force, allowed)

    @property
    def places(self) -> NDArray[np.int64]:
        """Rows and columns of the allowed states, shape (states, 2)."""
        return np.argwhere(self.allowed)


def multiples(low: float, high: float, step: float) -> NDArray[np.float64]:
    """The whole multiples of a step from low to high, to rounding.

    >>> multiples(-0.03, 0.01, 0.01)
    array([-0.03, -0.02, -0.01,  0.  ,  0.01])
    """
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    return np.asarray(np.round(np.arange(first, last + 1) * step, 12), np.float64)


def _range(low: object, high: object, unit: float) -> str:
    return f"{float(low) / unit:g}..{float(high) / unit:g}"  # type: ignore[arg-type]


def even_layouts(states: States, count: int, directions: int) -> list[NDArray[np.int64]]:
    """Ways to spread points evenly: over so many pressures, and at each from one end of the taut stroke to the other.

    Parameters
    ----------
    states
        From which to choose.
    count
        How many points.
    directions
        How many directions there are; they alternate from point to point and from pressure to pressure.

    Returns
    -------
    list of ndarray
        Of shape (count, 3) each: pressure and contraction by number, and direction; one layout for each number of
        pressures from one to half of the points. Empty if there are fewer states than points.

    Examples
    --------
    >>> axis = np.arange(5.0)
    >>> layouts = even_layouts(States(axis, axis, np.ones((5, 5)), np.ones((5, 5), bool)), 4, 2)
    >>> [layout.tolist() for layout in layouts]
    [[[2, 0, 0], [2, 1, 1], [2, 3, 0], [2, 4, 1]], [[0, 0, 0], [0, 4, 1], [4, 0, 1], [4, 4, 0]]]
    """
    usable = np.flatnonzero(states.allowed.any(axis=1))
    layouts = []
    for levels in range(1, max(count // 2, 1) + 1):
        rows = usable[_spread(len(usable), levels)]
        sizes = np.full(levels, count // levels)
        sizes[levels - count % levels :] += 1  # more at high pressure, where the taut stroke is long
        if len(np.unique(rows)) < levels:
            break
        layout = []
        for i, (row, size) in enumerate(zip(rows, sizes, strict=True)):
            there = np.flatnonzero(states.allowed[row])
            columns = there[_spread(len(there), int(size))]
            layout += [(row, column, (i + j) % directions) for j, column in enumerate(columns)]
        if len(set(layout)) == count:
            layouts.append(np.array(layout))
    return layouts


def _spread(size: int, count: int) -> NDArray[np.int64]:
    """So many of `size` places from the first to the last; of one, the middle."""
    if count == 1:
        return np.array([(size - 1) // 2])
    return np.round(np.linspace(0, size - 1, count)).astype(np.int64)


_RESERVE = 0.05  # of the rated force stays unused, as in a protocol
_CLEAR = 3.0  # standard deviations of a point from which a force is no slack muscle's


def setting_for(
    hand: AtHand,
    limits: Domain | None,
    specimen: Specimen | None,
    contraction_step: float | None,
    pressure_step: float,
) -> tuple[Setting, list[str]]:
    """Where the rig may go, and sentences on it; arguments as for `mckibben.experiment_design.plan`.

    Raises
    ------
    RangeError
        If nothing says where to measure, or how hard the muscle may pull; or the limits lie outside the specimen's.
    """
    attrs = hand.measured.table.attrs
    said: list[str] = []
    if specimen is None and attrs["specimen"] in catalog.names("specimens"):
        specimen = catalog.specimen(attrs["specimen"])
    highest = float(hand.measured.force.max())
    if specimen is not None:
        box, highest = specimen.domain, (1 - _RESERVE) * float(specimen.rated_force)
    else:
        data = hand.measured
        if len(data) == 0:
            raise RangeError("neither points nor a specimen say where to measure", remedy="name the specimen")
        box = Domain(data.contraction.min(), data.contraction.max(), data.levels.min(), data.levels.max())
        if highest <= hand.measured.table.attrs["slack_force"]:
            raise RangeError(
                "no point is taut and the specimen is not known: nothing says how hard the muscle may pull",
                remedy="name the specimen",
            )
        said.append(
            "the specimen is not in the catalog: the plan stays within contractions, pressures and forces of the data"
            + (" as far as the limits do not say otherwise" if limits else "")
        )
    if limits is not None:
        box = limits if specimen is None else _within(limits, specimen)
    length = attrs.get("initial_length") or (float(specimen.initial_length) if specimen else None)
    usual = 1 * mm / length if length else 0.5 * percent
    step = usual if contraction_step is None else contraction_step
    lowest = float(attrs["slack_force"]) + _CLEAR * hand.spread.point
    return Setting(box, step, pressure_step, lowest, highest), said


def _within(limits: Domain, specimen: Specimen) -> Domain:
    """The part of the limits that the specimen permits."""
    box = limits.intersection(specimen.domain)
    try:
        return Domain(
            *(float(x) for x in (box.contraction_min, box.contraction_max, box.pressure_min, box.pressure_max))
        )
    except RangeError:
        raise RangeError(
            f"the limits {limits} lie outside {specimen.domain} of {specimen.name}",
            remedy="choose limits inside; a contraction is in %, or a ratio",
        ) from None


@dataclass(frozen=True, eq=False)
class Choices:
    """Every state in every direction as often as it may be measured, in this order; the last counts fastest.

    Attributes
    ----------
    states
        That can be measured.
    ways
        The directions; one that is empty where they make no difference.
    repeats
        How often.
    rows
        Shape (choices, unknowns): of the design matrix.
    strokes
        Shape (choices,): those of one pressure, direction and repeat share a stroke.
    """

    states: States
    ways: tuple[str, ...]
    repeats: int
    rows: NDArray[np.float64] = field(repr=False)
    strokes: NDArray[np.int64] = field(repr=False)

    @classmethod
    def of(cls, hand: AtHand, states: States, ways: tuple[str, ...], repeats: int) -> Choices:
        """All that can be measured."""
        levels, columns = states.places.T
        names = [p.name for p in type(hand.law).parameters()]
        rows = force_gradients(hand.law, names, states.contractions[columns], states.pressures[levels])
        each = len(ways) * repeats
        rows = np.repeat(rows, each, axis=0)
        if hand.friction:
            signs = np.tile(np.repeat([SIGN[way] for way in ways], repeats), len(levels))
            rows = np.concatenate([rows, signs[:, None]], axis=1)
        strokes = np.repeat(levels * each, each) + np.tile(np.arange(each), len(levels))
        return cls(states, ways, repeats, rows, np.unique(strokes, return_inverse=True)[1].reshape(-1))

    def places(self, chosen: list[int]) -> list[tuple[float, float, str, int, float]]:
        """Pressure, contraction, direction, repeat and expected force; passes are counted as they come."""
        passes: dict[tuple[int, int], list[int]] = {}
        found = []
        for one in chosen:
            place, rest = divmod(one, len(self.ways) * self.repeats)
            way, repeat = divmod(rest, self.repeats)
            row, column = self.states.places[place]
            seen = passes.setdefault((int(row), way), [])
            if repeat not in seen:
                seen.append(repeat)
            where = float(self.states.pressures[row]), float(self.states.contractions[column])
            found.append((*where, self.ways[way], seen.index(repeat), float(self.states.force[row, column])))
        return found

    def even(self, count: int) -> list[list[int]]:
        """Evenly spaced points, in several layouts."""
        numbers = np.cumsum(self.states.allowed.ravel()).reshape(self.states.allowed.shape) - 1
        each = len(self.ways) * self.repeats
        return [
            [int(numbers[row, column]) * each + int(way) * self.repeats for row, column, way in layout]
            for layout in even_layouts(self.states, count, len(self.ways))
        ]
