"""Limits of a joint's samples and commands: from its scenario, or from a file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from mckibben.config.model import ConfigModel
from mckibben.containment import Containment, ControlSample
from mckibben.control import Setpoint
from mckibben.errors import ExportError, SimulationError
from mckibben.joint import Measurement
from mckibben.numerics.compiled import jit, numeric
from mckibben.simulation.problem import sampled
from mckibben.units import Angle, PositiveTime, Pressure, Share, Stiffness, deg, ms

if TYPE_CHECKING:
    from mckibben.plant import Plant
    from mckibben.scenario import Scenario

_BEYOND = 10 * deg  # of the angles beyond those of the reference, of the start, and of the vented joint
_ABOVE = 0.05  # of measured pressures outside the rated ones, relative to the highest
_ANGLES = 50  # at which the highest stiffness is sought
FINITE = 1e30
"""Bound of numbers that have no other."""


class Limits(ConfigModel):
    """Limits of the samples of a controller, as the section `limits` of a file; by default from the scenario.

    Attributes
    ----------
    lowest_angle, highest_angle
        Angles [rad]. Default: 10 deg beyond the reference, the start, and the angle of the vented joint.
    lowest_pressure, highest_pressure
        Measured gauge pressures [Pa]. Default: 5 % of the rated pressure outside the rated ones.
    highest_stiffness
        Highest setpoint [N*m/rad]. Default: that of the joint at the rated pressures, or of the reference.
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


def joint_containment(scenario: Scenario, limits: Limits) -> Containment:
    """Containment of a joint.

    Raises `ExportError` if the angle of the vented joint is unknown, and its limits are not given.
    """
    plant = scenario.plant()
    reference = sampled(scenario.reference(), scenario.duration, scenario.control_period)[1]
    low, high = limits.lowest_angle, limits.highest_angle
    if low is None or high is None:
        angles = np.append(np.asarray(reference.angle), [scenario.start.angle, _vented(scenario)])
        low = angles.min() - _BEYOND if low is None else low
        high = angles.max() + _BEYOND if high is None else high
    rated = [muscle.specimen.domain for muscle in plant.muscles]
    least, most = limits.lowest_pressure, limits.highest_pressure
    margins = [_ABOVE * domain.pressure_max for domain in rated]
    lowest = [float(domain.pressure_min - margin) for domain, margin in zip(rated, margins, strict=True)]
    highest = [float(domain.pressure_max + margin) for domain, margin in zip(rated, margins, strict=True)]
    lowest = lowest if least is None else [least] * len(rated)
    highest = highest if most is None else [most] * len(rated)
    stiffest = limits.highest_stiffness
    if stiffest is None:
        joint, angles = numeric(plant.joint), np.linspace(low, high, _ANGLES)
        of_joint = np.asarray(jit(type(joint).stiffness)(joint, angles, tuple(domain.pressure_max for domain in rated)))
        stiffest = np.nanmax([np.nanmax(of_joint), np.max(np.asarray(reference.stiffness))])
    softest = min(0.0, float(np.min(np.asarray(reference.stiffness))))
    return limits.containment(
        plant,
        _sample(low, softest, lowest),
        _sample(high, float(stiffest), highest),
    )


def _sample(angle: float, stiffness: float, pressures: Sequence[float]) -> ControlSample:
    """Bounds of a sample of a joint."""
    pressure1, pressure2 = map(jnp.asarray, pressures)
    angle_bound = jnp.asarray(angle)
    return ControlSample(
        Setpoint(angle_bound, jnp.asarray(stiffness)), Measurement(angle_bound, (pressure1, pressure2))
    )


def _vented(scenario: Scenario) -> float:
    """Angle [rad] of the vented joint."""
    from mckibben.rig.compiled import vented_angle

    try:
        return vented_angle(scenario.plant())
    except SimulationError as error:
        remedy = "give lowest_angle and highest_angle in the section limits of a file (command line: --hardware FILE)"
        raise ExportError(str(error), field="limits", remedy=remedy) from error
