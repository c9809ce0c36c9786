"""Fit files: the law as in any other file, and the numbers of its fit in SI, with the points if there are not too many.

Parameters have the digits that the residuals justify, points and domain nine, other numbers of the fit six.

A law written by hand is such a file, too: ``law: {class: chou, braid_angle: 25 deg, initial_diameter: 10 mm}``.
"""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from mckibben.component.calls import user_level
from mckibben.component.schema import ComponentField
from mckibben.config.document import to_text
from mckibben.config.model import ConfigModel, DocumentModel, fail_validation
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.identification.estimator import standard_errors
from mckibben.identification.least_squares import design_matrix
from mckibben.identification.regression import Regression, RobustErrors
from mckibben.identification.smooth import Prior, prior_scales, restored_regression
from mckibben.identification.summary import DatasetSummary, LeaveOnePressureOut, Outlier
from mckibben.muscle import ForceLaw
from mckibben.muscle.muscle import CHECK_LAW
from mckibben.muscle.slopes import unphysical
from mckibben.result import Remark
from mckibben.storage.files import atomic_write
from mckibben.units import justified

_HEAD = "# A force law identified by mckibben. The numbers of its fit are in SI: N, Pa, and those of the parameters.\n"
_DIGITS = {"data": 9, "correlations": 17}
"""Digits of numbers below a key; others have six."""
_COLUMNS = ("pressure", "contraction", "force", "set_pressure", "set_force", "direction", "phase", "repeat")


class _FitPoints(ConfigModel):
    """Points of a fit, one value of each column per point, and the scales of its prior."""

    model_config = ConfigDict(strict=False, ser_json_inf_nan="strings")  # a pressure without a level is NaN

    slack_force: float
    pressure: list[float]
    contraction: list[float]
    force: list[float]
    set_pressure: list[float] | None = None
    set_force: list[float] | None = None
    direction: list[str] | None = None
    phase: list[str] | None = None
    repeat: list[int] | None = None
    prior_scales: list[float] | None = None

    @model_validator(mode="after")
    def _as_many_of_each(self) -> _FitPoints:
        for name, values in self.columns().items():
            if len(values) != len(self.force):
                fail_validation(f"{name} has {len(values)} values instead of {len(self.force)}", "give one per point")
        return self

    def columns(self) -> dict[str, list[object]]:
        """Columns that are known, by name."""
        return {name: getattr(self, name) for name in _COLUMNS if getattr(self, name) is not None}

    @classmethod
    def of(cls, regression: Regression | None, *, most: int = 5000) -> _FitPoints | None:
        """Points of a regression; None without it or with too many for a text file."""
        if regression is None or len(regression.points) > most:
            return None
        points, problem = regression.points, regression.problem
        columns = {name: points.table[name].to_numpy().tolist() for name in _COLUMNS if name in points.table}
        scales = None
        if problem.prior is not None:
            scales = prior_scales(Prior.of(points.levels), problem.prior).tolist()
        return cls(slack_force=float(points.table.attrs["slack_force"]), prior_scales=scales, **columns)


class _FitNumbers(ConfigModel):
    """Numbers of a fit, as attributes of `Fit`."""

    model_config = ConfigDict(strict=False, ser_json_inf_nan="strings")

    standard_errors: dict[str, float]
    robust: RobustErrors | None = None
    rmse: float
    max_error: float
    points_used: Annotated[int, Field(ge=0)]
    points_slack: Annotated[int, Field(ge=0)]
    leave_one_pressure_out: LeaveOnePressureOut | None = None
    correlations: list[list[float]] | None = None  # of a fit without points; near 1, all their digits count
    notes: list[Remark]
    dataset: DatasetSummary
    outliers: list[Outlier] = []  # noqa: RUF012
    data: _FitPoints | None = None


class _FitFile(DocumentModel):
    """A law, with the numbers of its fit unless it is written by hand."""

    kind: ClassVar[str] = "fit"
    examples: ClassVar[str] = "docs/files.md"
    model_config = ConfigDict(ser_json_inf_nan="strings")  # errors of parameters at a bound are NaN

    law: Annotated[Any, ComponentField(ForceLaw)]
    equation: str = ""
    fit: _FitNumbers | None = None

    @model_validator(mode="after")
    def _consistent(self) -> _FitFile:
        kind = type(self.law)
        try:
            kind.check_equation(self.equation or kind.equation)
        except RangeError as error:
            fail_validation(error.message, error.remedy, field="equation", value=self.equation)
        names = [p.name for p in kind.parameters()]
        known = self.fit and (self.fit.data or np.shape(self.fit.correlations or ()) == (len(names),) * 2)
        if self.fit and (list(self.fit.standard_errors) != names or not known):
            message = f"has no standard errors and correlations for the parameters {', '.join(names)}"
            fail_validation(message, "keep the order of the parameters", field="fit")
        return self


def write_fit(fit: Any, path: Path) -> None:
    """Write a `Fit`; the file appears complete or not at all."""
    points = _FitPoints.of(fit.regression)
    numbers = _FitNumbers(
        **{name: getattr(fit, name) for name in _FitNumbers.model_fields if name not in ("correlations", "data")},
        correlations=None if points else np.asarray(fit.correlations).tolist(),
        data=points,
    )
    kind = type(fit.law)
    file = _FitFile(law=fit.law, equation=kind.equation, fit=numbers)
    content = json.loads(file.model_dump_json(exclude_none=True, context={"folder": path.parent}))
    content["law"] = rounded_law(content["law"], fit.law, fit.rmse)
    content["law"].pop("equation", None)  # stands at the top
    content["fit"] = _shortened(content["fit"], 6)
    with atomic_write(path, overwrite=True) as sibling:
        sibling.write_text(_HEAD + to_text(content, width=200), encoding="utf-8")


def rounded_law(section: dict[str, str], law: ForceLaw, error: float) -> dict[str, str]:
    """Section of a law in a file with numbers that move its force in its domain by less than 1 % of an error [N].

    Correlated parameters need more digits than their own errors have.
    """
    names, domain = [p.name for p in type(law).parameters()], law.domain
    contractions = np.linspace(domain.contraction_min, domain.contraction_max, 9)
    grid = np.meshgrid(contractions, np.linspace(domain.pressure_min, domain.pressure_max, 9))
    slopes = np.abs(design_matrix(law, names, *map(np.ravel, grid))).max(axis=0)
    errors = 0.1 * max(error, 1e-12) / (len(names) * np.maximum(slopes, 1e-300))
    return section | {name: justified(section[name], at) for name, at in zip(names, errors.tolist(), strict=True)}


def _shortened(value: object, digits: int) -> object:
    """Plain data whose numbers have at most some digits, or those of their key."""
    if isinstance(value, dict):
        return {key: _shortened(item, _DIGITS.get(key, digits)) for key, item in value.items()}
    if isinstance(value, list):
        return [_shortened(item, digits) for item in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def read_law(path: str | os.PathLike[str]) -> ForceLaw:
    """Read the law of a file that `Fit.to_yaml` wrote, or of one written by hand.

    Raises a `ScenarioError` with every problem of the file and its line; a `McKibbenWarning` names a law whose force
    rises with contraction or falls with pressure.
    """
    law = _FitFile.read(path).law
    if wrong := unphysical(law):
        text = f"the law of {os.fspath(path)} is not that of a muscle: {wrong}; {CHECK_LAW}"
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())
    return law


def read_fields(path: Path) -> dict[str, Any] | None:
    """Fields of a `Fit` from a file; None for one of a law alone."""
    file = _FitFile.read(path)
    law, numbers = file.law, file.fit
    if numbers is None:
        return None
    regression, points = None, numbers.data
    if points is not None:
        columns: dict[str, Any] = {**points.columns(), "slack_force": points.slack_force}
        table = IsobaricDataset.of(specimen=numbers.dataset.specimen, source=numbers.dataset.source, **columns)
        at_bound = np.isnan(list(numbers.standard_errors.values()))
        scales = None if points.prior_scales is None else np.array(points.prior_scales)
        regression = restored_regression(law, table, at_bound, scales)
        residuals, jacobian = regression.solution.augmented
        correlations = standard_errors(jacobian, residuals, at_bound)[1]
    else:
        correlations = np.array(numbers.correlations)
    return {
        **{name: getattr(numbers, name) for name in _FitNumbers.model_fields if name != "data"},
        "law": law,
        "notes": tuple(numbers.notes),
        "outliers": tuple(numbers.outliers),
        "correlations": correlations,
        "residuals": regression.solution.residuals if regression else None,
        "regression": regression,
    }
