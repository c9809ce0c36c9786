"""Files of a robot: bodies, joints, muscles, valves, ground, and the studies of landing, jumping and stiffness."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Collection, Mapping
from types import SimpleNamespace
from typing import Annotated, Any, cast

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray
from pydantic import (
    Field,
    PrivateAttr,
    SerializationInfo,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from mckibben.actuator import Actuator, IdealValve
from mckibben.binding import call
from mckibben.component.schema import ComponentField, Scope, independent, inherit, parse_component
from mckibben.config.document import to_text
from mckibben.config.fields import Title
from mckibben.config.model import fail_validation, located_below
from mckibben.control import Controller, Reference
from mckibben.control.base import DiscreteTimeSystem
from mckibben.control.computed_torque import ComputedTorque
from mckibben.control.reaching import PointReference
from mckibben.control.robot_control import JointwiseControl, RobotController, check_pairs
from mckibben.errors import RangeError, UnreachableError
from mckibben.mechanism.dynamics import joint_load
from mckibben.mechanism.ground import Ground
from mckibben.mechanism.point_stiffness import SINGULAR, movable
from mckibben.mechanism.robot import Robot
from mckibben.numerics.batching import lanes_of
from mckibben.numerics.compiled import numeric
from mckibben.plant import PerfectSensors, PlantState
from mckibben.plant.robot_plant import RobotPlant, RobotStart
from mckibben.result import Remark
from mckibben.scenario.robot_settings import (
    DrawSettings,
    JumpSettings,
    LandingSettings,
    StartSettings,
    StiffnessSettings,
)
from mckibben.scenario.scenario import (
    ControllerPart,
    ReferencePart,
    Scenario,
    SensorsPart,
    StudiedScenario,
    Substeps,
    ValvePart,
)
from mckibben.simulation.accuracy import ACCURACY
from mckibben.simulation.feasibility import held_by_pairs
from mckibben.simulation.problem import sampled_reference, sampling_times
from mckibben.statics.attainable import attainable_statics
from mckibben.statics.posture import holding_torques, is_affine
from mckibben.statics.pressures import pressures_for_joint_stiffness
from mckibben.units import (
    Accuracy,
    CommandDelay,
    Duration,
    PositiveTime,
    mm,
)

_DEEPEST = 50 * mm
"""Largest static deflection of the ground under the weight of the robot."""

CONTROLLERS = JointwiseControl, ComputedTorque
"""Controllers of all joints that a file may name; those of a user's module are known as well."""

_JOINTS = TypeAdapter(dict[str, ReferencePart])


class RobotScenario(StudiedScenario):
    """Robot, valves, ground, control of its joints, and studies; `read` and `dumps` know the units.

    Attributes
    ----------
    reference
        Reference of angle and stiffness of each joint.
    controllers, controller
        A controller for each joint with a pair of muscles, or one for all joints and muscles. Parts of their models
        that the file does not give are those of the plant.
    control_period
        Time between samples of the controller, and of the forces [s]; it has as many integration steps as the
        `accuracy` of the angles [rad] needs, or `substeps`.

    Examples
    --------
    >>> scenario = RobotScenario.read("examples/robot/lei-leg.yaml")
    >>> scenario.plant()
    RobotPlant(...)
    """

    kind = section = "robot"
    plant_parts = ("robot", "valve", "command_delay")
    examples = "examples/robot/"

    name: Title
    robot: Annotated[Robot, ComponentField(Robot)]
    valve: ValvePart = IdealValve()
    ground: Annotated[Ground, ComponentField(Ground)] = Ground()
    sensors: SensorsPart = PerfectSensors()
    command_delay: CommandDelay | None = None
    landing: LandingSettings | None = None
    jump: JumpSettings | None = None
    stiffness: StiffnessSettings | None = None
    uncertainty: DrawSettings = DrawSettings()
    reference: dict[str, ReferencePart] | PointReference = Field(default_factory=dict)
    controllers: dict[str, ControllerPart] = Field(default_factory=dict)
    controller: Annotated[RobotController, ComponentField(RobotController)] | None = None
    start: StartSettings = StartSettings()
    duration: Duration | None = None
    control_period: PositiveTime = 0.25e-3
    accuracy: Accuracy = ACCURACY
    substeps: Substeps | None = None
    _computed: list[PyTree] = PrivateAttr(default_factory=list)

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any, info: SerializationInfo) -> Any:
        written, empty = super()._write(handler, info), {"angles": {}, "clearance": "0 mm"}
        return {key: value for key, value in written.items() if value not in (None, {}, empty)}

    @field_validator("reference", mode="wrap")
    @classmethod
    def _of_joints_or_a_point(cls, value: PyTree, handler: PyTree, info: ValidationInfo) -> PyTree:
        of_a_point = isinstance(value, PointReference) or (isinstance(value, dict) and "position" in value)
        validate = PointReference.model_validate if of_a_point else _JOINTS.validate_python
        try:
            return validate(value, context=info.context)
        except ValidationError as error:
            raise located_below(error, ()) from None

    @field_validator("valve", mode="after")
    @classmethod
    def _of_all_muscles(cls, value: Actuator, info: ValidationInfo) -> Actuator:
        robot = info.data.get("robot")
        return value if robot is None else value.for_muscles(robot.muscle_names)

    @field_validator("controllers", mode="wrap")
    @classmethod
    def _in_their_joints(cls, value: Any, handler: Any, info: ValidationInfo) -> Any:
        robot, valve = info.data.get("robot"), info.data.get("valve")
        if robot is None or valve is None or not isinstance(value, dict):
            return handler(value)
        made = {}
        for name, section in value.items():
            scope = _joint_scope(robot, valve, info.data.get("command_delay"), robot.index(name, name))
            context = dict(info.context or {}) | {"scope": (scope,)}
            within = cast(ValidationInfo, SimpleNamespace(context=context, field_name=name, data={}))
            try:
                made[name] = ComponentField(Controller).read(section, within)
            except ValidationError as error:
                raise located_below(error, (name,)) from None
        return made

    @field_validator("ground", mode="after")
    @classmethod
    def _carries(cls, value: Ground, info: ValidationInfo) -> Ground:
        robot = info.data.get("robot")
        if robot is None:
            return value
        weight = float(robot.total_mass) * RobotPlant.gravity
        if (depth := weight / value.stiffness) > _DEEPEST:
            fail_validation(
                f"the robot would stand {depth / mm:.3g} mm deep in the ground",
                f"give a stiffness of {weight / _DEEPEST:.2g} N/m or more",
                value=value.stiffness,
            )
        return value

    @field_validator("landing", "jump", "stiffness", mode="after")
    @classmethod
    def _of_the_robot(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and (robot := info.data.get("robot")) is not None:
            value.check(robot, info.data.get("valve"))
        return value

    @model_validator(mode="after")
    def _controlled(self) -> RobotScenario:
        if not (self.controllers or self.controller or self.reference or self.duration):
            return self
        if self.controllers and self.controller:
            fail_validation("has a controller of each joint and one of all", "give controllers, or controller")
        if isinstance(self.controller, JointwiseControl):
            fail_validation("is a list of controllers", "give `controllers` by joint", field="controller")
        if not (self.controllers or self.controller):
            remedy = "give `controller: {class: computed_torque, ...}`, or `controllers` by joint"
            fail_validation("has references or a duration, and no controller", remedy)
        if isinstance(self.reference, dict):
            _check_each(self.robot, "reference", self.reference)
        if self.controllers:
            _check_each(self.robot, "controllers", self.controllers)
        if self.duration is None:
            fail_validation("lacks the duration of the run", "give one, such as `duration: 5 s`", field="duration")
        if self.controllers:
            check_pairs(self.robot, self.control())
        self.robot.check_angles(self.start.angles, "start.angles")
        if self.controller:
            _check_independent(self.robot)
        return self

    def timing_over(self, duration: float) -> dict[str, Any]:
        """As `timing`, for another duration [s], rounded to control periods."""
        return super().timing | {"duration": self.control_period * round(duration / self.control_period)}

    @property
    def supply(self) -> float:
        """Gauge pressure of the supply of the valves [Pa]; infinite where they have none."""
        return float(getattr(self.valve, "supply", None) or np.inf)

    def plant(self) -> RobotPlant:
        """The simulated robot."""
        plant = RobotPlant(self.robot, self.valve, self.ground, sensors=self.sensors, command_delay=self.command_delay)
        return plant.with_period(self.control_period)

    def control(self) -> RobotController:
        if not (self.controller or self.controllers):
            raise _no_controller()
        whole = self.with_model()
        if whole.controller is not None:
            return whole.controller
        return JointwiseControl(tuple(whole.controllers[name] for name in self.joint_names))

    def controlled_by(self, controller: DiscreteTimeSystem) -> dict[str, PyTree]:
        if not isinstance(controller, JointwiseControl):
            return {"controller": controller, "controllers": {}}
        return {"controller": None, "controllers": dict(zip(self.joint_names, controller.controllers, strict=True))}

    def _scope(self) -> Scope:
        return {name: getattr(self, name) for name in self.plant_parts}

    def _joint_scope(self, name: str) -> Scope:
        return _joint_scope(self.robot, self.valve, self.command_delay, self.robot.index(name))

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.robot.joint_names

    @property
    def muscle_names(self) -> tuple[str, ...]:
        return self.robot.muscle_names

    def attainable_torques(self) -> dict[str, tuple[float, float]]:
        robot, angles = self.robot, self._first()[0]
        if robot.has_disjoint_pairs:
            pairs = {self.joint_names[joint]: (robot.pair(joint), angles[joint]) for joint in robot.pairs}
            ranges = {name: pair.attainable_torque(angle) for name, (pair, angle) in pairs.items()}
            return {name: (float(low), float(high)) for name, (low, high) in ranges.items()}
        torques = holding_torques(robot, angles, RobotPlant.gravity)
        ranges = attainable_statics(robot, angles, torques=torques, supply=self.supply)
        return {name: torque for name, (torque, *_) in ranges.items()}

    def references(self) -> dict[str, Reference]:
        return self._joint_references[0]

    @property
    def _joint_references(self) -> tuple[dict[str, Reference], list[Remark]]:
        """References of the joints, also of those of a point, and what is not exact in them.

        Copies share them; those whose robot varies over runs have that of the nominal one.
        """
        if not isinstance(self.reference, PointReference):
            return self.reference, []
        varies, settings = lanes_of(self.robot)[0], (self.reference, self.duration, self.control_period, self.start)
        for known, robot, found in self._computed:
            if known == settings and (varies or robot is self.robot):
                return found
        self._computed.append((settings, self.robot, self._of_a_point(self.reference)))
        return self._computed[-1][-1]

    def _of_a_point(self, reference: PointReference) -> tuple[dict[str, Reference], list[Remark]]:
        times = sampling_times(self.run_duration, self.control_period)
        start = self.robot.posture_angles(self.start.angles)
        tension = getattr(self.controller, "minimum_tension", 1.0)
        return reference.of_joints(self.robot, start, times, self.supply, tension)

    def reference_remarks(self) -> list[Remark]:
        return self._joint_references[1]

    def with_model(self, *, fixed: bool = False) -> RobotScenario:
        change = independent if fixed else (lambda part: part)
        controllers = {
            name: change(_inheriting(own, self._joint_scope, name)) for name, own in self.controllers.items()
        }
        return self.model_copy(
            update={"controller": change(_inheriting(self.controller, self._scope)), "controllers": controllers}
        )

    def suite(self, controllers: Mapping[str, object] | None = None, **settings: PyTree) -> PyTree:
        return call("robot_suite", self, controllers, **settings)

    @property
    def timing(self) -> dict[str, Any]:
        return super().timing | {"duration": self.run_duration}

    @property
    def run_duration(self) -> float:
        """Duration [s]; `RangeError` without one."""
        if self.duration is None:
            raise _no_controller()
        return self.duration

    def starts(self) -> RobotStart:
        """Return the start of a controlled run, of a batch with others in the place of those that do not exist."""
        parts: dict[str, PyTree] = {"robot": self.robot, "reference": self.references()}
        if lanes_of(getattr(self.valve, "supply", None))[0] is not None:
            parts["valve"] = self.valve
        count, varying = lanes_of(parts)
        if count is None:
            return self._start()
        lanes, shared = eqx.partition(parts, varying)
        leaves, structure = jax.tree.flatten(lanes)

        @functools.cache
        def start_of(*row: float) -> RobotStart | None:
            own = self.model_copy(update=eqx.combine(jax.tree.unflatten(structure, row), shared))
            try:
                return own._start()
            except UnreachableError:
                return None

        rows = np.stack(leaves, axis=-1)
        attained, known = self._held_by_pairs(lanes, shared, rows[0], structure)
        starts = [known(row) if attained[row] else start_of(*rows[row].tolist()) for row in range(count)]
        nowhere = RobotStart((0.0,) * len(self.joint_names), (0.0,) * len(self.muscle_names))
        found = next((start for start in starts if start), nowhere)
        exists = np.array([start is not None for start in starts])
        columns = jax.tree.map(lambda *each: np.array(each, float), *(start or found for start in starts))
        return columns._replace(exists=exists)

    def _held_by_pairs(
        self, lanes: PyTree, shared: PyTree, row: NDArray, structure: PyTree
    ) -> tuple[NDArray[np.bool_], Callable[[int], RobotStart]]:
        """Mask of the runs whose start follows in closed form, and a function of their numbers that gives it."""
        robot = self.robot
        limits = [(joint.lower, joint.upper, joint.locked) for joint in robot.joints]
        varies = "valve" in shared or lanes_of((self.references(), limits))[0] is not None
        if varies or not (robot.has_disjoint_pairs and is_affine(robot)):
            return np.zeros(len(jax.tree.leaves(lanes)[0]), bool), lambda number: self._start()
        own = self.model_copy(update=eqx.combine(jax.tree.unflatten(structure, row.tolist()), shared))
        angles, stiffness = own._first()
        posture = tuple(map(np.asarray, angles)), tuple(map(np.asarray, stiffness))
        none, numbers = (None,) * len(angles), numeric(robot)
        varied, fixed = eqx.partition(numbers, lanes_of(numbers)[1])
        held = held_by_pairs((fixed, self.supply, RobotPlant.gravity, *posture), (varied, None, None, none, none))
        pressures = np.stack([pressure for pair in held.pressures for pressure in pair])

        def start(number: int) -> RobotStart:
            return RobotStart(angles, tuple(pressures[:, number].tolist()), clearance=self.start.clearance)

        return np.asarray(held.attained), start

    def initial(self, plant: RobotPlant) -> PlantState:
        return plant.begin(self._start())

    def _first(self) -> tuple[tuple[float, ...], list[float]]:
        """Return angles [rad] and stiffness [N*m/rad] of the joints at the start."""
        first = {name: sampled_reference(reference, np.zeros(1)) for name, reference in self.references().items()}
        given = {} if isinstance(self.reference, PointReference) else self.start.angles
        angles = {name: float(setpoint.angle[0]) for name, setpoint in first.items() if name not in given}
        free = [joint.name for joint in self.robot.joints if joint.locked is None]
        self.robot.check_angles({name: angle for name, angle in angles.items() if name in free}, "reference")
        stiffness = [float(first[name].stiffness[0]) for name in self.joint_names]
        return self.robot.posture_angles(angles | given), stiffness

    def _start(self) -> RobotStart:
        """Return the start of a controlled run: at rest, with the stiffness nearest to that of the references.

        Raises `McKibbenError` if the muscles cannot hold the posture.
        """
        (angles, stiffness), robot = self._first(), self.robot
        torques = holding_torques(robot, angles, RobotPlant.gravity)
        if is_affine(robot):
            pressures = pressures_for_joint_stiffness(
                robot, angles, stiffness, torques=torques, supply=self.supply
            ).pressures
        else:
            pressures = robot.pressures_for(angles, torques.tolist(), stiffness)
        return RobotStart(angles, tuple(pressures), clearance=self.start.clearance)


def _inheriting(component: PyTree, scope: Callable[..., Scope], *where: str) -> PyTree:
    """A component with what it inherits from a scope, which is computed only if it inherits something."""
    return component if independent(component) is component else inherit(component, scope(*where))


def _no_controller() -> RangeError:
    remedy = "give it `controller` or `controllers`, `reference` and `duration`, or use `mckibben robot`"
    return RangeError("the robot has no controller", field="controller", remedy=remedy)


def _joint_scope(robot: Robot, valve: Any, command_delay: float | None, index: int) -> dict[str, Any]:
    """Models of a joint for its controller: its pair of muscles, the load with all angles near 0, and the valve."""
    load = joint_load(robot, robot.posture_angles({}), index, RobotPlant.gravity)
    names, pair = robot.named_pair(index)
    return {"joint": pair, "load": load, "valve": valve.for_muscles(names), "command_delay": command_delay}


def _check_each(robot: Robot, field: str, given: Collection[str]) -> None:
    """Refuse parts by joint of unknown joints, and of fewer than all."""
    robot.check_angles(dict.fromkeys(given), field)
    if missing := [name for name in robot.joint_names if name not in given]:
        fail_validation(f"lacks {', '.join(missing)}", "give one for each joint", field=field)


def _check_independent(robot: Robot) -> None:
    """Refuse joints that the muscles do not turn independently with all angles as near 0 as they can be."""
    routed, arms = robot.routed_muscles(robot.posture_angles({})), np.zeros((len(robot.joints), len(robot.all_muscles)))
    for number, muscle in enumerate(routed):
        for joint, slope in muscle.slopes.items():
            arms[joint, number] = slope
    directions, sizes, _ = np.linalg.svd(arms[movable(robot)])
    rank = int((sizes > SINGULAR * sizes.max(initial=0.0)).sum())
    if rank < len(directions):
        names = [joint.name for joint in robot.joints if joint.locked is None]
        shares = np.abs(directions[:, rank:]).max(axis=1)
        alike = [name for name, share in zip(names, shares, strict=True) if share > SINGULAR]
        text = f"the muscles do not turn {', '.join(alike)}" + (" independently" if len(alike) > 1 else "")
        remedy = "let muscles pass beside the axis of each joint, or lock it"
        fail_validation(text, remedy, field=f"robot.joints.{robot.index(alike[-1])}")


def read_robot(name: str | os.PathLike[str]) -> Robot:
    """The robot of the catalog of that name, or of a file; raises ScenarioError."""
    text = os.fspath(name)
    if text.endswith((".yaml", ".yml")):
        return RobotScenario.read(name).robot
    return parse_component(Robot, to_text({"from": text}), source=text)


def read_scenario(path: str | os.PathLike[str]) -> Any:
    """Read the scenario of a joint or of a robot; a name for this version alone of `Scenario.read`."""
    return Scenario.read(path)
