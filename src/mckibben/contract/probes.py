"""Functions and identities of each base that the contract evaluates, with the ranges of their arguments."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from mckibben import catalog
from mckibben.actuator import Actuator, FirstOrderValve, Valve
from mckibben.actuator.base import AirState, AirVolume
from mckibben.control import Controller, Feedback, Loop, Observer, Reference, Setpoint, Signal
from mckibben.control.base import DiscreteTimeSystem
from mckibben.joint import AntagonisticJoint, Geometry, Load, Measurement, MusclePath, Tendon
from mckibben.leg.control import LegController, LegReference
from mckibben.leg.plant import LegMeasurement
from mckibben.muscle import Creep, ForceLaw, Friction, Muscle
from mckibben.muscle.creep import CreepState, TensionAt
from mckibben.numerics.calculus import derivative
from mckibben.plant import Disturbance, JointFriction, Sensors
from mckibben.units import bar, mm, ms, percent

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of each argument in SI, in order."""

PERIOD = 1 * ms
"""Control period [s] of the probes."""
_JERK = 2000.0  # rad/s^3: attainable by the actuators
_PRESSURE, _LENGTH = (0.5 * bar, 5 * bar), (170 * mm, 190 * mm)


class Probe(NamedTuple):
    """A function of a component and numbers; one that `broadcasts` takes arrays of them as well."""

    function: Callable[..., Any]
    ranges: Ranges
    broadcasts: bool = False


class Identity(NamedTuple):
    """A promise of a base: two results of a component and numbers that must be equal, and the remedy if they differ."""

    name: str
    function: Callable[..., tuple[Any, Any]]
    ranges: Ranges
    remedy: str
    tolerance: float = 1e-8


class Probes(NamedTuple):
    """Functions and identities of a base; whether its components occur in files and in emitted C."""

    functions: tuple[Probe, ...]
    identities: tuple[Identity, ...] = ()
    in_files: bool = True
    emitted: bool = True


def probes_of(component: Any) -> Probes:
    """Return the probes of the nearest base of a component; empty for a class without functions."""
    return next((_PROBES[base](component) for base in type(component).__mro__ if base in _PROBES), Probes(()))


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


def _force(law: ForceLaw, contraction: Any, pressure: Any) -> Any:
    return law.force(contraction, pressure), law.slope(contraction, pressure)


def _inverse(law: ForceLaw, contraction: Any, pressure: Any) -> Any:
    return law.pressure_for(law.force(contraction, pressure), contraction)


def _inverted(law: ForceLaw, contraction: Any, pressure: Any) -> tuple[Any, Any]:
    force = law.force(contraction, pressure)
    return law.force(contraction, law.pressure_for(force, contraction)), force


def _law(law: ForceLaw) -> Probes:
    domain = law.domain.intersection(law.formula_domain)
    box = {
        "contraction": _finite(domain.contraction_min, domain.contraction_max, -3 * percent, 25 * percent),
        "pressure": _finite(domain.pressure_min, domain.pressure_max, 0.0, 6 * bar),
    }
    remedy = (
        "`pressure_for` inverts `force`; `mckibben.muscle.pressure_for(law, force, contraction)` does so numerically"
    )
    return Probes(
        (Probe(_force, box, broadcasts=True), Probe(_inverse, box, broadcasts=True)),
        (Identity("inverse", _inverted, box, remedy),),
    )


def _finite(low: Any, high: Any, least: float, most: float) -> tuple[float, float]:
    """Range of a domain, with finite ends in place of infinite ones."""
    low, high = float(low), float(high)
    low = low if np.isfinite(low) else min(least, high)
    return low, high if np.isfinite(high) else max(most, low)


# Friction and creep of a muscle, friction of a joint.

_MOVE = {
    "length": _LENGTH,
    "move": (-3 * mm, 3 * mm),
    "tension": (0.0, 300.0),
    "pressure": (0.0, 5 * bar),
    "rate": (-0.1, 0.1),
}


def _moved(friction: Friction, length: Any, move: Any, tension: Any, pressure: Any, rate: Any) -> Any:
    state = friction.project(friction.initial(length), length + move / 3, tension, pressure)
    force = friction.force(state, length + move, tension, pressure)
    return (
        force,
        friction.viscous_force(length + move, tension, pressure, rate),
        friction.half_width_at(tension, pressure),
    )


def _moved_in_two(friction: Friction, length: Any, move: Any, tension: Any, pressure: Any, _: Any) -> tuple[Any, Any]:
    start, end = friction.initial(length), length + move
    middle = friction.project(start, length + move / 3, tension, pressure)
    return friction.force(middle, end, tension, pressure), friction.force(start, end, tension, pressure)


def _projected(friction: Friction, length: Any, move: Any, tension: Any, pressure: Any, _: Any) -> tuple[Any, Any]:
    end, start = length + move, friction.initial(length)
    after = friction.project(start, end, tension, pressure)
    return friction.force(after, end, tension, pressure), friction.force(start, end, tension, pressure)


def _path(friction: Friction, length: Any, move: Any, tension: Any, pressure: Any, _: Any) -> tuple[Any, Any]:
    path, force = np.array([length, length + move, length]), []
    state = friction.initial(length)
    for end in path:
        force.append(friction.force(state, end, tension, pressure))
        state = friction.project(state, end, tension, pressure)
    return friction.path_response(path, tension=float(tension), pressure=float(pressure)), np.array(force)


_SLIDING = "two moves in one direction must give the force of their sum: keep what the force needs in the state"
_PROJECTION = "`project` keeps the force: it returns the state after the move"


def _friction(_: Friction) -> Probes:
    return Probes(
        (Probe(_moved, _MOVE),),
        (
            Identity("composition", _moved_in_two, _MOVE, _SLIDING),
            Identity("projection", _projected, _MOVE, _PROJECTION),
            Identity("path", _path, _MOVE, "`path_response` gives the force of `force` and `project` along a path"),
        ),
    )


_AREA = 1e-4  # N/Pa


def _crept(creep: Creep, length: Any, pressure: Any, step: Any, tension: Any, rate: Any) -> Any:
    state, tension_at = _moved_creep(creep, length, pressure, step, tension)
    return creep.force(state, tension, tension_at), creep.rate(state, rate, pressure), creep.project(state, tension)


def _creep_projected(creep: Creep, length: Any, pressure: Any, step: Any, tension: Any, _: Any) -> tuple[Any, Any]:
    state, tension_at = _moved_creep(creep, length, pressure, step, tension)
    return creep.force(creep.project(state, tension), tension, tension_at), creep.force(state, tension, tension_at)


def _moved_creep(creep: Creep, length: Any, pressure: Any, step: Any, tension: Any) -> tuple[CreepState, TensionAt]:
    """State relaxed before a step of the pressure and a move, and the tension over the pressure."""
    relaxed = creep.initial(length, pressure - step)
    rates = creep.rate(relaxed, step / bar, pressure)
    state = jax.tree.map(lambda x, rate: x + 0.1 * rate, relaxed, rates)
    return state, lambda at: jnp.maximum(tension + _AREA * (at - pressure), 0.0)


def _creep(_: Creep) -> Probes:
    ranges = {
        "length": _LENGTH,
        "pressure": (0.0, 5 * bar),
        "step": (-1 * bar, 1 * bar),
        "tension": (0.0, 300.0),
        "rate": (-0.1, 0.1),
    }
    return Probes((Probe(_crept, ranges),), (Identity("projection", _creep_projected, ranges, _PROJECTION),))


_TURN = {"angle": (-0.2, 0.2), "move": (-0.1, 0.1)}


def _turned(friction: JointFriction, angle: Any, move: Any) -> Any:
    return friction.resisting_torque(friction.project(friction.initial(angle), angle + move / 3), angle + move)


def _turned_in_two(friction: JointFriction, angle: Any, move: Any) -> tuple[Any, Any]:
    return _turned(friction, angle, move), friction.resisting_torque(friction.initial(angle), angle + move)


def _joint_friction(_: JointFriction) -> Probes:
    return Probes((Probe(_turned, _TURN),), (Identity("composition", _turned_in_two, _TURN, _SLIDING),))


# Tendons, geometries, paths and loads.


def _tension(tendon: Tendon, path: Any, pressure: Any, tension: Any) -> Any:
    muscle = _muscle()
    return (
        tendon.extension(tension),
        tendon.tension(muscle, path, pressure),
        tendon.pressure_for(muscle, path, tension),
        tendon.permitted(muscle, path),
    )


def _equilibrium(tendon: Tendon, path: Any, pressure: Any, _: Any) -> tuple[Any, Any]:
    muscle = _muscle()
    contraction = tendon.contraction(muscle, path, pressure)
    length = muscle.specimen.length_at(contraction)
    return length + tendon.extension(muscle.tension(contraction, pressure)), path


def _tendon(_: Tendon) -> Probes:
    ranges = {"path": (150 * mm, 185 * mm), "pressure": _PRESSURE, "tension": (0.0, 300.0)}
    remedy = "`contraction` solves path = muscle length + `extension` at equal tension"
    return Probes((Probe(_tension, ranges),), (Identity("equilibrium", _equilibrium, ranges, remedy),))


def _angles(limits: tuple[float, float]) -> Ranges:
    return {"angle": (max(float(limits[0]), -0.4), min(float(limits[1]), 0.4))}


def _arms(geometry: Geometry, angle: Any) -> Any:
    return geometry.path_lengths(angle), geometry.moment_arms(angle)


def _virtual_work(geometry: Geometry, angle: Any) -> tuple[Any, Any]:
    slope1, slope2 = (derivative(lambda x, n=n: geometry.path_lengths(x)[n], angle) for n in (0, 1))
    return geometry.moment_arms(angle), (slope1, -slope2)


def _geometry(geometry: Geometry) -> Probes:
    ranges = _angles(geometry.angle_range)
    remedy = "moment arms are the slopes of the path lengths, that of muscle 2 with the opposite sign"
    return Probes((Probe(_arms, ranges, broadcasts=True),), (Identity("virtual work", _virtual_work, ranges, remedy),))


def _lengths(path: MusclePath, angle: Any) -> Any:
    return path.length(angle, 1), path.length(angle, -1)


def _muscle_path(path: MusclePath) -> Probes:
    return Probes((Probe(_lengths, _angles(path.angle_range), broadcasts=True),))


_MOTION = {"angle": (-0.4, 0.4), "velocity": (-3.0, 3.0), "torque": (-20.0, 20.0)}


def _acceleration(load: Load, angle: Any, velocity: Any, torque: Any) -> Any:
    return load.acceleration(angle, velocity, torque), load.gravity_stiffness(angle)


def _required(load: Load, angle: Any, velocity: Any, torque: Any) -> tuple[Any, Any]:
    return load.required_torque(angle, velocity, load.acceleration(angle, velocity, torque)), torque


def _gravity(load: Load, angle: Any, *_: Any) -> tuple[Any, Any]:
    return load.gravity_stiffness(angle), -derivative(load.gravity_torque, angle)


def _load(_: Load) -> Probes:
    slope = "`gravity_stiffness` is minus the slope of `gravity_torque`: override both"
    return Probes(
        (Probe(_acceleration, _MOTION, broadcasts=True),),
        (
            Identity("inverse", _required, _MOTION, "`required_torque` inverts `acceleration`"),
            Identity("slope", _gravity, _MOTION, slope),
        ),
    )


# Actuators.


def _rates(actuator: Actuator, pressure1: Any, pressure2: Any, command1: Any, command2: Any) -> Any:
    pressures, commands = (pressure1, pressure2), (command1, command2)
    states, air = actuator.init_states(pressures), AirVolume(jnp.asarray(1e-4), jnp.asarray(1e-5))
    if actuator.holds_air and isinstance(states, AirState):
        states = actuator.before_steps(states, commands, pressures, 0.1 * ms)
    rates = actuator.rates(pressures, states, commands, lambda: (air, air))
    return rates, actuator.after_command(pressure1, command1), actuator.telemetry(states, commands, pressures)


def _response(valve: Valve, pressure: Any, command: Any, following: Any, elapsed: Any, rate: Any) -> Any:
    moving = valve.after(pressure, valve.init(pressure), command, elapsed)
    return valve.after(*moving, following, elapsed), valve.command_for(pressure, rate)


def _composed(valve: Valve, pressure: Any, command: Any, following: Any, elapsed: Any, _: Any) -> tuple[Any, Any]:
    moving = valve.after(pressure, valve.init(pressure), command, elapsed)
    twice = valve.after(*valve.after(*moving, following, elapsed), following, 1.6 * elapsed)
    return twice, valve.after(*moving, following, 2.6 * elapsed)


def _rest(valve: Valve, pressure: Any, _: Any, __: Any, elapsed: Any, ___: Any) -> tuple[Any, Any]:
    return valve.after(pressure, valve.init(pressure), valve.command_for(pressure, 0.0), elapsed)[0], pressure


def _actuator(actuator: Actuator) -> Probes:
    command = (-1.0, 1.0) if actuator.direct else _PRESSURE
    ranges = {"pressure1": _PRESSURE, "pressure2": _PRESSURE, "command1": command, "command2": command}
    if not actuator.has_closed_form:
        return Probes((Probe(_rates, ranges),))
    times = {
        "pressure": _PRESSURE,
        "command": command,
        "next command": command,
        "elapsed": (0.5 * ms, 40 * ms),
        "rate": (-1e4, 1e4),
    }
    state = (
        "two intervals must give the result of their sum: the response lacks a state that it needs; return all that it "
        "depends on from `init` and `after`, as SecondOrderValve does"
    )
    start = "`init` is the state at a constant pressure, and `command_for(pressure, 0)` the command that keeps it"
    return Probes(
        (Probe(_rates, ranges), Probe(_response, times)),
        (Identity("composition", _composed, times, state), Identity("rest", _rest, times, start)),
    )


# Sensors, disturbances and references.


def _measured(sensors: Sensors, angle: Any, pressure1: Any, pressure2: Any, further: Any) -> Any:
    first, second = Measurement(angle, (pressure1, pressure2)), Measurement(further, (pressure2, pressure1))
    state, before = sensors.measure(sensors.init(first), jnp.asarray(0), first)
    return before, sensors.measure(state, jnp.asarray(1), second)[1]


def _sensors(_: Sensors) -> Probes:
    ranges = {"angle": (-0.4, 0.4), "pressure1": _PRESSURE, "pressure2": _PRESSURE, "next angle": (-0.4, 0.4)}
    return Probes((Probe(_measured, ranges),))


def _torque(disturbance: Disturbance, time: Any) -> Any:
    return disturbance.torque(time)


def _value(signal: Signal | Reference, time: Any) -> Any:
    return signal(time)


_TIMES = {"time": (0.0, 10.0)}


def _signal(_: Signal | Reference) -> Probes:
    return Probes((Probe(_value, _TIMES, broadcasts=True),), emitted=False)  # a reference is sampled before a run


# Controllers and their parts.


def _commands(
    controller: Controller, angle: Any, further: Any, pressure1: Any, pressure2: Any, target: Any, stiffness: Any
) -> Any:
    found = [Measurement(at, (pressure1, pressure2)) for at in (angle, further)]
    return _stepped(controller, Setpoint(target, stiffness), found)


def _stepped(system: DiscreteTimeSystem, setpoint: Any, measurements: Sequence[Any]) -> Any:
    """Outputs for successive measurements, from a start at the first, and telemetry."""
    rows = jax.tree.map(lambda *each: jnp.stack(each), *measurements)
    start = system.init(measurements[0])
    state, outputs = lax.scan(lambda state, row: system.step(state, setpoint, row, PERIOD), start, rows)
    return outputs, system.telemetry(state)


def _controller(_: Controller) -> Probes:
    ranges = {
        "angle": (-0.1, 0.1),
        "next angle": (-0.1, 0.1),
        "pressure1": (2 * bar, 4 * bar),
        "pressure2": (2 * bar, 4 * bar),
        "reference": (-0.1, 0.1),
        "stiffness": (12.0, 18.0),
    }
    return Probes((Probe(_commands, ranges),))


def _looped(loop: Loop, setpoint: Any, measured: Any, output: Any, sensitivity: Any) -> Any:
    def step(state: Any, _: Any) -> tuple[Any, Any]:
        state, given = loop.step(state, setpoint, measured, sensitivity, PERIOD)
        return loop.track(state, given, 0.9 * given, PERIOD), given

    state, given = lax.scan(step, loop.init(setpoint, measured, output), length=2)
    return given, loop.telemetry(state)


def _loop(_: Loop) -> Probes:
    ranges = {
        "setpoint": (-0.1, 0.1),
        "measured": (-0.1, 0.1),
        "output": (-1 * bar, 1 * bar),
        "sensitivity": (1e-6, 3e-6),
    }
    return Probes((Probe(_looped, ranges),))


def _fed_back(feedback: Feedback, error: Any, rate: Any, shortfall: Any) -> Any:
    state = feedback.track(feedback.init(error), shortfall, PERIOD)
    return feedback.step(state, error, rate, _JERK, PERIOD)[1], feedback.lag


def _feedback(_: Feedback) -> Probes:
    return Probes((Probe(_fed_back, {"error": (-0.1, 0.1), "rate": (-2.0, 2.0), "shortfall": (-10.0, 10.0)}),))


def _observed(observer: Observer, angle: Any, further: Any, known: Any, period: Any) -> Any:
    motion = observer.init(angle, known)
    for now in (further, angle):
        motion = observer.step(motion, now, known, period)
    return tuple(motion), observer.gains(period)


def _observer(_: Observer) -> Probes:
    ranges = {"angle": (-0.1, 0.1), "next angle": (-0.1, 0.1), "known": (-20.0, 20.0), "period": (0.5 * ms, 2 * ms)}
    return Probes((Probe(_observed, ranges),))


def _leg_step(part: LegController | LegReference, time: Any, angle: Any, pressure: Any, force: Any) -> Any:
    return _stepped(part, time, [LegMeasurement((angle, 0.5 + angle), (pressure,) * 5, force)] * 2)


def _leg(_: LegController | LegReference) -> Probes:
    ranges = {"time": (0.0, 1.0), "angle": (-0.1, 0.1), "pressure": (2 * bar, 4 * bar), "force": (0.0, 100.0)}
    return Probes((Probe(_leg_step, ranges),), in_files=False)


_PROBES: dict[type, Callable[[Any], Probes]] = {
    ForceLaw: _law,
    Friction: _friction,
    Creep: _creep,
    JointFriction: _joint_friction,
    Tendon: _tendon,
    Geometry: _geometry,
    MusclePath: _muscle_path,
    Load: _load,
    Actuator: _actuator,
    Sensors: _sensors,
    Disturbance: lambda _: Probes((Probe(_torque, _TIMES, broadcasts=True),)),
    Signal: _signal,
    Reference: _signal,
    Controller: _controller,
    Loop: _loop,
    Feedback: _feedback,
    Observer: _observer,
    LegController: _leg,
    LegReference: _leg,
}
