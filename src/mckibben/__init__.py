"""mckibben: pneumatic artificial muscles, from the test rig to a controlled joint.

Importing has one documented effect: JAX computes with 64-bit numbers (and its loops run fast on the CPU, see
`mckibben.numerics.runtime`). The public names are listed here one by one; each is loaded when it is first used, so that
the import itself is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mckibben.numerics import runtime as _runtime

__version__ = "0.1.0"

_runtime.configure()

if TYPE_CHECKING:
    from mckibben.control import (
        PID,
        BackpropPID,
        Constant,
        DecouplingControl,
        ExtendedStateObserver,
        FrictionCompensation,
        InverseModelControl,
        Jacobian,
        Multisine,
        PolePlacement,
        PositionStiffnessControl,
        PredictiveControl,
        Reference,
        Samples,
        Sine,
        SlidingMode,
        Step,
        VelocityObserver,
    )
    from mckibben.dataset import IsobaricDataset, Recording, read_dataset, read_recording
    from mckibben.errors import McKibbenError
    from mckibben.experiment_design import plan
    from mckibben.identification import Fit, identify, identify_hysteresis, rank, validate
    from mckibben.joint import AntagonisticJoint, KneeGeometry, Load, RigidTendon, SeriesSpring
    from mckibben.muscle import (
        ChouLaw,
        Domain,
        ExponentialLaw,
        MaxwellCreep,
        MaxwellSlip,
        Muscle,
        Specimen,
        TripleExponentialLaw,
    )
    from mckibben.paper import reproduce
    from mckibben.plant import FirstOrderValve, IdealValve, JointPlant
    from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
    from mckibben.simulation import Result, check_reference, differentiate, simulate, simulate_many
    from mckibben.study.scenario import Scenario
    from mckibben.study.sweep import sweep
    from mckibben.study.tune import tune

_MODULES = ("catalog", "report", "units")
_HOMES = {
    "control": (
        "PID BackpropPID Constant DecouplingControl ExtendedStateObserver FrictionCompensation InverseModelControl "
        "Jacobian Multisine PolePlacement PositionStiffnessControl PredictiveControl Reference Samples Sine "
        "SlidingMode Step VelocityObserver"
    ),
    "dataset": "IsobaricDataset Recording read_dataset read_recording",
    "errors": "McKibbenError",
    "identification": "Fit identify identify_hysteresis rank validate",
    "joint": "AntagonisticJoint KneeGeometry Load RigidTendon SeriesSpring",
    "muscle": "ChouLaw Domain TripleExponentialLaw ExponentialLaw MaxwellCreep MaxwellSlip Muscle Specimen",
    "plant": "FirstOrderValve IdealValve JointPlant",
    "rig": "IsobaricProtocol SimulatedIsobaricTest",
    "simulation": "Result check_reference differentiate simulate simulate_many",
    "paper": "reproduce",
    "experiment_design": "plan",
    "study.scenario": "Scenario",
    "study.sweep": "sweep",
    "study.tune": "tune",
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}

__all__ = [
    "PID",
    "AntagonisticJoint",
    "BackpropPID",
    "ChouLaw",
    "Constant",
    "DecouplingControl",
    "Domain",
    "ExponentialLaw",
    "ExtendedStateObserver",
    "FirstOrderValve",
    "Fit",
    "FrictionCompensation",
    "IdealValve",
    "InverseModelControl",
    "IsobaricDataset",
    "IsobaricProtocol",
    "Jacobian",
    "JointPlant",
    "KneeGeometry",
    "Load",
    "MaxwellCreep",
    "MaxwellSlip",
    "McKibbenError",
    "Multisine",
    "Muscle",
    "PolePlacement",
    "PositionStiffnessControl",
    "PredictiveControl",
    "Recording",
    "Reference",
    "Result",
    "RigidTendon",
    "Samples",
    "Scenario",
    "SeriesSpring",
    "SimulatedIsobaricTest",
    "Sine",
    "SlidingMode",
    "Specimen",
    "Step",
    "TripleExponentialLaw",
    "VelocityObserver",
    "catalog",
    "check_reference",
    "differentiate",
    "identify",
    "identify_hysteresis",
    "plan",
    "rank",
    "read_dataset",
    "read_recording",
    "report",
    "reproduce",
    "simulate",
    "simulate_many",
    "sweep",
    "tune",
    "units",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"mckibben.{name}")
    if name in _HOME_OF:
        return getattr(importlib.import_module(f"mckibben.{_HOME_OF[name]}"), name)
    raise AttributeError(f"module 'mckibben' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
