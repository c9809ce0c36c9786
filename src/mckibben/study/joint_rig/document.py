"""A file that says on what a scenario is run: a bench that is not there, or a card; within which limits."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from mckibben.study.rig.fields import JsonPath, Wait
from mckibben.study.scenario.fields import Angle, Duration, PositiveTime, Pressure, PressureRate, Title
from mckibben.study.scenario.part import Part, refuse
from mckibben.study.scenario.quantity import Quantity
from mckibben.study.scenario.reading import parsed, text_of
from mckibben.study.scenario.words import Whole

_Step = Annotated[float, Quantity("rad", "deg", 0, 10)]
_Noise = Annotated[float, Quantity("Pa", "kPa", 0, 1e3)]
_Turning = Annotated[float, Quantity("rad/s", "deg/s", 0, 1e5, open_lower=True)]


class BenchSpec(Part):
    """The virtual joint: how well it is measured, see `Sensing`. It is the scenario's own plant."""

    angle_step: _Step | None = None
    pressure_noise: _Noise | None = None
    seed: Annotated[int, Whole(0, 2**31 - 1)] = 0


class JointCardSpec(Part):
    """A card of National Instruments: its terminals, and the file of the five calibrations."""

    device: str
    angle: str = "ai0"
    pressure1: str = "ai1"
    pressure2: str = "ai2"
    valve1: str = "ao0"
    valve2: str = "ao1"
    heartbeat: str = "port0/line0"
    hold: str = "port0/line1"
    server: str = ""
    calibration: JsonPath


class JointLimitsSpec(Part):
    """What may not be exceeded, see `JointLimits`.

    Unless given, the angle may go 10 deg beyond the wishes, the start, and where the joint hangs without air; the
    pressure 5 % beyond what the specimens are rated for.
    """

    lowest_angle: Angle | None = None
    highest_angle: Angle | None = None
    pressure: Pressure | None = None
    angle_rate: _Turning | None = None
    pressure_rate: PressureRate | None = None
    window: PositiveTime | None = None
    pressure_error: Pressure | None = None
    following: PositiveTime | None = None
    silence: PositiveTime | None = None
    late: PositiveTime | None = None


class ApproachSpec(Part):
    """How the joint is brought to its start.

    In `raising` the pressures go to those of the start along a straight line; in `settling` the controller holds the
    first wish.
    """

    raising: Wait = 2.0
    settling: Wait = 2.0


class JointRig(Part):
    """What a scenario is run on; in SI, `read` knows the units.

    Attributes
    ----------
    name
        What it is, in a few words.
    virtual, nidaqmx
        One of them.
    limits
        What may not be exceeded.
    approach
        How the joint is brought to its start.
    patience
        How long the rig waits for the host before it vents by itself [s].

    Examples
    --------
    >>> rig = JointRig.read("examples/rig/joint-rig.yaml")
    >>> rig.approach.raising, rig.patience
    (2.0, 0.1)
    """

    name: Title = Field("virtual joint", examples=["knee on the bench"])
    virtual: BenchSpec | None = None
    nidaqmx: JointCardSpec | None = Field(None, validate_default=True)
    limits: JointLimitsSpec = JointLimitsSpec()
    approach: ApproachSpec = ApproachSpec()
    patience: Duration = 0.1

    @field_validator("virtual", mode="before")
    @classmethod
    def _word_alone(cls, value: Any) -> Any:
        return {} if value == "" else value

    @field_validator("nidaqmx", mode="after")
    @classmethod
    def _one(cls, value: Any, info: ValidationInfo) -> Any:
        virtual = info.data.get("virtual", "wrong")
        if (virtual is None) == (value is None):
            what = "is virtual and nidaqmx at once" if value is not None else "has no rig"
            refuse(what, "give one of virtual, nidaqmx", parent=True)
        return value

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> JointRig:
        """Read a file.

        Raises
        ------
        ScenarioError
            With every problem of the file: line, field, value, allowed range and remedy.
        """
        text = text_of(path, "a joint rig", "examples/rig/joint-rig.yaml")
        return parsed(cls, text, source=os.fspath(path), folder=Path(path).parent)[0]

    def to_json(self) -> dict[str, Any]:
        """What was given, with units, for the record."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True, context={"folder": Path()})
