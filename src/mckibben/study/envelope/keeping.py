"""Offers and designs as scenarios that can be run."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.control import Constant, Multisine, Signal, Sine, Step
from mckibben.errors import UnreachableError
from mckibben.files import whole
from mckibben.study.envelope.design import Design
from mckibben.study.envelope.nearest import Offer
from mckibben.study.parameters import with_values
from mckibben.study.scenario import ReferenceSpec, Scenario, StartSpec
from mckibben.units import deg

PLACES = {
    "connector_length": "joint.connector_length",
    "joint_radius": "joint.geometry.joint_radius",
    "joint_length": "joint.geometry.joint_length",
}
"""Where a scenario has the lengths of a design; a muscle's length belongs to its specimen, which the catalog has."""


def keep_offer(scenario: Scenario, offer: Offer, folder: Path, name: str) -> list[str]:
    """Write an offer as a scenario, and its samples, where it has any, as a table beside it.

    The scenario starts at rest at the first angle and stiffness of the offer; a slower one takes longer.

    Returns
    -------
    names
        Of the files.
    """
    table = folder / f"{name}.csv"
    sampled = [_is_sampled(signal) for signal in (offer.reference.angle, offer.reference.stiffness)]
    if any(sampled):
        _write_samples(table, offer)
    angle, stiffness = (_written(signal, table) for signal in (offer.reference.angle, offer.reference.stiffness))
    motion = offer.following.motion
    periods = math.ceil(scenario.duration / offer.speed / scenario.control_period - 1e-9)
    update = {
        "name": f"{scenario.name[:150]}, nearest that keeps the {offer.kept.name.lower()}",
        "signals": ReferenceSpec.model_validate({"angle": angle, "stiffness": stiffness}),
        "start": StartSpec(angle=float(motion.angle[0]), stiffness=float(motion.stiffness[0])),
        "duration": scenario.duration if offer.speed == 1 else periods * scenario.control_period,
    }
    changed = scenario.model_copy(update=update)
    if not _can_start(changed):  # the reference may begin in motion, with a torque that rest does not have
        changed = changed.model_copy(update={"start": StartSpec(angle=float(motion.angle[0]))})
    changed.to_yaml(folder / f"{name}.yaml")
    return [f"{name}.yaml", *([table.name] if any(sampled) else [])]


def keep_design(scenario: Scenario, found: Design, path: Path) -> bool:
    """Write a scenario with the lengths of a design; False if it varies one that a scenario cannot hold.

    Its start keeps the angle, and the stiffness where that can be held.
    """
    if not set(found.lengths) <= set(PLACES):
        return False
    changed = with_values(scenario, {PLACES[name]: value for name, value in found.lengths.items()})
    if not _can_start(changed):
        changed = changed.model_copy(update={"start": StartSpec(angle=scenario.start.angle)})
    changed.to_yaml(path)
    return True


def _can_start(scenario: Scenario) -> bool:
    try:
        scenario.initial(scenario.plant())
    except (UnreachableError, ValueError):
        return False
    return True


def _is_sampled(signal: Signal) -> bool:
    return not isinstance(signal, Constant | Sine | Multisine | Step)


def _write_samples(path: Path, offer: Offer) -> None:
    times = offer.times
    columns = {"time_s": times}
    for title, signal, unit in (
        ("angle_deg", offer.reference.angle, deg),
        ("stiffness_N*m/rad", offer.reference.stiffness, 1.0),
    ):
        if _is_sampled(signal):
            columns[title] = np.asarray(signal(times), float) / unit
    with whole(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.9g}" for value in row] for row in zip(*columns.values(), strict=True))


def _written(signal: Signal, table: Path) -> dict[str, Any]:
    """A signal as the mapping of a scenario, in SI."""
    match signal:
        case Constant():
            return {"constant": float(signal.value)}
        case Step():
            return {"step": {name: float(getattr(signal, name)) for name in ("before", "after", "at")}}
        case Sine():
            names = ("amplitude", "frequency", "offset", "phase")
            return {"sine": {name: float(getattr(signal, name)) for name in names}}
        case Multisine():
            lists = {name: tuple(map(float, getattr(signal, name))) for name in ("amplitudes", "frequencies", "phases")}
            given = {name: values for name, values in lists.items() if values}
            return {"multisine": {**given, "offset": float(signal.offset)}}
    return {"samples": {"file": table}}
