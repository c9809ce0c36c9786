"""The record of a run as the result of a simulation: the same columns, metrics and figures, of what was measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mckibben.control.base import Setpoint
from mckibben.muscle import NoCreep, NoFriction
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation import Reach, Result, compiled_trajectory
from mckibben.simulation.loop import Record
from mckibben.study.joint_rig.rows import Phase

_PREFIX = "controller_"


def measured_result(
    columns: Mapping[str, NDArray[Any]], plant: JointPlant, reach: Reach, period: float, *, scenario: str = ""
) -> Result | None:
    """What a record says of its run, one value a control period; None if there was none.

    Angle and pressures are as measured. Stiffness, torque, forces and contractions are what the laws of the plant's
    muscles make of them, without friction and creep, whose state cannot be measured. The velocity is that between
    neighbouring samples. How far a change of the stiffness moved the angle would take a second run, and what goes
    in and out as air cannot be told from the noise of the pressures: there is neither ``coupling`` nor ``air``.

    Parameters
    ----------
    columns
        Of a record.
    plant
        What the joint is believed to be.
    reach
        Of the reference.
    period
        The control period [s].
    scenario
        Text to keep with the result.
    """
    whole = _every_period(columns)
    run = whole["phase"] == Phase.RUN
    count = int(run.sum())
    if count < 2:
        return None
    table = {name: values[run] for name, values in whole.items()}
    telemetry = {name.removeprefix(_PREFIX): table[name] for name in table if name.startswith(_PREFIX)}
    telemetry |= {"saturated": telemetry["saturated"] != 0} if "saturated" in telemetry else {}
    velocity: Any = np.gradient(table["angle"], period)
    angle, pressure1, pressure2 = (cast(Any, table[name]) for name in ("angle", "pressure1", "pressure2"))
    state = PlantState(angle, velocity, pressure1, pressure2)
    record = Record(state, table["command1"], table["command2"], table["limited"] != 0, telemetry)  # type: ignore[arg-type]
    wishes = Setpoint(table["desired_angle"], table["desired_stiffness"])  # type: ignore[arg-type]
    nothing = np.full(count, np.nan)
    moved = compiled_trajectory(numeric(_by_laws(plant)), wishes, record, nothing)  # type: ignore[arg-type]
    moved = moved._replace(air1=nothing, air2=nothing)  # type: ignore[arg-type]
    band = reach.lowest[:count], reach.highest[:count]
    return Result.of(moved, period, band=band, telemetry=telemetry, scenario=scenario)


def _every_period(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The rows without gaps: where a sample or a command is missing, the one before was in force."""
    sample = columns["sample"]
    if not sample.size:
        return dict(columns)
    rows = np.searchsorted(sample, np.arange(sample[0], sample[-1] + 1), side="right") - 1
    filled = {}
    for name, values in columns.items():
        there = np.isfinite(values)
        last = np.maximum.accumulate(np.where(there, np.arange(values.size), 0))
        filled[name] = values[last][rows]
    return filled


def _by_laws(plant: JointPlant) -> JointPlant:
    """The plant without friction and creep."""
    joint = plant.joint
    muscle1, muscle2 = (
        dataclasses.replace(muscle, friction=NoFriction(), creep=NoCreep()) for muscle in (joint.muscle1, joint.muscle2)
    )
    return dataclasses.replace(plant, joint=dataclasses.replace(joint, muscle1=muscle1, muscle2=muscle2))
