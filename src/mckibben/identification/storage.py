"""Fit files: YAML with a unit next to every number, in SI so that each number is read back exactly.

`read_law` reads a file written by hand as well: the law, its parameters and its domain suffice, and a parameter may be
a text such as ``a2: 109 N/bar``.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, ValidationError, create_model, field_validator, model_validator

from mckibben.component.classes import find_class, full_name
from mckibben.component.extensions import is_foreign, load_installed, package_version
from mckibben.component.schema import declared_fields
from mckibben.config.document import read_document, to_text
from mckibben.config.fields import Number, OneOf
from mckibben.config.model import ConfigModel, fail_validation, problems_of, read_text
from mckibben.dataset import IsobaricDataset
from mckibben.errors import Problem, RangeError, ScenarioError, quoted, suggest
from mckibben.identification.fit import DatasetSummary, Fit, LeaveOnePressureOut, Outlier
from mckibben.identification.fitting import restored_regression
from mckibben.identification.intervals import RobustErrors
from mckibben.identification.regression import Regression
from mckibben.identification.smooth import prior_of, prior_scales
from mckibben.identification.uncertainty import Grouping
from mckibben.muscle import LAWS, Domain, ForceLaw
from mckibben.storage.files import atomic_write, sealed
from mckibben.units import BoundedInt, factor, quantity, show

_UNITS = {"pressure_unit": "Pa", "force_unit": "N", "contraction_unit": "1"}
_COLUMNS = ("pressure", "contraction", "force", "set_pressure", "direction", "phase", "repeat")
_HEAD = "# A force law identified by mckibben. Each number is followed by its unit; comments give published units.\n"


def write_fit(fit: Fit, path: Path) -> None:
    """Write a fit; the file appears complete or not at all."""
    law, domain, robust, lopo = type(fit.law), fit.law.domain, fit.robust, fit.leave_one_pressure_out
    parameters: dict[str, Any] = {}
    comments: dict[tuple[str | int, ...], str] = {
        ("correlations",): "in the order of the parameters",
        ("outliers",): "left out; in Pa, 1 and N",
    }
    for p in law.parameters():
        row: dict[str, Any] = {
            "estimate": float(fit.estimates[p.name]),
            "standard_error": float(fit.standard_errors[p.name]),
        }
        if robust:
            row["robust_error"] = float(robust.standard_errors[p.name])
            row["degrees_of_freedom"] = float(robust.degrees_of_freedom[p.name])
        parameters[p.name] = {**row, "unit": p.unit}
        comments["parameters", p.name] = f"{show(fit.estimates[p.name], p.shown)}: {p.meaning}"
    for p in law.constants:
        value = float(getattr(fit.law, p.name))
        parameters[p.name] = {"estimate": value, "unit": p.unit}
        comments["parameters", p.name] = f"{show(value, p.shown)}: {p.meaning}, not estimated"
    data = {
        "law": full_name(law) if is_foreign(law.__module__) else law.__name__,
        "version": package_version(law.__module__),
        "equation": law.equation,
        "parameters": parameters,
        "robust": {"by": robust.by.value, "groups": int(robust.groups)} if robust else None,
        "domain": {
            "contraction": _span(domain.contraction_min, domain.contraction_max, "1"),
            "pressure": _span(domain.pressure_min, domain.pressure_max, "Pa"),
        },
        "residuals": {"rmse": float(fit.rmse), "max": float(fit.max_error), "unit": "N"},
        "points": {"used": int(fit.points_used), "slack": int(fit.points_slack)},
        "leave_one_pressure_out": {
            "rmse": float(lopo.rmse),
            "max": float(lopo.max_error),
            "unit": "N",
            "pressures": _floats(lopo.by_pressure),
            "pressure_unit": "Pa",
            "rmse_by_pressure": _floats(lopo.by_pressure.values()),
        }
        if lopo
        else None,
        "correlations": [_floats(row) for row in fit.correlations],
        "outliers": [dataclasses.asdict(one) for one in fit.outliers],
        **_data(fit.regression),
        "warnings": list(fit.warnings),
        "dataset": {
            "specimen": fit.dataset.specimen,
            "source": fit.dataset.source,
            "pressures": _floats(fit.dataset.pressures),
            "pressure_unit": "Pa",
        },
    }
    text = _HEAD + to_text(data, comments, width=200)
    with atomic_write(path, overwrite=True) as sibling:
        sibling.write_bytes(sealed(text.encode()))


_MOST_POINTS = 5000


def _data(regression: Regression | None) -> dict[str, Any]:
    """Points of a fit, from which its intervals follow; none if there are too many for a text file."""
    if regression is None or len(regression.points) > _MOST_POINTS:
        return {}
    points, problem = regression.points, regression.problem
    table = points.table
    columns = {name: table[name].to_numpy().tolist() for name in _COLUMNS if name in table}
    data: dict[str, Any] = {**_UNITS, "slack_force": float(table.attrs["slack_force"]), **columns}
    if problem.prior is not None:
        prior = prior_of(problem.law_type, points.levels)
        data["prior_scales"] = _floats(prior_scales(prior, problem.prior))
    return {"data": data}


def read_law(path: str | os.PathLike[str]) -> ForceLaw:
    """Read the law of a file that `Fit.to_yaml` wrote, or of one written by hand with its first sections.

    Raises a `ScenarioError` with every problem of the file and its line.
    """
    return _read(path, complete=False).force_law()


def read_fit(path: Path) -> Fit:
    """Read a file that `write_fit` wrote; raises a `ScenarioError` with every problem and its line."""
    return _read(path, complete=True).fit()


def find_fit(path: Path) -> Fit | None:
    """Read a file as `read_fit`, or return None for one of a law alone, without correlations."""
    read = _read(path, complete=None)
    return read.fit() if isinstance(read, _FitFile) else None


def law_types(*, installed: bool = False) -> dict[str, type[ForceLaw]]:
    """Force laws by name: those of mckibben, and imported ones, also those of installed packages where asked."""
    if installed:
        load_installed()
    return dict(LAWS)


def _find_law(name: Any, line: int | None) -> tuple[type[ForceLaw] | None, list[Problem]]:
    """The law of a name in a file, or the problems with it."""
    try:
        found = find_class(ForceLaw, name) if isinstance(name, str) else None
    except RangeError as error:
        return None, [Problem.of(error, line, "law")]
    if found is not None and found.parameters():
        return found, []
    remedy = (
        f"{suggest(str(name), sorted(law_types()))}; for a user-defined law, load its module first: "
        "`mckibben --extension FILE.py ...`, or a module"
    )
    return None, [Problem(f"there is no law {quoted(name)}", line, "law", remedy, value=name), *load_installed()]


def _of_kind(unit: str, expected: str) -> str:
    """The unit, if it is of the expected kind."""
    factor(unit, expected)
    return unit


_PressureUnit = Annotated[str, AfterValidator(lambda unit: _of_kind(unit, "Pa"))]


class _Section(ConfigModel):
    """Numbers in the unit that is given with them; other keys are ignored."""

    model_config = ConfigDict(extra="ignore")
    expected: ClassVar[str] = "N"

    unit: str

    @field_validator("unit", mode="after")
    @classmethod
    def _of_that_kind(cls, value: str) -> str:
        return _of_kind(value, cls.expected)

    def si(self, name: str) -> float:
        """One of the numbers in SI."""
        return getattr(self, name) * factor(self.unit, self.expected)


class _Estimate(_Section):
    """A parameter, which may be a text such as "109 N/bar"."""

    estimate: Annotated[float, Number()]

    @model_validator(mode="before")
    @classmethod
    def _from_text(cls, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        return {"estimate": quantity(value, cls.expected), "unit": cls.expected}


class _FittedEstimate(_Estimate):
    standard_error: Annotated[float, Number(nan=True)]


class _RobustEstimate(_FittedEstimate):
    robust_error: Annotated[float, Number(nan=True)]
    degrees_of_freedom: Annotated[float, Number(nan=True, infinite=True)]


class _Span(_Section):
    min: Annotated[float, Number(infinite=True)]
    max: Annotated[float, Number(infinite=True)]


class _Ratios(_Span):
    expected: ClassVar = "1"


class _Pressures(_Span):
    expected: ClassVar = "Pa"


class _Domain(ConfigModel):
    contraction: _Ratios
    pressure: _Pressures


class _Residuals(_Section):
    rmse: Annotated[float, Number()]
    max: Annotated[float, Number()]


class _LeftOut(_Residuals):
    pressure_unit: _PressureUnit
    pressures: tuple[Annotated[float, Number()], ...]
    rmse_by_pressure: tuple[Annotated[float, Number()], ...]

    @field_validator("rmse_by_pressure", mode="after")
    @classmethod
    def _as_many(cls, value: Any, info: Any) -> Any:
        count = len(info.data.get("pressures", value))
        if len(value) != count:
            fail_validation(f"has {len(value)} numbers instead of {count}", "give one for each pressure")
        return value


class _Points(ConfigModel):
    used: Annotated[int, BoundedInt(0, 10**12)]
    slack: Annotated[int, BoundedInt(0, 10**12)]


class _Robust(ConfigModel):
    by: Annotated[str, OneOf(tuple(g.value for g in Grouping if g is not Grouping.POINT))]
    groups: Annotated[int, BoundedInt(0, 10**12)]


class _Dataset(ConfigModel):
    specimen: str
    source: str
    pressures: tuple[Annotated[float, Number()], ...]
    pressure_unit: _PressureUnit


class _Outlier(ConfigModel):
    row: Annotated[int, BoundedInt(1, 10**12)]
    pressure: Annotated[float, Number()]
    contraction: Annotated[float, Number()]
    force: Annotated[float, Number()]
    expected: Annotated[float, Number()]
    place: str = ""


class _Data(ConfigModel):
    """Points of a fit, one number of each column per point."""

    pressure_unit: _PressureUnit
    force_unit: Annotated[str, AfterValidator(lambda unit: _of_kind(unit, "N"))]
    contraction_unit: Annotated[str, AfterValidator(lambda unit: _of_kind(unit, "1"))]
    slack_force: Annotated[float, Number()] = 0.0
    pressure: tuple[Annotated[float, Number()], ...]
    contraction: tuple[Annotated[float, Number()], ...]
    force: tuple[Annotated[float, Number()], ...]
    set_pressure: tuple[Annotated[float, Number(nan=True)], ...] | None = None
    direction: tuple[str, ...] | None = None
    phase: tuple[str, ...] | None = None
    repeat: tuple[Annotated[int, BoundedInt(0, 2**53)], ...] | None = None
    prior_scales: tuple[Annotated[float, Number()], ...] | None = None

    @model_validator(mode="after")
    def _as_many_of_each(self) -> Any:
        count = len(self.force)
        for name in _COLUMNS:
            column = getattr(self, name)
            if column is not None and len(column) != count:
                fail_validation(f"{name} has {len(column)} numbers instead of {count}", "give one for each point")
        return self

    def points(self, specimen: str, source: str) -> IsobaricDataset:
        columns = {name: getattr(self, name) for name in _COLUMNS if getattr(self, name) is not None}
        for name, values in columns.items():
            kind = "pressure" if name == "set_pressure" else name
            if f"{kind}_unit" in _UNITS:
                columns[name] = np.array(values) * factor(getattr(self, f"{kind}_unit"), _UNITS[f"{kind}_unit"])
        slack = self.slack_force * factor(self.force_unit, "N")
        return IsobaricDataset.of(**columns, specimen=specimen, source=source, slack_force=slack)


class _LawFile(ConfigModel):
    """Law, parameters and domain; other keys are ignored."""

    model_config = ConfigDict(extra="ignore")

    law_type: ClassVar[type[ForceLaw]]

    law: str
    parameters: Any
    domain: _Domain

    def force_law(self) -> ForceLaw:
        values: dict[str, Any] = {name: row.si("estimate") for name, row in self.parameters}
        if self.domain is not None:
            contraction, pressure = self.domain.contraction, self.domain.pressure
            limits = (contraction.si("min"), contraction.si("max"), pressure.si("min"), pressure.si("max"))
            values["domain"] = Domain(*limits)
        return self.law_type(**values)


class _FitFile(_LawFile):
    robust: _Robust | None = None
    residuals: _Residuals
    points: _Points
    leave_one_pressure_out: _LeftOut | None = None
    correlations: tuple[tuple[Annotated[float, Number(nan=True)], ...], ...]
    warnings: tuple[str, ...]
    dataset: _Dataset
    outliers: tuple[_Outlier, ...] = ()
    data: _Data | None = None

    @field_validator("correlations", mode="after")
    @classmethod
    def _square(cls, value: Any) -> Any:
        size = len(cls.law_type.parameters()) if hasattr(cls, "law_type") else len(value)
        if len(value) != size or any(len(row) != size for row in value):
            fail_validation(f"is not a table of {size} rows of {size} numbers", "keep the order of the parameters")
        return value

    def fit(self) -> Fit:
        law, lopo, robust, data = self.force_law(), self.leave_one_pressure_out, self.robust, self.dataset
        rows = {p.name: getattr(self.parameters, p.name) for p in type(law).parameters()}
        unseen = errors = None
        if lopo:
            scale, unit = factor(lopo.pressure_unit), factor(lopo.unit)
            pressures = (pressure * scale for pressure in lopo.pressures)
            by_pressure = (error * unit for error in lopo.rmse_by_pressure)
            unseen = LeaveOnePressureOut(
                lopo.si("rmse"), lopo.si("max"), dict(zip(pressures, by_pressure, strict=True))
            )
        if robust:
            errors = RobustErrors(
                Grouping(robust.by),
                robust.groups,
                {name: row.si("robust_error") for name, row in rows.items()},
                {name: row.degrees_of_freedom for name, row in rows.items()},
            )
        pressures = tuple(pressure * factor(data.pressure_unit) for pressure in data.pressures)
        regression = None
        if self.data is not None:
            points = self.data.points(data.specimen, data.source)
            at_bound = np.isnan([row.si("standard_error") for row in rows.values()])
            scales = None if self.data.prior_scales is None else np.array(self.data.prior_scales)
            regression = restored_regression(law, points, at_bound, scales)
        return Fit(
            law=law,
            standard_errors={name: row.si("standard_error") for name, row in rows.items()},
            correlations=np.array(self.correlations) if self.correlations else np.empty((0, 0)),
            rmse=self.residuals.si("rmse"),
            max_error=self.residuals.si("max"),
            points_used=self.points.used,
            points_slack=self.points.slack,
            leave_one_pressure_out=unseen,
            warnings=self.warnings,
            dataset=DatasetSummary(data.specimen, data.source, pressures),
            residuals=regression.solution.residuals if regression else None,
            robust=errors,
            regression=regression,
            outliers=tuple(Outlier(**dict(one)) for one in self.outliers),
        )


def _read(path: str | os.PathLike[str], *, complete: bool | None) -> Any:
    """The checked content of a file: a `_FitFile`, or a `_LawFile` if it need not be complete; None: as it is."""
    source = os.fspath(path)
    text = read_text(path, "a fit", "docs/files.md")
    document = read_document(text)
    if not document.readable:
        raise ScenarioError(source, document.problems)
    data = document.data if isinstance(document.data, dict) else {}
    complete = "correlations" in data if complete is None else complete
    law_type = None
    if "law" in data:
        law_type, problems = _find_law(data["law"], document.line(("law",)))
        if law_type is not None:
            try:
                law_type.check_equation(data.get("equation", law_type.equation), data.get("version"))
            except RangeError as error:
                problems = [Problem.of(error, document.line(("equation",)), "equation")]
        if problems:
            raise ScenarioError(source, [*document.problems, *problems])
    base, row = (_FitFile, _FittedEstimate) if complete else (_LawFile, _Estimate)
    if complete and "robust" in data:
        row = _RobustEstimate
    model: type[ConfigModel] = base
    if law_type is not None:
        rows: dict[str, Any] = {
            p.name: (type(kind.__name__, (kind,), {"expected": p.unit, "__module__": __name__}), ...)
            for parameters, kind in ((law_type.parameters(), row), (law_type.constants, _Estimate))
            for p in parameters
        }
        parameters = create_model("Parameters", __base__=ConfigModel, **rows)
        fields: dict[str, Any] = {"parameters": (parameters, Field())}
        if not complete and declared_fields(law_type)["domain"].default is not dataclasses.MISSING:
            fields["domain"] = (_Domain | None, None)
        model = create_model("FitFile", __base__=base, **fields)
        model.law_type = law_type
    try:
        read = model.model_validate(document.data)
    except ValidationError as error:
        raise ScenarioError(source, problems_of(error, document, model)) from None
    if document.problems:
        raise ScenarioError(source, document.problems)
    return read


def _floats(values: Any) -> list[float]:
    return [float(value) for value in values]


def _span(low: Any, high: Any, unit: str) -> dict[str, Any]:
    return {"min": float(low), "max": float(high), "unit": unit}
