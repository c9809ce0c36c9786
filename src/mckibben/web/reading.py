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
            if (option := getattr(recipe, name)) is not None:
                text = ", ".join(option) if name == "accept" else option
                setattr(self, name, show(option, _UNITS[name], 12) if name in _UNITS else text)
        self.negative = recipe.force_sign == -1
        self.columns = "\n".join(f"{header} = {name}" for header, name in (recipe.columns or {}).items())
        others = {"contraction", "sample_rate", "part", *(["force_sign"] if recipe.force_sign == 1 else [])}
        self.others = recipe.model_dump(include=others, exclude_none=True)

    def recipe(self) -> Recipe:
        """The recipe; a `ParameterError` or `ScenarioError` lists mistakes."""
        texts = {name: getattr(self, name).strip() for name in (*TEXTS, "displacement")}
        options: dict[str, Any] = {name: text for name, text in texts.items() if text}
        options |= {"columns": names} if (names := column_names(self.columns)) else {}
        options |= self.others | ({"force_sign": -1} if self.negative else {})
        if accepted := [*_topics(self.accept), *(["corrupt"] if self.skip else [])]:
            options["accept"] = accepted
        return Recipe(**options)


def _topics(text: str) -> list[str]:
    """Topics of questions, separated by commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


def understood(data: IsobaricDataset) -> list[tuple[str, ...]]:
    """What was understood of the columns of the files, `dataset.Table.rows`, once; without ranges if several differ."""
    several = len(data.lines) > 1
    rows = (row for part in data.lines for row in part.columns)
    return list(dict.fromkeys((*row[:4], "", *row[5:]) if several else row for row in rows))


def column_names(text: str) -> dict[str, str]:
    """Headers of a file to names, from lines such as ``Druck [bar] = pressure_bar``."""
    names = {}
    for number, line in enumerate(filter(str.strip, text.splitlines()), start=1):
        header, equals, name = (part.strip() for part in line.rpartition("="))
        if not (header and equals and name):
            raise ParameterError(
                f"columns, line {number} is not a pair", value=line, remedy="write HEADER = pressure_bar"
            )
        names[header] = name
    return names


def refusal(name: str, text: str | None) -> str | None:
    """Reason why a text is not a value of a recipe's field; None if it is valid or empty."""
    try:
        options: dict[str, Any] = {name: text.strip()} if text and text.strip() else {}
        options = {"accept": _topics(options["accept"])} if "accept" in options else options
        Recipe(**options)
    except ScenarioError as error:
        return "; ".join(filter(None, (error.problems[0].message, error.problems[0].remedy)))
    return None


def read(paths: Sequence[Path], fields: ReadingFields) -> IsobaricDataset:
    """The points of the files of a test, read as the fields say; errors name them without their folder."""
    try:
        return read_dataset(paths, fields.recipe())
    except DatasetError as error:
        raise DatasetError(Path(error.source).name.removeprefix("data-"), error.problems) from None
