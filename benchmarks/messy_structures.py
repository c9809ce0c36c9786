"""Kinds of messy files: restarts, several tables, footers, delimiters and encodings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, one_of, plain, text, workbook


def block(p):
    """Rows of a level."""
    return int(np.argmax(np.append(np.abs(np.diff(p.pressure)) > 0.06, True))) + 1


@kind
def restart_with_columns_in_another_order(p, rng):
    half = len(p.force) // 2
    rows = cells(p)
    return csv(p, text(rows[:half]) + text([r[::-1] for r in rows[half:]], HEADER[::-1]))


@kind
def restart_in_another_unit(p, rng):
    half = len(p.force) // 2
    rows = cells(p)
    return csv(
        p,
        text(rows[:half])
        + text([[plain(float(a) * 100), b, c] for a, b, c in rows[half:]], ("Pressure [kPa]", *HEADER[1:])),
    )


@kind
def restart_with_mark_of_the_encoding(p, rng):
    half = len(p.force) // 2
    rows = cells(p)
    return csv(p, "\ufeff" + text(rows[:half]) + "\ufeff" + text(rows[half:]))


@kind
def restart_with_preamble(p, rng):
    half = len(p.force) // 2
    rows = cells(p)
    head = "Logger v2\nStart: 2024-03-01 10:00\n"
    return csv(p, head + text(rows[:half]) + "\n" + head + text(rows[half:]))


@kind
def table_of_calibration_before(p, rng):
    head = "Calibration\nV;bar\n0;0\n5;10\n\nMeasurement\n"
    return csv(p, head + text(cells(p)))


@kind
def calibration_table_with_same_names_before(p, rng):
    head = "Calibration\nPressure [bar];Force [N]\n0;0.1\n5;500.2\n\nMeasurement\n"
    return csv(p, head + text(cells(p)))


@kind
def side_by_side(p, rng):
    q = cells(replace(p, force=(p.force * 0.5).round(1)))
    return csv(p, text([[*a, "", *b] for a, b in zip(cells(p), q, strict=False)], (*HEADER, "", *HEADER)))


@kind
def side_by_side_with_numbers(p, rng):
    q = cells(replace(p, force=(p.force * 0.5).round(1)))
    return csv(p, text([[*a, *b] for a, b in zip(cells(p), q, strict=False)], (*HEADER, *(f"{n}.1" for n in HEADER))))


@kind
def loading_and_unloading_side_by_side(p, rng):
    q = cells(replace(p, force=(p.force * 0.9).round(1)))
    return csv(
        p,
        text([[*a, b[2]] for a, b in zip(cells(p), q, strict=False)], (*HEADER[:2], "Force up [N]", "Force down [N]")),
    )


@kind
def pivot(p, rng):
    n = block(p)
    eps = p.contraction[:n]
    levels = len(p.force) // n
    f = p.force.reshape(levels, -1)
    q = replace(p, pressure=np.repeat(np.arange(1.0, levels + 1), n))
    return csv(
        q,
        text(
            [[plain(e), *map(plain, f[:, i])] for i, e in enumerate(eps)],
            ("Contraction [%]", *(f"Force [N] at {k} bar" for k in range(1, levels + 1))),
        ),
    )


@kind
def blocks_under_titles_of_pressure(p, rng):
    p = replace(p, pressure=np.repeat(p.pressure[:: block(p)], block(p)))
    out = "Contraction [%];Force [N]\n"
    last = None
    for (a, b, c), lv in zip(cells(p), np.repeat(np.arange(20), block(p)), strict=False):
        if lv != last:
            out += f"p = {a} bar\n"
            last = lv
        out += f"{b};{c}\n"
    return csv(p, out)


@kind
def pressure_only_in_first_row_of_block(p, rng):
    n = block(p)
    q = replace(p, pressure=np.repeat(p.pressure[::n], n))
    rows = [[a if i % n == 0 else "", b, c] for i, (a, b, c) in enumerate(cells(q))]
    return csv(q, text(rows))


@kind
def workbook_with_merged_pressures(p, rng):
    n = block(p)
    q = replace(p, pressure=np.repeat(p.pressure[::n], n))
    rows = [[a if i % n == 0 else None, b, c] for i, (a, b, c) in enumerate(numbers(q))]

    def merge(book):
        for k in range(0, len(rows), n):
            book.active.merge_cells(start_row=k + 2, end_row=k + 1 + n, start_column=1, end_column=1)

    return File("rig.xlsx", workbook([HEADER, *rows], merge), q)


@kind
def footer_of_statistics(p, rng):
    stats = [
        ["Mean", *(f"{v.mean():.3f}" for v in (p.contraction, p.force))],
        ["Std", *(f"{v.std():.3f}" for v in (p.contraction, p.force))],
    ]
    return csv(p, text(cells(p)) + "".join(";".join(r) + "\n" for r in stats))


@kind
def footer_of_maximum_without_label(p, rng):
    return csv(p, text(cells(p)) + "\n" + ";".join(plain(v.max()) for v in (p.pressure, p.contraction, p.force)) + "\n")


@kind
def footer_of_standard_deviation_without_label(p, rng):
    return csv(
        p,
        text(cells(p))
        + "\n"
        + ";".join(plain(round(v.std(ddof=1), 3)) for v in (p.pressure, p.contraction, p.force))
        + "\n",
    )


@kind
def footer_of_counts(p, rng):
    return csv(p, text(cells(p)) + f"n={len(p.force)};;\nSigned: A. B.;;\n")


@kind
def index_row_of_numbers(p, rng):
    return csv(p, "1;2;3\n" + text(cells(p)))


@kind
def nominal_row_first(p, rng):
    """A row of zeros before the valve opens: recorded, and true."""
    return csv(
        type(p)(*(np.append(0, v) for v in (p.pressure, p.contraction, p.force))), text([["0", "0", "0"], *cells(p)])
    )


@kind
def missing_cell_between_blanks(p, rng):
    rows = [["pressure_bar", "contraction_percent", "force_N", "temp"], *([*r, "21.5"] for r in cells(p))]
    at = int(rng.integers(1, len(rows)))
    rows[at][2] = ""
    return csv(p.without([at - 1]), "".join("".join(f"{c:>20}" for c in row) + "\n" for row in rows), "rig.dat")


@kind
def header_commas_rows_semicolons(p, rng):
    return csv(p, ",".join(HEADER) + "\n" + "".join(";".join(r) + "\n" for r in cells(p)))


@kind
def comma_and_blank(p, rng):
    return csv(p, text(cells(p), HEADER, ", "))


@kind
def double_carriage_returns(p, rng):
    return csv(p, text(cells(p), end="\r\r\n"))


@kind
def utf16_without_mark(p, rng):
    return csv(p, text(cells(p)), encoding=one_of(rng, ["utf-16-le", "utf-16-be"]))


@kind
def mac_roman(p, rng):
    return csv(p, text(cells(p, ","), ("Druck [bar]", "Verkürzung [%]", "Kraft [N]")), encoding="mac_roman")


@kind
def dos_code_page(p, rng):
    return csv(p, text(cells(p, ","), ("Druck [bar]", "Verkürzung [%]", "Kraft [N]")), encoding="cp850")
