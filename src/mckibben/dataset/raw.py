"""Raw tables of files, before their columns are understood, and the limits of what is read."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.table import Question, refusal
from mckibben.dataset.vocabulary import Header, parse_header, parse_line
from mckibben.errors import FileError
from mckibben.storage.files import similar_file

if TYPE_CHECKING:
    import h5py

Floats = NDArray[np.float64]

LARGEST = 2**27
"""Bytes of a file, and of its numbers."""
LARGEST_PLAIN, MOST_PLAIN = 2**30, 3 * LARGEST
"""Bytes of a text of numbers alone, which is read in chunks, and of its numbers: 12 million rows of four columns."""
_ROWS = 1_500_000
_COLUMNS = 1024
LIMIT_REMEDY = "split the file, or save fewer rows and columns; a recording of numbers alone may have 12 million rows"
FILES_REMEDY = "name its files, several for one test: DIR/*.csv, in Python sorted(Path('DIR').glob('*.csv'))"


@dataclass(frozen=True, eq=False)
class RawColumn:
    """Column as the file has it.

    Attributes
    ----------
    name
        Full name: the header, or the path of a channel (``group/channel``, ``struct.field``, ``matrix(:,2)``).
    cells
        Numbers, or texts.
    label
        Part of the name that is understood as a header; default: the name.
    unit
        Unit that stands elsewhere: in a row of units, or in a property of the channel.
    """

    name: str
    cells: Floats | Sequence[str]
    label: str = ""
    unit: str = ""

    @property
    def title(self) -> str:
        """Label or name."""
        return self.label or self.name

    def name_in(self, mapping: Mapping[str, str]) -> str:
        """Name that a recipe gives to the column; empty if it gives none."""
        return mapping.get(self.name, mapping.get(self.title, ""))

    def header(self, mapping: Mapping[str, str] = MappingProxyType({})) -> Header:
        """Meaning of the column, by the recipe or by its title."""
        name = self.name_in(mapping)
        return parse_header(parse_line(name)[2]) if name else parse_header(self.title, self.unit)


@dataclass
class RawTable:
    """Columns of a file, with what stands beside them.

    Attributes
    ----------
    lines
        Number of the line (`place` "line") or row of each row.
    words
        Texts beside the table: comments, cells outside, attributes, with their line, or None.
    comments
        Values of the keys that this program writes: specimen, source, initial_length, slack_force, preprocessing.
    questions
        Rows of another width, hidden cells, a decimal sign that is not plain, and objects that cannot be read.
    decimal
        Decimal sign of texts; empty if no cell determines it.
    interval
        Sampling interval [s] that the file states.
    """

    columns: list[RawColumn] = field(default_factory=list)
    lines: Sequence[int] | NDArray[np.int64] = ()
    place: str = "row"
    words: list[tuple[int | None, str]] = field(default_factory=list)
    comments: dict[str, str] = field(default_factory=dict)
    questions: list[Question] = field(default_factory=list)
    decimal: str = "."
    interval: float | None = None


class Budget:
    """Limits of rows, columns and bytes while a file is read.

    Parameters
    ----------
    path
        File that errors name.
    most
        Bytes of numbers that may be in memory together.

    Examples
    --------
    >>> budget = Budget(Path("rig.csv"), most=1000)
    >>> budget.spend(size=600, rows=25)
    >>> budget.bytes
    600
    """

    def __init__(self, path: Path, most: int = LARGEST) -> None:
        self.path, self.most, self.bytes = path, most, 0

    def spend(self, *, size: int = 0, rows: int = 0, columns: int = 0) -> None:
        """Account for bytes that will be in memory; check rows and columns.

        Raises a `DatasetError` that names the limit that is passed.
        """
        self.bytes += size
        for amount, most, what in (
            (self.bytes, self.most, "bytes"),
            (rows, _ROWS, "rows"),
            (columns, _COLUMNS, "columns"),
        ):
            if amount > most:
                raise refusal(self.path, f"has more than {most:,} {what}", LIMIT_REMEDY)


def check_regular(path: Path) -> int:
    """Size of a regular file [bytes].

    Raises a `DatasetError` if there is none, with the most similar name, and for a directory, a pipe or a device.
    """
    if os.path.isfile(path):  # noqa: PTH113, false for a path that cannot be
        return path.stat().st_size
    meant = FILES_REMEDY if "*" in path.name else similar_file(path) or "give the path of a file of measurements"
    if os.path.isdir(path):  # noqa: PTH112
        raise refusal(path, "is a directory", FILES_REMEDY)
    if os.path.exists(path):  # noqa: PTH110
        raise refusal(path, "is a pipe or a device", "save its content in a file")
    raise refusal(path, "there is no such file", meant)


def read_bytes(path: Path) -> bytes:
    """Content of a regular file within the limits; raises a `DatasetError` for any other."""
    Budget(path).spend(size=check_regular(path))
    try:
        with path.open("rb") as file:
            return file.read(os.fstat(file.fileno()).st_size)
    except OSError as error:
        raise refusal(path, f"cannot be read: {error}") from None


@contextmanager
def readable(path: Path, what: str) -> Iterator[None]:
    """Raise a `DatasetError` for any exception of a library that reads a file.

    Libraries raise nearly every kind of exception for a damaged file. `what` names the kind of file, with its article;
    the first line of the exception is quoted. Errors of files, and a missing library, remain what they are.
    """
    try:
        yield
    except (FileError, ImportError):
        raise
    except Exception as error:
        lines = (getattr(error, "strerror", None) or str(error) or type(error).__name__).splitlines()
        text = f"cannot be read as {what}: {lines[0][:500]}"
        raise refusal(path, text, "save it again, or export it as CSV") from error


def hdf5_nodes(file: h5py.File, budget: Budget) -> dict[str, h5py.Group | h5py.Dataset | None]:
    """Groups and datasets of an open file by name, each once; None where values are in other files.

    No link is followed; the budget limits their number.
    """
    import h5py

    nodes: dict[str, h5py.Group | h5py.Dataset | None] = {}

    def visit(name: str, node: h5py.Group | h5py.Dataset) -> None:
        budget.spend(columns=len(nodes))
        if not name.startswith("#"):
            nodes[name] = None if isinstance(node, h5py.Dataset) and (node.is_virtual or node.external) else node

    file.visititems(visit)
    return nodes


@contextmanager
def needs(path: Path, library: str, extra: str) -> Iterator[None]:
    """Raise a `DatasetError` if a library that a file needs is not installed."""
    try:
        yield
    except ImportError:
        remedy = f'pip install "mckibben[{extra}]", or export the file as CSV'
        raise refusal(path, f"needs {library}, which is not installed", remedy) from None
