"""Route of a muscle in a posture: its path, and the derivatives of that by the joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.joint.geometry import Geometry
from mckibben.joint.tendon import Tendon
from mckibben.muscle import NO_STATE, Muscle, MuscleState
from mckibben.muscle.air import ATMOSPHERE
from mckibben.numerics.calculus import bracketed_root, derivative, value_and_derivative
from mckibben.numerics.elementary import Number, floating
from mckibben.numerics.spatial import product, total

Bends = dict[tuple[int, int], Number]
"""Second derivatives of a path [m/rad^2], by two hinges or joints, the first of which is not after the second."""


class Route(NamedTuple):
    """A muscle in a posture: the length of its path [m], and the derivatives [m/rad] of that by number of the joint.

    `bends` computes the second derivatives [m/rad^2].
    """

    muscle: Muscle
    tendon: Tendon
    path: Array
    slopes: dict[int, Array]
    bends: Callable[[], Bends]

    def tension(self, pressure: ArrayLike) -> Array:
        """Return the tension [N] of the law at a gauge pressure [Pa]."""
        return self.tendon.tension(self.muscle, self.path, pressure)

    def contraction(self, pressure: ArrayLike, state: MuscleState = NO_STATE) -> Array:
        """Return the contraction [-] of the muscle at a gauge pressure [Pa]."""
        return self.tendon.contraction(self.muscle, self.path, pressure, state)

    def forces(self, pressure: ArrayLike, state: MuscleState, rate: ArrayLike | None) -> tuple[Array, Array]:
        """Return the tension [N] with friction and creep, at a rate of the path [m/s], and the contraction [-].

        A rate of None leaves out the viscous part of friction.
        """
        muscle, contraction = self.muscle, self.contraction(pressure, state)
        tension = muscle.tension(contraction, pressure, state)
        if rate is not None and muscle.has_friction:
            tension = tension + muscle.viscous_force(contraction, pressure, rate, state)
        return tension, contraction

    def closed_valve_slope(self, pressure: ArrayLike, index: ArrayLike, dead_volume: ArrayLike) -> Array:
        """Return the derivative [N/m] of the tension by the path where p V^n is constant, at a gauge pressure [Pa]."""
        muscle, tendon, pressure = self.muscle, self.tendon, floating(pressure)
        contraction, by_path = value_and_derivative(lambda x: tendon.contraction(muscle, x, pressure), self.path)
        by_pressure = derivative(lambda p: tendon.contraction(muscle, self.path, p), pressure)
        volume, volume_slope = value_and_derivative(muscle.specimen.volume, contraction)
        compression = index * (pressure + ATMOSPHERE) * -volume_slope / (volume + dead_volume)  # dp / d contraction
        pressure_slope = compression * by_path / (1 - compression * by_pressure)  # dp / d path
        isobaric = derivative(lambda x: tendon.tension(muscle, x, pressure), self.path)
        by_air = derivative(lambda p: tendon.tension(muscle, self.path, p), pressure)
        return isobaric + by_air * pressure_slope

    def closed_valve_pressure(
        self, start: Route, pressure: ArrayLike, state: MuscleState, index: ArrayLike, dead_volume: ArrayLike
    ) -> Array:
        """Return the pressure [Pa] of the air that a closed valve held at a pressure [Pa], on the route `start`."""
        pressure = floating(pressure)

        def expansion(route: Route, pressure: Array) -> Array:
            """Absolute pressure [Pa] times V^n."""
            volume = self.muscle.specimen.volume(route.contraction(pressure, state)) + dead_volume
            return (pressure + ATMOSPHERE) * volume**index

        held = expansion(start, pressure)
        return bracketed_root(lambda p: expansion(self, p) / held - 1, -ATMOSPHERE, 9 * (pressure + ATMOSPHERE))

    def rate(self, rates: Sequence[ArrayLike]) -> Array:
        """Return the rate [m/s] of the length of the path, at rates [rad/s] of all joints."""
        rate: Number = 0.0
        for joint, slope in self.slopes.items():
            rate = total(rate, product(slope, rates[joint]))
        return jnp.asarray(rate)


def closed_valve_stiffness(
    routes: Sequence[Route],
    joint: int,
    pressures: Sequence[ArrayLike],
    indices: Sequence[ArrayLike],
    dead_volume: ArrayLike,
) -> Array:
    """Return the stiffness [N*m/rad] of a joint of a number, at gauge pressures [Pa], with closed valves: p V^n is
    constant, with an n of each muscle, and a dead volume [m^3] is added to its own.
    """
    stiffness: Number = 0.0
    for route, pressure, index in zip(routes, pressures, indices, strict=True):
        if joint in route.slopes:
            slope = route.closed_valve_slope(pressure, index, dead_volume)
            stiffness += slope * route.slopes[joint] ** 2 + route.tension(pressure) * route.bends()[joint, joint]
    return jnp.asarray(stiffness)


def secant_stiffness(
    routes_at: Callable[[Array], Sequence[Route]],
    joint: int,
    angle: ArrayLike,
    pressures: Sequence[ArrayLike],
    amplitude: ArrayLike,
    *,
    polytropic_index: ArrayLike | None = None,
    dead_volume: ArrayLike = 0.0,
) -> Array:
    """Return the secant stiffness [N*m/rad] of a joint of a number, whose routes are given over its angle [rad].

    See `AntagonisticJoint.secant_stiffness`.
    """
    angle, amplitude = floating(angle), floating(amplitude)
    routes = routes_at(angle)
    states = init_states(routes, pressures)

    def resistance(angle: Array) -> Number:
        """Minus the torque [N*m]."""
        resisting: Number = 0.0
        for start, route, pressure, state in zip(routes, routes_at(angle), pressures, states, strict=True):
            if joint in route.slopes:
                if polytropic_index is not None:
                    pressure = route.closed_valve_pressure(start, pressure, state, polytropic_index, dead_volume)
                resisting += route.forces(pressure, state, 0.0)[0] * route.slopes[joint]
        return resisting

    return jnp.asarray((resistance(angle + amplitude) - resistance(angle - amplitude)) / (2 * amplitude))


def init_states(routes: Sequence[Route], pressures: Sequence[ArrayLike]) -> tuple[MuscleState, ...]:
    """Return the unstressed, relaxed states of muscles at gauge pressures [Pa]."""
    points = zip(routes, pressures, strict=True)
    return tuple(route.muscle.init_state(route.contraction(pressure), pressure) for route, pressure in points)


def update_states(
    routes: Sequence[Route], states: Sequence[MuscleState], pressures: Sequence[ArrayLike]
) -> tuple[MuscleState, ...]:
    """Return the states of muscles after a short move, projected on their bounds; no force changes by it."""
    points = zip(routes, states, pressures, strict=True)
    return tuple(
        route.muscle.update_state(state, route.contraction(pressure, state), pressure)
        for route, state, pressure in points
    )


def pair_routes(
    geometry: Geometry, muscles: tuple[Muscle, Muscle], tendon: Tendon, angle: ArrayLike, joint: int = 0
) -> tuple[Route, Route]:
    """Return two antagonistic muscles at an angle [rad] of a joint of a number."""
    (path1, path2), (arm1, arm2) = geometry.paths_and_arms(angle)

    def bends(muscle: int) -> Bends:
        slope = value_and_derivative(geometry.moment_arms, angle)[1][muscle]
        return {(joint, joint): slope * (1 - 2 * muscle)}

    return (
        Route(muscles[0], tendon, path1, {joint: arm1}, lambda: bends(0)),
        Route(muscles[1], tendon, path2, {joint: -arm2}, lambda: bends(1)),
    )
