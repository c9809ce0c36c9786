"""The plant of a simulation: a joint with its load, valves, sensors and disturbances."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree
from numpy.typing import NDArray

from mckibben.actuator.base import Actuator
from mckibben.errors import UnreachableError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.antagonistic import pressure_pair
from mckibben.joint.attainable import StaticSolution, check_finite, raise_unattainable, solve_static
from mckibben.joint.geometry import Pressures
from mckibben.mechanism.disturbance import Disturbance, NoDisturbance
from mckibben.mechanism.hinge import Hinge
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.muscle import MaxwellCreep, MaxwellSlip, Muscle
from mckibben.numerics.compiled import jit
from mckibben.numerics.elementary import floating
from mckibben.plant.base import Angles, Plant
from mckibben.plant.state import PlantState

Scalar = Float[Array, ""]


def _rated(joint: AntagonisticJoint) -> tuple[Any, ...]:
    return tuple(muscle.specimen.domain.pressure_max for muscle in joint.muscles)


def rated_for(joint: AntagonisticJoint, pressures: tuple[ArrayLike, ...]) -> AntagonisticJoint:
    """Return the joint with its muscles rated for highest pressures [Pa]."""
    return eqx.tree_at(_rated, joint, pressures)


class JointPlant(Plant):
    """The simulated system: joint, load, valves, sensors and disturbance; controllers have no access to it.

    Its motion follows Eq. 6 of the paper with the torque of Eq. 7, the disturbance, and friction.

    Parameters
    ----------
    joint, load, valve
        Joint with its muscles, load, and the actuators of the muscles.
    disturbance
        External torque [N*m] over time; none by default.
    friction
        Dry friction of the joint itself (default: none); that of a muscle belongs to the muscle.
    sensors, command_delay, delay_periods
        As for `Plant`.

    Raises `RangeError` for a valve that fills a muscle of unknown volume.

    Examples
    --------
    The paper's knee in equilibrium at 0 deg, with the torque [N*m] of its muscles against that of gravity:

    >>> from mckibben import IdealValve, catalog
    >>> plant = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> state = plant.equilibrium(0.0)
    >>> round(float(plant.joint.torque(state.angle, state.pressures)), 4)
    -0.7358
    """

    joint: AntagonisticJoint
    load: Load
    valve: Actuator
    disturbance: Disturbance = eqx.field(kw_only=True, default=NoDisturbance())
    friction: JointFriction | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        self.joint.check_load(self.load)
        if self.valve.holds_air:
            for muscle in self.joint.muscles:
                muscle.specimen.check_volume(f"a {type(self.valve).__name__} that fills the volume")

    def __repr__(self) -> str:
        parts = [self.valve] if self.has_ideal_io else [self.valve, self.sensors, self.disturbance]
        return f"JointPlant({self.joint!r}, {', '.join(type(part).__name__ for part in parts)})"

    @property
    def mechanism(self) -> Hinge:
        return Hinge(self.joint, self.load, self.friction)

    @property
    def disturbances(self) -> tuple[Disturbance, ...]:
        return (self.disturbance,)

    @property
    def supplied_joint(self) -> AntagonisticJoint:
        """The joint with its muscles rated for the supply of the valves, where that is below their own rating."""
        supplies = [getattr(self.valve.for_muscle(i), "supply", None) for i in (0, 1)]
        if supplies == [None, None]:
            return self.joint
        both = zip(_rated(self.joint), supplies, strict=True)
        limits = tuple(rated if supply is None else jnp.minimum(jnp.asarray(rated), supply) for rated, supply in both)
        return rated_for(self.joint, limits)

    def with_disturbances(self, disturbances: Sequence[Disturbance]) -> Self:
        (disturbance,) = disturbances
        return dataclasses.replace(self, disturbance=disturbance)

    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> Float[Array, "..."]:
        """Return the total stiffness [N*m/rad], of muscles (Eq. 8) and gravity, at an angle [rad] and pressures."""
        return self.joint.stiffness(angle, pressures) + self.load.gravity_stiffness(angle)

    def telemetry(self, state: PlantState, commands: Sequence[ArrayLike], period: ArrayLike) -> dict[str, Array]:
        found = self.valve.telemetry(state.air, self.arriving(state, commands, period), state.pressures)
        if self.friction is not None:
            found["joint_friction_torque"] = -self.friction.resisting_torque(state.friction, state.angle)
        return found

    def init_state(self, angle: ArrayLike, pressures: Pressures) -> PlantState:
        """Return the state without velocity at an angle [rad] and gauge pressures [Pa], its muscles relaxed."""
        angle = floating(angle)
        pressure1, pressure2 = map(floating, pressure_pair(pressures))
        return self.complete_state(PlantState(angle, jnp.zeros_like(angle), (pressure1, pressure2)))

    def unpressurised(self) -> PlantState:
        return self.init_state(0.0, (0.0, 0.0))

    def fastest_rates(self, angles: Angles, stiffness: ArrayLike | None = 0.0) -> dict[str, float]:
        return {"the motion": _fastest_mode(self, angles, stiffness), "the air": _fastest_air(self, angles)}

    def find_equilibrium(self, angle: ArrayLike, stiffness: ArrayLike) -> tuple[PlantState, Bool[Array, ""]]:
        """Return the state of `equilibrium` and whether it exists, for traced numbers; NaN for no given stiffness."""
        state, _, solution = _equilibrium(self, angle, stiffness)
        return state, solution.exists

    def equilibrium(self, angle: float = 0.0, *, stiffness: float | None = None) -> PlantState:
        """Return the equilibrium at an angle [rad] with both muscles taut, relaxed and unstressed by friction.

        Pressures are within the supply of the valves. The default stiffness [N*m/rad] is midway between
        those of the slackest and the tightest state.

        Raises
        ------
        UnreachableError
            If no pressures within limits balance the load, or give the stiffness; with the attainable range.
        RangeError
            If a muscle would leave its domain, or a number is not finite.
        """
        check_finite(angle=angle, stiffness=0.0 if stiffness is None else stiffness)
        wanted = math.nan if stiffness is None else stiffness
        state, torque, solution = _equilibrium(self, angle, wanted)
        if not solution.exists:
            if not solution.lowest <= solution.highest and solve_static(self.joint, angle, torque, math.nan).exists:
                raise UnreachableError(
                    "the supply of the valves is too low to hold the joint at "
                    f"{self.joint.joint_type.show(angle, 'deg', 4)}; the rated pressures would",
                    field="supply",
                    remedy="raise the supply, or choose another angle",
                )
            raise_unattainable(self.supplied_joint, solution, float(angle), float(torque), float(wanted))
        return state


def _fastest_mode(plant: JointPlant, angles: Angles, stiffness: ArrayLike | None) -> float:
    """Largest magnitude [1/s] of an eigenvalue of the linearised motion, with presliding friction and creep."""
    inertia, damping = float(plant.load.total_inertia), float(plant.load.damping)
    total = float(np.nanmax(np.abs(np.asarray(stiffness, float)))) + abs(float(plant.load.gravity_moment))
    modes = [0.0]
    if plant.joint.has_friction or plant.joint.has_creep:
        paths, arms, _ = _at_extremes(plant, angles)
        for muscle, arm, path in zip(plant.muscles, map(float, np.abs(arms).max(axis=1)), paths, strict=True):
            friction, creep = muscle.friction, muscle.creep
            if isinstance(friction, MaxwellSlip):
                total += float(np.sum(friction.stiffnesses)) * arm**2
                if friction.follows_rate:
                    damping += _steepest_damping(muscle, friction, path) * arm**2
            if isinstance(creep, MaxwellCreep):
                total += float(creep.stiffness) * arm**2
                modes += [1 / float(tau) for tau in (*creep.time_constants, *creep.pressure_time_constants)]
    if plant.friction is not None:
        total += float(plant.friction.steepest)
    half = damping / (2 * inertia)  # of s^2 + 2 half s + total/inertia
    root = half**2 - total / inertia
    return max(*modes, half + math.sqrt(root) if root > 0 else math.sqrt(total / inertia))


def _steepest_damping(muscle: Muscle, friction: MaxwellSlip, lengths: NDArray[np.float64]) -> float:
    """Largest slope [N*s/m] of the friction over the rate at lengths [m] and all pressures of the domain."""
    pressures = np.array([muscle.domain.pressure_min, muscle.domain.pressure_max], float)[:, None]
    tension = np.asarray(_tensions(muscle, lengths, pressures))
    return float(np.max(friction.steepest_damping(lengths, tension, pressures)))


@jit
def _tensions(muscle: Muscle, lengths: ArrayLike, pressures: ArrayLike) -> Array:
    return muscle.tension(muscle.specimen.contraction_at(lengths), pressures)


def _fastest_air(plant: JointPlant, angles: Angles) -> float:
    """Bound on the rates [1/s] of the air in both muscles with its valves; 0 without."""
    if not plant.valve.holds_air:
        return 0.0
    return plant.valve.fastest_rate_in(float(np.min([*_at_extremes(plant, angles)][2])))


def _at_extremes(plant: JointPlant, angles: Angles) -> Iterator[NDArray]:
    """Path lengths [m], moment arms [m] and air volumes [m^3] of both muscles at first, lowest and highest angle."""
    at = np.asarray(angles, float)
    extremes = np.array([at.flat[0], np.nanmin(at), np.nanmax(at)])
    return map(np.asarray, _geometry_at(plant.joint, extremes, volumes=plant.valve.holds_air))


@jit
def _geometry_at(joint: AntagonisticJoint, angles: ArrayLike, *, volumes: bool) -> PyTree:
    lowest1, lowest2 = (muscle.domain.pressure_min for muscle in joint.muscles)
    pairs = zip(joint.muscles, joint.contractions(angles, (lowest1, lowest2)), strict=True)
    air = [muscle.specimen.volume(at) for muscle, at in pairs if volumes]  # that of a spring is a number
    return *joint.geometry.paths_and_arms(angles), jnp.broadcast_arrays(*air)


@jit
def _equilibrium(plant: JointPlant, angle: ArrayLike, stiffness: ArrayLike) -> tuple[PlantState, Array, StaticSolution]:
    """Return the equilibrium, the muscles' torque [N*m] in it, and the static solution, from one program."""
    torque = -plant.load.gravity_torque(angle)
    solution = solve_static(plant.supplied_joint, angle, torque, stiffness)
    return plant.init_state(angle, solution.pressures), torque, solution
