"""Muscles: force laws, specimen, and the internal state of friction and creep."""

from collections.abc import Iterator, Mapping

from mckibben.component.classes import classes_of
from mckibben.muscle.adjusted import ForceCorrection, adjusted_law
from mckibben.muscle.base import ForceLaw, Parameter, PressureAffineLaw, pressure_for
from mckibben.muscle.chou import ChouLaw
from mckibben.muscle.creep import Creep, CreepState, MaxwellCreep, NoCreep
from mckibben.muscle.exponential import ExponentialLaw, SarosiLaw
from mckibben.muscle.friction import Friction, FrictionState, MaxwellSlip, NoFriction
from mckibben.muscle.martens_boblan import MartensBoblanLaw
from mckibben.muscle.muscle import NO_STATE, Muscle, MuscleState, forces
from mckibben.muscle.phenomenological import HuntLaw, ReppergerLaw, ReynoldsLaw
from mckibben.muscle.piecewise import PiecewiseLaw
from mckibben.muscle.smooth import SmoothLaw
from mckibben.muscle.specimen import Domain, Specimen
from mckibben.muscle.spring import NoForce, SpringLaw, no_muscle, return_spring
from mckibben.muscle.threshold import ThresholdLaw
from mckibben.muscle.tondu_lopez import TonduLopezLaw, TonduLopezVariableLaw
from mckibben.muscle.tsagarakis_caldwell import TsagarakisCaldwellLaw


class _Laws(Mapping[str, type[ForceLaw]]):
    """Force laws with parameters to identify, of this package and of any module that is imported, by name, sorted."""

    def _by_name(self) -> dict[str, type[ForceLaw]]:
        laws = {name: law for name, law in classes_of(ForceLaw).items() if law.parameters()}
        package = __name__.partition(".")[0]
        named = (
            (law.__name__ if law.__module__.partition(".")[0] == package else name, law) for name, law in laws.items()
        )
        return dict(sorted(named))

    def __getitem__(self, name: str) -> type[ForceLaw]:
        return self._by_name()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name())

    def __len__(self) -> int:
        return len(self._by_name())


LAWS = _Laws()
"""Force laws by the name used in files and on the command line."""

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
    "HuntLaw",
    "MartensBoblanLaw",
    "MaxwellCreep",
    "MaxwellSlip",
    "Muscle",
    "MuscleState",
    "NoCreep",
    "NoForce",
    "NoFriction",
    "Parameter",
    "PiecewiseLaw",
    "PressureAffineLaw",
    "ReppergerLaw",
    "ReynoldsLaw",
    "SarosiLaw",
    "SmoothLaw",
    "Specimen",
    "SpringLaw",
    "ThresholdLaw",
    "TonduLopezLaw",
    "TonduLopezVariableLaw",
    "TsagarakisCaldwellLaw",
    "adjusted_law",
    "forces",
    "no_muscle",
    "pressure_for",
    "return_spring",
]
