"""A joint between two antagonistic muscles: torque and stiffness, Eqs. 7 and 8 of the paper."""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.errors import RangeError, UnreachableError
from mckibben.joint import attainable
from mckibben.joint.geometry import KneeGeometry, Pair
from mckibben.joint.tendon import RigidTendon, Tendon
from mckibben.muscle import MaxwellSlip, Muscle, NoCreep, PressureAffineLaw
from mckibben.numerics.batching import compute_once
from mckibben.numerics.calculus import derivative, value_and_derivative
from mckibben.numerics.checks import check_kind, check_within
from mckibben.numerics.elementary import floating
from mckibben.units import deg


def pressure_pair(pressures: tuple[ArrayLike, ArrayLike]) -> tuple[ArrayLike, ArrayLike]:
    """The pressures of muscles 1 and 2, given as a pair; each is a number or an array.

    An array with more than one axis is refused, whatever its shape: which axis stands for the muscles is a guess.

    Raises
    ------
    RangeError
        If it is no pair.
    """
    shape = (len(pressures),) if isinstance(pressures, tuple | list) else jnp.shape(pressures)
    if shape != (2,):
        raise RangeError(
            f"the pressures are an array of shape {shape}, not a pair",
            remedy="give (p1, p2), the gauge pressures of muscles 1 and 2; each may be an array",
        )
    return pressures[0], pressures[1]


class AffineMap(NamedTuple):
    """Something affine in the two pressures: value = offset + slope1 p1 + slope2 p2."""

    offset: Array
    slope1: Array
    slope2: Array

    def __call__(self, pressures: tuple[ArrayLike, ArrayLike]) -> Float[Array, "..."]:
        """The value at a pair of gauge pressures [Pa]."""
        pressure1, pressure2 = pressure_pair(pressures)
        return self.offset + self.slope1 * pressure1 + self.slope2 * pressure2


class TorqueStiffnessMap(NamedTuple):
    """Torque [N*m] and stiffness [N*m/rad] at one angle, over the pressures of two taut muscles."""

    torque: AffineMap
    stiffness: AffineMap

    def pressures_for(self, torque: ArrayLike, stiffness: ArrayLike) -> Pair:
        """The two gauge pressures [Pa] that give both at once; they may lie outside any limits.

        The exact inverse of the 2x2 map. It does not exist where both muscles move torque and stiffness in the same
        proportion; there the answer is not finite.
        """
        (torque0, t1, t2), (stiffness0, k1, k2) = self.torque, self.stiffness
        more_torque, more_stiffness = torque - torque0, stiffness - stiffness0
        determinant = t1 * k2 - t2 * k1
        return (
            (k2 * more_torque - t2 * more_stiffness) / determinant,
            (t1 * more_stiffness - k1 * more_torque) / determinant,
        )


class AntagonisticJoint(eqx.Module):
    """Two muscles that pull a joint both ways.

    Everywhere `pressures` is a pair of gauge pressures [Pa], (p1, p2), `angle` is in rad, and scalars and arrays
    broadcast; what is no pair is refused with a `RangeError`. Torque and stiffness are those of the muscles alone;
    gravity belongs to the load (`mckibben.plant`).

    Parameters
    ----------
    geometry
        The muscles' paths.
    muscle1
        The antagonist: it lengthens as the angle grows.
    muscle2
        The agonist: it shortens as the angle grows.
    tendon
        What connects each muscle to its path; rigid unless said.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.units import bar
    >>> knee = catalog.joint("knee-table-2")
    >>> round(float(knee.stiffness(0.0, (3 * bar, 3 * bar))), 2)
    71.93
    """

    geometry: KneeGeometry
    muscle1: Muscle
    muscle2: Muscle
    tendon: Tendon = RigidTendon()

    def __check_init__(self) -> None:
        check_kind(
            "AntagonisticJoint",
            geometry=(self.geometry, KneeGeometry),
            muscle1=(self.muscle1, Muscle),
            muscle2=(self.muscle2, Muscle),
            tendon=(self.tendon, Tendon),
        )
        if not isinstance(self.tendon, RigidTendon):  # then the rate of a muscle's length is no function of the state
            owner = f"muscle in series with a {type(self.tendon).__name__}"
            for muscle in (self.muscle1, self.muscle2):
                if isinstance(muscle.friction, MaxwellSlip):
                    check_within(owner, 0.0, 0.0, "N*s/m", viscous=muscle.friction.viscous)
                if not isinstance(muscle.creep, NoCreep):
                    raise RangeError(
                        f"{owner}: its creep follows the rate of its length, which is not known there",
                        remedy="leave out the creep or the spring",
                    )

    def contractions(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Pair:
        """The contraction [-] of each muscle."""
        pressure1, pressure2 = pressure_pair(pressures)
        path1, path2 = self.geometry.path_lengths(angle)
        return (
            self.tendon.contraction(self.muscle1, path1, pressure1),
            self.tendon.contraction(self.muscle2, path2, pressure2),
        )

    @compute_once
    def tensions(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Pair:
        """The pull [N] of each muscle, F1 and F2."""
        pressure1, pressure2 = pressure_pair(pressures)
        path1, path2 = self.geometry.path_lengths(angle)
        return (
            self.tendon.tension(self.muscle1, path1, pressure1),
            self.tendon.tension(self.muscle2, path2, pressure2),
        )

    def torque(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Float[Array, "..."]:
        """The muscles' torque [N*m], F2 d2 - F1 d1 (Eq. 7 without its gravity)."""
        pressure1, pressure2 = pressure_pair(pressures)
        (path1, path2), (arm1, arm2) = self.geometry.paths_and_arms(angle)
        tension1 = self.tendon.tension(self.muscle1, path1, pressure1)
        tension2 = self.tendon.tension(self.muscle2, path2, pressure2)
        return tension2 * arm2 - tension1 * arm1

    def stiffness(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Float[Array, "..."]:
        """The isobaric stiffness [N*m/rad]: minus the derivative of the torque at constant pressures (Eq. 8).

        Positive where the joint returns by itself; the paper's sign is the opposite.
        """
        return self.torque_and_stiffness(angle, pressures)[1]

    @compute_once
    def torque_and_stiffness(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Pair:
        """Both, from one pass."""
        pressure1, pressure2 = pressure_pair(pressures)
        # The chain rule by hand between geometry and tension: a third of the operations of differentiating all at once.
        (paths, arms), (path_slopes, arm_slopes) = value_and_derivative(self.geometry.paths_and_arms, angle)

        def pulled(i: int, muscle: Muscle, pressure: ArrayLike) -> Pair:
            """One muscle's torque, without its sign, and the derivative with respect to the angle."""
            tension, by_path = value_and_derivative(lambda path: self.tendon.tension(muscle, path, pressure), paths[i])
            return tension * arms[i], by_path * path_slopes[i] * arms[i] + tension * arm_slopes[i]

        (torque1, slope1), (torque2, slope2) = pulled(0, self.muscle1, pressure1), pulled(1, self.muscle2, pressure2)
        return torque2 - torque1, slope1 - slope2

    def closed_valve_stiffness(
        self,
        angle: ArrayLike,
        pressures: tuple[ArrayLike, ArrayLike],
        *,
        polytropic_index: float = 1.0,
        atmosphere: float = 101325.0,
    ) -> Float[Array, "..."]:
        """The stiffness [N*m/rad] with the air locked in: p V^n stays constant, V from the braid.

        Parameters
        ----------
        angle, pressures
            The state at which the valves were closed, [rad] and [Pa].
        polytropic_index
            n: 1 for slow motion (isothermal), 1.4 for fast (adiabatic).
        atmosphere
            The ambient pressure [Pa]; the gas law is about absolute pressure.
        """
        pressure1, pressure2 = pressure_pair(pressures)
        path_slope1, path_slope2 = value_and_derivative(self.geometry.path_lengths, angle)[1]
        path1, path2 = self.geometry.path_lengths(angle)

        def tension_slope(muscle: Muscle, path: Array, path_slope: Array, pressure: ArrayLike) -> Array:
            """The derivative of one muscle's tension with respect to the angle, its air locked in."""
            pressure = floating(pressure)
            contraction, by_path = value_and_derivative(lambda x: self.tendon.contraction(muscle, x, pressure), path)
            by_pressure = derivative(lambda p: self.tendon.contraction(muscle, path, p), pressure)
            volume, volume_slope = value_and_derivative(muscle.specimen.volume, contraction)
            compression = -polytropic_index * (pressure + atmosphere) * volume_slope / volume  # dp / d contraction
            pressure_slope = compression * by_path / (1 - compression * by_pressure)  # dp / d path
            isobaric = derivative(lambda x: self.tendon.tension(muscle, x, pressure), path)
            by_air = derivative(lambda p: self.tendon.tension(muscle, path, p), pressure)
            return path_slope * (isobaric + by_air * pressure_slope)

        (arm1, arm2), (arm_slope1, arm_slope2) = value_and_derivative(self.geometry.moment_arms, angle)
        tension1, tension2 = self.tensions(angle, pressures)
        slope1 = tension_slope(self.muscle1, path1, path_slope1, pressure1)
        slope2 = tension_slope(self.muscle2, path2, path_slope2, pressure2)
        return slope1 * arm1 + tension1 * arm_slope1 - slope2 * arm2 - tension2 * arm_slope2

    def affine_map(self, angle: ArrayLike) -> TorqueStiffnessMap:
        """Torque and stiffness at an angle as affine functions of the two pressures, while both muscles are taut.

        Raises
        ------
        TypeError
            If the tendon gives or a law is not affine in pressure: then no such map exists.
        """
        for muscle in (self.muscle1, self.muscle2):
            if not isinstance(muscle.law, PressureAffineLaw):
                raise TypeError(f"{type(muscle.law).__name__} is not affine in pressure: the joint has no affine map")
        if not isinstance(self.tendon, RigidTendon):
            raise TypeError(f"with a {type(self.tendon).__name__} the torque is not affine in the pressures")

        def torque_terms(a: Array) -> tuple[Array, Array, Array]:
            (path1, path2), (arm1, arm2) = self.geometry.paths_and_arms(a)
            offset1, gain1 = self.muscle1.law.pressure_terms(self.muscle1.specimen.contraction_at(path1))  # type: ignore
            offset2, gain2 = self.muscle2.law.pressure_terms(self.muscle2.specimen.contraction_at(path2))  # type: ignore
            return offset2 * arm2 - offset1 * arm1, -gain1 * arm1, gain2 * arm2

        torque, slopes = value_and_derivative(torque_terms, angle)
        return TorqueStiffnessMap(AffineMap(*torque), AffineMap(*(-slope for slope in slopes)))

    def attainable_torque(
        self,
        angle: ArrayLike,
        *,
        pressure_limits: tuple[float, float] | None = None,
        minimum_tension: float = 0.0,
    ) -> Pair:
        """The lowest and highest torque [N*m] that can be held at an angle; see `attainable_stiffness`."""
        return attainable.torque_range(self, angle, pressure_limits, minimum_tension)

    def attainable_stiffness(
        self,
        angle: ArrayLike,
        torque: ArrayLike,
        *,
        pressure_limits: tuple[float, float] | None = None,
        minimum_tension: float = 0.0,
    ) -> Pair:
        """The lowest and highest stiffness [N*m/rad] that can be held at an angle while the muscles give a torque.

        Both muscles are taut: with one that is slack at every pressure nothing is attainable.
        With a rigid tendon and laws affine in pressure the set is a segment and its ends are exact. With a series
        spring it is scanned at a few hundred tensions.

        Parameters
        ----------
        angle, torque
            Where [rad] and how hard [N*m] the muscles pull.
        pressure_limits
            Lowest and highest gauge pressure [Pa]; the muscles' domains unless given.
        minimum_tension
            What each muscle must keep [N]; at 0 they are just taut.

        Returns
        -------
        lowest, highest
            NaN where the torque cannot be held at that angle: for the pressures, because a muscle would leave the
            contractions of its domain or is slack at every pressure within the limits, or because its tension would
            exceed its specimen's rating.
        """
        return attainable.stiffness_range(self, angle, torque, pressure_limits, minimum_tension)

    def pressures_for(self, angle: float, torque: float, stiffness: float | None = None) -> Pair:
        """The gauge pressures [Pa] within the muscles' domains that give a torque and a stiffness at an angle.

        Parameters
        ----------
        angle, torque
            Where [rad] and how hard [N*m].
        stiffness
            How stiff [N*m/rad]; unless given, amid the slackest and the tightest state (the middle of the attainable
            range, where the stiffness is affine in the pressures).

        Raises
        ------
        UnreachableError
            If there are none; it names the attainable range.
        RangeError
            If a muscle would leave its domain, or a number is not finite.
        """
        found = attainable.hold(self, angle, torque, math.nan if stiffness is None else stiffness)
        return self.held(found, angle, torque, stiffness)

    def held(self, found: attainable.Hold, angle: float, torque: float, stiffness: float | None) -> Pair:
        """The pressures of an answer of `attainable.hold` to these numbers; raises as `pressures_for` does."""
        for name, value in (("angle", angle), ("torque", torque), ("stiffness", stiffness)):
            if value is not None and not math.isfinite(value):
                raise RangeError(f"the {name} is {value}", value=value, remedy="give a finite number")
        if found.exists:
            return found.pressures
        where = f"at {float(angle) / deg:.4g} deg with a torque of {float(torque):.4g} N*m"
        low, high = float(found.lowest), float(found.highest)
        if not low <= high:
            contractions = self.contractions(angle, attainable.pressure_limits_of(self)[1])
            for muscle, contraction in zip((self.muscle1, self.muscle2), contractions, strict=True):
                stretched = float(contraction) < float(muscle.domain.contraction_min)
                muscle.domain.check_contraction(
                    float(contraction),
                    muscle.specimen.name,
                    remedy="give the joint a series spring or a longer connector"
                    if stretched
                    else "give the joint a shorter connector or a longer muscle",
                )
            raise UnreachableError(
                f"no pressures and tensions within limits hold the joint {where}",
                value=angle,
                unit="rad",
                remedy="choose a smaller angle, a longer connector or a series spring",
            )
        if low <= (stiffness or 0.0) <= high:
            raise UnreachableError(
                f"stiffness {stiffness:.4g} N*m/rad {where} lies in a gap of the attainable {low:.4g}..{high:.4g} "
                "N*m/rad: it jumps where a spring meets its stop",
                value=stiffness,
                lower=low,
                upper=high,
                unit="N*m/rad",
                remedy="choose another stiffness, preload or travel",
            )
        raise UnreachableError(
            f"stiffness {stiffness:.4g} N*m/rad {where} is outside the attainable {low:.4g}..{high:.4g} N*m/rad",
            value=stiffness,
            lower=low,
            upper=high,
            unit="N*m/rad",
            remedy="choose a stiffness inside, or change the connector length",
        )
