"""Common base of all plants: actuators, sensors, delayed commands, and the integration over a control period."""

from __future__ import annotations

import abc
import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import Actuator, AirState, AirVolume, air_volumes, delay_periods
from mckibben.component.base import Component
from mckibben.errors import RangeError, SimulationError
from mckibben.joint import Measurement
from mckibben.joint.route import init_states, update_states
from mckibben.mechanism.base import Mechanism
from mckibben.mechanism.disturbance import Disturbance, NoDisturbance
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.muscle import Muscle, MuscleState
from mckibben.muscle.friction import FrictionState
from mckibben.numerics.batching import fusion_barrier
from mckibben.numerics.calculus import rk4, value_and_derivative
from mckibben.numerics.elementary import floating
from mckibben.numerics.spatial import difference, total
from mckibben.plant.sensors import PerfectSensors, Sensors
from mckibben.plant.state import Forces, IOState, LastStep, Motion, PlantState
from mckibben.units import CommandDelay

STABILITY_LIMIT = 2.785
"""Largest product of step and mode on the negative real axis at which the classical Runge-Kutta method is stable."""

HERMITE_LIMIT = 1.19
"""Largest product of step and mode, of any damping, at which the steps of `Plant.with_last_step` are stable."""

MOST_HERMITE = 2
"""Largest number of coordinates, with two muscles each, for which these steps are faster than others: both add
derivatives."""

MOST_SUBSTEPS = 1000
"""Largest number of integration steps per control period."""

_SLOWER = {
    "the motion": "less damping and stiffness, or more inertia",
    "the friction of the ground": "a ground with a higher slip speed",
    "the air": "a valve with less conductance, a wider band, a slower spool or regulator, or more dead volume",
}
_ROUNDING = 1e-9

Scalar = Float[Array, ""]

Angles = ArrayLike | Sequence[ArrayLike]
"""Angles [rad] of one joint, as an array, or one of each joint."""


class Plant(Component):
    """A mechanism moved by muscles, with actuators, sensors, disturbances and a delay of the commands.

    Commands are constant over a control period. Within it, the motion is integrated in steps of equal length: those of
    the two-point Hermite method if it is smooth (`with_last_step`), else of the classical method of Runge and Kutta.
    Pressures follow in closed form, or, with air, are integrated along. After each step `project` updates the internal
    states of friction and creep, by which no force changes.

    Parameters
    ----------
    sensors
        Model of the sensors, read once in a control period; perfect by default.
    command_delay
        Time from a command to the valves [s]; a delay that is no multiple of the control period mixes two commands.
    delay_periods
        Its length in control periods, set by `with_period`.
    """

    sensors: Sensors = eqx.field(kw_only=True, default=PerfectSensors())
    command_delay: CommandDelay | None = eqx.field(kw_only=True, default=None)
    delay_periods: int = eqx.field(kw_only=True, default=0, static=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        count = self._valve.muscle_count
        if count is not None and count != len(self.muscles):
            message = f"{type(self).__name__}: a {type(self._valve).__name__} is for {count} muscles, "
            message += f"and there are {len(self.muscles)}"
            raise RangeError(message, field="valve", remedy="give an actuator that all muscles have")

    @property
    def _valve(self) -> Actuator:
        """The field `valve` of each plant, in its own order of arguments."""
        return self.valve  # type: ignore[attr-defined]

    def valve_of(self, muscle: int) -> Actuator:
        """Return the actuator of one muscle."""
        return self._valve.for_muscle(muscle)

    @property
    def supply(self) -> float:
        """Gauge pressure of the supply of the valves [Pa]; infinite where they have none."""
        return float(getattr(self._valve, "supply", None) or math.inf)

    @property
    def has_friction(self) -> bool:
        """Whether muscles or joints have friction."""
        return any(muscle.has_friction for muscle in self.muscles) or self._has_joint_friction

    @property
    @abc.abstractmethod
    def mechanism(self) -> Mechanism:
        """Joints and loads that the muscles move."""

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        """All muscles, in the order of commands and pressures."""
        return self.mechanism.muscles

    @property
    @abc.abstractmethod
    def disturbances(self) -> tuple[Disturbance, ...]:
        """Disturbances of all joints."""

    @abc.abstractmethod
    def with_disturbances(self, disturbances: Sequence[Disturbance]) -> Self:
        """Return the plant with other disturbances, one of each joint."""

    def with_ideal_io(self) -> Self:
        """Return the plant with perfect sensors, and without disturbances and delay of the commands."""
        plant = self.with_disturbances((NoDisturbance(),) * len(self.disturbances))
        return dataclasses.replace(plant, sensors=PerfectSensors(), command_delay=None, delay_periods=0)

    def true_measurement(self, state: PlantState) -> Measurement:
        """Return what perfect sensors measure: angle [rad] and gauge pressures [Pa]."""
        return Measurement(state.angle, state.pressures)  # type: ignore[arg-type]  # of any number of joints

    def disturbing_torque(self, time: ArrayLike) -> Any:
        """Return the torque [N*m] of the disturbances at a time [s] since the start."""
        return self.mechanism.like_joints([floating(disturbance.torque(time)) for disturbance in self.disturbances])

    @property
    def is_smooth(self) -> bool:
        """Whether steps are those of `with_last_step`: nothing slips, touches the ground or disturbs, up to two joints
        move, and pressures are those of linear valves in closed form.
        """
        valve, mechanism = self._valve, self.mechanism
        large = mechanism.coordinates > MOST_HERMITE or len(self.muscles) > 2 * MOST_HERMITE
        if self.slips or mechanism.has_contacts or large or not self.has_ideal_io:
            return False
        return valve.is_linear and valve.holds_pressure and not valve.holds_air

    @property
    def slips(self) -> bool:
        """Whether internal states of friction or creep are updated after each integration step (`project`)."""
        return any(muscle.has_friction or muscle.has_creep for muscle in self.muscles) or self._has_joint_friction

    @property
    def _has_joint_friction(self) -> bool:
        return any(friction is not None for friction in self.mechanism.frictions)

    @property
    def stability_limit(self) -> float:
        """Largest product of an integration step and the fastest rate."""
        return HERMITE_LIMIT if self.is_smooth else STABILITY_LIMIT

    def forces(self, state: PlantState) -> Forces:
        """Return the forces of the muscles, and the torques, in a state."""
        mechanism = self.mechanism
        position, velocity = state.position, state.velocity
        rates = mechanism.by_joint(velocity)
        resistance: list[Any] = [0.0] * len(rates)  # minus the torque of the muscles
        tensions, contractions, path_rates = [], [], []
        for route, pressure, held in zip(mechanism.routes(position), state.pressures, state.muscles, strict=True):
            path_rate = route.rate(rates)
            tension, contraction = route.forces(pressure, held, path_rate)
            for joint, slope in route.slopes.items():
                resistance[joint] = total(resistance[joint], tension * slope)
            tensions.append(tension)
            contractions.append(contraction)
            path_rates.append(path_rate)
        torques = [difference(0.0, torque) for torque in resistance]
        if isinstance(state.io, IOState):
            torques = list(map(total, torques, mechanism.by_joint(state.io.disturbance)))
        for joint, (friction, held, at) in enumerate(self._joint_frictions(state)):
            if friction is not None:
                torques[joint] = difference(torques[joint], friction.resisting_torque(held, at))
        return Forces(tuple(tensions), tuple(contractions), tuple(path_rates), tuple(torques))

    def _joint_frictions(self, state: PlantState) -> Iterator[tuple[JointFriction | None, FrictionState, Scalar]]:
        """Friction of each joint with its state and position; none if no joint has friction."""
        if state.friction == ():
            return iter(())
        by_joint = self.mechanism.by_joint
        return zip(self.mechanism.frictions, by_joint(state.friction), by_joint(state.position), strict=True)

    def rate(self, state: PlantState) -> Motion:
        """Return the time derivative of the motion (Eq. 6), and of creep, at the pressures of a state."""
        forces, velocity = self.forces(state), state.velocity
        acceleration = self.acceleration(state, forces.torques)
        muscles = zip(self.muscles, state.muscles, forces.path_rates, state.pressures, strict=True)
        creep = tuple(muscle.state_rate(held, rate, pressure).creep for muscle, held, rate, pressure in muscles)
        return Motion(velocity, acceleration, creep)

    def acceleration(self, state: PlantState, torques: Sequence[Array]) -> PyTree:
        """Return the acceleration [rad/s^2, m/s^2] under torques [N*m] by joint, in the form of a velocity."""
        return self.mechanism.acceleration(state.position, state.velocity, torques)

    def project(self, state: PlantState) -> PlantState:
        """Return the state after an integration step with updated internal states; no force changes by it."""
        if state.friction != ():
            frictions = [
                held if friction is None else friction.project(held, at)
                for friction, held, at in self._joint_frictions(state)
            ]
            state = state._replace(friction=self.mechanism.like_joints(frictions))
        if not any(held.friction or held.creep for held in state.muscles):
            return state
        return state._replace(
            muscles=update_states(self.mechanism.routes(state.position), state.muscles, state.pressures)
        )

    def air_volumes(self, state: PlantState) -> Sequence[AirVolume]:
        """Return the volume of the air of each muscle, dead volume included, at the velocity of a state."""
        dead_volumes = [self._valve.for_muscle(i).attached_volume for i in range(len(state.pressures))]
        routes, rates = self.mechanism.routes(state.position), self.mechanism.by_joint(state.velocity)
        return air_volumes(routes, rates, state.pressures, state.muscles, dead_volumes)

    def init_muscles(self, state: PlantState) -> tuple[MuscleState, ...]:
        """Return the relaxed states of the muscles at the positions and pressures of a state."""
        return init_states(self.mechanism.routes(state.position), state.pressures)

    def init_friction(self, state: PlantState) -> Any:
        """Return the unstressed states of the friction of the joints at the positions of a state."""
        if not self._has_joint_friction:
            return ()
        joints = zip(self.mechanism.frictions, self.mechanism.by_joint(state.position), strict=True)
        return self.mechanism.like_joints([() if own is None else own.initial(at) for own, at in joints])

    @abc.abstractmethod
    def fastest_rates(self, angles: Angles, stiffness: ArrayLike | None = 0.0) -> dict[str, float]:
        """Return the rates [1/s] that integration steps must resolve by their cause, near angles [rad]."""

    def needed_substeps(self, angles: Angles, stiffness: ArrayLike | None, period: float) -> int:
        """Return the least number of integration steps in a period [s] that resolves the fastest rate of the plant.

        At the extreme angles [rad] of a joint, with a stiffness [N*m/rad], or at the angles of all joints of a robot.
        Raises `SimulationError` if there is none up to 1000.
        """
        needed = max(self.fastest_rates(angles, stiffness).values()) * period / self.stability_limit
        if not needed <= MOST_SUBSTEPS:
            self.check_substeps(angles, stiffness, period, MOST_SUBSTEPS)
        return max(math.ceil(needed * (1 - _ROUNDING)), 1) if math.isfinite(needed) else 1

    def check_substeps(self, angles: Angles, stiffness: ArrayLike | None, period: float, substeps: int) -> None:
        """Raise `SimulationError` if integration steps do not resolve the fastest rate, as for `needed_substeps`."""
        what, fastest = max(self.fastest_rates(angles, stiffness).items(), key=lambda item: item[1])
        needed = fastest * period / self.stability_limit
        if math.isfinite(needed) and needed > substeps * (1 + _ROUNDING):
            raise SimulationError(
                f"integration steps of {period / substeps * 1e3:g} ms do not resolve {what}: "
                f"{period / needed * 1e3:.2g} ms would",
                field="substeps",
                value=substeps,
                lower=math.ceil(needed),
                remedy=f"give at least {math.ceil(needed)} substeps, a shorter control period, or "
                f"{_SLOWER.get(what, 'a softer or slower component')}",
            )

    def check_start(self, start: Any) -> None:
        """Raise `RangeError` where the plain numbers of a start are not possible; a state always is."""

    @abc.abstractmethod
    def unpressurised(self) -> PlantState:
        """Return the state at rest without pressures, at angles of 0 or as near as stops permit."""

    def outputs(self, state: PlantState) -> dict[str, Array]:
        """Return further quantities of a state that an exported plant has, by name."""
        return {}

    def begin(self, start: Any) -> PlantState:
        """Return the state of a start; by default a start is a state."""
        return start._replace(last=())

    def with_last_step(self, state: PlantState, step: ArrayLike) -> PlantState:
        """Return the state from which steps of a length [s] evaluate the torque once; unchanged unless `is_smooth`.

        They are those of the two-point Hermite method of order 4, which is implicit (E. Hairer, S. P. Norsett and G.
        Wanner, Solving Ordinary Differential Equations I, III.4). The next state is predicted by a Taylor polynomial;
        the torque and its derivatives there, which a controller and the metrics need as well, correct it in the step
        that follows.
        """
        if not self.is_smooth:
            return state
        positions, velocities = map(self.mechanism.by_joint, (state.position, state.velocity))
        accelerations, slopes = self._derivatives(state)
        changes = _rate_of(slopes, (*velocities, *accelerations))
        third = step**2 / 12
        return state._replace(
            last=LastStep(
                _by_joint(lambda x, v, a: x - step / 2 * v + third * a, positions, velocities, accelerations),
                _by_joint(lambda v, a, j: v - step / 2 * a + third * j, velocities, accelerations, changes),
                tuple(jnp.zeros_like(pressure) for pressure in state.pressures),
            )
        )

    def observe(self, state: PlantState) -> Any:
        """Return what a run records of a state at the start of a control period; by default the state."""
        return state._replace(last=())

    def telemetry(self, state: PlantState, commands: Sequence[ArrayLike], period: ArrayLike) -> dict[str, Any]:
        """Return further quantities of a control period [s], at whose start commands [Pa] are sent, by name."""
        return {}

    @property
    def has_ideal_io(self) -> bool:
        """Whether sensors are perfect and there is no disturbance."""
        quiet = all(isinstance(disturbance, NoDisturbance) for disturbance in self.disturbances)
        return isinstance(self.sensors, PerfectSensors) and quiet

    def with_period(self, period: float) -> Self:
        """Return the plant with states for commands on their way, a period [s] each; `RangeError` for more than 100."""
        if self.command_delay is None:
            return self
        return dataclasses.replace(self, delay_periods=delay_periods(self.command_delay, period))

    def sample(self, state: PlantState, period: ArrayLike) -> tuple[PlantState, Any]:
        """Return the state at the start of a control period [s], with its disturbance, and the measurement.

        The disturbance [N*m] holds until the next sample.
        """
        true, io = self.true_measurement(state), state.io
        if not isinstance(io, IOState):
            return state, true
        sensors, measured = self.sensors.measure(io.sensors, io.sample, true)
        disturbance = self.disturbing_torque(io.sample * period)
        return state._replace(io=IOState(io.sample + 1, disturbance, sensors)), measured

    def clip_commands(self, commands: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] within the rated pressures and the supply, or openings within -1..1."""
        rated = (muscle.specimen.domain for muscle in self.muscles)
        muscles = enumerate(zip(commands, rated, strict=False))  # `clip_commands` of each plant checks the count
        return tuple(self._valve.for_muscle(i).clip_command(*muscle) for i, muscle in muscles)

    def apply_commands(self, state: PlantState, commands: Sequence[ArrayLike]) -> PlantState:
        """Return the state right after new commands [Pa]."""
        if self._valve.holds_air:
            return state
        muscles = enumerate(zip(state.pressures, commands, strict=True))
        return state._replace(
            pressures=tuple(self._valve.for_muscle(i).after_command(*muscle) for i, muscle in muscles)
        )

    def arriving(self, state: PlantState, commands: Sequence[ArrayLike], period: ArrayLike) -> tuple[ArrayLike, ...]:
        """Return the mean commands [Pa] at the valves in a control period [s], at whose start new ones are sent."""
        if not state.sent:
            return tuple(commands)
        late = jnp.minimum(jnp.asarray(self.command_delay) / period, len(state.sent))
        shares = [jnp.maximum(1 - jnp.abs(late - number), 0.0) for number in range(len(state.sent) + 1)]
        return tuple(
            sum(share * jnp.asarray(command) for share, command in zip(shares, side, strict=True))
            for side in zip(commands, *state.sent, strict=True)
        )

    def follow(self, state: PlantState, commands: Sequence[ArrayLike], period: ArrayLike, substeps: int) -> PlantState:
        """Return the state after a control period [s] at whose start commands [Pa] are sent to the valves.

        With a `command_delay` the valves receive earlier commands, which the state holds.
        """
        sent = (tuple(commands), *state.sent)[: len(state.sent)]
        after = self.advance(state._replace(sent=()), self.arriving(state, commands, period), period, substeps)
        return after._replace(sent=sent)

    def advance(
        self, state: PlantState, commands: Sequence[ArrayLike], duration: ArrayLike, substeps: int
    ) -> PlantState:
        """Return the state after a duration [s] under constant commands [Pa], by integration steps of equal length."""
        step, valve = duration / substeps, self._valve
        one_step = self._step_with_air if valve.holds_air else self._step

        def integrate(_: Array, state: PlantState) -> PlantState:
            return one_step(valve, state, commands, step)

        return lax.fori_loop(0, substeps, integrate, self.apply_commands(state, commands))

    def _derivatives(self, state: PlantState) -> tuple[tuple[Scalar, ...], list[tuple[Scalar, ...]]]:
        """Acceleration of each joint [rad/s^2], and its derivatives by all positions, velocities and pressures."""
        mechanism = self.mechanism
        positions, velocities = map(mechanism.by_joint, (state.position, state.velocity))
        count, point = len(positions), (*positions, *velocities, *state.pressures)

        def along(place: int) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
            def acceleration(x: Scalar) -> tuple[Scalar, ...]:
                moved = (*point[:place], x, *point[place + 1 :])
                at = state._replace(
                    position=mechanism.like_joints(moved[:count], state.position),
                    velocity=mechanism.like_joints(moved[count : 2 * count], state.velocity),
                    pressures=moved[2 * count :],
                )
                return mechanism.by_joint(self.rate(at).velocity)

            return value_and_derivative(acceleration, point[place])

        (accelerations, *_), slopes = zip(*map(along, range(len(point))), strict=True)
        return accelerations, list(slopes)

    def _hermite_step(
        self, valve: Actuator, state: PlantState, commands: Sequence[ArrayLike], step: ArrayLike, last: LastStep
    ) -> PlantState:
        """State after a step [s] with the pressures of a closed form; see `with_last_step`."""
        mechanism = self.mechanism
        positions, velocities = map(mechanism.by_joint, (state.position, state.velocity))
        predicted, slopes = fusion_barrier(self._derivatives, state)

        def pressures(elapsed: ArrayLike) -> Any:
            return valve.all_after(state.pressures, state.air, commands, elapsed)[0]

        third = step**2 / 12
        changes = _rate_of(slopes, (*velocities, *predicted, *last.rates))
        v = _by_joint(lambda v, a, j: v + step / 2 * a - third * j, last.velocities, predicted, changes)
        x = _by_joint(lambda x, v, a: x + step / 2 * v - third * a, last.positions, v, predicted)
        errors = (*map(operator.sub, x, positions), *map(operator.sub, v, velocities))
        a = tuple(map(operator.add, predicted, _rate_of(slopes, errors)))
        rates, bends = value_and_derivative(lambda t: value_and_derivative(pressures, t)[1], jnp.zeros_like(step))
        jerk = _rate_of(slopes, (*v, *a, *rates))
        snap = _rate_of(slopes, (*a, *jerk, *bends))  # without products of rates

        def end(x: Scalar, v: Scalar, a: Scalar, j: Scalar, s: Scalar) -> Scalar:
            return x + step * (v + step / 2 * (a + step / 3 * (j + step / 4 * s)))

        def end_rate(v: Scalar, a: Scalar, j: Scalar, s: Scalar) -> Scalar:
            return v + step * (a + step / 2 * (j + step / 3 * s))

        return state._replace(
            position=mechanism.like_joints(_by_joint(end, x, v, a, jerk, snap), state.position),
            velocity=mechanism.like_joints(_by_joint(end_rate, v, a, jerk, snap), state.velocity),
            pressures=pressures(step),
            air=valve.all_after(state.pressures, state.air, commands, step)[1],
            last=LastStep(
                _by_joint(lambda x, v, a: x + step / 2 * v + third * a, x, v, a),
                _by_joint(lambda v, a, j: v + step / 2 * a + third * j, v, a, jerk),
                value_and_derivative(pressures, step)[1],
            ),
        )

    def _step(self, valve: Actuator, state: PlantState, commands: Sequence[ArrayLike], step: ArrayLike) -> PlantState:
        """State after a step [s] with the pressures of a closed form."""
        if isinstance(last := state.last, LastStep):
            return self._hermite_step(valve, state, commands, step, last)

        def rate(motion: Motion, *pressures: Scalar) -> Motion:
            return self.rate(motion.applied_to(state, pressures))

        end, held = valve.all_after(state.pressures, state.air, commands, step)
        middle, _ = valve.all_after(state.pressures, state.air, commands, step / 2)
        state = state._replace(air=())
        rolled = len(self.muscles) > 2  # as fast, and compiled in half the time
        motion = rk4(rate, Motion.of(state), step, (state.pressures, middle, end), rolled=rolled)
        return self.project(motion.applied_to(state, end))._replace(air=held)

    def _step_with_air(
        self, valve: Actuator, state: PlantState, commands: Sequence[ArrayLike], step: ArrayLike
    ) -> PlantState:
        """State after a step [s] in which motion and air are integrated together."""
        assert isinstance(state.air, AirState)
        state = state._replace(air=valve.before_steps(state.air, commands, state.pressures, step))

        def rate(motion: Motion) -> Motion:
            at = motion.applied_to(state, state.pressures)
            assert isinstance(at.air, AirState)
            pressures, air = valve.air_rate(at.pressures, at.air, commands, self.air_volumes(at))
            return self.rate(at)._replace(pressures=pressures, air=air)

        motion = rk4(rate, Motion.of(state), step, rolled=True)
        return self.project(motion.applied_to(state, state.pressures))

    def commands_for(self, state: PlantState, rates: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] at which the pressures change at rates [Pa/s]; infinite if there are none."""
        muscles = enumerate(zip(state.pressures, rates, strict=True))
        valve = self._valve
        if not valve.holds_air:
            return tuple(valve.for_muscle(i).command_for(*muscle) for i, muscle in muscles)
        volumes = self.air_volumes(state)
        return tuple(valve.for_muscle(i).command_for(*muscle, volumes[i]) for i, muscle in muscles)

    def complete_state(self, state: PlantState) -> PlantState:
        """Return a state with initial values for the internal states, the io state and the commands that it lacks."""
        pairs = zip(state.muscles, self.init_muscles(state), strict=True)
        zero = jnp.zeros_like(floating(jax.tree.leaves(state.velocity)[0]))
        io, air = state.io, state.air
        if io == () and not self.has_ideal_io:
            torque = jax.tree.map(jnp.zeros_like, self.disturbing_torque(zero))
            io = IOState(zero, torque, self.sensors.init(self.true_measurement(state)))
        state = state._replace(
            muscles=tuple(MuscleState(*map(_given_or, *pair)) for pair in pairs),
            io=io,
            air=self._valve.init_states(tuple(map(floating, state.pressures))) if air == () else air,
            friction=self.init_friction(state) if state.friction == () else state.friction,
        )
        if state.sent == () and self.delay_periods:
            state = state._replace(sent=(self._holding(state, zero),) * self.delay_periods)
        return state

    def _holding(self, state: PlantState, zero: Scalar) -> tuple[Array, ...]:
        """Commands [Pa] at which the pressures stay; the opening 0 of valves with `direct` commands."""
        zeros = (zero,) * len(state.pressures)
        return zeros if self._valve.direct else self.clip_commands(self.commands_for(state, zeros))


def _given_or(values: tuple[Array, ...], initial: tuple[Array, ...]) -> tuple[Array, ...]:
    return values if len(values) else initial


def _by_joint(function: Callable[..., Scalar], *values: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """Apply a function to the values of each joint."""
    return tuple(map(function, *values))


def _rate_of(slopes: Sequence[tuple[Scalar, ...]], rates: Sequence[ArrayLike]) -> tuple[Scalar, ...]:
    """Rates of a function of each joint, from its derivatives by variables and the rates of the first of these."""
    columns = zip(*slopes[: len(rates)], strict=True)
    return tuple(functools.reduce(operator.add, map(operator.mul, column, rates)) for column in columns)
