"""What follows from a recorded episode: the plant's true torque, stiffness and muscles, computed once, vectorised."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Array

from mckibben.control.base import Setpoint
from mckibben.joint.attainable import pressure_limits_of
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.simulation.loop import Record

_AT_LIMIT = 1.0  # Pa: a command this close to a limit is at it


class Trajectory(NamedTuple):
    """An episode over time; every leaf has shape (periods,), SI units.

    Stiffness, torque, forces and contractions are the plant's own, not the controller's belief.
    """

    angle: Array
    velocity: Array
    desired_angle: Array
    desired_stiffness: Array
    stiffness: Array
    stiffness_estimate: Array
    torque: Array
    pressure1: Array
    pressure2: Array
    command1: Array
    command2: Array
    force1: Array
    force2: Array
    contraction1: Array
    contraction2: Array
    saturated: Array
    slack: Array
    outside_domain: Array


def trajectory(plant: JointPlant, setpoints: Setpoint, record: Record) -> Trajectory:
    """Work out the trajectory of a record. Pure: it may be compiled, vmapped and differentiated."""
    state, joint = record.state, plant.joint
    torque, stiffness = joint.torque_and_stiffness(state.angle, state.pressures)
    contraction1, contraction2 = joint.contractions(state.angle, state.pressures)
    force1 = joint.muscle1.force(contraction1, state.pressure1)
    force2 = joint.muscle2.force(contraction2, state.pressure2)
    lowest, highest = pressure_limits_of(joint)
    saturated = (
        (record.command1 <= lowest[0] + _AT_LIMIT)
        | (record.command1 >= highest[0] - _AT_LIMIT)
        | (record.command2 <= lowest[1] + _AT_LIMIT)
        | (record.command2 >= highest[1] - _AT_LIMIT)
    )
    inside = joint.muscle1.domain.contains(contraction1, state.pressure1) & joint.muscle2.domain.contains(
        contraction2, state.pressure2
    )
    return Trajectory(
        angle=state.angle,
        velocity=state.velocity,
        desired_angle=setpoints.angle,
        desired_stiffness=setpoints.stiffness,
        stiffness=stiffness,
        stiffness_estimate=record.telemetry["stiffness_estimate"],
        torque=torque,
        pressure1=state.pressure1,
        pressure2=state.pressure2,
        command1=record.command1,
        command2=record.command2,
        force1=force1,
        force2=force2,
        contraction1=contraction1,
        contraction2=contraction2,
        saturated=saturated,
        slack=(force1 <= 0) | (force2 <= 0),
        outside_domain=~inside,
    )


compiled_trajectory = compiled(trajectory)
