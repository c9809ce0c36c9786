"""LabVIEW measurement files (.lvm)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mckibben.dataset.sheet import RawColumn, RawTable
from mckibben.dataset.text import read_text
from mckibben.errors import DatasetError, Problem

SIGNATURE = "LabVIEW Measurement"
_END = "***End_of_Header***"


def read_lvm(
    text: str, source: str, known: Callable[[str, str], bool], *, zeros: int = 0, decimal: str = ""
) -> RawTable:
    """Columns of a single-segment file, with units from ``Y_Unit_Label``; ``X_Value`` may be the time [s]."""
    parts = text.split(_END)
    if len(parts) != 3:
        found = f"has {len(parts) - 2} segments" if len(parts) > 3 else "is a LabVIEW measurement without a segment"
        raise DatasetError(source, [Problem(found, remedy="write one segment to a file, or give TDMS")])
    separator = "," if "Separator,Comma" in parts[0] else "\t"
    fields = [line.rstrip().split(separator) for line in parts[1].splitlines()]
    said = {cells[0]: cells[1:] for cells in fields if cells}
    first = text[: text.rindex(_END)].count("\n") + 1
    body = parts[2].partition("\n")[2]
    header, _, rows = body.partition("\n")
    names = header.rstrip("\r\n").split(separator)
    comments = None
    if names[-1] == "Comment":  # its cells are written only if there is a comment
        header = separator.join(names[:-1])
        rows, comments = _without_comments(rows, len(names), separator)
    text = "\n" * first + f"{header}\n{rows}"  # leading blank lines preserve the line numbers
    del parts, fields, body, rows  # of a large text
    sheet = read_text(text, source, known, zeros=zeros, decimal=decimal)
    units = dict(zip(names[1:], said.get("Y_Unit_Label", []), strict=False))
    if said.get("X_Dimension", ["Time"])[:1] == ["Time"]:
        units["X_Value"] = "s"
    if comments is not None:
        lines = sheet.channels[0].lines
        sheet.channels.append(RawColumn("Comment", [comments[line - first - 2] for line in lines], lines))
    if not any(map(str.strip, map(str, sheet.channels[0].cells))):  # X_Columns: No
        del sheet.channels[0]
    sheet.channels = [
        replace(each, short="time" if each.name == "X_Value" else "", unit=each.unit or units.get(each.name, ""))
        for each in sheet.channels
    ]
    return sheet


def _without_comments(rows: str, columns: int, separator: str) -> tuple[str, list[str]]:
    """Rows without their last column, and its cells, empty where a row ends before."""
    bare, comments = [], []
    for line in rows.split("\n"):
        cells = line.split(separator, columns - 1)
        comment = cells[-1] if len(cells) == columns else ""
        bare.append(line[: len(line) - len(comment) - 1] if len(cells) == columns else line)
        comments.append(comment.strip(f"{separator}\r"))
    return "\n".join(bare), comments
