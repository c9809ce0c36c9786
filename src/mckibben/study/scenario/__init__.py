"""Scenario files: everything that one simulated run needs, as YAML with units in the text, and back."""

from mckibben.study.scenario.controller import LoopSpec
from mckibben.study.scenario.plant import GeometrySpec, JointSpec, StartSpec
from mckibben.study.scenario.reference import AngleSignalSpec, ReferenceSpec, SignalSpec
from mckibben.study.scenario.scenario import Scenario

__all__ = [
    "AngleSignalSpec",
    "GeometrySpec",
    "JointSpec",
    "LoopSpec",
    "ReferenceSpec",
    "Scenario",
    "SignalSpec",
    "StartSpec",
]
