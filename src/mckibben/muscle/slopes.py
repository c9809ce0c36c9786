"""Slopes that the force of a muscle has: it falls with contraction and rises with pressure."""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.muscle.base import ForceLaw
from mckibben.muscle.specimen import Domain
from mckibben.numerics.compiled import jit
from mckibben.units import bar, percent

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def unphysical(law: ForceLaw, domain: Domain | None = None, *, measured: bool = False) -> str:
    """Return the first violation, in words, of a pull that falls with contraction and rises with pressure.

    Sought on a grid over a domain, by default that of the law, or with `measured` over the hull of its points alone;
    empty if there is none. Where the domain is not bounded, contractions are 0 to 10 %, which every muscle reaches, and
    pressures 0 to 1 bar.

    Examples
    --------
    >>> from mckibben.muscle import ReynoldsLaw
    >>> unphysical(ReynoldsLaw(f0=3, f1=60 / bar, k0=0, k1=-280 / bar))
    'its force rises with contraction at 0 % and 0.03125 bar'
    """
    domain = law.domain if domain is None else domain
    contraction, pressure = slope_grid(domain)
    force = np.asarray(_force(law, contraction, pressure))
    if 0 < domain.pressure_max < np.inf and (force <= 0).all():
        return f"it does not pull up to {domain.pressure_max / bar:.4g} bar"
    inside = np.asarray(domain.contains(contraction, pressure)) | (not measured)
    texts = ("it has no force", "its force rises with contraction", "its force falls with pressure")
    for violation, wrong in zip(texts, (~np.isfinite(force), *wrong_slopes(force)), strict=True):
        rows, columns = wrong.shape  # those of intervals: both of their ends count
        wrong = wrong & inside[:rows, :columns] & inside[-rows:, -columns:]
        if wrong.any():
            i, j = np.unravel_index(np.argmax(wrong), wrong.shape)
            return f"{violation} at {contraction[i, 0] / percent:.4g} % and {pressure[j] / bar:.4g} bar"
    return ""


@jit
def _force(law: ForceLaw, contraction: ArrayLike, pressure: ArrayLike) -> Array:
    return law.force(contraction, pressure)


def slope_grid(
    box: Domain, *, contractions: int = 57, pressures: int = 33, first_step: float = 0.02
) -> tuple[Floats, Floats]:
    """Contraction, a column, and pressure [Pa], a row, at which slopes are checked.

    The first step of the contraction is short, a share `first_step` of the others: an exponential term is steepest
    there.
    """
    contraction = np.linspace(*_finite(box.contraction_min, box.contraction_max, 10 * percent), contractions)
    contraction = np.insert(contraction, 1, contraction[0] + first_step * np.diff(contraction[:2]))
    return contraction[:, None], np.linspace(*_finite(box.pressure_min, box.pressure_max, 1 * bar), pressures)


def _finite(low: float | Array, high: float | Array, reached: float) -> tuple[float, float]:
    """Bounds, an infinite lower one as 0, and an infinite upper one as `reached`."""
    lower, upper = float(low), float(high)
    lowest = lower if np.isfinite(lower) else min(0.0, upper)
    return lowest, upper if np.isfinite(upper) else max(reached, lowest)


def wrong_slopes(force: Floats, *, rounding: float = 1e-9) -> tuple[Bools, Bools]:
    """Masks of intervals of the grid in which a force rises with contraction, and in which it falls with pressure.

    Changes by a share `rounding` of the largest force do not count.
    """
    rounding = rounding * float(np.nanmax(np.abs(force), initial=0.0))
    rises = (force[:-1] > 0) & (np.diff(force, axis=0) > rounding)
    return rises, (force[:, :-1] > 0) & (-np.diff(force, axis=1) > rounding)
