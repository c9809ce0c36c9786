"""Options that read files, the same for all commands: a recipe, and its settings that files most often need."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Argument

from mckibben.cli.help import completion
from mckibben.cli.options import echo, parse_pairs
from mckibben.errors import ScenarioError
from mckibben.units import show

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe, Recording

_DATA = "Data files of one test, or the name of a dataset in the catalog."
Data = Annotated[list[str], Argument(metavar="DATA...", help=_DATA, autocompletion=completion("data"))]
Texts = list[str] | None


class Reading(NamedTuple):
    """Reading options of a command."""

    recipe: Recipe
    options: tuple[str, ...] = ()

    def data(self, names: list[str]) -> IsobaricDataset:
        """Data files or a dataset from the catalog; reading and preprocessing are reported on standard error."""
        from mckibben.dataset.preprocessing import POINTS
        from mckibben.scenario.inputs import data_named

        dataset = data_named(names, self.recipe)
        _report(dataset.table.attrs)
        command = f"`{shlex.join([*POINTS.split(), *names, *self.options, '--out', 'plateaus'])}` and "
        for note in dataset.table.attrs.get("preprocessing", "").splitlines():
            text = note.replace(POINTS, f"{command}`mckibben identify plateaus/points.csv`")
            echo(f"found in the data: {text}", err=True)
        return dataset

    def recordings(self, paths: list[str]) -> list[Recording]:
        """Recordings over time, one per file; reading is reported on standard error."""
        return [self.recording([path]) for path in paths]

    def recording(self, paths: list[str] | list[Path]) -> Recording:
        """One recording over time, of one or more files; reading is reported on standard error."""
        from mckibben.dataset import read_recording
        from mckibben.scenario.inputs import geometry_named

        recording = read_recording(paths, self.recipe, geometry=geometry_named(self.recipe.joint))
        _report(recording.table.attrs)
        return recording


def read_options(*, read: Texts = None, column: Texts = None, initial_length: str = "") -> Reading:
    """Return the recipe of --read with the other options of the command line.

    Parameters
    ----------
    read : FILE|NAME=VALUE
        Recipe, or one of its settings, such as 'sample_rate=1000 Hz', 'ambient=101.3 kPa' or decimal=,; and
        accept=TOPIC, which answers the questions of a topic with yes; repeatable. Other options prevail.
    column : 'HEADER=NAME'
        Read the column HEADER as NAME, such as pressure_bar, or ignore it; repeatable.
    initial_length : LENGTH
        Length of the deflated muscle, such as '180 mm', if the file has lengths.
    """
    from mckibben.dataset.recipe import Recipe

    recipe, options, accepted = Recipe(), dict[str, object](), []
    for text in read or []:
        name, equals, value = (word.strip() for word in text.partition("="))
        if not equals or not name.isidentifier():
            recipe = Recipe.read(text)
        elif name == "accept":
            accepted.append(value)
        else:
            options[name] = value
    if initial_length:
        options["initial_length"] = initial_length
    if recipe.initial_length is not None and "initial_length" not in options:
        length = show(recipe.initial_length, "mm")
        echo(
            f"initial length {length}, from the recipe; for a muscle of another length, give --initial-length", err=True
        )
    if columns := parse_pairs("--column", column, "Druck [bar]=pressure_bar"):
        options["columns"] = (recipe.columns or {}) | columns
    if accepted:
        options["accept"] = [*recipe.accept, *accepted]
    try:
        arguments = (*_repeated("--read", read), *_repeated("--column", column))
        return Reading(recipe.with_options(options), (*arguments, *_repeated("--initial-length", [initial_length])))
    except ScenarioError as error:
        options_of_fields = {"initial_length": "--initial-length", "columns": "--column"}
        problems = [
            replace(p, field=options_of_fields.get(p.field.split("[")[0], f"--read {p.field}=")) for p in error.problems
        ]
        raise ScenarioError("options of reading", problems) from None


def _repeated(option: str, texts: Texts) -> list[str]:
    """An option before each of its texts."""
    return [argument for text in filter(None, texts or []) for argument in (option, text)]


def _report(attributes: Mapping[str, Any]) -> None:
    """Report how the columns of a file were read, and which were not, on standard error."""
    if read := attributes.get("columns_read"):
        echo(read, err=True)
    if ignored := attributes.get("ignored_columns"):
        echo(f"ignored columns: {ignored} (read one with --column 'HEADER=NAME')", err=True)
