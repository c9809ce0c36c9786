"""Names and units in which results are shown, and the uncertainty of a fit in words."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mckibben.storage.files import atomic_write
from mckibben.units import deg, factor, litre, percent

if TYPE_CHECKING:
    from mckibben.identification import Bootstrap, Fit, HysteresisFit, Interval, Profile


METRICS: dict[str, tuple[str, str, float]] = {
    "angle_rmse_deg": ("angle_rmse", "deg", deg),
    "angle_max_deg": ("angle_max", "deg", deg),
    "stiffness_rmse": ("stiffness_rmse", "N*m/rad", 1.0),
    "stiffness_max": ("stiffness_max", "N*m/rad", 1.0),
    "stiffness_ripple": ("stiffness_ripple", "N*m/rad", 1.0),
    "stiffness_settling_s": ("stiffness_settling", "s", 1.0),
    "coupling_deg": ("coupling", "deg", deg),
    "estimate_rmse": ("estimate_rmse", "N*m/rad", 1.0),
    "time_saturated_s": ("time_saturated", "s", 1.0),
    "time_slack_s": ("time_slack", "s", 1.0),
    "time_outside_domain_s": ("time_outside_domain", "s", 1.0),
    "time_overloaded_s": ("time_overloaded", "s", 1.0),
    "excursion_max_percent": ("excursion_max", "%", percent),
    "force_max_N": ("force_max", "N", 1.0),
    "air_L": ("air", "L", litre),
}
"""From the name under which a metric is shown to that of `Metrics`, the unit as text and as a factor to SI."""


def shown(metrics: Mapping[str, float]) -> dict[str, float]:
    """The metrics of a run under the names and in the units in which they are shown."""
    return {name: metrics[metric] / unit for name, (metric, _, unit) in METRICS.items()}


def fit_numbers(fit: Fit) -> dict[str, Any]:
    """A fit in the units in which its law is published."""
    unseen = fit.leave_one_pressure_out
    published = {p.name: factor(p.shown, p.unit) for p in type(fit.law).parameters()}
    units = {p.name: p.shown for p in type(fit.law).parameters()}
    return {
        "law": type(fit.law).__name__,
        **({"decay_per_percent": fit.estimates["decay"] / published["decay"]} if "decay" in published else {}),
        "rmse_N": fit.rmse,
        "max_N": fit.max_error,
        "leave_one_pressure_out_rmse_N": unseen.rmse if unseen else None,
        "leave_one_pressure_out_max_N": unseen.max_error if unseen else None,
        "points_used": fit.points_used,
        "points_slack": fit.points_slack,
        "parameters": {
            name: {
                "estimate": value / published[name],
                "standard_error": fit.standard_errors[name] / published[name],
                "unit": units[name],
            }
            for name, value in fit.estimates.items()
        },
        "warnings": list(fit.warnings),
    }


def hysteresis_numbers(found: HysteresisFit) -> dict[str, Any]:
    """Friction and drift in the units in which they are shown."""
    friction, errors = found.friction, found.standard_errors
    per_bar = factor("N/bar")
    return {
        "half_width_N": friction.half_width,
        "half_width_standard_error_N": errors["half_width"],
        "growth_N_per_bar": friction.growth / per_bar,
        "growth_standard_error_N_per_bar": errors["growth"] / per_bar,
        "reference_pressure_bar": friction.reference_pressure / factor("bar"),
        "presliding_length_mm": friction.presliding_length / factor("mm"),
        "presliding_length_standard_error_mm": errors["presliding_length"] / factor("mm"),
        "drift_N_per_hour": found.drift.rate * 3600 if found.drift else 0.0,
        "rmse_N": found.rmse,
        "max_N": found.max_error,
        "warnings": list(found.warnings),
    }


def plain(value: Any) -> Any:
    """The same with NaN and infinities as None, which JSON has a word for, and tuples as lists."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def to_json(value: Any) -> str:
    """As text, indented."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def html_table(title: str, headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """HTML of a small table, for notebooks."""

    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    return f"<table><caption>{escape(title)}</caption>{row(headers, 'th')}{body}</table>"


def write_json(path: Path, value: Any) -> None:
    """To a file; an existing one is replaced only when the new one is whole."""
    text = to_json(value)
    with atomic_write(path, overwrite=True) as part:
        part.write_text(text + "\n", encoding="utf-8")


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
    from mckibben.identification.intervals import check_level

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
        lines += [f"warning: {doubt}" for doubt in refits.warnings]
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
            "doubts": list(refits.warnings),
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
