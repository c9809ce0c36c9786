"""Where a rig may measure next: states that it can set, at which the muscle is taut and not overloaded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.muscle import Domain, ForceLaw, forces
from mckibben.units import bar, percent

_MOST = 40_000  # states of a grid: beyond it no rig sets so fine


@dataclass(frozen=True)
class Setting:
    """What a rig can set, and what the muscle bears.

    Attributes
    ----------
    box
        Contractions [-] and gauge pressures [Pa] from which to choose.
    contraction_step, pressure_step
        Of the rig [-], [Pa]: states are whole multiples of these.
    lowest_force, highest_force
        What a force must be above to be a measurement, and may not exceed [N].
    """

    box: Domain
    contraction_step: float
    pressure_step: float
    lowest_force: float
    highest_force: float

    def __post_init__(self) -> None:
        for what, step, unit in (
            ("contraction", self.contraction_step, ""),
            ("pressure", self.pressure_step, " Pa"),
        ):
            if not (math.isfinite(step) and step > 0):
                raise RangeError(f"a {what} step of {step:g}{unit} is none", value=step, lower=0.0)


@dataclass(frozen=True, eq=False)
class States:
    """A grid of states, and which of them can be measured.

    Attributes
    ----------
    contractions, pressures
        Shape (contractions,), (pressures,): the axes [-], [Pa], ascending.
    force
        Shape (pressures, contractions): by the law [N].
    allowed
        The same shape: taut, not overloaded, and where the law has a meaning.
    """

    contractions: NDArray[np.float64] = field(repr=False)
    pressures: NDArray[np.float64] = field(repr=False)
    force: NDArray[np.float64] = field(repr=False)
    allowed: NDArray[np.bool_] = field(repr=False)

    @classmethod
    def of(cls, law: ForceLaw, setting: Setting) -> States:
        """All states of a setting.

        Raises
        ------
        RangeError
            If none of them can be measured, or the steps make more than a rig would ever set.
        """
        box = setting.box
        contractions = multiples(float(box.contraction_min), float(box.contraction_max), setting.contraction_step)
        pressures = multiples(float(box.pressure_min), float(box.pressure_max), setting.pressure_step)
        if len(contractions) * len(pressures) > _MOST:
            raise RangeError(
                f"{len(pressures)} pressures x {len(contractions)} contractions are too many to choose from",
                value=len(contractions) * len(pressures),
                upper=_MOST,
                remedy="choose coarser steps or narrower limits",
            )
        grid = contractions[None, :], pressures[:, None]
        force = forces(law, *grid)
        meant = np.asarray(type(law).holds.contains(*grid))
        with np.errstate(invalid="ignore"):
            allowed = np.isfinite(force) & meant & (force > setting.lowest_force) & (force <= setting.highest_force)
        if not allowed.any():
            raise RangeError(
                f"at no state within contraction {_range(box.contraction_min, box.contraction_max, percent)} % and "
                f"pressure {_range(box.pressure_min, box.pressure_max, bar)} bar does the muscle pull with more than "
                f"{setting.lowest_force:.3g} and at most {setting.highest_force:.4g} N",
                remedy="widen the limits, or choose finer steps",
            )
        return cls(contractions, pressures, force, allowed)

    @property
    def places(self) -> NDArray[np.int64]:
        """Rows and columns of the allowed states, shape (states, 2)."""
        return np.argwhere(self.allowed)


def multiples(low: float, high: float, step: float) -> NDArray[np.float64]:
    """The whole multiples of a step from low to high, to rounding.

    >>> multiples(-0.03, 0.01, 0.01)
    array([-0.03, -0.02, -0.01,  0.  ,  0.01])
    """
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    return np.asarray(np.round(np.arange(first, last + 1) * step, 12), np.float64)


def _range(low: object, high: object, unit: float) -> str:
    return f"{float(low) / unit:g}..{float(high) / unit:g}"  # type: ignore[arg-type]
