"""Functions and identities of each base that the contract evaluates, with the ranges of their arguments.

A base has at least one function, of a component and numbers whose names select their ranges; from its results follow
the checks of batches, derivatives and C. An identity returns two results that must be equal for each component of the
base: a promise on which other code relies, such as that `pressure_for` inverts `force`.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree

from mckibben import catalog
from mckibben.actuator import Actuator, FirstOrderValve, Valve
from mckibben.actuator.base import AirState, AirVolume
from mckibben.control import Controller, Feedback, Loop, Observer, Reference, Setpoint, Signal, StageCost, StageEnd
from mckibben.control.base import DiscreteTimeSystem
from mckibben.control.robot_control import PressureSchedule, RobotController
from mckibben.joint import AntagonisticJoint, Geometry, Load, Measurement, MusclePath, Tendon
from mckibben.mechanism.base import RobotMeasurement
from mckibben.muscle import Creep, ForceLaw, Friction, Muscle
from mckibben.muscle.creep import CreepState, TensionAt
from mckibben.numerics.calculus import derivative
from mckibben.plant import Disturbance, JointFriction, Sensors
from mckibben.units import bar, mm, ms, percent

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of each argument in SI, in order."""

Num: TypeAlias = Array
"""A number of a component's function: a float, an array or a tracer."""

Tree: TypeAlias = PyTree
"""Tree of a component: a tree of numbers."""

PERIOD = 1 * ms
"""Control period [s] of the probes."""

_RANGES: Ranges = {
    "angle": (-0.4, 0.4),
    "area": (0.8e-4, 1.2e-4),
    "command": (0.5 * bar, 5 * bar),
    "contraction": (-3 * percent, 25 * percent),
    "elapsed": (0.5 * ms, 40 * ms),
    "error": (-0.1, 0.1),
    "force": (0.0, 100.0),
    "jerk": (1500.0, 2500.0),
    "acceleration": (-20.0, 20.0),
    "length": (170 * mm, 190 * mm),
    "measured": (-0.1, 0.1),
    "move": (-3 * mm, 3 * mm),
    "output": (-1 * bar, 1 * bar),
    "path": (150 * mm, 185 * mm),
    "period": (0.5 * ms, 2 * ms),
    "pressure": (0.5 * bar, 5 * bar),
    "rate": (-0.1, 0.1),
    "setpoint": (-0.1, 0.1),
    "shortfall": (-10.0, 10.0),
    "slope": (-1e4, 1e4),
    "step": (-1 * bar, 1 * bar),
    "stiffness": (12.0, 18.0),
    "swing": (-0.1, 0.1),
    "tension": (0.0, 300.0),
    "time": (0.0, 10.0),
    "torque": (-20.0, 20.0),
    "turn": (-2.0, 2.0),
    "velocity": (-3.0, 3.0),
}
"""Range of an argument by its name, without a number at its end."""


class Identity(NamedTuple):
    """A promise of a base: two results of a component and numbers that must be equal.

    Parameters
    ----------
    name
        Name of the check.
    function
        Function of a component and numbers that returns both results.
    remedy
        What the class must do, if they differ.
    """

    name: str
    function: Callable[..., tuple[Tree, Tree]]
    remedy: str


class Probes(NamedTuple):
    """What the contract evaluates of the components of a base.

    Parameters
    ----------
    functions
        Functions of a component and numbers, whose names select their ranges.
    identities
        Promises, see `Identity`.
    broadcasts
        Whether the functions take arrays.
    in_files, emitted
        Whether such components occur in files, and in emitted C.
    limits
        Ranges of the arguments of a component that differ from the usual ones.
    """

    functions: tuple[Callable[..., Tree], ...] = ()
    identities: tuple[Identity, ...] = ()
    broadcasts: bool = False
    in_files: bool = True
    emitted: bool = True
    limits: Callable[[Any], Ranges] = lambda _: {}

    def ranges(self, function: Callable[..., Tree], component: object) -> Ranges:
        """Return the range of each argument of a function [SI], for a component: its own limits, or the usual ones."""
        limits = self.limits(component)
        names = list(inspect.signature(function).parameters)[1:]
        return {name: limits.get(name.rstrip("12"), _RANGES[name.rstrip("12")]) for name in names}


def probes_of(component: object) -> Probes:
    """Return the probes of the nearest base of a component; empty for a class without functions.

    >>> [identity.name for identity in probes_of(catalog.load("knee-table-2")).identities]
    ['inverse', 'slope']
    """
    return next((_PROBES[base] for base in type(component).__mro__ if base in _PROBES), Probes())


@functools.cache
def plant_scope() -> dict[str, Any]:
    """Return the fields of a scenario around a component, with the knee of Table 2, for fields that inherit them."""
    knee = catalog.joint("knee-table-2")
    geometry = dataclasses.replace(knee.geometry, connector_length=208 * mm)  # pyrefly: ignore[unexpected-keyword]
    joint = AntagonisticJoint(geometry, knee.muscle1, knee.muscle2)
    return {
        "joint": joint,
        "load": catalog.load("knee-table-2"),
        "valve": FirstOrderValve(20 * ms),
        "specimen": knee.muscle1.specimen,
        "key": "angle",
    }


def _muscle() -> Muscle:
    return plant_scope()["joint"].muscle1


# Force laws.


def _force(law: ForceLaw, contraction: Num, pressure: Num) -> Tree:
    """Force [N], its slope [N], and the pressure [Pa] back from it."""
    force = law.force(contraction, pressure)
    return force, law.slope(contraction, pressure), law.pressure_for(force, contraction)


def _inverted(law: ForceLaw, contraction: Num, pressure: Num) -> tuple[Tree, Tree]:
    """F(eps, p(F, eps)) = F."""
    force = law.force(contraction, pressure)
    return law.force(contraction, law.pressure_for(force, contraction)), force


def _domain(law: ForceLaw) -> Ranges:
    """Contractions and pressures [Pa] of the domain of a law, with finite ends in place of infinite ones."""
    domain = law.domain.intersection(law.formula_domain)
    ends = {
        "contraction": (domain.contraction_min, domain.contraction_max, *_RANGES["contraction"]),
        "pressure": (domain.pressure_min, domain.pressure_max, 0.0, 6 * bar),
    }
    return {name: _finite(*map(float, limits)) for name, limits in ends.items()}


def _finite(low: float, high: float, least: float, most: float) -> tuple[float, float]:
    low = low if np.isfinite(low) else min(least, high)
    return low, high if np.isfinite(high) else max(most, low)


# Friction and creep of a muscle, friction of a joint.


def _moved(friction: Friction, length: Num, move: Num, tension: Num, pressure: Num, rate: Num) -> Tree:
    """State after a third of a move, and forces at its end."""
    state = friction.project(friction.initial(length), length + move / 3, tension, pressure)
    viscous = friction.viscous_force(length + move, tension, pressure, rate)
    return friction.force(state, length + move, tension, pressure), viscous, friction.half_width_at(tension, pressure)


def _moved_in_two(friction: Friction, length: Num, move: Num, tension: Num, pressure: Num) -> tuple[Tree, Tree]:
    """The force after two moves in one direction is that after their sum."""
    start, end = friction.initial(length), length + move
    middle = friction.project(start, length + move / 3, tension, pressure)
    return friction.force(middle, end, tension, pressure), friction.force(start, end, tension, pressure)


def _projected(friction: Friction, length: Num, move: Num, tension: Num, pressure: Num) -> tuple[Tree, Tree]:
    """`project` does not change the force."""
    end, start = length + move, friction.initial(length)
    after = friction.project(start, end, tension, pressure)
    return friction.force(after, end, tension, pressure), friction.force(start, end, tension, pressure)


def _path(friction: Friction, length: Num, move: Num, tension: Num, pressure: Num) -> tuple[Tree, Tree]:
    """`path_response` is the force of `force` and `project` along there and back."""
    path, forces = np.array([length, length + move, length]), []
    state = friction.initial(length)
    for end in path:
        forces.append(friction.force(state, end, tension, pressure))
        state = friction.project(state, end, tension, pressure)
    return friction.path_response(path, tension=float(tension), pressure=float(pressure)), np.array(forces)


_SLIDING = "two moves in one direction must give the force of their sum: keep what the force needs in the state"
_PROJECTION = "`project` keeps the force: it returns the state after the move"


def _crept(creep: Creep, length: Num, pressure: Num, step: Num, tension: Num, rate: Num, area: Num) -> Tree:
    """Force of creep [N], rates and projection of its state."""
    state, tension_at = _moved_creep(creep, length, pressure, step, tension, area)
    return creep.force(state, tension, tension_at), creep.rate(state, rate, pressure), creep.project(state, tension)


def _creep_projected(creep: Creep, length: Num, pressure: Num, step: Num, tension: Num, area: Num) -> tuple[Tree, Tree]:
    """`project` does not change the force of creep."""
    state, tension_at = _moved_creep(creep, length, pressure, step, tension, area)
    return creep.force(creep.project(state, tension), tension, tension_at), creep.force(state, tension, tension_at)


def _moved_creep(
    creep: Creep, length: Num, pressure: Num, step: Num, tension: Num, area: Num
) -> tuple[CreepState, TensionAt]:
    """State of creep, relaxed before a step of the pressure and a move, and the tension [N] over the pressure."""
    relaxed = creep.initial(length, pressure - step)
    rates = creep.rate(relaxed, step / bar, pressure)
    state = jax.tree.map(lambda x, rate: x + 0.1 * rate, relaxed, rates)
    return state, lambda at: jnp.maximum(tension + area * (at - pressure), 0.0)


def _turned(friction: JointFriction, angle: Num, swing: Num) -> Tree:
    """Resisting torque [N*m] after a swing in two parts."""
    return friction.resisting_torque(friction.project(friction.initial(angle), angle + swing / 3), angle + swing)


def _turned_in_two(friction: JointFriction, angle: Num, swing: Num) -> tuple[Tree, Tree]:
    """The torque after two swings in one direction is that after their sum."""
    return _turned(friction, angle, swing), friction.resisting_torque(friction.initial(angle), angle + swing)


# Tendons, geometries, paths and loads.


def _tension(tendon: Tendon, path: Num, pressure: Num, tension: Num) -> Tree:
    """Extension [m], tension [N] of muscle and tendon, pressure [Pa] for a tension, and whether it is permitted."""
    muscle = _muscle()
    pulled = tendon.tension(muscle, path, pressure), tendon.pressure_for(muscle, path, tension)
    return tendon.extension(tension), *pulled, tendon.permitted(muscle, path)


def _equilibrium(tendon: Tendon, path: Num, pressure: Num) -> tuple[Tree, Tree]:
    """Muscle length and extension at the tension of both add up to the path [m]."""
    muscle = _muscle()
    contraction = tendon.contraction(muscle, path, pressure)
    length = muscle.specimen.length_at(contraction)
    return length + tendon.extension(muscle.tension(contraction, pressure)), path


def _angles(geometry: Geometry | MusclePath) -> Ranges:
    low, high = _RANGES["angle"]
    return {"angle": (max(float(geometry.angle_range[0]), low), min(float(geometry.angle_range[1]), high))}


def _arms(geometry: Geometry, angle: Num) -> Tree:
    """Path lengths and moment arms [m]."""
    return geometry.path_lengths(angle), geometry.moment_arms(angle)


def _virtual_work(geometry: Geometry, angle: Num) -> tuple[Tree, Tree]:
    """Moment arms are the slopes of path lengths: dL1/dtheta = d1, dL2/dtheta = -d2."""
    slope1, slope2 = (derivative(lambda x, n=n: geometry.path_lengths(x)[n], angle) for n in (0, 1))
    return geometry.moment_arms(angle), (slope1, -slope2)


def _lengths(path: MusclePath, angle: Num) -> Tree:
    """Path lengths [m] of both sides."""
    return path.length(angle, 1), path.length(angle, -1)


def _acceleration(load: Load, angle: Num, velocity: Num, torque: Num) -> Tree:
    """Angular acceleration [rad/s^2], and stiffness of gravity [N*m/rad]."""
    return load.acceleration(angle, velocity, torque), load.gravity_stiffness(angle)


def _required(load: Load, angle: Num, velocity: Num, torque: Num) -> tuple[Tree, Tree]:
    """The torque for the acceleration of a torque is that torque [N*m]."""
    return load.required_torque(angle, velocity, load.acceleration(angle, velocity, torque)), torque


def _gravity(load: Load, angle: Num) -> tuple[Tree, Tree]:
    """Stiffness of gravity is -d(torque of gravity)/dtheta."""
    return load.gravity_stiffness(angle), -derivative(load.gravity_torque, angle)


# Actuators.


def _rates(actuator: Actuator, pressure1: Num, pressure2: Num, command1: Num, command2: Num) -> Tree:
    """Rates of pressures and states, commands after the delay, and telemetry."""
    pressures, commands = (pressure1, pressure2), (command1, command2)
    states, air = actuator.init_states(pressures), AirVolume(jnp.asarray(1e-4), jnp.asarray(1e-5))
    if actuator.holds_air and isinstance(states, AirState):
        states = actuator.before_steps(states, commands, pressures, 0.1 * ms)
    rates = actuator.rates(pressures, states, commands, lambda: (air, air))
    return rates, actuator.after_command(pressure1, command1), actuator.telemetry(states, commands, pressures)


def _response(valve: Valve, pressure: Num, command1: Num, command2: Num, elapsed: Num, slope: Num) -> Tree:
    """Pressures [Pa] after two commands, and the command for a rate."""
    moving = valve.after(pressure, valve.init(pressure), command1, elapsed)
    return valve.after(*moving, command2, elapsed), valve.command_for(pressure, slope)


def _composed(valve: Valve, pressure: Num, command1: Num, command2: Num, elapsed: Num) -> tuple[Tree, Tree]:
    """The pressure after two intervals of one command is that after their sum."""
    moving = valve.after(pressure, valve.init(pressure), command1, elapsed)
    twice = valve.after(*valve.after(*moving, command2, elapsed), command2, 1.6 * elapsed)
    return twice, valve.after(*moving, command2, 2.6 * elapsed)


def _at_rest(valve: Valve, pressure: Num, elapsed: Num) -> tuple[Tree, Tree]:
    """`command_for(p, 0)` keeps the pressure p of a valve at rest."""
    return valve.after(pressure, valve.init(pressure), valve.command_for(pressure, 0.0), elapsed)[0], pressure


_STATE = (
    "two intervals must give the result of their sum: the response lacks a state that it needs; return all that it "
    "depends on from `init` and `after`, as SecondOrderValve does"
)
_START = "`init` is the state at a constant pressure, and `command_for(pressure, 0)` the command that keeps it"


# Sensors and controllers.


def _measured(sensors: Sensors, angle1: Num, pressure1: Num, pressure2: Num, angle2: Num) -> Tree:
    """Measurements of two successive samples."""
    first, second = Measurement(angle1, (pressure1, pressure2)), Measurement(angle2, (pressure2, pressure1))
    state, before = sensors.measure(sensors.init(first), jnp.asarray(0), first)
    return before, sensors.measure(state, jnp.asarray(1), second)[1]


def _commands(
    controller: Controller,
    angle1: Num,
    angle2: Num,
    pressure1: Num,
    pressure2: Num,
    setpoint: Num,
    stiffness: Num,
) -> Tree:
    """Commands [Pa] at two successive angles, and telemetry."""
    measurements = [Measurement(angle, (pressure1, pressure2)) for angle in (angle1, angle2)]
    return _stepped(controller, Setpoint(setpoint, stiffness), measurements)


def _robot_step(system: RobotController, setpoint: Num, stiffness: Num, angle: Num, pressure: Num, force: Num) -> Tree:
    measurement = RobotMeasurement((angle, 0.5 + angle), (pressure,) * 5, force)
    return _stepped(system, (Setpoint(setpoint, stiffness),) * 2, [measurement] * 2)


def _scheduled(system: PressureSchedule, time: Num) -> Tree:
    return system.step((), time, RobotMeasurement((), (), time), PERIOD)[1]


def _stepped(system: DiscreteTimeSystem, setpoint: Tree, measurements: Sequence[Tree]) -> Tree:
    """Outputs for successive measurements, from a start at the first, and telemetry."""
    rows = jax.tree.map(lambda *values: jnp.stack(values), *measurements)
    start = system.init(measurements[0])
    state, outputs = lax.scan(lambda state, row: system.step(state, setpoint, row, PERIOD), start, rows)
    return outputs, system.telemetry(state)


def _looped(loop: Loop, setpoint: Num, measured: Num, output: Num) -> Tree:
    """Outputs of two steps with an output that is cut to 90 %."""

    def step(state: Tree, _: None) -> tuple[Tree, Num]:
        state, asked = loop.step(state, setpoint, measured, PERIOD)
        return loop.track(state, asked, 0.9 * asked, PERIOD), asked

    state, asked = lax.scan(step, loop.init(setpoint, measured, output), length=2)
    return asked, loop.telemetry(state)


def _residuals(cost: StageCost, angle: Num, turn: Num, stiffness: Num, pressure: Num) -> Tree:
    return cost.residuals(StageEnd(angle, turn, turn, stiffness, (pressure, pressure), Setpoint(angle, stiffness)))


def _fed_back(feedback: Feedback, error: Num, turn: Num, shortfall: Num, jerk: Num) -> Tree:
    """Acceleration [rad/s^2] that is asked for, with a jerk [rad/s^3] that the actuators attain, and the lag."""
    state = feedback.track(feedback.init(error), shortfall, PERIOD)
    return feedback.step(state, error, turn, jerk, PERIOD)[1], feedback.lag


def _observed(observer: Observer, angle1: Num, angle2: Num, acceleration: Num, period: Num) -> Tree:
    """Estimated motion after three samples, and gains."""
    motion = observer.init(angle1, acceleration)
    for angle in (angle2, angle1):
        motion = observer.step(motion, angle, acceleration, period)
    return tuple(motion), observer.gains(period)


def _value(signal: Signal | Reference, time: Num) -> Tree:
    return signal(time)


def _torque(disturbance: Disturbance, time: Num) -> Tree:
    return disturbance.torque(time)


_NARROW: Ranges = {"angle": (-0.1, 0.1), "pressure": (2 * bar, 4 * bar), "time": (0.0, 1.0)}
_SIGNAL = Probes((_value,), broadcasts=True, emitted=False)  # a reference is sampled before a run
_ROBOT = Probes((_robot_step,), in_files=False, limits=lambda _: _NARROW)
_PROBES: dict[type, Probes] = {
    ForceLaw: Probes(
        (_force,),
        (Identity("inverse", _inverted, "`pressure_for` inverts `force`; mckibben.muscle.pressure_for is numerical"),),
        broadcasts=True,
        limits=_domain,
    ),
    Friction: Probes(
        (_moved,),
        (
            Identity("composition", _moved_in_two, _SLIDING),
            Identity("projection", _projected, _PROJECTION),
            Identity("path", _path, "`path_response` gives the force of `force` and `project` along a path"),
        ),
        limits=lambda _: {"pressure": (0.0, 5 * bar)},
    ),
    Creep: Probes(
        (_crept,),
        (Identity("projection", _creep_projected, _PROJECTION),),
        limits=lambda _: {"pressure": (0.0, 5 * bar)},
    ),
    JointFriction: Probes((_turned,), (Identity("composition", _turned_in_two, _SLIDING),)),
    Tendon: Probes(
        (_tension,),
        (
            Identity(
                "equilibrium", _equilibrium, "`contraction` solves path = muscle length + `extension` at equal tension"
            ),
        ),
    ),
    Geometry: Probes(
        (_arms,),
        (
            Identity(
                "virtual work",
                _virtual_work,
                "moment arms are the slopes of the path lengths, that of muscle 2 with the opposite sign",
            ),
        ),
        broadcasts=True,
        limits=_angles,
    ),
    MusclePath: Probes((_lengths,), broadcasts=True, limits=_angles),
    Load: Probes(
        (_acceleration,),
        (
            Identity("inverse", _required, "`required_torque` inverts `acceleration`"),
            Identity("slope", _gravity, "`gravity_stiffness` is minus the slope of `gravity_torque`: override both"),
        ),
        broadcasts=True,
    ),
    Valve: Probes(
        (_rates, _response),
        (Identity("composition", _composed, _STATE), Identity("rest", _at_rest, _START)),
        limits=lambda valve: {"command": (-1.0, 1.0)} if valve.direct else {},
    ),
    Actuator: Probes((_rates,), limits=lambda actuator: {"command": (-1.0, 1.0)} if actuator.direct else {}),
    Sensors: Probes((_measured,)),
    Disturbance: Probes((_torque,), broadcasts=True),
    Signal: _SIGNAL,
    Reference: _SIGNAL,
    Controller: Probes((_commands,), limits=lambda _: _NARROW),
    Loop: Probes((_looped,)),
    Feedback: Probes((_fed_back,)),
    StageCost: Probes((_residuals,), limits=lambda _: _NARROW),
    Observer: Probes((_observed,), limits=lambda _: _NARROW),
    RobotController: _ROBOT,
    PressureSchedule: Probes((_scheduled,)),
}
