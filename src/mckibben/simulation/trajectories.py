"""Trajectory of a run: the plant's true torque, stiffness, muscle forces and air at each control period."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.actuator.base import at_room_temperature
from mckibben.component.columns import Label, labelled
from mckibben.control.base import Setpoint
from mckibben.joint.antagonistic import NO_STATES
from mckibben.numerics.batching import fusion_barrier
from mckibben.plant import JointPlant
from mckibben.units import atm


class Record(NamedTuple):
    """The record of every control period; each leaf has the shape of the time axis."""

    state: PyTree  # what the plant observes of its state
    commands: tuple[Array, ...]  # within the limits of the plant
    limited: Array  # whether the plant limited a command
    telemetry: dict[str, Array]


@labelled
class Trajectory(NamedTuple):
    """An episode over time; every leaf has shape (periods,), SI units.

    Stiffness, torque, forces and contractions are those of the plant. Torque and forces include the muscles' friction
    and creep; stiffness is that of the force laws, or of the controller's `stiffness_amplitude` if it has one.
    """

    angle: Annotated[Array, Label("rad", "joint angle")]
    velocity: Annotated[Array, Label("rad/s", "angular velocity")]
    desired_angle: Annotated[Array, Label("rad", "desired joint angle")]
    angle_without_step: Annotated[
        Array, Label("rad", "joint angle of the same run without the last change of the desired stiffness")
    ]
    desired_stiffness: Annotated[Array, Label("N*m/rad", "desired joint stiffness")]
    stiffness: Annotated[Array, Label("N*m/rad", "isobaric joint stiffness of the plant's muscles")]
    total_stiffness: Annotated[Array, Label("N*m/rad", "joint stiffness of the plant's muscles and gravity")]
    stiffness_estimate: Annotated[Array, Label("N*m/rad", "controller's estimate of the joint stiffness")]
    torque: Annotated[Array, Label("N*m", "torque of the muscles")]
    pressure1: Annotated[Array, Label("Pa", "gauge pressure in muscle 1")]
    pressure2: Annotated[Array, Label("Pa", "gauge pressure in muscle 2")]
    command1: Annotated[Array, Label("Pa", "commanded pressure of muscle 1")]
    command2: Annotated[Array, Label("Pa", "commanded pressure of muscle 2")]
    force1: Annotated[Array, Label("N", "tension of muscle 1")]
    force2: Annotated[Array, Label("N", "tension of muscle 2")]
    contraction1: Annotated[Array, Label("1", "contraction of muscle 1")]
    contraction2: Annotated[Array, Label("1", "contraction of muscle 2")]
    saturated: Annotated[Array, Label("1", "a command is at a pressure limit")]
    slack: Annotated[Array, Label("1", "a muscle is slack")]
    outside_domain: Annotated[Array, Label("1", "a muscle's contraction or pressure is outside its domain")]
    overloaded: Annotated[Array, Label("1", "a muscle's tension is above its rating")]
    excursion: Annotated[Array, Label("1", "distance of a contraction from its domain")]
    air1: Annotated[Array, Label("m^3", "air in muscle 1, as a volume at atmospheric pressure")]
    air2: Annotated[Array, Label("m^3", "air in muscle 2, as a volume at atmospheric pressure")]


def trajectory(
    plant: JointPlant,
    setpoints: Setpoint,
    record: Record,
    angle_without_step: Array,
    stiffness_amplitude: ArrayLike | None = None,
) -> Trajectory:
    """Trajectory of a record; elementwise, of one control period or of all."""
    state, joint = record.state, plant.joint
    torque, stiffness = fusion_barrier(joint.torque_and_stiffness, state.angle, state.pressures)
    if stiffness_amplitude is not None:
        stiffness = fusion_barrier(joint.secant_stiffness, state.angle, state.pressures, stiffness_amplitude)
    pressure1, pressure2 = state.pressures
    if state.muscles != NO_STATES:
        forces = fusion_barrier(joint.forces, state.angle, state.velocity, state.pressures, state.muscles)
        (force1, force2), torque, (contraction1, contraction2) = forces
    else:
        contraction1, contraction2 = fusion_barrier(joint.contractions, state.angle, state.pressures)
        force1 = joint.muscle1.tension(contraction1, pressure1)
        force2 = joint.muscle2.tension(contraction2, pressure2)
    muscles = ((joint.muscle1, contraction1, pressure1), (joint.muscle2, contraction2, pressure2))
    dead = [plant.valve.for_muscle(i).dead_volume for i in (0, 1)]
    air1, air2 = (
        at_room_temperature((m.specimen.volume(contraction) + dead[i]) * (pressure + atm) / atm, state.air, i)
        if m.specimen.has_volume
        else jnp.full_like(stiffness, jnp.nan)
        for i, (m, contraction, pressure) in enumerate(muscles)
    )
    inside = [muscle.domain.contains(contraction, pressure) for muscle, contraction, pressure in muscles]
    beyond = [
        jnp.maximum(muscle.domain.contraction_min - contraction, contraction - muscle.domain.contraction_max)
        for muscle, contraction, _ in muscles
    ]
    rated1, rated2 = joint.muscle1.specimen.force_limit, joint.muscle2.specimen.force_limit
    return Trajectory(
        angle=state.angle,
        velocity=state.velocity,
        desired_angle=setpoints.angle,
        angle_without_step=angle_without_step,
        desired_stiffness=setpoints.stiffness,
        stiffness=stiffness,
        total_stiffness=stiffness + plant.load.gravity_stiffness(state.angle),
        stiffness_estimate=record.telemetry.get("stiffness_estimate", jnp.full_like(stiffness, jnp.nan)),
        torque=torque,
        pressure1=pressure1,
        pressure2=pressure2,
        command1=record.commands[0],
        command2=record.commands[1],
        force1=force1,
        force2=force2,
        contraction1=contraction1,
        contraction2=contraction2,
        saturated=record.limited | record.telemetry.get("saturated", False),
        slack=(force1 <= 0) | (force2 <= 0),
        outside_domain=~(inside[0] & inside[1]),
        overloaded=(force1 > rated1) | (force2 > rated2),
        excursion=jnp.maximum(jnp.maximum(beyond[0], beyond[1]), 0.0),
        air1=air1,
        air2=air2,
    )
