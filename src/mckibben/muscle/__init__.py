"""Muscles: one force law a file, on one small base; a muscle is a specimen, a law and a domain."""

from mckibben.muscle.base import ForceLaw, Parameter, PressureAffineLaw
from mckibben.muscle.chou import ChouLaw
from mckibben.muscle.domain import Domain
from mckibben.muscle.exponential import ExponentialLaw
from mckibben.muscle.muscle import Muscle, forces
from mckibben.muscle.specimen import Specimen

LAWS: dict[str, type[ForceLaw]] = {law.__name__: law for law in (ChouLaw, ExponentialLaw)}
"""Every law by its name, as files and the command line call it."""

__all__ = [
    "LAWS",
    "ChouLaw",
    "Domain",
    "ExponentialLaw",
    "ForceLaw",
    "Muscle",
    "Parameter",
    "PressureAffineLaw",
    "Specimen",
    "forces",
]
