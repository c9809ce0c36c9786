"""Geometry of a slide: muscles that act along its axis."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import ArrayLike

from mckibben.errors import RangeError
from mckibben.joint.geometry import Geometry, Pair
from mckibben.muscle import Domain, Muscle
from mckibben.numerics.elementary import floating
from mckibben.units import SLIDE, Length, mm

POSSIBLE = Domain(-0.5, 0.8)
"""Contractions of any muscle."""
_ABSENT = 1.0  # m, of what is not there


class Slide(Geometry):
    """Two muscles along the axis of a slide, whose coordinate is a position [m] in place of an angle [rad].

    The lengths change as the position, so that the moment arms are 1, and a torque [N*m] is a force [N].

    Parameters
    ----------
    rest_length1, rest_length2
        Length [m] at position 0 of muscle 1, which lengthens as the position grows, and of muscle 2, which shortens;
        None for no muscle.

    Examples
    --------
    >>> slide = Slide(rest_length1="150 mm", rest_length2="165 mm")
    >>> [round(float(length), 6) for length in (*slide.path_lengths(0.01), *slide.moment_arms(0.01))]
    [0.16, 0.155, 1.0, 1.0]
    """

    short_name = "slide"
    joint_type = SLIDE

    rest_length1: Length | None = None
    rest_length2: Length | None = None

    @property
    def _rest_lengths(self) -> tuple[float, float]:
        first, second = self.rest_length1, self.rest_length2
        return _ABSENT if first is None else first, _ABSENT if second is None else second

    def check_muscles(self, muscles: tuple[Muscle, Muscle]) -> None:
        lengths = zip((1, 2), (self.rest_length1, self.rest_length2), muscles, strict=True)
        for number, length, muscle in lengths:
            if length is None and muscle.law.pulls:
                name = f"rest_length{number}"
                remedy = f"give the length of muscle {number} at position 0, or `muscle{number}: none`"
                raise RangeError(f"Slide: {name} is missing", field=f"geometry.{name}", remedy=remedy)

    def span(self, muscles: tuple[Muscle, Muscle]) -> tuple[float, float]:
        """Return the positions [m] between which a muscle is within its domain, in whole millimetres."""
        positions = []
        for sign, rest, muscle in zip((1, -1), self._rest_lengths, muscles, strict=True):
            if not muscle.law.is_passive:
                domain = muscle.domain.intersection(POSSIBLE)
                ends = muscle.specimen.length_at(jnp.stack([domain.contraction_min, domain.contraction_max]))
                positions += [sign * (float(end) - float(rest)) for end in ends]
        return math.floor(min(positions) / mm) * mm, math.ceil(max(positions) / mm) * mm

    def path_lengths(self, angle: ArrayLike) -> Pair:
        position, (first, second) = floating(angle), self._rest_lengths
        return first + position, second - position

    def remedy(self, number: int, *, longer: bool) -> str:
        return f"a {'longer' if longer else 'shorter'} rest_length{number}"
