"""The reference episode: the paper's knee over 10 s, control at 1 kHz, RK4 with 4 substeps, two loops.

Everything is built from our own objects; `Numbers` hands the same numbers to the other engines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

import mckibben as mk
from mckibben.control import Controller, Setpoint
from mckibben.plant import PlantState
from mckibben.simulation import sampled
from mckibben.units import bar, deg, mm, ms

PERIODS, PERIOD, SUBSTEPS = 10_000, 1 * ms, 4
REFERENCE = mk.Reference(mk.Sine(10 * deg, 0.5), mk.Step(13.0, 17.0, 5.0))
POSITION = mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar)
STIFFNESS = mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0)


class Numbers(NamedTuple):
    """The episode's parameters in SI, in the order of `Parameters` in engines/knee.h."""

    a1: float
    a2: float
    b1: float
    b2: float
    c1: float
    c2: float
    decay: float
    initial_length: float
    joint_length: float
    joint_radius: float
    connector_length: float
    inertia: float
    damping: float
    gravity: float
    hanging: float
    time_constant: float
    low: float
    high: float
    position_kp: float
    stiffness_kp: float
    position_ki: float
    stiffness_ki: float
    position_kd: float
    stiffness_kd: float
    position_filter: float
    stiffness_filter: float
    position_tracking: float
    stiffness_tracking: float


@dataclass(frozen=True)
class Problem:
    """A plant, its controllers and setpoints, and the state it starts from."""

    plant: mk.JointPlant
    pid: mk.PositionStiffnessControl
    setpoints: Setpoint
    start: PlantState

    @property
    def periods(self) -> int:
        """How many control periods it lasts."""
        return len(self.setpoints.angle)

    @property
    def wanted(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The desired angle and stiffness at the start of each period."""
        return np.array(self.setpoints.angle, float), np.array(self.setpoints.stiffness, float)

    @property
    def first(self) -> NDArray[np.float64]:
        """The state at the start: angle, velocity, p1, p2."""
        return np.array([float(value) for value in (self.start.angle, self.start.velocity, *self.start.pressures)])

    @property
    def numbers(self) -> Numbers:
        """The same numbers for the other engines."""
        return numbers(self.plant, self.pid)

    def shortened(self, periods: int) -> Problem:
        """The first so many control periods."""
        setpoints = Setpoint(self.setpoints.angle[:periods], self.setpoints.stiffness[:periods])
        return Problem(self.plant, self.pid, setpoints, self.start)


def reference_problem() -> Problem:
    """The knee with connectors of 208 mm; as in examples/pre-contracted-step-pid.yaml."""
    printed = mk.catalog.joint("knee-table-2")
    geometry = mk.KneeGeometry(printed.geometry.joint_length, printed.geometry.joint_radius, 208 * mm)
    joint = mk.AntagonisticJoint(geometry, printed.muscle1, printed.muscle2)
    plant = mk.JointPlant(joint, mk.catalog.load("knee-table-2"), mk.FirstOrderValve(20 * ms))
    _, setpoints = sampled(REFERENCE, PERIODS * PERIOD, PERIOD)
    return Problem(
        plant,
        mk.PositionStiffnessControl(POSITION, STIFFNESS, model=joint),
        setpoints,
        plant.equilibrium(0.0, stiffness=12.0),
    )


def with_mass(plant: mk.JointPlant, mass2: ArrayLike) -> mk.JointPlant:
    """The plant with another external load [kg]."""
    return eqx.tree_at(lambda p: p.load.mass2, plant, mass2)


def with_gains(controller: mk.PositionStiffnessControl, gains: ArrayLike) -> mk.PositionStiffnessControl:
    """The controller with these kp, ki, kd of the position loop and kp, ki, kd of the stiffness loop."""
    return eqx.tree_at(
        lambda c: tuple(getattr(loop, name) for loop in (c.position, c.stiffness) for name in ("kp", "ki", "kd")),
        controller,
        tuple(jnp.asarray(gains)[i] for i in range(6)),
    )


def gains_of(controller: mk.PositionStiffnessControl) -> NDArray[np.float64]:
    """What `with_gains` takes."""
    loops = (controller.position, controller.stiffness)
    return np.array([float(getattr(loop, name)) for loop in loops for name in ("kp", "ki", "kd")])


def numbers(plant: mk.JointPlant, controller: Controller) -> Numbers:
    """What the other engines need to know of a knee, its load and its PID loops."""
    assert isinstance(controller, mk.PositionStiffnessControl)
    law, specimen, domain = plant.joint.muscle1.law, plant.joint.muscle1.specimen, plant.joint.muscle1.domain
    geometry, load = plant.joint.geometry, plant.load
    loops = (controller.position, controller.stiffness)
    values = (
        *(getattr(law, name) for name in ("a1", "a2", "b1", "b2", "c1", "c2", "decay")),
        *(specimen.initial_length, geometry.joint_length, geometry.joint_radius, geometry.connector_length),
        *(load.total_inertia, load.damping, load.gravity_moment, load.hanging_angle),
        *(plant.valve.time_constant, domain.pressure_min, domain.pressure_max),
        *(getattr(loop, name) for name in ("kp", "ki", "kd", "filter_time", "tracking_time") for loop in loops),
    )
    return Numbers(*(float(value) for value in values))
