"""Tables of rows as text for a terminal and as Markdown."""

from __future__ import annotations

from rows import Row, Table


def as_text(table: Table) -> str:
    """Columns under each other, notes below their row."""
    header, lines = _header(table), [_cells(table, row) for row in table.rows]
    widths = [max(len(line[i]) for line in [header, *lines]) for i in range(len(header))]
    aligned = [
        "  ".join(cell.ljust(width) if i == 0 else cell.rjust(width) for i, (cell, width) in enumerate(pairs)).rstrip()
        for pairs in (list(zip(line, widths, strict=True)) for line in [header, *lines])
    ]
    text = [table.title, "=" * len(table.title), aligned[0], "-" * len(aligned[0])]
    for row, line in zip(table.rows, aligned[1:], strict=True):
        text.append(line)
        if row.note:
            text.append(f"    {row.note}")
    return "\n".join([*text, *(f"* {note}" for note in table.notes), ""])


def as_markdown(table: Table) -> str:
    """A section with a table; notes in its last column."""
    lines = [[*_header(table), "note"], *([*_cells(table, row), row.note] for row in table.rows)]
    head, *body = (f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)
    rule = "|" + "|".join(["---", *["---:"] * (len(lines[0]) - 2), "---"]) + "|"
    return "\n".join([f"## {table.title}", "", head, rule, *body, "", *(f"- {note}" for note in table.notes), ""])


def _header(table: Table) -> list[str]:
    measured = "median (least)" if table.shown == "time" else f"{table.unit}/s: median (best)"
    columns = ["engine", measured, f"ratio of {table.shown}", "against"]
    return columns + (["deviation"] if table.deviation_of else []) + (["cores busy"] if table.shown == "speed" else [])


def _cells(table: Table, row: Row) -> list[str]:
    measured = "-"
    if row.time is not None and row.least is not None:
        median, least = row.time, row.least
        measured = (
            f"{_seconds(median)} ({_seconds(least)})"
            if table.shown == "time"
            else f"{1 / median:.2f} ({1 / least:.2f})"
        )
    cells = [row.engine, measured, f"{row.ratio:.3g}" if row.ratio is not None else "-", row.base or "-"]
    if table.deviation_of:
        cells.append(f"{row.deviation:.0e}" if row.deviation is not None else "-")
    if table.shown == "speed":
        cells.append(f"{row.cores:.1f}" if row.cores is not None else "-")
    return cells


def _seconds(value: float) -> str:
    if value < 1:
        return f"{1e3 * value:.3g} ms"
    return f"{value:.2f} s"
