"""Kinds of messy files: rows that are no measurements, units and scales, two columns of one quantity, offsets.

Importing this adds them to `KINDS`.
"""

from __future__ import annotations

import io
from dataclasses import replace

import h5py
import numpy as np
from messy_kinds import HEADER, File, Points, cells, csv, kind, numbers, text, third
from messy_labs import NAMES
from messy_loggers import lengths

ATMOSPHERE = 1.013  # bar


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


@kind
def maxima_under_the_table(p, rng):
    rows = [*cells(p), [f"{p.pressure.max():g}", f"{p.contraction.max():g}", f"{p.force.max():g}"]]
    return csv(p, text(rows))


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


# Delimiters, units and scales


@kind
def delimiter_before_each_row(p, rng):
    return csv(p, "".join(";" + ";".join(row) + "\n" for row in [HEADER, *cells(p, ",")]))


@kind
def table_with_pipes(p, rng):
    return csv(p, text(cells(p), HEADER, "|"))


@kind
def end_of_data(p, rng):
    return csv(p, text(cells(p)) + rng.choice(["END OF DATA\n", "EOF", "*** end ***\n", "\x1a"]))


@kind
def units_in_other_letters(p, rng):
    units = {"KPA": 100, "Kpa": 100, "BAR": 1, "mBar": 1000, "MPA": 0.1, "mpa": 0.1, "PSI": 14.503773773}
    unit = rng.choice([*units])
    rows = [[repr(a * units[unit]), repr(b), repr(c)] for a, b, c in numbers(p)]
    return csv(p, text(rows, (f"Pressure [{unit}]", *HEADER[1:]), ","))


@kind
def units_after_in(p, rng):
    return csv(p, text(cells(p, ","), ("Druck in bar", "Kontraktion in %", "Kraft in N")))


@kind
def scale_in_the_name(p, rng):
    scales = {"Force x10 [N]": 10, "Force (x 100) [N]": 100, "Force/10 [N]": 0.1, "Force [10 N]": 10}
    scales |= {"Force [10^3 N]": 1000, "Force [N/10]": 0.1, "10*Force [N]": 0.1}
    scales |= {"Pressure x10 [bar]": 10, "Pressure [0.1 bar]": 0.1, "Pressure [1e5 Pa]": 1}
    name = rng.choice([*scales])
    at = 0 if "Pressure" in name else 2
    rows = [[f"{v / scales[name]:.6g}" if i == at else repr(v) for i, v in enumerate(row)] for row in numbers(p)]
    return csv(p, text(rows, [name if i == at else one for i, one in enumerate(HEADER)]))


@kind
def units_that_are_rare(p, rng):
    """Those of forces and pressures on older gauges and scales."""
    units = {"g": 9.80665e-3, "kg": 9.80665, "ozf": 0.27801385, "mN": 1e-3, "lb": 4.4482216152605}
    units |= {"kgf/cm2": 0.980665, "kg/cm²": 0.980665, "at": 0.980665, "atm": 1.01325, "mmHg": 1.33322387415e-3}
    unit = rng.choice([*units])
    column = 2 if [*units].index(unit) < 5 else 0
    rows = [[repr(v / units[unit]) if i == column else repr(v) for i, v in enumerate(row)] for row in numbers(p)]
    return csv(p, text(rows, [f"{name.split()[0]} [{unit}]" if i == column else name for i, name in enumerate(HEADER)]))


@kind
def negative_contractions(p, rng):
    """Contractions counted as negative strains."""
    rows = [[a, f"{-float(b):g}", c] for a, b, c in cells(p)]
    return csv(p, text(rows))


@kind
def units_that_change_from_cell_to_cell(p, rng):
    """Autorange: 850 N, then 1.02 kN."""
    p = p.large()
    forces = [f"{f / 1000:.3f} kN" if f >= 1000 else f"{f:g} N" for f in p.force]
    return csv(p, text(third(cells(p), forces), (*HEADER[:2], rng.choice(["Force", "Force [N]"]))))


@kind
def initial_and_present_length(p, rng):
    rows = [[a, "180", length, c] for (a, _, c), length in zip(cells(p), lengths(p), strict=True)]
    header = (HEADER[0], "Initial length [mm]", "Length [mm]", HEADER[2])
    return csv(p, text(rows, header), initial_length=0.18)


@kind
def hdf5_with_another_unit_than_the_name(p, rng):
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, column in zip(NAMES, np.array(numbers(p), float).T, strict=True):
            file[name] = column * (100 if name == "pressure_bar" else 1)
        file["pressure_bar"].attrs[rng.choice(["unit", "Unit", "Units", "units"])] = "kPa"
    return File("rig.h5", stream.getvalue(), p)


# Two columns of one quantity, two muscles, an offset


@kind
def mean_and_deviation_of_the_force(p, rng):
    rows = [[*row[:2], "0.8", row[2]] for row in cells(p)]
    spread = rng.choice(["Force std [N]", "u(Force) [N]", "σ Force [N]", "Force error [N]"])
    return csv(p, text(rows, (*HEADER[:2], spread, "Force mean [N]")))


@kind
def setpoint_and_actual_in_german(p, rng):
    rows = [[f"{round(2 * float(row[0])) / 2:g}", *row] for row in cells(p)]
    return csv(p, text(rows, ("Druck Soll [bar]", "Druck Ist [bar]", *HEADER[1:])))


@kind
def force_up_and_down(p, rng):
    rows = [[*row, f"{1.1 * float(row[2]):.1f}"] for row in cells(p)]
    loading = [float(row[3]) for row in rows]
    both = Points(*(np.tile(v, 2) for v in (p.pressure, p.contraction)), np.r_[p.force, loading])
    return replace(csv(p, text(rows, (*HEADER[:2], "Force unloading [N]", "Force loading [N]"))), truth=both)


@kind
def two_specimens_in_one_column(p, rng):
    other = [["B", a, b, f"{1.7 * float(c):.1f}"] for a, b, c in cells(p)]
    return csv(p, text([["A", *row] for row in cells(p)] + other, ("Specimen", *HEADER)))


@kind
def offset_with_few_slack_points(p, rng):
    """Two to four points at one pressure, or one at each, where the muscle is slack; the load cell has an offset."""
    offset, noise = rng.uniform([0.03, 0], [0.08, 0.002]) * p.force.max()
    blocks, apart = levels(p), p.contraction[1]
    counts = [int(rng.integers(2, 5))] + [0] * (len(blocks) - 1) if rng.random() < 0.6 else [1] * len(blocks)
    parts = []
    for block, count in zip(blocks, counts, strict=True):
        eps = (30 + apart * np.arange(count)).round(1)
        slack = np.stack([np.full(count, p.pressure[block][0]), eps, np.zeros(count)])
        parts += [np.stack([p.pressure[block], p.contraction[block], p.force[block]]), slack]
    truth = np.concatenate(parts, axis=1)
    measured = truth[2] + offset + noise * rng.standard_normal(truth.shape[1]) * (truth[2] == 0)
    rows = [[f"{v:.6g}" for v in row] for row in zip(truth[0], truth[1], measured, strict=True)]
    return replace(csv(p, text(rows)), truth=Points(*truth))
