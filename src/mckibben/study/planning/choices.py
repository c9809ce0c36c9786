"""The points to choose from: every state in every direction, as often as it may be measured."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.identification.bands import force_gradients
from mckibben.muscle import Domain, Specimen
from mckibben.study.planning.at_hand import SIGN, AtHand
from mckibben.study.planning.candidates import Setting, States
from mckibben.study.planning.even import even_layouts
from mckibben.units import mm, percent

_RESERVE = 0.05  # of the rated force stays unused, as in a protocol
_CLEAR = 3.0  # standard deviations of a point from which a force is no slack muscle's


def setting_for(
    hand: AtHand,
    limits: Domain | None,
    specimen: Specimen | None,
    contraction_step: float | None,
    pressure_step: float,
) -> tuple[Setting, list[str]]:
    """Where the rig may go, and sentences on it; arguments as for `mckibben.study.planning.plan`.

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
