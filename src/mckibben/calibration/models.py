"""Models that a calibration corrects: what the muscles of a recording move."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
from jaxtyping import Array

from mckibben.calibration.recordings import JointRecording
from mckibben.errors import IdentificationError
from mckibben.joint import AntagonisticJoint, Load, ScaledArms
from mckibben.joint.route import Route
from mckibben.mechanism import Robot
from mckibben.mechanism.dynamics import joint_equations
from mckibben.muscle import Muscle
from mckibben.units import GRAVITY, HINGE, SLIDE, JointType

Number = Any  # float | Array


class Weight(NamedTuple):
    """A known weight: mass [kg], distance of its centre from the axis [m], and its own inertia [kg*m^2]."""

    mass: Number = 0.0
    distance: Number = 0.0
    inertia: Number = 0.0


class Moved(Protocol):
    """Joints with their loads and muscles, of which a calibration estimates the parameters `priors` names.

    Sequences over joints and muscles have the order of a recording's columns.
    """

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Prefix of the quantities of each joint."""

    @property
    def joint_type(self) -> JointType:
        """How the joints move."""

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Name of each muscle."""

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        """All muscles."""

    def check(self, recordings: Sequence[JointRecording]) -> None:
        """Raise `IdentificationError` if the model cannot have moved as recorded."""

    def priors(self, prior: Any) -> dict[str, float]:
        """Return names of parameters, and their deviations, relative ones of factors about 1."""

    @property
    def absolute(self) -> dict[str, Number]:
        """Values in SI of the parameters that are factors of them."""

    @property
    def parts(self) -> dict[str, Any]:
        """Parts of a plant by their names in a scenario."""

    def with_muscles(self, muscles: Sequence[Muscle]) -> Moved:
        """Return the model with other muscles, in their order."""

    def changed(self, muscles: Sequence[Muscle], values: Mapping[str, Number]) -> Moved:
        """Return the model with other muscles and with parameters, each a factor or a difference from its prior."""

    @property
    def physical(self) -> Moved:
        """The model with estimates that are not negative where they cannot be."""

    def routes(self, angles: Sequence[Number]) -> Sequence[Route]:
        """Return all muscles with their paths at angles [rad]."""

    def required(
        self, angles: Sequence[Number], rates: Sequence[Number], accelerations: Sequence[Number], weight: Weight
    ) -> list[Number]:
        """Return the torques [N*m] of the muscles for a motion, with a weight."""

    def stiffness(self, angles: Sequence[Number], pressures: Sequence[Number]) -> Sequence[Array]:
        """Return the isobaric stiffness [N*m/rad] of each joint, the others held."""


class HingeModel(NamedTuple):
    """A joint with two muscles and its load. `inertia` is in excess of that of the load [kg*m^2]."""

    joint: AntagonisticJoint
    load: Load
    inertia: Number = 0.0

    @property
    def joint_names(self) -> tuple[str, ...]:
        return ("",)

    @property
    def joint_type(self) -> JointType:
        return self.joint.joint_type

    @property
    def muscle_names(self) -> tuple[str, ...]:
        return "muscle1", "muscle2"

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        return self.joint.muscles

    def check(self, recordings: Sequence[JointRecording]) -> None:
        pass

    def priors(self, prior: Any) -> dict[str, float]:
        mass = {"load.mass": prior.mass} if self.load.estimated_mass else {}
        if self.joint_type is SLIDE:  # its inertia is the mass, and its moment arms are 1
            return mass
        return mass | {"load.inertia": prior.inertia, "arm_scale": prior.arm_scale}

    @property
    def absolute(self) -> dict[str, Number]:
        name = self.load.estimated_mass
        mass = {"load.mass": getattr(self.load, name)} if name else {}
        if self.joint_type is SLIDE:
            return mass
        return mass | {"load.inertia": self.load.total_inertia + self.inertia}

    @property
    def parts(self) -> dict[str, Any]:
        return {"joint": self.joint, "load": self.load}

    def with_muscles(self, muscles: Sequence[Muscle]) -> HingeModel:
        first, second = muscles
        return self._replace(joint=dataclasses.replace(self.joint, muscle1=first, muscle2=second))

    def changed(self, muscles: Sequence[Muscle], values: Mapping[str, Number]) -> HingeModel:
        load: Any = self.load
        name = load.estimated_mass
        changes = {"damping": load.damping + values["damping"]}
        if name:
            changes[name] = getattr(load, name) * values["load.mass"]
        changed = self.with_muscles(muscles)._replace(load=dataclasses.replace(load, **changes))
        if self.joint_type is SLIDE:
            return changed
        geometry = ScaledArms(self.joint.geometry, values["arm_scale"])
        joint, inertia = dataclasses.replace(changed.joint, geometry=geometry), values["load.inertia"] - 1
        return changed._replace(joint=joint, inertia=inertia * load.total_inertia)

    def routes(self, angles: Sequence[Number]) -> Sequence[Route]:
        return self.joint.routes(angles[0])

    def required(
        self, angles: Sequence[Number], rates: Sequence[Number], accelerations: Sequence[Number], weight: Weight
    ) -> list[Number]:
        loaded = self.load.with_weight(weight.mass, weight.distance)
        torque: Any = loaded.required_torque(angles[0], rates[0], accelerations[0])
        return [torque + (self.inertia + weight.inertia) * accelerations[0]]

    def stiffness(self, angles: Sequence[Number], pressures: Sequence[Number]) -> Sequence[Array]:
        return [self.joint.evaluate(angles[0], (pressures[0], pressures[1]))[1]]

    @property
    def physical(self) -> HingeModel:
        """The model with damping and inertia that are not negative; the load has the inertia if it is a parameter."""
        load: Any = self.load
        load, inertia = dataclasses.replace(load, damping=jnp.maximum(load.damping, 0.0)), self.inertia
        if not hasattr(load, "inertia"):
            return self._replace(load=load)
        load = dataclasses.replace(load, inertia=jnp.maximum(load.inertia + inertia, 0.0))
        return self._replace(load=load, inertia=0.0)


class RobotModel(NamedTuple):
    """A robot on a fixed base: mass and inertia of each body on a joint are estimated; no weight is added."""

    robot: Robot

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(f"{name}." for name in self.robot.joint_names)

    @property
    def joint_type(self) -> JointType:
        return HINGE

    @property
    def muscle_names(self) -> tuple[str, ...]:
        return self.robot.muscle_names

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        return self.robot.all_muscles

    def check(self, recordings: Sequence[JointRecording]) -> None:
        if self.robot.base != "fixed":
            message = f"the base moves: {self.robot.base}"
            raise IdentificationError(message, field="robot.base", remedy="hold it, and give the robot `base: fixed`")
        if locked := [joint.name for joint in self.robot.joints if joint.locked is not None]:
            raise IdentificationError(f"{', '.join(locked)}: locked", remedy="give the robot without locked joints")
        if any(recording.added_mass for recording in recordings):
            raise IdentificationError("a weight on a robot has no place", remedy="give it as a body of the robot")

    def priors(self, prior: Any) -> dict[str, float]:
        widths = {"mass": prior.mass, "inertia": prior.inertia}
        return {f"{body.name}.{name}": width for body in self.robot.bodies[1:] for name, width in widths.items()}

    @property
    def absolute(self) -> dict[str, Number]:
        return {f"{body.name}.mass": body.mass for body in self.robot.bodies[1:]}

    @property
    def parts(self) -> dict[str, Any]:
        return {"robot": self.robot}

    def with_muscles(self, muscles: Sequence[Muscle]) -> RobotModel:
        following = iter(muscles)
        units: list[Any] = []
        for unit in self.robot.muscles:
            names = ("muscle1", "muscle2") if len(unit.names) > 1 else ("muscle",)
            units.append(dataclasses.replace(unit, **{name: next(following) for name in names}))
        return RobotModel(dataclasses.replace(self.robot, muscles=tuple(units)))

    def changed(self, muscles: Sequence[Muscle], values: Mapping[str, Number]) -> RobotModel:
        """Return the model with other muscles, and changed bodies and dampings."""
        bodies = [
            dataclasses.replace(
                body,
                mass=body.mass * values[f"{body.name}.mass"],
                inertia=tuple(number * values[f"{body.name}.inertia"] for number in body.inertia),
            )
            for body in self.robot.bodies[1:]
        ]
        joints = [
            dataclasses.replace(joint, damping=joint.damping + values[f"{joint.name}.damping"])
            for joint in self.robot.joints
        ]
        parts = {"bodies": (self.robot.bodies[0], *bodies), "joints": tuple(joints)}
        return RobotModel(dataclasses.replace(self.with_muscles(muscles).robot, **parts))

    @property
    def physical(self) -> RobotModel:
        joints: list[Any] = list(self.robot.joints)
        joints = [dataclasses.replace(joint, damping=jnp.maximum(joint.damping, 0.0)) for joint in joints]
        return RobotModel(dataclasses.replace(self.robot, joints=tuple(joints)))

    def routes(self, angles: Sequence[Number]) -> Sequence[Route]:
        return self.robot.routed_muscles(angles)

    def required(
        self, angles: Sequence[Number], rates: Sequence[Number], accelerations: Sequence[Number], weight: Weight
    ) -> list[Number]:
        matrix, bias = joint_equations(self.robot, angles, rates, GRAVITY)
        rows = zip(matrix, bias, self.robot.joints, rates, strict=True)
        return [
            sum((m * a for m, a in zip(row, accelerations, strict=True)), torque + joint.damping * rate)
            for row, torque, joint, rate in rows
        ]

    def stiffness(self, angles: Sequence[Number], pressures: Sequence[Number]) -> Sequence[Array]:
        return self.robot.stiffness(angles, pressures)
