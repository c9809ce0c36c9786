"""State of a plant, and its rates."""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import AirState
from mckibben.joint.antagonistic import NO_STATES
from mckibben.mechanism.base import angles_of
from mckibben.muscle import MuscleState

Scalar = Float[Array, ""]


class IOState(NamedTuple):
    """State of sensors and disturbance, constant over a control period."""

    sample: Scalar
    disturbance: Any
    sensors: Any


class LastStep(NamedTuple):
    """Explicit part of a Hermite step, with one evaluation per step: the implicit part is evaluated in the next one."""

    positions: tuple[Scalar, ...]  # [rad], the terms of the corrector from the beginning of the step, by joint
    velocities: tuple[Scalar, ...]  # likewise [rad/s]
    rates: tuple[Scalar, ...]  # of the pressures at the end of the step [Pa/s]


class PlantState(NamedTuple):
    """State of a plant; parts that it lacks have no leaves. Position and velocity have the form of its mechanism."""

    position: PyTree  # of an unnamed joint [rad], or the `Posture` of a robot
    velocity: PyTree
    pressures: PyTree  # of the muscles [Pa], a tuple
    muscles: tuple[MuscleState, ...] = NO_STATES
    io: IOState | tuple[()] = ()  # of sensors and disturbance
    air: AirState | tuple[()] = ()
    friction: PyTree = ()  # of the joints
    sent: tuple[tuple[ArrayLike, ...], ...] = ()  # commands [Pa] on their way, the latest first
    last: LastStep | tuple[()] = ()

    @property
    def angle(self) -> PyTree:
        """Angle [rad] of the unnamed joint, or of each joint."""
        return angles_of(self.position)


class Motion(NamedTuple):
    """Integrated part of a state, or its rate."""

    position: Any
    velocity: Any
    creep: tuple[Any, ...] = ((), ())  # of the muscles [N, Pa]
    pressures: tuple[Scalar, ...] = ()  # with an actuator that `holds_air` [Pa]
    air: AirState | tuple[()] = ()  # likewise, the state of the valves

    @classmethod
    def of(cls, state: PlantState) -> Motion:
        """Return the integrated part of a state."""
        pressures = state.pressures if isinstance(state.air, AirState) else ()
        return cls(
            state.position, state.velocity, tuple(muscle.creep for muscle in state.muscles), pressures, state.air
        )

    def applied_to(self, state: PlantState, pressures: tuple[Scalar, ...]) -> PlantState:
        """Return a state with this motion, and other pressures [Pa] unless they are part of it."""
        held = zip(state.muscles, self.creep, strict=True)
        return state._replace(
            position=self.position,
            velocity=self.velocity,
            pressures=self.pressures or pressures,
            muscles=tuple(MuscleState(muscle.friction, creep) for muscle, creep in held),
            air=self.air,
        )


class Forces(NamedTuple):
    """Tensions [N], contractions and path rates [m/s] of the muscles, and the torque [N*m] on each joint.

    Torques are those of muscles, friction and disturbance.
    """

    tensions: tuple[Array, ...]
    contractions: tuple[Array, ...]
    path_rates: tuple[Array, ...]
    torques: tuple[Array, ...]
