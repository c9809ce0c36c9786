"""Tables of rows as text for a terminal and as Markdown."""

from __future__ import annotations

from rows import Row, Table


def as_text(table: Table) -> str:
    """Columns under each other, notes below their row."""
    header, lines = _header(table), [_cells(table, row) for row in table.rows]
    widths = [max(map(len, column)) for column in zip(header, *lines, strict=True)]
    texts = [table.title, "=" * len(table.title)]
    for row, cells in [(None, header), *zip(table.rows, lines, strict=True)]:
        first, *rest = (cell.rjust(width) for cell, width in zip(cells, widths, strict=True))
        texts.append("  ".join([first.lstrip().ljust(widths[0]), *rest]).rstrip())
        if row is not None and row.note:
            texts.append(f"    {row.note}")
    return "\n".join([*texts, *(f"* {note}" for note in table.notes), ""])


def as_markdown(table: Table) -> str:
    """A section with a table; notes in its last column."""
    lines = [[*_header(table), "note"], *([*_cells(table, row), row.note] for row in table.rows)]
    head, *body = (f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)
    rule = "|" + "|".join(["---", *["---:"] * (len(lines[0]) - 2), "---"]) + "|"
    return "\n".join([f"## {table.title}", "", head, rule, *body, "", *(f"- {note}" for note in table.notes), ""])


def _common_base(table: Table) -> str:
    """The engine that all ratios are to, or none."""
    bases = {row.base for row in table.rows if row.ratio is not None}
    return bases.pop() if len(bases) == 1 else ""


def _header(table: Table) -> list[str]:
    measured = "time" if table.shown == "time" else f"{table.unit}/s"
    base = _common_base(table)
    columns = ["engine", measured, f"ratio to {base}" if base else "ratio", *([] if base else ["to"])]
    return columns + (["deviation"] if table.deviation_of else []) + (["cores busy"] if table.shown == "speed" else [])


def _cells(table: Table, row: Row) -> list[str]:
    time = "-" if row.time is None else _seconds(row.time) if table.shown == "time" else f"{1 / row.time:.2f}"
    cells = [row.engine, time, f"{row.ratio:.3g}" if row.ratio is not None else "-"]
    cells += [] if _common_base(table) else [row.base or "-"]
    if table.deviation_of:
        cells.append(f"{row.deviation:.0e}" if row.deviation is not None else "-")
    if table.shown == "speed":
        cells.append(f"{row.cores:.1f}" if row.cores is not None else "-")
    return cells


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.2f} s"
