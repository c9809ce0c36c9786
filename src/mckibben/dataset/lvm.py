"""LabVIEW measurement files (.lvm) to a `Sheet`."""

from __future__ import annotations

from collections.abc import Callable

from mckibben.dataset.sheet import Channel, Sheet
from mckibben.dataset.text import read_text
from mckibben.errors import DatasetError, Problem

SIGNATURE = "LabVIEW Measurement"
_END = "***End_of_Header***"


def read_lvm(text: str, source: str, known: Callable[[str, str], bool], *, zeros: int = 0) -> Sheet:
    """Read a file of one segment: the columns under its second header, units from ``Y_Unit_Label``.

    ``X_Value`` is the time [s] where the file says that its dimension is time.

    Raises
    ------
    DatasetError
        If there is no segment, or more than one.
    """
    parts = text.split(_END)
    if len(parts) != 3:
        found = f"has {len(parts) - 2} segments" if len(parts) > 3 else "is a LabVIEW measurement without a segment"
        raise DatasetError(source, [Problem(found, remedy="write one segment to a file, or give TDMS")])
    fields = [line.rstrip().split("\t") for line in parts[1].splitlines()]
    said = {cells[0]: cells[1:] for cells in fields if cells}
    first = text[: text.rindex(_END)].count("\n") + 1
    body = parts[2].partition("\n")[2]
    header, _, rows = body.partition("\n")
    names = header.rstrip("\r\n").split("\t")
    if names[-1] == "Comment":  # its cells are written only where there is a comment
        rows = "".join(_padded(line, len(names)) for line in rows.splitlines(keepends=True))
    # the lines before are put back blank, so that every row keeps its number
    sheet = read_text("\n" * first + f"{header}\n{rows}", source, known, zeros=zeros)
    units = dict(zip(names[1:], said.get("Y_Unit_Label", []), strict=False))
    if said.get("X_Dimension", ["Time"])[:1] == ["Time"]:
        units["X_Value"] = "s"
    sheet.channels = [
        Channel(
            each.name,
            each.cells,
            each.lines,
            "time" if each.name == "X_Value" else "",
            each.unit or units.get(each.name, ""),
        )
        for each in sheet.channels
    ]
    return sheet


def _padded(line: str, cells: int) -> str:
    """A row with the cell of its comment, if that alone is missing."""
    content = line.rstrip("\r\n")
    missing = cells - 1 - content.count("\t")
    return f"{content}\t{line[len(content) :]}" if missing == 1 and content.strip() else line
