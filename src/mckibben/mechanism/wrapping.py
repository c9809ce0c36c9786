"""Paths of muscles: through points of bodies, around spheres and cylinders on them, and over pulleys of a tackle.

As MuJoCo defines them: a path between two points lies on the surface between them where its straight line would pass
through it, or, with a `side`, on the other side of it. A surface acts once between two points, and as if it were
endless.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mckibben.component.checks import check_positive
from mckibben.errors import RangeError
from mckibben.joint.route import Bends
from mckibben.mechanism.bodies import BodyPoint, PathElement, Place
from mckibben.mechanism.tree import Frame, TreeHinge, ancestors, path_through
from mckibben.numerics.elementary import floating
from mckibben.numerics.spatial import ZERO, Rotation, Vector, X, Z, product, total, unit_vector
from mckibben.units import Distance, Quantity

Flat = tuple[Any, Any]
"""A point in the plane in which a path turns."""

_LEAST = 1e-30  # m^2, below the square of any length


class Wrapped(NamedTuple):
    """A path from one point to another by a surface.

    Attributes
    ----------
    length
        Its length [m].
    first, last
        Its derivatives by the places of both points: unit vectors.
    contacts
        Where it meets the surface, and where it leaves it, from the centre [m]; both points where it is straight.
    turn
        Angle [rad] about the surface; 0 where it is straight.
    """

    length: Any
    first: Vector
    last: Vector
    contacts: tuple[Vector, Vector]
    turn: Any


class WrapSphere(PathElement):
    """Sphere on a body, which a path touches between the points before and after it.

    Parameters
    ----------
    body
        Name of a body, or of a joint without one.
    radius
        Radius [m].
    place
        Its centre, from the hinge that carries the body.
    side
        Point of the same body outside the sphere, on the side on which the path always passes. Default: the path
        passes on the shorter side, and does not touch a sphere that it would not pass through.

    Examples
    --------
    A quarter of a circle of radius 30 mm, and 20 mm before and after it:

    >>> from mckibben.numerics.elementary import floating
    >>> from mckibben.numerics.spatial import IDENTITY
    >>> sphere = WrapSphere("shank", radius=0.03)
    >>> path = sphere.wrap(Vector(-0.02, 0.0, 0.03), Vector(0.03, 0.0, -0.02), IDENTITY)
    >>> round(float(path.length) - 0.04, 6), round(float(path.turn), 6)
    (0.047124, 1.570796)
    """

    short_name = "sphere"

    body: str = eqx.field(static=True)
    radius: Distance
    place: Place = Place()
    side: Place | None = None

    def __check_init__(self) -> None:
        super().__check_init__()
        check_positive(f"surface on {self.body}", "m", radius=self.radius)
        if self.side is not None:
            self._check_side(self._distance(self.side.vector - self.place.vector))

    @property
    def carrier(self) -> str:
        return self.body

    @property
    def label(self) -> str:
        return f"around {self.body}"

    def _check_side(self, distance: Any) -> None:
        if isinstance(distance, float) and isinstance(self.radius, float) and distance <= self.radius:
            message = f"surface on {self.body}: its side is inside it"
            remedy = "give a point outside; paths on the inside of a surface are points"
            raise RangeError(message, field="side", value=distance, lower=float(self.radius), unit="m", remedy=remedy)

    def _distance(self, point: Vector) -> float | None:
        """Distance [m] of a point from the centre; None for one that varies."""
        return math.hypot(*point) if all(isinstance(number, float) for number in point) else None

    def _plane(self, start: Vector, end: Vector, axes: Rotation) -> tuple[Vector, Vector]:
        """Axes of the plane in which the path turns."""
        del axes
        x = _unit(start)
        normal = x.cross(end)
        square = normal.dot(normal)
        on_line = square < _LEAST  # with the centre: any plane holds both points
        normal = _where(on_line, _where(abs(x.z) < 0.9, x.cross(Z), x.cross(X)), normal)
        return x, _unit(normal).cross(x)

    def wrap(self, start: Vector, end: Vector, axes: Rotation) -> Wrapped:
        """Return the path between two points, given from the centre [m]; the body has axes."""
        x, y = self._plane(start, end, axes)

        def flat(point: Vector) -> Flat:
            return point.dot(x), point.dot(y)

        side = None if self.side is None else flat(axes.apply(self.side.vector - self.place.vector))
        turn = _around_circle(flat(start), flat(end), side, self.radius)
        contacts = [x.scaled(u) + y.scaled(v) for u, v in turn.contacts]
        length = turn.near + turn.arc + turn.far
        rise, line = self._rise(axes), end - start
        if rise is not ZERO:
            low, high = start.dot(rise), end.dot(rise)
            places = low + (high - low) * turn.near / length, high - (high - low) * turn.far / length
            contacts = [contact + rise.scaled(place) for contact, place in zip(contacts, places, strict=True)]
            length = jnp.sqrt(length**2 + (high - low) ** 2)
        first, last = _where(turn.bent, contacts[0], end), _where(turn.bent, contacts[1], start)
        return Wrapped(
            jnp.where(turn.bent, length, jnp.sqrt(line.dot(line))),
            _unit(start - first),
            _unit(end - last),
            (first, last),
            jnp.where(turn.bent, turn.angle, 0.0),
        )

    def arc(self, path: Wrapped, axes: Rotation, count: int = 16) -> list[Vector]:
        """Return points of a path on the surface, from the centre [m]."""
        rise = self._rise(axes)
        low, high = (contact.dot(rise) for contact in path.contacts)
        across = path.contacts[0] - rise.scaled(low)
        ahead = -path.first + rise.scaled(path.first.dot(rise))
        ahead = ahead.scaled(self.radius / jnp.sqrt(ahead.dot(ahead)))
        steps = [(share, path.turn * share) for share in np.linspace(0, 1, count).tolist()]
        return [
            across.scaled(jnp.cos(angle)) + ahead.scaled(jnp.sin(angle)) + rise.scaled(low + (high - low) * share)
            for share, angle in steps
        ]

    def _rise(self, axes: Rotation) -> Vector:
        """Axis along which a path does not turn."""
        del axes
        return ZERO


class WrapCylinder(WrapSphere):
    """Endless cylinder on a body, which a path touches between the points before and after it: a bone, or a pulley.

    Parameters
    ----------
    body, radius, place
        As of a sphere; the place is any point of its axis.
    side
        Point of the same body outside the cylinder, on the side on which the path always passes.
    axis
        Direction of its axis, in the axes of the body.
    """

    short_name = "cylinder"

    axis: tuple[Annotated[float, Quantity("1", "1", -1, 1)], ...] = eqx.field(static=True, default=(0.0, 1.0, 0.0))

    def __check_init__(self) -> None:
        if len(self.axis) != 3 or not any(self.axis):
            remedy = "give a direction in space, such as [0, 1, 0]"
            message = f"surface on {self.body}: the axis is {', '.join(f'{number:g}' for number in self.axis)}"
            raise RangeError(message, field="axis", value=self.axis, remedy=remedy)
        super().__check_init__()

    def _distance(self, point: Vector) -> float | None:
        z = unit_vector(self.axis)
        return super()._distance(point - z.scaled(point.dot(z)))

    def _plane(self, start: Vector, end: Vector, axes: Rotation) -> tuple[Vector, Vector]:
        z = unit_vector(self.axis)
        x = unit_vector(z.cross(Z if abs(z.z) < 0.9 else X))
        return axes.apply(x), axes.apply(z.cross(x))

    def _rise(self, axes: Rotation) -> Vector:
        return axes.apply(unit_vector(self.axis))


class TendonPulley(PathElement):
    """Pulley of a tackle: a new branch of the path begins, the length of which counts divided.

    Parameters
    ----------
    divisor
        Number of ropes that share the force. It counts up to the next pulley.
    """

    short_name = "pulley"

    divisor: Annotated[float, Quantity("1", "1", 0.1, 100)]

    @property
    def label(self) -> str:
        return f"pulley of {float(self.divisor):g}"


class _Turn(NamedTuple):
    """Path about a circle: whether it touches it, its parts [m], its contacts, and the angle [rad] between these."""

    bent: Array
    near: Array
    arc: Array
    far: Array
    contacts: tuple[Flat, Flat]
    angle: Array


def _where(condition: Array, yes: Vector, no: Vector) -> Vector:
    return Vector(*(jnp.where(condition, *pair) for pair in zip(yes, no, strict=True)))


def _unit(vector: Vector) -> Vector:
    return vector.scaled(1 / jnp.sqrt(jnp.maximum(vector.dot(vector), _LEAST)))


def _dot(a: Flat, b: Flat) -> Any:
    return a[0] * b[0] + a[1] * b[1]


def _cross(a: Flat, b: Flat) -> Any:
    return a[0] * b[1] - a[1] * b[0]


def _minus(a: Flat, b: Flat) -> Flat:
    return a[0] - b[0], a[1] - b[1]


def _around_circle(start: Flat, end: Flat, side: Flat | None, radius: Any) -> _Turn:
    """Return the path from start to end about a circle with its centre at 0."""
    line = _minus(end, start)
    square = radius * radius
    share = jnp.clip(-_dot(start, line) / jnp.maximum(_dot(line, line), _LEAST), 0.0, 1.0)
    nearest = start[0] + share * line[0], start[1] + share * line[1]
    bent = _dot(nearest, nearest) <= square
    way = jnp.where(_cross(start, end) < 0, 1.0, -1.0)
    behind = jnp.zeros_like(bent)  # whether the line passes the centre on the other side
    if side is not None:
        behind = (way * _cross(start, side) > 0) & (way * _cross(side, end) > 0)
        bent, way = bent | behind, jnp.where(behind, -way, way)
    first, last = _tangents(start, end, radius, way)
    angle = -way * jnp.arctan2(_cross(first, last), _dot(first, last))
    angle = jnp.where(behind & (angle < 0), angle + 2 * math.pi, angle)
    bent &= (_dot(start, start) > square) & (_dot(end, end) > square)
    return _Turn(bent, _straight(start, radius), radius * angle, _straight(end, radius), (first, last), angle)


def _straight(point: Flat, radius: Any) -> Array:
    """Length of the line from a point to where it touches a circle."""
    return jnp.sqrt(jnp.maximum(_dot(point, point) - radius * radius, _LEAST))


def _tangents(start: Flat, end: Flat, radius: Any, way: Any) -> tuple[Flat, Flat]:
    """Points that lines from start and end touch on the way about a circle: 1 clockwise, -1 against it."""

    def touched(point: Flat, way: Any) -> Flat:
        (x, y), across, distance = point, way * radius * _straight(point, radius), _dot(point, point)
        return (radius * radius * x + across * y) / distance, (radius * radius * y - across * x) / distance

    return touched(start, way), touched(end, -way)


def branches(elements: Sequence[PathElement]) -> Iterator[tuple[Any, tuple[PathElement, ...]]]:
    """Yield the branches of a path between its pulleys, each with its divisor."""
    divisor: Any = 1.0
    begun: list[PathElement] = []
    for element in elements:
        if not isinstance(element, TendonPulley):
            begun.append(element)
            continue
        if begun:
            yield divisor, tuple(begun)
        divisor, begun = element.divisor, []
    yield divisor, tuple(begun)


def check_path(owner: str, elements: Sequence[PathElement]) -> None:
    """Raise `RangeError` for a path that is on one body, and for branches that do not go from point to point."""
    field = "through"
    for _, branch in branches(elements):
        points = [isinstance(element, BodyPoint) for element in branch]
        if len(branch) < 2 or not (points[0] and points[-1]):
            message, remedy = f"{owner}: a branch of its path has no end", "give points as its first and its last part"
            raise RangeError(message, field=field, remedy=remedy)
        if not all(first or second for first, second in pairwise(points)):
            message, remedy = f"{owner}: two surfaces follow each other", "give a point between them"
            raise RangeError(message, field=field, remedy=remedy)
    bodies = [element.carrier for element in elements if element.carrier is not None]
    if len(set(bodies)) == 1:
        message, remedy = f"{owner}: it passes through {', '.join(bodies)} alone", "give points on two bodies or more"
        raise RangeError(message, field=field, value=bodies, remedy=remedy)


def path_along(
    elements: Sequence[PathElement], names: Sequence[str], hinges: Sequence[TreeHinge], frames: Sequence[Frame]
) -> tuple[Any, dict[int, Any], Callable[[], Bends]]:
    """Return the length [m] of a path, and its derivatives [m/rad] by hinge.

    A hinge has the number of its body, which has a name. The function computes the second derivatives.
    """
    found = list(_parts(elements, names, hinges, frames))
    length: Any = 0.0
    slopes: dict[int, Any] = {}
    for divisor, (own, by_hinge, _) in found:
        length = total(length, product(1 / divisor, own))
        for index, slope in by_hinge.items():
            slopes[index] = total(slopes.get(index, 0.0), product(1 / divisor, slope))

    def bends() -> Bends:
        made: Bends = {}
        for divisor, (_, _, second) in found:
            for pair, bend in second().items():
                made[pair] = total(made.get(pair, 0.0), product(1 / divisor, bend))
        return made

    return length, slopes, bends


def _parts(
    elements: Sequence[PathElement], names: Sequence[str], hinges: Sequence[TreeHinge], frames: Sequence[Frame]
) -> Iterator[tuple[Any, tuple[Any, dict[int, Any], Callable[[], Bends]]]]:
    """Yield the straight lines and the parts by surfaces of a path, each with its divisor."""
    for divisor, branch in branches(elements):
        line: list[tuple[int, Vector]] = []
        surface: WrapSphere | None = None
        for element in branch:
            if isinstance(element, WrapSphere):
                surface = element
                continue
            assert isinstance(element, BodyPoint)
            point = names.index(element.body), element.place.vector
            if surface is not None:
                yield divisor, _by_surface(surface, names.index(surface.body), (line[-1], point), hinges, frames)
                if len(line) > 1:
                    yield divisor, path_through(line, hinges, frames)
                line, surface = [], None
            line.append(point)
        if len(line) > 1:
            yield divisor, path_through(line, hinges, frames)


def _by_surface(
    surface: WrapSphere,
    body: int,
    ends: Sequence[tuple[int, Vector]],
    hinges: Sequence[TreeHinge],
    frames: Sequence[Frame],
) -> tuple[Any, dict[int, Any], Callable[[], Bends]]:
    """Return the length [m] between two points by a surface, its derivatives by hinge, and the second ones."""
    frame = frames[body]
    centre = frame.point(surface.place.vector)[0]
    start, end = (frames[other].point(place)[0] - centre for other, place in ends)
    path = surface.wrap(start, end, frame.axes)
    moves: dict[int, list[Vector | None]] = {}  # of both ends against the body of the surface, by hinge
    slopes: dict[int, Any] = {}
    bent: list[tuple[int, int, int, Vector]] = []
    for which, ((other, _), point, along) in enumerate(zip(ends, (start, end), (path.first, path.last), strict=True)):
        chain = _between(hinges, body, other)
        for place, (index, sign) in enumerate(chain):
            move = frames[index].axis.cross(point + centre - frames[index].position).scaled(sign)
            moves.setdefault(index, [None, None])[which] = move
            slopes[index] = total(slopes.get(index, 0.0), along.dot(move))
            bent += [
                (nearer, index, which, frames[nearer].axis.cross(move).scaled(way))
                for nearer, way in chain[: place + 1]
            ]

    def bends() -> Bends:
        made: Bends = {}
        for first, second, which, change in bent:
            pair = min(first, second), max(first, second)
            made[pair] = total(made.get(pair, 0.0), (path.first, path.last)[which].dot(change))
        for second, (at_start, at_end) in moves.items():
            turned = _turning(surface, (start, end), (at_start, at_end), frame.axes)
            for first, others in moves.items():
                if first <= second:
                    for change, move in zip(turned, others, strict=True):
                        if move is not None:
                            made[first, second] = total(made.get((first, second), 0.0), change.dot(move))
        return made

    return path.length, slopes, bends


def _between(hinges: Sequence[TreeHinge], body: int, other: int) -> list[tuple[int, int]]:
    """Hinges from one body to another, and 1 where they move the other, -1 where they move the one."""
    before, after = ancestors(hinges, body), ancestors(hinges, other)
    own = [(index, -1) for index in before if index not in after]
    return own + [(index, 1) for index in reversed(after) if index not in before]


def _turning(
    surface: WrapSphere, ends: tuple[Vector, Vector], moves: Sequence[Vector | None], axes: Rotation
) -> tuple[Vector, Vector]:
    """Change of the directions of a path at its ends, as these move."""
    rates = tuple(ZERO if move is None else move for move in moves)
    numbers = jax.tree.map(floating, (ends, rates))
    shape = jnp.broadcast_shapes(*(number.shape for number in jax.tree.leaves(numbers)))
    places, rates = jax.tree.map(lambda number: jnp.broadcast_to(number, shape), numbers)
    return jax.jvp(lambda start, end: surface.wrap(start, end, axes)[1:3], places, rates)[1]
