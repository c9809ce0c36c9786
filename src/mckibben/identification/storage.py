"""Fits to files and back: YAML with a unit beside every number, in SI so that each number comes back exactly.

A file written by hand needs no more than the law, its parameters and its domain to be read by `read_law`; a
parameter may be a text there, such as ``a2: 109 N/bar``.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.errors import Problem, ScenarioError, UnitError
from mckibben.identification.fit import DatasetSummary, Fit, LeaveOnePressureOut
from mckibben.identification.intervals import RobustErrors
from mckibben.identification.uncertainty import Grouping
from mckibben.muscle import LAWS, Domain, ForceLaw, Parameter
from mckibben.storage.files import atomic_write
from mckibben.units import factor, quantity, show


def write_fit(fit: Fit, path: Path) -> None:
    """Write a fit; the file appears complete or not at all."""
    law = type(fit.law)
    lines = [
        "# A force law identified by mckibben. Numbers have their unit beside them, comments that of publications.",
        f"law: {law.__name__}",
        f"equation: {_text(law.equation)}",
        "parameters:",
    ]
    for p in law.parameters():
        estimate, error = fit.estimates[p.name], fit.standard_errors[p.name]
        numbers = f"estimate: {_number(estimate)}, standard_error: {_number(error)}"
        if robust := fit.robust:
            numbers += f", robust_error: {_number(robust.standard_errors[p.name])}"
            numbers += f", degrees_of_freedom: {_number(robust.degrees_of_freedom[p.name])}"
        lines.append(f"  {p.name}: {{{numbers}, unit: {_text(p.unit)}}}  # {show(estimate, p.shown)}: {p.meaning}")
    if robust := fit.robust:
        lines.append(f"robust: {{by: {robust.by.value}, groups: {robust.groups}}}  # whose points may share an error")
    domain = fit.law.domain
    lines += [
        "domain:",
        f"  contraction: {_span(domain.contraction_min, domain.contraction_max, '1')}",
        f"  pressure: {_span(domain.pressure_min, domain.pressure_max, 'Pa')}",
        f"residuals: {{rmse: {_number(fit.rmse)}, max: {_number(fit.max_error)}, unit: N}}",
        f"points: {{used: {fit.points_used}, slack: {fit.points_slack}}}",
    ]
    if lopo := fit.leave_one_pressure_out:
        lines += [
            "leave_one_pressure_out:",
            f"  rmse: {_number(lopo.rmse)}",
            f"  max: {_number(lopo.max_error)}",
            "  unit: N",
            f"  pressures: {_numbers(lopo.by_pressure)}",
            "  pressure_unit: Pa",
            f"  rmse_by_pressure: {_numbers(lopo.by_pressure.values())}",
        ]
    lines.append("correlations:  # in the order of the parameters")
    lines += [f"  - {_numbers(row)}" for row in fit.correlations]
    lines.append("warnings:" if fit.warnings else "warnings: []")
    lines += [f"  - {_text(warning)}" for warning in fit.warnings]
    lines += [
        "dataset:",
        f"  specimen: {_text(fit.dataset.specimen)}",
        f"  source: {_text(fit.dataset.source)}",
        f"  pressures: {_numbers(fit.dataset.pressures)}",
        "  pressure_unit: Pa",
    ]
    with atomic_write(path, overwrite=True) as sibling:
        sibling.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def read_law(path: str | os.PathLike[str]) -> ForceLaw:
    """Read the law of a file that `Fit.to_yaml` wrote, or of one written by hand with its first sections.

    Raises
    ------
    ScenarioError
        With every problem of the file and its line.
    """
    page = _Page(Path(path))
    law = page.law()
    page.finish()
    assert law is not None
    return law


def read_fit(path: Path) -> Fit:
    """Read a file that `write_fit` wrote.

    Raises
    ------
    ScenarioError
        With every problem of the file and its line.
    """
    page = _Page(path)
    law, top = page.law(), page.top
    parameters = type(law).parameters() if law else ()
    listed = page.section(top, "parameters")
    errors = {p.name: page.number(page.section(listed, p.name), "standard_error", p.unit, nan=True) for p in parameters}
    residuals = page.section(top, "residuals")
    points = page.section(top, "points")
    lopo = page.section(top, "leave_one_pressure_out") if "leave_one_pressure_out" in top else None
    unseen = None
    if lopo is not None:
        pressures = page.numbers(lopo, "pressures", "Pa", unit_key="pressure_unit")
        by_pressure = page.numbers(lopo, "rmse_by_pressure", "N", count=len(pressures))
        unseen = LeaveOnePressureOut(
            page.number(lopo, "rmse", "N"),
            page.number(lopo, "max", "N"),
            dict(zip(pressures, by_pressure, strict=False)),
        )
    robust = page.robust(parameters) if "robust" in top else None
    data = page.section(top, "dataset")
    fit_fields = {
        "standard_errors": errors,
        "correlations": page.square(top, "correlations", len(parameters)),
        "rmse": page.number(residuals, "rmse", "N"),
        "max_error": page.number(residuals, "max", "N"),
        "points_used": page.count(points, "used"),
        "points_slack": page.count(points, "slack"),
        "warnings": page.texts(top, "warnings"),
        "dataset": DatasetSummary(
            page.text(data, "specimen"),
            page.text(data, "source"),
            tuple(page.numbers(data, "pressures", "Pa", unit_key="pressure_unit")),
        ),
    }
    page.finish()
    assert law is not None
    return Fit(law=law, leave_one_pressure_out=unseen, robust=robust, **fit_fields)


class _Page:
    """A parsed file, and all that is found wrong with it."""

    def __init__(self, path: Path) -> None:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import MarkedYAMLError, YAMLError

        self.source = str(path)
        self.problems: list[Problem] = []
        try:
            top = YAML(typ="rt", pure=True).load(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ScenarioError(self.source, [Problem(f"cannot be read: {error.strerror or error}")]) from error
        except (UnicodeDecodeError, YAMLError) as error:
            mark = error.problem_mark if isinstance(error, MarkedYAMLError) else None
            reason = error.problem if isinstance(error, MarkedYAMLError) else str(error)
            line = mark.line + 1 if mark else None
            raise ScenarioError(self.source, [Problem(f"is not YAML: {reason}", line=line)]) from error
        if not isinstance(top, Mapping):
            raise ScenarioError(self.source, [Problem("holds no fit", remedy="write one with Fit.to_yaml")])
        self.top: Mapping[str, Any] = top

    def finish(self) -> None:
        if self.problems:
            unique = dict.fromkeys(self.problems)
            raise ScenarioError(self.source, sorted(unique, key=lambda p: p.line or 0))

    def law(self) -> ForceLaw | None:
        """The law of the file; None where something is wrong with it."""
        before = len(self.problems)
        name = self.text(self.top, "law")
        law_type = LAWS.get(name)
        if law_type is None:
            if len(self.problems) == before:
                self.wrong(self.top, "law", f"there is no law {name!r}", f"take one of {', '.join(sorted(LAWS))}")
            return None
        listed = self.section(self.top, "parameters")
        known = {p.name for p in law_type.parameters()}
        for key in listed:
            if key not in known:
                self.wrong(listed, key, f"{name} has no such parameter", f"it has {', '.join(sorted(known))}")
        values = {p.name: self.parameter(listed, p.name, p.unit) for p in law_type.parameters()}
        domain = self.section(self.top, "domain")
        contraction, pressure = self.section(domain, "contraction"), self.section(domain, "pressure")
        box = Domain(
            *(self.number(contraction, key, "1", infinite=True) for key in ("min", "max")),
            *(self.number(pressure, key, "Pa", infinite=True) for key in ("min", "max")),
        )
        return law_type(**values, domain=box) if len(self.problems) == before else None

    def robust(self, parameters: Sequence[Parameter]) -> RobustErrors | None:
        """Errors by groups of points; None where something is wrong with them."""
        before = len(self.problems)
        section, listed = self.section(self.top, "robust"), self.section(self.top, "parameters")
        by, known = self.text(section, "by"), [g.value for g in Grouping if g is not Grouping.POINT]
        if by not in known and len(self.problems) == before:
            self.wrong(section, "by", f"{by!r} is no group of points", f"take one of {', '.join(known)}")
        errors, freedom = {}, {}
        for p in parameters:
            row = self.section(listed, p.name)
            errors[p.name] = self.number(row, "robust_error", p.unit, nan=True)
            freedom[p.name] = self.entry(row, "degrees_of_freedom")
            if freedom[p.name] is not None and not _is_number(freedom[p.name]):
                self.wrong(row, "degrees_of_freedom", f"{freedom[p.name]!r} is no number")
        groups = self.count(section, "groups")
        return RobustErrors(Grouping(by), groups, errors, freedom) if len(self.problems) == before else None

    def wrong(self, section: Mapping[str, Any], key: str, message: str, remedy: str = "") -> None:
        marks = getattr(section, "lc", None)
        line = None
        if marks is not None:
            line = (marks.key(key)[0] if key in section else marks.line) + 1
        self.problems.append(Problem(message, line=line, field=str(key), remedy=remedy))

    def entry(self, section: Mapping[str, Any], key: str) -> Any:
        """What stands at a key; None, and a problem, where there is nothing (a missing section is one problem)."""
        if section is _MISSING:
            return None
        if section.get(key) is None:
            self.wrong(section, key, "is missing")
            return None
        return section[key]

    def section(self, section: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        value = self.entry(section, key)
        if value is None or isinstance(value, Mapping):
            return _MISSING if value is None else value
        self.wrong(section, key, f"{value!r} is no section", "write names and values below it")
        return _MISSING

    def text(self, section: Mapping[str, Any], key: str) -> str:
        value = self.entry(section, key)
        if value is not None and not isinstance(value, str):
            self.wrong(section, key, f"{value!r} is no text")
        return str(value)

    def texts(self, section: Mapping[str, Any], key: str) -> tuple[str, ...]:
        values = self.entry(section, key)
        if not _is_list(values) or not all(isinstance(value, str) for value in values):
            if values is not None:
                self.wrong(section, key, "is no list of texts")
            return ()
        return tuple(str(value) for value in values)

    def count(self, section: Mapping[str, Any], key: str) -> int:
        value = self.entry(section, key)
        if value is not None and (not isinstance(value, int) or isinstance(value, bool) or value < 0):
            self.wrong(section, key, f"{value!r} is no count")
            return 0
        return int(value or 0)

    def parameter(self, section: Mapping[str, Any], key: str, unit: str) -> float:
        """An estimate: a section with its unit, or a text such as "109 N/bar"."""
        value = self.entry(section, key)
        if isinstance(value, str):
            try:
                return quantity(value, unit)
            except UnitError as error:
                self.wrong(section, key, str(error))
                return math.nan
        return self.number(self.section(section, key), "estimate", unit)

    def number(
        self, section: Mapping[str, Any], key: str, unit: str, *, infinite: bool = False, nan: bool = False
    ) -> float:
        """A number in the unit that stands beside it, as SI."""
        value = self.entry(section, key)
        if value is None:
            return math.nan
        if not _is_number(value):
            self.wrong(section, key, f"{value!r} is no number")
        elif not (math.isfinite(value) or (infinite and math.isinf(value)) or (nan and math.isnan(value))):
            self.wrong(section, key, f"{value!r} is not finite")
        else:
            return float(value) * self.scale(section, "unit", unit)
        return math.nan

    def numbers(
        self,
        section: Mapping[str, Any],
        key: str,
        unit: str,
        *,
        unit_key: str = "unit",
        count: int | None = None,
    ) -> list[float]:
        values = self.entry(section, key)
        if values is None:
            return []
        if not _is_list(values) or not all(_is_number(value) and math.isfinite(value) for value in values):
            self.wrong(section, key, "is no list of numbers")
            return []
        if count is not None and len(values) != count:
            self.wrong(section, key, f"has {len(values)} numbers instead of {count}")
        scale = self.scale(section, unit_key, unit)
        return [float(value) * scale for value in values]

    def square(self, section: Mapping[str, Any], key: str, size: int) -> np.ndarray:
        rows = self.entry(section, key)
        if rows is None or not size:
            return np.empty((0, 0))
        good = _is_list(rows) and all(_is_list(row) and all(map(_is_number, row)) for row in rows)
        if not good or len(rows) != size or any(len(row) != size for row in rows):
            self.wrong(section, key, f"is no table of {size} rows of {size} numbers")
            return np.empty((0, 0))
        return np.array([[float(value) for value in row] for row in rows])

    def scale(self, section: Mapping[str, Any], key: str, unit: str) -> float:
        name = self.entry(section, key)
        if name is None:
            return math.nan
        try:
            return factor(str(name), unit)
        except UnitError as error:
            self.wrong(section, key, str(error))
            return math.nan


_MISSING: Mapping[str, Any] = {}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _number(value: Any) -> str:
    number = float(value)
    if math.isnan(number):
        return ".nan"
    if math.isinf(number):
        return ".inf" if number > 0 else "-.inf"
    return repr(number)


def _numbers(values: Any) -> str:
    return f"[{', '.join(_number(value) for value in values)}]"


def _span(low: Any, high: Any, unit: str) -> str:
    return f"{{min: {_number(low)}, max: {_number(high)}, unit: {_text(unit)}}}"


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
