"""Recipe for reading files: every option of a reader, for Python, the command line and the page."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field

from mckibben.config.fields import OneOf
from mckibben.config.model import DocumentModel, fail_validation
from mckibben.dataset.clocks import ESTIMATED, PAIRED, Clock
from mckibben.dataset.file_names import pattern_problem
from mckibben.dataset.matrix import MATRIX
from mckibben.dataset.table import TOPICS
from mckibben.errors import UnitError
from mckibben.units import Contraction, Force, Length, Pressure, SampleRate


def _check_pattern(pattern: str) -> str:
    if problem := pattern_problem(pattern):
        fail_validation(problem, "write a pattern such as 'L{length_mm}mm' for Muscle_L190mm.csv")
    return pattern


def _check_clocks(text: str) -> str:
    if text not in (ESTIMATED, PAIRED):
        try:
            Clock.parse(text)
        except UnitError as error:
            fail_validation(error.message, f"write {ESTIMATED}, {PAIRED}, '12.5 s' or '12.5 s, 0.01 %'")
    return text


def _as_tuple(value: object) -> object:
    parts = [part.strip() for part in value.strip("[] ").split(",")] if isinstance(value, str) else value
    return tuple(parts) if isinstance(parts, list) else parts


def _as_parts(value: object) -> object:
    """Names of parts: a text alone is one name, with its commas."""
    return (value,) if isinstance(value, str) and not re.fullmatch(r"\[.*\]", value) else _as_tuple(value)


def _check_matrix(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) not in (0, len(MATRIX)):
        fail_validation("needs rows, columns and cells", "write 'pressure_bar, contraction_percent, force_N'")
    return names


def _as_weight(value: object) -> object:
    """Weight of a mass, such as '2 kg', as a force."""
    match = re.fullmatch(r"(.*\d)\s*(k?g)\s*", value) if isinstance(value, str) else None
    return f"{match[1]} {match[2]}f" if match else value


class Recipe(DocumentModel):
    """Options of `read_dataset` and `read_recording`, in SI units; `read` and `to_yaml` know the units.

    A `ScenarioError` lists all mistakes of a file, or of the arguments.

    Attributes
    ----------
    columns
        Header to a quantity with its unit: ``{"Druck [bar]": "pressure_bar"}``; ``"2.5*(x-0.4) pressure_bar"`` is the
        line of a sensor in volts or counts, ``"-force_N"`` turns the sign,
        ``"pressure_kPa_abs"`` is absolute, ``"shortening_mm"`` and ``"lengthening_mm"`` say the direction of a
        displacement, ``"ignore"`` leaves a column out. Without a header, columns have numbers from 1. A word such as
        ``{"up": "unloading"}`` gives the meaning of a cell.
    part
        Sheets, groups or structs to be read, of several: one, or a list of those of one test.
    matrix
        Quantities of a matrix: of the numbers before its rows and above its columns, and of its cells, as in `columns`:
        ``["pressure_bar", "contraction_percent", "force_N"]``. Empty cells are no points.
    initial_length
        Length of the deflated muscle [m], for lengths and displacements.
    displacement, zero_length
        Direction of positive displacements, "shortening" or "lengthening", and the length [m] at displacement 0;
        default: `initial_length`.
    ambient
        Ambient pressure [Pa], subtracted from absolute pressures.
    contraction, sample_rate
        Of a recording: its contraction [-], if no column has it, and the rate of its samples [Hz], if it has no times.
    slack_force, largest_force
        Force [N] up to which the muscle counts as slack (default: estimated), and from which on rows are left out.
    decimal
        Decimal sign of a text, "." or ",", if its numbers do not determine it.
    specimen
        Name of the specimen.
    joint, lever
        Of a test on a joint, with angles and torques: name in the catalog or file of its geometry, and the lever arm
        [m], if forces were measured in place of torques.
    loads
        Weights or forces [N] that hung on the muscle, one for each file or part, if no column has them:
        ``["2 kg", "50 N"]``.
    from_name
        Pattern of the names of files or sheets with a quantity in braces: ``"L{length_mm}mm"`` reads the length of
        L190mm.csv. If the names of all sheets of measurements match, all are read.
    clocks
        Of two recordings of one test by devices with clocks of their own: "estimated", from a quantity in both, or when
        the second clock starts on the first: ``"12.5 s"``, with its drift ``"12.5 s, 0.01 %"``. Of one file whose
        signals each follow a time of their own: "paired".
    accept
        Topics of questions that are answered with yes: `mckibben.dataset.TOPICS` lists them.

    Examples
    --------
    >>> recipe = Recipe(columns={"Weg [mm]": "shortening_mm"}, initial_length=0.3, accept=["words"])
    >>> print(recipe.dumps())
    columns: {'Weg [mm]': shortening_mm}
    initial_length: 300 mm
    accept: [words]
    <BLANKLINE>
    """

    kind = "recipe"
    examples = "docs/files.md"

    columns: dict[str, str] | None = Field(None, examples=["{Druck: pressure_bar}"])
    part: Annotated[tuple[str, ...], BeforeValidator(_as_parts)] = ()
    matrix: Annotated[tuple[str, ...], BeforeValidator(_as_tuple), AfterValidator(_check_matrix)] = ()
    initial_length: Length | None = None
    displacement: Annotated[str, OneOf(("shortening", "lengthening"))] | None = None
    zero_length: Length | None = None
    ambient: Pressure | None = None
    contraction: Contraction | None = None
    sample_rate: SampleRate | None = None
    slack_force: Force | None = None
    largest_force: Force | None = None
    decimal: Annotated[str, OneOf((".", ","))] | None = None
    specimen: str | None = None
    from_name: Annotated[str, AfterValidator(_check_pattern)] | None = None
    joint: str | None = None
    lever: Length | None = None
    clocks: Annotated[str, AfterValidator(_check_clocks)] | None = None
    loads: Annotated[tuple[Annotated[Force, BeforeValidator(_as_weight)], ...], BeforeValidator(_as_tuple)] = ()
    accept: Annotated[tuple[Annotated[str, OneOf(tuple(TOPICS))], ...], BeforeValidator(_as_tuple)] = ()

    @classmethod
    def parse(cls, text: str, *, source: str = "", folder: str | os.PathLike[str] = ".") -> Self:
        """Read YAML text; one without any line but comments is the recipe of a file that needs no options."""
        if all(not line.strip() or line.lstrip().startswith("#") for line in text.splitlines()):
            return cls()
        return super().parse(text, source=source, folder=folder)

    def with_options(self, options: Mapping[str, object]) -> Self:
        """Recipe with further options, which are checked as its own."""
        make: Any = type(self)
        return make(**{**self.model_dump(exclude_defaults=True), **options}) if options else self

    def _written(self, folder: Any) -> dict[str, Any]:
        return {key: value for key, value in super()._written(folder).items() if value not in (None, [], ())}
