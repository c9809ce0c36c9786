"""Paths of single muscles over the joint angle (pulley, cam, two bones, table), and a geometry of two paths."""

from __future__ import annotations

import abc
import math
import warnings
from collections.abc import Sequence
from numbers import Real
from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray

from mckibben.component.base import Component
from mckibben.component.checks import check_positive
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.joint.geometry import Ends, Geometry, Pair
from mckibben.numerics.calculus import derivative
from mckibben.numerics.elementary import floating, sincos
from mckibben.units import Angle, Coordinate, Distance, Length, MomentArm, Quantity, deg, mm

ArmSlope = Annotated[float, Quantity("m/rad", "mm/rad", -1e4, 1e4)]
ArmCurvature = Annotated[float, Quantity("m/rad^2", "mm/rad^2", -1e4, 1e4)]

_Side = int
"""1 for muscle 1, which lengthens as the angle increases, -1 for muscle 2."""
_LARGEST_DEGREE = 8
_SPARE = 2  # points of a table in excess of the coefficients
_ROUGH = 0.05  # error of a table, relative to the range of its lengths or to its largest arm


class MusclePath(Component):
    """Length of a muscle, with the elements in series, over the joint angle."""

    adjusted_by: ClassVar[tuple[str, bool]] = ("", True)
    """Field with which the length grows (True) or falls (False), for remedies; empty if there is none."""

    @abc.abstractmethod
    def length(self, angle: ArrayLike, side: _Side) -> Float[Array, "..."]:
        """Return the length [m] at an angle [rad] of muscle 1 (`side` 1) or 2 (-1)."""

    def anchors(self, angle: ArrayLike) -> Ends | None:
        """Return the ends of a straight path with its connectors; None if it is not straight."""
        return None

    @property
    def angle_range(self) -> tuple[float, float]:
        """Range of angles [rad] for which the path is defined."""
        return -math.inf, math.inf


class Pulley(MusclePath):
    """Muscle on a pulley, with a constant moment arm.

    Parameters
    ----------
    radius, rest_length
        Moment arm [m], and length of the muscle at angle 0 [m].

    Muscle 1 lengthens, and muscle 2 shortens:

    >>> pulley = Pulley(radius=0.03, rest_length=0.16)
    >>> [round(float(pulley.length(0.5, side)), 3) for side in (1, -1)]
    [0.175, 0.145]
    """

    short_name = "pulley"
    adjusted_by = ("rest_length", True)

    radius: MomentArm
    rest_length: Length

    def length(self, angle: ArrayLike, side: _Side) -> Float[Array, "..."]:
        return self.rest_length + side * self.radius * floating(angle)


class Cam(MusclePath):
    """Muscle on a cam, with a moment arm that is quadratic in the angle.

    Parameters
    ----------
    arm, arm_slope, arm_curvature
        Moment arm at the angle 0 [m], and its derivatives with respect to the angle [m/rad], [m/rad^2].
    rest_length
        Length of the muscle at the angle 0 [m].
    """

    short_name = "cam"
    adjusted_by = ("rest_length", True)

    arm: MomentArm
    rest_length: Length
    arm_slope: ArmSlope = 0.0
    arm_curvature: ArmCurvature = 0.0

    def length(self, angle: ArrayLike, side: _Side) -> Float[Array, "..."]:
        x = floating(angle)
        return self.rest_length + side * x * (self.arm + x * (self.arm_slope / 2 + x * (self.arm_curvature / 6)))


class TwoBonePath(MusclePath):
    """Straight muscle between an anchor on the fixed bone and one on the moving bone, which turns about a hinge.

    Coordinates have their origin at the hinge; the distal anchor is given at angle 0, and the angle turns from x to y.

    Parameters
    ----------
    proximal_x, proximal_y, distal_x, distal_y
        Anchors on the fixed and on the moving bone [m].
    connector_length
        Length of the connectors in series with the muscle [m].

    Raises `RangeError` if the anchors come so close that no muscle fits between them.

    >>> path = TwoBonePath(proximal_x=0.03, proximal_y=0.16, distal_x=0.03, distal_y=0.0)
    >>> round(float(path.length(0.0, -1)), 6)
    0.16
    """

    short_name = "two_bone"
    adjusted_by = ("connector_length", False)

    proximal_x: Coordinate
    proximal_y: Coordinate
    distal_x: Coordinate
    distal_y: Coordinate
    connector_length: Distance = 0.0

    def __check_init__(self) -> None:
        super().__check_init__()
        values = (self.proximal_x, self.proximal_y, self.distal_x, self.distal_y, self.connector_length)
        if all(isinstance(value, Real) for value in values):
            closest = abs(math.hypot(*values[:2]) - math.hypot(*values[2:4]))
            check_positive("TwoBonePath: length where its anchors are closest", "m", length=closest)

    def _distal(self, angle: ArrayLike) -> tuple[Array, Array]:
        sine, cosine = sincos(floating(angle))
        return self.distal_x * cosine - self.distal_y * sine, self.distal_x * sine + self.distal_y * cosine

    def anchors(self, angle: ArrayLike) -> Ends:
        return jnp.asarray([[self.proximal_x, self.proximal_y], self._distal(angle)])

    def length(self, angle: ArrayLike, side: _Side) -> Float[Array, "..."]:
        distal_x, distal_y = self._distal(angle)
        x, y = distal_x - self.proximal_x, distal_y - self.proximal_y
        return jnp.sqrt(x * x + y * y) - self.connector_length


class TabulatedPath(MusclePath):
    """Path through a measured table of lengths or moment arms, as a Chebyshev series.

    The degree minimises the leave-one-out error, `error`. Outside the table the moment arm is constant.

    Parameters
    ----------
    angles
        Measured angles [rad], in any order.
    lengths
        Lengths of the muscle with the elements in series [m].
    arms, rest_length
        Positive moment arms [m], and length at angle 0 [m], in place of lengths.
    """

    short_name = "tabulated"

    angles: tuple[Angle, ...]
    lengths: tuple[Length, ...] | None = None
    arms: tuple[MomentArm, ...] | None = None
    rest_length: Length | None = None
    error: float = eqx.field(static=True, default=0.0)
    coefficients: tuple[float, ...] = eqx.field(static=True, default=())
    window: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))

    def __init__(
        self,
        angles: Sequence[float],
        *,
        lengths: Sequence[float] | None = None,
        arms: Sequence[float] | None = None,
        rest_length: float | None = None,
    ) -> None:
        values = arms if lengths is None else lengths
        if values is None or (lengths is None) == (arms is None):
            raise RangeError("a table has lengths or moment arms", remedy="give `lengths`, or `arms` and `rest_length`")
        if (arms is None) != (rest_length is None):
            remedy = "give `rest_length`, the length at the angle 0, with `arms`, and not with `lengths`"
            raise RangeError("a table of moment arms needs a length", remedy=remedy)
        x, y = np.asarray(angles, float), np.asarray(values, float)
        if x.shape != y.shape or len(np.unique(x)) < 2 + _SPARE:
            raise RangeError(
                f"the table has {x.size} angles and {y.size} values",
                value=x.size,
                lower=2 + _SPARE,
                remedy="give one value for each of at least four different angles",
            )
        series, left_out = _series(x, y)
        self.error = float(np.sqrt(np.mean(left_out**2)))
        if self.error > _ROUGH * float(np.ptp(y) if arms is None else np.abs(y).max()):
            worst = int(np.argmax(np.abs(left_out)))
            text = (
                f"the table of {x.size} values is not smooth: each is {self.error:.3g} m from the curve through the "
                f"others, that at {x[worst] / deg:.4g} deg, {y[worst]:.5g} m, {abs(left_out[worst]):.3g} m"
            )
            warnings.warn(text, McKibbenWarning, stacklevel=2)
        if arms is not None:
            series = series.integ(lbnd=0)
        self.coefficients, self.window = tuple(map(float, series.coef)), (float(x.min()), float(x.max()))
        self.angles, self.rest_length = tuple(x.tolist()), rest_length
        self.lengths = None if lengths is None else tuple(y.tolist())
        self.arms = None if arms is None else tuple(y.tolist())

    @property
    def angle_range(self) -> tuple[float, float]:
        return self.window

    def length(self, angle: ArrayLike, side: _Side) -> Float[Array, "..."]:
        low, high = self.window
        x = floating(angle)
        inside = jnp.clip(x, low, high)

        def series(at: Array) -> Array:
            """Clenshaw's sum."""
            scaled = (2 * at - (low + high)) / (high - low)
            last = before = jnp.zeros_like(scaled)
            for coefficient in self.coefficients[:0:-1]:
                last, before = coefficient + 2 * scaled * last - before, last
            return self.coefficients[0] + scaled * last - before

        # Linear beyond the table, with value and slope of its nearest angle.
        value = series(inside) + (x - inside) * derivative(series, inside)
        return value if self.rest_length is None else self.rest_length + side * value


def _series(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[Chebyshev, NDArray[np.float64]]:
    """Chebyshev series of the degree that minimises the RMS leave-one-out error, and the errors."""
    best, errors, least = 0, y, math.inf
    for degree in range(1, min(_LARGEST_DEGREE, len(np.unique(x)) - _SPARE) + 1):
        columns = np.polynomial.chebyshev.chebvander((2 * x - x.min() - x.max()) / np.ptp(x), degree)
        q = np.linalg.qr(columns)[0]
        left_out = (y - q @ (q.T @ y)) / np.maximum(1 - np.sum(q * q, axis=1), 1e-12)
        error = float(np.sqrt(np.mean(left_out**2)))
        if error < least * (1 - 1e-9) - 1e-15:
            best, errors, least = degree, left_out, error
    return Chebyshev.fit(x, y, best, domain=[x.min(), x.max()]), errors


class PairedPaths(Geometry):
    """Joint with one path per muscle; muscle 1 lengthens as the angle increases, muscle 2 shortens.

    Parameters
    ----------
    path1, path2
        Paths of muscle 1 and of muscle 2.

    Examples
    --------
    >>> from mckibben.units import mm
    >>> elbow = PairedPaths(
    ...     TwoBonePath(proximal_x=-0.02, proximal_y=0.30, distal_x=-0.03, distal_y=0.0),
    ...     Pulley(radius=25 * mm, rest_length=300 * mm),
    ... )
    >>> [round(float(value), 4) for value in (*elbow.path_lengths(0.0), *elbow.moment_arms(0.0))]
    [0.3002, 0.3, 0.03, 0.025]
    """

    short_name = "paired_paths"

    path1: MusclePath
    path2: MusclePath

    def __check_init__(self) -> None:
        super().__check_init__()
        low, high = self.angle_range
        if low >= high:
            raise RangeError("the tables of the two muscles have no angle in common", remedy="measure the same angles")
        if not all(isinstance(leaf, Real) for leaf in jax.tree.leaves(self)):  # arrays of many runs
            return
        at = min(max(0.0, low), high)
        for number, arm in enumerate(self.moment_arms(at), 1):
            if not float(arm) > 0:
                does = "shortens" if number == 1 else "lengthens"
                message = (
                    f"muscle {number} {does} as the angle increases: its moment arm at {at / deg:.4g} deg is "
                    f"{float(arm) / mm:.4g} mm"
                )
                remedy = "exchange the paths, or check the signs of the coordinates"
                raise RangeError(message, value=float(arm), lower=0.0, unit="m", remedy=remedy)

    @property
    def angle_range(self) -> tuple[float, float]:
        (low1, high1), (low2, high2) = self.path1.angle_range, self.path2.angle_range
        return max(low1, low2), min(high1, high2)

    def remedy(self, number: int, *, longer: bool) -> str:
        name, grows = (self.path1, self.path2)[number - 1].adjusted_by
        if not name:
            return super().remedy(number, longer=longer)
        return f"a {'longer' if longer == grows else 'shorter'} {name} of path{number}"

    def path_lengths(self, angle: ArrayLike) -> Pair:
        return self.path1.length(angle, 1), self.path2.length(angle, -1)

    def anchors(self, angle: ArrayLike) -> tuple[Ends | None, Ends | None]:
        return self.path1.anchors(angle), self.path2.anchors(angle)
