"""Plan of a jump with a soft landing: motion of the centre of mass, postures, torques, pressures and commands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mckibben.component.checks import check_positive
from mckibben.errors import McKibbenError, RangeError, UnreachableError
from mckibben.leg.dynamics import acceleration, at_rest, contact, frames, motion, posture_of
from mckibben.leg.foot import foot_jacobian, movable
from mckibben.leg.foot_pressures import FootPressures, check_stops, square_jacobian, trajectory_pressures
from mckibben.leg.jump_control import PlannedControl, planned_commands
from mckibben.leg.mechanism import Leg
from mckibben.leg.plant import LegPlant, LegStart
from mckibben.numerics.calculus import bracketed_root, value_and_derivative
from mckibben.numerics.compiled import jit
from mckibben.units import bar, mm, ms

Floats = NDArray[np.float64]

KNOTS = 4 * ms
"""Longest time between two points of a plan."""
_STRETCH = np.linspace(1.2, 3.2, 201)
"""Durations of a stance that are tried, over stroke and speed at its end."""
_LINE = 257
"""Postures of the line at which its height is checked."""
_ABOVE = 1e-6  # of the line, beyond the take-off posture, so that its height has a root


class Stance(NamedTuple):
    """Motion of the centre of mass between rest and flight: a polynomial [m] over time [s], and its duration [s]."""

    height: Polynomial
    duration: float

    @classmethod
    def push_off(cls, stroke: float, speed: float, gravity: float) -> Stance:
        """Return the motion from rest to a speed [m/s] over a stroke [m].

        The quintic polynomial that begins and ends with a continuous force, of the weight and of 0. Its duration is
        that with the least peak force, among those with which the centre of mass does not sink, nor the ground pull.
        """
        best: tuple[float, Stance] | None = None
        for duration in _STRETCH * stroke / speed:
            height, time = _quintic((0.0, 0.0, 0.0), (stroke, speed, -gravity), duration), np.linspace(0, duration, 201)
            force, rate = height.deriv(2)(time), height.deriv()(time)
            if rate.min() < -1e-9 * speed or force.min() < -gravity * (1 + 1e-9):
                continue
            if best is None or force.max() < best[0]:
                best = float(force.max()), cls(height, float(duration))
        if best is None:
            raise RangeError(
                f"a stroke of {stroke / mm:.3g} mm is too long for a take-off at {speed:.3g} m/s without a pause",
                field="height",
                value=speed * speed / (2 * gravity),
                unit="m",
                remedy="give a greater height, or a shorter stroke",
            )
        return best[1]


@dataclass(frozen=True)
class JumpPlan:
    """A planned jump: push-off from a squat, flight, and a landing that ends at rest.

    Arrays are over `times` [s]; those of joints and muscles have one row for each.

    Attributes
    ----------
    angles, torques
        Angles [rad], and torques [N*m] of the muscles.
    mass_height, ground_force
        Height of the centre of mass [m], and force of the ground along its normal [N].
    pressures
        Gauge pressures [Pa] that give the torques and, if wanted, the stiffness of the foot nearest to the wanted one.
    foot
        Stiffness of the foot at each time, with its certified error; empty if none is wanted.
    commands, attained
        Commands [Pa], averaged about each time, and the pressures [Pa] that the valves reach by their model.
    take_off, touchdown
        Times [s] at which the foot leaves the ground, and touches it again.
    """

    times: Floats
    angles: Floats
    torques: Floats
    mass_height: Floats
    ground_force: Floats
    pressures: Floats
    foot: tuple[FootPressures, ...]
    commands: Floats
    attained: Floats
    take_off: float
    touchdown: float

    @property
    def landing_force(self) -> float:
        """Largest planned force of the ground after touchdown [N]."""
        return float(self.ground_force[self.times >= self.touchdown].max())

    @property
    def valve_error(self) -> float:
        """Largest difference [Pa] between a planned pressure and that which the valves reach."""
        return float(np.abs(self.attained - self.pressures).max())

    def controller(self) -> PlannedControl:
        """Return the controller that gives the commands of the plan."""
        return PlannedControl(self.commands.T, float(self.times[1]), self.take_off, self.touchdown)

    def record(self, level: float = 0.0) -> dict[str, Any]:
        """Return the plan as plain data; the apex is above a level [m]."""
        found: dict[str, Any] = {
            "apex_mm": float(self.mass_height.max() - level) / mm,
            "take_off_ms": self.take_off / ms,
            "touchdown_ms": self.touchdown / ms,
            "duration_ms": float(self.times[-1]) / ms,
            "ground_force": [float(self.ground_force[self.times <= self.take_off].max()), self.landing_force],
            "valve_error_bar": self.valve_error / bar,
        }
        if self.foot:
            standing = (self.times <= self.take_off) | (self.times >= self.touchdown)
            grounded = [one for one, on in zip(self.foot, standing, strict=True) if on]
            for name, key in (("error", "stiffness_error"), ("least", "stiffness_least_error")):
                errors = np.array([getattr(one, name) for one in grounded])
                found[key] = {"mean": float(errors.mean()), "largest": float(errors.max())}
            limits = Counter(" ".join(one.limits[0]) for one in grounded if one.limits)
            found["limits"] = dict(limits.most_common())
        return found

    def describe(self, level: float = 0.0) -> str:
        """Return apex above a level [m], forces and errors of the stiffness as text."""
        one = self.record(level)
        push, land = one["ground_force"]
        text = f"apex {one['apex_mm']:.1f} mm, force of the ground up to {push:.0f} N and at landing {land:.0f} N"
        if "stiffness_error" not in one:
            return text
        error = one["stiffness_error"]
        text += f", stiffness of the foot on the ground within {error['largest']:.2g} (mean {error['mean']:.2g})"
        return f"{text}, limited by {next(iter(one['limits']))}" if one["limits"] else text

    def start(self) -> LegStart:
        """Return the start of the jump, at rest on the ground."""
        return LegStart(tuple(self.angles[:, 0].tolist()), tuple(self.pressures[:, 0].tolist()))


def plan_jump(
    plant: LegPlant,
    squat: Sequence[float],
    take_off: Sequence[float],
    *,
    height: float,
    landing_depth: float,
    stiffness: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    period: float = 0.25e-3,
) -> JumpPlan:
    """Plan a jump of a leg on a vertical slider, and a landing in which the foot meets the ground at rest.

    The postures lie on the line from the squat to the take-off posture, in angles, and beyond it in flight and in deep
    landings; inverse kinematics finds the one with the height of the centre of mass. The torques are those of inverse
    dynamics, with damping, on rigid ground.

    Parameters
    ----------
    squat, take_off
        Angles [rad] at rest at the start, and of the posture in which the foot leaves the ground and touches it again.
    height
        Rise of the centre of mass in flight [m].
    landing_depth
        Distance [m] by which the centre of mass sinks after touchdown.
    stiffness
        Wanted stiffness of the foot [N/m] in the squat, in the take-off posture and at the end of the landing, as
        matrices, of the muscles alone: without the part of the ground's force. The stiffness matrix of the joints that
        gives it is linear between these postures, and constant in flight. Default: the middle of the attainable
        stiffness of each joint.
    period
        Control period [s] for which the commands are found.

    Raises
    ------
    RangeError
        If the trunk is not on a vertical slider, the take-off posture is not above the squat, an angle is beyond a
        stop, or no motion has these heights.
    UnreachableError
        If no pressures give the torques at a point, or they exceed the supply of the valve; with the time, the joint or
        muscle, and the attainable range.
    """
    leg = plant.leg
    if leg.trunk.freedom != "vertical":
        raise RangeError(
            f"the freedom of the trunk is {leg.trunk.freedom}",
            field="freedom",
            value=leg.trunk.freedom,
            remedy="plan jumps with a trunk on a vertical slider (`freedom: vertical`)",
        )
    check_positive("plan_jump", "m", height=height, landing_depth=landing_depth)
    line = PostureLine(plant, tuple(map(float, squat)), tuple(map(float, take_off)))
    gravity = float(plant.gravity)
    speed, stroke = float(np.sqrt(2 * gravity * height)), line.stroke
    push, land = (Stance.push_off(length, speed, gravity) for length in (stroke, landing_depth))
    flight_time = 2 * speed / gravity
    touchdown = push.duration + flight_time
    end = touchdown + land.duration
    times = np.linspace(0.0, end, int(np.ceil(end / KNOTS)) + 1)
    flying = (times > push.duration) & (times < touchdown)

    rise, flown = line.low + stroke, times - push.duration
    stances = push.height + line.low, land.height(Polynomial([land.duration, -1.0])) + rise - landing_depth
    course = np.array(  # of the centre of mass: height, speed and acceleration
        [
            np.where(times < touchdown, before.deriv(k)(times), after.deriv(k)(times - touchdown))
            for k, (before, after) in enumerate([stances] * 3)
        ]
    )
    at_take_off = [rise, speed, -gravity]
    moved = line.standing(np.where(flying, np.reshape(at_take_off, (3, 1)), course))
    path = line.flight(line.standing(np.reshape(at_take_off, (3, 1)))[:, 0], flight_time)
    moved[:, flying] = [path.deriv(k)(flown[flying]) for k in range(3)]
    course[0, flying] = (rise + speed * flown - gravity / 2 * flown**2)[flying]
    force, torques = line.dynamics(moved, ~flying)
    angles = line.angles(moved[0])
    wanted = None if stiffness is None else line.wanted(stiffness, moved[0], flying, times < touchdown)
    pressures, foot = _pressures(plant, angles, torques, times, wanted)
    commands, attained = planned_commands(plant, times, angles, pressures, period)
    return JumpPlan(
        times=times,
        angles=angles.T,
        torques=torques.T,
        mass_height=course[0],
        ground_force=force,
        pressures=pressures.T,
        foot=foot,
        commands=commands.T,
        attained=attained.T,
        take_off=float(push.duration),
        touchdown=touchdown,
    )


def _quintic(start: Sequence[float], end: Sequence[float], duration: float) -> Polynomial:
    """Polynomial with value and two derivatives at the start and at the end of a duration."""
    t = duration
    rows = [[t**3, t**4, t**5], [3 * t**2, 4 * t**3, 5 * t**4], [6 * t, 12 * t**2, 20 * t**3]]
    low = Polynomial([start[0], start[1], start[2] / 2])
    left = [end[k] - float(low.deriv(k)(t) if k else low(t)) for k in range(3)]
    return low + Polynomial([0, 0, 0, *np.linalg.solve(rows, left)])


class PostureLine:
    """Postures on a line in the angles of the joints, from a squat (0) to the take-off posture (1), and beyond."""

    def __init__(self, plant: LegPlant, squat: tuple[float, ...], take_off: tuple[float, ...]) -> None:
        check_stops(plant.leg, tuple(np.array([squat, take_off]).T))
        self.plant, self.start = plant, np.array(squat)
        self.change = np.where(movable(plant.leg), np.array(take_off) - self.start, 0.0)
        places = np.linspace(0.0, 1.0, _LINE)
        heights = np.asarray(self.height(places))
        self.low, self.stroke = float(heights[0]), float(heights[-1] - heights[0])
        if not (np.diff(heights) > 0).all():
            raise RangeError(
                "from the squat to the take-off posture the centre of mass does not rise throughout",
                field="take_off",
                value=list(take_off),
                unit="rad",
                remedy="give a more stretched take-off posture, or a deeper squat",
            )
        reach = [(side - a) / d for j, a, d in zip(plant.leg.joints, squat, self.change, strict=True) if d
                 for side in (j.lower, j.upper)]  # fmt: skip
        self.reach = max(one for one in reach if one <= 1e-12), min(one for one in reach if one >= 1 - 1e-12)

    def angles(self, place: ArrayLike) -> Floats:
        """Angles [rad], (times, joints)."""
        return self.start + np.multiply.outer(np.asarray(place, float), self.change)

    def height(self, place: ArrayLike) -> Array:
        """Height of the centre of mass [m] with the foot on the ground."""
        return _heights(self.plant, tuple(self.start), tuple(self.change), jnp.asarray(place, float))

    def standing(self, course: Floats) -> Floats:
        """Place on the line and its two derivatives, with the foot on the ground, for those of the height [m]."""
        found = _places(self.plant, tuple(self.start), tuple(self.change), (self.reach[0], 1 + _ABOVE), *course)
        places = np.array([np.asarray(one) for one in found])
        if not np.isfinite(places[0]).all():
            top = self.low + self.stroke
            raise RangeError(
                "the centre of mass sinks below the lowest posture between the stops",
                field="landing_depth",
                value=top - float(course[0].min()),
                upper=top - float(self.height(self.reach[0])),
                unit="m",
                remedy="give less depth, or a more stretched take-off posture",
            )
        return places

    def flight(self, leaving: Floats, duration: float) -> Polynomial:
        """Place on the line in flight: it leaves with given derivatives, and returns at that speed.

        Of even polynomials of the sixth order, that with the least acceleration between the stops.
        """
        half, grid = duration / 2, np.linspace(-1.0, 1.0, 201)
        place, rate, second = leaving[0], -leaving[1] * half, leaving[2] * half * half
        best: tuple[float, Polynomial] | None = None
        for middle in np.linspace(*self.reach, 201):
            rows, right = [[1, 1, 1], [2, 4, 6], [2, 12, 30]], [place - middle, rate, second]
            factors = np.linalg.solve(rows, right)
            path = Polynomial([middle, 0, factors[0], 0, factors[1], 0, factors[2]])
            places, needed = path(grid), float(np.abs(path.deriv(2)(grid)).max())
            inside = places.min() >= self.reach[0] and places.max() <= self.reach[1]
            if inside and (best is None or needed < best[0]):
                best = needed, path(Polynomial([-1.0, 1 / half]))
        if best is None:
            raise RangeError(
                "the joints reach a stop in flight, before they can turn back",
                field="height",
                value=duration * duration * float(self.plant.gravity) / 8,
                unit="m",
                remedy="give less height, or a more bent take-off posture",
            )
        return best[1]

    def wanted(
        self, stiffness: Sequence[ArrayLike], places: Floats, flying: NDArray[np.bool_], before: NDArray[np.bool_]
    ) -> Floats:
        """Wanted stiffness of the foot [N/m] at places; that of the joints is linear between those of the ends."""
        leg, free = self.plant.leg, movable(self.plant.leg)

        def jacobian(place: float) -> Floats:
            return square_jacobian(foot_jacobian(leg, self.angles(place).tolist())[0][:, free])

        ends = np.array([0.0, 1.0, places[-1]])
        jacobians = [jacobian(place) for place in ends]
        at_ends = [one.T @ np.asarray(each, float) @ one for one, each in zip(jacobians, stiffness, strict=True)]
        matrices = []
        for place, flies, early in zip(places.tolist(), flying, before, strict=True):
            end = 0 if early else 2
            part = 0.0 if flies else (1 - place) / (1 - ends[end])
            inverse = np.linalg.inv(jacobian(place))
            matrices.append(inverse.T @ (at_ends[1] + part * (at_ends[end] - at_ends[1])) @ inverse)
        return np.array(matrices)

    def dynamics(self, moved: Floats, standing: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Force of the ground [N] and torques of the muscles [N*m] for places on the line, and their derivatives."""
        force, torques = _dynamics(self.plant, tuple(self.start), tuple(self.change), moved, standing)
        return np.asarray(force), np.asarray(torques)


def _on_line(plant: LegPlant, start: tuple[Any, ...], change: tuple[Any, ...], place: Array) -> tuple[Any, Array]:
    """Posture with the foot on the ground, and the height of its centre of mass [m]."""
    leg, normal = plant.leg, plant.ground.normal
    posture = posture_of(leg, [a + place * d for a, d in zip(start, change, strict=True)])
    still = at_rest(posture)
    depth = contact(leg, frames(leg, posture, still), normal).position.dot(normal) / normal.z
    return posture._replace(z=-depth), motion(leg, posture, still, plant.gravity).height - depth


@jit
def _heights(plant: LegPlant, start: Any, change: Any, place: Array) -> Array:
    return _on_line(plant, start, change, place)[1]


@jit
def _places(
    plant: LegPlant, start: Any, change: Any, reach: tuple[Any, Any], height: Array, speed: Array, acceleration: Array
) -> tuple[Array, Array, Array]:
    def rise(place: Array) -> Array:
        return _on_line(plant, start, change, place)[1]

    place = bracketed_root(lambda x: rise(x) - height, jnp.full_like(height, reach[0]), jnp.full_like(height, reach[1]))
    (slope, bend) = value_and_derivative(lambda x: value_and_derivative(rise, x)[1], place)
    rate = speed / slope
    return place, rate, (acceleration - bend * rate * rate) / slope


@jit
def _dynamics(plant: LegPlant, start: Any, change: Any, moved: Any, standing: Any) -> tuple[Array, Array]:
    """Force of the ground along its normal, and torques, at points of the line; with the foot on the ground or not."""
    leg, normal = plant.leg, plant.ground.normal
    free = np.flatnonzero(movable(leg))

    def hip(place: Array) -> Array:
        return _on_line(plant, start, change, place)[0].z

    def at(moved: Array, standing: Array) -> tuple[Array, Array]:
        place, rate, second = moved
        slope, bend = value_and_derivative(lambda x: value_and_derivative(hip, x)[1], place)
        posture = _on_line(plant, start, change, place)[0]
        rates = [rate * d for d in change]
        velocity = at_rest(posture)._replace(
            z=jnp.where(standing, slope * rate, 0.0), angles=tuple(map(jnp.asarray, rates))
        )
        upward = slope * second + bend * rate * rate
        point = contact(leg, frames(leg, posture, velocity), normal)
        slip = point.velocity - normal.scaled(point.velocity.dot(normal))
        speed = jnp.sqrt(slip.dot(slip) + plant.ground.slip_speed**2)
        direction = normal - slip.scaled(plant.ground.friction / speed)

        def accelerations(unknown: Array) -> Array:
            """Errors of the accelerations; unknown are the torques, and the force or the trunk's acceleration."""
            torques: list[Any] = [0.0] * len(leg.joints)
            for place, i in enumerate(free):
                torques[i] = unknown[place]
            push = jnp.where(standing, unknown[-1], 0.0)
            found = acceleration(leg, posture, velocity, torques, direction.scaled(push), plant.gravity, normal)
            trunk = jnp.where(standing, found.z - upward, unknown[-1])
            return jnp.stack([*(found.angles[i] - second * change[i] for i in free), trunk])

        zero = jnp.zeros(len(free) + 1)
        offset, matrix = accelerations(zero), jax.jacfwd(accelerations)(zero)
        solved = jnp.linalg.solve(matrix, -offset)
        torques = jnp.zeros(len(leg.joints)).at[free].set(solved[:-1])
        damping = jnp.stack([jnp.asarray(joint.damping) * one for joint, one in zip(leg.joints, rates, strict=True)])
        return jnp.where(standing, solved[-1], 0.0), torques + damping

    return jax.vmap(at, in_axes=-1)(moved, standing)


def _pressures(
    plant: LegPlant, angles: Floats, torques: Floats, times: Floats, wanted: Floats | None
) -> tuple[Floats, tuple[FootPressures, ...]]:
    """Pressures [Pa], (times, muscles), and those for a wanted stiffness in detail."""
    leg, supply = plant.leg, float(getattr(plant.valve, "supply", None) or np.inf)
    if wanted is None:
        rows = leg.pressures_for(tuple(angles.T), tuple(torques.T), [None] * len(leg.joints))
        pressures = np.stack(np.broadcast_arrays(*rows, times)[:-1], -1)
        _check_supply(leg, pressures, times, supply)
        return pressures, ()
    try:
        found = trajectory_pressures(leg, angles.tolist(), list(wanted), torques=torques.tolist(), supply=supply)
    except McKibbenError as error:
        error.message += f" (postures every {times[1] / ms:.1f} ms of the plan)"
        raise
    return np.array([one.pressures for one in found]), tuple(found)


def _check_supply(leg: Leg, pressures: Floats, times: Floats, supply: float) -> None:
    """Raise `UnreachableError` for the highest pressure of a plan, (times, muscles), if it exceeds the supply [Pa]."""
    at, muscle = np.unravel_index(pressures.argmax(), pressures.shape)
    highest = float(pressures[at, muscle])
    if highest > supply * (1 + 1e-9):
        raise UnreachableError(
            f"{leg.muscle_names[muscle]}: the plan needs {highest / bar:.3g} bar at {times[at] / ms:.1f} ms, and the "
            f"supply is {supply / bar:.3g} bar",
            value=highest,
            upper=supply,
            unit="Pa",
            remedy="give less height, a higher supply, or a wanted stiffness",
        )
