"""Tests on a joint: torques at angles as forces and lengths of the muscle that is under pressure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from mckibben.dataset.raw import Floats
from mckibben.dataset.table import Column, Question, question
from mckibben.dataset.vocabulary import QUANTITIES
from mckibben.muscle import air
from mckibben.units import show

PRESSURES = ("pressure", "pressure1", "pressure2")
"""Pressures of the only muscle, and of muscles 1 and 2."""


class JointPaths(Protocol):
    """Geometry of a joint, such as `mckibben.joint.Geometry`."""

    @property
    def angle_range(self) -> tuple[float, float]:
        """Range of angles [rad] in which it is defined."""

    def paths_and_arms(self, angle: Any) -> tuple[Any, Any]:
        """Return lengths [m] and moment arms [m] of muscles 1 and 2, each a pair, at an angle [rad]."""


AT_LEVER = "force at lever"
"""Column of the forces that became torques."""


def needed_at_joint(columns: dict[str, Column], lever: float | None) -> tuple[str, ...]:
    """Quantities that a test on a joint needs; a force at a lever arm [m] becomes a torque."""
    if lever is not None and "force" in columns and "torque" not in columns:
        columns[AT_LEVER] = force = columns.pop("force")
        remarks = (f"at an arm of {show(lever, 'mm')}",)
        columns["torque"] = Column(force.header, "torque", "N*m", lever * force.values, force.source, remarks)
    measured = "force" if lever is not None and "torque" not in columns else "torque"
    return ("angle", measured) if any(name in columns for name in PRESSURES) else ("angle", measured, "pressure")


def implausible_torque(columns: Mapping[str, Column], arms: Floats) -> Iterator[Question]:
    """Ask about torques that no muscle has at its pressure and moment arm, shape (1 or 2 muscles, rows) [m].

    The largest one by the ideal bound of Chou and Hannaford, with the diameters of muscles; of two muscles, the one
    with more pressure has to win.
    """
    measured, torque = columns.get(AT_LEVER, columns["torque"]), columns["torque"].values
    pressures = np.array([columns[name].values for name in (PRESSURES[1:] if len(arms) > 1 else PRESSURES[:1])])
    moments, size = arms * pressures, np.abs(torque)  # N, per area of a muscle
    largest = np.max(moments, axis=0)
    option = f"--column '{measured.header}={{}}{measured.quantity}_{{}}'"
    at = int(np.argmax(np.where(largest > 0, size, 0)))
    if not (size[at] > 0 and largest[at] > 0):
        return
    diameter = air.implied_diameter(size[at] / largest[at])
    if not air.DIAMETERS[0] <= diameter <= air.DIAMETERS[1]:
        low, high = (size[at] * (limit / diameter) ** 2 for limit in air.DIAMETERS)
        found = show(size[at], "N*m", 3), show(diameter, "mm", 3), show(pressures[:, at].max(), "bar", 3)
        text = (
            f"the largest torque, {found[0]}, is that of a muscle of {found[1]} diameter: at {found[2]} and an arm of "
            f"{show(arms[:, at].max(), 'mm')}, those of 1.7 to 80 mm have {low:.2g} to {show(high, 'N*m', 3)}"
        )
        units = f"{option.format('', 'UNIT')}, where UNIT is one of {', '.join(QUANTITIES[measured.quantity])}"
        remedy = f"check its unit{', the lever' * (AT_LEVER in columns)} and the geometry: {units}"
        yield question(text, "range", field=measured.header, remedy=remedy)
    elif len(arms) > 1 and np.cov(torque, moments[1] - moments[0])[0, 1] < 0:
        text = "the torque falls with the pressure of muscle 2 and rises with that of muscle 1: a wrong sign?"
        remedy = f"turn it: {option.format('-', measured.unit)}; or exchange the pressures"
        yield question(text, "order", field=measured.header, remedy=remedy)


def add_muscle(columns: dict[str, Column], geometry: JointPaths | None) -> Iterator[Question]:
    r"""Add force and length of the only muscle under pressure to the columns of a test on a joint; yield questions.

    With the moment arm d and the length l of the geometry,

    .. math:: F = |\tau| / d(\theta), \qquad l = l(\theta)

    The muscle is 1 or 2, by its pressure's name or, as muscle 2 acts in the direction of the angle, by the torque.
    """
    if geometry is None:
        remedy = "give the geometry: geometry=mk.Scenario.read('joint.yaml').joint.geometry"
        yield question("is known by its name alone", field="joint", remedy=remedy)
        return
    low, high = geometry.angle_range
    angle, torque = columns["angle"], columns["torque"]
    if np.any((angle.values < low) | (angle.values > high)):
        text = f"is outside {show(low, 'deg')} to {show(high, 'deg')}, where the joint is defined"
        remedy = f"check its zero and sign: --column '{angle.header}=1*x+0 angle_{angle.unit}'"
        yield question(text, field=angle.header, remedy=remedy)
    names = [name for name in PRESSURES if name in columns]
    if len(names) > 1:
        first = columns[names[0]].header
        remedy = (
            "for the law of both: identify_torque (command line: --of torque); if one has no pressure, leave it out: "
            f"--column '{first}=ignore'"
        )
        yield question("is the pressure of one of two muscles", field=first, remedy=remedy)
        return
    (name,) = names
    pulls = np.max(torque.values) >= -np.min(torque.values)
    muscle = {"pressure1": 0, "pressure2": 1}.get(name, int(pulls))
    columns["pressure"] = replace(columns.pop(name), quantity="pressure")
    told = (f"of muscle {muscle + 1}, by the joint",)
    length, arm = (np.asarray(pair[muscle]) for pair in geometry.paths_and_arms(angle.values))
    yield from implausible_torque(columns, arm[None])
    force = (torque.values if muscle else -torque.values) / arm
    columns["force"] = Column(torque.header, "force", "N", force, torque.source, told)
    columns["length"] = Column(angle.header, "length", "mm", length, angle.source, told)
