"""Dynamic stiffness that a push feels: torque over angle of a joint in closed loop, over the frequency."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.component.checks import check_positive
from mckibben.control import Reference
from mckibben.joint import AntagonisticJoint
from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.mechanism.disturbance import Disturbance
from mckibben.notebook import Progress, silent
from mckibben.numerics.compiled import jit
from mckibben.numerics.elementary import floating
from mckibben.result import Column, TableColumns
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import simulate
from mckibben.statics.attainable import attainable_statics
from mckibben.statics.posture import holding_torques

Values = NDArray[np.float64]

FREQUENCIES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Frequencies of pushes [Hz]."""
_SETTLING, _MEASURED = 2.0, 1.0  # s: least time before the measured cycles, and of these
_LONGEST = 16  # times the settling
_STEADY = 0.02  # relative change between two measurements
_FEWEST = 8  # control periods in a cycle
_SHARE = 0.1  # of the attainable torque


class Felt(NamedTuple):
    """Resistance of a joint to a sinusoidal torque, held at its setpoint by its controller.

    A robot's other joints are held by the controller, too. Inertia, gravity and friction take part.
    """

    angle: float
    """Held [rad]."""
    setpoint: float
    """Stiffness [N*m/rad] that is asked for."""
    isobaric: float
    """Isobaric stiffness [N*m/rad] of the muscles, held without a push."""
    small_motion: float
    """Stiffness [N*m/rad] of slow motion by 0.1 deg at constant pressures, with friction; NaN if it is not known."""
    torque: float
    """Amplitude of the push [N*m]."""
    frequency: Values
    """Frequencies of the pushes [Hz], shape (n,)."""
    impedance: NDArray[np.complex128]
    """Torque over angle [N*m/rad] at these, shape (n,)."""
    pushed: Values
    """Mean isobaric stiffness [N*m/rad] meanwhile, shape (n,)."""
    settled: NDArray[np.bool_]
    """Whether the motion repeats to 2 %, shape (n,)."""

    @property
    def magnitude(self) -> Values:
        """Stiffness that is felt [N*m/rad]: the amplitude of the torque over that of the angle."""
        return np.abs(self.impedance)

    @property
    def deflection(self) -> Values:
        """Amplitude of the angle [rad]."""
        return self.torque / self.magnitude

    def columns(self) -> TableColumns:
        """Felt stiffness over the frequency."""
        stiffness = Column("N*m/rad", digits=3)
        return {
            "frequency": (Column("Hz", digits=2), self.frequency),
            "felt": (stiffness, self.magnitude),
            "phase": (Column("rad", "", "deg", digits=3), np.angle(self.impedance)),
            "deflection": (Column("rad", "", "deg", digits=2), self.deflection),
            "isobaric": (stiffness, self.pushed),
        }


class _Push(Disturbance):
    """A sine of torque."""

    amplitude: ArrayLike = 0.0
    frequency: ArrayLike = 1.0

    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(self.amplitude) * jnp.sin(2 * jnp.pi * self.frequency * floating(time))


class _Run(NamedTuple):
    """Angles [rad] and isobaric stiffness [N*m/rad] of a run, shape (joints, periods), and the last pressures [Pa]."""

    angles: Values
    stiffness: Values
    pressures: tuple[float, ...]


class _Loop(NamedTuple):
    """A closed loop that holds its first setpoints, which are pushed."""

    names: Sequence[str]
    setpoints: Sequence[tuple[float, float]]  # angle [rad] and stiffness [N*m/rad]
    torques: Sequence[float]  # of pushes [N*m]
    pairs: dict[int, AntagonisticJoint]
    period: float
    run: Callable[[int, float, float, float], _Run]  # joint, torque, frequency, duration

    def felt(self, joint: int, torque: float | None, frequencies: Sequence[float], tell: Callable[[], None]) -> Felt:
        """Push one of the joints."""
        amplitude = self.torques[joint] if torque is None else torque
        at_rest = self.run(joint, 0.0, 1.0, _SETTLING)
        angle = float(at_rest.angles[joint, -1])
        counts = np.unique([max(round(1 / (f * self.period)), _FEWEST) for f in frequencies])[::-1]
        impedance, pushed, settled = [], [], []
        for count in counts:
            tell()
            cycle = count * self.period
            cycles = max(int(np.ceil(_MEASURED / cycle)), 1)
            before = max(int(np.ceil(_SETTLING / cycle)), 1)
            moved, change, run, more = 0j, np.inf, at_rest, 1
            while change >= _STEADY and more <= _LONGEST:
                run = self.run(joint, amplitude, 1 / cycle, (more * before + 2 * cycles) * cycle)
                windows = run.angles[joint, -2 * cycles * count :].reshape(2, -1)
                earlier, moved = 2 * np.mean(windows * np.exp(-2j * np.pi * np.arange(cycles * count) / count), axis=1)
                change = abs(moved - earlier) / abs(moved)
                more *= 4
            held = np.sinc(1 / count) * np.exp(-1j * np.pi / count)  # the torque is constant over control periods
            impedance.append(-1j * amplitude * held / moved)
            pushed.append(run.stiffness[joint, -cycles * count :].mean())
            settled.append(change < _STEADY)
        small, pair = np.nan, self.pairs.get(joint)
        if pair is not None:
            first = 2 * list(self.pairs).index(joint)
            small = float(_small(pair, angle, (at_rest.pressures[first], at_rest.pressures[first + 1])))
        return Felt(
            angle,
            self.setpoints[joint][1],
            float(at_rest.stiffness[joint, -round(0.5 / self.period) :].mean()),
            small,
            amplitude,
            1 / (counts * self.period),
            np.array(impedance),
            np.array(pushed),
            np.array(settled),
        )


def felt_stiffness(
    scenario: Scenario | RobotScenario,
    *,
    torque: float | None = None,
    frequencies: Sequence[float] = FREQUENCIES,
    progress: Progress | None = None,
) -> dict[str, Felt]:
    """Hold the first setpoints of a scenario, and push each joint with sines of torque.

    Of the angle the component with the frequency of the push counts, once it repeats to 2 %, after 2 s at least.

    Parameters
    ----------
    scenario
        Plant, controller and reference; its disturbances are left out.
    torque
        Amplitude of the push [N*m]. Default: a tenth of half the attainable range of torque.
    frequencies
        Frequencies of the pushes [Hz], of which each cycle is rounded to control periods.
    progress
        Called with the name of the joint and the completed fraction, 0 to 1.

    Returns
    -------
    dict
        By the name of the joint, which is empty in a scenario of one joint.

    Raises
    ------
    RangeError
        If torque or frequency is not positive.
    SimulationError
        If the plant needs more substeps.
    """
    check_positive("felt_stiffness", "Hz", frequencies=frequencies)
    if torque is not None:
        check_positive("felt_stiffness", "N*m", torque=torque)
    report = progress or silent
    loop = _loop_of_joint(scenario) if isinstance(scenario, Scenario) else _loop_of_robot(scenario)
    found, done = {}, 0
    for joint, name in enumerate(loop.names):

        def tell(name: str = name) -> None:
            nonlocal done
            report(f"pushing {name}".strip(), done / (len(frequencies) * len(loop.names)))
            done += 1

        found[name] = loop.felt(joint, torque, frequencies, tell)
    return found


def first_setpoints(scenario: Scenario | RobotScenario) -> Any:
    """Return the first setpoint of an unnamed joint, or a tuple of those of all joints."""
    references: Any = scenario.references()
    if not scenario.joint_names:
        return references(0.0)
    return tuple(references[name](0.0) for name in scenario.joint_names)


def _loop_of_joint(scenario: Scenario) -> _Loop:
    asked = first_setpoints(scenario)
    setpoint = float(asked.angle), float(asked.stiffness)
    held = scenario.model_copy(update={"disturbance": _Push()})
    plant, controller, reference = held.plant(), held.control(), Reference(*setpoint)
    start, substeps = held.initial(plant), scenario.needed_substeps()

    def run(_: int, torque: float, frequency: float, duration: float) -> _Run:
        pushed = dataclasses.replace(plant, disturbance=_Push(torque, frequency))
        times = {"duration": duration, "control_period": held.control_period, "substeps": substeps}
        result = simulate(pushed, controller, reference, initial=start, warn_infeasible=False, **times)
        pressures = result["pressure1"], result["pressure2"]
        stiffness = np.asarray(plant.joint.stiffness(result["angle"], pressures))
        return _Run(result["angle"][None], stiffness[None], tuple(float(pressure[-1]) for pressure in pressures))

    low, high = plant.supplied_joint.attainable_torque(setpoint[0])
    pairs = {0: plant.joint}
    return _Loop([""], [setpoint], [_push_of(float(low), float(high))], pairs, held.control_period, run)


def _loop_of_robot(scenario: RobotScenario) -> _Loop:
    robot, names = scenario.robot, scenario.joint_names
    setpoints = [(float(asked.angle), float(asked.stiffness)) for asked in first_setpoints(scenario)]
    constant = {name: Reference(*setpoint) for name, setpoint in zip(names, setpoints, strict=True)}
    joints = tuple(dataclasses.replace(joint, disturbance=_Push()) for joint in robot.joints)
    update = {"reference": constant, "robot": dataclasses.replace(robot, joints=joints)}
    held = scenario.with_model(fixed=True).model_copy(update=update)
    plant, controller, references, start = held.plant(), held.control(), held.references(), held.starts()
    substeps = scenario.needed_substeps()

    def run(joint: int, torque: float, frequency: float, duration: float) -> _Run:
        pushed = eqx.tree_at(lambda plant: plant.robot.joints[joint].disturbance, plant, _Push(torque, frequency))
        times = {"duration": duration, "control_period": held.control_period, "substeps": substeps}
        result = simulate(pushed, controller, references, initial=start, warn_infeasible=False, **times)
        return _Run(result["angle"], result["stiffness"], tuple(result["pressure"][:, -1].tolist()))

    angles, ranges = [angle for angle, _ in setpoints], {}
    pairs = {index: robot.pair(index) for index in robot.pairs} if robot.has_disjoint_pairs else {}
    if not pairs:
        ranges = attainable_statics(robot, angles, torques=holding_torques(robot, angles), supply=scenario.supply)
    torques = [
        _push_of(*(map(float, pairs[i].attainable_torque(angles[i])) if pairs else ranges[name].torque))
        for i, name in enumerate(names)
    ]
    return _Loop(names, setpoints, torques, pairs, held.control_period, run)


def _push_of(low: float, high: float) -> float:
    """Amplitude of a push [N*m] from a range of torque, to one digit."""
    return float(f"{_SHARE * (high - low) / 2:.1g}")


@jit
def _small(joint: AntagonisticJoint, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Array:
    return joint.secant_stiffness(angle, pressures, SMALL_MOTION)
