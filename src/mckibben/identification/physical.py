"""Whether a fitted law does what no muscle can, between the points that it was fitted to."""

from __future__ import annotations

import numpy as np

from mckibben.muscle import Domain, ForceLaw, forces
from mckibben.units import bar, percent

_CONTRACTIONS, _PRESSURES = 57, 33
_ROUNDING = 1e-9  # of the largest force


def unphysical(law: ForceLaw, domain: Domain | None = None) -> str:
    """Where the law has no force, or its taut muscle would pull harder when shorter or less at more pressure; or empty.

    Parameters
    ----------
    law
        To be looked at.
    domain
        On a grid over it, edges included; over the law's own unless given.

    Examples
    --------
    >>> from mckibben import catalog
    >>> unphysical(catalog.law("lei-mas-10-180n"))
    ''
    >>> from mckibben.muscle import ReynoldsLaw
    >>> unphysical(ReynoldsLaw(100.0, 1e-3, 500.0, -2e-2, Domain(0.0, 0.2, 0.0, 6e5)))
    'its force rises with contraction at 0 % and 0.375 bar'
    """
    box = law.domain if domain is None else domain
    contraction = np.linspace(float(box.contraction_min), float(box.contraction_max), _CONTRACTIONS)
    pressure = np.linspace(float(box.pressure_min), float(box.pressure_max), _PRESSURES)
    force = forces(law, contraction[:, None], pressure)
    nowhere = ~np.isfinite(force)
    if nowhere.any():
        i, j = np.unravel_index(np.argmax(nowhere), nowhere.shape)
        return f"it has no force at {contraction[i] / percent:.4g} % and {pressure[j] / bar:.4g} bar"
    rounding = _ROUNDING * float(np.abs(force).max())
    for what, change, taut in (
        ("rises with contraction", np.diff(force, axis=0), force[:-1] > 0),
        ("falls with pressure", -np.diff(force, axis=1), force[:, :-1] > 0),
    ):
        wrong = taut & (change > rounding)
        if wrong.any():
            i, j = np.unravel_index(np.argmax(wrong), wrong.shape)
            return f"its force {what} at {contraction[i] / percent:.4g} % and {pressure[j] / bar:.4g} bar"
    return ""
