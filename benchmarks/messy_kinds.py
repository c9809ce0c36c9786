"""Kinds of messy files: functions from true points and a random generator to a file, its true points and options."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import h5py
import numpy as np
import openpyxl
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat


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


LIMITS: dict[str, Callable[[Points, np.random.Generator], File]] = {}
"""Kinds whose files do not say that their numbers are wrong: no reader can know."""


def limit(make: Callable[[Points, np.random.Generator], File]) -> Callable[[Points, np.random.Generator], File]:
    LIMITS[make.__name__] = make
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


# Delimiters and decimal signs


@kind
def comma_and_point(p, rng):
    return csv(p, text(cells(p), delimiter=","))


@kind
def semicolon_and_comma(p, rng):
    return csv(p, text(cells(p, ",")))


@kind
def semicolon_and_point(p, rng):
    return csv(p, text(cells(p)))


@kind
def tab_and_comma(p, rng):
    return csv(p, text(cells(p, ","), delimiter="\t"), "rig.txt")


@kind
def tab_and_point(p, rng):
    return csv(p, text(cells(p), delimiter="\t"), "rig.txt")


@kind
def aligned_with_blanks(p, rng):
    header = ("pressure_bar", "contraction_percent", "force_N")
    return csv(p, "".join("".join(f"{c:>20}" for c in row) + "\n" for row in [header, *cells(p)]), "rig.dat")


@kind
def blanks_and_decimal_commas(p, rng):
    header = ("pressure_bar", "contraction_percent", "force_N")
    return csv(p, text(cells(p, ","), header, " "), "rig.dat")


@kind
def quoted_decimal_commas(p, rng):
    return csv(p, text([[f'"{c}"' for c in row] for row in cells(p, ",")], delimiter=","))


@kind
def decimal_commas_in_a_comma_file(p, rng):
    return csv(p, text([[f"{float(c):.1f}".replace(".", ",") for c in row] for row in cells(p)], delimiter=","))


@kind
def decimal_comma_in_the_first_column(p, rng):
    """Pressures 1,5 2,5 3,5 before whole numbers, so that the first cells count as row numbers do."""
    n = rng.integers(4, 7)
    pressure = np.arange(1, n + 1) + rng.integers(1, 9) / 10
    points = Points(pressure, np.full(n, 5.0), (80 * pressure).round())
    return csv(points, text(cells(points, ","), delimiter=","))


@kind
def mixed_decimal_signs(p, rng):
    forces = [f"{f:.1f}".replace(".", ",") for f in p.force]
    return csv(p, text(third(cells(p), forces)))


@kind
def mixed_decimal_signs_of_three_digits(p, rng):
    """Pressures with points; forces such as 123,456, which are not thousands."""
    exact = replace(p, force=(p.force + 2).clip(max=990).round() + 0.125)
    return csv(exact, text(third(cells(exact), [f"{f:.3f}".replace(".", ",") for f in exact.force])))


# Thousands


def whole(p, forces):
    """Points with the forces of others, and whole pressures and contractions."""
    return replace(forces, pressure=p.pressure.round(), contraction=p.contraction.round())


@kind
def thousands_points_with_semicolons(p, rng):
    p = whole(p, p.huge())
    return csv(p, text(third(cells(p), [grouped(f, ".", ",") for f in p.force])))


@kind
def thousands_commas_with_tabs(p, rng):
    p = whole(p, p.huge())
    return csv(p, text(third(cells(p), [grouped(f) for f in p.force]), delimiter="\t"), "rig.txt")


@kind
def some_thousands_points_with_semicolons(p, rng):
    p = whole(p, p.large())
    return csv(p, text(third(cells(p), [grouped(f, ".", ",") for f in p.force])))


@kind
def thousands_points_and_decimal_commas(p, rng):
    p = replace(p.huge(), force=p.huge().force + 0.5)
    return csv(p, text(third(cells(p, ","), [grouped(f, ".", ",") for f in p.force])))


@kind
def thousands_commas_and_decimal_points(p, rng):
    p = replace(p.huge(), force=p.huge().force + 0.5)
    return csv(p, text(third(cells(p), [grouped(f) for f in p.force])))


@kind
def thousands_points_settled_by_other_columns(p, rng):
    p = p.large()
    return csv(p, text(third(cells(p, ","), [grouped(f, ".", ",") for f in p.force])))


@kind
def thousands_commas_settled_by_other_columns(p, rng):
    p = p.large()
    return csv(p, text(third(cells(p), [grouped(f) for f in p.force]), delimiter="\t"), "rig.txt")


@kind
def quoted_thousands_in_a_comma_file(p, rng):
    p = p.large()
    return csv(p, text(third(cells(p), [f'"{grouped(f)}"' for f in p.force]), delimiter=","))


@kind
def thousands_blanks(p, rng):
    p = p.large()
    blank = rng.choice([" ", "\u00a0", "\u202f"])
    return csv(p, text(third(cells(p, ","), [grouped(f, blank) for f in p.force])))


@kind
def thousands_apostrophes(p, rng):
    p = p.large()
    return csv(p, text(third(cells(p), [grouped(f, rng.choice(["'", "’"])) for f in p.force])))


@kind
def thousands_unquoted_before_an_empty_note(p, rng):
    p = p.large()
    rows = [[*row, grouped(f), ""] for row, f in zip((r[:2] for r in cells(p)), p.force, strict=True)]
    return csv(p, text(rows, (*HEADER, "note"), ","))


@kind
def thousands_unquoted_in_all_rows_before_a_note(p, rng):
    p = whole(p, p.huge())
    rows = [[*row, grouped(f), ""] for row, f in zip((r[:2] for r in cells(p)), p.force, strict=True)]
    return csv(p, text(rows, (*HEADER, "note"), ","))


@kind
def thousands_unquoted_before_a_note_left_out(p, rng):
    p = p.huge()
    rows = [[*row, grouped(f)] for row, f in zip((r[:2] for r in cells(p)), p.force, strict=True)]
    return csv(p, text(rows, (*HEADER, "note"), ","))


@kind
def thousands_blanks_between_blanks(p, rng):
    p = p.huge()
    rows = [[*row, grouped(f, " ")] for row, f in zip((r[:2] for r in cells(p)), p.force, strict=True)]
    return csv(p, text(rows, ("pressure_bar", "contraction_percent", "force_N", "note"), " "), "rig.dat")


@kind
def thousands_millions_in_pascals(p, rng):
    pa = [grouped(round(v * 1e5), ".", ",") for v in p.pressure]
    rows = [[a, *row[1:]] for a, row in zip(pa, cells(p, ","), strict=True)]
    return csv(p, text(rows, ("Pressure [Pa]", *HEADER[1:])))


@kind
def three_decimals_everywhere_above_one(p, rng):
    p = Points(p.pressure, p.contraction + 1, (p.force + 10).clip(max=990))
    return csv(p, text([[f"{float(c):.3f}".replace(".", ",") for c in row] for row in cells(p)]))


@kind
def three_decimals_everywhere(p, rng):
    p = replace(p, force=p.force.clip(max=990))
    return csv(p, text([[f"{float(c):.3f}".replace(".", ",") for c in row] for row in cells(p)]))


@kind
def three_decimals_with_points_and_commas_between(p, rng):
    p = Points(p.pressure, p.contraction + 1, (p.force + 10).clip(max=990))
    return csv(p, text([[f"{float(c):.3f}" for c in row] for row in cells(p)], delimiter=","))


# Rows


@kind
def delimiter_after_each_row(p, rng):
    return csv(p, text(cells(p), delimiter=",", end=",\n"))


@kind
def delimiter_after_rows_but_not_the_header(p, rng):
    return csv(p, ",".join(HEADER) + "\n" + "".join(",".join(row) + ",\n" for row in cells(p)))


@kind
def semicolons_after_rows_but_not_the_header(p, rng):
    return csv(p, ";".join(HEADER) + "\n" + "".join(";".join(row) + ";;\n" for row in cells(p, ",")))


@kind
def windows_line_ends_and_mark(p, rng):
    return csv(p, text(cells(p, ","), end="\r\n"), encoding="utf-8-sig")


@kind
def utf16(p, rng):
    return csv(p, text(cells(p, ",")), encoding="utf-16")


@kind
def row_numbers_with_a_name(p, rng):
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p), 1)], ("No", *HEADER), ","))


@kind
def row_numbers_without_a_name(p, rng):
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p), 1)], delimiter=","))


@kind
def row_numbers_without_a_name_and_semicolons(p, rng):
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p, ","), 1)]))


@kind
def row_numbers_under_an_empty_name(p, rng):
    return csv(p, text([[str(i), *row] for i, row in enumerate(cells(p))], ("", *HEADER), ","))


@kind
def quoted_row_names(p, rng):
    header = [f'"{name}"' for name in HEADER]
    return csv(p, text([[f'"{i}"', *row] for i, row in enumerate(cells(p), 1)], header, ","))


@kind
def blank_lines(p, rng):
    return csv(p, text(cells(p), end="\n\n"))


@kind
def lines_of_delimiters(p, rng):
    rows = cells(p, ",")
    rows.insert(int(rng.integers(1, len(rows))), ["", "", ""])
    return csv(p, text(rows) + ";;\n;;\n")


@kind
def header_again_in_the_middle(p, rng):
    rows = cells(p)
    rows.insert(len(rows) // 2, list(HEADER))
    return csv(p, text(rows))


@kind
def truncated_row(p, rng):
    return csv(p, text(cells(p)).rstrip("\n").rpartition(";")[0])


@kind
def truncated_number(p, rng):
    p = replace(p, force=p.force.astype(int) + 0.75)
    return csv(p, text(third(cells(p), [f"{f:.2f}" for f in p.force]))[:-2])


@kind
def text_instead_of_a_number(p, rng):
    rows = cells(p)
    rows[int(rng.integers(len(rows)))][2] = one_of(rng, ["---", "NaN", "n/a", "#DIV/0!", "ERR", "OL", "inf"])
    return csv(p, text(rows))


@kind
def empty_cell(p, rng):
    rows = cells(p, ",")
    rows[int(rng.integers(len(rows)))][int(rng.integers(3))] = ""
    return csv(p, text(rows))


@kind
def units_in_the_cells(p, rng):
    return csv(p, text([[f"{a} bar", f"{b} %", f"{c} N"] for a, b, c in cells(p)]))


@kind
def exponents(p, rng):
    values = zip(p.pressure, p.contraction, p.force, strict=True)
    return csv(p, text([[f"{v:.6e}" for v in row] for row in values], delimiter=","))


@kind
def exponents_of_fortran(p, rng):
    values = zip(p.pressure, p.contraction, p.force, strict=True)
    return csv(p, text([[f"{v:.6e}".replace("e", "D") for v in row] for row in values], delimiter=","))


@kind
def minus_sign_of_typography(p, rng):
    p = replace(p, contraction=p.contraction - 1)
    return csv(p, text([[c.replace("-", "\u2212") for c in row] for row in cells(p)]))


@kind
def unclosed_quote(p, rng):
    rows = cells(p)
    rows[int(rng.integers(len(rows)))][1] = '"5'
    return csv(p, text(rows))


@kind
def copied_block(p, rng):
    """Rows appended twice; the truth has each once."""
    return csv(p, text([*cells(p), *cells(p)]))


# Headers and lines before them


@kind
def row_of_units(p, rng):
    return csv(p, text([["bar", "%", "N"], *cells(p, ",")], ("Pressure", "Contraction", "Force")))


@kind
def comments(p, rng):
    return csv(p, "# rig 3\n# specimen: MAS-10\n# operator: A, B; C\n" + text(cells(p)))


@kind
def preamble(p, rng):
    return csv(p, "Rig;3\nDate;12.03.2024\nSensor;U9C\n\n" + text(cells(p, ",")))


@kind
def no_header(p, rng):
    return csv(p, text(cells(p)[1:], cells(p)[0]))


@kind
def no_header_with_positions(p, rng):
    columns = {"1": "pressure_bar", "2": "contraction_percent", "3": "force_N"}
    return csv(p, text(cells(p)[1:], cells(p)[0]), columns=columns)


@kind
def german_header_mapped(p, rng):
    header = ("Druck [bar]", "Kürzung [%]", "Kraft [N]")
    names = dict(zip(header, ("pressure_bar", "contraction_percent", "force_N"), strict=True))
    return csv(p, text(cells(p, ","), header), encoding="cp1252", columns=names)


@kind
def german_header(p, rng):
    return csv(p, text(cells(p, ","), ("Druck [bar]", "Kürzung [%]", "Kraft [N]")), encoding="cp1252")


@kind
def header_with_slashes(p, rng):
    return csv(p, text(cells(p), ("p / bar", "Contraction / %", "F / N")))


@kind
def header_in_capitals(p, rng):
    return csv(p, text(cells(p), ("PRESSURE (BAR)", " CONTRACTION (%) ", "FORCE (N)")))


@kind
def other_order_and_more_columns(p, rng):
    rows = [[f"{20 + i / 10:.1f}", c, b, "ok", a] for i, (a, b, c) in enumerate(cells(p))]
    return csv(p, text(rows, ("Temp [°C]", "Force [N]", "Contraction [%]", "state", "Pressure [bar]"), ","))


@kind
def two_equal_headers(p, rng):
    rows = [[*row, plain(float(row[2]) + 5)] for row in cells(p)]
    return csv(p, text(rows, (*HEADER, HEADER[2])))


@kind
def force_and_force_filtered(p, rng):
    """The filtered force is the true one."""
    rows = [[a, b, plain(round(float(c) * 1.1 + 3, 1)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (*HEADER, "Force filtered [N]")))


@kind
def force_raw_and_force_filtered(p, rng):
    rows = [[a, b, plain(round(float(c) * 1.1 + 3, 1)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (*HEADER[:2], "Force raw [N]", "Force filtered [N]")))


@kind
def supply_and_muscle_pressure(p, rng):
    rows = [["8", *row] for row in cells(p)]
    return csv(p, text(rows, ("Supply pressure [bar]", *HEADER)))


@kind
def set_and_measured_pressure(p, rng):
    rows = [[f"{float(row[0]):.1f}", *row] for row in cells(p)]
    return csv(p, text(rows, ("Set pressure [bar]", *HEADER)))


# Units, signs and zeros


@kind
def kilopascals_and_kilonewtons(p, rng):
    rows = [[plain(round(float(a) * 100, 3)), b, f"{float(c) / 1000:.5f}"] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [kPa]", HEADER[1], "Force [kN]")))


@kind
def psi(p, rng):
    rows = [[repr(float(a) / 0.06894757293168361), b, c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [psi]", *HEADER[1:])))


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
def bar_named_kilopascals(p, rng):
    return csv(p, text(cells(p), ("Pressure [kPa]", *HEADER[1:])))


@kind
def ratios_named_percent(p, rng):
    return csv(p, text([[a, f"{float(b) / 100:.4f}", c] for a, b, c in cells(p)]))


@kind
def percent_named_ratio(p, rng):
    return csv(p, text(cells(p), (HEADER[0], "Contraction [-]", HEADER[2])))


@kind
def kilonewtons_named_newtons(p, rng):
    return csv(p, text([[a, b, f"{float(c) / 1000:.5f}"] for a, b, c in cells(p)]))


@kind
def pull_is_negative(p, rng):
    return csv(p, text([[a, b, f"-{c}"] for a, b, c in cells(p)]))


@kind
def lengths(p, rng):
    rows = [[a, repr(250 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Length [mm]", HEADER[2])), initial_length=0.25)


@kind
def lengths_with_the_initial_length_in_a_comment(p, rng):
    rows = [[a, repr(250 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(p, "# initial_length: 250 mm\n" + text(rows, (HEADER[0], "Length [mm]", HEADER[2])))


@kind
def lengths_without_initial_length(p, rng):
    rows = [[a, repr(250 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Length [mm]", HEADER[2])))


@kind
def lengths_with_a_wrong_initial_length(p, rng):
    rows = [[a, repr(250 * (1 - float(b) / 100)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Length [mm]", HEADER[2])), initial_length=0.22)


@kind
def displacement_instead_of_contraction(p, rng):
    rows = [[a, repr(2.5 * float(b)), c] for a, b, c in cells(p)]
    return csv(p, text(rows, (HEADER[0], "Displacement [mm]", HEADER[2])))


@kind
def comment_on_preprocessing_and_wrong_unit(p, rng):
    rows = [[a, b, f"{float(c) / 1000:.5f}"] for a, b, c in cells(p)]
    return csv(p, "# preprocessing: low-pass at 10 Hz\n" + text(rows))


@kind
def comment_on_preprocessing_and_negative_pull(p, rng):
    return csv(p, "# preprocessing: none needed\n" + text([[a, b, f"-{c}"] for a, b, c in cells(p)]))


# Marks and saturation


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
def minus_9999_among_pascals(p, rng):
    rows, at = cells(p), int(rng.integers(len(p.force)))
    rows = [[plain(round(float(a) * 1e5)), b, c] for a, b, c in rows]
    rows[at][0] = "-9999"
    return csv(p.without([at]), text(rows, ("Pressure [Pa]", *HEADER[1:])))


@kind
def mark_999_9_among_forces(p, rng):
    content, truth = marked(p, rng, 2, "999.9", int(rng.integers(1, 3)))
    return csv(truth, content)


@kind
def mark_9999_among_forces(p, rng):
    content, truth = marked(p, rng, 2, "9999")
    return csv(truth, content)


@kind
def mark_minus_99_among_contractions(p, rng):
    content, truth = marked(p, rng, 1, "-99")
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


# Excel


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
def excel(p, rng):
    return File("rig.xlsx", workbook([HEADER, *numbers(p)]), p)


@kind
def excel_with_title_and_units(p, rng):
    head = [["Rig 3", None, None], [], ["Pressure", "Contraction", "Force"], ["bar", "%", "N"]]
    return File("rig.xlsx", workbook([*head, *numbers(p)]), p)


@kind
def excel_numbers_as_text(p, rng):
    return File("rig.xlsx", workbook([HEADER, *cells(p, rng.choice([".", ","]))]), p)


@kind
def excel_thousands_as_text(p, rng):
    """Numbers, and in some cells texts such as 1,234."""
    p = p.large()
    rows = numbers(p)
    rows = [[a, b, grouped(c) if c >= 1000 else c] for a, b, c in rows]
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


@kind
def excel_three_decimals_as_text(p, rng):
    """The same text cells as decimals."""
    p = replace(p, force=p.force.clip(min=1, max=900).round() + 0.125)
    rows = numbers(p)
    at = rng.choice(len(rows), 2, replace=False)
    for one in at:
        rows[one][2] = f"{rows[one][2]:.3f}".replace(".", ",")
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


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


@kind
def excel_hidden_sheet(p, rng):
    """The hidden sheet has an earlier measurement."""

    def add(book):
        old = book.create_sheet("old", 0)
        for row in [HEADER, *numbers(replace(p, force=p.force * 0.9))]:
            old.append(list(row))
        old.sheet_state = "hidden"

    return File("rig.xlsx", workbook([HEADER, *numbers(p)], add), p)


@kind
def excel_hidden_column(p, rng):
    """The hidden column is an earlier force under the usual name."""
    rows = [[a, b, c * 0.9, c] for a, b, c in numbers(p)]

    def hide(book):
        book.active.column_dimensions["C"].hidden = True

    return File("rig.xlsx", workbook([(*HEADER, "Force corrected [N]"), *rows], hide), p)


@kind
def excel_two_sheets(p, rng):
    def add(book):
        book.create_sheet("copy")
        for row in [HEADER, *numbers(replace(p, force=p.force * 0.9))]:
            book["copy"].append(list(row))

    return File("rig.xlsx", workbook([HEADER, *numbers(p)], add), p)


@kind
def excel_percent_format(p, rng):
    """Cells that show 5 % and hold 0.05."""

    def show(book):
        for cell in book.active["B"][1:]:
            cell.value, cell.number_format = cell.value / 100, "0.0%"

    return File("rig.xlsx", workbook([HEADER, *numbers(p)], show), p)


@kind
def excel_formulas_without_values(p, rng):
    rows = [[a, b, f"={c}+0"] for a, b, c in numbers(p)]
    return File("rig.xlsx", workbook([HEADER, *rows]), p)


@kind
def excel_sums_under_the_table(p, rng):
    last = ["mean", None, float(p.force.mean())]
    return File("rig.xlsx", workbook([HEADER, *numbers(p), [], last]), p)


# HDF5, NetCDF, MATLAB, TDMS, LabVIEW


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
def hdf5_plain(p, rng):
    return hdf5(p)


@kind
def hdf5_scale_factor(p, rng):
    return hdf5(p, lambda f: packed(f, "Force", (p.force * 10).round().astype(np.int32), scale_factor=0.1))


@kind
def hdf5_scale_and_offset(p, rng):
    raw = ((p.pressure - 1) * 100).round().astype(np.int16)
    return hdf5(p, lambda f: packed(f, "Pressure", raw, scale_factor=np.array([0.01]), add_offset=1.0))


@kind
def hdf5_fill_value(p, rng):
    at = int(rng.integers(len(p.force)))
    values = p.force.copy()
    values[at] = mark = rng.choice([-1.0, 0.0, 123.0])
    return replace(hdf5(p, lambda f: packed(f, "Force", values, _FillValue=mark)), truth=p.without([at]))


@kind
def hdf5_missing_value(p, rng):
    at = int(rng.integers(len(p.force)))
    raw = (p.force * 10).round().astype(np.int32)
    raw[at] = mark = int(raw.max()) + 1
    attributes = {"missing_value": np.int32(mark), "scale_factor": 0.1}
    return replace(hdf5(p, lambda f: packed(f, "Force", raw, **attributes)), truth=p.without([at]))


@kind
def hdf5_valid_range(p, rng):
    at = int(np.argmin(p.force))
    values = p.force.copy()
    values[at] *= 0.5
    low = values[at] * 1.5
    make = hdf5(p, lambda f: packed(f, "Force", values, valid_range=np.array([low, 1e4])))
    return replace(make, truth=p.without([at]))


@kind
def hdf5_gain_attribute(p, rng):
    return hdf5(p, lambda f: packed(f, "Force", p.force * 2, gain=0.5))


@kind
def hdf5_saturated_bytes(p, rng):
    """Forces in a type of 8 bits that ends below the largest."""
    p = replace(p, force=(p.force * 400 / p.force.max()).round())
    return hdf5(p, lambda f: packed(f, "Force", p.force.clip(max=255).astype(np.uint8)))


@kind
def hdf5_without_units(p, rng):
    return hdf5(p, lambda f: [f[key].attrs.pop("units") for key in f])


@kind
def netcdf_packed(p, rng):
    raw = (p.force * 10).round()
    table = xr.Dataset(
        {
            "pressure": ("point", p.pressure * 1e5, {"units": "Pa"}),
            "contraction": ("point", p.contraction / 100, {"units": "1"}),
            "force": ("point", raw.astype(np.int32), {"units": "N", "scale_factor": 0.1}),
        }
    )
    return File("rig.nc", bytes(table.to_netcdf(engine="h5netcdf")), p)


@kind
def netcdf_without_units(p, rng):
    """In bar, percent and newtons, as its title says."""
    table = xr.Dataset({"pressure": ("point", p.pressure), "contraction": ("point", p.contraction / 100)})
    table["force"] = ("point", p.force)
    return File("rig.nc", bytes(table.to_netcdf(engine="h5netcdf")), p)


@kind
def netcdf_in_kilonewtons_named_newtons(p, rng):
    table = xr.Dataset(
        {
            "pressure": ("point", p.pressure * 1e5, {"units": "Pa"}),
            "contraction": ("point", p.contraction / 100, {"units": "1"}),
            "force": ("point", p.force / 1000, {"units": "N"}),
        }
    )
    return File("rig.nc", bytes(table.to_netcdf(engine="h5netcdf")), p)


def matlab(p: Points, force: np.ndarray | None = None) -> File:
    stream = io.BytesIO()
    force = p.force if force is None else force
    savemat(stream, {"pressure_bar": p.pressure, "contraction_percent": p.contraction, "force_N": force})
    return File("rig.mat", stream.getvalue(), p)


@kind
def matlab_vectors(p, rng):
    return matlab(p)


@kind
def matlab_saturated_bytes(p, rng):
    p = replace(p, force=(p.force * 400 / p.force.max()).round())
    return matlab(p, p.force.clip(max=255).astype(np.uint8))


@kind
def matlab_nan(p, rng):
    values = p.force.copy()
    values[int(rng.integers(len(values)))] = np.nan
    return matlab(p, values)


@kind
def tdms(p, rng):
    stream = io.BytesIO()
    columns = (("Pressure", p.pressure, "bar"), ("Contraction", p.contraction, "%"), ("Force", p.force, "N"))
    with TdmsWriter(stream) as writer:
        writer.write_segment([ChannelObject("rig", n, v, properties={"unit_string": u}) for n, v, u in columns])
    return File("rig.tdms", stream.getvalue(), p)


@kind
def labview(p, rng):
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t3\n"
        "Y_Unit_Label\tbar\t%\tN\nX_Dimension\tTime\tTime\tTime\n***End_of_Header***\t\n"
        "X_Value\tPressure\tContraction\tForce\tComment\n"
    )
    decimal = rng.choice([".", ","])
    rows = (f"{i / 2:f}\t{a}\t{b}\t{c}\n".replace(".", decimal) for i, (a, b, c) in enumerate(cells(p)))
    return csv(p, head + "".join(rows), "rig.lvm")
