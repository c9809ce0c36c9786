"""Requirement of a joint, and makes of muscles with the uncertainty of their forces."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from mckibben import catalog
from mckibben.component.base import Checked
from mckibben.component.schema import read_component
from mckibben.config.document import read_document
from mckibben.errors import ParameterError
from mckibben.identification import Fit, fit_law
from mckibben.joint import Load
from mckibben.muscle import ExponentialLaw, Muscle, Specimen
from mckibben.units import (
    Angle,
    Duration,
    Length,
    MomentArm,
    Quantity,
    Share,
    Stiffness,
    SupplyPressure,
    deg,
    show,
)

ReserveTorque = Annotated[float, Quantity("N*m", "N*m", 0, 1e6)]
SHORTEST = 0.04
"""Shortest muscle [m]."""


@dataclass(frozen=True)
class Requirement(Checked):
    """Load, motion and stiffness of a joint with two antagonistic muscles, and what may be chosen for it.

    A file has these fields with units, see docs/size.md. The joint has muscles on pulleys.

    Parameters
    ----------
    load
        Inertia, damping and gravity.
    angles
        Both ends of the motion [rad], the lower first.
    cycle
        Time [s] of a sine from one end to the other and back.
    supply
        Gauge pressure of the supply [Pa]; 90 % of it are used.
    stiffness
        Lowest and highest isobaric stiffness [N*m/rad] to be attainable throughout the motion. Default: any.
    torque
        Torque [N*m] in either direction, in addition to gravity and inertia.
    spread
        Relative spread of the forces among specimens of a muscle.
    tube
        Length of the tubes between valves and muscles [m].
    muscles, catalog
        Files of muscles to choose from, and whether those of the catalog are considered, too.
    longest, widest
        Longest muscle, and largest radius of a pulley [m].

    Raises
    ------
    ParameterError
        If the angles are not two, the lower first, or the stiffness likewise.
    RangeError
        If a number is outside the range of its field.

    Examples
    --------
    2 kg at 250 mm, moved by 30 deg to both sides in 2 s, take 0.646 N*m in addition to gravity:

    >>> from mckibben import PendulumLoad
    >>> from mckibben.units import bar
    >>> need = Requirement(PendulumLoad(2.0, 0.25), (-30 * deg, 30 * deg), cycle=2.0, supply=6 * bar)
    >>> round(need.reserve, 3)
    0.646
    """

    load: Load
    angles: tuple[Angle, ...]
    cycle: Duration
    supply: SupplyPressure
    stiffness: tuple[Stiffness, ...] | None = None
    torque: ReserveTorque = 0.0
    spread: Share = 0.1
    tube: Length = 1.0
    muscles: tuple[Path, ...] = ()
    catalog: bool = True
    longest: Length = 1.0
    widest: MomentArm = 0.15

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, pair in (("angles", self.angles), ("stiffness", self.stiffness)):
            if pair is not None and not (
                len(pair) == 2 and (pair[0] < pair[1] or (name == "stiffness" and 0 < pair[0] == pair[1]))
            ):
                remedy = "give two, the lower first, such as [-30 deg, 30 deg]"
                raise ParameterError(f"{name} are not a range", field=name, value=pair, remedy=remedy)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Requirement:
        """Read a file; raises `ScenarioError` with every problem: line, field, value, range and remedy."""
        return read_component(cls, Path(path))

    @property
    def amplitude(self) -> float:
        """Half of the range of angles [rad]."""
        return (self.angles[1] - self.angles[0]) / 2

    @property
    def middle(self) -> float:
        """Middle of the range of angles [rad]."""
        return (self.angles[0] + self.angles[1]) / 2

    @property
    def speed(self) -> float:
        """Highest speed of the motion [rad/s]."""
        return self.amplitude * 2 * math.pi / self.cycle

    @property
    def reserve(self) -> float:
        r"""Torque [N*m] in either direction in excess of gravity.

        .. math:: \tau + A \omega \sqrt{(I \omega)^2 + c^2}

        the required torque, and the largest of inertia and damping along the sine.
        """
        rate = 2 * math.pi / self.cycle
        return self.torque + self.speed * math.hypot(float(self.load.total_inertia) * rate, float(self.load.damping))

    def __str__(self) -> str:
        stiffness = self.stiffness and f", stiffness {self.stiffness[0]:.4g}..{self.stiffness[1]:.4g} N*m/rad"
        return (
            f"{self.angles[0] / deg:g}..{self.angles[1] / deg:g} deg in cycles of {self.cycle:g} s, inertia "
            f"{float(self.load.total_inertia):.3g} kg*m^2, gravity {abs(float(self.load.gravity_moment)):.3g} N*m, "
            f"torque {self.torque:g} N*m{stiffness or ''}, supply {show(self.supply, 'bar')}"
        )


class Make(NamedTuple):
    """Muscles of one diameter and any length: name, a muscle, and the relative uncertainty of its forces."""

    name: str
    muscle: Muscle
    uncertainty: float

    @classmethod
    def of(cls, name: str, muscle: Muscle, fit: Fit | None, spread: float = Requirement.spread) -> Make:
        """A make with the spread of its specimens and, if its law was fitted, the prediction interval of the fit.

        Raises `ParameterError` for a muscle without volume, and for a spread outside 0 to 1, or 1 with the fit.
        """
        if not muscle.specimen.has_volume:
            remedy = "give its initial_diameter and braid_angle, or identify it with --inner"
            raise ParameterError(f"{name}: the volume of the muscle is unknown", field="specimen", remedy=remedy)
        uncertainty = math.hypot(spread, 0.0 if fit is None else _relative_error(fit))
        if not (spread >= 0 and uncertainty < 1):
            raise ParameterError(
                f"{name}: forces with a spread of {spread:.3g} have an uncertainty of {uncertainty:.3g}",
                field="spread",
                value=spread,
                remedy="give a spread from 0 to below 1 (command line: --spread '10 %')",
            )
        return cls(name, muscle, uncertainty)

    @property
    def shortest(self) -> float:
        """Shortest muscle [m] that is considered, of at least three diameters: below, it is not a cylinder (ours)."""
        return max(SHORTEST, 3 * float(self.muscle.specimen.initial_diameter or 0.0))

    @property
    def unnamed(self) -> Specimen:
        """The specimen under a common name."""
        return dataclasses.replace(self.muscle.specimen, name="muscle")


def _relative_error(fit: Fit) -> float:
    """Root mean square half width of the 95 % prediction interval of a fit over its domain, relative to the forces."""
    domain = fit.law.domain
    contraction = np.linspace(float(domain.contraction_min), float(domain.contraction_max), 25)
    pressure = np.linspace(float(domain.pressure_min), float(domain.pressure_max), 9)
    interval = fit.force_intervals(contraction[:, None], pressure).prediction
    taut = np.asarray(interval.value) > 0
    half = ((np.asarray(interval.upper) - np.asarray(interval.lower)) / 2)[taut]
    return float(np.sqrt(np.mean(half**2) / np.mean(np.asarray(interval.value)[taut] ** 2)))


@functools.cache
def catalog_makes() -> tuple[Make, ...]:
    """Festo's muscles of 10, 20 and 40 mm, of any length.

    10 mm is fitted to the maker's chart, 20 mm to the force map of Martens and Boblan (2017). The catalog has no table
    of 40 mm: its forces are those of 20 mm times four, the ratio of the cross-sections and of the rated forces, 1500
    and 6000 N, with twice the spread (ours).
    """
    ten = fit_law(ExponentialLaw, catalog.dataset("festo-tool-10mm"))
    twenty = fit_law(ExponentialLaw, catalog.dataset("dmsp-20-300-martens2017"))
    small, large = catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.specimen("DMSP-20-300")
    forty = dataclasses.replace(
        large, name="Festo 40 mm", initial_diameter=2 * float(large.initial_diameter or 0.0), rated_force=6000.0
    )
    return (
        Make.of("Festo 10 mm", Muscle(dataclasses.replace(small, name="Festo 10 mm"), ten.law), ten),
        Make.of("Festo 20 mm", Muscle(dataclasses.replace(large, name="Festo 20 mm"), twenty.law), twenty),
        Make.of("Festo 40 mm", Muscle(forty, twenty.law, strength=4.0), twenty, 2 * Requirement.spread),
    )


def read_make(path: Path, spread: float = Requirement.spread) -> Make:
    """A make from a muscle file: with the uncertainty of its fit, if its law is the file of one with points."""
    muscle = read_component(Muscle, path)
    text = read_document(path.read_text(encoding="utf-8")).data.get("law")
    fit = None
    if isinstance(text, str) and Path(text).suffix in (".yaml", ".yml"):
        read = Fit.from_yaml(path.parent / text)
        fit = read if read.regression is not None else None
    return Make.of(str(muscle.specimen.name), muscle, fit, spread)
