"""Muscles: one force law a file, on one small base; a muscle is a specimen, a law and a domain."""

from mckibben.muscle.base import ForceLaw, Parameter, PressureAffineLaw
from mckibben.muscle.chou import ChouLaw
from mckibben.muscle.creep import Creep, MaxwellCreep, NoCreep, Relaxing
from mckibben.muscle.exponential import ExponentialLaw
from mckibben.muscle.friction import Friction, MaxwellSlip, Memory, NoFriction
from mckibben.muscle.hunt import HuntLaw
from mckibben.muscle.martens_boblan import MartensBoblanLaw
from mckibben.muscle.muscle import Muscle, forces
from mckibben.muscle.repperger import ReppergerLaw
from mckibben.muscle.reynolds import ReynoldsLaw
from mckibben.muscle.sarosi import SarosiLaw
from mckibben.muscle.scaled import stronger
from mckibben.muscle.specimen import Domain, Specimen
from mckibben.muscle.tondu_lopez import TonduLopezLaw, TonduLopezVariableLaw
from mckibben.muscle.triple_exponential import TripleExponentialLaw
from mckibben.muscle.tsagarakis_caldwell import TsagarakisCaldwellLaw

LAWS: dict[str, type[ForceLaw]] = {
    law.__name__: law
    for law in (
        ChouLaw,
        TonduLopezLaw,
        TonduLopezVariableLaw,
        TsagarakisCaldwellLaw,
        MartensBoblanLaw,
        ReppergerLaw,
        ReynoldsLaw,
        HuntLaw,
        SarosiLaw,
        ExponentialLaw,
        TripleExponentialLaw,
    )
}
"""Every law by its name, as files and the command line call it."""

__all__ = [
    "LAWS",
    "ChouLaw",
    "Creep",
    "Domain",
    "ExponentialLaw",
    "ForceLaw",
    "Friction",
    "HuntLaw",
    "MartensBoblanLaw",
    "MaxwellCreep",
    "MaxwellSlip",
    "Memory",
    "Muscle",
    "NoCreep",
    "NoFriction",
    "Parameter",
    "PressureAffineLaw",
    "Relaxing",
    "ReppergerLaw",
    "ReynoldsLaw",
    "SarosiLaw",
    "Specimen",
    "TonduLopezLaw",
    "TonduLopezVariableLaw",
    "TripleExponentialLaw",
    "TsagarakisCaldwellLaw",
    "forces",
    "stronger",
]
