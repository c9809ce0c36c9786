"""The kinds of field in a scenario, with the ranges they may have: wide ones, they catch slips of the unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, PlainSerializer

from mckibben.study.scenario.quantity import Quantity
from mckibben.study.scenario.words import read_flag, read_law, read_table, read_title, write_law, write_path

Title = Annotated[str, BeforeValidator(read_title)]
Flag = Annotated[bool, BeforeValidator(read_flag)]
Law = Annotated[str | Path, BeforeValidator(read_law), PlainSerializer(write_law, when_used="json")]
TablePath = Annotated[Path, BeforeValidator(read_table), PlainSerializer(write_path, when_used="json")]

Duration = Annotated[float, Quantity("s", "s", 0, 1e6, open_lower=True)]
Instant = Annotated[float, Quantity("s", "s", -1e6, 1e6)]
ShortTime = Annotated[float, Quantity("s", "ms", 0, 1e6)]
PositiveTime = Annotated[float, Quantity("s", "ms", 0, 1e6, open_lower=True)]
Frequency = Annotated[float, Quantity("1/s", "Hz", 0, 1e6)]
Length = Annotated[float, Quantity("m", "mm", 0, 1e5, open_lower=True)]
Distance = Annotated[float, Quantity("m", "mm", 0, 1e5)]
Mass = Annotated[float, Quantity("kg", "kg", 0, 1e4)]
Inertia = Annotated[float, Quantity("kg*m^2", "kg*m^2", 0, 1e4)]
Damping = Annotated[float, Quantity("N*m*s/rad", "N*m*s/rad", 0, 1e6)]
Gravity = Annotated[float, Quantity("m/s^2", "m/s^2", 0, 1e3)]
SpringRate = Annotated[float, Quantity("N/m", "N/mm", 0, 1e6, open_lower=True)]
Force = Annotated[float, Quantity("N", "N", 0, 1e6)]
FrictionForce = Annotated[float, Quantity("N", "N", 1e-6, 1e6)]
FrictionGrowth = Annotated[float, Quantity("N/Pa", "N/bar", -1e4, 1e4)]
Presliding = Annotated[float, Quantity("m", "mm", 0, 1e3, open_lower=True)]
CreepTime = Annotated[float, Quantity("s", "s", 0.01, 1e6)]
Viscosity = Annotated[float, Quantity("N*s/m", "N*s/m", 0, 1e6)]
Tension = Annotated[float, Quantity("N", "N", 0, 1e6, open_lower=True)]
Pressure = Annotated[float, Quantity("Pa", "bar", -1e3, 1e3)]
PressureNoise = Annotated[float, Quantity("Pa", "kPa", 0, 1e5)]
AngleStep = Annotated[float, Quantity("rad", "deg", 0, 90)]
Torque = Annotated[float, Quantity("N*m", "N*m", -1e6, 1e6)]
Share = Annotated[float, Quantity("1", "1", 0, 100)]
PositiveTorque = Annotated[float, Quantity("N*m", "N*m", 0, 1e6, open_lower=True)]
Strength = Annotated[float, Quantity("1", "1", 0, 100, open_lower=True)]
StrengthSpread = Annotated[float, Quantity("1", "1", 0, 0.3, open_lower=True)]
Delay = Annotated[float, Quantity("1", "1", 0, 1)]
Angle = Annotated[float, Quantity("rad", "deg", -360, 360)]
Stiffness = Annotated[float, Quantity("N*m/rad", "N*m/rad", -1e6, 1e6)]
Phase = Annotated[float, Quantity("rad", "deg", -1e4, 1e4)]
AngleScale = Annotated[float, Quantity("rad", "deg", 0, 1e6, open_lower=True)]
StiffnessScale = Annotated[float, Quantity("N*m/rad", "N*m/rad", 0, 1e6, open_lower=True)]
PressureScale = Annotated[float, Quantity("Pa", "bar", 0, 1e3, open_lower=True)]
PressureRate = Annotated[float, Quantity("Pa/s", "bar/s", 0, 1e6, open_lower=True)]
Rate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6)]
PositiveRate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6, open_lower=True)]
Bandwidth = Annotated[float, Quantity("rad/s", "rad/s", 0, 1e6, open_lower=True)]
AngularAcceleration = Annotated[float, Quantity("rad/s^2", "rad/s^2", 0, 1e6, open_lower=True)]
PoleDamping = Annotated[float, Quantity("1", "1", 2, 3)]
Momentum = Annotated[float, Quantity("1", "1", 0, 1, open_upper=True)]
Ratio = Annotated[float, Quantity("1", "1", 1, 1e6, open_lower=True)]

AngleGain = Annotated[float, Quantity("Pa/rad", "bar/rad", -1e6, 1e6)]
AngleIntegralGain = Annotated[float, Quantity("Pa/(rad*s)", "bar/(rad*s)", -1e6, 1e6)]
AngleDerivativeGain = Annotated[float, Quantity("Pa*s/rad", "bar*s/rad", -1e6, 1e6)]
StiffnessGain = Annotated[float, Quantity("Pa/(N*m/rad)", "bar/(N*m/rad)", -1e6, 1e6)]
StiffnessIntegralGain = Annotated[float, Quantity("Pa/(N*m*s/rad)", "bar/(N*m*s/rad)", -1e6, 1e6)]
StiffnessDerivativeGain = Annotated[float, Quantity("Pa*s/(N*m/rad)", "bar*s/(N*m/rad)", -1e6, 1e6)]
