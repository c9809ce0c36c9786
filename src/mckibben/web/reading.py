"""Fields by which the page of muscles reads a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mckibben.dataset import IsobaricDataset, Recipe, read_dataset
from mckibben.errors import DatasetError, ParameterError, ScenarioError
from mckibben.units import show

TEXTS = {
    "initial_length": "initial length, such as 180 mm",
    "ambient": "ambient pressure, such as 101.3 kPa, if pressures are absolute",
    "zero_length": "zero length: at displacement 0, if another",
    "from_name": "from file names, such as {pressure_bar}bar",
    "slack_force": "slack force, such as 4 N, if not estimated",
    "largest_force": "largest force, if the sensor is saturated there",
    "decimal": "decimal sign, if the file does not tell",
    "specimen": "name of the muscle",
    "accept": "questions that are answered with yes, such as words",
}
"""Labels of the fields for texts, by the names of a recipe."""
_UNITS = {"ambient": "kPa", "initial_length": "mm", "zero_length": "mm", "slack_force": "N", "largest_force": "N"}
DISPLACEMENTS = {"": "not given", "shortening": "shortening", "lengthening": "lengthening"}


@dataclass
class ReadingFields:
    """Reading options, as texts of the fields of the page."""

    initial_length: str = ""
    displacement: str = ""
    zero_length: str = ""
    from_name: str = ""
    slack_force: str = ""
    largest_force: str = ""
    decimal: str = ""
    specimen: str = ""
    negative: bool = False
    skip: bool = False
    columns: str = ""
    ambient: str = ""
    accept: str = ""
    others: dict[str, Any] = field(default_factory=dict)
    """Settings of a recipe without a field, which it keeps: those of recordings only, and a positive sign."""

    def clear(self) -> None:
        """Empty all fields, to which those of an open page are bound."""
        vars(self).update(vars(ReadingFields()))

    def take(self, recipe: Recipe) -> None:
        """Fill all fields from a recipe."""
        self.clear()
        for name in (*TEXTS, "displacement"):
            if (given := getattr(recipe, name)) is not None:
                text = ", ".join(given) if name == "accept" else given
                setattr(self, name, show(given, _UNITS[name], 12) if name in _UNITS else text)
        self.negative = recipe.force_sign == -1
        self.columns = "\n".join(f"{header} = {name}" for header, name in (recipe.columns or {}).items())
        kept = {"contraction", "sample_rate", "part", *(["force_sign"] if recipe.force_sign == 1 else [])}
        self.others = recipe.model_dump(include=kept, exclude_none=True)

    def recipe(self) -> Recipe:
        """The recipe; a `ParameterError` or `ScenarioError` lists mistakes."""
        texts = {name: getattr(self, name).strip() for name in (*TEXTS, "displacement")}
        given: dict[str, Any] = {name: text for name, text in texts.items() if text}
        given |= {"columns": names} if (names := column_names(self.columns)) else {}
        given |= self.others | ({"force_sign": -1} if self.negative else {})
        if accepted := [*_topics(self.accept), *(["corrupt"] if self.skip else [])]:
            given["accept"] = accepted
        return Recipe(**given)


def _topics(text: str) -> list[str]:
    """Topics of questions, separated by commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


def rows_read(text: str) -> tuple[list[tuple[str, ...]], str]:
    """Cells of the table of columns that were read, without those of its header, and the line below it."""
    header, *lines, last = text.split("\n")
    starts = [0, *map(header.index, ("quantity", "unit", "unit from", "range"))]
    rows: list[tuple[str, ...]] = []
    for one in lines:
        *cells, end = (one[start:stop].strip() for start, stop in zip(starts, [*starts[1:], None], strict=True))
        found, _, remark = end.partition("  ")
        rows.append((*cells, found, remark.strip()))
    return rows, last


def column_names(text: str) -> dict[str, str]:
    """Headers of a file to names, from lines such as ``Druck [bar] = pressure_bar``."""
    found = {}
    for number, one in enumerate(filter(str.strip, text.splitlines()), start=1):
        header, equals, name = (part.strip() for part in one.rpartition("="))
        if not (header and equals and name):
            raise ParameterError(
                f"columns, line {number} is not a pair", value=one, remedy="write HEADER = pressure_bar"
            )
        found[header] = name
    return found


def refusal(name: str, text: str | None) -> str | None:
    """Reason why a text is not a value of a recipe's field; None if it is valid or empty."""
    try:
        given: dict[str, Any] = {name: text.strip()} if text and text.strip() else {}
        given = {"accept": _topics(given["accept"])} if "accept" in given else given
        Recipe(**given)
    except ScenarioError as error:
        return "; ".join(filter(None, (error.problems[0].message, error.problems[0].remedy)))
    return None


def read(paths: Sequence[Path], fields: ReadingFields) -> IsobaricDataset:
    """The points of the files of a test, read as the fields say; errors name them without their folder."""
    try:
        return read_dataset(paths, fields.recipe())
    except DatasetError as error:
        raise DatasetError(Path(error.source).name.removeprefix("data-"), error.problems) from None
