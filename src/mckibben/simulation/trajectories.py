"""Trajectory of a run: the plant's true torque, stiffness, muscle forces and air at each control period."""

from __future__ import annotations

import functools
import operator
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.actuator.base import at_room_temperature
from mckibben.component.columns import Label, declare, labelled, labels_of
from mckibben.mechanism.base import angles_of, over_joints
from mckibben.plant import Plant
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

    Quantities of joints are those of the unnamed joint, or tuples over the joints, and those of muscles tuples. In
    results they are columns: of an unnamed joint each has shape (periods,), such as ``angle``, ``pressure1`` and
    ``pressure2``; else (joints, periods) or (muscles, periods).

    Stiffness, torque, forces and contractions are those of the plant. Torque and forces include the muscles' friction
    and creep; stiffness is that of the force laws, or of the controller's `stiffness_amplitude` if it has one.
    """

    angle: Annotated[PyTree, Label("rad", "joint angle", along="joint")]
    velocity: Annotated[PyTree, Label("rad/s", "angular velocity", along="joint")]
    desired_angle: Annotated[PyTree, Label("rad", "desired joint angle", along="joint")]
    angle_without_step: Annotated[
        PyTree,
        Label("rad", "joint angle of the same run without the last change of the desired stiffness", along="joint"),
    ]
    desired_stiffness: Annotated[PyTree, Label("N*m/rad", "desired joint stiffness", along="joint")]
    stiffness: Annotated[PyTree, Label("N*m/rad", "isobaric joint stiffness of the plant's muscles", along="joint")]
    total_stiffness: Annotated[
        PyTree, Label("N*m/rad", "joint stiffness of the plant's muscles and gravity", along="joint")
    ]
    stiffness_estimate: Annotated[
        PyTree, Label("N*m/rad", "controller's estimate of the joint stiffness", along="joint")
    ]
    torque: Annotated[PyTree, Label("N*m", "torque of the muscles", along="joint")]
    pressure: Annotated[tuple[Array, ...], Label("Pa", "gauge pressure", along="muscle")]
    command: Annotated[tuple[Array, ...], Label("Pa", "commanded pressure", along="muscle")]
    force: Annotated[tuple[Array, ...], Label("N", "tension", along="muscle")]
    contraction: Annotated[tuple[Array, ...], Label("1", "contraction", along="muscle")]
    saturated: Annotated[Array, Label("1", "a command is at a pressure limit")]
    slack: Annotated[Array, Label("1", "a muscle is slack")]
    outside_domain: Annotated[Array, Label("1", "a muscle's contraction or pressure is outside its domain")]
    overloaded: Annotated[Array, Label("1", "a muscle's tension is above its rating")]
    excursion: Annotated[Array, Label("1", "distance of a contraction from its domain")]
    air: Annotated[tuple[Array, ...], Label("m^3", "air, as a volume at atmospheric pressure", along="muscle")]


LABELS = labels_of(Trajectory)
_PAIR = {
    f"{name}{number}": Label(label.unit, f"{label.title} of muscle {number}")
    for name, label in LABELS.items()
    if label.along == "muscle"
    for number in (1, 2)
}
declare(__name__, _PAIR)
REFERENCES = ("desired_angle", "desired_stiffness", "angle_without_step")
"""Columns of runs that follow references."""


@functools.cache
def column_names(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns of a trajectory in results: those of an unnamed joint have one for each of its two muscles."""
    each = {name: [f"{name}1", f"{name}2"] if label.along == "muscle" else [name] for name, label in LABELS.items()}
    return tuple(LABELS) if joints else tuple(name for names in each.values() for name in names)


def column_of(moved: Trajectory, name: str) -> Any:
    """Return a column of results; a tuple has a value for each joint or muscle."""
    return getattr(moved, name) if name in LABELS else getattr(moved, name[:-1])[int(name[-1]) - 1]


def trajectory_of(columns: Any, joints: tuple[str, ...]) -> Trajectory:
    """Return the trajectory of columns in results."""

    def values(name: str, label: Label) -> PyTree:
        if label.along == "muscle" and not joints:
            return columns[f"{name}1"], columns[f"{name}2"]
        return tuple(columns[name]) if label.along and joints else columns[name]

    return Trajectory(**{name: values(name, label) for name, label in LABELS.items()})


def trajectory(
    plant: Plant,
    setpoints: PyTree,
    record: Record,
    angle_without_step: PyTree,
    stiffness_amplitude: ArrayLike | None = None,
) -> Trajectory:
    """Trajectory of a record; elementwise, of one control period or of all.

    Setpoints are those of the joint, a tuple of those of the joints, or, of runs without reference, the times.
    """
    state, mechanism = record.state, plant.mechanism
    muscles = state.muscles
    torque, stiffness, forces, contractions = mechanism.statics(
        state.position, state.velocity, state.pressures, muscles, stiffness_amplitude
    )
    nothing = over_joints(lambda own: jnp.full_like(own, jnp.nan), stiffness)
    follows = not hasattr(setpoints, "dtype")
    states = list(zip(plant.muscles, contractions, state.pressures, strict=True))
    air = tuple(
        at_room_temperature(
            (muscle.specimen.volume(contraction) + plant.valve_of(i).dead_volume) * (pressure + atm) / atm, state.air, i
        )
        if muscle.specimen.has_volume
        else jnp.full_like(contraction, jnp.nan)
        for i, (muscle, contraction, pressure) in enumerate(states)
    )
    inside = [muscle.domain.contains(contraction, pressure) for muscle, contraction, pressure in states]
    beyond = [
        jnp.maximum(muscle.domain.contraction_min - contraction, contraction - muscle.domain.contraction_max)
        for muscle, contraction, _ in states
    ]
    slack = [force <= 0 for muscle, force in zip(plant.muscles, forces, strict=True) if muscle.law.pulls]
    over = [force > muscle.specimen.force_limit for muscle, force in zip(plant.muscles, forces, strict=True)]
    return Trajectory(
        angle=state.angle,
        velocity=angles_of(state.velocity),
        desired_angle=over_joints(lambda own: own.angle, setpoints) if follows else nothing,
        angle_without_step=angle_without_step,
        desired_stiffness=over_joints(lambda own: own.stiffness, setpoints) if follows else nothing,
        stiffness=stiffness,
        total_stiffness=over_joints(operator.add, stiffness, mechanism.gravity_stiffness(state.position)),
        stiffness_estimate=record.telemetry.get("stiffness_estimate", nothing),
        torque=torque,
        pressure=tuple(state.pressures),
        command=record.commands,
        force=tuple(forces),
        contraction=tuple(contractions),
        saturated=record.limited | record.telemetry.get("saturated", False),
        slack=functools.reduce(operator.or_, slack),
        outside_domain=~functools.reduce(operator.and_, inside),
        overloaded=functools.reduce(operator.or_, over),
        excursion=jnp.maximum(functools.reduce(jnp.maximum, beyond), 0.0),
        air=air,
    )
