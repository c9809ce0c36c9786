"""Reader of the page of muscles: its fields, the choice for each column, and the remaining questions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Self

from mckibben.dataset import TOPICS, IsobaricDataset, Question, Recipe, Table, read_columns, read_dataset
from mckibben.dataset.cells import NUMBER
from mckibben.dataset.checks import questions_of
from mckibben.dataset.vocabulary import QUANTITIES, parse_header, parse_line
from mckibben.errors import DatasetError, ScenarioError
from mckibben.units import show

_UNITS = {"initial_length": "mm", "ambient": "kPa"}
_OF_JOINTS = ("angle", "torque", "pressure1", "pressure2")
WORDS = {
    "": "not used",
    **{name: name.replace("_", " ") for name in QUANTITIES if name not in _OF_JOINTS},
    "displacement": "displacement (which way?)",
    "shortening": "displacement, + = shorter",
    "lengthening": "displacement, + = longer",
}
"""Quantities of columns, with their words on the page."""


class ColumnChoice(NamedTuple):
    """Meaning of a column: quantity ("" if it is not used), unit, sign and reference of a pressure.

    `line` is the line of a sensor in volts or counts, of a recipe.

    >>> ColumnChoice.of_name("-force_N"), ColumnChoice.of_name("2*x+1 pressure_kPa_abs").name
    (ColumnChoice(quantity='force', unit='N', turned=True, absolute=False, line=''), '2*x+1 pressure_kPa_abs')
    """

    quantity: str
    unit: str = ""
    turned: bool = False
    absolute: bool = False
    line: str = ""

    @classmethod
    def of_name(cls, name: str) -> Self:
        """The choice of a name in a recipe."""
        line, _, plain = name.rpartition(" ")
        header = parse_header(parse_line(name)[2])
        return cls(header.quantity, header.unit, not line and plain.startswith("-"), header.absolute, line)

    @classmethod
    def of(cls, header: str, table: Table, columns: dict[str, str]) -> Self:
        """The choice for a column of a file: that of the recipe, or as it was understood."""
        if (name := columns.get(header)) is not None:
            return cls("") if name == "ignore" else cls.of_name(name)
        meant = parse_header(header, table.units[header])
        for column in table.columns.values():
            if column.header == header:
                return cls(column.quantity, column.unit, absolute=meant.absolute)
        asked = any(question.problem.field == header for question in table.questions)
        is_known = asked and meant.quantity in WORDS
        return cls(meant.quantity, meant.unit, absolute=meant.absolute) if is_known else cls("")

    def changed(self, **changes: object) -> Self:
        """With another quantity, unit, sign or reference; a unit that the quantity does not have is to be chosen."""
        choice = self._replace(**changes)  # type: ignore[arg-type]
        unit = choice.unit if choice.unit in QUANTITIES.get(choice.quantity, ()) else ""
        return choice._replace(unit=unit, absolute=choice.absolute and "pressure" in choice.quantity)

    @property
    def name(self) -> str:
        """Name in a recipe."""
        if not self.quantity:
            return "ignore"
        name = "_".join(filter(None, (self.quantity, self.unit, "abs" if self.absolute else "")))
        return f"{self.line} {name}" if self.line else f"-{name}" if self.turned else name


@dataclass
class ReadingFields:
    """Reading options, as the page has them.

    Attributes
    ----------
    initial_length, ambient
        Quantities with a unit; empty for none.
    columns, accept
        Names of columns by their headers, and topics of questions that are answered with yes.
    further
        All other settings, as the YAML text of a `Recipe`.
    """

    initial_length: str = ""
    ambient: str = ""
    columns: dict[str, str] = field(default_factory=dict)
    accept: tuple[str, ...] = ()
    further: str = ""

    def take(self, recipe: Recipe) -> None:
        """Fill all fields, to which those of an open page are bound, from a recipe."""
        for name, unit in _UNITS.items():
            value = getattr(recipe, name)
            setattr(self, name, "" if value is None else show(value, unit, 12))
        self.columns, self.accept = dict(recipe.columns or {}), recipe.accept
        further = recipe.model_copy(update={**dict.fromkeys((*_UNITS, "columns")), "accept": ()})
        self.further = "" if further == Recipe() else further.dumps()

    def recipe(self) -> Recipe:
        """The recipe of all fields; raises `ScenarioError` with all mistakes of the settings."""
        options: dict[str, object] = {name: text for name in _UNITS if (text := getattr(self, name).strip())}
        options |= {name: value for name in ("columns", "accept") if (value := getattr(self, name))}
        return Recipe.parse(self.further, source="further settings").with_options(options)


class Read(NamedTuple):
    """Table, columns and questions of the files of a test.

    Attributes
    ----------
    tables
        What was understood of each file; none of a file that this program wrote.
    data
        Points; None while questions about columns are open.
    questions
        What is not plain, and not answered.
    """

    tables: tuple[Table, ...]
    data: IsobaricDataset | None
    questions: tuple[Question, ...]


def read(paths: Sequence[Path], fields: ReadingFields) -> Read:
    """Read the files of a test as the fields say; errors name them without their folder.

    There are points, to be drawn, as soon as columns are understood; questions about their numbers may still be open.
    """
    recipe = fields.recipe()
    try:
        data = read_dataset(paths, recipe.with_options({"accept": list(TOPICS)}))
    except DatasetError as error:
        table = None
        for columns in ({}, _unnamed(paths[0])):
            with suppress(DatasetError):
                table = table or read_columns(paths[0], recipe.with_options({"columns": columns | fields.columns}))
        if table is None:
            raise DatasetError(Path(error.source).name.removeprefix("data-"), error.problems) from None
        asked = _open(table.questions, recipe) or tuple(Question(problem) for problem in error.problems)
        return Read((table,), None, asked)
    asked = tuple(itertools.chain.from_iterable(table.questions for table in data.lines))
    if "columns_read" in data.table.attrs:  # this program did not write it
        lines = list(itertools.chain.from_iterable(table.lines for table in data.lines))
        asked += tuple(questions_of(data, lines))
    return Read(data.lines, data, _open(asked, recipe))


def _unnamed(path: Path) -> dict[str, str]:
    """Columns of a text without a header that is understood, each to be chosen: by its name there, or its number."""
    line = next(filter(str.strip, path.read_text(encoding="utf-8", errors="replace").splitlines()), "")
    cells = [cell.strip(' "') for cell in max((line.split(separator) for separator in ",;\t"), key=len)]
    numbered = all(NUMBER.fullmatch(cell) for cell in cells)
    return dict.fromkeys([str(k) for k in range(1, len(cells) + 1)] if numbered else cells, "ignore")


def _open(questions: Sequence[Question], recipe: Recipe) -> tuple[Question, ...]:
    """Questions that a recipe does not answer."""
    return tuple(question for question in questions if not question.topic or question.topic not in recipe.accept)


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
