"""How sure a fit is, in words and numbers: what `mckibben identify` says beyond the fit itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mckibben.units import factor

if TYPE_CHECKING:
    from mckibben.identification import Bootstrap, Fit, Interval, Profile


@dataclass(frozen=True)
class Further:
    """What was asked of a fit beyond its standard errors.

    Attributes
    ----------
    level
        Of all intervals.
    profiles
        Of each shape parameter; empty unless asked for.
    refits
        The bootstrap; None unless asked for.
    """

    level: float
    profiles: tuple[Profile, ...]
    refits: Bootstrap | None


def further(fit: Fit, *, level: float = 0.95, profiles: bool = False, refits: int = 0, seed: int = 0) -> Further:
    """Profile the shape parameters of a fit, and repeat it on blocks drawn anew.

    Parameters
    ----------
    fit
        As `identify` returned it.
    level
        Of the intervals.
    profiles
        Whether to profile each shape parameter.
    refits
        Of the bootstrap; none at 0.
    seed
        Of the bootstrap.

    Raises
    ------
    RangeError
        If the level is no probability, or there is one refit only.
    IdentificationError
        If there are too few blocks to draw from.
    """
    from mckibben.identification import bootstrap, profile
    from mckibben.identification.bands import check_level

    check_level(level)
    shape = type(fit.law).shape_parameters if profiles else ()
    return Further(
        level,
        tuple(profile(fit, p.name, level=level) for p in shape),
        bootstrap(fit, refits, seed=seed) if refits else None,
    )


def further_report(fit: Fit, found: Further) -> str:
    """Profiles and bootstrap as text, in the units of publications; empty where there are none."""
    share = f"{100 * found.level:g} %"
    lines: list[str] = []
    for one in found.profiles:
        low, high = _shown(fit, one.name, one.interval)
        lines.append(f"profile of {one.name}: {share} interval {_end(low)} .. {_end(high)} {_unit(fit, one.name)}")
        lines += [f"warning: {reason}" for reason in one.reasons]
    if refits := found.refits:
        again = f"; {refits.failed} draws that left the law undetermined were drawn again" if refits.failed else ""
        lines.append(f"bootstrap: {len(refits.draws)} refits to {refits.by.counted(refits.blocks)} drawn anew{again}")
        errors = refits.standard_errors
        for name, interval in refits.intervals(found.level).items():
            low, high = _shown(fit, name, interval)
            error = errors[name] / _scale(fit, name)
            if np.isnan(error):
                lines.append(f"  {name}: at its bound")
                continue
            lines.append(f"  {name}: standard error {error:.2g}, {share} {low:.5g} .. {high:.5g} {_unit(fit, name)}")
        lines += [f"warning: {doubt}" for doubt in refits.doubts]
    return "\n".join(lines)


def interval_numbers(fit: Fit, found: Further) -> dict[str, Any]:
    """Intervals of a fit, of its profiles and its bootstrap, in the units of publications, for JSON."""
    robust = fit.robust
    numbers: dict[str, Any] = {
        "level": found.level,
        "errors_by": robust.by.value if robust else "point",
        "groups": robust.groups if robust else fit.points_used,
        "intervals": _all(fit, fit.intervals(found.level)),
    }
    if robust:
        numbers["robust_standard_errors"] = {n: e / _scale(fit, n) for n, e in robust.standard_errors.items()}
        numbers["degrees_of_freedom"] = dict(robust.degrees_of_freedom)
    if found.profiles:
        numbers["profiles"] = {
            one.name: {
                "interval": list(_shown(fit, one.name, one.interval)),
                "identified": one.identified,
                "reasons": list(one.reasons),
            }
            for one in found.profiles
        }
    if refits := found.refits:
        numbers["bootstrap"] = {
            "by": refits.by.value,
            "blocks": refits.blocks,
            "refits": len(refits.draws),
            "drawn_again": refits.failed,
            "doubts": list(refits.doubts),
            "standard_errors": {n: e / _scale(fit, n) for n, e in refits.standard_errors.items()},
            "intervals": _all(fit, refits.intervals(found.level)),
        }
    return numbers


def _all(fit: Fit, intervals: Mapping[str, Interval]) -> dict[str, list[float]]:
    return {name: list(_shown(fit, name, interval)) for name, interval in intervals.items()}


def _shown(fit: Fit, name: str, interval: Interval) -> tuple[float, float]:
    scale = _scale(fit, name)
    return interval.lower / scale, interval.upper / scale


def _end(value: float) -> str:
    return "not bounded" if abs(value) == float("inf") else f"{value:.5g}"


def _unit(fit: Fit, name: str) -> str:
    return next(p.shown for p in type(fit.law).parameters() if p.name == name)


def _scale(fit: Fit, name: str) -> float:
    return factor(_unit(fit, name))
