"""Fields by which the page of muscles reads a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mckibben.dataset import IsobaricDataset, Recipe, read_dataset
from mckibben.errors import DatasetError, ParameterError, ScenarioError
from mckibben.units import show

_UNITS = {"initial_length": "mm", "ambient": "kPa"}


@dataclass
class ReadingFields:
    """Reading options, as texts of the fields of the page.

    Attributes
    ----------
    initial_length, ambient
        Quantities with a unit; empty for none.
    columns
        Lines ``HEADER = NAME``, see `column_names`.
    further
        All other settings, as the YAML text of a `Recipe`.
    """

    initial_length: str = ""
    ambient: str = ""
    columns: str = ""
    further: str = ""

    def take(self, recipe: Recipe) -> None:
        """Fill all fields, to which those of an open page are bound, from a recipe."""
        for name, unit in _UNITS.items():
            value = getattr(recipe, name)
            setattr(self, name, "" if value is None else show(value, unit, 12))
        self.columns = "\n".join(f"{header} = {name}" for header, name in (recipe.columns or {}).items())
        further = recipe.model_copy(update=dict.fromkeys((*_UNITS, "columns")))
        self.further = "" if further == Recipe() else further.dumps()

    def recipe(self) -> Recipe:
        """The recipe of all fields.

        Raises `ParameterError` for a line of `columns` that is not a pair, and `ScenarioError` with all mistakes of
        the settings.
        """
        options: dict[str, object] = {name: text for name in _UNITS if (text := getattr(self, name).strip())}
        options |= {"columns": names} if (names := column_names(self.columns)) else {}
        return Recipe.parse(self.further, source="further settings").with_options(options)


def understood(data: IsobaricDataset) -> list[tuple[str, ...]]:
    """What was understood of the columns of the files, as rows of texts for a table.

    Rows are those of `dataset.Table.rows`, each once; without ranges if files differ.
    """
    several = len(data.lines) > 1
    rows = (row for part in data.lines for row in part.rows())
    return list(dict.fromkeys((*row[:4], "", *row[5:]) if several else row for row in rows))


def column_names(text: str) -> dict[str, str]:
    """Headers of a file to names, from lines such as ``Druck [bar] = pressure_bar``; `ParameterError` for other lines.

    >>> column_names("Druck [bar] = pressure_bar")
    {'Druck [bar]': 'pressure_bar'}
    """
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
    """Reason why a text is not a value of a recipe's field; None if it is valid or empty.

    >>> refusal("initial_length", "180 mm") is None, "unit" in refusal("initial_length", "180 bar")
    (True, True)
    """
    try:
        Recipe().with_options({name: text.strip()} if text and text.strip() else {})
    except ScenarioError as error:
        return "; ".join(filter(None, (error.problems[0].message, error.problems[0].remedy)))
    return None


def read(paths: Sequence[Path], fields: ReadingFields) -> IsobaricDataset:
    """The points of the files of a test, read as the fields say; errors name them without their folder."""
    try:
        return read_dataset(paths, fields.recipe())
    except DatasetError as error:
        raise DatasetError(Path(error.source).name.removeprefix("data-"), error.problems) from None
