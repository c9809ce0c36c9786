"""The plant of a simulation: a joint with its load and its valves."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from mckibben.joint import AntagonisticJoint, creep, friction
from mckibben.joint.antagonistic import pressure_pair
from mckibben.joint.attainable import Hold, hold
from mckibben.joint.creep import Relaxings
from mckibben.joint.friction import Memories
from mckibben.joint.load import Load
from mckibben.muscle import Memory, Relaxing
from mckibben.numerics.calculus import rk4
from mckibben.numerics.checks import check_kind
from mckibben.numerics.compiled import compiled
from mckibben.numerics.elementary import floating
from mckibben.plant.disturbance import Disturbance, NoDisturbance
from mckibben.plant.sensors import PerfectSensors, Reading, Sensors
from mckibben.plant.valve import Valve

Scalar = Float[Array, ""]


class Surroundings(NamedTuple):
    """What a plant with real sensors or disturbances has beside its state of motion; all of it stands still in between.

    Attributes
    ----------
    periods
        Control periods since the start.
    push
        The torque from outside [N*m].
    sensed
        What the sensors remember.
    """

    periods: Scalar
    push: Scalar
    sensed: Any


class PlantState(NamedTuple):
    """Angle [rad], angular velocity [rad/s] and the gauge pressures [Pa] of muscles 1 and 2.

    With friction also what each muscle remembers of its way, with creep what is relaxing in it [N], and with real
    sensors or disturbances what becomes of these; nothing without.
    """

    angle: Scalar
    velocity: Scalar
    pressure1: Scalar
    pressure2: Scalar
    memory1: Memory = ()
    memory2: Memory = ()
    relaxing1: Relaxing = ()
    relaxing2: Relaxing = ()
    around: Surroundings | tuple[()] = ()

    @property
    def pressures(self) -> tuple[Scalar, Scalar]:
        """Both pressures, (p1, p2)."""
        return self.pressure1, self.pressure2

    @property
    def memories(self) -> Memories:
        """Both memories."""
        return self.memory1, self.memory2

    @property
    def relaxing(self) -> Relaxings:
        """What is relaxing in both."""
        return self.relaxing1, self.relaxing2


class Motion(NamedTuple):
    """What is integrated of a `PlantState`: angle [rad], angular velocity [rad/s], and what relaxes [N]."""

    angle: Scalar
    velocity: Scalar
    relaxing1: Relaxing = ()
    relaxing2: Relaxing = ()


class JointPlant(eqx.Module):
    """What is simulated, and what a controller never sees.

    Parameters
    ----------
    joint
        Muscles and geometry.
    load
        Inertia, damping and gravity.
    valve
        One kind for both muscles.
    sensors
        What tells a controller of angle and pressures; the truth unless given.
    disturbance
        What pushes from outside; nothing unless given.
    """

    joint: AntagonisticJoint
    load: Load
    valve: Valve
    sensors: Sensors = PerfectSensors()
    disturbance: Disturbance = NoDisturbance()

    def __check_init__(self) -> None:
        check_kind(
            "JointPlant",
            joint=(self.joint, AntagonisticJoint),
            load=(self.load, Load),
            valve=(self.valve, Valve),
            sensors=(self.sensors, Sensors),
            disturbance=(self.disturbance, Disturbance),
        )

    @property
    def sheltered(self) -> bool:
        """Whether sensors are perfect and nothing pushes."""
        return isinstance(self.sensors, PerfectSensors) and isinstance(self.disturbance, NoDisturbance)

    def begun(self, state: PlantState, period: ArrayLike) -> tuple[PlantState, Reading]:
        """The state as a control period [s] begins, and what the sensors tell of it.

        What pushes is held over the period.
        """
        true = Reading(state.angle, *state.pressures)
        around = state.around
        if not isinstance(around, Surroundings):
            return state, true
        sensed, told = self.sensors.read(around.sensed, around.periods, true)
        push = floating(self.disturbance.torque(around.periods * period))
        return state._replace(around=Surroundings(around.periods + 1, push, sensed)), told

    def limited(self, commands: tuple[ArrayLike, ArrayLike]) -> tuple[Scalar, Scalar]:
        """The commands [Pa] that the valves let through: within the pressures that the specimens are rated for.

        A law may hold for less; whoever commands more than it was fitted to leaves its domain, and the result says so.
        """
        rated1, rated2 = self.joint.muscle1.specimen.domain, self.joint.muscle2.specimen.domain
        return (
            jnp.clip(jnp.asarray(commands[0]), rated1.pressure_min, rated1.pressure_max),
            jnp.clip(jnp.asarray(commands[1]), rated2.pressure_min, rated2.pressure_max),
        )

    def stiffness(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Float[Array, "..."]:
        """The stiffness against a push from outside [N*m/rad]: that of the muscles and that of gravity."""
        return self.joint.stiffness(angle, pressures) + self.load.gravity_stiffness(angle)

    def switched(self, state: PlantState, commands: tuple[ArrayLike, ArrayLike]) -> PlantState:
        """The state right after new commands [Pa] reached the valves."""
        return state._replace(
            pressure1=self.valve.switched(state.pressure1, commands[0]),
            pressure2=self.valve.switched(state.pressure2, commands[1]),
        )

    def advance(
        self, state: PlantState, commands: tuple[ArrayLike, ArrayLike], duration: ArrayLike, substeps: int
    ) -> PlantState:
        """The state a duration [s] after new commands [Pa], which are held, by Runge-Kutta steps of equal length.

        The valves give the pressures in closed form; motion and creep are integrated under them.
        """
        step = duration / substeps

        def pressures_after(state: PlantState, elapsed: ArrayLike) -> tuple[Scalar, Scalar]:
            after = self.valve.pressure_after
            return (
                after(state.pressure1, commands[0], elapsed),
                after(state.pressure2, commands[1], elapsed),
            )

        def integrate(_: Array, state: PlantState) -> PlantState:
            def rate(motion: Motion, pressure1: Scalar, pressure2: Scalar) -> Motion:
                return self.rate(state._replace(pressure1=pressure1, pressure2=pressure2, **motion._asdict()))

            end = pressures_after(state, step)
            inputs = state.pressures, pressures_after(state, step / 2), end
            motion = rk4(rate, Motion(state.angle, state.velocity, *state.relaxing), step, inputs)
            return self.settled(state._replace(pressure1=end[0], pressure2=end[1], **motion._asdict()))

        return lax.fori_loop(0, substeps, integrate, self.switched(state, commands))

    def rate(self, state: PlantState) -> Motion:
        """The derivative of the motion with respect to time, Eq. 6, at the pressures of the state."""
        relaxing1, relaxing2 = state.relaxing
        if creep.has_creep(self.joint):
            relaxing1, relaxing2 = creep.rates(self.joint, state.relaxing, state.angle, state.velocity)
        torque = self._torque(state)
        if isinstance(state.around, Surroundings):
            torque = torque + state.around.push
        acceleration = self.load.acceleration(state.angle, state.velocity, torque)
        return Motion(state.velocity, acceleration, relaxing1, relaxing2)

    def settled(self, state: PlantState) -> PlantState:
        """The state after a step of the integration: the muscles remember the way; no force changes by it."""
        if friction.has_friction(self.joint):
            memory1, memory2 = friction.settled(self.joint, state.memories, state.angle, state.pressures)
            state = state._replace(memory1=memory1, memory2=memory2)
        if creep.has_creep(self.joint):
            relaxing1, relaxing2 = creep.settled(self.joint, state.relaxing, state.angle, state.pressures)
            state = state._replace(relaxing1=relaxing1, relaxing2=relaxing2)
        return state

    def still(self, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> PlantState:
        """The state that has long stood at an angle [rad] and gauge pressures [Pa], come to without friction."""
        angle = floating(angle)
        pressure1, pressure2 = map(floating, pressure_pair(pressures))
        return self.remembering(PlantState(angle, jnp.zeros_like(angle), pressure1, pressure2))

    def remembering(self, state: PlantState) -> PlantState:
        """The state, with muscles without stress from friction, and relaxed, unless it says what they remember.

        And with what sensors and disturbances begin with.
        """
        if state.memories == ((), ()) and friction.has_friction(self.joint):
            memory1, memory2 = friction.unstressed(self.joint, state.angle, state.pressures)
            state = state._replace(memory1=memory1, memory2=memory2)
        if state.relaxing == ((), ()) and creep.has_creep(self.joint):
            relaxing1, relaxing2 = creep.relaxed(self.joint, state.angle)
            state = state._replace(relaxing1=relaxing1, relaxing2=relaxing2)
        if state.around == () and not self.sheltered:
            nothing = jnp.zeros_like(floating(state.angle))
            sensed = self.sensors.first(Reading(state.angle, *state.pressures))
            state = state._replace(around=Surroundings(nothing, nothing, sensed))
        return state

    def _torque(self, state: PlantState) -> Scalar:
        """Of the muscles, friction and creep included [N*m]."""
        if friction.plain(self.joint):
            return self.joint.torque(state.angle, state.pressures)
        motion = state.angle, state.velocity, state.pressures
        return friction.pull(self.joint, state.memories, *motion, state.relaxing).torque

    def resting(self, angle: ArrayLike, stiffness: ArrayLike) -> tuple[PlantState, Bool[Array, ""]]:
        """The state of `at_rest`, and whether there is one: for traced numbers, which cannot raise.

        A stiffness of NaN stands for amid the attainable ones.
        """
        state, _, found = _rest(self, angle, stiffness)
        return state, found.exists

    def at_rest(self, angle: float = 0.0, *, stiffness: float | None = None) -> PlantState:
        """The state that rests at an angle with both muscles taut, relaxed, and without stress from friction.

        Parameters
        ----------
        angle
            Where [rad].
        stiffness
            The stiffness of the joint there [N*m/rad]; amid the attainable ones unless given.

        Raises
        ------
        UnreachableError
            If no pressures within limits hold the angle, or the stiffness at it; it names the attainable range.
        RangeError
            If a muscle would leave its domain.
        """
        state, holding, found = _rest(self, angle, math.nan if stiffness is None else stiffness)
        self.joint.held(found, angle, float(holding), stiffness)
        return state


@compiled
def _rest(plant: JointPlant, angle: ArrayLike, stiffness: ArrayLike) -> tuple[PlantState, Array, Hold]:
    """The state at rest, the muscles' torque [N*m] in it, and how it was found; all in one program."""
    holding = -plant.load.gravity_torque(angle)
    found = hold(plant.joint, angle, holding, stiffness)
    return plant.still(angle, found.pressures), holding, found
