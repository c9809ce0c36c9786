"""References in a scenario file, and sampled references from CSV files."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field, ValidationInfo, field_validator, model_serializer, model_validator

from mckibben.component.schema import ComponentModel, PartOf, model_of, named_model
from mckibben.config.fields import TablePath
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation
from mckibben.control import Constant, Multisine, Ramp, RandomSteps, Samples, Signal, Sine, Step
from mckibben.errors import Problem, ScenarioError, UnitError
from mckibben.units import NUMBER, Angle, Instant, Phase, Stiffness, factor

_LARGEST = 64 * 2**20


def read_samples(path: Path, name: str, unit: str) -> tuple[list[float], list[float]]:
    """The times [s] and the values, in `unit`, of the column of a CSV file that is titled NAME_UNIT."""
    times, values = read_columns(path, lambda _: {name: unit})
    return times, values[name]


def read_columns(
    path: Path, wanted: Callable[[list[str]], Mapping[str, str]]
) -> tuple[list[float], dict[str, list[float]]]:
    """The times [s] and the values, by name, of columns titled NAME_UNIT: names and units wanted of a header."""
    try:
        if path.stat().st_size > _LARGEST:
            raise ScenarioError(str(path), [Problem(f"is larger than {_LARGEST // 2**20} MiB")])
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy="give a CSV file")]) from None
    problems: list[Problem] = []
    header = [title.strip() for title in rows[0]] if rows else []
    units = wanted(header)
    columns = [_column(header, name, unit, problems) for name, unit in (("time", "s"), *units.items())]
    if problems:
        raise ScenarioError(str(path), problems)

    samples: list[list[float]] = []
    for line, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        sample = [_number(row, place, scale) for place, scale in columns]
        if not all(map(math.isfinite, sample)):
            problems.append(Problem(f"{','.join(row)[:60]!r} does not hold {len(sample)} finite numbers", line))
        elif samples and sample[0] <= samples[-1][0]:
            problems.append(Problem(f"the time {sample[0]:g} s does not rise", line, remedy="sort the rows"))
        else:
            samples.append(sample)
    if not samples and not problems:
        problems.append(Problem("holds no samples"))
    if problems:
        raise ScenarioError(str(path), problems)
    times, *values = (list(column) for column in zip(*samples, strict=True))
    return times, dict(zip(units, values, strict=True))


def _column(header: list[str], name: str, unit: str, problems: list[Problem]) -> tuple[int, float]:
    """Index and scale of the column of a quantity."""
    found = [i for i, title in enumerate(header) if title.startswith(f"{name}_")]
    if len(found) != 1:
        what = "has several columns" if found else "has no column"
        problems.append(Problem(f"{what} {name}_...", 1, remedy=f"title one column {name}_{unit}"))
        return 0, 1.0
    try:
        return found[0], factor(header[found[0]][len(name) + 1 : len(name) + 41], unit)
    except UnitError as error:
        problems.append(Problem.of(error, 1, header[found[0]]))
        return 0, 1.0


def _number(row: list[str], place: int, scale: float) -> float:
    text = row[place].strip() if place < len(row) else ""
    return float(text) * scale if NUMBER.fullmatch(text) else math.nan  # not 1_0, nor digits of other scripts


MOST_SAMPLES = 2000
"""In the text itself; more belong in a table of their own."""


class _MultisineModel(ComponentModel):
    @field_validator("phases", mode="after", check_fields=False)
    @classmethod
    def _one_each(cls, value: Any, info: ValidationInfo) -> Any:
        lists = {**info.data, "phases": value}
        counts = {key: len(items) for key, items in lists.items() if isinstance(items, tuple)}
        if len(set(counts.values())) > 1:
            listed = ", ".join(f"{count} {key}" for key, count in counts.items())
            fail_validation(f"has {listed}", "give one of each for every sine", parent=True)
        return value


class SamplesSpec(ConfigModel):
    """Straight lines between samples: in the text, or in a CSV file.

    The file has a header of names and units, such as ``time_s,angle_deg,stiffness_N*m/rad``; the angle's signal takes
    the column that begins with ``angle_``, the stiffness's the one with ``stiffness_``.
    """

    times: tuple[Instant, ...] | None = Field(None, max_length=MOST_SAMPLES)
    values: tuple[Any, ...] | None = Field(None, max_length=MOST_SAMPLES)
    file: TablePath | None = Field(None, validate_default=True)

    @field_validator("times", mode="after")
    @classmethod
    def _rising(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        times = value or ()
        for before, after in itertools.pairwise(times):
            if not after > before:
                fail_validation(f"do not rise: {after:g} s follows {before:g} s", "sort them and remove repeats")
        return value

    @field_validator("file", mode="after")
    @classmethod
    def _one_source(cls, value: Any, info: ValidationInfo) -> Any:
        times, values = info.data.get("times", "wrong"), info.data.get("values", "wrong")
        if "wrong" in (times, values):
            return value
        if value is not None and (times is not None or values is not None):
            fail_validation("is given beside times or values", "keep the file, or the lists")
        if value is not None:
            return value
        if times is None or values is None:
            fail_validation("lacks its samples", "give `times` and `values`, or a `file`", parent=True)
        if len(times) != len(values) or not times:
            fail_validation(f"has {len(times)} times and {len(values)} values", "give one value a time", parent=True)
        return value


class _RandomStepsModel(ComponentModel):
    @field_validator("longest_dwell", mode="after", check_fields=False)
    @classmethod
    def _not_below(cls, value: Any, info: ValidationInfo) -> Any:
        dwell = info.data.get("dwell")
        if value is not None and dwell is not None and value < dwell:
            fail_validation(f"{value:g} s is below the dwell of {dwell:g} s", "exchange them")
        return value


class SignalSpec(ConfigModel):
    """One signal by its kind, such as `step`, or `samples`; in text a quantity alone is a constant."""

    name: ClassVar[str]
    unit: ClassVar[str]

    constant: Any = None
    step: Any = None
    ramp: Any = None
    random_steps: Any = None
    sine: Any = None
    multisine: Any = None
    samples: Any = None

    @model_validator(mode="before")
    @classmethod
    def _quantity_alone(cls, value: Any) -> Any:
        return {"constant": value} if isinstance(value, str | float | int) and value != "" else value

    @field_validator("samples", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        forms = tuple(SignalSpec.model_fields)
        given = {**{key: info.data.get(key, "wrong") for key in forms[:-1]}, "samples": value}
        chosen = [key for key in forms if given[key] is not None]
        if len(chosen) != 1:
            what = f"is {' and '.join(chosen)} at once" if chosen else "has no signal"
            fail_validation(what, f"give one of {', '.join(forms)}", parent=True)
        if value is not None and value.file is not None:
            try:
                read_samples(value.file, cls.name, cls.unit)
            except ScenarioError as error:
                first, *others = (str(problem) for problem in error.problems)
                more = f" (and {len(others)} more)" if others else ""
                fail_validation(f"{value.file.name}: {first}{more}", parent=True)
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        written = handler(self)
        return written.get("constant") or written

    def build(self) -> Signal:
        """The signal."""
        if self.constant is not None:
            return Constant(self.constant)
        if self.samples is not None and self.samples.file is not None:
            return Samples(*read_samples(self.samples.file, self.name, self.unit))
        if self.samples is not None:
            return Samples(**explicit_fields(self.samples))
        return (self.step or self.ramp or self.random_steps or self.sine or self.multisine).build()


def _signal(name: str, quantity: Any, unit: str) -> Any:
    """The model of a signal of a quantity."""
    prefix = name.title()
    forms = {
        "constant": quantity,
        "step": model_of(Step, signal=quantity, model_name=f"{prefix}StepSpec"),
        "ramp": model_of(Ramp, signal=quantity, model_name=f"{prefix}RampSpec"),
        "random_steps": model_of(
            RandomSteps, signal=quantity, base=_RandomStepsModel, model_name=f"{prefix}RandomStepsSpec"
        ),
        "sine": model_of(Sine, signal=quantity, model_name=f"{prefix}SineSpec"),
        "multisine": model_of(
            Multisine,
            signal=quantity,
            base=_MultisineModel,
            model_name=f"{prefix}MultisineSpec",
            amplitudes=(Annotated[tuple[quantity, ...], Field(min_length=1)], ...),
            phases=(tuple[Phase, ...] | None, Field(None, validate_default=True)),
        ),
    }
    made: dict[str, Any] = {key: (form | None, None) for key, form in forms.items()}
    values = {"values": (tuple[quantity, ...] | None, Field(None, max_length=MOST_SAMPLES))}
    samples = named_model(f"{prefix}SamplesSpec", SamplesSpec, values)
    made["samples"] = samples | None, Field(None, validate_default=True)
    model = named_model(f"{prefix}SignalForms", SignalSpec, made)
    model.name, model.unit = name, unit
    return model


class AngleSignalSpec(_signal("angle", Angle, "rad")):
    """Signal of an angle [rad]."""


class StiffnessSignalSpec(_signal("stiffness", Stiffness, "N*m/rad")):
    """Signal of a stiffness [N*m/rad]."""


class ReferenceSpec(ConfigModel):
    """Reference of the angle [rad] and of the stiffness [N*m/rad]."""

    angle: Annotated[AngleSignalSpec, PartOf("mckibben.control:Signal", signal=Angle)]
    stiffness: Annotated[StiffnessSignalSpec, PartOf("mckibben.control:Signal", signal=Stiffness)]
