"""Limits of a joint's samples and commands: from its scenario, or from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.config.model import ConfigModel
from mckibben.control import Setpoint
from mckibben.errors import ExportError, SimulationError
from mckibben.export.containment import Containment, ControlSample
from mckibben.joint import Measurement
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.robot import Robot
from mckibben.numerics.compiled import jit, numeric
from mckibben.scenario import Scenario
from mckibben.simulation.problem import sampled
from mckibben.units import Angle, PositiveTime, Pressure, Share, Stiffness, deg, ms

if TYPE_CHECKING:
    from mckibben.plant import Plant
    from mckibben.plant.robot_plant import RobotPlant
    from mckibben.scenario.robot import RobotScenario

_BEYOND = 10 * deg  # of the angles beyond those of the reference, of the start, and of the vented joint
_ABOVE = 0.05  # of measured pressures outside the rated ones, relative to the highest
_ANGLES = 50  # at which the highest stiffness is sought, of a robot for each of its joints
_SOFTEST = 1e-3  # setpoint of the stiffness of a robot's joint, relative to the highest
_IMPACT = 1000.0  # m/s^2: of the whole robot, by the highest measured force of the ground


class Limits(ConfigModel):
    """Limits of the samples of a controller, as the section `limits` of a file; by default from the scenario.

    Attributes
    ----------
    lowest_angle, highest_angle
        Angles [rad], of a slide positions [m], in files in mm. Default: 10 deg, of a slide 10 mm, beyond the reference,
        the start, and the angle of the vented joint.
    lowest_pressure, highest_pressure
        Measured gauge pressures [Pa]. Default: 5 % of the rated pressure outside the rated ones.
    highest_stiffness
        Highest setpoint [N*m/rad]. Default: that of the joint at the rated pressures, of a robot's where each muscle
        has that or none, or of the reference. The lowest of a robot's joint is a thousandth of it.
    moved
        Change of a command, as a share of its range, beyond which its sensor has to change.
    frozen
        Time [s] in which it has to.
    tolerated
        Time [s] of holding before the vent, and of good samples before a restart.
    ramp
        Duration [s] of the ramp after a restart.
    """

    lowest_angle: Angle | None = None
    highest_angle: Angle | None = None
    lowest_pressure: Pressure | None = None
    highest_pressure: Pressure | None = None
    highest_stiffness: Stiffness | None = None
    moved: Share = 0.15
    frozen: PositiveTime = 250 * ms
    tolerated: PositiveTime = 50 * ms
    ramp: PositiveTime = 2.0

    def containment(self, plant: Plant, lowest: ControlSample, highest: ControlSample) -> Containment:
        """Containment with these bounds of a sample, and the commands of a plant."""
        largest = (float(np.finfo(np.float32).max),) * len(plant.muscles)
        least, most = plant.clip_commands([-x for x in largest]), plant.clip_commands(largest)
        moved = [self.moved * (high - low) for low, high in zip(least, most, strict=True)]
        if isinstance(lowest.measurement, Measurement):
            moved.append(max(moved))  # of their difference, for the angle
        vent = tuple(min(float(low), 0.0) for low in least)
        least = tuple(map(jnp.minimum, least, vent))
        return Containment(lowest, highest, least, most, vent, tuple(moved), self.frozen, self.tolerated, self.ramp)


def containment_of(scenario: Scenario | RobotScenario, limits: Limits) -> Containment:
    """Containment of a joint, or of the joints of a robot.

    Those of a robot have as default limits of their angles 10 deg beyond their ranges.

    Raises `ExportError` if the angle of the vented joint is unknown, and its limits are not given.
    """
    if isinstance(scenario, Scenario):
        return limits.containment(scenario.plant(), *_joint_bounds(scenario, limits))
    plant = scenario.plant()
    pressures, stiffest = _measured_pressures(plant, limits), _stiffest(scenario, limits)
    return limits.containment(
        plant, *(_robot_bounds(plant, limits, side, pressures[side], stiffest) for side in (0, 1))
    )


def _measured_pressures(plant: Plant, limits: Limits) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Lowest and highest measured pressures [Pa] of all muscles."""
    rated = [muscle.specimen.domain for muscle in plant.muscles]
    strongest = max(float(domain.pressure_max) for domain in rated)  # for a spring, whose pressure is 0
    margins = [_ABOVE * (float(domain.pressure_max) or strongest) for domain in rated]
    lowest = [domain.pressure_min - margin for domain, margin in zip(rated, margins, strict=True)]
    highest = [domain.pressure_max + margin for domain, margin in zip(rated, margins, strict=True)]
    if limits.lowest_pressure is not None:
        lowest = [limits.lowest_pressure] * len(rated)
    if limits.highest_pressure is not None:
        highest = [limits.highest_pressure] * len(rated)
    return tuple(map(jnp.asarray, lowest)), tuple(map(jnp.asarray, highest))


def _joint_bounds(scenario: Scenario, limits: Limits) -> tuple[ControlSample, ControlSample]:
    """Lowest and highest sample of a joint."""
    plant = scenario.plant()
    reference = sampled(scenario.reference(), scenario.duration, scenario.control_period)[1]
    low, high = limits.lowest_angle, limits.highest_angle
    if low is None or high is None:
        angles = np.append(np.asarray(reference.angle), [scenario.start.angle, _vented(scenario)])
        beyond = _BEYOND * scenario.joint_type.scale
        low = angles.min() - beyond if low is None else low
        high = angles.max() + beyond if high is None else high
    stiffest = limits.highest_stiffness
    if stiffest is None:
        joint, angles = numeric(plant.joint), np.linspace(low, high, _ANGLES)
        rated = tuple(muscle.specimen.domain.pressure_max for muscle in plant.muscles)
        of_joint = np.asarray(jit(type(joint).stiffness)(joint, angles, rated))
        stiffest = np.nanmax([np.nanmax(of_joint), np.max(np.asarray(reference.stiffness))])
    softest = min(0.0, float(np.min(np.asarray(reference.stiffness))))
    ends = zip((low, high), (softest, float(stiffest)), _measured_pressures(plant, limits), strict=True)
    lowest, highest = (
        ControlSample(Setpoint(angle, jnp.asarray(stiffness)), Measurement(angle, measured))  # type: ignore[arg-type]
        for end, stiffness, measured in ends
        for angle in [jnp.asarray(end)]
    )
    return lowest, highest


def _stiffest(scenario: RobotScenario, limits: Limits) -> NDArray[np.float64]:
    """Highest setpoint of the stiffness [N*m/rad] of each joint of a robot: what it attains, or of its reference.

    Each muscle is at its rated pressure, or vented where its pressure softens the joint.
    """
    joints, references = scenario.robot.joints, scenario.references()
    if limits.highest_stiffness is not None:
        return np.full(len(joints), limits.highest_stiffness)
    rated = np.array([muscle.domain.pressure_max for muscle in scenario.robot.all_muscles], float)
    alone = np.vstack([np.zeros(len(rated)), np.diag(rated)])  # pressures, of no muscle and of each
    count = _ANGLES * len(joints)
    lower, upper = (np.array([[getattr(joint, end)] for joint in joints], float) for end in ("lower", "upper"))
    angles = lower + (upper - lower) * np.random.default_rng(0).uniform(size=(len(joints), count))
    lanes = tuple(np.repeat(angles, len(alone), axis=1)), tuple(np.tile(alone.T, count))
    vented, *each = np.moveaxis(
        np.reshape(_stiffness_of_joints(scenario.robot, lanes), (len(joints), count, -1)), -1, 0
    )
    stiffest = vented + sum(np.maximum(own - vented, 0.0) for own in each)
    times = scenario.run_duration, scenario.control_period
    wanted = [np.max(np.asarray(sampled(references[joint.name], *times)[1].stiffness)) for joint in joints]
    return np.fmax(np.nanmax(stiffest, axis=1), wanted)


@compiled
def _stiffness_of_joints(robot: Robot, lane: tuple[tuple[Array, ...], tuple[Array, ...]]) -> tuple[Array, ...]:
    """Stiffness [N*m/rad] of the joints at angles [rad] and pressures [Pa], many along the last axis."""
    return robot.stiffness(*lane)


def _robot_bounds(
    plant: RobotPlant, limits: Limits, side: int, pressures: tuple[Array, ...], stiffest: NDArray[np.float64]
) -> ControlSample:
    """Lowest (side 0) or highest sample of a robot."""
    given = (limits.lowest_angle, limits.highest_angle)[side]
    ends = [joint.upper + _BEYOND if side else joint.lower - _BEYOND for joint in plant.robot.joints]
    angles = tuple(jnp.asarray(end if given is None else given) for end in ends)
    stiffness = tuple(map(jnp.asarray, stiffest if side else _SOFTEST * stiffest))
    force = plant.robot.total_mass * (_IMPACT if side else -_IMPACT)
    return ControlSample({"angles": angles, "stiffness": stiffness}, RobotMeasurement(angles, pressures, force))


def _vented(scenario: Scenario) -> float:
    """Angle [rad] of the vented joint."""
    from mckibben.rig.compiled import vented_angle

    try:
        return vented_angle(scenario.plant())
    except SimulationError as error:
        remedy = "give lowest_angle and highest_angle in the section limits of a file (command line: --hardware FILE)"
        raise ExportError(str(error), field="limits", remedy=remedy) from error
