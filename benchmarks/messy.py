"""Messy measurement files whose true numbers are known: read right, asked about, or read wrong in silence.

``python benchmarks/messy.py`` writes files of some 60 kinds (the functions marked `kind`), reads each with
`mckibben.dataset.read_dataset`, and compares pressures, contractions and forces with the truth. Where a file does not
determine its numbers (two columns of forces, say), only a question is right. Files that are wrong in silence are listed
with the seeds that ``--repeat KIND SEED`` writes and reads again; the exit code is 1 if there are any.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
from nptdms import ChannelObject, TdmsWriter
from openpyxl.comments import Comment
from scipy.io import savemat

from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.errors import McKibbenError


@dataclass(frozen=True)
class Points:
    """True points: pressure [bar], contraction [%] and force [N]."""

    pressure: np.ndarray
    contraction: np.ndarray
    force: np.ndarray

    @staticmethod
    def drawn(rng: np.random.Generator) -> Points:
        """Points of a muscle of 10 to 40 mm: three or four pressures, taut at each contraction."""
        diameter = rng.choice([10, 20, 40]) * 1e-3
        levels = np.sort(rng.choice([1.5, 2, 2.5, 3, 4, 5, 6], rng.integers(3, 5), replace=False))
        eps = np.linspace(0, rng.choice([12, 15, 18]), rng.integers(5, 9)).round(1)
        p, c = np.repeat(levels, len(eps)), np.tile(eps, len(levels))
        p = (p + rng.uniform(-0.02, 0.02, len(p))).round(2)
        force = 8.2 * np.pi / 4 * diameter**2 * p * 1e5 * (1 - c / 28) ** 2 * rng.uniform(0.97, 1.03, len(p))
        return Points(p, c, force.round(1))

    def rounded(self) -> Points:
        """Forces in whole newtons."""
        return replace(self, force=self.force.round())

    def large(self) -> Points:
        """Whole forces of a muscle of 40 mm, of which some are above 1000 N."""
        return replace(self, force=(self.force * 3000 / self.force.max()).round())

    def huge(self) -> Points:
        """Whole forces all above 1000 N."""
        return replace(self, force=(1000 + self.force * 5000 / self.force.max()).round())

    def without(self, rows: Sequence[int]) -> Points:
        """Points without some rows."""
        return Points(*(np.delete(v, rows) for v in (self.pressure, self.contraction, self.force)))


@dataclass(frozen=True)
class File:
    """Name and content of a file, its truth, and options of the reader."""

    name: str
    content: bytes
    truth: Points
    options: dict[str, Any] = field(default_factory=dict)


KINDS: dict[str, Callable[[Points, np.random.Generator], File]] = {}


def kind(make: Callable[[Points, np.random.Generator], File]) -> Callable[[Points, np.random.Generator], File]:
    KINDS[make.__name__] = make
    return make


HEADER = ("Pressure [bar]", "Contraction [%]", "Force [N]")


def one_of(rng: np.random.Generator, texts: Sequence[str]) -> str:
    """One of several texts, at random."""
    return str(rng.choice(texts))


def plain(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e5 and float(f"{value:g}") == value else repr(float(value))


def grouped(value: float, sign: str = ",", decimal: str = ".") -> str:
    """With thousands separators."""
    text = f"{int(value):,}" if value == int(value) else f"{value:,}"
    return text.replace(",", "\0").replace(".", decimal).replace("\0", sign)


def cells(points: Points, decimal: str = ".") -> list[list[str]]:
    rows = zip(points.pressure, points.contraction, points.force, strict=True)
    return [[plain(v).replace(".", decimal) for v in row] for row in rows]


def text(rows: Sequence[Sequence[str]], header: Sequence[str] = HEADER, delimiter: str = ";", end: str = "\n") -> str:
    return "".join(delimiter.join(row) + end for row in [header, *rows])


def csv(points: Points, content: str, name: str = "rig.csv", encoding: str = "utf-8", **options: Any) -> File:
    return File(name, content.encode(encoding), points, options)


def third(rows: list[list[str]], forces: Sequence[str]) -> list[list[str]]:
    """Rows with other forces."""
    return [[*row[:2], force] for row, force in zip(rows, forces, strict=True)]


@kind
def aligned_with_blanks(p, rng):
    header = ("pressure_bar", "contraction_percent", "force_N")
    return csv(p, "".join("".join(f"{c:>20}" for c in row) + "\n" for row in [header, *cells(p)]), "rig.dat")


@kind
def quoted_decimal_commas(p, rng):
    return csv(p, text([[f'"{c}"' for c in row] for row in cells(p, ",")], delimiter=","))


@kind
def decimal_commas_in_a_comma_file(p, rng):
    return csv(p, text([[f"{float(c):.1f}".replace(".", ",") for c in row] for row in cells(p)], delimiter=","))


def whole(p, forces):
    """Points with the forces of others, and whole pressures and contractions."""
    return replace(forces, pressure=p.pressure.round(), contraction=p.contraction.round())


@kind
def thousands_points_with_semicolons(p, rng):
    p = whole(p, p.huge())
    return csv(p, text(third(cells(p), [grouped(f, ".", ",") for f in p.force])))


@kind
def thousands_points_and_decimal_commas(p, rng):
    p = replace(p.huge(), force=p.huge().force + 0.5)
    return csv(p, text(third(cells(p, ","), [grouped(f, ".", ",") for f in p.force])))


@kind
def thousands_unquoted_in_all_rows_before_a_note(p, rng):
    p = whole(p, p.huge())
    rows = [[*row, grouped(f), ""] for row, f in zip((r[:2] for r in cells(p)), p.force, strict=True)]
    return csv(p, text(rows, (*HEADER, "note"), ","))


@kind
def row_numbers_without_a_name(p, rng):
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p), 1)], delimiter=","))


@kind
def truncated_number(p, rng):
    p = replace(p, force=p.force.astype(int) + 0.75)
    return csv(p, text(third(cells(p), [f"{f:.2f}" for f in p.force]))[:-2])


@kind
def empty_cell(p, rng):
    rows = cells(p, ",")
    rows[int(rng.integers(len(rows)))][int(rng.integers(3))] = ""
    return csv(p, text(rows))


@kind
def copied_block(p, rng):
    """Rows appended twice; the truth has each once."""
    return csv(p, text([*cells(p), *cells(p)]))


@kind
def row_of_units(p, rng):
    return csv(p, text([["bar", "%", "N"], *cells(p, ",")], ("Pressure", "Contraction", "Force")))


@kind
def force_raw_and_force_filtered(p, rng):
    rows = [[a, b, plain(round(float(c) * 1.1 + 3, 1)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (*HEADER[:2], "Force raw [N]", "Force filtered [N]")))


@kind
def supply_and_muscle_pressure(p, rng):
    rows = [["8", *row] for row in cells(p)]
    return csv(p, text(rows, ("Supply pressure [bar]", *HEADER)))


@kind
def absolute_pressure(p, rng):
    rows = [[plain(round(float(a) + 1.013, 3)), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [bar abs]", *HEADER[1:])))


@kind
def kilopascals_named_bar(p, rng):
    return csv(
        p, text([[plain(round(float(a) * 100)), b, c] for a, b, c in cells(replace(p, pressure=p.pressure.round(1)))])
    )


@kind
def kilonewtons_named_newtons(p, rng):
    return csv(p, text([[a, b, f"{float(c) / 1000:.5f}"] for a, b, c in cells(p)]))


@kind
def lengths_without_initial_length(p, rng):
    rows = [[a, repr(250 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Length [mm]", HEADER[2])))


@kind
def lengths_with_a_wrong_initial_length(p, rng):
    rows = [[a, repr(250 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Length [mm]", HEADER[2])), initial_length=0.22)


def marked(p: Points, rng: np.random.Generator, column: int, mark: str, times: int = 1) -> tuple[str, Points]:
    rows, at = cells(p), rng.choice(len(p.force), times, replace=False)
    for one in at:
        rows[one][column] = mark
    return text(rows), p.without(at)


@kind
def minus_9999_among_forces(p, rng):
    content, truth = marked(p, rng, 2, "-9999")
    return csv(truth, content)


@kind
def mark_999_9_among_forces(p, rng):
    content, truth = marked(p, rng, 2, "999.9", int(rng.integers(1, 3)))
    return csv(truth, content)


@kind
def clipped_forces(p, rng):
    limit = np.quantile(p.force, 0.8).round(1)
    return csv(p, text(cells(replace(p, force=p.force.clip(max=limit)))))


@kind
def zeros_for_missing_forces(p, rng):
    """A force of 0 at a contraction where the muscle is taut; the truth lacks the row."""
    content, truth = marked(p, rng, 2, "0")
    return csv(truth, content)


def workbook(rows: Sequence[Sequence[Any]], change: Callable[[Any], None] = lambda book: None) -> bytes:
    book = openpyxl.Workbook()
    sheet = book.active
    for row in rows:
        sheet.append(list(row))
    change(book)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def numbers(p: Points) -> list[list[Any]]:
    return [list(map(float, row)) for row in zip(p.pressure, p.contraction, p.force, strict=True)]


@kind
def excel_hidden_rows(p, rng):
    """The hidden rows are outliers that were filtered out."""
    rows, at = numbers(p), sorted(rng.choice(len(p.force), 2, replace=False))
    for one in at:
        rows[one][2] *= 0.5

    def hide(book):
        for one in at:
            book.active.row_dimensions[int(one) + 2].hidden = True

    return File("rig.xlsx", workbook([HEADER, *rows], hide), p.without(at))


def hdf5(p: Points, change: Callable[[Any], None] = lambda file: None, name: str = "rig.h5") -> File:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for key, values, unit in (
            ("Pressure", p.pressure, "bar"),
            ("Contraction", p.contraction, "%"),
            ("Force", p.force, "N"),
        ):
            file.create_dataset(key, data=values).attrs["units"] = unit
        change(file)
    return File(name, stream.getvalue(), p)


def packed(file: Any, key: str, values: np.ndarray, **attributes: Any) -> None:
    unit = file[key].attrs["units"]
    del file[key]
    file.create_dataset(key, data=values).attrs.update({"units": unit, **attributes})


@kind
def hdf5_fill_value(p, rng):
    at = int(rng.integers(len(p.force)))
    values = p.force.copy()
    values[at] = mark = rng.choice([-1.0, 0.0, 123.0])
    return replace(hdf5(p, lambda f: packed(f, "Force", values, _FillValue=mark)), truth=p.without([at]))


@kind
def hdf5_saturated_bytes(p, rng):
    """Forces in a type of 8 bits that ends below the largest."""
    p = replace(p, force=(p.force * 400 / p.force.max()).round())
    return hdf5(p, lambda f: packed(f, "Force", p.force.clip(max=255).astype(np.uint8)))


def block(p):
    """Rows of a level."""
    return int(np.argmax(np.append(np.abs(np.diff(p.pressure)) > 0.06, True))) + 1


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


def scaled(p, column, factor, digits=6):
    rows = cells(p)
    for row in rows:
        row[column] = plain(round(float(row[column]) * factor, digits))
    return rows


@kind
def merged_names_over_split_decimals(p, rng):
    """Decimal commas split by commas under names with empty ones between."""
    rows = [[x for c in row for x in f"{float(c):.1f}".split(".")] for row in cells(p)]
    return csv(p, text(rows, [x for n in HEADER for x in (n, "")], ","))


@kind
def force_and_contraction_swapped(p, rng):
    q = replace(p, force=(p.force * 20 / p.force.max()).round(2))
    return csv(q, text([[a, c, b] for a, b, c in cells(q)]))


@kind
def pressure_clipped(p, rng):
    limit = np.unique(p.pressure)[-int(len(p.pressure) * 0.3)]
    return csv(p, text(cells(replace(p, pressure=p.pressure.clip(max=limit)))))


def times(p, step=0.5):
    return [f"{step * i:.3f}" for i in range(len(p.force))]


def means(p, rows=slice(None)):
    """Mean of points, with the decimals that people print."""
    a, b, c = (v[rows].mean() for v in (p.pressure, p.contraction, p.force))
    return [f"{a:.2f}", f"{b:.1f}", f"{c:.1f}"]


def levels(p):
    """Slices of the pressures."""
    count = len(np.unique(p.contraction))
    return [slice(at, at + count) for at in range(0, len(p.force), count)]


@kind
def mean_after_each_pressure(p, rng):
    rows = []
    for block in levels(p):
        rows += [*cells(p)[block], means(p, block)]
    return csv(p, text(rows))


@kind
def maxima_under_the_table(p, rng):
    rows = [*cells(p), [f"{p.pressure.max():g}", f"{p.contraction.max():g}", f"{p.force.max():g}"]]
    return csv(p, text(rows))


@kind
def zeroed_in_the_middle(p, rng):
    """The force of the rows above has an offset; the truth lacks it."""
    at = len(p.force) // 2
    rows = cells(replace(p, force=p.force + np.where(np.arange(len(p.force)) < at, 5.0, 0.0)))
    return csv(p, text(rows[:at]) + "# tared\n" + "".join(";".join(row) + "\n" for row in rows[at:]))


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
def force_stuck_for_a_while(p, rng):
    """Six rows have the force of the first of them; in hundredths of a newton, so that no other repeats."""
    force = p.force + rng.uniform(-0.05, 0.05, len(p.force)).round(2)
    force[6:12] = force[6]
    return csv(replace(p), text(cells(replace(p, force=force.round(2)))))


@kind
def matlab_counts_and_a_vector_of_scales(p, rng):
    stream = io.BytesIO()
    raw = (p.force * 10).round()
    savemat(
        stream, {"pressure_bar": p.pressure, "contraction_percent": p.contraction, "force_N": raw, "cal": [1, 1, 0.1]}
    )
    return File("rig.mat", stream.getvalue(), p)


def channels(p, rows=slice(None)):
    columns = (("pressure", "bar", p.pressure), ("contraction", "%", p.contraction), ("force", "N", p.force))
    return [(name, unit, values[rows], {}) for name, unit, values in columns]


@kind
def offset_of_the_load_cell_without_slack_points(p, rng):
    return csv(p, text(cells(replace(p, force=p.force + round(0.2 * p.force.max())))))


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


KINDS |= {
    "comma_and_point": lambda p, rng: csv(p, text(cells(p), delimiter=",")),
    "semicolon_and_comma": lambda p, rng: csv(p, text(cells(p, ","))),
    "utf16": lambda p, rng: csv(p, text(cells(p, ",")), encoding="utf-16"),
    "truncated_row": lambda p, rng: csv(p, text(cells(p)).rstrip("\n").rpartition(";")[0]),
    "units_in_the_cells": lambda p, rng: csv(p, text([[f"{a} bar", f"{b} %", f"{c} N"] for a, b, c in cells(p)])),
    "preamble": lambda p, rng: csv(p, "Rig;3\nDate;12.03.2024\nSensor;U9C\n\n" + text(cells(p, ","))),
    "no_header": lambda p, rng: csv(p, text(cells(p)[1:], cells(p)[0])),
    "ratios_named_percent": lambda p, rng: csv(p, text([[a, f"{float(b) / 100:.4f}", c] for a, b, c in cells(p)])),
    "pull_is_negative": lambda p, rng: csv(p, text([[a, b, f"-{c}"] for a, b, c in cells(p)])),
    "mean_under_the_table": lambda p, rng: csv(p, text([*cells(p), means(p)])),
    "numbers_of_channels_under_the_names": lambda p, rng: csv(p, text([["1", "2", "3"], *cells(p)])),
}
"""Kinds of one line."""


def outcome(name: str, seed: int, folder: Path) -> tuple[str, str]:
    """Write a file of a kind, read it, and compare it with the truth: right, asked or silent, and why."""
    rng = np.random.default_rng([seed, *name.encode()])
    file = KINDS[name](Points.drawn(rng), rng)
    path = folder / file.name
    path.write_bytes(file.content)
    try:
        data = read_dataset(path, **file.options)
    except McKibbenError as error:
        return "asked", str(error)
    wrong = different(file.truth, data)
    return ("silent" if wrong else "right"), wrong


def different(truth: Points, data: IsobaricDataset) -> str:
    """First difference between the truth and a dataset; empty if there is none."""
    for name, factor in (("pressure", 1e5), ("contraction", 0.01), ("force", 1.0)):
        expected, values = getattr(truth, name) * factor, getattr(data, name)
        if len(values) != len(expected):
            return f"{len(values)} points instead of {len(expected)}"
        off = np.abs(values - expected) > 1e-6 * np.abs(expected).max()
        if off.any():
            at = int(np.argmax(off))
            return f"{name} {values[at] / factor:g} instead of {expected[at] / factor:g} at point {at}"
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=len(KINDS), metavar="N", help="files of all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--repeat", nargs=2, metavar=("KIND", "SEED"), help="one file, written to the current folder")
    options = parser.parse_args()
    if options.repeat:
        print(*outcome(options.repeat[0], int(options.repeat[1]), Path()), sep=": ")
        return 0
    kinds, counts = [*KINDS], Counter()
    with tempfile.TemporaryDirectory() as folder:
        for index in range(options.files):
            name, seed = kinds[index % len(kinds)], options.seed + index // len(kinds)
            result, why = outcome(name, seed, Path(folder))
            counts[result] += 1
            if result == "silent":
                print(f"wrong in silence: {name} {seed}: {why}")
    shown = ", ".join(f"{counts[result]} {result}" for result in ("right", "asked", "silent"))
    print(f"{options.files} files of {len(kinds)} kinds: {shown}")
    return 1 if counts["silent"] else 0


if __name__ == "__main__":
    sys.exit(main())
