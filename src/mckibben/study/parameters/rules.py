"""What numbers of a scenario must keep to among themselves, for a whole table of them.

The rules have one home, the parts of a scenario and the objects that are built from them: what is tried here is to make
these. Parts that share no rule are tried apart from each other.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, RangeError
from mckibben.study.parameters.address import Address
from mckibben.study.parameters.putting import part_at, validated
from mckibben.study.parameters.survey import Place
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.controller import BelievingSpec
from mckibben.study.scenario.part import Part

_Attempt = Callable[[Sequence[Any]], str | None]
"""Says of values, one for each number, why they are not allowed."""


class Refusal(NamedTuple):
    """Why a row is not allowed, and the numbers whose values it is about."""

    addresses: tuple[Address, ...]
    reason: str


def refusals(scenario: Scenario, columns: Mapping[Address, NDArray]) -> dict[int, Refusal]:
    """Why rows of a table are not allowed: by row, in order.

    Parameters
    ----------
    scenario
        Into which the values are to be put.
    columns
        Of one length, each in the range of its field.
    """
    groups: dict[Place, list[Address]] = {}
    for address in columns:
        groups.setdefault(_part_of(address.place), []).append(address)
    found: dict[int, Refusal] = {}
    for place, group in groups.items():
        attempt = _attempt(scenario, place, [address.place[len(place) :] for address in group])
        table = [columns[address] for address in group]
        for row, reason in _search(attempt, table, np.arange(len(table[0]))).items():
            found.setdefault(row, Refusal(tuple(group), reason))
    return dict(sorted(found.items()))


def _part_of(place: Place) -> Place:
    """The part within which a number has to do with others."""
    return place[:2] if len(place) > 2 and place[0] in ("controller", "reference") else place[:1]


def _attempt(scenario: Scenario, place: Place, keys: list[Place]) -> _Attempt:
    """What says of values why the part does not allow them; None where it does."""
    part = part_at(scenario, place)
    build = _builder(place)

    def attempt(values: Sequence[Any]) -> str | None:
        try:
            build(validated(part, dict(zip(keys, values, strict=True)), place))
        except (ParameterError, RangeError) as error:
            return str(error)
        return None

    return attempt


def _builder(place: Place) -> Callable[[Any], object]:
    """What makes of a part the object whose constructor has rules of its own."""
    from mckibben.study.scenario import building

    match place:
        case ("load",):
            return building.build_load
        case ("valve",):
            return building.build_valve
        case ("joint",) | ("controller", "model"):
            return lambda spec: (building.build_geometry(spec), building.build_tendon(spec.spring))
        case ("controller", "decoupling"):
            return lambda spec: (building.decoupling_parts(spec), _beliefs(spec))
        case ("controller", "predictive"):
            return lambda spec: (building.observers(spec), _beliefs(spec))
        case ("controller", "inverse_model"):
            return lambda spec: spec.load and building.build_load(spec.load)
        case ("controller", _):
            return building.build_loop
        case ("reference", quantity):
            return lambda spec: building.build_signal(spec, quantity)
        case _:
            return _nothing


def _beliefs(spec: BelievingSpec) -> tuple[object, ...]:
    """What a controller by a model believes, and what corrects it."""
    from mckibben.study.scenario import building

    return spec.load and building.build_load(spec.load), building.build_adaptation(spec.adaptation)


def _nothing(_: Part) -> None:
    """A start is made by the plant."""


def _search(attempt: _Attempt, table: Sequence[NDArray], rows: NDArray[np.int64]) -> dict[int, str]:
    """The rows that are refused, and why, without a look at each of them.

    Each rule compares sums and products of numbers, or their signs: away from zero it is the stricter the further a
    number goes one way. So where all corners of the box around some rows are allowed, its inside is, too; where not,
    the rows are halved.
    """
    ends = [_ends(column[rows]) for column in table]
    corners = math.prod(len(each) for each in ends)
    if corners > 1 and corners >= len(rows):
        tried = {row: attempt([column[row].item() for column in table]) for row in rows.tolist()}
        return {row: reason for row, reason in tried.items() if reason is not None}
    refused = next(filter(None, map(attempt, itertools.product(*ends))), None)
    if refused is None:
        return {}
    if corners == 1:
        return dict.fromkeys(rows.tolist(), refused)
    widths = [np.ptp(column[rows]) / max(np.ptp(column), 1e-300) for column in table]
    widest = table[int(np.argmax(widths))]
    ordered = rows[np.argsort(widest[rows], kind="stable")]
    return {
        **_search(attempt, table, ordered[: len(rows) // 2]),
        **_search(attempt, table, ordered[len(rows) // 2 :]),
    }


def _ends(column: NDArray) -> list[Any]:
    """The lowest and highest of the numbers below, at and above zero."""
    signs = [column[column < 0], column[column == 0], column[column > 0]]
    return sorted({end.item() for part in signs if part.size for end in (part.min(), part.max())})
