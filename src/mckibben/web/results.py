"""The view of results, one for all pages: verdict, remarks, figure, tables, and a download of all of them."""

from __future__ import annotations

import base64
import io
import threading
import zipfile
from typing import NamedTuple

from nicegui import ui

from mckibben.errors import printable
from mckibben.report import png_of
from mckibben.result import Listing, Remark, Result
from mckibben.storage.files import to_json
from mckibben.web.layout import button, panel, quiet, show_remarks, table

_RESOLUTION = 150  # dpi
_drawing = threading.Lock()  # the house style is set for the whole process while a figure is drawn


class Presented(NamedTuple):
    """What is shown of a result, computed in the thread of its job; `picture` is a PNG, empty without a figure."""

    result: Result
    remarks: tuple[Remark, ...]
    listings: tuple[Listing, ...]
    picture: bytes

    @classmethod
    def of(cls, result: Result) -> Presented:
        """Compute the tables of a result, and draw its first figure."""
        with _drawing:
            picture = png_of(result.plot(), _RESOLUTION) if result.figures else b""
        return cls(result, tuple(result.remarks()), tuple(result.listings()), picture)

    def archive(self) -> bytes:
        """Zip file of results.json and the figure."""
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as folder:
            folder.writestr("results.json", to_json(self.result.to_dict()))
            if self.picture:
                folder.writestr("figure.png", self.picture)
        return content.getvalue()


def show_result(presented: Presented, name: str) -> ui.column:
    """Show a result in a panel, to which the page may add; `name` is that of the download."""
    with panel(printable(presented.result.verdict(), 500)) as shown:
        show_remarks(presented.remarks)
        if presented.picture:
            data = base64.b64encode(presented.picture).decode("ascii")
            ui.image(f"data:image/png;base64,{data}").classes("w-full").props(f'alt="figure: {name}" no-spinner')
        for listing in presented.listings:
            if listing.detail:
                with ui.expansion(printable(listing.title, 100)).props("dense").classes("w-full"):
                    show_listing(listing)
            else:
                quiet(listing.title)
                show_listing(listing)
        button("Download results", lambda: ui.download.content(presented.archive(), f"{name}.zip"), f"download-{name}")
    return shown


def show_listing(listing: Listing) -> None:
    """Show a table of a result; units are in the header."""
    header = [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in listing.header()]
    if listing.vertical:
        table(
            ("", ""), [(title, *cells) for title, cells in zip(header, zip(*listing.rows(), strict=True), strict=True)]
        )
    else:
        texts = [index for index, (column, _) in enumerate(listing.columns.values()) if not column.shown_unit]
        table(header, listing.rows(), texts={0, *texts})
