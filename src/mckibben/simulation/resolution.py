"""Resolution of a run: references below half the control rate, and substeps that resolve the plant's fastest mode."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Reference
from mckibben.errors import SimulationError
from mckibben.muscle import MaxwellCreep, MaxwellSlip
from mckibben.numerics.batching import named_leaves
from mckibben.plant import JointPlant

STABILITY_LIMIT = 2.785
"""Largest product of step and mode on the negative real axis at which the classical Runge-Kutta method is stable."""

_ANGLE_STEP = 1e-4  # rad, of the differences that give the moment arms


def check_frequencies(reference: Reference, control_period: float) -> None:
    """Raise `SimulationError` if a frequency [Hz] of a signal is at or above half the control rate."""
    highest = 0.5 / control_period
    for name, leaf in named_leaves({"reference": reference}).items():
        if name.split(".")[-1] == "frequency" or "frequencies" in name.split("."):
            value = float(np.max(np.asarray(leaf, float)))
            if value >= highest * (1 - 1e-9):
                raise SimulationError(
                    f"{name} is {value:g} Hz, at or above half the control rate of {1 / control_period:g} Hz",
                    field=name,
                    value=value,
                    upper=highest,
                    unit="Hz",
                    remedy=f"give less than {highest:g} Hz, or a shorter control period",
                )


def check_substeps(
    plant: JointPlant, angles: ArrayLike, stiffness: ArrayLike, control_period: float, substeps: int
) -> None:
    """Raise `SimulationError` if the plant has a mode that its integration steps do not resolve.

    The plant is linearised at the first of the angles [rad], and at the lowest and highest, with a stiffness [N*m/rad].
    """
    motion, air = fastest_mode(plant, angles, stiffness), fastest_air(plant, angles)
    fastest = max(motion, air)
    if math.isfinite(fastest) and fastest * control_period > STABILITY_LIMIT * substeps:
        needed = math.ceil(fastest * control_period / STABILITY_LIMIT)
        slower = "a plant with less damping and stiffness or more inertia"
        if air > motion:
            slower = "a valve with less conductance, a wider band, a slower spool or regulator, or more dead volume"
        raise SimulationError(
            f"substeps is {substeps}, too few for the fastest mode of the plant, {fastest:.4g} 1/s",
            field="substeps",
            value=substeps,
            lower=needed,
            remedy=f"give at least {needed} substeps, or {slower}",
        )


def fastest_mode(plant: JointPlant, angles: ArrayLike, stiffness: ArrayLike) -> float:
    """Largest magnitude [1/s] of an eigenvalue of the linearised plant, friction in presliding and creep included."""
    load, muscles = plant.load, (plant.joint.muscle1, plant.joint.muscle2)
    inertia, damping = float(load.total_inertia), float(load.damping)
    total = float(np.nanmax(np.abs(np.asarray(stiffness, float)))) + abs(float(load.gravity_moment))
    modes = [0.0]
    if plant.joint.has_friction or plant.joint.has_creep:
        for muscle, arm in zip(muscles, _largest_arms(plant, angles), strict=True):
            friction: Any = muscle.friction
            if isinstance(friction, MaxwellSlip):
                total += float(np.sum(friction.stiffnesses)) * arm**2
                damping += float(friction.viscous) * arm**2
            creep: Any = muscle.creep
            if isinstance(creep, MaxwellCreep):
                total += float(creep.stiffness) * arm**2
                modes.append(1 / float(creep.time_constants[0]))
    if plant.friction is not None:
        total += float(plant.friction.steepest)
    half = damping / (2 * inertia)  # of s^2 + 2 half s + total/inertia
    root = half**2 - total / inertia
    return max(*modes, half + math.sqrt(root) if root > 0 else math.sqrt(total / inertia))


def fastest_air(plant: JointPlant, angles: ArrayLike) -> float:
    """Bound on the rates [1/s] of the air in both muscles with its valves; 0 without."""
    if not plant.valve.holds_air:
        return 0.0
    at, joint = _angles_checked(angles), plant.joint
    contractions = joint.contractions(at, (joint.muscle1.domain.pressure_min, joint.muscle2.domain.pressure_min))
    muscles = zip((joint.muscle1, joint.muscle2), contractions, strict=True)
    smallest = min(float(np.min(np.asarray(muscle.specimen.volume(one)))) for muscle, one in muscles)
    return plant.valve.fastest_rate_in(smallest)


def _angles_checked(angles: ArrayLike) -> NDArray[np.float64]:
    """First, lowest and highest angle."""
    angles = np.asarray(angles, float)
    return np.array([angles.flat[0], np.nanmin(angles), np.nanmax(angles)])


def _largest_arms(plant: JointPlant, angles: ArrayLike) -> tuple[float, float]:
    """Largest moment arm [m] of each muscle at the first, lowest and highest angle."""
    at = _angles_checked(angles)
    lengths = [np.asarray(plant.joint.geometry.path_lengths(at + step)) for step in (-_ANGLE_STEP, _ANGLE_STEP)]
    arm1, arm2 = np.max(np.abs(lengths[1] - lengths[0]) / (2 * _ANGLE_STEP), axis=1)
    return float(arm1), float(arm2)
