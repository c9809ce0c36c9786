"""The motor of a stretching device: pulses and the way they make."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import RangeError
from mckibben.numerics.checks import check_positive
from mckibben.units import mm

_WHOLE = 1e-6  # pulses


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A step motor, a reducer and a lead screw.

    Parameters
    ----------
    steps
        Pulses a revolution of the motor: 200 (ours; the usual motor, full steps).
    reduction
        Revolutions of the motor for one of the screw: 10 (the paper, "Experimental system").
    lead
        Way [m] of one revolution of the screw: 5 mm (the paper).
    fastest
        Pulses a second [Hz] that it follows: 2000 (ours), which is 5 mm/s.

    Raises
    ------
    RangeError
        If a number has no meaning.

    Examples
    --------
    >>> drive = Drive()
    >>> drive.pulses_per_metre, drive.pulses(1 * mm), drive.rate(0.2 * mm)
    (400000.0, 400, 80.0)
    >>> drive.pulses(1.001 * mm)
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: 1.001 mm are 400.4 pulses; take a multiple of 0.0025 mm
    """

    steps: int = 200
    reduction: float = 10.0
    lead: float = 5 * mm
    fastest: float = 2000.0

    def __post_init__(self) -> None:
        check_positive("drive", steps=float(self.steps), reduction=self.reduction)
        check_positive("drive", "m", lead=self.lead)
        check_positive("drive", "Hz", fastest=self.fastest)

    @property
    def pulses_per_metre(self) -> float:
        """Pulses for a way of a metre [1/m]; exact in the decimals that were given."""
        return float(self.steps * Fraction(str(self.reduction)) / Fraction(str(self.lead)))

    def pulses(self, way: float) -> int:
        """Pulses for a way [m].

        Raises
        ------
        RangeError
            If it is no whole number of them.
        """
        exact = way * self.pulses_per_metre
        if not np.isfinite(exact) or abs(exact - round(exact)) > _WHOLE:
            one = 1 / self.pulses_per_metre / mm
            raise RangeError(
                f"{way / mm:g} mm are {exact:g} pulses", value=way, unit="m", remedy=f"take a multiple of {one:g} mm"
            )
        return round(exact)

    def nearest(self, way: float) -> int:
        """Pulses that come nearest to a way [m]."""
        return round(way * self.pulses_per_metre)

    def way(self, pulses: ArrayLike) -> NDArray[np.float64]:
        """The way [m] of so many pulses, of any shape."""
        return np.asarray(pulses, np.float64) / self.pulses_per_metre

    def rate(self, speed: float) -> float:
        """Pulses a second [Hz] for a speed [m/s].

        Raises
        ------
        RangeError
            If the motor is not that fast.
        """
        rate = abs(speed) * self.pulses_per_metre
        if not 0 < rate <= self.fastest:
            raise RangeError(
                f"{speed / mm:g} mm/s are {rate:g} pulses a second; the motor does {self.fastest:g} at most",
                value=rate,
                lower=0.0,
                upper=self.fastest,
                unit="Hz",
                remedy=f"move at up to {self.fastest / self.pulses_per_metre / mm:g} mm/s",
            )
        return rate
