"""Kinds of messy files: exports of machines, loggers, phones and spreadsheets, and failures of sensors."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from messy_kinds import HEADER, File, cells, csv, hdf5, kind, numbers, one_of, plain, text, workbook
from messy_structures import block
from nptdms import ChannelObject, TdmsWriter
from openpyxl.styles import Font
from scipy.io import savemat


@kind
def key_value_lines_with_units(p, rng):
    return csv(p, "".join(f"pressure={a}bar, contraction={b}%, force={c}N\n" for a, b, c in cells(p)), "log.txt")


@kind
def markdown_table(p, rng):
    rows = "".join("| " + " | ".join(r) + " |\n" for r in cells(p))
    return csv(p, "# Results\n\n| " + " | ".join(HEADER) + " |\n|---|---|---|\n" + rows, "rig.md")


@kind
def testxpert(p, rng):
    """Preamble in quotes, names and units in two rows, standard travel in mm from the initial length."""
    head = '"Prüfer";"Meier"\n"Prüfdatum";"12.03.2024"\n"Einspannlänge";"250,00 mm"\n\n'
    rows = [
        [f"{i * 0.5:.2f}".replace(".", ","), c, plain(round(2.5 * float(b.replace(",", ".")), 4)).replace(".", ","), a]
        for i, (a, b, c) in enumerate(cells(p, ","))
    ]
    return csv(
        p,
        head + text([["s", "N", "mm", "bar"], *rows], ("Prüfzeit", "Standardkraft", "Standardweg", "Druck")),
        encoding="cp1252",
        columns={"Standardweg": "displacement_mm"},
        displacement="shortening",
        initial_length=0.25,
    )


@kind
def testxpert_elongation(p, rng):
    """A machine whose travel is positive upwards (longer), read as shortening."""
    rows = [[c, plain(round(-2.5 * float(b), 4)), a] for a, b, c in cells(p)]
    return csv(
        p,
        text(rows, ("Standardkraft [N]", "Standardweg [mm]", "Druck [bar]")),
        columns={"Standardweg [mm]": "displacement_mm"},
        displacement="shortening",
        initial_length=0.25,
    )


@kind
def bluehill_results(p, rng):
    rows = [[str(i), f'"{a}"', f'"{b}"', f'"{c}"'] for i, (a, b, c) in enumerate(cells(p), 1)]
    return csv(
        p,
        "Results Table 1\n"
        + text([["", "(bar)", "(%)", "(N)"], *rows], ("", "Pressure", "Contraction", "Load"), ",")
        + "\n",
    )


@kind
def bluehill_raw(p, rng):
    rows = [
        [f"{i:.3f}", plain(round(-2.5 * float(b), 4)), plain(round(float(c) / 1000, 7)), a]
        for i, (a, b, c) in enumerate(cells(p))
    ]
    return csv(
        p,
        "Raw data\n" + text([["(s)", "(mm)", "(kN)", "(bar)"], *rows], ("Time", "Extension", "Load", "Pressure"), ","),
        columns={"Extension": "displacement_mm"},
        displacement="lengthening",
        initial_length=0.25,
    )


@kind
def mts_testsuite(p, rng):
    head = "MTS793|MPT|ENU|1|2|.|,|:|1|0|0|A\n\nData Acquisition: Timed\tStation Name: rig\n"
    rows = [[f"{i:.4f}", a, b, c] for i, (a, b, c) in enumerate(cells(p))]
    return csv(
        p,
        head + text([["Sec", "bar", "%", "N"], *rows], ("Time", "Pressure", "Contraction", "Axial Force"), "\t"),
        "specimen.dat",
    )


@kind
def phyphox(p, rng):
    rows = [[f"{i * 0.1:.15E}", *(f"{float(c):.9E}" for c in r)] for i, r in enumerate(cells(p))]
    return csv(p, text(rows, ('"Time (s)"', '"Pressure (bar)"', '"Contraction (%)"', '"Force (N)"'), ","))


@kind
def daqami(p, rng):
    head = "DAQami export\nDevice;USB-1608G\nSample rate;10 Hz\nDate/Time;3/1/2024 10:00:00 AM\n\n"
    rows = [[str(i), f"3/1/2024 10:00:{i % 60:02d}.{rng.integers(10)} AM", *r] for i, r in enumerate(cells(p))]
    return csv(p, head + text(rows, ("Sample", "Date/Time", "Pressure (bar)", "Contraction (%)", "Force (N)"), ","))


@kind
def daq_with_scaled_names(p, rng):
    rows = [[f"{float(a) * 0.5:.4f}", a, b, f"{float(c) / 100:.5f}", c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [V]", "Pressure [bar]", "Contraction [%]", "Force [V]", "Force [N]")))


@kind
def influx_annotated(p, rng):
    head = "#group,false,false,false\n#datatype,double,double,double\n#default,,,\n"
    return csv(p, head + text(cells(p), ("pressure_bar", "contraction_percent", "force_N"), ","))


@kind
def vicon_two_headers(p, rng):
    head = "Devices\n1000\n,,Imported Pressure,Imported LVDT,Imported AMTI\n"
    rows = [[str(i), "0", *r] for i, r in enumerate(cells(p), 1)]
    return csv(
        p,
        head
        + text([["", "", "bar", "%", "N"], *rows], ("Frame", "Sub Frame", "Pressure", "Contraction", "Force"), ","),
    )


@kind
def opensim_sto(p, rng):
    head = f"muscle\nversion=1\nnRows={len(p.force)}\nnColumns=4\ninDegrees=no\nendheader\n"
    rows = [[f"{i:.3f}", *r] for i, r in enumerate(cells(p))]
    return csv(p, head + text(rows, ("time", "pressure_bar", "contraction_percent", "force_N"), "\t"), "rig.sto")


@kind
def signal_with_quality_columns(p, rng):
    rows = [[a, "192", b, "192", c, "192" if i else "0"] for i, (a, b, c) in enumerate(cells(p))]
    return csv(p, text(rows, ("Pressure [bar]", "Quality", "Contraction [%]", "Quality", "Force [N]", "Quality")))


@kind
def signal_with_named_quality(p, rng):
    rows = [[a, b, c, "Good" if i != 4 else "Bad"] for i, (a, b, c) in enumerate(cells(p))]
    rows[4][2] = plain(float(rows[4][2]) * 0.6)
    return csv(p.without([4]), text(rows, (*HEADER, "Force quality")))


@kind
def outlier_flag_column(p, rng):
    rows = [[a, b, c, "" if i != 4 else "x"] for i, (a, b, c) in enumerate(cells(p))]
    rows[4][2] = plain(round(float(rows[4][2]) * 0.8, 1))
    return csv(p.without([4]), text(rows, (*HEADER, one_of(rng, ["exclude", "outlier", "ungültig", "ignore"]))))


@kind
def use_flag_column(p, rng):
    rows = [[a, b, c, "1" if i != 4 else "0"] for i, (a, b, c) in enumerate(cells(p))]
    rows[4][2] = plain(round(float(rows[4][2]) * 0.8, 1))
    return csv(p.without([4]), text(rows, (*HEADER, one_of(rng, ["use", "valid", "ok", "good"]))))


@kind
def remark_repeat_at_a_row(p, rng):
    rows = [[*r, "" if i != 4 else "slipped, repeated below"] for i, r in enumerate(cells(p))]
    rows.append([*rows[4][:3], ""])
    rows[4][2] = plain(round(float(rows[4][2]) * 0.8, 1))
    order = [*range(4), *range(5, len(p.force)), 4]
    q = type(p)(p.pressure[order], p.contraction[order], p.force[order])
    return csv(q, text(rows, (*HEADER, "Remark")))


@kind
def overflow_of_16_bits(p, rng):
    at = int(rng.integers(2, len(p.force)))
    rows = cells(p)
    rows[at][2] = one_of(rng, ["6553.5", "3276.7", "655.35", "-3276.8", "32767", "65535", "4095", "1023"])
    return csv(p.without([at]), text(rows))


@kind
def scpi_nan(p, rng):
    at = int(rng.integers(2, len(p.force)))
    rows = cells(p)
    rows[at][int(rng.integers(3))] = one_of(
        rng,
        [
            "9.91E+37",
            "9.9E37",
            "3.4028235E+38",
            "1.7976931348623157E308",
            "1E+30",
            "-1E+30",
            "1.#QNAN",
            "-1.#IND",
            "+OVER",
            "1.#INF",
        ],
    )
    return csv(p.without([at]), text(rows))


@kind
def wrap_around_of_pressure(p, rng):
    """A signed counter of 9 bits for hundredths of a bar wraps."""
    raw = (p.pressure * 100).round().astype(int)
    return csv(
        p, text([[plain(((r + 256) % 512 - 256) / 100), b, c] for r, (_, b, c) in zip(raw, cells(p), strict=False)])
    )


@kind
def sign_of_force_flips_midway(p, rng):
    n = len(p.force) * 2 // 3
    return csv(p, text([[a, b, c if i < n else f"-{c}"] for i, (a, b, c) in enumerate(cells(p))]))


@kind
def contraction_in_ratio_from_a_row_on(p, rng):
    n = len(p.force) // 2
    return csv(
        p, text([[a, b if i < n else plain(round(float(b) / 100, 6)), c] for i, (a, b, c) in enumerate(cells(p))])
    )


@kind
def force_in_kilograms_from_a_row_on(p, rng):
    n = len(p.force) // 2
    return csv(
        p, text([[a, b, c if i < n else plain(round(float(c) / 9.80665, 3))] for i, (a, b, c) in enumerate(cells(p))])
    )


@kind
def pressure_in_megapascals_from_a_row_on(p, rng):
    n = len(p.force) // 2
    return csv(
        p, text([[a if i < n else plain(round(float(a) / 10, 6)), b, c] for i, (a, b, c) in enumerate(cells(p))])
    )


@kind
def pressure_and_contraction_swapped(p, rng):
    return csv(p, text([[b, a, c] for a, b, c in cells(p)]))


@kind
def force_and_contraction_swapped(p, rng):
    q = replace(p, force=(p.force * 20 / p.force.max()).round(2))
    return csv(q, text([[a, c, b] for a, b, c in cells(q)]))


@kind
def pressure_clipped(p, rng):
    limit = np.unique(p.pressure)[-int(len(p.pressure) * 0.3)]
    return csv(p, text(cells(replace(p, pressure=p.pressure.clip(max=limit)))))


@kind
def contraction_lags_one_row(p, rng):
    return csv(p, text(cells(replace(p, contraction=np.roll(p.contraction, 1)))))


@kind
def workbook_with_merged_header(p, rng):
    rows = [[a, None, b, None, c, None] for a, b, c in numbers(p)]

    def merge(book):
        for c in (1, 3, 5):
            book.active.merge_cells(start_row=1, end_row=1, start_column=c, end_column=c + 1)

    return File("rig.xlsx", workbook([(HEADER[0], None, HEADER[1], None, HEADER[2], None), *rows], merge), p)


@kind
def workbook_with_decimal_comma_texts(p, rng):
    rows = [[a, b, str(c).replace(".", ",")] if i % 3 == 0 else [a, b, c] for i, (a, b, c) in enumerate(numbers(p))]
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


@kind
def workbook_with_errors(p, rng):
    rows = numbers(p)
    at = int(rng.integers(len(rows)))
    rows[at][2] = one_of(rng, ["#N/A", "#DIV/0!", "#VALUE!"])
    return File("rig.xlsx", workbook([HEADER, *rows]), p.without([at]))


@kind
def workbook_with_booleans(p, rng):
    rows = [[*r, i != 3] for i, r in enumerate(numbers(p))]
    rows[3][2] *= 0.8
    return File("rig.xlsx", workbook([(*HEADER, "valid"), *rows]), p.without([3]))


@kind
def workbook_by_hand(p, rng):
    """Title, operator, blank lines, table at B6, a mean beside it, and a second table below."""
    rows = [
        ["Versuch 12"],
        [None, "Bearbeiter:", "AB"],
        [],
        [None, None, "Druck", "Kontraktion", "Kraft"],
        [None, "Nr.", "[bar]", "[%]", "[N]"],
    ]
    rows += [[None, i, *r] for i, r in enumerate(numbers(p), 1)]
    rows += [[], [None, "Fmax", None, None, float(p.force.max())]]
    return File("rig.xlsx", workbook(rows), p)


@kind
def workbook_with_sheet_per_pressure(p, rng):
    n = block(p)
    rows = numbers(p)

    def add(book):
        book.active.title = "p1"
        for k in range(n, len(rows), n):
            s = book.create_sheet(f"p{k // n + 1}")
            for row in [HEADER, *rows[k : k + n]]:
                s.append(list(row))

    return File("rig.xlsx", workbook([HEADER, *rows[:n]], add), p)


@kind
def workbook_white_text(p, rng):
    rows = numbers(p)
    rows[5][2] *= 0.7

    def show(book):
        for cell in book.active[7]:
            cell.font = Font(color="FFFFFFFF")

    return File("rig.xlsx", workbook([HEADER, *rows], show), p.without([5]))


@kind
def hdf5_units_spelled(p, rng):
    name = one_of(rng, ["Units", "unit", "Unit", "UNIT", "unit_string"])

    def change(f):
        for k in f:
            u = f[k].attrs["units"]
            del f[k].attrs["units"]
            f[k].attrs[name] = np.bytes_(u)

    return hdf5(p, change)


@kind
def hdf5_psi_unit(p, rng):
    def change(f):
        f["Pressure"][...] = p.pressure * 14.503773773
        f["Pressure"].attrs["units"] = "psi"

    return hdf5(p, change)


@kind
def hdf5_valid_mask(p, rng):
    def change(f):
        m = np.ones(len(p.force), bool)
        m[3] = False
        v = p.force.copy()
        v[3] *= 0.7
        f["Force"][...] = v
        f["valid"] = m

    return replace(hdf5(p, change), truth=p.without([3]))


@kind
def matlab_units_struct(p, rng):
    s = io.BytesIO()
    savemat(
        s,
        {
            "rig": {
                "pressure": p.pressure * 100,
                "contraction": p.contraction,
                "force": p.force,
                "units": {"pressure": "kPa", "contraction": "%", "force": "N"},
            }
        },
    )
    return File("rig.mat", s.getvalue(), p)


@kind
def matlab_data_and_column_names_wrong_unit(p, rng):
    s = io.BytesIO()
    savemat(
        s,
        {
            "pressure_bar": p.pressure,
            "contraction_percent": p.contraction,
            "force_N": (p.force * 10).round().astype(np.int16),
            "force_N_scale": 0.1,
        },
    )
    return File("rig.mat", s.getvalue(), p)


@kind
def tdms_unit_psi(p, rng):
    s = io.BytesIO()
    cols = (
        ("Pressure", p.pressure * 14.503773773, "psi"),
        ("Contraction", p.contraction, "%"),
        ("Force", p.force, "N"),
    )
    with TdmsWriter(s) as w:
        w.write_segment([ChannelObject("rig", n, v, properties={"unit_string": u}) for n, v, u in cols])
    return File("rig.tdms", s.getvalue(), p)


@kind
def tdms_description_raw(p, rng):
    s = io.BytesIO()
    cols = (
        ("Pressure", p.pressure, "bar", ""),
        ("Contraction", p.contraction, "%", ""),
        ("Force", p.force / 10, "N", "raw, times 10"),
    )
    with TdmsWriter(s) as w:
        w.write_segment(
            [ChannelObject("rig", n, v, properties={"unit_string": u, "description": d}) for n, v, u, d in cols]
        )
    return File("rig.tdms", s.getvalue(), p)
