"""Muscles: force laws, specimen, and the internal state of friction and creep."""

from mckibben.component.classes import concrete_subclasses
from mckibben.muscle.base import ForceLaw, Parameter, PressureAffineLaw, pressure_for, scaled_law
from mckibben.muscle.chou import ChouLaw
from mckibben.muscle.corrected import ForceCorrection, corrected_law
from mckibben.muscle.creep import Creep, CreepState, MaxwellCreep, NoCreep
from mckibben.muscle.exponential import ExponentialLaw, SarosiLaw
from mckibben.muscle.friction import Friction, FrictionState, MaxwellSlip, NoFriction
from mckibben.muscle.gaussian_process import GaussianProcessLaw
from mckibben.muscle.martens_boblan import MartensBoblanLaw
from mckibben.muscle.muscle import NO_STATE, Muscle, MuscleState, forces
from mckibben.muscle.phenomenological import HuntLaw, ReppergerLaw, ReynoldsLaw
from mckibben.muscle.smooth import SmoothAffineLaw, SmoothLaw
from mckibben.muscle.specimen import Domain, Specimen
from mckibben.muscle.spring import SpringLaw, return_spring
from mckibben.muscle.tondu_lopez import TonduLopezLaw, TonduLopezVariableLaw
from mckibben.muscle.tsagarakis_caldwell import TsagarakisCaldwellLaw

LAWS: dict[str, type[ForceLaw]] = {
    name: law for name, law in sorted((law.__name__, law) for law in concrete_subclasses(ForceLaw)) if law.parameters()
}
"""Force laws with parameters to identify, by the name used in files and on the command line, sorted."""

__all__ = [
    "LAWS",
    "NO_STATE",
    "ChouLaw",
    "Creep",
    "CreepState",
    "Domain",
    "ExponentialLaw",
    "ForceCorrection",
    "ForceLaw",
    "Friction",
    "FrictionState",
    "GaussianProcessLaw",
    "HuntLaw",
    "MartensBoblanLaw",
    "MaxwellCreep",
    "MaxwellSlip",
    "Muscle",
    "MuscleState",
    "NoCreep",
    "NoFriction",
    "Parameter",
    "PressureAffineLaw",
    "ReppergerLaw",
    "ReynoldsLaw",
    "SarosiLaw",
    "SmoothAffineLaw",
    "SmoothLaw",
    "Specimen",
    "SpringLaw",
    "TonduLopezLaw",
    "TonduLopezVariableLaw",
    "TsagarakisCaldwellLaw",
    "corrected_law",
    "forces",
    "pressure_for",
    "return_spring",
    "scaled_law",
]
