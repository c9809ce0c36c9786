"""Attainable set of a joint: static torques and stiffnesses for pressures within limits.

The tension of each muscle lies between its values at the lowest and the highest pressure. A given torque leaves one
degree of freedom, co-contraction: along T2 d2 - T1 d1 = torque both tensions rise together. With rigid tendons and laws
affine in pressure the stiffness is affine along that segment, so its extremes are at the two ends.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import NamedTuple, NoReturn, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, ArrayLike

from mckibben.component.calls import user_level
from mckibben.component.checks import known_numbers
from mckibben.errors import McKibbenWarning, RangeError, UnreachableError
from mckibben.joint.geometry import Geometry, Pair, Pressures
from mckibben.joint.tendon import RigidTendon, Tendon
from mckibben.muscle import Muscle, PressureAffineLaw
from mckibben.muscle.muscle import CHECK_LAW
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.compiled import jit, jit_inline
from mckibben.numerics.elementary import floating
from mckibben.units import JointType

_SCANNED = 401
_SCANNED_FRICTION = 33
_TOLERANCE = 1e-6  # relative tolerance of a stiffness
_ROUNDING = 1e-12  # relative tolerance of a tension
_INSIDE = 1e-9  # margin at the ends of a segment, as a fraction: at the end itself a muscle is slack


class Antagonistic(Protocol):
    """The part of an `AntagonisticJoint` that attainable sets follow from."""

    muscle1: Muscle
    muscle2: Muscle
    geometry: Geometry
    tendon: Tendon

    @property
    def muscles(self) -> tuple[Muscle, Muscle]: ...

    @property
    def springs(self) -> tuple[bool, bool]: ...

    @property
    def joint_type(self) -> JointType: ...

    def contractions(self, angle: ArrayLike, pressures: Pressures) -> Pair: ...

    def evaluate(self, angle: ArrayLike, pressures: Pressures) -> Pair: ...

    def secant_stiffness(self, angle: ArrayLike, pressures: Pressures, amplitude: ArrayLike) -> Array: ...


def check_angle(angle: ArrayLike) -> None:
    """Refuse text, and warn of an angle of more than a turn, in a direct call."""
    if (largest := np.abs(known_numbers("joint", "angle", angle)).max(initial=0.0)) > 2 * math.pi:
        text = f"an angle of {largest:.4g} rad is more than a turn: numbers are in SI, such as 10 * deg"
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())


@jit_inline
def torque_range(
    joint: Antagonistic, angle: ArrayLike, pressure_limits: tuple[float, float] | None, minimum_tension: float
) -> Pair:
    """See `AntagonisticJoint.attainable_torque`."""
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(floating(angle))
    low, high = _tension_ranges(joint, paths, pressure_limits, minimum_tension)
    flexing, extending = (low[0] * arm1, high[0] * arm1), (low[1] * arm2, high[1] * arm2)
    lowest, highest = jnp.minimum(*extending) - jnp.maximum(*flexing), jnp.maximum(*extending) - jnp.minimum(*flexing)
    feasible = (low[0] <= high[0]) & (low[1] <= high[1])
    return jnp.where(feasible, lowest, jnp.nan), jnp.where(feasible, highest, jnp.nan)


@jit_inline
def stiffness_range(
    joint: Antagonistic,
    angle: ArrayLike,
    torque: ArrayLike,
    pressure_limits: tuple[float, float] | None,
    minimum_tension: float,
    amplitude: ArrayLike | None = None,
) -> Pair:
    """See `AntagonisticJoint.attainable_stiffness`."""
    segment = cocontraction_segment(joint, angle, torque, pressure_limits, minimum_tension)
    return _range(segment, segment.profile(), amplitude)


class StaticSolution(NamedTuple):
    """Pressures [Pa] of a static state, whether it exists, and the attainable stiffness [N*m/rad]."""

    pressures: Pair
    exists: Array
    lowest: Array
    highest: Array


@jit
def solve_static(joint: Antagonistic, angle: ArrayLike, torque: ArrayLike, stiffness: ArrayLike) -> StaticSolution:
    """Return the pressures for a torque [N*m] and a stiffness [N*m/rad] at an angle [rad].

    A stiffness of NaN selects the middle of the segment of co-contraction. Compiled; differentiable with respect to the
    arguments and the joint's parameters by one Newton step at the root.
    """
    segment = cocontraction_segment(joint, angle, torque, None, 0.0)
    return _solve(segment.profile(), segment.feasible, stiffness, _fractions(joint))


@jit
def _solve_many(joint: Antagonistic, angle: ArrayLike, torque: ArrayLike, stiffness: ArrayLike) -> StaticSolution:
    """Return the solutions for arrays of shape (n,)."""
    return jax.vmap(lambda *numbers: solve_static(joint, *numbers))(angle, torque, stiffness)


def pressures_for(joint: Antagonistic, angle: ArrayLike, torque: ArrayLike, stiffness: ArrayLike | None) -> Pair:
    """See `AntagonisticJoint.pressures_for`."""
    check_finite(angle=angle, torque=torque, stiffness=0.0 if stiffness is None else stiffness)
    target = math.nan if stiffness is None else stiffness
    numbers = np.broadcast_arrays(*(np.asarray(x, float) for x in (angle, torque, target)))
    shape = numbers[0].shape
    solution = _solve_many(joint, *map(np.ravel, numbers)) if shape else solve_static(joint, *numbers)
    missing = np.flatnonzero(~np.asarray(solution.exists))
    if missing.size:
        first = jax.tree.map(lambda x: np.ravel(x)[missing[0]], solution)
        raise_unattainable(joint, first, *(float(np.ravel(x)[missing[0]]) for x in numbers))
    return solution.pressures[0].reshape(shape), solution.pressures[1].reshape(shape)


def check_finite(**numbers: ArrayLike) -> None:
    """Raise `RangeError` unless all numbers are finite."""
    for name, value in numbers.items():
        if not np.all(np.isfinite(np.asarray(value, float))):
            raise RangeError(f"the {name} is {value}", value=value, remedy="give a finite number")


def raise_unattainable(
    joint: Antagonistic, solution: StaticSolution, angle: float, torque: float, stiffness: float
) -> NoReturn:
    """Raise an error that says why a static state does not exist; a stiffness of NaN stands for any."""
    kind, unit = joint.joint_type, joint.joint_type.unit("N*m/rad")
    where = f"at {kind.show(angle, 'deg', 4)} with {_a_torque(kind, torque)}"
    low, high = float(solution.lowest), float(solution.highest)
    if not low <= high:
        raise unattainable(joint, angle, torque)
    attainable = {"value": stiffness, "lower": low, "upper": high, "unit": unit}
    if low <= stiffness <= high:
        raise UnreachableError(
            f"stiffness {kind.show(stiffness, 'N*m/rad', 4)} {where} lies in a gap of the attainable "
            f"{kind.span((low, high), 'N*m/rad')}: it jumps where a spring meets its stop",
            remedy="choose another stiffness, preload or travel",
            **attainable,
        )
    raise UnreachableError(
        f"stiffness {kind.show(stiffness, 'N*m/rad', 4)} {where} is outside the attainable "
        f"{kind.span((low, high), 'N*m/rad')}",
        remedy="leave the stiffness out: with a return spring the angle determines it"
        if any(joint.springs)
        else "choose a stiffness inside, or change the lengths of the geometry or muscles; `mckibben envelope` names "
        "what limits it",
        **attainable,
    )


def unattainable(
    joint: Antagonistic,
    angle: float,
    torque: float,
    pressure_limits: tuple[float, float] | None = None,
    minimum_tension: float = 0.0,
) -> RangeError | UnreachableError:
    """Return the error that says why a torque is not attainable at an angle, and which range it leaves."""
    if error := _outside_domain(joint, angle):
        return error
    kind = joint.joint_type
    at, held = f"at {kind.show(angle, 'deg', 4)}", _a_torque(kind, torque)
    remedy = f"choose a smaller {kind.words('angle')} or load, other lengths of the geometry, or a series spring"
    if pressure_limits is not None or minimum_tension:
        remedy += "; wider pressure_limits or a lower minimum_tension, if given"
    low, high = map(float, torque_range(joint, angle, pressure_limits, minimum_tension))
    if low <= high and not low <= torque <= high:
        message = f"{held} {at} is outside the attainable {kind.span((low, high), 'N*m')}"
        return UnreachableError(message, value=torque, lower=low, upper=high, unit=kind.unit("N*m"), remedy=remedy)
    message = f"no pressures and tensions within limits hold the joint {at} with {held}"
    if wrong := next(filter(None, (muscle.violation for muscle in joint.muscles)), ""):
        message, remedy = f"{message}, as {wrong}", CHECK_LAW
    return UnreachableError(message, value=angle, unit=kind.unit("rad"), remedy=remedy)


def _a_torque(joint_type: JointType, torque: float) -> str:
    return f"a {joint_type.words('torque')} of {joint_type.show(torque + 0.0, 'N*m', 4)}"


def leaves_domain(joint: Antagonistic, angles: ArrayLike, unheld: ArrayLike) -> str:
    """Error text of a muscle that leaves its domain at the first infeasible angle [rad]; empty if there is none."""
    first = np.asarray(angles)[np.asarray(unheld)][:1]
    error = _outside_domain(joint, float(first[0])) if first.size else None
    return f"at {joint.joint_type.show(first[0], 'deg', 4)}, {error}" if error else ""


def _outside_domain(joint: Antagonistic, angle: float) -> RangeError | None:
    """Return the error of a contraction that leaves its muscle's domain at an angle; None if neither does."""
    contractions = joint.contractions(angle, pressure_limits_of(joint)[1])
    for number, (muscle, contraction) in enumerate(zip(joint.muscles, contractions, strict=True), 1):
        stretched = float(contraction) < float(muscle.domain.contraction_min)
        change, other = joint.geometry.remedy(number, longer=not stretched), "a series spring"
        try:
            muscle.domain.check_contraction(
                float(contraction),
                f"{muscle.specimen.name} (muscle {number})",
                remedy=f"give the joint {change} or {other if stretched else 'a shorter muscle'}",
            )
        except RangeError as error:
            return error
    return None


def warn_unattainable(
    joint: Antagonistic,
    angle: ArrayLike,
    torque: ArrayLike,
    lowest: Array,
    *limits: tuple[float, float] | float | None,
) -> None:
    """Warn of a direct call without any attainable stiffness, and say why there is none at the first angle."""
    if isinstance(lowest, Tracer) or not lowest.size or not jnp.isnan(lowest).all():
        return
    first = jax.tree.map(lambda values: float(np.ravel(values)[0]), (angle, torque, *limits))
    text = f"no stiffness is attainable: {unattainable(joint, *first)}"
    warnings.warn(text, McKibbenWarning, stacklevel=user_level())


class _Scan(NamedTuple):
    """The last fraction of a scan and its stiffness, the extremes, and the bracket with the smallest step."""

    fraction: Array
    value: Array
    lowest: Array
    highest: Array
    step: Array
    low: Array
    high: Array
    increasing: Array


def _solve(profile: Profile, feasible: Array, stiffness: ArrayLike, fractions: Array) -> StaticSolution:
    """Return the state along a segment with a given stiffness."""

    def stiffness_at(fraction: ArrayLike) -> Array:
        return profile(fraction)[1]

    unspecified = jnp.isnan(stiffness)
    target = jnp.where(unspecified, 0.0, stiffness)

    # Bracket by neighbours. A spring that reaches its stop makes the stiffness jump: take the smallest step.
    def scan(scanned: _Scan, fraction: Array) -> tuple[_Scan, None]:
        value = stiffness_at(fraction)
        held = lax.stop_gradient(value)
        step = jnp.abs(held - scanned.value)
        nearer = ((held - target) * (scanned.value - target) <= 0) & (step < scanned.step)
        bracket = scanned.fraction, fraction, held > scanned.value
        bracketed = (jnp.where(nearer, new, old) for new, old in zip((step, *bracket), scanned[4:], strict=True))
        return _Scan(
            fraction, held, jnp.minimum(scanned.lowest, value), jnp.maximum(scanned.highest, value), *bracketed
        ), None

    infinite, unknown = jnp.full_like(fractions[0], jnp.inf), jnp.full_like(fractions[0], jnp.nan)
    start = _Scan(fractions[0], unknown, infinite, -infinite, infinite, fractions[0], fractions[1], jnp.asarray(False))
    scanned, _ = lax.scan(scan, start, fractions)

    def bisect(_: int, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = (low + high) / 2
        beyond = (stiffness_at(middle) >= target) == scanned.increasing
        return jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)

    low, high = lax.fori_loop(0, 60, bisect, (scanned.low, scanned.high))
    root = lax.stop_gradient((low + high) / 2)
    # One Newton step makes the root differentiable with respect to the joint's parameters.
    value, slope = value_and_derivative(stiffness_at, root)
    newton = (value - target) / jnp.where(slope == 0, jnp.inf, lax.stop_gradient(slope))
    fraction = jnp.where(unspecified, 0.5, root - (newton - lax.stop_gradient(newton)))
    pressures, reached = profile(fraction)
    met = jnp.abs(reached - target) <= _TOLERANCE * jnp.abs(target)
    return StaticSolution(
        pressures,
        feasible & (unspecified | (jnp.isfinite(scanned.step) & met)),
        jnp.where(feasible, scanned.lowest, jnp.nan),
        jnp.where(feasible, scanned.highest, jnp.nan),
    )


def _range(segment: Segment, profile: Profile, amplitude: ArrayLike | None = None) -> Pair:
    """Return the lowest and the highest stiffness of each segment."""
    fractions = _fractions(segment.joint)
    if amplitude is not None:  # the band of friction narrows where a muscle is nearly slack
        fractions = jnp.linspace(fractions[0], fractions[-1], _SCANNED_FRICTION)

    def wider(extremes: Pair, fraction: Array) -> tuple[Pair, None]:
        pressures, stiffness = profile(fraction)
        if amplitude is not None:
            stiffness = segment.joint.secant_stiffness(segment.angle, pressures, amplitude)
        return (jnp.minimum(extremes[0], stiffness), jnp.maximum(extremes[1], stiffness)), None

    infinite = jnp.full_like(segment.angle, jnp.inf)
    (lowest, highest), _ = lax.scan(wider, (infinite, -infinite), fractions)
    return jnp.where(segment.feasible, lowest, jnp.nan), jnp.where(segment.feasible, highest, jnp.nan)


def _fractions(joint: Antagonistic) -> Array:
    """Return the fractions of a segment at which to evaluate it: its two ends, or a scan."""
    return jnp.linspace(_INSIDE, 1 - _INSIDE, 2 if is_affine(joint) else _SCANNED)


Profile = Callable[[ArrayLike], tuple[Pair, Array]]
"""Pressures [Pa] and stiffness [N*m/rad] as functions of the fraction of a segment."""


class Segment(NamedTuple):
    """States of equal torque at one angle; fraction 0 has the lowest tension of muscle 1, fraction 1 the highest.

    The tension of muscle 2 follows from the torque: T2 = (torque + T1 d1) / d2, with the moment arms d.
    """

    joint: Antagonistic
    angle: Array
    torque: Array
    paths: Pair
    arms: Pair
    first: Array  # tension of muscle 1 [N] at fraction 0
    last: Array  # and at fraction 1
    feasible: Array

    def pressures(self, fraction: ArrayLike) -> Pair:
        joint = self.joint
        tension1 = self.first + (self.last - self.first) * fraction
        tension2 = (self.torque + tension1 * self.arms[0]) / self.arms[1]
        return (
            joint.tendon.pressure_for(joint.muscle1, self.paths[0], tension1),
            joint.tendon.pressure_for(joint.muscle2, self.paths[1], tension2),
        )

    def at(self, fraction: ArrayLike) -> tuple[Pair, Array]:
        pressures = self.pressures(fraction)
        return pressures, self.joint.evaluate(jnp.broadcast_to(self.angle, pressures[0].shape), pressures)[1]

    def profile(self) -> Profile:
        """Return pressures and stiffness over the fraction; affine for two taut muscles with affine laws."""
        if not is_affine(self.joint):
            return self.at
        # A loop over the two ends, although they would vectorise: XLA then computes their inputs once instead of in
        # each fusion, and generates a third of the code.
        ends = lax.map(self.at, _fractions(self.joint))

        def interpolate(fraction: ArrayLike) -> tuple[Pair, Array]:
            share = (fraction - _INSIDE) / (1 - 2 * _INSIDE)
            return jax.tree.map(lambda end: end[0] + (end[1] - end[0]) * share, ends)

        return interpolate


def cocontraction_segment(
    joint: Antagonistic,
    angle: ArrayLike,
    torque: ArrayLike,
    pressure_limits: tuple[float, float] | None,
    minimum_tension: float,
) -> Segment:
    """Return the states with torques [N*m] at angles [rad]; limits as for `AntagonisticJoint.attainable_stiffness`."""
    angle, torque = jnp.broadcast_arrays(floating(angle), floating(torque))
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    low, high = _tension_ranges(joint, paths, pressure_limits, minimum_tension)
    at_limits = (low[1] * arm2 - torque) / arm1, (high[1] * arm2 - torque) / arm1  # in order if both arms are positive
    first = jnp.maximum(low[0], jnp.minimum(*at_limits))
    last, high2 = jnp.minimum(high[0], jnp.maximum(*at_limits)), high[1]
    if any(joint.springs):
        last, high2 = (x + _ROUNDING * jnp.abs(x) for x in (last, high[1]))  # a single tension, possibly rounded twice
    feasible = (first <= last) & (low[1] <= high2)  # then low[0] <= high[0], too
    return Segment(joint, angle, torque, paths, (arm1, arm2), first, last, feasible)


def pressure_limits_of(joint: Antagonistic) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the gauge pressure limits [Pa] of the muscles' domains: ((low1, low2), (high1, high2))."""
    low1, low2 = (floating(muscle.domain.pressure_min) for muscle in joint.muscles)
    high1, high2 = (floating(muscle.domain.pressure_max) for muscle in joint.muscles)
    return (low1, low2), (high1, high2)


def _tension_ranges(
    joint: Antagonistic, paths: Pair, pressure_limits: tuple[float, float] | None, minimum_tension: float
) -> tuple[Pair, Pair]:
    """Return the lowest and the highest tension [N] of each muscle within pressures, domain and rated force."""
    if pressure_limits is None:
        lowest, highest = pressure_limits_of(joint)
    else:
        lowest, highest = ((limit, limit) for limit in pressure_limits)

    def tension_range(muscle: Muscle, path: Array, low: ArrayLike, high: ArrayLike) -> Pair:
        least, most = joint.tendon.permitted(muscle, path)
        pressures = jnp.stack(jnp.broadcast_arrays(floating(low), floating(high)))
        tensions = jax.vmap(lambda pressure: joint.tendon.tension(muscle, path, pressure))(pressures)
        slackest = jnp.maximum(tensions[0], minimum_tension)
        if not muscle.law.pulls:
            return tensions[0], tensions[0]
        # A muscle that is slack at the highest pressure leaves the feasible set empty.
        tightest = jnp.where(tensions[1] > 0, jnp.minimum(tensions[1], muscle.specimen.force_limit), -jnp.inf)
        return jnp.maximum(slackest, least), jnp.minimum(tightest, most)

    low1, high1 = tension_range(joint.muscle1, paths[0], lowest[0], highest[0])
    low2, high2 = tension_range(joint.muscle2, paths[1], lowest[1], highest[1])
    return (low1, low2), (high1, high2)


def is_affine(joint: Antagonistic) -> bool:
    """Return whether torque and stiffness are affine in the two pressures: affine laws, and rigid tendons."""
    laws_affine = all(isinstance(m.law, PressureAffineLaw) for m in joint.muscles)
    return laws_affine and isinstance(joint.tendon, RigidTendon)
