"""Kinds of messy files of loggers that were restarted, zeroed or stuck, and of rows that are no measurements."""

from __future__ import annotations

import io
from dataclasses import replace

import h5py
import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, text, workbook
from nptdms import ChannelObject, TdmsWriter
from openpyxl.styles import PatternFill
from scipy.io import savemat


@kind
def zeroed_in_the_middle(p, rng):
    """The force of the rows above has an offset; the truth lacks it."""
    at = len(p.force) // 2
    rows = cells(replace(p, force=p.force + np.where(np.arange(len(p.force)) < at, 5.0, 0.0)))
    return csv(p, text(rows[:at]) + "# tared\n" + "".join(";".join(row) + "\n" for row in rows[at:]))


@kind
def another_muscle_after_a_comment(p, rng):
    """The truth has the first one alone."""
    other = cells(replace(p, force=(p.force * 0.8).round(1)))
    return csv(p, text(cells(p)) + "# ---- muscle 2 ----\n" + text(other).split("\n", 1)[1])


@kind
def numbers_of_channels_under_the_names(p, rng):
    return csv(p, text([["1", "2", "3"], *cells(p)]))


@kind
def ranges_under_the_names(p, rng):
    return csv(p, text([["10", "30", "5000" if p.force.max() < 5000 else "20000"], *cells(p)]))


@kind
def zeros_after_a_restart(p, rng):
    rows, at = cells(p), int(rng.integers(3, len(p.force) - 3))
    return csv(p, text([*rows[:at], ["0", "0", "0"], *rows[at:]]))


@kind
def offset_and_scale_in_rows(p, rng):
    rows = [["Offset", "0.01", "0.2", "1.5"], ["Scale", "1", "1", "1"]]
    rows += [[str(i), *row] for i, row in enumerate(cells(p), 1)]
    return csv(p, text(rows, ("No", *HEADER)))


@kind
def ranges_under_the_table(p, rng):
    last = [f"{np.ptp(values):.6g}" for values in (p.pressure, p.contraction, p.force)]
    return csv(p, text([*cells(p), last]))


@kind
def force_stuck_for_a_while(p, rng):
    """Six rows have the force of the first of them; in hundredths of a newton, so that no other repeats."""
    force = p.force + rng.uniform(-0.05, 0.05, len(p.force)).round(2)
    force[6:12] = force[6]
    return csv(replace(p), text(cells(replace(p, force=force.round(2)))))


@kind
def decimal_point_lost_at_the_largest_force(p, rng):
    rows, at = cells(replace(p, force=p.force.astype(int) + 0.5)), int(np.argmax(p.force))
    rows[at][2] = rows[at][2].replace(".", "")
    return csv(replace(p, force=p.force.astype(int) + 0.5), text(rows))


@kind
def shortening_in_millimetres_named_percent(p, rng):
    """Of a muscle of 300 mm."""
    return csv(p, text([[a, f"{3 * float(b):g}", c] for a, b, c in cells(p)]))


@kind
def matlab_counts_and_a_vector_of_scales(p, rng):
    stream = io.BytesIO()
    raw = (p.force * 10).round()
    savemat(
        stream, {"pressure_bar": p.pressure, "contraction_percent": p.contraction, "force_N": raw, "cal": [1, 1, 0.1]}
    )
    return File("rig.mat", stream.getvalue(), p)


@kind
def workbook_with_a_red_row(p, rng):
    """The row is wrong; the truth lacks it."""
    at = int(rng.integers(1, len(p.force) - 1))
    rows = numbers(p)
    rows[at][2] *= 1.2

    def mark(book):
        for cell in book.active[at + 2]:
            cell.fill = PatternFill("solid", fgColor="FFFF0000")

    return File("rig.xlsx", workbook([HEADER, *rows], mark), p.without([at]))


def tdms(*segments):
    """Channels of segments, given by names, units, values and other properties."""
    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        for segment in segments:
            writer.write_segment(
                [ChannelObject("rig", n, v, properties={"unit_string": u, **more}) for n, u, v, more in segment]
            )
    return stream.getvalue()


def channels(p, rows=slice(None)):
    columns = (("pressure", "bar", p.pressure), ("contraction", "%", p.contraction), ("force", "N", p.force))
    return [(name, unit, values[rows], {}) for name, unit, values in columns]


@kind
def tdms_channel_that_began_later(p, rng):
    """The force was started 2 s after the others: its values belong to later rows, of which the file lacks the last."""
    begin, last = np.datetime64("2024-03-12T14:00:00", "us"), len(p.force) - 1
    segment = []
    for name, unit, values, _ in channels(p):
        late = 2 * (name == "force")
        start = {"wf_increment": 1.0, "wf_start_time": begin + np.timedelta64(late, "s")}
        segment.append((name, unit, values[late:] if late else values[:-2], start))
    return File("rig.tdms", tdms(segment), p.without([0, 1, last - 1, last]))


# Files of the same loggers and programs with nothing wrong


@kind
def mark_10_gauge(p, rng):
    """Its units are lbF and kgF."""
    unit, factor = (("lbF", 4.4482216152605), ("kgF", 9.80665))[int(rng.integers(2))]
    rows = [[*row[:2], repr(float(row[2]) / factor)] for row in cells(p)]
    return csv(p, text(rows, (*HEADER[:2], f"Load [{unit}]"), ","))


@kind
def gauge_pressure_by_its_unit(p, rng):
    unit, factor = (("psig", 14.503773773), ("barg", 1), ("bar rel", 1), ("hPa", 1000))[int(rng.integers(4))]
    rows = [[repr(float(row[0]) * factor), *row[1:]] for row in cells(p)]
    return csv(p, text(rows, (f"Pressure ({unit})", *HEADER[1:]), ","))


@kind
def table_of_latex(p, rng):
    header = ("p [bar]", "Contraction [%]", "F [N]")
    return csv(p, "".join(" & ".join(row) + " \\\\\n" for row in [header, *cells(p)]), "rig.tex")


@kind
def workbook_of_percents_as_text(p, rng):
    rows = [[a, f"{b:g} %".replace(".", ","), c] for a, b, c in numbers(p)]
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


@kind
def workbook_with_sensors_names_and_units(p, rng):
    head = [["Sensor A", "Sensor B", "Sensor C"], ["Pressure", "Contraction", "Force"], ["kPa", "%", "kN"]]
    return File("rig.xlsx", workbook([*head, *([100 * a, b, c / 1000] for a, b, c in numbers(p))]), p)


@kind
def workbook_with_grouped_rows(p, rng):
    def group(book):
        book.active.row_dimensions.group(4, 7, hidden=True)

    return File("rig.xlsx", workbook([HEADER, *numbers(p)], group), p)


@kind
def matlab_nested_structs(p, rng):
    stream = io.BytesIO()
    sensors = {"pressure_bar": p.pressure, "force_N": p.force}
    savemat(stream, {"log": {"sensors": sensors, "encoder": {"contraction_percent": p.contraction}}})
    return File("rig.mat", stream.getvalue(), p)


@kind
def matlab_row_vectors_of_single_precision(p, rng):
    p = replace(p, pressure=np.float32(p.pressure).astype(float), force=p.force.round())
    stream = io.BytesIO()
    columns = {"pressure_bar": np.float32(p.pressure), "contraction_percent": p.contraction, "force_N": p.force}
    savemat(stream, {name: values[None, :] for name, values in columns.items()}, do_compression=True)
    return File("rig.mat", stream.getvalue(), p)


@kind
def matlab_mask_of_valid_rows(p, rng):
    """The truth lacks the row that it marks."""
    valid, force, at = np.ones(len(p.force), bool), p.force.copy(), int(rng.integers(len(p.force)))
    valid[at], force[at] = False, 1.3 * force[at]
    stream = io.BytesIO()
    columns = {"pressure_bar": p.pressure, "contraction_percent": p.contraction, "force_N": force}
    savemat(stream, {**columns, "valid": valid})
    return File("rig.mat", stream.getvalue(), p.without([at]))


@kind
def tdms_appended(p, rng):
    at = len(p.force) // 2
    return File("rig.tdms", tdms(channels(p, slice(at)), channels(p, slice(at, None))), p)


@kind
def tdms_with_a_linear_scale(p, rng):
    """Integers with NI's scale, which npTDMS applies."""
    linear = {
        "NI_Number_Of_Scales": np.uint32(1),
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.1,
        "NI_Scale[0]_Linear_Y_Intercept": 0.0,
        "NI_Scale[0]_Linear_Input_Source": np.uint32(0xFFFFFFFF),
    }
    raw = ("force", "N", (10 * p.force).round().astype(np.int32), linear)
    return File("rig.tdms", tdms([*channels(p)[:2], raw]), p)


@kind
def pandas_frame_in_hdf5(p, rng):
    """Its fixed format; the columns are given by position."""
    stream = io.BytesIO()
    names = ("pressure_bar", "contraction_percent", "force_N")
    with h5py.File(stream, "w") as file:
        file["df/axis0"] = np.array(names, "S")
        file["df/axis1"] = np.arange(len(p.force))
        file["df/block0_values"] = np.stack([p.pressure, p.contraction, p.force], axis=1)
    columns = {f"df/block0_values(:,{number})": name for number, name in enumerate(names, 1)}
    return File("rig.h5", stream.getvalue(), p, {"columns": columns})


@kind
def lvm_of_points(p, rng):
    head = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\nChannels\t3\nY_Unit_Label\tbar\t%\tN\n"
    names = ("X_Value", "Pressure", "Contraction", "Force", "Comment")
    rows = [[str(number), *row] for number, row in enumerate(cells(p))]
    return csv(p, f"{head}***End_of_Header***\t\t\t\n{text(rows, names, chr(9))}", "rig.lvm")


@kind
def serial_lines_with_carriage_returns_and_a_counter(p, rng):
    rows = [[str(17 * number), *row] for number, row in enumerate(cells(p))]
    return csv(p, text(rows, ("millis", *HEADER), ",", "\r\r\n" if rng.integers(2) else "\r\n"), "serial.txt")
