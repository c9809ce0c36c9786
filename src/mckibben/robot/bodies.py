"""Bodies of a robot: trunk and links, with their masses and inertias."""

from __future__ import annotations

from numbers import Real
from typing import Any, Literal

import equinox as eqx

from mckibben.component.base import Component
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError
from mckibben.units import Distance, Inertia, Mass, PositiveMass

Freedom = Literal["fixed", "vertical", "planar", "free", "spatial", "floating"]
"""Motion of the trunk: none, up and down (a slider), in the plane without pitch (a boom) or with it, in space without
rotation (a gantry), or unconstrained."""

_MOTIONS = {
    "fixed": (),
    "vertical": ("z",),
    "planar": ("x", "z"),
    "free": ("x", "z", "pitch"),
    "spatial": ("x", "y", "z"),
    "floating": ("x", "y", "z", "yaw", "pitch", "roll"),
}
"""Coordinates of the trunk for each freedom: translations, then rotations, each in the axes after those before it."""


class Trunk(Component):
    """Body above the hip.

    Parameters
    ----------
    mass, inertia
        Mass [kg], and inertia about the centre of mass [kg*m^2], which matters only for a trunk that turns; that of
        the pitch.
    centre
        Height of the centre of mass above the hip [m].
    freedom
        "fixed", "vertical" (on a slider), "planar" (a boom: no pitch), "free" (in the plane), "spatial" (a gantry: no
        rotation), or "floating" (in space). A floating trunk must not pitch by 90 deg, where yaw and roll coincide.
    roll_inertia, yaw_inertia
        Inertia about the forward and the upward axis [kg*m^2]. Default: `inertia`.
    """

    mass: PositiveMass
    inertia: Inertia = 0.0
    centre: Distance = 0.0
    freedom: Freedom = eqx.field(static=True, default="vertical")
    roll_inertia: Inertia | None = None
    yaw_inertia: Inertia | None = None

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.freedom in ("free", "floating"):
            check_positive("Trunk", "kg*m^2", inertia=self.inertia)
        if self.freedom == "floating":
            check_positive("Trunk", "kg*m^2", roll_inertia=self.roll_inertia, yaw_inertia=self.yaw_inertia)
            _check_inertias("Trunk", "inertia", self.inertias)

    @property
    def motions(self) -> tuple[str, ...]:
        """Coordinates of its freedom: translations, then rotations."""
        return _MOTIONS[self.freedom]

    @property
    def inertias(self) -> tuple[Any, Any, Any]:
        """Principal inertias about the forward, the left and the upward axis [kg*m^2]."""
        roll, yaw = (self.inertia if one is None else one for one in (self.roll_inertia, self.yaw_inertia))
        return roll, self.inertia, yaw


class Link(Component):
    """Rigid link between two joints, or of the foot.

    Parameters
    ----------
    length
        From its upper joint to the next one, or to the foot's point [m]; 0 if the axes of both joints intersect.
    mass, inertia
        Mass [kg], and inertia about the two axes across the link through its centre of mass [kg*m^2]. Both may be 0
        in a link above another one.
    centre
        Distance of the centre of mass from the upper joint, along the link [m].
    axial_inertia
        Inertia about the link's own line [kg*m^2]. Default: that of a slender rod.
    """

    length: Distance
    mass: Mass
    centre: Distance
    inertia: Inertia
    axial_inertia: Inertia = 0.0

    def __check_init__(self) -> None:
        super().__check_init__()
        if all(isinstance(one, Real) for one in (self.mass, self.centre, self.inertia)) and self.mass > 0:
            check_positive("Link", "kg*m^2", inertia_about_joint=self.inertia_about_joint)
        _check_inertias("Link", "axial_inertia", self.inertias)

    @property
    def inertia_about_joint(self) -> Any:
        """Inertia about an axis across the link through its upper joint [kg*m^2]."""
        return self.inertia + self.mass * self.centre**2

    @property
    def inertias(self) -> tuple[Any, Any, Any]:
        """Principal inertias about the centre of mass [kg*m^2], the axial one last."""
        return self.inertia, self.inertia, self.axial_inertia


def _check_inertias(owner: str, field: str, inertias: tuple[Any, Any, Any]) -> None:
    """Raise `RangeError` if a principal inertia is above the sum of the others, as in no body."""
    if not all(isinstance(one, Real) for one in inertias):
        return
    *others, largest = sorted(float(one) for one in inertias)
    if largest > sum(others) * (1 + 1e-9):
        raise RangeError(
            f"{owner}: a principal inertia of {largest:g} kg*m^2 is above the sum of the others",
            field=field,
            value=largest,
            upper=sum(others),
            unit="kg*m^2",
            remedy="give inertias about the centre of mass of which none is above the sum of the other two",
        )
