"""Kinds of messy files: spellings of numbers, units and names, and comments that say more than the names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from messy_kinds import HEADER, cells, csv, grouped, kind, one_of, plain, text, third

UNITLESS = ("Pressure", "Contraction", "Force")


def scaled(p, column, factor, digits=6):
    rows = cells(p)
    for row in rows:
        row[column] = plain(round(float(row[column]) * factor, digits))
    return rows


def renamed(column, name):
    header = list(HEADER)
    header[column] = name
    return header


@kind
def unit_row_above_the_names(p, rng):
    return csv(p, text([list(UNITLESS), *cells(p)], ("bar", "%", "N")))


@kind
def three_rows_of_header_mean(p, rng):
    return csv(p, text([["(bar)", "(%)", "(N)"], ["Mean"] * 3, *cells(p)], UNITLESS))


@kind
def blank_line_between_names_and_units(p, rng):
    return csv(p, "Pressure;Contraction;Force\n\nbar;%;N\n\n" + text(cells(p)[1:], cells(p)[0]))


@kind
def barg_glued(p, rng):
    return csv(
        p,
        text(
            cells(p),
            renamed(
                0, rng.choice(["Pressure [barg]", "Pressure [bar(g)]", "Pressure (bar gauge)", "Gauge pressure [bar]"])
            ),
        ),
    )


@kind
def absolute_variants(p, rng):
    rows = [[plain(round(float(a) + 1.013, 3)), b, c] for a, b, c in cells(p)]
    return csv(
        p,
        text(
            rows,
            renamed(
                0,
                one_of(
                    rng,
                    [
                        "Pressure [bara]",
                        "Pressure [bar(a)]",
                        "Abs. pressure [bar]",
                        "p_abs [bar]",
                        "Absolute pressure [bar]",
                        "Pressure_abs [bar]",
                        "Pressure [bar absolute]",
                    ],
                ),
            ),
        ),
    )


@kind
def absolute_hectopascal_of_a_phone(p, rng):
    rows = [[plain(round(float(a) * 1000 + 1013, 3)), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, renamed(0, "Pressure (hPa)")))


@kind
def absolute_pressure_said_by_barometer_column(p, rng):
    rows = [[plain(round(float(a) + 1.013, 3)), b, c, "1.013"] for a, b, c in cells(p)]
    return csv(p, text(rows, (*HEADER, "Ambient pressure [bar]")))


@kind
def technical_atmospheres(p, rng):
    return csv(
        p,
        text(
            scaled(p, 0, 1 / 0.980665, 9),
            renamed(0, one_of(rng, ["Pressure [kgf/cm2]", "Pressure [kg/cm²]", "Pressure [at]"])),
        ),
    )


@kind
def kilograms_of_force(p, rng):
    return csv(
        p,
        text(
            scaled(p, 2, 1 / 9.80665, 9),
            renamed(2, one_of(rng, ["Force [kg]", "Load [kg]", "Force [kp]", "Force [kgf]"])),
        ),
    )


@kind
def centinewtons(p, rng):
    return csv(p, text(scaled(p, 2, 100), renamed(2, "Force [cN]")))


@kind
def force_times_ten(p, rng):
    return csv(
        p,
        text(
            scaled(p, 2, 0.1),
            renamed(
                2,
                one_of(
                    rng,
                    [
                        "Force [N x10]",
                        "Force [10 N]",
                        "Force x10 [N]",
                        "Force*10 [N]",
                        "Force [N*10]",
                        "Force /10 [N]",
                    ],
                ),
            ),
        ),
    )


@kind
def permille(p, rng):
    return csv(p, text(scaled(p, 1, 10), renamed(1, "Contraction [‰]")))


@kind
def millimetres_per_metre(p, rng):
    return csv(p, text(scaled(p, 1, 10), renamed(1, "Contraction [mm/m]")))


@kind
def metre_per_metre(p, rng):
    return csv(
        p,
        text(
            scaled(p, 1, 0.01),
            renamed(
                1,
                one_of(
                    rng,
                    [
                        "Contraction [m/m]",
                        "Contraction [mm/mm]",
                        "Contraction [1]",
                        "Contraction ratio [-]",
                        "Contraction ratio",
                        "epsilon [-]",
                    ],
                ),
            ),
        ),
    )


@kind
def remaining_length_in_percent(p, rng):
    rows = [[a, plain(round(100 - float(b), 6)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, renamed(1, one_of(rng, ["Length [%]", "Contraction [%]"]))))


@kind
def lengths_in_micrometres(p, rng):
    rows = [[a, plain(round(250000 * (1 - float(b) / 100))), c] for a, b, c in cells(p)]
    return csv(p, text(rows, renamed(1, "Length [µm]")), initial_length=0.25)


@kind
def lengths_in_inches(p, rng):
    rows = [[a, repr(10 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(
        p,
        text(rows, renamed(1, one_of(rng, ["Length [in.]", 'Length ["]', "Length [inch]", "Length [IN]"]))),
        initial_length=0.254,
    )


@kind
def shortening_in_millimetres(p, rng):
    rows = [[a, plain(round(2.5 * float(b), 4)), c] for a, b, c in cells(p)]
    return csv(
        p,
        text(rows, renamed(1, one_of(rng, ["Contraction [mm]", "Shortening [mm]", "Verkürzung [mm]"]))),
        initial_length=0.25,
    )


@kind
def both_contractions(p, rng):
    rows = [[a, plain(round(2.5 * float(b), 4)), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Contraction [mm]", "Contraction [%]", HEADER[2])))


@kind
def same_force_in_two_units(p, rng):
    rows = [[*row, plain(round(float(row[2]) / 4.4482216152605, 5))] for row in cells(p)]
    return csv(p, text(rows, (*HEADER, "Force [lbf]")))


@kind
def same_pressure_in_two_units(p, rng):
    rows = [[plain(round(float(row[0]) / 0.0689475729, 3)), *row] for row in cells(p)]
    return csv(p, text(rows, ("Pressure [psi]", *HEADER)))


@kind
def two_pressures_that_differ(p, rng):
    rows = [[plain(round(float(row[0]) * 14.5038 * 1.07, 3)), *row] for row in cells(p)]
    return csv(p, text(rows, ("Pressure [psi]", *HEADER)))


@kind
def units_in_angle_brackets(p, rng):
    return csv(p, text(cells(p), ("Pressure <bar>", "Contraction <%>", "Force <N>")))


@kind
def units_after_a_dash(p, rng):
    return csv(p, text(cells(p), ("Pressure - bar", "Contraction - %", "Force - N")))


@kind
def units_after_a_colon(p, rng):
    return csv(p, text(cells(p), ("Pressure: bar", "Contraction: %", "Force: N")))


@kind
def units_with_inner_blanks(p, rng):
    return csv(p, text(cells(p), ("Pressure [ bar ]", "Contraction [ % ]", "Force [ N ]")))


@kind
def footnotes_at_names(p, rng):
    return csv(p, text(cells(p), ("Pressure¹ [bar]", "Contraction* [%]", "Force² [N]")) + "* of the initial length\n")


@kind
def names_with_channels(p, rng):
    return csv(p, text(cells(p), ("CH1 Pressure [bar]", "CH2 Contraction [%]", "CH3 Force [N]")))


@kind
def names_with_channels_and_colons(p, rng):
    return csv(p, text(cells(p), ("AI0: Pressure [bar]", "AI1: Contraction [%]", "AI2: Force [N]")))


@kind
def names_with_numbers(p, rng):
    return csv(p, text(cells(p), ("Pressure 1 [bar]", "Contraction 1 [%]", "Force 1 [N]")))


@kind
def names_in_two_languages(p, rng):
    return csv(p, text(cells(p), ("Druck/Pressure [bar]", "Kontraktion/Contraction [%]", "Kraft/Force [N]")))


@kind
def names_in_russian(p, rng):
    return csv(p, text(cells(p, ","), ("Давление, бар", "Сокращение, %", "Усилие, Н")), encoding="cp1251")


@kind
def names_in_korean(p, rng):
    return csv(p, text(cells(p), ("압력 [bar]", "수축률 [%]", "힘 [N]")), encoding=one_of(rng, ["utf-8", "cp949"]))


@kind
def names_in_turkish_czech(p, rng):
    header = [
        ("Basınç [bar]", "Kısalma [%]", "Kuvvet [N]"),
        ("Tlak [bar]", "Zkrácení [%]", "Síla [N]"),
        ("Trykk [bar]", "Kontraksjon [%]", "Kraft [N]"),
    ][rng.integers(3)]
    return csv(p, text(cells(p, ","), header))


@kind
def small_letters_for_units(p, rng):
    return csv(p, text(cells(p), ("pressure(BAR)", "contraction(PCT)", "force(n)")))


@kind
def millipascals_or_megapascals(p, rng):
    return csv(
        p,
        text(
            scaled(p, 0, 0.1),
            renamed(0, one_of(rng, ["Pressure [mPa]", "Pressure [mpa]", "Pressure [MPA]", "Pressure [Mpa]"])),
        ),
    )


@kind
def kilopascals_in_odd_letters(p, rng):
    return csv(
        p,
        text(
            scaled(p, 0, 100),
            renamed(0, one_of(rng, ["Pressure [Kpa]", "Pressure [KPA]", "Pressure [KPa]", "PRESSURE,kpa"])),
        ),
    )


@kind
def milliamperes_mapped(p, rng):
    rows = [[plain(round(4 + 16 * float(a) / 10, 4)), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, renamed(0, "Pressure sensor [mA]")), columns={"Pressure sensor [mA]": "pressure_bar"})


@kind
def comment_says_other_unit(p, rng):
    name = one_of(rng, ["# all forces in kN\n", "# Force unit: kN\n", "# F in kN, p in bar\n", "# units: bar, %, kN\n"])
    return csv(p, name + text(scaled(p, 2, 0.001)))


@kind
def comment_says_sign(p, rng):
    return csv(p, "# compression is positive\n" + text(scaled(p, 2, -1)))


@kind
def comment_says_offset_remains(p, rng):
    return csv(
        p,
        one_of(
            rng,
            [
                "# load cell not tared: subtract 12.5 N\n",
                "# zero offset of the load cell: 12.5 N (included)\n",
                "Tara;12,5 N\n",
            ],
        )
        + text([[a, b, plain(round(float(c) + 12.5, 3))] for a, b, c in cells(p)]),
    )


@kind
def comment_says_ratio_times_lever(p, rng):
    return csv(
        p,
        one_of(
            rng,
            [
                "# load cell at lever, ratio 2:1, force at muscle is half\n",
                "# lever ratio: 2\n",
                "Lever arm ratio;2\n",
            ],
        )
        + text(scaled(p, 2, 2)),
    )


@kind
def comment_says_two_muscles(p, rng):
    return csv(p, "# two muscles in parallel\n" + text(scaled(p, 2, 2)))


@kind
def decimal_sign_by_column(p, rng):
    rows = [[a.replace(".", ","), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows))


@kind
def decimal_point_alone(p, rng):
    rows = [[c.rstrip("0").removeprefix("0") if "." in c else c + "." for c in row] for row in cells(p)]
    return csv(p, text(rows))


@kind
def plus_signs(p, rng):
    return csv(p, text([[f"+{float(c):.3f}" for c in row] for row in cells(p)]))


@kind
def exponents_with_commas(p, rng):
    return csv(p, text([[f"{float(c):.5E}".replace(".", ",") for c in row] for row in cells(p)]))


@kind
def minus_behind(p, rng):
    return csv(p, text(third(cells(p), [f"{c}-" for _, _, c in cells(p)])), force_sign=-1)


@kind
def en_dash_as_minus(p, rng):
    return csv(p, text(third(cells(p), [f"–{c}" for _, _, c in cells(p)])), force_sign=-1)


@kind
def with_uncertainties(p, rng):
    return csv(p, text(third(cells(p), [f"{c}{rng.choice(['±', ' ± ', '+/-', ' +- '])}0.5" for _, _, c in cells(p)])))


@kind
def limits_as_less_than(p, rng):
    rows = cells(p)
    at = int(np.argmin(p.force))
    rows[at][2] = f"<{rows[at][2]}"
    return csv(p.without([at]), text(rows))


@kind
def percent_signs_in_cells(p, rng):
    return csv(p, text([[a, f"{b}%", c] for a, b, c in cells(p)], (HEADER[0], "Contraction", HEADER[2])))


@kind
def some_cells_in_millibar(p, rng):
    rows = cells(p)
    for at in rng.choice(len(rows), 3, replace=False):
        rows[at][0] = f"{float(rows[at][0]) * 1000:.0f} mbar"
    return csv(p, text(rows))


@kind
def quoted_with_units_and_commas(p, rng):
    rows = [[f'"{a} bar"', f'"{b} %"', f'"{c} N"'] for a, b, c in cells(p, ",")]
    return csv(p, text(rows, ['"Pressure"', '"Contraction"', '"Force"'], ","))


@kind
def units_glued_to_cells(p, rng):
    return csv(p, text([[f"{a}bar", f"{b}%", f"{c}N"] for a, b, c in cells(p)], UNITLESS, ","))


@kind
def units_in_cells_and_names(p, rng):
    return csv(p, text([[f"{a} bar", f"{b} %", f"{c} N"] for a, b, c in cells(p)], HEADER, ","))


@kind
def underscores_in_numbers(p, rng):
    p = p.large()
    return csv(p, text(third(cells(p), [f"{int(f):_}" for f in p.force])))


@kind
def full_width_digits(p, rng):
    table = str.maketrans("0123456789.", "０１２３４５６７８９．")
    return csv(p, text([[c.translate(table) for c in row] for row in cells(p)]))


@kind
def apostrophes_before_numbers(p, rng):
    return csv(p, text([[f"'{c}" for c in row] for row in cells(p)]))


@kind
def excel_text_formulas(p, rng):
    return csv(p, text([[f'="{c}"' for c in row] for row in cells(p)]))


@kind
def single_quotes(p, rng):
    return csv(p, text([[f"'{c}'" for c in row] for row in cells(p)], [f"'{n}'" for n in HEADER], ","))


@kind
def thousands_next_to_a_day_column(p, rng):
    """1.234 under whole numbers, and a date such as 12.03 in a column that is not read."""
    p = p.huge()
    p = replace(p, pressure=p.pressure.round(), contraction=p.contraction.round())
    rows = [[one_of(rng, ["12.03", "4.10", "3.12"]), a, b, grouped(float(c), ".", ",")] for a, b, c in cells(p)]
    return csv(p, text(rows, (one_of(rng, ["Date", "Day", "Version", "Uhrzeit"]), *HEADER)))


@kind
def thousands_next_to_clock_column(p, rng):
    p = p.huge()
    p = replace(p, pressure=p.pressure.round(), contraction=p.contraction.round())
    rows = [
        [f"{9 + i // 60:02d},{i % 60:02d}", a, b, grouped(float(c), ",", ".")] for i, (a, b, c) in enumerate(cells(p))
    ]
    return csv(p, text(rows, ("clock", *HEADER), "\t"))


@kind
def merged_names_over_split_decimals(p, rng):
    """Decimal commas split by commas under names with empty ones between."""
    rows = [[x for c in row for x in f"{float(c):.1f}".split(".")] for row in cells(p)]
    return csv(p, text(rows, [x for n in HEADER for x in (n, "")], ","))


@kind
def units_in_columns_of_their_own(p, rng):
    rows = [[a, "bar", b, "%", c, "N"] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure", "Unit", "Contraction", "Unit", "Force", "Unit")))


@kind
def units_in_columns_that_change(p, rng):
    rows = [
        [a, "bar", b, "%", c, "N"] if i % 3 else [plain(float(a) * 100), "kPa", b, "%", c, "N"]
        for i, (a, b, c) in enumerate(cells(p))
    ]
    return csv(p, text(rows, ("Pressure [bar]", "p unit", "Contraction [%]", "eps unit", "Force [N]", "F unit")))
