"""What a joint is to be able to hold, and what of it may be chosen: in numbers, and as people write it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from mckibben.errors import ParameterError, UnitError
from mckibben.plant import JointPlant
from mckibben.units import deg, mm, parse_range

VARIED = {
    "connector_length": "what lies between a muscle and its anchors",
    "joint_radius": "at which the muscles' lower ends are fixed",
    "joint_length": "from the upper anchors to the axis",
    "muscle_length": "deflated, of both muscles",
    "muscle1_length": "deflated, of the antagonist",
    "muscle2_length": "deflated, of the agonist",
}
"""The lengths [m] that a design may vary, by name."""

_OVER = re.compile(r"(?:stiffness\s+)?(.+?)\s+over\s+(.+)", re.DOTALL)


@dataclass(frozen=True)
class Wanted:
    """A range of stiffness that is to be attainable all over a range of angle.

    Attributes
    ----------
    stiffness
        Lowest and highest [N*m/rad].
    angles
        First and last [rad].
    torque
        What the muscles are to give besides holding the load, either way, at each of these stiffnesses [N*m].
    """

    stiffness: tuple[float, float]
    angles: tuple[float, float]
    torque: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high) in (("stiffness", self.stiffness), ("angles", self.angles)):
            if not (np.isfinite(low) and np.isfinite(high) and low <= high):
                raise ParameterError(
                    f"{name} from {low:g} to {high:g}",
                    value=(low, high),
                    remedy="give two finite numbers, the lower first",
                )
        if max(map(abs, self.angles)) > 80 * deg:
            raise ParameterError(
                f"angles reach {max(map(abs, self.angles)) / deg:.4g} deg",
                lower=-80.0,
                upper=80.0,
                unit="deg",
                remedy="stay within -80..80 deg, where both muscles have an arm",
            )
        if not (np.isfinite(self.torque) and self.torque >= 0):
            raise ParameterError(
                f"the torque to spare is {self.torque:g} N*m", value=self.torque, remedy="give 0 or more"
            )

    def describe(self) -> str:
        """In words.

        >>> Wanted((12.0, 18.0), (-20 * deg, 20 * deg)).describe()
        'stiffness 12..18 N*m/rad over -20..20 deg'
        """
        (low, high), (first, last) = self.stiffness, self.angles
        spare = f", {self.torque:g} N*m to spare" if self.torque else ""
        return f"stiffness {low:g}..{high:g} N*m/rad over {first / deg:g}..{last / deg:g} deg{spare}"


def read_wanted(text: str, *, torque: float = 0.0) -> Wanted:
    """What is wanted, from text.

    Parameters
    ----------
    text
        Such as "stiffness 12..18 N*m/rad over -20..20 deg"; one stiffness, or one angle, is a range of no width.
    torque
        To spare [N*m].

    Raises
    ------
    ParameterError
        If it is written otherwise.
    UnitError
        If a range is no range of its kind.
    """
    found = _OVER.fullmatch(text.strip())
    if not found:
        raise ParameterError(
            f"{text!r} is nothing to design for",
            value=text,
            remedy="write it like 'stiffness 12..18 N*m/rad over -20..20 deg'",
        )
    try:
        return Wanted(parse_range(found[1], "N*m/rad"), parse_range(found[2], "rad"), torque)
    except UnitError as error:
        raise UnitError(f"{text!r}: {error}", value=text) from None


@dataclass(frozen=True)
class Choice:
    """A length that may be chosen.

    Attributes
    ----------
    name
        One of `VARIED`.
    lower, upper
        Within [m].
    """

    name: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if self.name not in VARIED:
            raise ParameterError(
                f"{self.name!r} cannot be varied in a design", value=self.name, remedy=f"known are {', '.join(VARIED)}"
            )
        if not 0 <= self.lower < self.upper < 10:
            raise ParameterError(
                f"{self.name} from {self.lower / mm:g} to {self.upper / mm:g} mm is no range of a length",
                value=(self.lower, self.upper),
                remedy="give two lengths, the shorter first",
            )


def read_choice(text: str) -> Choice:
    """A length and its range, from text such as "connector_length=150..260 mm".

    >>> read_choice("joint_radius=20..40 mm")
    Choice(name='joint_radius', lower=0.02, upper=0.04)

    Raises
    ------
    ParameterError
        If it is written otherwise, or there is no such length.
    UnitError
        If the range is none of lengths.
    """
    name, equals, said = (part.strip() for part in text.partition("="))
    if not equals or ".." not in said:
        raise ParameterError(
            f"{text!r} is no length and its range", value=text, remedy="write it like 'connector_length=150..260 mm'"
        )
    name = name.removeprefix("joint.").removeprefix("geometry.")
    try:
        lower, upper = parse_range(said, "m")
    except UnitError as error:
        raise UnitError(f"{text!r}: {error}", value=text) from None
    return Choice(name, lower, upper)


def nominal(plant: JointPlant, name: str) -> float:
    """What a length is [m]; of two muscles of unlike length the first."""
    if name in ("connector_length", "joint_radius", "joint_length"):
        return float(getattr(plant.joint.geometry, name))
    muscle = plant.joint.muscle2 if name == "muscle2_length" else plant.joint.muscle1
    return float(muscle.specimen.initial_length)


def put(plant: JointPlant, lengths: Mapping[str, ArrayLike]) -> JointPlant:
    """The plant with other lengths [m], which may be traced; a law is one of contraction and stays as it is."""
    for name, value in lengths.items():
        plant = eqx.tree_at(lambda p, name=name: _places(p, name), plant, [value] * len(_places(plant, name)))
    return plant


def _places(plant: JointPlant, name: str) -> list[object]:
    joint = plant.joint
    if name.startswith("muscle"):
        chosen = {"muscle1_length": [joint.muscle1], "muscle2_length": [joint.muscle2]}
        muscles = chosen.get(name, [joint.muscle1, joint.muscle2])
        return [muscle.specimen.initial_length for muscle in muscles]
    return [getattr(joint.geometry, name)]
