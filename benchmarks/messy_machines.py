"""Kinds of messy files: exports of test machines, and workbooks.

Importing this adds them to `KINDS`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, text, third, workbook
from messy_loggers import times, with_times
from messy_rows import levels, means

# Test machines


@kind
def zwick_with_units_in_the_header(p, rng):
    header = ("Prüfzeit [s]", "Druck [bar]", "Kontraktion [%]", "Zugkraft [N]")
    return csv(p, "Zwick testXpert\n\n" + text(with_times(p, ","), header, end="\r\n"), "rig.csv", "cp1252")


@kind
def instron_with_units_in_the_header(p, rng):
    rows = [[f'"{one}"' for one in row] for row in with_times(p)]
    return csv(p, text(rows, ('"Time (s)"', '"Pressure (bar)"', '"Contraction (%)"', '"Force (N)"'), ","))


@kind
def machine_in_megapascals_and_kilonewtons(p, rng):
    rows = [[repr(a / 10), repr(b / 100), repr(c / 1000)] for a, b, c in numbers(p)]
    return csv(p, text(rows, ("Pressure [MPa]", "Contraction [-]", "Force [kN]"), "\t"), "rig.txt")


@kind
def fluidtester_in_hectopascals(p, rng):
    rows = [[f"{1000 * a:.1f}", f"{b:g}", f"{c:g}"] for a, b, c in numbers(p)]
    return csv(p, text(rows, ("Pressure [mbar]", *HEADER[1:])))


@kind
def zwick_tra(p, rng):
    head = "Prüfmaschine Zwick Z010\r\nPrüfer;Müller\r\n\r\n"
    header = ("Prüfzeit", "Druck", "Kontraktion", "Standardkraft")
    rows = [["s", "bar", "%", "N"], *with_times(p, ",")]
    mapped = {"Standardkraft": "force_N", "Druck": "pressure_bar", "Kontraktion": "contraction_percent"}
    return csv(p, head + text(rows, header, end="\r\n"), "rig.TRA", "cp1252", columns=mapped)


@kind
def zwick_without_mapping(p, rng):
    rows = [["s", "bar", "mm", "N"], *with_times(p, ",")]
    return csv(p, text(rows, ("Prüfzeit", "Druck", "Standardweg", "Standardkraft")), "rig.TRA", "cp1252")


@kind
def zwick_in_kilonewtons_by_its_row_of_units(p, rng):
    forces = [repr(float(f) / 1000).replace(".", ",") for f in p.force]
    rows = [["bar", "%", "kN"], *third(cells(p, ","), forces)]
    return csv(p, text(rows, ("Druck", "Kontraktion", "Kraft")), "rig.TRA")


@kind
def instron_bluehill(p, rng):
    """Quoted, with units in brackets in a second row, and results above the table."""
    head = '"Results Table 1"\n"","Maximum Load (N)"\n"1","' + f'{p.force.max():g}"\n\n'
    rows = [[f'"{one}"' for one in row] for row in cells(p)]
    return csv(p, head + text([['"(bar)"', '"(%)"', '"(N)"'], *rows], ('"Pressure"', '"Contraction"', '"Load"'), ","))


@kind
def instron_with_load_mapped(p, rng):
    rows = [[f'"{one}"' for one in row] for row in cells(p)]
    content = text([['"(bar)"', '"(%)"', '"(N)"'], *rows], ('"Pressure"', '"Contraction"', '"Load"'), ",")
    return csv(p, content, columns={"Load": "force_N"})


@kind
def instron_load_in_kilonewtons_mapped_as_newtons(p, rng):
    rows = third(cells(p), [repr(float(f) / 1000) for f in p.force])
    content = text([["(bar)", "(%)", "(kN)"], *rows], ("Pressure", "Contraction", "Load"), ",")
    return csv(p, content, columns={"Load": "force_N"})


@kind
def mts_with_cycles(p, rng):
    head = "MTS793|MPT|ENU|1|2|/|.|/|:|1|0|0|A\n\nData Acquisition:Timed\t\tTime:\t0.5\tSec\n"
    rows = [["bar", "%", "N"], *cells(p)]
    return csv(p, head + text(rows, ("Pressure", "Contraction", "Axial Force"), "\t"), "specimen.dat")


@kind
def shimadzu_with_names_and_units_in_two_rows(p, rng):
    rows = [["sec", "bar", "%", "N"], *with_times(p)]
    return csv(p, '"Test name","muscle"\n' + text(rows, ("Time", "Pressure", "Contraction", "Force"), ","))


@kind
def machine_with_a_push_counted_positive(p, rng):
    return csv(p, text(third(cells(p), [f"-{f:g}" for f in p.force]), (*HEADER[:2], "Load cell force [N]")))


@kind
def machine_at_its_limit_of_force(p, rng):
    """The machine reports its range, 80 % of the largest force, in place of all above."""
    top = round(0.6 * float(p.force.max()), 1)
    return csv(p, text(third(cells(p), [f"{min(f, top):g}" for f in p.force])))


@kind
def tinius_olsen_with_positions(p, rng):
    head = "Horizon\nTest Name:,Muscle tension\nDate:,3/12/2024\nSpecimen:,1\n\n"
    strokes = [f"{180 * b / 100:.6f}" for b in p.contraction]
    rows = [[t, s, c, a] for t, s, (a, _, c) in zip(times(p), strokes, cells(p), strict=True)]
    header = ("Time (sec)", "Position (mm)", "Force (N)", "Aux Pressure (bar)")
    options = {
        "columns": {"Position (mm)": "displacement_mm", "Aux Pressure (bar)": "pressure_bar"},
        "displacement": "shortening",
        "initial_length": 0.18,
    }
    return csv(p, head + text(rows, header, ","), **options)


@kind
def tinius_olsen_with_positions_of_the_crosshead(p, rng):
    """The crosshead's position grows as the muscle is stretched; the user has said the reverse."""
    p = p.without([i for i in range(len(p.force)) if p.contraction[i] == 0])
    strokes = [f"{-180 * b / 100:.6f}" for b in p.contraction]
    rows = [[t, s, c, a] for t, s, (a, _, c) in zip(times(p), strokes, cells(p), strict=True)]
    header = ("Time (sec)", "Stroke (mm)", "Force (N)", "Pressure (bar)")
    return csv(p, text(rows, header, ","), displacement="shortening", initial_length=0.18)


@kind
def instron_in_kilonewtons_by_its_row_of_units(p, rng):
    rows = [["(sec)", "(bar)", "(%)", "(kN)"], *[[*r[:3], f"{float(r[3]) / 1000:.7f}"] for r in with_times(p)]]
    return csv(p, text(rows, ("Time", "Pressure", "Contraction", "Force"), ","))


@kind
def instron_with_quoted_thousands(p, rng):
    p = replace(p.large(), force=p.large().force + 0.25)
    return csv(p, text([[f'"{float(c):,.2f}"' for c in row] for row in cells(p)], [f'"{h}"' for h in HEADER], ","))


@kind
def zwick_with_force_at_preload(p, rng):
    """The force of a preload in a column of its own."""
    rows = [[*row, "5"] for row in cells(p, ",")]
    return csv(p, text(rows, ("Druck [bar]", "Kontraktion [%]", "Kraft [N]", "Vorkraft [N]")), "rig.csv", "cp1252")


# German and other Excel


@kind
def german_excel_with_thousands_and_units_in_cells(p, rng):
    rows = [[f"{a} bar", f"{b} %", f"{c} N"] for a, b, c in cells(p, ",")]
    return csv(p, text(rows, ("Druck", "Kontraktion", "Kraft")), encoding="cp1252")


@kind
def german_excel_with_dates_for_decimals(p, rng):
    """Excel has made a date of a pressure such as 2.5."""
    rows = cells(p, ",")
    at = int(rng.integers(len(rows)))
    rows[at][0] = "02. Mai"
    return replace(csv(p, text(rows, ("Druck [bar]", "Kontraktion [%]", "Kraft [N]"))), truth=p.without([at]))


@kind
def german_excel_with_rows_for_each_pressure(p, rng):
    """The pressure stands only in the first row of its block."""
    p = replace(p, pressure=np.concatenate([np.full(len(p.force[at]), p.pressure[at][0]) for at in levels(p)]))
    rows = cells(p, ",")
    for block in levels(p):
        for row in rows[block][1:]:
            row[0] = ""
    return csv(p, text(rows, ("Druck [bar]", "Kontraktion [%]", "Kraft [N]")))


@kind
def german_excel_with_mittelwert(p, rng):
    rows = [*cells(p, ","), ["Mittelwert", f"{p.contraction.mean():.1f}".replace(".", ","), f"{p.force.mean():.1f}"]]
    return csv(p, text(rows, ("Druck [bar]", "Kontraktion [%]", "Kraft [N]")))


@kind
def workbook_with_numbers_and_units_in_one_cell(p, rng):
    rows = [[f"{a} bar", f"{b} %", f"{c} N"] for a, b, c in cells(p, ",")]
    return File("rig.xlsx", workbook([("Druck", "Kontraktion", "Kraft"), *rows]), p)


@kind
def workbook_with_a_struck_out_row(p, rng):
    """A row that its author struck out."""
    from openpyxl.styles import Font

    rows = numbers(p)
    at = int(rng.integers(1, len(rows) - 1))
    rows[at][2] = rows[at][2] * 0.4

    def strike(book):
        for cell in book.active[at + 2]:
            cell.font = Font(strike=True)

    return File("rig.xlsx", workbook([(*HEADER, "note"), *([*row, None] for row in rows)], strike), p.without([at]))


@kind
def workbook_with_a_mean_of_each_block(p, rng):
    rows = []
    for block in levels(p):
        rows += numbers(p)[block] + [list(map(float, means(p, block)))]
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


@kind
def workbook_filtered(p, rng):
    """A filter hides rows of which one is wrong."""
    rows = numbers(p)
    rows.insert(2, [rows[2][0], rows[2][1], 3 * rows[2][2]])

    def hide(book):
        book.active.row_dimensions[4].hidden = True

    return File("rig.xlsx", workbook([HEADER, *rows], hide), p)


@kind
def workbook_with_merged_names_over_units(p, rng):
    """Force merged over two columns, in N and in lbf."""
    rows = [[a, b, c, c / 4.4482216152605] for a, b, c in numbers(p)]

    def merge(book):
        book.active.merge_cells("C1:D1")

    return File(
        "rig.xlsx", workbook([("Pressure", "Contraction", "Force", None), ("bar", "%", "N", "lbf"), *rows], merge), p
    )


@kind
def workbook_with_merged_set_and_measured(p, rng):
    rows = [[round(a * 2) / 2, a, b, c] for a, b, c in numbers(p)]

    def merge(book):
        book.active.merge_cells("A1:B1")

    head = [("Pressure [bar]", None, "Contraction [%]", "Force [N]"), ("set", "measured", None, None)]
    return File("rig.xlsx", workbook([*head, *rows], merge), p)


@kind
def workbook_with_two_muscles_side_by_side(p, rng):
    rows = [[*row, None, row[0], row[1], row[2] * 1.6] for row in numbers(p)]
    return File("rig.xlsx", workbook([("Muscle A", None, None, None, "Muscle B"), (*HEADER, None, *HEADER), *rows]), p)


@kind
def workbook_with_two_tables_of_other_units(p, rng):
    half = len(p.force) // 2
    rows = numbers(p)
    second = [[100 * a, b, c] for a, b, c in rows[half:]]
    return File("rig.xlsx", workbook([HEADER, *rows[:half], [], ("Pressure [kPa]", *HEADER[1:]), *second]), p)


@kind
def workbook_shown_in_thousands(p, rng):
    """Forces in newtons under kN, because their format shows thousands."""

    def shown(book):
        for (cell,) in book.active.iter_rows(min_row=2, min_col=3, max_col=3):
            cell.number_format = "0.000,"

    return File("rig.xlsx", workbook([(*HEADER[:2], "Force [kN]"), *numbers(p)], shown), p)


@kind
def workbook_with_other_units_in_the_format(p, rng):
    """Cells that show 250 kPa, under bar."""

    def shown(book):
        for (cell,) in book.active.iter_rows(min_row=2, max_col=1):
            cell.number_format = '0" kPa"'

    return File("rig.xlsx", workbook([HEADER, *([100 * a, b, c] for a, b, c in numbers(p))], shown), p)
