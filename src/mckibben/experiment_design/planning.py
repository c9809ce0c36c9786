"""From points at hand to the points that come next: what of them makes a quantity surest."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, ParameterError, RangeError
from mckibben.experiment_design.candidates import Choices, Setting, States, setting_for
from mckibben.experiment_design.information import Aim, Coordinates, Field, Judge, information, search
from mckibben.experiment_design.prior import AtHand
from mckibben.experiment_design.quantities import Quantity
from mckibben.experiment_design.result import (
    ErrorMap,
    Plan,
    PlannedPoint,
    about_coverage,
    about_force,
    about_parameters,
)
from mckibben.identification import Fit
from mckibben.muscle import Domain, ForceLaw, Specimen
from mckibben.units import bar

DIRECTIONS = ("loading", "unloading")
_PRIOR = 100.0  # highest forces, by which each coordinate may be off before anything is measured
_ROUNDING = 1e-10  # of the information of one point: a weaker prior would drown in rounding
_MOST_POINTS = 200
_NOTHING = 1e-9  # a quantity that moves by less per newton depends on nothing


def plan(
    data: IsobaricDataset | Fit,
    quantity: Quantity,
    law_type: type[ForceLaw] | None = None,
    *,
    points: int = 8,
    limits: Domain | None = None,
    specimen: Specimen | None = None,
    contraction_step: float | None = None,
    pressure_step: float = 0.25 * bar,
    directions: Sequence[str] = DIRECTIONS,
    repeats: int = 2,
    friction: bool | None = None,
    noise: float | None = None,
    stroke_error: float | None = None,
    guess: ForceLaw | None = None,
) -> Plan:
    """Which points to measure next, so that a quantity becomes as sure as possible.

    A locally optimal exact design: the law is taken as linear in its parameters about the fit, and points are chosen
    from a grid and exchanged until nothing improves. Where directions are recorded, half the gap between them is an
    unknown of the fit: points of one direction alone do not tell it from the force.

    Parameters
    ----------
    data
        The points at hand, or a fit to them.
    quantity
        `Coefficients`, `Force`, `JointStiffness` or `JointTorque`.
    law_type
        The kind of law; that of the fit, where a fit is given.
    points
        How many.
    limits
        Where to measure, as far as the specimen permits; all of its range unless given, and that of the data where the
        specimen is not known.
    specimen
        Range, rating and length of the muscle; that of the catalog by the name in the data unless given.
    contraction_step, pressure_step
        What the rig can set [-], [Pa]: whole multiples of these. 1 mm unless given, or 0.5 % of an unknown length.
    directions
        In which it can measure.
    repeats
        How often a point may be in the plan, each time on another pass.
    friction
        Whether an unknown gap between the directions is part of the model; unless said, where directions are recorded.
    noise, stroke_error
        Standard deviation of a point on its own, and of what the points of a stroke share [N]; estimated from what the
        fit leaves over unless given.
    guess
        A law to begin with where the data do not determine one; fitted to a maker's chart unless given.

    Raises
    ------
    IdentificationError
        If no measurement within the limits can make the quantity surer.
    RangeError
        If nothing can be measured within the limits, or a number makes no sense.
    ParameterError
        If the law has no such coefficient, a direction is none, or the law's kind is missing.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw
    >>> from mckibben.study.planning import Coefficients
    >>> data = catalog.dataset("dmsp-10-250-martens2017")
    >>> found = plan(data, Coefficients(("decay",)), ExponentialLaw, points=4)
    >>> found.after < found.even < found.now
    True
    """
    _check(points, repeats, directions, noise, stroke_error)
    hand = AtHand.of(data, law_type, friction, noise, stroke_error, guess)
    setting, said = setting_for(hand, limits, specimen, contraction_step, pressure_step)
    states = States.of(hand.law, setting)
    ways = tuple(d for d in DIRECTIONS if d in directions) if hand.friction else ("",)
    candidates = Choices.of(hand, states, ways, repeats)
    if len(candidates.rows) < points:
        raise RangeError(
            f"there are {len(candidates.rows)} points to choose {points} from",
            value=points,
            upper=len(candidates.rows),
            remedy="choose finer steps, wider limits or fewer points",
        )
    target = quantity.target(hand.law, states)
    gradients = np.pad(target.gradients, ((0, 0), (0, hand.friction)))  # friction is of no interest itself
    coordinates = Coordinates.of(np.concatenate([candidates.rows[:: candidates.repeats], hand.rows]))
    _check_sensible(quantity, gradients, coordinates, hand, ways)
    aim = Aim.of(gradients @ coordinates.forward, target.joint)
    weakest = 1 / (_PRIOR * float(states.force[states.allowed].max())) ** 2, _ROUNDING / hand.spread.point**2
    prior = np.eye(coordinates.forward.shape[1]) * max(weakest)
    known = information(hand.rows @ coordinates.forward, hand.strokes, hand.spread)
    field = Field(candidates.rows @ coordinates.forward, candidates.strokes, known + prior, hand.spread, aim)
    judge = Judge(known, prior)

    chosen = search(field, points)
    added = [field.after(chosen[: i + 1]) - field.known for i in range(points)]
    errors = [judge.error(aim), *(judge.error(aim, more) for more in added)]
    layouts = [(judge.error(aim, field.after(one) - field.known), one) for one in candidates.even(points)]
    even, evenly = min(layouts, default=(math.nan, []))
    each = np.eye(len(hand.names)) @ coordinates.forward
    lost = coordinates.misses(np.eye(len(hand.names))) > 1e-6
    now, after = (np.where(lost, np.inf, judge.errors(each, more)) for more in (0.0, added[-1]))
    over = candidates.rows[:: candidates.repeats * len(ways)].copy()
    over[:, len(over[0]) - hand.friction :] = 0.0  # the law's force, midway between the directions
    maps = [_mapped(states, judge.errors(over @ coordinates.forward, more)) for more in (0.0, added[-1])]
    combinations = np.concatenate([coordinates.lost, judge.unknown(coordinates)], axis=1)
    values = np.array([*(float(getattr(hand.law, name)) for name in hand.names[: hand.parameters]), *hand.width])
    return Plan(
        quantity=quantity,
        law=hand.law,
        points=tuple(
            PlannedPoint(*place, standard_error=error, gain=_gain(before, error))
            for place, before, error in zip(candidates.places(chosen), errors, errors[1:], strict=False)
        ),
        now=errors[0],
        after=errors[-1],
        even=even,
        even_points=tuple(place[:4] for place in candidates.places(evenly)),
        value=float(target.values[0]) if len(target.values) == 1 else None,
        parameter_errors={
            name: (float(now[i]), float(after[i])) for i, name in enumerate(hand.names[: hand.parameters])
        },
        spread=hand.spread,
        half_width=float(values[-1]) if hand.friction and np.isfinite(now[-1]) else None,
        unseen=(
            *about_parameters(hand.names, combinations, values, now),
            *about_force(states, maps[0], hand.spread.point),
            *about_coverage(hand.points, hand.measured, states),
        ),
        notes=(
            *hand.notes,
            *said,
            *target.doubts,
            *_risky(field, chosen, candidates, judge, setting),
            *_hopeless(errors, target.values),
        ),
        measured=hand.measured,
        map=ErrorMap(states, *maps),
        target_states=target.states,
    )


def _mapped(states: States, errors: NDArray[np.float64]) -> NDArray[np.float64]:
    mapped = np.full(states.allowed.shape, np.nan)
    mapped[states.allowed] = errors
    return mapped


def _gain(before: float, after: float) -> float:
    if math.isinf(before):
        return 0.0 if math.isinf(after) else 1.0
    return 1 - after / before


def _hopeless(errors: list[float], values: NDArray[np.float64]) -> list[str]:
    if math.isinf(errors[-1]):
        return ["even these points do not determine the quantity: plan more of them"]
    if math.isfinite(errors[0]) and errors[-1] > 0.99 * errors[0]:
        return ["there is little to gain: these points shrink the standard error by less than 1 %"]
    if len(values) == 1 and math.isfinite(errors[0]) and errors[0] > abs(values[0]):
        return ["the standard error is larger than the value: measure a few of these points, and plan again"]
    return []


def _risky(field: Field, chosen: list[int], candidates: Choices, judge: Judge, setting: Setting) -> list[str]:
    """Which points may pull harder than they should, as far as is known."""
    force = np.array([place[-1] for place in candidates.places(chosen)])
    errors = judge.errors(field.rows[chosen])
    over = [str(i + 1) for i in np.flatnonzero(np.isfinite(errors) & (force + 2 * errors > setting.highest_force))]
    if not over:
        return []
    return [
        f"the force may exceed {setting.highest_force:.0f} N at point{'s' * (len(over) > 1)} {', '.join(over)}, "
        "as far as is known now: come there slowly"
    ]


def _check(
    points: int, repeats: int, directions: Sequence[str], noise: float | None, stroke_error: float | None
) -> None:
    if not 1 <= points <= _MOST_POINTS:
        raise RangeError(
            f"{points} points cannot be planned; 1 to {_MOST_POINTS} can", value=points, lower=1, upper=_MOST_POINTS
        )
    if not 1 <= repeats <= 20:
        raise RangeError(f"{repeats} repeats cannot be planned; 1 to 20 can", value=repeats, lower=1, upper=20)
    for direction in directions or [""]:
        if direction not in DIRECTIONS:
            raise ParameterError(
                f"{direction!r} is no direction", value=direction, remedy=f"give {' or '.join(DIRECTIONS)}, or both"
            )
    for name, value, least in (("noise", noise, "above 0"), ("stroke error", stroke_error, "0 or above")):
        if value is not None and not (math.isfinite(value) and (value > 0 or (value == 0 and least != "above 0"))):
            raise RangeError(f"a {name} of {value:g} N is not {least}", value=value, lower=0.0, unit="N")


def _check_sensible(
    quantity: Quantity, gradients: NDArray[np.float64], coordinates: Coordinates, hand: AtHand, ways: tuple[str, ...]
) -> None:
    """Refuse a quantity that no measurement can make surer."""
    if not np.abs(gradients / coordinates.size).max() > _NOTHING:
        raise IdentificationError(
            f"{quantity}: there is nothing to gain; it does not depend on the law's parameters there (both muscles are "
            "slack, or their errors cancel)",
            remedy="choose another angle or other pressures",
        )
    if (coordinates.misses(gradients) > 1e-6).any():
        share = np.abs(coordinates.lost).max(axis=1)
        tied = [name for name, part in zip(hand.names, share, strict=True) if part > 0.05 * share.max()]
        one_way = hand.friction and len(ways) == 1 and "friction" in tied
        raise IdentificationError(
            f"{quantity}: no measurement within the limits can tell it, for {', '.join(tied)} can change together and "
            "leave all forces as they are",
            remedy=f"measure in the other direction than {ways[0]} too, or plan without friction"
            if one_way
            else "take a law with fewer parameters, or wider limits",
        )
