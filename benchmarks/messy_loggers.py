"""Kinds of messy files: formats of LabVIEW, dSPACE, Simulink, ROS, microcontrollers, amplifiers and loggers.

Importing this adds them to `KINDS`.
"""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, text, third
from messy_labs import NAMES
from scipy.io import savemat


def times(p, step=0.5):
    return [f"{step * i:.3f}" for i in range(len(p.force))]


def with_times(p, decimal="."):
    return [[t.replace(".", decimal), *row] for t, row in zip(times(p), cells(p, decimal), strict=True)]


def lengths(p, initial=180.0):
    return [repr(initial * (1 - float(c) / 100)) for c in p.contraction]


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


def lvm(p, rows, units, separator="\t", decimal="."):
    head = "LabVIEW Measurement~\nWriter_Version~2\nReader_Version~2\nSeparator~{}\nDecimal_Separator~{}\n"
    head += "Multi_Headings~No\nX_Columns~One\n***End_of_Header***~\n~\nChannels~3\nY_Unit_Label~{}\n"
    head = head.format("Comma" if separator == "," else "Tab", decimal, "~".join(units)).replace("~", separator)
    lines = [["X_Value", "Pressure", "Contraction", "Force", "Comment"], *rows]
    content = f"{head}***End_of_Header***{separator}\n" + "".join(separator.join(row) + "\n" for row in lines)
    return csv(p, content, "rig.lvm")


@kind
def lvm_with_commas(p, rng):
    return lvm(p, with_times(p), ("bar", "%", "N"), ",")


@kind
def lvm_with_remarks(p, rng):
    rows = with_times(p)
    rows[2].append("valve open")
    return lvm(p, rows, ("bar", "%", "N"))


@kind
def lvm_with_decimal_commas(p, rng):
    return lvm(p, with_times(p, ","), ("bar", "%", "N"), decimal=",")


@kind
def lvm_in_kilopascals(p, rng):
    rows = [[t, f"{100 * a:.6f}", f"{b:.6f}", f"{c:.6f}"] for t, (a, b, c) in zip(times(p), numbers(p), strict=True)]
    return lvm(p, rows, ("kPa", "%", "N"))


# Arduino, amplifiers, loggers


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


@kind
def monitor_with_arrows(p, rng):
    """The Arduino IDE's time stamps."""
    lines = [f"14:33:{i:02d}.250 -> {line}" for i, line in enumerate([",".join(HEADER), *map(",".join, cells(p))])]
    return csv(p, "\n".join(lines) + "\n", "monitor.txt")


@kind
def boot_messages_of_an_esp32(p, rng):
    head = "ets Jun  8 2016 00:22:57\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\nconfigsip: 0, SPIWP:0xee\r\n"
    return csv(p, head + text(cells(p), NAMES, ",", end="\r\n"), "putty.log")


@kind
def counts_next_to_pressures(p, rng):
    rows = [[f"{round(102 + 81.8 * float(row[0]))}", *row] for row in cells(p)]
    return csv(p, text(rows, ("pressure_adc", *NAMES), "\t"), "rig.txt")


@kind
def milliseconds_that_overflow(p, rng):
    rows = [[str((4294966000 + 500 * i) % 2**32), *row] for i, row in enumerate(cells(p))]
    return csv(p, text(rows, ("time_ms", *NAMES), ","))


@kind
def catman_with_units_under_the_names(p, rng):
    rows = [["s", "bar", "%", "N"], *with_times(p, ",")]
    head = "CATMAN ASCII\nSample rate 50 Hz\nChannels 4\n\n"
    return csv(p, head + text(rows, ("Zeit", "Druck", "Kontraktion", "Kraft"), "\t", "\r\n"), "rig.asc", "cp1252")


@kind
def marks_of_an_overflow(p, rng):
    """As an Arduino, a PicoLog or catman writes them."""
    rows = with_times(p)
    at = int(np.argmax(p.force))
    rows[at][3] = rng.choice(["ovf", "inf", "nan", "******", "-1000000"])
    return replace(csv(p, text(rows, ("Time [s]", *HEADER), "\t")), truth=p.without([at]))


@kind
def columns_of_means_and_peaks(p, rng):
    rows = [[a, b, f"{1.07 * float(c):.1f}", c] for a, b, c in cells(p)]
    return csv(p, text(rows, (*HEADER[:2], "Force peak [N]", "Force mean [N]"), "\t"))


@kind
def keysight_scans_with_alarms(p, rng):
    rows = [
        [str(i), f"03/12/2024 14:33:{i:02d}:125", a, "0", b, "0", c, "0"] for i, (a, b, c) in enumerate(cells(p), 1)
    ]
    header = ("Scan", "Time", "101 <Pressure> (bar)", "Alarm 101", "102 <Contraction> (%)", "Alarm 102")
    return csv(p, text(rows, (*header, "103 <Force> (N)", "Alarm 103"), ","))


@kind
def keysight_exponents_mapped(p, rng):
    rows = [[f"{v:+.8E}" for v in row] for row in numbers(p)]
    header = ("101 (BAR)", "102 (%)", "103 (N)")
    return csv(p, text(rows, header, ","), columns=dict(zip(header, NAMES, strict=True)))


@kind
def picolog_with_last_values(p, rng):
    header = ("", "Pressure Last (bar)", "Contraction Last (%)", "Force Last (N)")
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p))], header, ","))
