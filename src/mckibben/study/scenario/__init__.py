"""Scenario files: everything that one simulated run needs, as YAML with units in the text, and back."""

from mckibben.study.scenario.controller import (
    BackpropSpec,
    ControllerSpec,
    DecouplingSpec,
    LoopSpec,
    ObserverSpec,
    PIDSpec,
    PolesSpec,
    PredictiveSpec,
    SlidingSpec,
)
from mckibben.study.scenario.plant import (
    CreepSpec,
    FrictionSpec,
    GeometrySpec,
    JointSpec,
    LoadSpec,
    MuscleSpec,
    SpringSpec,
    StartSpec,
    ValveSpec,
)
from mckibben.study.scenario.reference import (
    AngleSignalSpec,
    ReferenceSpec,
    SamplesSpec,
    SignalSpec,
    StiffnessSignalSpec,
)
from mckibben.study.scenario.scenario import Scenario

__all__ = [
    "AngleSignalSpec",
    "BackpropSpec",
    "ControllerSpec",
    "CreepSpec",
    "DecouplingSpec",
    "FrictionSpec",
    "GeometrySpec",
    "JointSpec",
    "LoadSpec",
    "LoopSpec",
    "MuscleSpec",
    "ObserverSpec",
    "PIDSpec",
    "PolesSpec",
    "PredictiveSpec",
    "ReferenceSpec",
    "SamplesSpec",
    "Scenario",
    "SignalSpec",
    "SlidingSpec",
    "SpringSpec",
    "StartSpec",
    "StiffnessSignalSpec",
    "ValveSpec",
]
