"""Fit results in the units of publications, as plain data."""

from __future__ import annotations

import dataclasses

from mckibben.identification.fit import Fit
from mckibben.units import factor


def fit_numbers(fit: Fit) -> dict[str, object]:
    """A fit as plain data."""
    held_out = fit.leave_one_pressure_out
    shown = {p.name: p.shown for p in type(fit.law).parameters()}
    published = {p.name: factor(p.shown, p.unit) for p in type(fit.law).parameters()}
    return {
        "law": type(fit.law).__name__,
        **({"decay_per_percent": fit.estimates["decay"] / published["decay"]} if "decay" in published else {}),
        "rmse_N": fit.rmse,
        "max_N": fit.max_error,
        "leave_one_pressure_out_rmse_N": held_out.rmse if held_out else None,
        "leave_one_pressure_out_max_N": held_out.max_error if held_out else None,
        "points_used": fit.points_used,
        "points_slack": fit.points_slack,
        "parameters": {
            name: {
                "estimate": value / published[name],
                "standard_error": fit.standard_errors[name] / published[name],
                "unit": shown[name],
            }
            for name, value in fit.estimates.items()
        },
        "outliers": [dataclasses.asdict(outlier) for outlier in fit.outliers],
        "warnings": list(fit.warnings),
    }
