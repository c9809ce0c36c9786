"""The muscles of a joint as an actuator of Newton, with plants drawn from intervals as domain randomisation."""
# pyrefly: ignore-errors

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from mckibben.errors import ExportError
from mckibben.export.episodes import example_of, plants_of
from mckibben.export.mjcf import Transmission, check_parts, command_range, gravity_of, mass_point, muscle_module
from mckibben.export.warp import check_version, drawn_muscles, loaded, split_parameters, warp_muscles, with_strengths
from mckibben.plant import JointPlant, PlantState
from mckibben.scenario import Scenario
from mckibben.study.compare.suite import Suite

check_version("newton", "1.7", "1.9")  # of other versions, the imports fail
from newton import ModelBuilder  # noqa: E402
from newton.actuators import DriveBase  # noqa: E402

COMMANDS = "muscle_command1", "muscle_command2"
"""Arrays of `newton.Control` with the commands [Pa] of the muscles, one element per degree of freedom."""
_LEAST_INERTIA = 2e-6  # kg*m^2: Newton enlarges smaller ones


@dataclass(frozen=True, eq=False, kw_only=True)
class MuscleJoint:
    """A joint with its load and muscles, for Newton's builders."""

    module: ModuleType  # muscles as functions of Warp; their length is the angle, and their force a torque
    parameters: Mapping[str, Any]  # by `PARAMETERS` and `command_delay`, a row per plant; joints take them in turn
    timestep: float  # of the simulation [s]
    left_out: tuple[str, ...]  # parts of the scenario, and varied parameters, that the joint does not have
    plant: JointPlant
    start: PlantState
    activations: tuple[Sequence[float], Sequence[float]]  # of both muscles at the start

    def add_to(self, builder: ModelBuilder, parent: int = -1, xform: Any = None) -> int:
        """Add the limb, its joint and its muscles to a builder; returns the index of the joint."""
        load, friction = self.plant.load, self.plant.friction
        mass, distance, inertia, _ = mass_point(load)
        moment, total = mass * distance, inertia + mass * distance**2
        if inertia < _LEAST_INERTIA < total:  # the same torques of gravity and inertia, with a slightly larger mass
            distance, inertia = (total - _LEAST_INERTIA) / moment, _LEAST_INERTIA
            mass = moment / distance
        link = builder.add_link(
            mass=mass, com=wp.vec3(0.0, -distance, 0.0), inertia=wp.mat33(np.eye(3) * inertia), lock_inertia=True
        )
        sine, cosine = np.sin(float(load.hanging_angle)), np.cos(float(load.hanging_angle))
        turned = np.array([[cosine, sine, 0.0], [0.0, 0.0, -1.0], [-sine, cosine, 0.0]])  # gravity is along -z
        frame = wp.transform(wp.vec3(), wp.quat_from_matrix(wp.mat33(turned)))
        joint = builder.add_joint_revolute(
            parent,
            link,
            parent_xform=frame if xform is None else wp.transform(*xform) * frame,
            axis=(0.0, 0.0, 1.0),
            damping=float(load.damping),
            friction=0.0 if friction is None else float(friction.torque),
        )
        position, speed = builder.joint_q_start[joint], builder.joint_qd_start[joint]
        builder.joint_q[position], builder.joint_qd[speed] = float(self.start.angle), float(self.start.velocity)
        builder.add_actuator(MuscleDrive, index=speed, pos_index=position, joint=self)
        return joint

    def muscles(self, worlds: int, device: Any) -> Any:
        """`Muscles` of the module in arrays of two columns, and of one more for each further activation."""
        joint, valve, timestep = self.plant.joint, self.plant.valve, self.timestep
        limits = [command_range(valve.for_muscle(i), one) for i, one in enumerate((joint.muscle1, joint.muscle2))]
        second = 1 + max(len(self.activations[0]), 1)

        class Alone(self.module.Muscles):
            def place(self, mjm: Any, prefix: str) -> None:
                self.actuators, self.first, self.rest = (0, 1), (0, 1), (2, second)
                self.ranges, self.timestep = limits, timestep

        return drawn_muscles(Alone, self.parameters, None, worlds, device)


class MuscleDrive(DriveBase):
    """Both muscles of a joint, by Heun's method under the commands in `COMMANDS` [Pa]; `muscles` has the parameters."""

    SHARED_PARAMS = {"joint"}  # noqa: RUF012
    custom_inputs = COMMANDS

    @dataclass
    class State(DriveBase.State):
        """State of the muscles: activations, anchors of friction, commands under way, and the number of steps."""

        act: Any
        anchors: Any
        sent: Any
        last: Any
        steps: Any
        start: Any

        def reset(self, mask: Any = None) -> None:
            mask = wp.full(len(self.last), True, dtype=bool, device=self.last.device) if mask is None else mask
            wp.launch(_reset, dim=self.act.shape, inputs=[mask, self.start, self.act, self.last], device=mask.device)

    @classmethod
    def resolve_arguments(cls, args: dict[str, Any]) -> dict[str, Any]:
        return {"joint": args["joint"]}

    def __init__(self, joint: MuscleJoint) -> None:
        self.joint = joint

    def finalize(self, device: Any, num_actuators: int) -> None:
        one, two = self.joint.activations
        start = [*(one[:1] or [0.0]), *(two[:1] or [0.0]), *one[1:], *two[1:]]
        self.muscles = self.joint.muscles(num_actuators, device)
        with wp.ScopedDevice(device):
            self._start = wp.array(start, dtype=float)
            zeros = lambda columns: wp.zeros((num_actuators, columns), dtype=float)  # noqa: E731
            self._now = SimpleNamespace(
                time=wp.full(num_actuators, 1.0, dtype=float), ctrl=zeros(2), actuator_length=zeros(2),
                actuator_velocity=zeros(2), actuator_force=zeros(2), act=zeros(len(start)), act_dot=zeros(len(start)),
            )  # fmt: skip
            self._rate = zeros(len(start))

    def is_stateful(self) -> bool:
        return True

    def is_graphable(self) -> bool:
        return True

    def state(self, num_actuators: int, device: Any) -> State:
        held = [self._now.act, *(getattr(self.muscles, name) for name in ("anchors", "sent", "last", "steps"))]
        made = self.State(*map(wp.clone, held), self._start)
        made.reset()
        return made

    def compute(
        self,
        positions: Any,
        velocities: Any,
        target_pos: Any,
        target_vel: Any,
        feedforward: Any,
        pos_indices: Any,
        vel_indices: Any,
        target_pos_indices: Any,
        target_vel_indices: Any,
        forces: Any,
        state: State,
        dt: float,
        device: Any = None,
        *,
        custom_inputs: dict[str, Any],
    ) -> None:
        if not np.isclose(dt, self.joint.timestep, rtol=1e-4):
            remedy = "give muscle_joint the time step of the simulation"
            raise ExportError(f"the time step is {dt:g} s", field="timestep", value=dt, remedy=remedy)
        now, count, muscles = self._now, len(forces), self.muscles
        self._copy(state, muscles, now.act)
        inputs = [positions, velocities, *map(custom_inputs.get, COMMANDS), pos_indices, vel_indices]
        held = [now.actuator_length, now.actuator_velocity, now.ctrl]
        wp.launch(_gather, dim=count, inputs=[*inputs, *held], device=device)
        muscles.act_dyn(None, now)
        muscles.act_bias(None, now)
        wp.launch(_torque, dim=count, inputs=[now.actuator_force, forces], device=device)
        wp.copy(self._rate, now.act_dot)
        add = lambda factor, change, total: wp.launch(_add, total.shape, [factor, change, total], device=device)  # noqa: E731
        add(dt, self._rate, now.act)
        add(dt, now.actuator_velocity, now.actuator_length)
        muscles.act_dyn(None, now)
        add(dt / 2, now.act_dot, now.act)
        add(-dt / 2, self._rate, now.act)

    def update_state(self, current_state: State, next_state: State) -> None:
        self._copy(self.muscles, next_state, next_state.act)
        wp.copy(next_state.act, self._now.act)
        next_state.last.zero_()  # the next call is later

    def _copy(self, source: Any, target: Any, act: Any) -> None:
        for name in ("anchors", "sent", "last", "steps"):
            wp.copy(getattr(target, name), getattr(source, name))
        wp.copy(act, getattr(source, "act", self._now.act))


def muscle_joint(
    scenario: Scenario | Suite | str | os.PathLike[str],
    timestep: float,
    random_plant: Sequence[str] = (),
    plants: int = 256,
    seed: int = 0,
) -> MuscleJoint:
    """Joint of a scenario for Newton, with its load, its start, and its muscles as an actuator, for a step [s].

    Each joint has the muscles, valves and delay of a plant drawn from `random_plant`, such as
    ``valve.time_constant=10..50 ms`` or ``joint.muscle.law=fit``, in the syntax of ``mckibben sweep``; a suite brings
    its conditions. Parts that Newton cannot represent, and variations of the load, are in `left_out`.

    Raises `ExportError` for parts that cannot be exported; importing this module with another version of Newton raises
    it, too.
    """
    scenario, random_plant = example_of(scenario, random_plant)
    plant = with_strengths(scenario.plant())
    check_parts(plant)
    start = plant.complete_state(scenario.initial(plant))
    alone = dataclasses.replace(plant, command_delay=None)
    module, muscles, acts = muscle_module(alone, (Transmission(), Transmission()), start, "joint", filters=False)
    left_out = ["controller and reference of the scenario", *mass_point(plant.load).chosen]
    left_out += [] if plant.has_ideal_io else ["sensors and disturbance of the plant"]
    left_out += [] if plant.friction is None else ["presliding of the joint's friction: the solver has its own"]
    delay = float(plant.command_delay or 0.0)
    text = warp_muscles(module, muscles, ("muscle1", "muscle2"), scenario.name, delay, tuple(left_out))
    made = loaded(text)
    drawn = plants_of(scenario, random_plant, plants, seed).varying if random_plant else ()
    parameters, others = split_parameters(drawn, made.PARAMETERS)
    left_out += [f"variation of {name}" for name in others]
    left_out += [f"gravity of the load: give the builder {gravity_of(plant.load):g} m/s^2"]
    return MuscleJoint(
        module=made,
        parameters=parameters,
        timestep=timestep,
        left_out=tuple(left_out),
        plant=plant,
        start=start,
        activations=(list(map(float, acts[0])), list(map(float, acts[1]))),
    )


@wp.kernel
def _reset(
    mask: wp.array(dtype=bool), start: wp.array(dtype=float), act: wp.array2d(dtype=float), last: wp.array(dtype=float)
):
    world, column = wp.tid()
    if mask[world]:
        act[world, column] = start[column]
        last[world] = wp.nan


@wp.kernel
def _gather(
    positions: wp.array(dtype=float),
    velocities: wp.array(dtype=float),
    command1: wp.array(dtype=float),
    command2: wp.array(dtype=float),
    pos_indices: wp.array(dtype=wp.uint32),
    vel_indices: wp.array(dtype=wp.uint32),
    length: wp.array2d(dtype=float),
    velocity: wp.array2d(dtype=float),
    command: wp.array2d(dtype=float),
):
    world = wp.tid()
    for muscle in range(2):
        length[world, muscle] = positions[pos_indices[world]]
        velocity[world, muscle] = velocities[vel_indices[world]]
    command[world, 0] = command1[vel_indices[world]]
    command[world, 1] = command2[vel_indices[world]]


@wp.kernel
def _torque(force: wp.array2d(dtype=float), torque: wp.array(dtype=float)):
    world = wp.tid()
    torque[world] = force[world, 0] + force[world, 1]


@wp.kernel
def _add(factor: float, change: wp.array2d(dtype=float), total: wp.array2d(dtype=float)):
    world, column = wp.tid()
    total[world, column] = total[world, column] + factor * change[world, column]
