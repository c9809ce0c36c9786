"""Tests on a joint: torques at angles as forces and lengths of the muscle that is under pressure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from mckibben.dataset.table import Column, Question, question
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


def needed_at_joint(columns: dict[str, Column], lever: float | None) -> tuple[str, ...]:
    """Quantities that a test on a joint needs; a force at a lever arm [m] becomes a torque."""
    if lever is not None and "force" in columns:
        force = columns.pop("force")
        remarks = (*force.remarks, f"at an arm of {show(lever, 'mm')}")
        columns["torque"] = replace(force, quantity="torque", values=lever * force.values, remarks=remarks)
    measured = "force" if lever is not None and "torque" not in columns else "torque"
    return ("angle", measured) if any(name in columns for name in PRESSURES) else ("angle", measured, "pressure")


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
    force = (torque.values if muscle else -torque.values) / arm
    columns["force"] = Column(torque.header, "force", "N", force, torque.source, told)
    columns["length"] = Column(angle.header, "length", "mm", length, angle.source, told)
