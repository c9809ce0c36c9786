"""Quantities as text, such as "stiffness at 5 deg, 2 bar, 4 bar"."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mckibben import catalog
from mckibben.errors import NotInCatalogError, ParameterError, UnitError
from mckibben.muscle import Domain, ForceLaw
from mckibben.study.planning.quantities import Coefficients, Force, JointStiffness, JointTorque, Quantity
from mckibben.units import bar, quantity

if TYPE_CHECKING:
    from mckibben.joint import AntagonisticJoint

_ANGLES = 5  # in a range of angles


def read_quantity(text: str, law_type: type[ForceLaw], joint: Callable[[], AntagonisticJoint]) -> Quantity:
    """A quantity from text.

    Parameters
    ----------
    text
        "coefficients", or names of them such as "decay" or "a1, a2"; "force", or "force at 0..10 %, 3..6 bar";
        "stiffness" or "torque", or either "at 5 deg, 3 bar" (in both muscles), "at -10..10 deg, 2 bar, 4 bar" (in
        muscle 1 and 2). Without a place a joint is at 0 deg and 3 bar.
    law_type
        Whose coefficients.
    joint
        Makes the joint, where one is needed.

    Raises
    ------
    ParameterError
        If the text is none of these.
    UnitError
        If what follows "at" is no quantity of its kind.

    Examples
    --------
    >>> from mckibben.muscle import ExponentialLaw
    >>> knee = lambda: catalog.joint("knee-table-2")
    >>> for words in ("decay", "force at 0..10 %, 3..6 bar", "stiffness at 5 deg, 2 bar, 4 bar"):
    ...     print(read_quantity(words, ExponentialLaw, knee))
    decay
    force at contraction 0..10 %, pressure 3..6 bar
    stiffness at 5 deg, 2 bar, 4 bar
    """
    kind, at, place = (part.strip() for part in text.partition(" at "))
    parts = [part.strip() for part in place.split(",")] if at else []
    if kind in ("stiffness", "torque"):
        made = JointStiffness if kind == "stiffness" else JointTorque
        if not parts:
            return made(joint())
        if len(parts) > 3:
            raise ParameterError(f"{text!r} has too many places", value=text, remedy="write 'at 5 deg, 2 bar, 4 bar'")
        try:
            low, high = span(parts[0], "rad")
            pressures = [quantity(part, "Pa") for part in parts[1:]] or [3 * bar]
        except UnitError as error:
            raise UnitError(f"{text!r} is an angle and pressures, but {error}", value=text) from None
        angle = low if low == high else tuple(np.linspace(low, high, _ANGLES).tolist())
        return made(joint(), angle, (pressures[0], pressures[-1]))
    if kind == "force":
        if not parts:
            return Force()
        if len(parts) != 2:
            raise ParameterError(f"{text!r} is no region", value=text, remedy="write 'force at 0..10 %, 3..6 bar'")
        try:
            return Force(Domain(*span(parts[0], "1"), *span(parts[1], "Pa")))
        except UnitError as error:
            raise UnitError(
                f"{text!r} is a range of contraction and one of pressure, but {error}", value=text
            ) from None
    known = {p.name.lower(): p.name for p in law_type.parameters()}
    names = [part.strip().lower() for part in text.split(",")]
    if text.strip() == "coefficients":
        return Coefficients()
    if not all(name in known for name in names):
        raise ParameterError(
            f"{text!r} is no quantity",
            value=text,
            remedy="give stiffness, torque, force, coefficients, or names of coefficients; "
            f"{law_type.__name__} has {', '.join(known.values())}",
        )
    return Coefficients(tuple(known[name] for name in names))


def span(text: str, unit: str) -> tuple[float, float]:
    """A range such as "0..10 %", or one value, which is both its ends; ascending, in the SI unit.

    >>> span("3..6 bar", "Pa"), span("-5 deg", "rad") == span("-5..-5 deg", "rad")
    ((300000.0, 600000.0), True)
    """
    first, dots, last = (part.strip() for part in text.partition(".."))
    if not dots:
        value = quantity(text, unit)
        return value, value
    end = quantity(last, unit)
    try:
        start = quantity(first, unit) if unit != "1" or first.endswith("%") else float("nan")
    except UnitError:
        start = float("nan")
    if start != start:  # the unit of the end does for both
        start = quantity(f"{first} {last.lstrip('+-.0123456789').lstrip('eE').strip()}", unit)
    return min(start, end), max(start, end)


def joint_named(name: str) -> AntagonisticJoint:
    """A joint of the catalog by its name, or that of a scenario file.

    Raises
    ------
    NotInCatalogError
        If it is neither.
    ScenarioError
        If the file is no scenario.
    """
    if Path(name).suffix in (".yaml", ".yml"):
        from mckibben.study.scenario import Scenario
        from mckibben.study.scenario.building import build_joint

        return build_joint(Scenario.read(name).joint)
    if name in catalog.names("joints"):
        return catalog.joint(name)
    raise NotInCatalogError(
        f"there is no joint {name!r}",
        value=name,
        remedy=f"give a scenario file (.yaml), or one of {', '.join(catalog.names('joints'))}",
    )
