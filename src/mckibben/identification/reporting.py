"""Fit results in the units of publications, as plain data and as text."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mckibben.identification.fit import Fit
from mckibben.identification.hysteresis import HysteresisFit
from mckibben.identification.intervals import Interval, check_level
from mckibben.identification.profile import Profile, profile
from mckibben.units import factor


def fit_numbers(fit: Fit) -> dict[str, Any]:
    """A fit as plain data."""
    held_out = fit.leave_one_pressure_out
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
                "unit": _unit(fit, name),
            }
            for name, value in fit.estimates.items()
        },
        "outliers": [dataclasses.asdict(one) for one in fit.outliers],
        "warnings": list(fit.warnings),
    }


_FRICTION = {
    "half_width": ("_N", "N"),
    "growth": ("_N_per_bar", "N/bar"),
    "tension_growth": ("", "1"),
    "viscous": ("_N_s_per_m", "N*s/m"),
    "viscous_growth": ("_N_s_per_m_bar", "N*s/m/bar"),
    "viscous_length_growth": ("_N_s_per_m2", "N*s/m^2"),
    "rate_growth": ("", "1"),
    "rate_speed": ("_mm_per_s", "mm/s"),
    "presliding_length": ("_mm", "mm"),
}


def hysteresis_numbers(found: HysteresisFit) -> dict[str, Any]:
    """Friction and drift as plain data."""
    friction, numbers = found.friction, {}
    for name, (ending, unit) in _FRICTION.items():
        value, error = getattr(friction, name) or 0.0, found.standard_errors[name]
        numbers |= {f"{name}{ending}": value / factor(unit), f"{name}_standard_error{ending}": error / factor(unit)}
    return {
        "form": found.form.value,
        "held_out_rmse_N": {form.value: rmse for form, rmse in found.comparison.rmse.items()}
        if found.comparison
        else {},
        "rejected_for": found.lack_of_fit.quantity if found.lack_of_fit else None,
        **numbers,
        "reference_pressure_bar": friction.reference_pressure / factor("bar"),
        "reference_tension_N": friction.reference_tension,
        "reference_length_mm": (friction.reference_length or 0.0) / factor("mm"),
        "drift_N_per_hour": found.drift.rate * 3600 if found.drift else 0.0,
        "drift_standard_error_N_per_hour": found.drift.rate_error * 3600 if found.drift else None,
        "rmse_N": found.rmse,
        "max_N": found.max_error,
        "warnings": list(found.warnings),
    }


@dataclass(frozen=True)
class UncertaintyReport:
    """Profile likelihoods of a fit."""

    fit: Fit
    level: float
    profiles: tuple[Profile, ...]

    @classmethod
    def of(cls, fit: Fit, *, level: float = 0.95, profiles: bool = False) -> UncertaintyReport:
        """Compute profiles."""
        check_level(level)
        shape = type(fit.law).shape_parameters if profiles else ()
        found = tuple(profile(fit, p.name, level=level) for p in shape)
        return cls(fit, level, found)

    def describe(self) -> str:
        """The report as text; empty without profiles."""
        share = f"{100 * self.level:g} %"
        lines: list[str] = []
        for one in self.profiles:
            low, high = (_end(end) for end in _interval(self.fit, one.name, one.interval))
            lines.append(f"profile of {one.name}: {share} interval {low} .. {high} {_unit(self.fit, one.name)}")
            lines += [f"warning: {reason}" for reason in one.reasons]
        return "\n".join(lines)

    def records(self) -> dict[str, Any]:
        """The report as plain data, with the intervals of the fit itself."""
        fit, robust = self.fit, self.fit.robust
        numbers: dict[str, Any] = {
            "level": self.level,
            "errors_by": robust.by.value if robust else "point",
            "groups": robust.groups if robust else fit.points_used,
            "intervals": _intervals(fit, fit.intervals(self.level)),
        }
        if robust:
            numbers["robust_standard_errors"] = _scaled(fit, robust.standard_errors)
            numbers["degrees_of_freedom"] = dict(robust.degrees_of_freedom)
        if self.profiles:
            numbers["profiles"] = {
                one.name: {
                    "interval": list(_interval(fit, one.name, one.interval)),
                    "identified": one.identified,
                    "reasons": list(one.reasons),
                }
                for one in self.profiles
            }
        return numbers


def _unit(fit: Fit, name: str) -> str:
    return next(p.shown for p in type(fit.law).parameters() if p.name == name)


def _scaled(fit: Fit, values: Mapping[str, float]) -> dict[str, float]:
    return {name: value / factor(_unit(fit, name)) for name, value in values.items()}


def _interval(fit: Fit, name: str, interval: Interval) -> tuple[float, float]:
    scale = factor(_unit(fit, name))
    return interval.lower / scale, interval.upper / scale


def _intervals(fit: Fit, intervals: Mapping[str, Interval]) -> dict[str, list[float]]:
    return {name: list(_interval(fit, name, interval)) for name, interval in intervals.items()}


def _end(value: float) -> str:
    return "not bounded" if math.isinf(value) else f"{value:.5g}"
