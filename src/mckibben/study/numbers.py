"""Numbers for people and for JSON: the names and units in which results are shown, in one place."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mckibben.files import whole
from mckibben.units import deg, factor, litre, percent

if TYPE_CHECKING:
    from mckibben.identification import Fit, HysteresisFit

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


def write_json(path: Path, value: Any) -> None:
    """To a file; an existing one is replaced only when the new one is whole."""
    text = to_json(value)
    with whole(path) as part:
        part.write_text(text + "\n", encoding="utf-8")
