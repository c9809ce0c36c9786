"""What a scenario wants over time: one signal for the angle, one for the stiffness."""

from __future__ import annotations

import itertools
from typing import Any, Generic, TypeVar

from pydantic import Field, ValidationInfo, field_validator, model_serializer, model_validator

from mckibben.errors import ScenarioError
from mckibben.study.scenario.fields import Angle, Frequency, Instant, Phase, Stiffness, TablePath
from mckibben.study.scenario.part import Part, refuse
from mckibben.study.scenario.samples import read_samples

Q = TypeVar("Q")
MOST_SAMPLES = 2000
"""In the text itself; more belong in a table of their own."""


class StepSpec(Part, Generic[Q]):
    """One value before a time [s], another from then on."""

    before: Q
    after: Q
    at: Instant


class SineSpec(Part, Generic[Q]):
    """offset + amplitude sin(2 pi frequency t + phase)."""

    amplitude: Q
    frequency: Frequency
    offset: Q | None = None
    phase: Phase | None = None


class MultisineSpec(Part, Generic[Q]):
    """offset + a sum of sines: one amplitude, frequency and, where given, phase each."""

    amplitudes: tuple[Q, ...] = Field(min_length=1)
    frequencies: tuple[Frequency, ...]
    phases: tuple[Phase, ...] | None = Field(None, validate_default=True)
    offset: Q | None = None

    @field_validator("phases", mode="after")
    @classmethod
    def _one_each(cls, value: Any, info: ValidationInfo) -> Any:
        lists = {**info.data, "phases": value}
        counts = {key: len(items) for key, items in lists.items() if items is not None}
        if len(set(counts.values())) > 1:
            told = ", ".join(f"{count} {key}" for key, count in counts.items())
            refuse(f"has {told}", "give one of each for every sine", parent=True)
        return value


class SamplesSpec(Part, Generic[Q]):
    """Straight lines between samples: in the text, or in a CSV file.

    The file has a header of names and units, such as ``time_s,angle_deg,stiffness_N*m/rad``; the angle's signal takes
    the column that begins with ``angle_``, the stiffness's the one with ``stiffness_``.
    """

    times: tuple[Instant, ...] | None = Field(None, max_length=MOST_SAMPLES)
    values: tuple[Q, ...] | None = Field(None, max_length=MOST_SAMPLES)
    file: TablePath | None = Field(None, validate_default=True)

    @field_validator("times", mode="after")
    @classmethod
    def _rising(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        times = value or ()
        for before, after in itertools.pairwise(times):
            if not after > before:
                refuse(f"do not rise: {after:g} s follows {before:g} s", "sort them and remove repeats")
        return value

    @field_validator("file", mode="after")
    @classmethod
    def _one_source(cls, value: Any, info: ValidationInfo) -> Any:
        times, values = info.data.get("times", "wrong"), info.data.get("values", "wrong")
        if "wrong" in (times, values):
            return value
        if value is not None and (times is not None or values is not None):
            refuse("is given beside times or values", "keep the file, or the lists")
        if value is not None:
            return value
        if times is None or values is None:
            refuse("lacks its samples", "give `times` and `values`, or a `file`", parent=True)
        if len(times) != len(values) or not times:
            refuse(f"has {len(times)} times and {len(values)} values", "give one value a time", parent=True)
        return value


class SignalSpec(Part, Generic[Q]):
    """One of `constant`, `step`, `sine`, `multisine`, `samples`; in text a quantity alone is a constant."""

    constant: Q | None = None
    step: StepSpec[Q] | None = None
    sine: SineSpec[Q] | None = None
    multisine: MultisineSpec[Q] | None = None
    samples: SamplesSpec[Q] | None = Field(None, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _quantity_alone(cls, value: Any) -> Any:
        return {"constant": value} if isinstance(value, str | float | int) and value != "" else value

    @field_validator("samples", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        forms = ("constant", "step", "sine", "multisine", "samples")
        given = {**{key: info.data.get(key, "wrong") for key in forms[:-1]}, "samples": value}
        chosen = [key for key in forms if given[key] is not None]
        if len(chosen) != 1:
            what = f"is {' and '.join(chosen)} at once" if chosen else "has no signal"
            refuse(what, f"give one of {', '.join(forms)}", parent=True)
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        written = handler(self)
        return written["constant"] if self.constant is not None else written


class ReferenceSpec(Part):
    """The wish for the angle [rad] and for the stiffness [N*m/rad]."""

    angle: SignalSpec[Angle]
    stiffness: SignalSpec[Stiffness]

    @field_validator("angle", "stiffness", mode="after")
    @classmethod
    def _readable_file(cls, value: SignalSpec[Any], info: ValidationInfo) -> SignalSpec[Any]:
        if value.samples is not None and value.samples.file is not None:
            name, unit = ("angle", "rad") if info.field_name == "angle" else ("stiffness", "N*m/rad")
            try:
                read_samples(value.samples.file, name, unit)
            except ScenarioError as error:
                first, *others = (str(problem) for problem in error.problems)
                more = f" (and {len(others)} more)" if others else ""
                refuse(f"{value.samples.file.name}: {first}{more}")
        return value
