"""Rigid bodies, points on them, and the hinges between them."""

from __future__ import annotations

from numbers import Real
from typing import Annotated, Any, Literal

import equinox as eqx
import numpy as np

from mckibben.component.base import Component
from mckibben.component.checks import check_positive, check_within
from mckibben.config.model import fail_validation
from mckibben.errors import RangeError
from mckibben.mechanism.disturbance import Disturbance, NoDisturbance
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.numerics.spatial import Tensor, Vector, difference, product, total, unit_vector
from mckibben.units import Angle, Coordinate, Damping, Distance, Inertia, Mass, Quantity, StiffnessScale, deg

Freedom = Literal["fixed", "vertical", "planar", "free", "spatial", "floating"]
"""Motion of the base: none, up and down (a slider), in the plane without pitch (a boom) or with it, in space without
rotation (a gantry), or unconstrained."""

MOTIONS = {
    "fixed": (),
    "vertical": ("z",),
    "planar": ("x", "z"),
    "free": ("x", "z", "pitch"),
    "spatial": ("x", "y", "z"),
    "floating": ("x", "y", "z", "yaw", "pitch", "roll"),
}
"""Coordinates of the base for each freedom: translations, then rotations, each in the axes after those before it."""

Direction = Annotated[float, Quantity("1", "1", -1, 1)]
GravityRatio = Annotated[float, Quantity("1", "1", -100, 100)]
Product = Annotated[float, Quantity("kg*m^2", "kg*m^2", -1e4, 1e4)]
StopDamping = Annotated[float, Quantity("s/rad", "s/rad", 0, 1e3)]


def _unless_zero(number: object) -> object:
    return None if isinstance(number, int | float) and number == 0 else number


class Place(Component):
    """Point of a body in its axes [m]; in files a list of three coordinates.

    A coordinate of 0 is None: compiled programs leave it out, and it cannot vary.

    >>> Place(0.1, 0.0, -0.4).vector
    Vector(x=0.1, y=0.0, z=-0.4)
    """

    x: Coordinate | None = eqx.field(default=None, converter=_unless_zero)
    y: Coordinate | None = eqx.field(default=None, converter=_unless_zero)
    z: Coordinate | None = eqx.field(default=None, converter=_unless_zero)

    @classmethod
    def from_file(cls, value: object) -> object:
        """Return a list of three coordinates as a section."""
        if not isinstance(value, list | tuple):
            return value
        if len(value) != 3:
            fail_validation(f"a point with {len(value)} coordinates", "give three: forwards, to the left and up")
        return dict(zip("xyz", value, strict=True))

    @classmethod
    def to_file(cls, section: dict[str, object]) -> list[object]:
        """Return a section as a list of three coordinates."""
        return [section.get(name, "0 mm") for name in "xyz"]

    @property
    def vector(self) -> Vector:
        """The coordinates."""
        return Vector(*(0.0 if number is None else number for number in (self.x, self.y, self.z)))


class Body(Component):
    """Rigid body. Its axes are those of the base where all angles and offsets are 0.

    Parameters
    ----------
    name
        Name in joints, points and errors.
    mass
        Mass [kg].
    centre
        Centre of mass, from the hinge that carries the body.
    inertia
        About the centre of mass [kg*m^2], in the axes of the body: two numbers, across its z axis and about it, of a
        body that is symmetric about that; three principal ones (xx, yy, zz); or six (xx, yy, zz, xy, xz, yz).
    """

    name: str = eqx.field(static=True)
    mass: Mass
    centre: Place = Place()
    inertia: tuple[Product, ...] = (0.0, 0.0)

    def __check_init__(self) -> None:
        super().__check_init__()
        if len(self.inertia) not in (2, 3, 6):
            remedy = "give two, across the z axis and about it, three, or six"
            message = f"{self.name}: {len(self.inertia)} moments of inertia"
            raise RangeError(message, field="inertia", value=self.inertia, remedy=remedy)
        if not all(isinstance(number, Real) for number in self.inertia):
            return
        xx, xy, xz, yy, yz, zz = map(float, self.tensor)
        least, middle, largest = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).tolist()
        if least < -1e-12 * largest or largest > (least + middle) * (1 + 1e-6):
            shown = f"{least:.4g}, {middle:.4g}, {largest:.4g} kg*m^2"
            message = f"{self.name}: no body has principal inertias of {shown}"
            remedy = "give positive ones about the centre of mass, none above the sum of the other two"
            raise RangeError(
                message, field="inertia", value=largest, upper=least + middle, unit="kg*m^2", remedy=remedy
            )

    @property
    def tensor(self) -> Tensor:
        """Inertia about the centre of mass [kg*m^2]."""
        if len(self.inertia) == 2:
            across, along = self.inertia
            return Tensor(across, 0.0, 0.0, across, 0.0, along)
        xx, yy, zz, xy, xz, yz = (*self.inertia, 0.0, 0.0, 0.0)[:6]
        return Tensor(xx, xy, xz, yy, yz, zz)

    def inertia_about(self, axis: Vector, point: Vector) -> Any:
        """Return the inertia [kg*m^2] about an axis through a point of the body."""
        moved = axis.cross(self.centre.vector - point)
        return total(axis.dot(self.tensor.apply(axis)), product(self.mass, moved.dot(moved)))


class Joint(Component):
    """Hinge between a body and the one that carries it.

    Parameters
    ----------
    name
        Name in results and errors.
    axis
        Direction about which the body turns as the angle increases (right-hand rule), in the axes of the body above.
    lower, upper
        Range of the angle [rad]; beyond it stops act.
    body
        Name of the body on it. Default: none, as in a universal joint, whose next joint has this one as `parent`.
    parent
        Name of the body that carries it, or of a joint without a body. Default: what the joint before it carries, for
        the first one the base.
    place
        Point of the body above. Default: its origin.
    offset
        Angle [rad] of the body from the axes of the one above where the angle of the joint is 0.
    damping
        Viscous damping [N*m*s/rad].
    stop_stiffness, stop_damping
        Stops: k [N*m/rad] and c [s/rad] in the torque k d (1 + c d') at a depth d [rad], never pulling.
    locked
        Angle [rad] at which the joint is locked. Default: movable.
    rotor_inertia
        Inertia that turns with the joint alone [kg*m^2]. Default: none.
    friction
        Friction of the joint itself. Default: none.
    spring, spring_angle
        Spring in parallel with the joint [N*m/rad], and the angle [rad] at which it is unloaded. It is a load, as
        gravity is: not in the stiffness of the muscles. Default: none.
    disturbance
        External torque on the joint over time.
    """

    name: str = eqx.field(static=True)
    axis: tuple[Direction, ...] = eqx.field(static=True)
    lower: Angle
    upper: Angle
    body: str | None = eqx.field(static=True, default=None)
    parent: str | None = eqx.field(static=True, default=None)
    place: Place = Place()
    offset: Angle = 0.0
    damping: Damping = 0.0
    stop_stiffness: StiffnessScale = 1000.0
    stop_damping: StopDamping = 0.2
    locked: Angle | None = None
    rotor_inertia: Inertia | None = None
    friction: JointFriction | None = None
    spring: StiffnessScale | None = None
    spring_angle: Angle = 0.0
    disturbance: Disturbance = NoDisturbance()

    def __check_init__(self) -> None:
        super().__check_init__()
        if len(self.axis) != 3 or not any(self.axis):
            remedy = "give a direction in space, such as [0, 1, 0]"
            message = f"{self.name}: the axis is {', '.join(f'{number:g}' for number in self.axis)}"
            raise RangeError(message, field="axis", value=self.axis, remedy=remedy)
        if not all(isinstance(one, Real) for one in (self.lower, self.upper)):
            return
        if not self.lower < self.upper:
            message = f"{self.name}: the range of the angle is {self.lower / deg:g}..{self.upper / deg:g} deg"
            remedy = "give the lower angle first"
            raise RangeError(message, field="upper", value=self.upper, lower=self.lower, unit="rad", remedy=remedy)
        ends, locked = (self.lower / deg, self.upper / deg), None if self.locked is None else self.locked / deg
        check_within(self.name, *ends, "deg", remedy="lock it within its range", locked=locked)

    @property
    def direction(self) -> Vector:
        """The axis as a unit vector."""
        return unit_vector(self.axis)

    def spring_torque(self, angle: Any) -> Any:
        """Return the torque [N*m] that holds the spring at an angle [rad]."""
        return 0.0 if self.spring is None else product(self.spring, difference(angle, self.spring_angle))


class PathElement(Component):
    """Part of the path of a muscle: a point, a surface that it may touch, or a pulley."""

    @property
    def carrier(self) -> str | None:
        """Name of the body that it is on; None for a pulley of a tackle."""
        return None

    @property
    def label(self) -> str:
        """What it is, in tables."""
        return self.carrier or ""

    @classmethod
    def from_file(cls, value: object) -> object:
        """Return a section with its class: a cylinder has an axis, a sphere a radius, a pulley a divisor."""
        if cls is not PathElement or not isinstance(value, dict) or "class" in value:
            return value
        marks = {"axis": "cylinder", "radius": "sphere", "divisor": "pulley"}
        return {"class": next((kind for mark, kind in marks.items() if mark in value), "point"), **value}

    @classmethod
    def to_file(cls, section: dict[str, object]) -> dict[str, object]:
        """Return a section without its class."""
        return {name: field for name, field in section.items() if name != "class"}


class BodyPoint(PathElement):
    """Point of a body.

    Parameters
    ----------
    body
        Name of a body, or of a joint without one.
    place
        From the hinge that carries the body.
    """

    short_name = "point"

    body: str = eqx.field(static=True)
    place: Place = Place()

    @property
    def carrier(self) -> str:
        return self.body


class Foot(Component):
    """Sphere that touches the ground.

    Parameters
    ----------
    body, place
        Its centre, as of a `Point`.
    radius
        Radius [m].
    """

    body: str = eqx.field(static=True)
    place: Place = Place()
    radius: Distance = 0.0


def check_base(base: Body, freedom: Freedom) -> None:
    """Raise `RangeError` for a base that turns without inertia, or moves without mass."""
    motions = MOTIONS[freedom]
    if motions:
        check_positive(base.name, "kg", mass=base.mass)
    turns = {"pitch": base.tensor.yy, "roll": base.tensor.xx, "yaw": base.tensor.zz}
    check_positive(base.name, "kg*m^2", **{f"{name}_inertia": turns[name] for name in motions if name in turns})
