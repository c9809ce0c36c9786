"""The view of results, one for all pages: verdict, remarks, figure, tables, a download, and how to get it again."""

from __future__ import annotations

import base64
import dataclasses
import io
import shlex
import threading
import zipfile
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple, Self

from nicegui import ui

from mckibben.errors import printable
from mckibben.report import png_of
from mckibben.result import Listing, Remark, Result
from mckibben.storage.files import to_json
from mckibben.web.layout import button, fold, panel, quiet, show_remarks, table
from mckibben.web.session import in_thread

_drawing = threading.Lock()  # the house style is set for the whole process while a figure is drawn


class Repetition(NamedTuple):
    """How to get a result again outside of the page.

    Attributes
    ----------
    command, python
        Command line, and a program, in the folder of the files.
    files
        Content of the files by name; the download of a result has them.
    """

    command: str
    python: str
    files: dict[str, bytes]

    @classmethod
    def of(cls, words: Iterable[str], python: str, files: dict[str, bytes]) -> Self:
        """From the words of the command, and lines of Python."""
        program = f"import mckibben as mk\n\n{python}\nprint(result.to_text())"
        return cls(f"mckibben {shlex.join(words)}", program, files)


class Presented(NamedTuple):
    """What is shown of a result, computed in the thread of its job.

    Attributes
    ----------
    result, remarks, listings
        Result, its remarks and its tables.
    picture
        First figure as PNG; empty if there is none, or if charts show it.
    steps
        How to get it again.
    """

    result: Result
    remarks: tuple[Remark, ...]
    listings: tuple[Listing, ...]
    picture: bytes
    steps: Repetition

    @classmethod
    def of(cls, result: Result, steps: Repetition, *, charts: bool = False) -> Presented:
        """Compute the tables of a result, and draw its first figure.

        Parameters
        ----------
        result, steps
            Result, and how to get it again.
        charts
            Whether the page has charts of it: they are in place of the figure, and tables are closed at first.
        """
        listings = result.listings()
        if charts:
            titled = (
                (table.title or f"all numbers{'' if table.vertical else ', by joint'}", table) for table in listings
            )
            listings = (dataclasses.replace(table, title=title, detail=True) for title, table in titled)
        picture = b"" if charts else _picture_of(result)
        return cls(result, tuple(result.remarks()), tuple(listings), picture, steps)

    def others(self, heard: list[str]) -> list[str]:
        """Warnings that are not remarks of the result."""
        shown = [remark.text for remark in self.remarks]
        return [text for text in heard if text not in shown]

    def archive(self) -> bytes:
        """Zip file of results.json, the figure, and the files with which command and program give them again."""
        content, picture = io.BytesIO(), self.picture or _picture_of(self.result)
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as folder:
            folder.writestr("results.json", to_json(self.result.to_dict()))
            if picture:
                folder.writestr("figure.png", picture)
            texts = {"command.txt": f"{self.steps.command}\n", "program.py": f"{self.steps.python}\n"}
            for file, text in (*texts.items(), *self.steps.files.items()):
                folder.writestr(file, text)
        return content.getvalue()


def _picture_of(result: Result, resolution: int = 220) -> bytes:
    """The first figure of a result as PNG with a resolution [dpi]; empty if it has none."""
    with _drawing:
        return png_of(result.plot(), resolution) if result.figures else b""


def show_result(presented: Presented, name: str, figure: Callable[[], object] = lambda: None) -> ui.column:
    """Show a result in a panel, to which the page may add.

    From top to bottom: verdict, remarks, figure, tables, and a button for the download.

    Parameters
    ----------
    presented
        What is shown.
    name
        Name of the downloaded zip file.
    figure
        Adds what the page shows in place of the figure, or below it.
    """

    async def download() -> None:
        archive, _ = await in_thread(presented.archive)
        ui.download.content(archive, f"{name}.zip")

    with panel(printable(presented.result.verdict(), 500)) as shown:
        show_remarks(presented.remarks)
        if presented.picture:
            data = base64.b64encode(presented.picture).decode("ascii")
            ui.image(f"data:image/png;base64,{data}").classes("w-full").props(f'alt="figure: {name}" no-spinner')
        figure()
        for listing in presented.listings:
            if not listing.detail:
                quiet(listing.title)
            with fold(printable(listing.title, 100)) if listing.detail else ui.column().classes("w-full"):
                show_listing(listing)
        with ui.row().style("gap: 8px"):
            button("Download results", download, f"download-{name}")
            for label, text in (("command", presented.steps.command), ("Python", presented.steps.python)):
                button(f"Copy as {label}", partial(_copy, text), f"copy-{label.lower()}-{name}")
    return shown


def _copy(text: str) -> None:
    ui.clipboard.write(text)
    ui.notify("copied; it runs in the unpacked folder of “Download results”, which has its files")


def show_listing(listing: Listing) -> None:
    """Show a table of a result; units are in the header."""
    header = [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in listing.header()]
    if listing.vertical:
        cells = zip(*listing.rows(), strict=True)
        table(("", ""), [(title, *values) for title, values in zip(header, cells, strict=True)])
    else:
        texts = [index for index, (column, _) in enumerate(listing.columns.values()) if not column.shown_unit]
        table(header, listing.rows(), texts={0, *texts})
