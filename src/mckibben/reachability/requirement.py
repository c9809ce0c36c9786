"""Requirement of a joint, and makes of muscles: strength, uncertainty, and friction along the motion."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.component.calls import CheckedCalls
from mckibben.component.schema import read_component
from mckibben.config.document import read_document
from mckibben.dataset import IsobaricDataset
from mckibben.errors import ParameterError
from mckibben.identification import Fit, identify
from mckibben.joint import GeneralLoad, Load
from mckibben.muscle import ExponentialLaw, Muscle, forces
from mckibben.muscle.muscle import half_widths
from mckibben.units import deg, show

SPREAD = 0.1
"""Relative spread of the forces of specimens of a make; the maker of the catalog's muscles allows up to 10 %."""
SHORTEST = 0.04
"""Shortest muscle [m]."""
_SLENDER = 3.0  # shortest muscle per diameter, below which it is not a cylinder (ours)
_SCALED_SPREAD = 0.2  # of a make whose forces are scaled from another diameter (ours)


@dataclass(frozen=True)
class Requirement(metaclass=CheckedCalls):
    """Motion, stiffness and load of a joint with two antagonistic muscles on pulleys.

    Parameters
    ----------
    load
        Inertia, damping and gravity.
    angles
        Both ends of the motion [rad].
    cycle
        Time [s] of a sine from one end to the other and back.
    supply
        Gauge pressure of the supply [Pa].
    stiffness
        Isobaric stiffness, or range of it [N*m/rad], to be attainable throughout the motion. Default: any.
    torque
        Torque [N*m] in either direction, in addition to gravity and inertia.
    longest, widest
        Longest muscle, and largest radius of a pulley [m].

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
    angles: tuple[float, float]
    cycle: float
    supply: float
    stiffness: tuple[float, float] | None = None
    torque: float = 0.0
    longest: float = 1.0
    widest: float = 0.15

    def __post_init__(self) -> None:
        for name in ("cycle", "supply", "longest", "widest"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ParameterError(f"{name} is {value:g}", value=value, remedy="give a positive number")
        if not (np.isfinite(self.torque) and self.torque >= 0):
            raise ParameterError(f"the torque is {self.torque:g} N*m", value=self.torque, remedy="give 0 or more")
        if not -math.inf < self.angles[0] < self.angles[1] < math.inf:
            message = f"the angles are {self.angles[0] / deg:g} and {self.angles[1] / deg:g} deg"
            remedy = "give two different angles, the lower first, such as -30..30 deg"
            raise ParameterError(message, value=self.angles, remedy=remedy)
        low, high = self.stiffness or (1.0, 1.0)
        if not 0 < low <= high < math.inf:
            remedy = "give a positive stiffness, or two, the lower first"
            raise ParameterError(f"the stiffness is {low:g} to {high:g} N*m/rad", value=self.stiffness, remedy=remedy)

    @property
    def amplitude(self) -> float:
        """Half of the range of angles [rad]."""
        return (self.angles[1] - self.angles[0]) / 2

    @property
    def middle(self) -> float:
        """Middle of the range of angles [rad]."""
        return (self.angles[0] + self.angles[1]) / 2

    @property
    def reserve(self) -> float:
        r"""Torque [N*m] in either direction in excess of gravity.

        .. math:: \tau + A \omega \sqrt{(I \omega)^2 + c^2}

        the required torque, and the largest of inertia and damping along the sine.
        """
        rate = 2 * math.pi / self.cycle
        return self.torque + self.amplitude * rate * math.hypot(
            float(self.load.total_inertia) * rate, float(self.load.damping)
        )

    def scaled(
        self, *, load: float = 1.0, angles: float = 1.0, stiffness: float = 1.0, cycle: float = 1.0
    ) -> Requirement:
        """The requirement with load and torque, range about the same middle, stiffness, or cycle times a factor."""
        given, half = self.load, self.amplitude * angles
        moved = GeneralLoad(
            inertia=float(given.total_inertia) * load,
            greatest_gravity_torque=float(given.gravity_moment) * load,
            damping=float(given.damping) * load,
            hanging_angle=float(given.hanging_angle),
        )
        wanted = self.stiffness and (self.stiffness[0] * stiffness, self.stiffness[1] * stiffness)
        return dataclasses.replace(
            self,
            load=moved,
            torque=self.torque * load,
            angles=(self.middle - half, self.middle + half),
            stiffness=wanted,
            cycle=self.cycle * cycle,
        )

    def stiffness_text(self) -> str:
        """The required stiffness as text."""
        low, high = self.stiffness or (math.nan, math.nan)
        return f"{low:.4g} N*m/rad" if low == high else f"{low:.4g}..{high:.4g} N*m/rad"

    def describe(self) -> str:
        """The requirement as text."""
        stiffness = f", stiffness {self.stiffness_text()}" if self.stiffness else ""
        torque = f", torque {self.torque:g} N*m either way" if self.torque else ""
        return (
            f"{self.angles[0] / deg:g}..{self.angles[1] / deg:g} deg in cycles of {self.cycle:g} s with an inertia of "
            f"{float(self.load.total_inertia):.3g} kg*m^2 and {abs(float(self.load.gravity_moment)):.3g} N*m of gravity"
            f"{torque}{stiffness}, supply {show(self.supply, 'bar')}"
        )


class Make(NamedTuple):
    """Muscles of one diameter and any length: name, a muscle, and the relative uncertainty of its forces."""

    name: str
    muscle: Muscle
    uncertainty: float

    @classmethod
    def of(cls, name: str, muscle: Muscle, fit: Fit | None, spread: float = SPREAD) -> Make:
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
        """Shortest muscle [m] that is considered, of at least three diameters."""
        return max(SHORTEST, _SLENDER * float(self.muscle.specimen.initial_diameter or 0.0))

    def with_strength(self, factor: float) -> Muscle:
        """The muscle with forces times a factor; without its name, so that all makes share compiled programs."""
        unnamed = dataclasses.replace(self.muscle.specimen, name="muscle")
        strength = factor * float(self.muscle.strength or 1.0)
        return dataclasses.replace(self.muscle, specimen=unnamed, strength=strength)


def _relative_error(fit: Fit) -> float:
    """Root mean square half width of the 95 % prediction interval of a fit over its domain, relative to the forces."""
    domain = fit.law.domain
    contraction = np.linspace(float(domain.contraction_min), float(domain.contraction_max), 25)
    pressure = np.linspace(float(domain.pressure_min), float(domain.pressure_max), 9)
    found = fit.force_intervals(contraction[:, None], pressure).prediction
    taut = np.asarray(found.value) > 0
    half = ((np.asarray(found.upper) - np.asarray(found.lower)) / 2)[taut]
    return float(np.sqrt(np.mean(half**2) / np.mean(np.asarray(found.value)[taut] ** 2)))


@functools.cache
def catalog_makes() -> tuple[Make, ...]:
    """Festo's muscles of 10, 20 and 40 mm, of any length.

    10 mm is fitted to the maker's chart, 20 mm to the force map of Martens and Boblan (2017). The catalog has no table
    of 40 mm: its forces are those of 20 mm times four, the ratio of the cross-sections and of the rated forces, 1500
    and 6000 N.
    """
    ten = identify(ExponentialLaw, catalog.dataset("festo-tool-10mm"))
    data: IsobaricDataset = catalog.dataset("dmsp-20-300-martens2017")
    twenty = identify(ExponentialLaw, data)
    small, large = catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.specimen("DMSP-20-300")
    forty = dataclasses.replace(
        large, name="Festo 40 mm", initial_diameter=2 * float(large.initial_diameter or 0.0), rated_force=6000.0
    )
    return (
        Make.of("Festo 10 mm", Muscle(dataclasses.replace(small, name="Festo 10 mm"), ten.law), ten),
        Make.of("Festo 20 mm", Muscle(dataclasses.replace(large, name="Festo 20 mm"), twenty.law), twenty),
        Make.of("Festo 40 mm", Muscle(forty, twenty.law, strength=4.0), twenty, _SCALED_SPREAD),
    )


def read_make(path: Path, spread: float = SPREAD) -> Make:
    """A make from a muscle file: with the uncertainty of its fit, if its law is the file of one with points."""
    muscle = read_component(Muscle, path)
    text = read_document(path.read_text(encoding="utf-8")).data.get("law")
    fit = None
    if isinstance(text, str) and Path(text).suffix in (".yaml", ".yml"):
        read = Fit.from_yaml(path.parent / text)
        fit = read if read.regression is not None else None
    return Make.of(str(muscle.specimen.name), muscle, fit, spread)


def with_supply(muscle: Muscle, highest: float) -> Muscle:
    """The muscle with a highest pressure [Pa] not above its own."""
    domain = muscle.specimen.domain
    limited = dataclasses.replace(domain, pressure_max=min(float(domain.pressure_max), highest))
    return dataclasses.replace(muscle, specimen=dataclasses.replace(muscle.specimen, domain=limited))


def with_length(muscle: Muscle, length: float) -> Muscle:
    """The muscle with another initial length [m]; its volume scales with the length."""
    specimen = muscle.specimen
    terms = specimen.volume_terms and tuple(t * length / float(specimen.initial_length) for t in specimen.volume_terms)
    return dataclasses.replace(
        muscle, specimen=dataclasses.replace(specimen, initial_length=length, volume_terms=terms)
    )


_PARTS = 5  # contractions along the motion


def friction_force(
    muscle: Muscle,
    need: Requirement,
    candidates: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    minimum_tension: float,
    *,
    cocontracted: bool,
) -> NDArray[np.float64]:
    """Largest sum [N] of both muscles' friction, for lengths, radii and middle contractions of shape (candidates,)."""
    # One muscle has its highest pressure and the other one its lowest, as for the largest torque; `cocontracted`: both
    # have the pressure with more friction. The viscous part is that of the highest speed.
    length, radius, contraction = candidates
    if not muscle.has_friction:
        return np.zeros_like(length)
    shift = radius * need.amplitude / length
    contractions = contraction + np.linspace(-1.0, 1.0, _PARTS)[:, None] * shift
    rate = radius * need.amplitude * 2 * math.pi / need.cycle

    def friction(pressure: float) -> NDArray[np.float64]:
        tension = np.maximum(forces(muscle, contractions, pressure), minimum_tension)
        sliding = half_widths(muscle.friction, tension, pressure)
        lengths = length * (1 - contractions)
        return sliding + np.asarray(muscle.friction.viscous_force(lengths, tension, pressure, rate))

    working, opposing = (friction(float(end)) for end in (muscle.domain.pressure_max, muscle.domain.pressure_min))
    if cocontracted:
        return 2 * np.maximum(working, opposing).max(axis=0)
    return (working + opposing[::-1]).max(axis=0)  # where one muscle is shorter, the other one is longer
