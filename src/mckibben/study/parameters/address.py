"""The numbers of a scenario by the names of its file: ``load.mass2``, ``controller.position.kp``."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mckibben.errors import ParameterError
from mckibben.study.parameters.survey import Mark, Place, Survey, survey
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.part import LONGEST, quoted
from mckibben.study.scenario.quantity import Quantity
from mckibben.study.scenario.words import Whole
from mckibben.units import show

LISTING = "`mckibben sweep SCENARIO.yaml --list` shows all"
"""How a user sees what there is."""


@dataclass(frozen=True)
class Address:
    """One number of a scenario, and what it may be.

    Attributes
    ----------
    name
        As it is listed, such as "controller.position.kp".
    place
        All keys on the way to it in the file, such as ("controller", "position", "pid", "kp").
    mark
        The kind of field: it reads text, and knows units and range.
    nominal
        What it is in the scenario: a float in SI, or an int. None for a starting stiffness or a minimum tension that is
        not given.
    """

    name: str
    place: Place
    mark: Mark
    nominal: float | int | None

    @property
    def whole(self) -> bool:
        """Whether it is a whole number."""
        return isinstance(self.mark, Whole)

    @property
    def unit(self) -> str:
        """The SI unit; "1" for a plain number."""
        return self.mark.unit if isinstance(self.mark, Quantity) else "1"

    @property
    def shown(self) -> str:
        """The unit in which it is written."""
        return self.mark.shown if isinstance(self.mark, Quantity) else "1"

    @property
    def lower(self) -> float | int:
        """The lower end of what it may be, in SI; a length of 0 is not in its range, nor below."""
        return self.mark.limits[0] if isinstance(self.mark, Quantity) else self.mark.lower

    @property
    def upper(self) -> float | int:
        """The upper end, in SI."""
        return self.mark.limits[1] if isinstance(self.mark, Quantity) else self.mark.upper

    @property
    def range(self) -> str:
        """What it may be, in words."""
        return self.mark.range if isinstance(self.mark, Quantity) else f"{self.mark.lower} to {self.mark.upper}"

    def holds(self, value: Any) -> Any:
        """Whether a number in SI, or each of an array, is in the range."""
        if isinstance(self.mark, Quantity):
            return self.mark.holds(value)
        return (value >= self.mark.lower) & (value <= self.mark.upper) & (value % 1 == 0)

    def show(self, value: float | int, digits: int = 6) -> str:
        """A value in SI as people read it."""
        return f"{value:.0f}" if self.whole else show(float(value), self.shown, digits)

    def write(self, value: float | int) -> str:
        """Text that a scenario reads back to the last bit."""
        return self.mark.write(float(value)) if isinstance(self.mark, Quantity) else str(int(value))


def addresses(scenario: Scenario) -> list[Address]:
    """All numbers of a scenario that a study can vary, in the order of the file.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> for address in addresses(scenario)[:3]:
    ...     print(address.name, address.show(address.nominal), address.range, sep=", ")
    joint.geometry.joint_length, 370 mm, above 0 to 100000 mm
    joint.geometry.joint_radius, 30 mm, above 0 to 100000 mm
    joint.connector_length, 208 mm, 0 to 100000 mm
    """
    found = survey(scenario)
    return [Address(name, *found.numbers[name]) for name in found.numbers]


def find(scenario: Scenario, name: str) -> Address:
    """The number of a name, in any of its spellings.

    Parameters
    ----------
    scenario
        Which one.
    name
        Such as "load.mass2" or "load.m2"; the level `pid`, `backprop`, `sine`, ... may be left out.

    Raises
    ------
    ParameterError
        If there is none, or it is nothing that a study can vary; it says why.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find(scenario, "controller.position.pid.kp").name
    'controller.position.kp'
    >>> find(scenario, "load.mass3")
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: the scenario has no number 'load.mass3'; did you mean ...
    """
    return find_all(scenario, [name])[0]


def find_all(scenario: Scenario, names: Iterable[str]) -> list[Address]:
    """The numbers of several names, no two of which may be the same number.

    Raises
    ------
    ParameterError
        As for `find`, and if a number is named twice.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_all(scenario, ["load.m2", "load.mass2"])
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.m2' and 'load.mass2' are the same number; keep one of them
    """
    found = survey(scenario)
    spelt: dict[str, str] = {}
    several = []
    for name in names:
        address = _resolve(found, name)
        if address.name in spelt:
            both = f"{quoted(spelt[address.name])} and {quoted(name)} are the same number"
            raise ParameterError(both, value=name, remedy="keep one of them")
        spelt[address.name] = name
        several.append(address)
    return several


def _resolve(found: Survey, name: str) -> Address:
    spelling = name.strip()
    canonical = found.spellings.get(spelling)
    if canonical is not None:
        return Address(canonical, *found.numbers[canonical])
    keys = spelling.split(".")
    for depth in range(len(keys), 0, -1):
        reason = found.refused.get(".".join(keys[:depth]))
        if reason is not None:
            raise ParameterError(f"{quoted(spelling)} cannot be varied: {reason[0]}", value=name, remedy=reason[1])
    below = [known for known in found.numbers if known.startswith(f"{spelling}.")]
    if below and spelling:
        raise ParameterError(
            f"{quoted(spelling)} is a group of numbers", value=name, remedy=f"choose one, such as {below[0]}; {LISTING}"
        )
    close = _close(spelling, list(found.spellings))
    remedy = f"did you mean {' or '.join(map(repr, close))}? {LISTING}" if close else LISTING
    raise ParameterError(f"the scenario has no number {quoted(spelling)}", value=name, remedy=remedy)


def _close(name: str, known: list[str]) -> list[str]:
    """What a name may stand for: those that end with it, or one that is spelt like it."""
    ending = [each for each in known if each.endswith(f".{name}")]
    return ending[:2] if ending else difflib.get_close_matches(name[:LONGEST], known, 1, cutoff=0.6)
