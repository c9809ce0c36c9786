"""What follows from a recorded episode: the plant's true torque, stiffness and muscles, computed once, vectorised."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.control.base import Setpoint
from mckibben.joint.friction import plain, pull
from mckibben.numerics.compiled import compiled
from mckibben.numerics.many import apart
from mckibben.plant import JointPlant
from mckibben.simulation.loop import Record
from mckibben.units import atm


class Trajectory(NamedTuple):
    """An episode over time; every leaf has shape (periods,), SI units.

    Stiffness, torque, forces and contractions are the plant's own, not the controller's belief. Torque and forces
    contain the muscles' friction and creep; ``stiffness`` is that of the muscles' laws, ``total_stiffness`` that and
    gravity's. ``undisturbed_angle`` is the angle of the same run without the last change of the desired stiffness,
    where there is one to leave out. ``excursion`` is how far the worse of the two contractions lies outside its domain.
    ``air1`` and ``air2`` are what the muscles hold, as volumes at atmospheric pressure [m^3], by the volumes inside
    their braids.
    """

    angle: Array
    velocity: Array
    desired_angle: Array
    undisturbed_angle: Array
    desired_stiffness: Array
    stiffness: Array
    total_stiffness: Array
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
    overloaded: Array
    excursion: Array
    air1: Array
    air2: Array


def trajectory(
    plant: JointPlant, setpoints: Setpoint, record: Record, undisturbed_angle: Array, period: ArrayLike = 1.0
) -> Trajectory:
    """Work out the trajectory of a record. Pure and elementwise: of one control period or of all of them.

    Parameters
    ----------
    plant, setpoints, record
        As `episode` took and gave them.
    undisturbed_angle
        The angle [rad] of a run to the same wishes `without_last_change`; the same angle where there is none.
    period
        The control period [s]; only looked at in programs for many runs.
    """
    state, joint = record.state, plant.joint
    torque, stiffness = apart(joint.torque_and_stiffness, state.angle, state.pressures, witness=period)
    if not plain(joint):
        motion = state.angle, state.velocity, state.pressures
        pulled = apart(functools.partial(pull, joint), state.memories, *motion, state.relaxing, witness=period)
        (force1, force2), torque, (contraction1, contraction2) = pulled
    else:
        contraction1, contraction2 = apart(joint.contractions, state.angle, state.pressures, witness=period)
        force1 = joint.muscle1.tension(contraction1, state.pressure1)
        force2 = joint.muscle2.tension(contraction2, state.pressure2)
    muscles = ((joint.muscle1, contraction1, state.pressure1), (joint.muscle2, contraction2, state.pressure2))
    air1, air2 = (m.specimen.volume(contraction) * (pressure + atm) / atm for m, contraction, pressure in muscles)
    inside = [muscle.domain.contains(contraction, pressure) for muscle, contraction, pressure in muscles]
    beyond = [
        jnp.maximum(muscle.domain.contraction_min - contraction, contraction - muscle.domain.contraction_max)
        for muscle, contraction, _ in muscles
    ]
    rated1, rated2 = joint.muscle1.specimen.rated_force, joint.muscle2.specimen.rated_force
    return Trajectory(
        angle=state.angle,
        velocity=state.velocity,
        desired_angle=setpoints.angle,
        undisturbed_angle=undisturbed_angle,
        desired_stiffness=setpoints.stiffness,
        stiffness=stiffness,
        total_stiffness=stiffness + plant.load.gravity_stiffness(state.angle),
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
        saturated=record.limited | record.telemetry.get("saturated", False),
        slack=(force1 <= 0) | (force2 <= 0),
        outside_domain=~(inside[0] & inside[1]),
        overloaded=(force1 > rated1) | (force2 > rated2),
        excursion=jnp.maximum(jnp.maximum(beyond[0], beyond[1]), 0.0),
        air1=air1,
        air2=air2,
    )


compiled_trajectory = compiled(trajectory)
