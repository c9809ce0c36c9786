"""A law to begin with, where the data at hand determine none."""

from __future__ import annotations

import dataclasses

import numpy as np

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, ParameterError
from mckibben.identification import identify
from mckibben.muscle import Domain, ForceLaw, forces

_CHART = "festo-tool-10mm"


def guessed_law(law_type: type[ForceLaw], points: IsobaricDataset, given: ForceLaw | None) -> tuple[ForceLaw, str]:
    """The law about which a plan is made before there is a fit, and where it comes from.

    Where none is given it is fitted to the maker's chart of a 10 mm muscle. Its linear parameters are then scaled
    together to the taut points, where there are any: a muscle of twice the area pulls twice as hard.

    Parameters
    ----------
    law_type
        The kind of law.
    points
        Taut points at hand, perhaps none.
    given
        A law of that kind.

    Raises
    ------
    ParameterError
        If the law given is of another kind.
    IdentificationError
        If there is none and the chart does not determine one either.
    """
    if given is not None:
        if type(given) is not law_type:
            raise ParameterError(
                f"the guess is a {type(given).__name__}, the plan is for {law_type.__name__}",
                remedy="give a guess of that kind, or plan for its kind",
            )
        law, origin = given, "the guess given"
    else:
        try:
            law = identify(law_type, catalog.dataset(_CHART)).law
        except IdentificationError as error:
            raise IdentificationError(
                f"there is no guess for {law_type.__name__}: the chart {_CHART} does not determine it either ({error})",
                remedy="give a law to begin with (--guess)",
            ) from error
        origin = f"{law_type.__name__} as it fits the chart {_CHART}"
    law = dataclasses.replace(law, domain=Domain())
    names = [p.name for p in law_type.linear_parameters]
    if not len(points) or not names:
        return law, origin
    place = points.contraction, points.pressure
    without = dataclasses.replace(law, **dict.fromkeys(names, 0.0))
    fixed, whole = forces(without, *place), forces(law, *place)
    part = whole - fixed
    scale = float(part @ (points.force - fixed) / (part @ part)) if part @ part else np.nan
    if not (np.isfinite(scale) and scale > 0):
        return law, origin
    law = dataclasses.replace(law, **{name: scale * float(getattr(law, name)) for name in names})
    return law, f"{origin}, times {scale:.3g} to meet the points at hand"
