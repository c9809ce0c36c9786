"""Scenario files: everything that one simulated run needs, as YAML with units in the text, and back."""

from mckibben.study.scenario.controller import BackpropSpec, ControllerSpec, LoopSpec, PIDSpec
from mckibben.study.scenario.joint import CreepSpec, FrictionSpec, GeometrySpec, JointSpec, MuscleSpec, SpringSpec
from mckibben.study.scenario.plant import LoadSpec, StartSpec, ValveSpec
from mckibben.study.scenario.reference import (
    MultisineSpec,
    ReferenceSpec,
    SamplesSpec,
    SignalSpec,
    SineSpec,
    StepSpec,
)
from mckibben.study.scenario.scenario import Scenario

__all__ = [
    "BackpropSpec",
    "ControllerSpec",
    "CreepSpec",
    "FrictionSpec",
    "GeometrySpec",
    "JointSpec",
    "LoadSpec",
    "LoopSpec",
    "MultisineSpec",
    "MuscleSpec",
    "PIDSpec",
    "ReferenceSpec",
    "SamplesSpec",
    "Scenario",
    "SignalSpec",
    "SineSpec",
    "SpringSpec",
    "StartSpec",
    "StepSpec",
    "ValveSpec",
]
