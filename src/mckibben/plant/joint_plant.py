"""The plant of a simulation: a joint with its load, valves, sensors and disturbances."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Load, Measurement
from mckibben.joint.antagonistic import NO_STATES, MuscleStates, pressure_pair
from mckibben.joint.attainable import StaticSolution, check_finite, raise_unattainable, solve_static
from mckibben.joint.geometry import Pressures
from mckibben.joint.tendon import RigidTendon
from mckibben.muscle import MuscleState
from mckibben.muscle.creep import CreepState
from mckibben.muscle.friction import FrictionState
from mckibben.numerics.calculus import rk4, value_and_derivative
from mckibben.numerics.compiled import compiled
from mckibben.numerics.elementary import floating
from mckibben.plant.actuator import Actuator, AirState, AirVolume
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, Sensors
from mckibben.units import CommandDelay

_MOST_PERIODS = 100  # of a command delay
_ROUNDING = 1e-9  # periods

Scalar = Float[Array, ""]


class IOState(NamedTuple):
    """State of sensors and disturbance, constant over a control period."""

    sample: Scalar
    disturbance: Scalar
    sensors: Any


class PlantState(NamedTuple):
    """State of a `JointPlant`.

    `muscles` has no leaves without friction and creep, `io` none for ideal sensors, `air` none for actuators without
    state beside the pressure, `friction` none but for a `JointFriction`, `sent` none without a delay: commands [Pa] on
    their way, the last first.
    """

    angle: Scalar
    velocity: Scalar
    pressures: tuple[Scalar, Scalar]
    muscles: MuscleStates = NO_STATES
    io: IOState | tuple[()] = ()
    air: AirState | tuple[()] = ()
    friction: FrictionState = ()
    sent: tuple[tuple[Scalar, Scalar], ...] = ()


class Motion(NamedTuple):
    """Integrated part of a `PlantState`: angle [rad], angular velocity [rad/s], creep of both muscles [N].

    With an actuator that `holds_air` pressures [Pa] and the state of the valves as well.
    """

    angle: Scalar
    velocity: Scalar
    creep: tuple[CreepState, CreepState] = ((), ())
    pressures: tuple[Scalar, Scalar] | tuple[()] = ()
    air: AirState | tuple[()] = ()

    @classmethod
    def of(cls, state: PlantState) -> Motion:
        """Return the integrated part of a state."""
        muscle1, muscle2 = state.muscles
        pressures = state.pressures if isinstance(state.air, AirState) else ()
        return cls(state.angle, state.velocity, (muscle1.creep, muscle2.creep), pressures, state.air)

    def applied_to(self, state: PlantState, pressures: tuple[Scalar, Scalar]) -> PlantState:
        """Return a state with this motion, and other pressures [Pa] unless they are part of it."""
        (friction1, _), (friction2, _) = state.muscles
        muscles = MuscleState(friction1, self.creep[0]), MuscleState(friction2, self.creep[1])
        pressures = self.pressures or pressures
        return state._replace(
            angle=self.angle, velocity=self.velocity, pressures=pressures, muscles=muscles, air=self.air
        )


class JointPlant(Component):
    """The simulated system, of joint, load, valves, sensors and disturbance; controllers have no access to it.

    `friction` is that of the joint itself, None for none; that of a muscle belongs to the muscle. `command_delay` is
    the time from a command to the valves [s]; `delay_periods`, its length in control periods, is set by `with_period`.
    """

    joint: AntagonisticJoint
    load: Load
    valve: Actuator
    sensors: Sensors = PerfectSensors()
    disturbance: Disturbance = NoDisturbance()
    friction: JointFriction | None = None
    command_delay: CommandDelay | None = eqx.field(kw_only=True, default=None)
    delay_periods: int = eqx.field(kw_only=True, default=0, static=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.valve.holds_air:
            for muscle in (self.joint.muscle1, self.joint.muscle2):
                muscle.specimen.check_volume(f"a {type(self.valve).__name__} that fills the volume")

    def __repr__(self) -> str:
        parts = [self.valve] if self.has_ideal_io else [self.valve, self.sensors, self.disturbance]
        return f"JointPlant({self.joint!r}, {', '.join(type(part).__name__ for part in parts)})"

    @property
    def has_ideal_io(self) -> bool:
        """Whether sensors are perfect and there is no disturbance."""
        return isinstance(self.sensors, PerfectSensors) and isinstance(self.disturbance, NoDisturbance)

    @property
    def slips(self) -> bool:
        """Whether internal states of friction or creep are updated after each integration step (`project`)."""
        return self.joint.has_friction or self.joint.has_creep or self.friction is not None

    @property
    def supplied_joint(self) -> AntagonisticJoint:
        """The joint with its muscles rated for the supply of the valves, where that is below their own rating."""
        supply = getattr(self.valve, "supply", None)
        if supply is None:
            return self.joint

        def highest(joint: AntagonisticJoint) -> tuple[Any, Any]:
            return joint.muscle1.specimen.domain.pressure_max, joint.muscle2.specimen.domain.pressure_max

        limits = tuple(jnp.minimum(jnp.asarray(rated), supply) for rated in highest(self.joint))
        return eqx.tree_at(highest, self.joint, limits)

    def with_ideal_io(self) -> JointPlant:
        """Return the plant with perfect sensors, and without disturbance and delay of the commands."""
        sensors, disturbance = PerfectSensors(), NoDisturbance()
        return dataclasses.replace(self, sensors=sensors, disturbance=disturbance, command_delay=None, delay_periods=0)

    def with_period(self, period: float) -> JointPlant:
        """Return the plant with states that hold the commands on their way, one each control period [s].

        Raises `RangeError` for a delay of more than 100 periods.
        """
        if self.command_delay is None:
            return self
        longest = float(np.max(self.command_delay))
        periods = math.ceil(longest / period - _ROUNDING)
        if periods > _MOST_PERIODS:
            raise RangeError(
                f"a command delay of {longest:g} s is {periods} control periods of {period:g} s",
                field="command_delay",
                value=longest,
                upper=_MOST_PERIODS * period,
                unit="s",
                remedy=f"give at most {_MOST_PERIODS} periods",
            )
        return dataclasses.replace(self, delay_periods=periods)

    def sample(self, state: PlantState, period: ArrayLike) -> tuple[PlantState, Measurement]:
        """Return the state at the start of a control period [s], with its disturbance, and the measurement."""
        true, io = Measurement(state.angle, state.pressures), state.io
        if not isinstance(io, IOState):
            return state, true
        sensors, measured = self.sensors.measure(io.sensors, io.sample, true)
        disturbance = floating(self.disturbance.torque(io.sample * period))
        return state._replace(io=IOState(io.sample + 1, disturbance, sensors)), measured

    def clip_commands(self, commands: Pressures) -> tuple[Scalar, Scalar]:
        """Return the commands [Pa] clipped to the specimens' rated pressures and to the supply.

        Openings of valves with `direct` commands are clipped to -1..1.
        """
        rated1, rated2 = self.joint.muscle1.specimen.domain, self.joint.muscle2.specimen.domain
        return self.valve.clip_command(commands[0], rated1), self.valve.clip_command(commands[1], rated2)

    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> Float[Array, "..."]:
        """Return the total stiffness [N*m/rad], of muscles and gravity."""
        return self.joint.stiffness(angle, pressures) + self.load.gravity_stiffness(angle)

    def apply_commands(self, state: PlantState, commands: Pressures) -> PlantState:
        """Return the state right after new commands [Pa]."""
        if self.valve.holds_air:
            return state
        pressure1, pressure2 = map(self.valve.after_command, state.pressures, commands)
        return state._replace(pressures=(pressure1, pressure2))

    def arriving(self, state: PlantState, commands: Pressures, period: ArrayLike) -> Pressures:
        """Return the commands [Pa] that reach the valves in a control period [s], of which new ones are sent.

        With a delay between two multiples of the period they are their mean over it.
        """
        if not state.sent:
            return commands
        late = jnp.minimum(jnp.asarray(self.command_delay) / period, len(state.sent))
        shares = [jnp.maximum(1 - jnp.abs(late - number), 0.0) for number in range(len(state.sent) + 1)]
        first, second = (
            sum(share * jnp.asarray(command) for share, command in zip(shares, side, strict=True))
            for side in zip(commands, *state.sent, strict=True)
        )
        return first, second

    def follow(self, state: PlantState, commands: Pressures, period: ArrayLike, substeps: int) -> PlantState:
        """Return the state after a control period [s] at whose start commands [Pa] are sent to the valves."""
        sent = (commands, *state.sent)[: len(state.sent)]
        after = self.advance(state._replace(sent=()), self.arriving(state, commands, period), period, substeps)
        return after._replace(sent=sent)

    def advance(self, state: PlantState, commands: Pressures, duration: ArrayLike, substeps: int) -> PlantState:
        """Return the state after a duration [s] under constant commands [Pa], by Runge-Kutta steps of equal length.

        A closed form gives the pressures where there is one; motion and creep are integrated, and air.
        """
        step = duration / substeps
        valve: Any = self.valve
        if valve.holds_air:
            return self._advance_with_air(valve, state, commands, step, substeps)

        def integrate(_: Array, state: PlantState) -> PlantState:
            def rate(motion: Motion, pressure1: Scalar, pressure2: Scalar) -> Motion:
                return self.rate(motion.applied_to(state, (pressure1, pressure2)))

            end, held = valve.all_after(state.pressures, state.air, commands, step)
            middle, _ = valve.all_after(state.pressures, state.air, commands, step / 2)
            state = state._replace(air=())
            motion = rk4(rate, Motion.of(state), step, (state.pressures, middle, end))
            return self.project(motion.applied_to(state, end))._replace(air=held)

        return lax.fori_loop(0, substeps, integrate, self.apply_commands(state, commands))

    def _advance_with_air(
        self, valve: Any, state: PlantState, commands: Pressures, step: ArrayLike, substeps: int
    ) -> PlantState:
        """Return the state after steps of a length [s] in which motion and air are integrated together."""

        def integrate(_: Array, state: PlantState) -> PlantState:
            assert isinstance(state.air, AirState)
            valve1, valve2 = (
                valve.before_step(*each, step) for each in zip(state.air.valves, commands, state.pressures, strict=True)
            )
            state = state._replace(air=state.air._replace(valves=(valve1, valve2)))

            def rate(motion: Motion) -> Motion:
                at = motion.applied_to(state, state.pressures)
                assert isinstance(at.air, AirState)
                pressures, air = valve.air_rate(at.pressures, at.air, commands, self.air_volumes(at))
                return self.rate(at)._replace(pressures=pressures, air=air)

            motion = rk4(rate, Motion.of(state), step)
            return self.project(motion.applied_to(state, state.pressures))

        return lax.fori_loop(0, substeps, integrate, state)

    def air_volumes(self, state: PlantState) -> tuple[AirVolume, AirVolume]:
        """Return the volumes of the air, dead volume included, at the velocity of a state."""
        dead = self.valve.dead_volume

        def volumes(angle: ArrayLike, pressures: Pressures) -> tuple[Array, Array]:
            contraction1, contraction2 = self.joint.contractions(angle, pressures, state.muscles)
            specimen1, specimen2 = self.joint.muscle1.specimen, self.joint.muscle2.specimen
            return specimen1.volume(contraction1) + dead, specimen2.volume(contraction2) + dead

        at, slopes = value_and_derivative(lambda angle: volumes(angle, state.pressures), state.angle)
        by_pressure: Any = (None, None)
        if not isinstance(self.joint.tendon, RigidTendon):
            ones = jax.tree.map(jnp.ones_like, state.pressures)
            by_pressure = jax.jvp(lambda held: volumes(state.angle, held), (state.pressures,), (ones,))[1]
        volume1, volume2 = map(AirVolume, at, (slope * state.velocity for slope in slopes), by_pressure)
        return volume1, volume2

    def commands_for(self, state: PlantState, rates: Pressures) -> tuple[Array, Array]:
        """Return the commands [Pa] at which the pressures change at rates [Pa/s]; infinite where none does."""
        given = zip(state.pressures, rates, strict=True)
        valve: Any = self.valve
        if valve.holds_air:
            each = zip(given, self.air_volumes(state), strict=True)
            command1, command2 = (valve.command_for(*pair, volume) for pair, volume in each)
        else:
            command1, command2 = (valve.command_for(*pair) for pair in given)
        return command1, command2

    def rate(self, state: PlantState) -> Motion:
        """Return the time derivative of the motion (Eq. 6) at the pressures of a state."""
        angle, velocity, pressures, muscles, io, _, friction, _ = state
        creep1, creep2 = (state.creep for state in self.joint.state_rate(muscles, angle, velocity))
        if muscles == NO_STATES:
            torque = self.joint.torque(angle, pressures)
        else:
            torque = self.joint.forces(angle, velocity, pressures, muscles).torque
        if isinstance(io, IOState):
            torque = torque + io.disturbance
        if self.friction is not None and friction:
            torque = torque - self.friction.resisting_torque(friction, angle)
        return Motion(velocity, self.load.acceleration(angle, velocity, torque), (creep1, creep2))

    def project(self, state: PlantState) -> PlantState:
        """Return the state after an integration step with updated internal states; no force changes by it."""
        friction = state.friction
        if self.friction is not None and friction:
            friction = self.friction.project(friction, state.angle)
        muscles = self.joint.update_state(state.muscles, state.angle, state.pressures)
        return state._replace(muscles=muscles, friction=friction)

    def init_state(self, angle: ArrayLike, pressures: Pressures) -> PlantState:
        """Return the state without velocity at an angle [rad] and gauge pressures [Pa], its muscles relaxed."""
        angle = floating(angle)
        pressure1, pressure2 = map(floating, pressure_pair(pressures))
        return self.complete_state(PlantState(angle, jnp.zeros_like(angle), (pressure1, pressure2)))

    def complete_state(self, state: PlantState) -> PlantState:
        """Return a state with initial values for the internal states, the io state and the commands that it lacks."""
        angle, _, pressures, given, io, air, friction, sent = state
        initial = self.joint.init_state(angle, pressures)
        muscle1, muscle2 = (MuscleState(*map(_given_or, *pair)) for pair in zip(given, initial, strict=True))
        if io == () and not self.has_ideal_io:
            zero = jnp.zeros_like(floating(angle))
            io = IOState(zero, zero, self.sensors.init(Measurement(angle, pressures)))
        if air == ():
            air = self.valve.init_states((floating(pressures[0]), floating(pressures[1])))
        if friction == () and self.friction is not None:
            friction = self.friction.initial(angle)
        state = state._replace(muscles=(muscle1, muscle2), io=io, air=air, friction=friction)
        if sent == () and self.delay_periods:
            state = state._replace(sent=(self._holding(state),) * self.delay_periods)
        return state

    def _holding(self, state: PlantState) -> tuple[Scalar, Scalar]:
        """Return the commands [Pa] at which the pressures stay; the opening 0 of valves with `direct` commands."""
        zero = jnp.zeros_like(floating(state.angle))
        if self.valve.direct:
            return zero, zero
        return self.clip_commands(self.commands_for(state, (zero, zero)))

    def find_equilibrium(self, angle: ArrayLike, stiffness: ArrayLike) -> tuple[PlantState, Bool[Array, ""]]:
        """Return the state of `equilibrium` and whether it exists, for traced numbers; NaN for no given stiffness."""
        state, _, found = _equilibrium(self, angle, stiffness)
        return state, found.exists

    def equilibrium(self, angle: float = 0.0, *, stiffness: float | None = None) -> PlantState:
        """Return the equilibrium at an angle [rad] with both muscles taut, relaxed and unstressed by friction.

        Pressures are within the supply of the valves. The stiffness [N*m/rad] is midway between the slackest and the
        tightest state unless given.

        Raises
        ------
        UnreachableError
            If no pressures within limits balance the load, or give the stiffness; with the attainable range.
        RangeError
            If a muscle would leave its domain, or a number is not finite.
        """
        check_finite(angle=angle, stiffness=0.0 if stiffness is None else stiffness)
        wanted = math.nan if stiffness is None else stiffness
        state, torque, found = _equilibrium(self, angle, wanted)
        if not found.exists:
            raise_unattainable(self.supplied_joint, found, float(angle), float(torque), float(wanted))
        return state


def _given_or(given: tuple[Array, ...], initial: tuple[Array, ...]) -> tuple[Array, ...]:
    return given if len(given) else initial


@compiled
def _equilibrium(plant: JointPlant, angle: ArrayLike, stiffness: ArrayLike) -> tuple[PlantState, Array, StaticSolution]:
    """Return the equilibrium, the muscles' torque [N*m] in it, and the static solution, from one program."""
    torque = -plant.load.gravity_torque(angle)
    found = solve_static(plant.supplied_joint, angle, torque, stiffness)
    return plant.init_state(angle, found.pressures), torque, found
