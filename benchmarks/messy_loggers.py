"""Kinds of messy files: formats of loggers and test machines, status columns, summary rows, absolute pressures.

Importing this adds them to `KINDS`.
"""

from __future__ import annotations

import io
import json
from dataclasses import replace

import h5py
import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, text, third, workbook
from messy_labs import NAMES
from scipy.io import savemat

ATMOSPHERE = 1.013  # bar


def times(p, step=0.5):
    return [f"{step * i:.3f}" for i in range(len(p.force))]


def with_times(p, decimal="."):
    return [[t.replace(".", decimal), *row] for t, row in zip(times(p), cells(p, decimal), strict=True)]


def lengths(p, initial=180.0):
    return [repr(initial * (1 - float(c) / 100)) for c in p.contraction]


def inserted(rows, at, row):
    return [*rows[:at], row, *rows[at:]]


def means(p, rows=slice(None)):
    """Mean of points, with the decimals that people print."""
    a, b, c = (v[rows].mean() for v in (p.pressure, p.contraction, p.force))
    return [f"{a:.2f}", f"{b:.1f}", f"{c:.1f}"]


def levels(p):
    """Slices of the pressures."""
    count = len(np.unique(p.contraction))
    return [slice(at, at + count) for at in range(0, len(p.force), count)]


# LabVIEW, dSPACE, Simulink, ROS


@kind
def lvm_with_times_of_each_channel(p, rng):
    """Multi_Headings and a time column before each channel."""
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "Multi_Headings\tYes\nX_Columns\tMulti\nTime_Pref\tRelative\n***End_of_Header***\t\n\t\nChannels\t3\n"
        "Y_Unit_Label\tbar\t\t%\t\tN\n***End_of_Header***\t\n"
        "X_Value\tPressure\tX_Value\tContraction\tX_Value\tForce\tComment\n"
    )
    rows = [[t, a, t, b, t, c] for t, (a, b, c) in zip(times(p), cells(p), strict=True)]
    return csv(p, head + "".join("\t".join(row) + "\n" for row in rows), "rig.lvm")


@kind
def lvm_of_two_segments(p, rng):
    head = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\n***End_of_Header***\t\n\t\n"
    segment = "Channels\t3\nY_Unit_Label\tbar\t%\tN\n***End_of_Header***\t\nX_Value\tPressure\tContraction\tForce\n"
    half = len(p.force) // 2
    rows = ["\t".join(row) + "\n" for row in with_times(p)]
    return csv(p, head + segment + "".join(rows[:half]) + "\n" + segment + "".join(rows[half:]), "rig.lvm")


@kind
def tdms_exported_as_text(p, rng):
    """Group and channel in the header, properties above it."""
    head = "Root Name\tTitle\tAuthor\nrig\tmuscle\tA. B.\n\nGroup\tChannels\nUntitled\t3\n\n"
    header = ("Untitled/Pressure (bar)", "Untitled/Contraction (%)", "Untitled/Force (N)")
    return csv(p, head + text(cells(p), header, "\t"), "rig.txt")


@kind
def labview_with_comma_decimals_and_tabs_without_header(p, rng):
    rows = ["\t".join(f"{v:.6f}".replace(".", ",") for v in row) for row in numbers(p)]
    return csv(p, "\n".join(rows) + "\n", "rig.txt", columns={str(i): n for i, n in enumerate(NAMES, 1)})


@kind
def dspace_controldesk(p, rng):
    """Paths of a model as names, with types and units in rows under them."""
    path = "Model Root/Rig/{}/Out1"
    head = f"dSPACE ControlDesk;5.1\nDate;2024-03-12\n\nvariable;{';'.join(map(path.format, ('p', 'eps', 'F')))}\n"
    rows = [["trace_values", *row] for row in cells(p)]
    return csv(p, head + "unit;bar;%;N\n" + "".join(";".join(row) + "\n" for row in rows))


@kind
def dspace_with_mapped_paths(p, rng):
    header = [f"Model Root/Rig/{name}/Out1" for name in ("p", "eps", "F")]
    return csv(p, text(cells(p), header, ","), columns=dict(zip(header, NAMES, strict=True)))


@kind
def simulink_to_workspace(p, rng):
    header = ("time", "pressure_kPa:1", "contraction_percent:1", "force_N:1")
    rows = [[t, f"{100 * float(a):g}", b, c] for t, (a, b, c) in zip(times(p), cells(p), strict=True)]
    return csv(p, text(rows, header, ","))


@kind
def simulink_struct_with_time(p, rng):
    stream = io.BytesIO()
    savemat(stream, {"rig": {"time": np.array(times(p), float), "signals": {"values": np.array(numbers(p))}}})
    return File("rig.mat", stream.getvalue(), p)


@kind
def matlab_table_of_mixed_scale(p, rng):
    """Pressure in kPa by its name, and one more column of the same in bar."""
    stream = io.BytesIO()
    savemat(
        stream,
        {
            "pressure_kPa": p.pressure * 100,
            "contraction_percent": p.contraction,
            "force_N": p.force,
            "status": np.r_[np.ones(len(p.force) - 1), 0.0],
        },
    )
    return File("rig.mat", stream.getvalue(), p.without([len(p.force) - 1]))


@kind
def ros_bag_with_fields(p, rng):
    header = (
        "%time",
        "field.header.seq",
        "field.header.stamp",
        "field.pressure",
        "field.length",
        "field.wrench.force.z",
    )
    rows = [
        [f"{1710250380000000000 + 10**8 * i}", str(i), f"{1710250380000000000 + 10**8 * i}", repr(a * 1e5), length, c]
        for i, ((a, _, _), length, (*_, c)) in enumerate(zip(numbers(p), lengths(p), cells(p), strict=True))
    ]
    mapped = {"field.pressure": "pressure_Pa", "field.length": "length_mm", "field.wrench.force.z": "force_N"}
    return csv(p, text(rows, header, ","), columns=mapped, initial_length=0.18)


@kind
def ros_topic_echo(p, rng):
    rows = "".join(f"pressure_bar: {a}\ncontraction_percent: {b}\nforce_N: {c}\n---\n" for a, b, c in cells(p))
    return csv(p, rows, "rig.txt")


@kind
def plotjuggler_with_gaps(p, rng):
    """A topic of a slower rate leaves cells empty."""
    rows = [[t, a, b if i % 2 == 0 else "", c] for i, (t, (a, b, c)) in enumerate(zip(times(p), cells(p), strict=True))]
    header = ("__time", "/rig/pressure_bar", "/rig/contraction_percent", "/rig/force_N")
    return csv(p.without(range(1, len(rows), 2)), text(rows, header, ","))


@kind
def plotjuggler_held_values(p, rng):
    """A topic of a slower rate holds its last value: every other force is that of the row before."""
    rows = cells(p)
    held = third(rows, [rows[i - i % 2][2] for i in range(len(rows))])
    return csv(p, text([[t, *row] for t, row in zip(times(p), held, strict=True)], ("time [s]", *HEADER), ","))


@kind
def ros2_bag_as_table(p, rng):
    header = ("timestamp", "/muscle/pressure_bar", "/muscle/contraction_percent", "/load_cell/force_N")
    return csv(p, text([[f"{1710250380 + 0.1 * i:.9f}", *row] for i, row in enumerate(cells(p))], header, ","))


@kind
def signal_express_with_two_rows_of_header(p, rng):
    head = "channel names:\nTime (s)\tPressure (bar)\tContraction (%)\tForce (N)\n"
    return csv(p, head + "".join("\t".join(row) + "\n" for row in with_times(p)), "rig.txt")


@kind
def dewesoft_export(p, rng):
    head = "File name: rig.dxd\nSample rate: 2.0 Hz\nStart time: 12.03.2024 14:33:00\n\n"
    return csv(p, head + text(with_times(p), ("Time (s)", "Pressure (bar)", "Contraction (%)", "Force (N)"), "\t"))


@kind
def oscilloscope_with_settings_above(p, rng):
    head = "Model,MSO44\nVertical Units,V\nHorizontal Units,s\nSample Interval,0.5\nRecord Length,24\n\n"
    return csv(p, head + text(with_times(p), ("Time (s)", "Pressure (bar)", "Contraction (%)", "Force (N)"), ","))


@kind
def python_logger_with_times_and_levels(p, rng):
    rows = [[f"2024-03-12 14:33:{i:02d}.250", "INFO", *row] for i, row in enumerate(cells(p))]
    return csv(p, text(rows, ("asctime", "levelname", *NAMES), ";"), "rig.log")


@kind
def pandas_with_index_and_exponents(p, rng):
    rows = [[str(i), *(f"{v:.6e}" for v in row)] for i, row in enumerate(numbers(p))]
    return csv(p, text(rows, ("", *NAMES), ","))


@kind
def julia_delimited(p, rng):
    rows = [[repr(v) for v in row] for row in numbers(p)]
    return csv(p, text(rows, NAMES, "\t"), "rig.tsv")


@kind
def matlab_timetable(p, rng):
    rows = [[f"{i / 2:g} sec", *row] for i, row in enumerate(cells(p))]
    return csv(p, text(rows, ("Time", *NAMES), ","))


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


# Arduino, amplifiers, multimeters


@kind
def arduino_lines_before_the_header(p, rng):
    return csv(p, "Calibrating HX711...\nTare done\nReady\n" + text(cells(p), NAMES, ","), "putty.log")


@kind
def arduino_restarted(p, rng):
    """A reset prints the banner and the header again."""
    rows, half = cells(p), len(p.force) // 2
    again = "Calibrating HX711...\nReady\n" + text(rows[half:], NAMES, ",")
    return csv(p, text(rows[:half], NAMES, ",") + again, "putty.log")


@kind
def arduino_lost_character(p, rng):
    """The first digit of the largest force is lost on the line."""
    rows = cells(p)
    at = int(np.argmax(p.force))
    rows[at][2] = rows[at][2][1:]
    return csv(p, text(rows, NAMES, ","))


@kind
def arduino_joined_lines(p, rng):
    """A line end is lost."""
    lines = text(cells(p), NAMES, ",").splitlines(keepends=True)
    at = int(rng.integers(2, len(lines) - 1))
    lines[at] = lines[at].rstrip("\n")
    return replace(csv(p, "".join(lines)), truth=p.without([at - 1, at]))


@kind
def arduino_json_lines(p, rng):
    lines = [json.dumps(dict(zip(NAMES, row, strict=True))) for row in numbers(p)]
    return csv(p, "\n".join(lines) + "\n", "rig.jsonl")


@kind
def arduino_counts_of_the_converter(p, rng):
    """Forces in counts of a 24-bit converter, named as forces."""
    counts = [f"{8388608 + round(f * 431.7)}" for f in p.force]
    return csv(p, text(third(cells(p), counts), (*HEADER[:2], "Force [N]")))


@kind
def amplifier_overload_marked_by_words(p, rng):
    rows = cells(p)
    at = int(np.argmax(p.force))
    rows[at][2] = "OVL"
    return replace(csv(p, text(rows)), truth=p.without([at]))


@kind
def multimeter_overload_as_9_9e37(p, rng):
    """Keysight's and Keithley's mark of an overload."""
    rows = cells(p)
    at = int(np.argmax(p.force))
    rows[at][2] = "+9.90000000E+37"
    return replace(csv(p, text(rows)), truth=p.without([at]))


@kind
def logger_mark_7999(p, rng):
    """Campbell's marks of a value beyond the range."""
    rows = cells(p)
    at = int(rng.integers(len(rows)))
    rows[at][2] = "-7999"
    return replace(csv(p, text(rows)), truth=p.without([at]))


@kind
def campbell_toa5(p, rng):
    """Four rows of header: station, names, units, processing."""
    head = '"TOA5","rig","CR1000","12345","CR1000.Std.32","CPU:rig.CR1","4711","Table1"\n'
    rows = [[f'"2024-03-12 14:33:{i:02d}"', str(i), *row] for i, row in enumerate(cells(p))]
    under = [['"TS"', '"RN"', '"bar"', '"%"', '"N"'], ['""', '""', '"Smp"', '"Smp"', '"Smp"']]
    header = ('"TIMESTAMP"', '"RECORD"', '"Pressure"', '"Contraction"', '"Force"')
    return csv(p, head + text([*under, *rows], header, ","), "rig.dat")


@kind
def hbm_catman(p, rng):
    head = "HBM_CATMAN_DATAFILE\nExported by catman Easy\n\n"
    header = ("Time  1 - default sample rate [s]", "Pressure [bar]", "Contraction [%]", "Force [N]")
    return csv(p, head + text(with_times(p), header, "\t"), "rig.ASC", "cp1252")


@kind
def picolog_with_averages(p, rng):
    header = ("", "Pressure (bar) Ave", "Contraction (%) Ave", "Force (N) Ave")
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p))], header, ","))


@kind
def graphtec_with_signs_apart(p, rng):
    """Signs in cells of their own blanks: + 1.50."""
    rows = [[f"+ {v:.4f}" for v in row] for row in numbers(p)]
    return csv(p, text(rows, HEADER, ","))


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


# Status columns


def faulty(p, rng):
    """Rows of which one is not a measurement, and its place."""
    rows = cells(p)
    at = int(rng.integers(1, len(rows) - 1))
    rows[at][2] = f"{0.6 * p.force[at]:.1f}"
    return rows, at


def marked(name, usual, mark, delimiter=";"):
    """Kind with a column that marks one row."""

    def make(p, rng):
        rows, at = faulty(p, rng)
        flags = [mark if i == at else usual for i in range(len(rows))]
        content = text([[*row, flag] for row, flag in zip(rows, flags, strict=True)], (*HEADER, name), delimiter)
        return replace(csv(p, content), truth=p.without([at]))

    return make


for label, arguments in {
    "status_ok_or_fault": ("Status", "OK", "FAULT"),
    "valid_one_or_zero": ("valid", "1", "0"),
    "quality_good_or_bad": ("Quality", "192", "0"),
    "error_codes": ("error code", "0", "17"),
    "state_of_the_rig": ("rig_state", "3", "4"),
    "gueltig_ja_nein": ("gültig", "ja", "nein"),
    "flags_in_hexadecimal": ("Flags", "0x0000", "0x0004"),
    "remark_that_a_row_is_invalid": ("remark", "", "invalid"),
    "note_of_an_outlier": ("note", "", "outlier, repeat"),
    "overload_true_or_false": ("Overload", "FALSE", "TRUE"),
    "rows_named_by_an_unread_column": ("run", "1", "mean"),
}.items():
    made = marked(*arguments)
    made.__name__ = f"status_{label}"
    kind(made)


@kind
def status_in_a_column_before_the_others(p, rng):
    rows, at = faulty(p, rng)
    content = [["E" if i == at else "M", *row] for i, row in enumerate(rows)]
    return replace(csv(p, text(content, ("state", *HEADER))), truth=p.without([at]))


@kind
def status_in_hdf5(p, rng):
    stream = io.BytesIO()
    rows, at = faulty(p, rng)
    with h5py.File(stream, "w") as file:
        for name, column in zip(NAMES, np.array(rows, float).T, strict=True):
            file[name] = column
        file["valid"] = np.arange(len(rows)) != at
    return File("rig.h5", stream.getvalue(), p.without([at]))


@kind
def status_mapped_as_a_pressure(p, rng):
    """The user maps a column of valve states to the pressure."""
    rows = [[*row, str(1 + i % 2)] for i, row in enumerate(cells(p))]
    header = ("p supply", *HEADER[1:], "valve state")
    return csv(p, text(rows, header), columns={"valve state": "pressure_bar"})


# Summary rows without a label


@kind
def mean_under_the_table(p, rng):
    return csv(p, text([*cells(p), means(p)]))


@kind
def mean_above_the_table(p, rng):
    return csv(p, text([means(p), *cells(p)]))


@kind
def mean_after_a_blank_line(p, rng):
    return csv(p, text(cells(p)) + "\n" + ";".join(means(p)) + "\n")


@kind
def mean_and_deviation_under_the_table(p, rng):
    deviations = [f"{v.std(ddof=1):.2f}" for v in (p.pressure, p.contraction, p.force)]
    return csv(p, text([*cells(p), means(p), deviations]))


@kind
def mean_after_each_pressure(p, rng):
    rows = []
    for block in levels(p):
        rows += [*cells(p)[block], means(p, block)]
    return csv(p, text(rows))


@kind
def mean_of_the_rows_so_far(p, rng):
    half = levels(p)[1].stop
    return csv(p, text(inserted(cells(p), half, means(p, slice(half)))))


@kind
def median_under_the_table(p, rng):
    return csv(p, text([*cells(p), [f"{np.median(v):.2f}" for v in (p.pressure, p.contraction, p.force)]]))


@kind
def mean_of_lengths_under_the_table(p, rng):
    rows = [[a, length, c] for (a, _, c), length in zip(cells(p), lengths(p), strict=True)]
    last = [f"{p.pressure.mean():.2f}", f"{np.mean(np.array(lengths(p), float)):.2f}", f"{p.force.mean():.1f}"]
    return csv(p, text([*rows, last], ("Pressure [bar]", "Length [mm]", "Force [N]")), initial_length=0.18)


# Absolute pressures


def absolute(p):
    return [[f"{float(a) + ATMOSPHERE:.3f}", b, c] for a, b, c in cells(p)]


def smooth(p):
    """Forces without the scatter of `Points.drawn`: their line over the pressure then tells its zero."""
    half = p.force[0] / p.pressure[0]
    return replace(p, force=(half * p.pressure * (1 - p.contraction / 28) ** 2).round(1))


@kind
def absolute_pressure_in_silence(p, rng):
    p = smooth(p)
    return csv(p, text(absolute(p)))


@kind
def absolute_pressure_by_a_comment(p, rng):
    return csv(p, "# pressures are absolute (MPXH6400A)\n" + text(absolute(p)))


@kind
def absolute_pressure_by_the_preamble(p, rng):
    return csv(p, "Rig 2\nSensor: Absolutdruck, Honeywell\n\n" + text(absolute(p)))


@kind
def absolute_pressure_in_kilopascals(p, rng):
    p = smooth(p)
    rows = [[f"{100 * float(a):.1f}", b, c] for a, b, c in absolute(p)]
    return csv(p, text(rows, ("Pressure [kPa]", *HEADER[1:])))


@kind
def absolute_pressure_named_p_abs(p, rng):
    return csv(p, text(absolute(p), ("p_abs [bar]", *HEADER[1:])), columns={"p_abs [bar]": "pressure_bar"})
