"""Settings of the studies of a robot, and of its start, as sections of its file."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from mckibben.actuator import Actuator
from mckibben.component.schema import ComponentField
from mckibben.config.fields import Flag, Title
from mckibben.config.model import ConfigModel, fail_validation
from mckibben.control.reaching import PointStiffnessValue
from mckibben.errors import RangeError
from mckibben.mechanism.bodies import BodyPoint
from mckibben.mechanism.point_stiffness import check_point, stiffness_matrix
from mckibben.mechanism.robot import Robot
from mckibben.units import (
    Angle,
    BoundedInt,
    Duration,
    Percent,
    PositiveTime,
    Pressure,
    Quantity,
    SignedForce,
    Stiffness,
    bar,
)

DropHeight = Annotated[float, Quantity("m", "mm", 0, 1e4)]
Spread = Annotated[float, Percent("1", "%", 0, 50)]

Angles = dict[str, Angle]
"""Angles [rad] by the name of the joint."""


class DrawSettings(ConfigModel):
    """Relative standard deviations of the strength of each muscle and of the mass of each body, independent.

    The inertia of a body follows its mass. Muscles whose law is a fit file vary within the errors of the fit as well,
    those with the same file identically. Fewer than 20 draws have no 5th and 95th percentiles. What is chosen on the
    draws is judged by as many fresh ones.
    """

    strength: Spread = 0.05
    mass: Spread = 0.03
    draws: Annotated[int, BoundedInt(20, 10_000)] = 400
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0


class LandingSettings(ConfigModel):
    """Drops on the ground over stiffness of a joint, drop height and valve."""

    joint: Title  # whose stiffness varies; the others have the middle of their attainable range
    touchdown: Angles = Field(default_factory=dict)
    stiffness: Annotated[tuple[Stiffness, ...], Field(min_length=2)] | None = None  # commanded, isobaric
    levels: Annotated[int, BoundedInt(3, 200)] = 13  # values over the attainable range, without `stiffness`
    drop: Annotated[tuple[DropHeight, ...], Field(min_length=1)] = (0.02, 0.05, 0.1)
    time_constants: tuple[PositiveTime, ...] = (0.02,)  # see `valve_with`; constant pressures and closed valves, too
    duration: Duration = 0.3

    def check(self, robot: Robot, valve: Actuator | None) -> None:
        """Raise `RangeError` unless the robot can land in this way."""
        _check_foot(robot)
        robot.check_angles(self.touchdown, "touchdown")
        index = robot.index(self.joint)
        robot.pair(index)
        if robot.joints[index].locked is not None:
            message, remedy = f"{self.joint} is locked: its stiffness has no effect", "name a joint that can move"
            raise RangeError(message, field="joint", value=self.joint, remedy=remedy)
        if self.time_constants and valve is not None and not valve.holds_air:
            message = "landing.time_constants (default: 20 ms) are of a valve with air, and the valve has none"
            remedy = "give a valve such as {class: regulator, ...}, or `time_constants: []`"
            raise RangeError(message, field="time_constants", remedy=remedy)


class JumpSettings(ConfigModel):
    """A jump from a squat."""

    squat: Angles = Field(default_factory=dict)  # at the start, held by the muscles at rest
    low: Pressure = 0.0  # the muscles are switched between these pressures
    high: Pressure = 6e5
    latest: Duration = 0.15  # switching time
    duration: Duration = 0.5

    @model_validator(mode="after")
    def _in_order(self) -> JumpSettings:
        for (name, value), (below, least) in (
            (("high", self.high), ("low", self.low)),
            (("duration", self.duration), ("latest", self.latest)),
        ):
            if value <= least:
                fail_validation(f"{name} is not above {below}", f"give more than {least:g}", value=value)
        return self

    def check(self, robot: Robot, valve: Actuator | None) -> None:
        """Raise `RangeError` unless the robot can jump in this way."""
        _check_foot(robot)
        robot.check_angles(self.squat, "squat")
        muscles = [one for one in robot.all_muscles if not one.law.is_passive]
        rated = min(float(one.specimen.domain.pressure_max) for one in muscles)
        for what, highest in (("rating of a muscle", rated), ("supply", getattr(valve, "supply", None) or np.inf)):
            if self.high > highest:
                message = f"high is {self.high / bar:g} bar, above the {what} of {highest / bar:g} bar"
                raise RangeError(message, field="high", value=self.high, upper=highest, unit="Pa", remedy="lower it")


class StiffnessSettings(ConfigModel):
    """A stiffness in a posture: of a point, as its main axes (see `stiffness_matrix`), or of joints."""

    principal: tuple[PointStiffnessValue, PointStiffnessValue] | None = None
    direction: Angle = 0.0
    sideways: PointStiffnessValue | None = None
    posture: Angles = Field(default_factory=dict)
    point: Annotated[BodyPoint, ComponentField(BodyPoint)] | None = None  # default: the foot
    force: tuple[SignedForce, ...] | None = None  # on the point: forwards and up, or forwards, to the left and up
    joints: dict[str, Stiffness] = Field(default_factory=dict)  # in place of a point
    gravity: Flag = False  # whether the muscles hold the weight, the base held

    @model_validator(mode="after")
    def _of_a_point_or_of_joints(self) -> StiffnessSettings:
        if self.joints and self.principal is not None:
            remedy = "give principal, for a point, or joints"
            fail_validation("has a stiffness of a point and of joints", remedy, field="joints")
        return self

    def check(self, robot: Robot, _: Actuator | None) -> None:
        """Raise `RangeError` for another posture, point or direction than the robot has, and a singular posture."""
        robot.check_angles(self.posture, "posture")
        robot.check_angles(dict.fromkeys(self.joints), "joints")
        if self.principal is not None:
            matrix = stiffness_matrix(self.principal, self.direction, self.sideways)
            check_point(robot, robot.posture_angles(self.posture), matrix, self.point, self.force)


def _check_foot(robot: Robot) -> None:
    """Raise `RangeError` unless a robot moves and touches the ground."""
    if robot.base == "fixed":
        raise RangeError("needs a base that can move", remedy="give the robot a `base` such as vertical")
    if robot.foot is None:
        raise RangeError("needs a foot", remedy="give the robot a `foot`: body, place and radius")


class StartSettings(ConfigModel):
    """Start of a run, at rest: angles by joint (default: those of the references), and clearance of the foot [m].

    With a reference of a point the run starts there; the angles are where its inverse kinematics begins.
    """

    angles: Angles = Field(default_factory=dict)
    clearance: DropHeight = 0.0
