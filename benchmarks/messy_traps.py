"""Kinds of messy files whose numbers look right: only a unit, a comment or another column shows that they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from messy_kinds import (
    HEADER,
    File,
    cells,
    csv,
    grouped,
    hdf5,
    kind,
    numbers,
    one_of,
    packed,
    plain,
    text,
    third,
    workbook,
)
from messy_notations import scaled


@kind
def units_in_columns_kgf(p, rng):
    rows = [
        [a, b, c, "N"] if i % 3 else [a, b, plain(round(float(c) / 9.80665, 4)), "kgf"]
        for i, (a, b, c) in enumerate(cells(p))
    ]
    return csv(p, text(rows, ("Pressure [bar]", "Contraction [%]", "Force", "Unit")))


@kind
def unit_column_contradicts(p, rng):
    rows = [[a, b, plain(round(float(c) / 9.80665, 6)), "kgf"] for i, (a, b, c) in enumerate(cells(p))]
    return csv(p, text(rows, (*HEADER, "Force unit")))


@kind
def comment_force_in_kgf(p, rng):
    return csv(
        p,
        one_of(
            rng,
            [
                "# force in kgf\n",
                "Force unit;kgf\n",
                "# load cell output: kgf\n",
                "# units: bar, %, kgf\n",
                "# p [bar], eps [%], F [kgf]\n",
                "Kraft in daN\n",
            ],
        )
        + text(scaled(p, 2, 1 / 9.80665)),
    )


@kind
def comment_force_in_decanewtons(p, rng):
    return csv(
        p,
        one_of(rng, ["# all forces in daN\n", "# Kraft: daN\n", "Einheiten;bar;%;daN\n"]) + text(scaled(p, 2, 0.1)),
    )


@kind
def comment_pressure_in_psi_x(p, rng):
    """In technical atmospheres, as a comment says."""
    return csv(
        p,
        one_of(rng, ["# pressure in kgf/cm2\n", "# pressure unit: at\n", "# p in atm\n"])
        + text(scaled(p, 0, 1 / 0.980665)),
    )


@kind
def comment_between_rows_force(p, rng):
    rows = cells(p)
    n = len(rows) // 2
    return csv(
        p,
        text(rows[:n])
        + "# from here load cell 2, kgf\n"
        + text(
            [[a, b, plain(round(float(c) / 9.80665, 3))] for a, b, c in rows[n + 1 :]],
            [rows[n][0], rows[n][1], plain(round(float(rows[n][2]) / 9.80665, 3))],
        ),
    )


@kind
def footer_says_unit(p, rng):
    return csv(
        p,
        text(scaled(p, 2, 1 / 9.80665))
        + one_of(rng, ["# force in kgf\n", "Note: force in kgf\n", "Note: forces must be multiplied by 9.81;;\n"]),
    )


@kind
def header_line_of_sensor_scaling(p, rng):
    return csv(
        p,
        one_of(
            rng,
            [
                "Sensitivity;2.0 mV/V\n",
                "Scaling: 1 V = 100 N, file in 100 N\n",
                "Calibration: F = 9.81 * reading\n",
                "# F_true = 9.81 x F\n",
                "# correct force by +3 %\n",
            ],
        )
        + text(scaled(p, 2, 1 / 9.80665)),
    )


@kind
def contraction_of_nominal_length(p, rng):
    """Contraction [%] measured from the stretched length; a comment says so."""
    return csv(
        p,
        one_of(
            rng,
            [
                "# contraction referred to stretched length 258 mm\n",
                "# contraction relative to mounted length, not initial length\n",
            ],
        )
        + text([[a, plain(round(100 * (1 - 250 * (1 - float(b) / 100) / 258), 4)), c] for a, b, c in cells(p)]),
    )


@kind
def displacement_with_preload_offset(p, rng):
    """Length column includes fittings of 60 mm."""
    rows = [[a, plain(round(250 * (1 - float(b) / 100) + 60, 4)), c] for a, b, c in cells(p)]
    return csv(
        p,
        "# lengths include 60 mm of fittings\n" + text(rows, (HEADER[0], "Length [mm]", HEADER[2])),
        initial_length=0.31,
    )


@kind
def force_peak_and_average(p, rng):
    return csv(
        p,
        text(
            [[a, b, plain(round(float(c) * 1.2, 3)), c] for a, b, c in cells(p)],
            (*HEADER[:2], "Force max [N]", "Force avg [N]"),
        ),
    )


@kind
def set_and_actual_swapped_names(p, rng):
    rows = [[plain(round(float(a))), a, b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [bar]", "Pressure actual [bar]", *HEADER[1:])))


@kind
def supply_pressure_named_pressure1(p, rng):
    rows = [["8.1", a, b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure 1 [bar]", "Pressure 2 [bar]", *HEADER[1:])))


@kind
def supply_pressure_ch1(p, rng):
    rows = [[plain(round(float(a) + 0.9, 2)), a, b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("CH1 Pressure [bar]", "Muscle [bar]", *HEADER[1:])))


@kind
def pressure_at_valve(p, rng):
    rows = [[plain(round(float(a) + 0.6, 2)), a, b, c] for a, b, c in cells(p)]
    return csv(
        p,
        text(
            rows,
            (
                "Pressure [bar]",
                one_of(
                    rng,
                    [
                        "Muscle pressure [bar]",
                        "p muscle [bar]",
                        "p_Muskel [bar]",
                        "Pressure muscle [bar]",
                        "Internal pressure [bar]",
                    ],
                ),
                *HEADER[1:],
            ),
        ),
    )


@kind
def decimal_three_digits_one_row(p, rng):
    """Thousands under whole numbers, and temperatures with decimals, which do not settle them."""
    p = p.huge()
    p = replace(p, pressure=p.pressure.round(), contraction=p.contraction.round())
    rows = third(cells(p), [grouped(f, ".", ",") for f in p.force])
    return csv(p, text([[r[0], r[1], r[2], "21.5"] for r in rows], (*HEADER, "Temp [C]")))


@kind
def thousands_with_decimal_index(p, rng):
    p = p.huge()
    p = replace(p, pressure=p.pressure.round(), contraction=p.contraction.round())
    rows = third(cells(p), [grouped(f, ".", ",") for f in p.force])
    return csv(p, text([[f"{1 + i // 5}.{1 + i % 5}", *r] for i, r in enumerate(rows)], ("No.", *HEADER)))


@kind
def mixed_thousand_in_one_column(p, rng):
    """Comma decimals in pressure, point thousands in force, contraction whole."""
    p = p.huge()
    p = replace(p, contraction=p.contraction.round())
    return csv(p, text(third(cells(p, ","), [grouped(f, ".", ",") for f in p.force])))


@kind
def rows_interleaved_of_two_muscles(p, rng):
    q = replace(p, force=(p.force * 0.55).round(2))
    rows = [r for pair in zip(cells(p), cells(q), strict=False) for r in pair]
    return csv(p, text(rows))


@kind
def forces_sorted(p, rng):
    """Column of forces sorted in Excel apart from the others."""
    return csv(p, text(cells(replace(p, force=np.sort(p.force)))))


@kind
def series_filled_by_excel(p, rng):
    """Dragging the pressure down in Excel counts it up: 3, 4, 5 ..."""
    q = np.arange(1, len(p.force) + 1) * 0.25 + 1
    return csv(p, text(cells(replace(p, pressure=q.round(2)))))


@kind
def pressure_in_bar_absolute_low(p, rng):
    rows = [[plain(round(float(a) + 1.013, 3)), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows))


@kind
def excel_formula_cached_zero(p, rng):
    rows = numbers(p)
    rows[4][2] = 0
    rows[9][2] = 0
    return File("rig.xlsx", workbook([HEADER, *rows]), p.without([4, 9]))


@kind
def excel_text_before_numbers(p, rng):
    rows = numbers(p)
    rows[4][2] = f"ca. {rows[4][2]}"
    rows[5][2] = f"{rows[5][2]}?"
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


@kind
def excel_second_header_hidden_right(p, rng):
    rows = [[*r, None, *[x * 0.9 for x in r]] for r in numbers(p)]
    return File("rig.xlsx", workbook([(*HEADER, None, "Pressure (bar)", "Contraction (%)", "Force (N)"), *rows]), p)


@kind
def hdf5_unit_and_name_prefix(p, rng):
    return hdf5(p, lambda f: f["Force"].attrs.update(units="N", long_name="force per fibre, 10 fibres"))


@kind
def hdf5_int_hundredths(p, rng):
    return hdf5(p, lambda f: packed(f, "Force", (p.force * 10).round().astype(np.int32), comment="0.1 N per digit"))


@kind
def hdf5_offset_attr(p, rng):
    return hdf5(p, lambda f: packed(f, "Force", p.force + 12.5, zero=12.5))
