"""Kinds of messy files of sensors that fail, of numbers that need a scale, and of units that change."""

from __future__ import annotations

import io
from dataclasses import replace

import h5py
import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, text, workbook
from nptdms import ChannelObject, TdmsWriter
from openpyxl.comments import Comment
from scipy.io import savemat

# Sensors and units that change or fail within a file


@kind
def force_in_kilonewtons_from_a_comment_on(p, rng):
    """The amplifier's range is switched in the middle of the file."""
    at = int(rng.integers(len(p.force) // 3, len(p.force) // 2))
    rows = cells(p)
    late = [[a, b, f"{float(c) / 1000:.4f}"] for a, b, c in rows[at:]]
    content = text(rows[:at]) + "# amplifier switched: force now in kN\n" + text(late).split("\n", 1)[1]
    return csv(p, content)


@kind
def amplifier_gain_in_a_comment(p, rng):
    return csv(p, "# amplifier gain: 10, divide the force by it\n" + text(cells(replace(p, force=10 * p.force))))


@kind
def offset_of_the_load_cell_without_slack_points(p, rng):
    return csv(p, text(cells(replace(p, force=p.force + round(0.2 * p.force.max())))))


@kind
def pressure_sensor_stuck(p, rng):
    return csv(p, text(cells(replace(p, pressure=np.full(len(p.pressure), p.pressure[0])))))


@kind
def length_sensor_lost_for_a_row(p, rng):
    """Its reading of 0 is a contraction of 0."""
    at = int(rng.choice(np.flatnonzero(p.contraction > 0.6 * p.contraction.max())))
    lost = p.contraction.copy()
    lost[at] = 0
    return csv(p, text(cells(replace(p, contraction=lost))))


@kind
def length_sensor_at_its_end(p, rng):
    return csv(p, text(cells(replace(p, contraction=np.minimum(p.contraction, 0.5 * p.contraction.max())))))


@kind
def amplifier_saturated_with_noise(p, rng):
    """At 40 % of the largest force: a single saturated point is not to be told from noise."""
    limit = 0.4 * p.force.max() * rng.uniform(0.996, 1.0, len(p.force))
    force = np.minimum(p.force, limit)
    return csv(p, text(cells(replace(p, force=force.round(2)))))


@kind
def matlab_counts_and_a_scale(p, rng):
    stream = io.BytesIO()
    counts = np.round(p.force / 0.05).astype(np.int32)
    savemat(stream, {"p": p.pressure, "c": p.contraction, "F": counts, "F_scale": 0.05})
    mapped = {"p": "pressure_bar", "c": "contraction_percent", "F": "force_N"}
    return File("rig.mat", stream.getvalue(), p, {"columns": mapped})


@kind
def hdf5_counts_and_an_attribute(p, rng):
    """A scale in an attribute of the column, of its group, or beside it."""
    stream = io.BytesIO()
    where = rng.integers(3)
    with h5py.File(stream, "w") as file:
        group = file.create_group("daq")
        for name, values, unit in (("pressure", p.pressure, "bar"), ("contraction", p.contraction, "%")):
            group.create_dataset(name, data=values).attrs["units"] = unit
        force = group.create_dataset("force", data=np.round(p.force / 0.05).astype(np.int32))
        force.attrs["Units"] = "N"
        if where == 0:
            force.attrs[rng.choice(["lsb", "sensitivity", "calibration", "resolution"])] = 0.05
        elif where == 1:
            group.attrs["force_scale"] = 0.05
        else:
            group["force_scale"] = 0.05
    return File("rig.h5", stream.getvalue(), p)


@kind
def tdms_counts_and_a_property(p, rng):
    stream = io.BytesIO()
    channels = [
        ChannelObject("daq", "Pressure", p.pressure, {"unit_string": "bar"}),
        ChannelObject("daq", "Contraction", p.contraction, {"unit_string": "%"}),
        ChannelObject("daq", "Force", np.round(p.force / 0.05), {"unit_string": "N", "Scale": 0.05}),
    ]
    with TdmsWriter(stream) as writer:
        writer.write_segment(channels)
    return File("rig.tdms", stream.getvalue(), p)


@kind
def workbook_with_a_note_at_a_cell(p, rng):
    """The note says that the row is invalid; the truth lacks it."""
    at = int(rng.integers(1, len(p.force)))
    force = p.force * np.where(np.arange(len(p.force)) == at, 0.9, 1)

    def note(book):
        book.active.cell(at + 2, 3).comment = Comment("cable slipped, discard", "AB")

    return File("rig.xlsx", workbook([HEADER, *numbers(replace(p, force=force))], note), p.without([at]))


@kind
def dutch(p, rng):
    return csv(p, text(cells(p, ","), ("Druk [bar]", "Contractie [%]", "Kracht [N]")))


@kind
def german_gauge_pressure(p, rng):
    return csv(p, text(cells(p, ","), ("Überdruck in bar", "Verkürzung in %", "Zugkraft in N")), encoding="cp1252")


@kind
def full_width_brackets(p, rng):
    return csv(p, text(cells(p), ("圧力（bar）", "収縮率（％）", "引張力（N）"), ","))


@kind
def newtons_per_square_millimetre(p, rng):
    rows = [[f"{float(a) / 10:.4g}", b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [N/mm²]", *HEADER[1:])))


@kind
def workbook_of_shares_shown_in_percent(p, rng):
    rows = numbers(replace(p, contraction=p.contraction / 100))

    def show(book):
        for cell in book.active["B"][1:]:
            cell.number_format = "0.0%"

    return File("rig.xlsx", workbook([("Pressure [bar]", "Contraction", "Force [N]"), *rows], show), p)
