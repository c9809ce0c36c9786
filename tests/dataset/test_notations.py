"""Spellings of names, units and numbers that are read, and notes and formats that are reported."""

import io
import warnings

import numpy as np
import openpyxl
import pytest
from openpyxl.styles import Font

from mckibben.dataset import read_dataset
from mckibben.dataset.headers import Header, parse_header
from mckibben.errors import DatasetError, McKibbenWarning

NAMES = ("Pressure [bar]", "Contraction [%]", "Force [N]")
ROWS = [(p, e, round(83.7 * p * (1 - e / 28) ** 2, 1)) for p in (2.0, 3.0, 4.0) for e in (0.0, 4.0, 8.0, 12.0, 16.0)]
FORCES = [row[2] for row in ROWS]


def table(names=NAMES, rows=ROWS, delimiter=";"):
    return "".join(delimiter.join(map(str, row)) + "\n" for row in [names, *rows])


def read(path, **options):
    """Dataset and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read_dataset(path, **options)
    return found, [str(one.message) for one in caught if issubclass(one.category, McKibbenWarning)]


def forces_of(path, **options):
    return read(path, **options)[0].force.round(4).tolist()


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("Force {N}", ("force", "N")),
        ("Force <N>", ("force", "N")),
        ("Force - N", ("force", "N")),
        ("Force: N", ("force", "N")),
        ("CH3 Force [N]", ("force", "N")),
        ("AI2: Force [N]", ("force", "N")),
        ("Force* [N]", ("force", "N")),
        ("Force² [N]", ("force", "N")),
        ("Force_1 [N]", ("force", "N")),
        ("Усилие, Н", ("force", "N")),
        ("Давление, МПа", ("pressure", "MPa")),
        ("수축률 [%]", ("contraction", "percent")),
        ("Pressure [kg/cm²]", ("pressure", "kgf/cm^2")),
        ("Contraction [mm/mm]", ("contraction", "ratio")),
        ("Contraction [‰]", ("contraction", "permille")),
        ("Force [cN]", ("force", "cN")),
        ("Length [µm]", ("length", "um")),
        ("Contraction [mm]", ("displacement", "mm", True)),
        ("Force 0 [N]", None),
        ("Force filtered [N]", None),
        ("Force - filtered", None),
        ("Pressure [mPa]", None),
        ("Pressure [mpa]", None),
        ("Pressure [MPA]", ("pressure", "MPa")),
        ("Pressure [mBar]", ("pressure", "mbar")),
        ("Pressure [MBAR]", None),
    ],
)
def test_names_are_read_with_their_units(header, expected):
    assert parse_header(header, loose=True) == (expected and Header(*expected))


def test_a_number_behind_a_name_yields_to_the_name_alone_and_two_are_a_question(put):
    rows = [(*row, 2 * row[2]) for row in ROWS]
    assert forces_of(put(table((*NAMES, "Force 2 [N]"), rows))) == FORCES
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(table((*NAMES[:2], "Force 1 [N]", "Force 2 [N]"), rows)))
    assert [problem.field for problem in caught.value.problems] == ["Force 2 [N]"]


def test_a_contraction_in_millimetres_is_a_shortening_from_the_initial_length(put):
    path = put(table((NAMES[0], "Contraction [mm]", NAMES[2]), [(p, 2.5 * e, f) for p, e, f in ROWS]))
    np.testing.assert_allclose(read(path, initial_length=0.25)[0].contraction, [row[1] / 100 for row in ROWS])
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    assert [problem.field for problem in caught.value.problems] == ["initial_length"]


def test_a_second_column_in_another_unit_is_left_out_if_it_agrees(put):
    names = (*NAMES, "Force [lbf]")
    assert forces_of(put(table(names, [(*row, round(row[2] / 4.44822, 2)) for row in ROWS]))) == FORCES
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(table(names, [(*row, round(row[2] / 4.2, 2)) for row in ROWS])))
    assert [problem.field for problem in caught.value.problems] == ["Force [lbf]"]


def test_units_in_columns_of_their_own_are_read_unless_they_change(put):
    names = ("Pressure", "Unit", "Contraction", "Unit", "Force", "Force unit")
    rows = [(p, "bar", e, "%", round(f / 9.80665, 6), "kgf") for p, e, f in ROWS]
    np.testing.assert_allclose(read(put(table(names, rows)))[0].force, FORCES, rtol=1e-5)
    rows[3] = (*rows[3][:5], "N")
    _, heard = read(put(table((*names[:4], "Force [N]", "Force unit"), rows)))
    assert any("kgf" in text and "Force unit" in text for text in heard)
    rows[3] = (*rows[3][:5], "kgf")
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(table((*names[:4], "Force [N]", "Force unit"), rows)))
    assert [problem.field for problem in caught.value.problems] == ["Force [N]"]


@pytest.mark.parametrize(
    "cell", ["'{}", "'{}'", '="{}"', '"""{}"""', "{} ± 0.5", "{}+/-0,5", "+{}"], ids="a b c d e f g".split()
)
def test_numbers_as_people_and_programs_write_them(put, cell):
    rows = [(p, e, cell.format(f)) for p, e, f in ROWS]
    assert forces_of(put(table(rows=rows))) == FORCES


def test_typographic_minus_signs_and_marks_between_joined_files(put):
    rows = [(p, e, f"–{f}") for p, e, f in ROWS]
    half = len(rows) // 2
    joined = "\ufeff" + table(rows=rows[:half]) + "\ufeff" + table(rows=rows[half:])
    assert forces_of(put(joined), force_sign=-1) == FORCES


@pytest.mark.parametrize("encoding", ["cp850", "mac_roman"])
def test_encodings_before_windows_are_found_by_the_words_of_a_header(put, encoding):
    assert forces_of(put(table(("Druck [bar]", "Verkürzung [%]", "Kraft [N]")).encode(encoding))) == FORCES


def test_units_over_the_names_rulers_under_them_and_a_preamble_that_is_repeated(put):
    names = [name.partition(" ")[0] for name in NAMES]
    assert forces_of(put(table(("bar", "%", "N"), [names, *ROWS]))) == FORCES
    assert forces_of(put(table(rows=[("---", ":--", "--:"), *ROWS], delimiter="|"))) == FORCES
    half = len(ROWS) // 2
    head = "Logger 2\nStart: 10:00\n"
    assert forces_of(put(head + table(rows=ROWS[:half]) + head + table(rows=ROWS[half:]))) == FORCES


def test_rows_with_another_delimiter_are_no_remarks(put):
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(table() + "4,16,100\n4,18,90\n"))
    assert {problem.line for problem in caught.value.problems} == {len(ROWS) + 2, len(ROWS) + 3}


@pytest.mark.parametrize(
    "line",
    ["# force in kgf", "Force unit;kgf", "# offset of the load cell: 12.5 N", "Lever;2:1", "# F = 9.81 x reading"],
)
@pytest.mark.parametrize("below", [False, True])
def test_lines_outside_the_table_on_forces_units_and_scales_are_reported(put, line, below):
    if below and not line.startswith("#"):
        line = f"# {line}"
    content = table() + f"{line}\n" if below else f"{line}\n{table()}"
    found, heard = read(put(content))
    assert found.force.round(4).tolist() == FORCES
    assert any(line.strip("# ") in text for text in heard)
    assert not read(put(f"# rig 3, operator A. B.\n{table()}"))[1]


def test_a_large_table_under_a_line_that_is_reported_is_read_in_pieces(put):
    rows = ROWS * 6000  # more than 1 MiB
    found, heard = read(put(f"# load cell of 500 N\n{table(rows=rows)}"))
    assert len(found) == len(rows)
    assert any("load cell" in text for text in heard)
    assert found.table.attrs["columns_read"].count("header") == 3


def test_dates_and_numbers_of_versions_do_not_settle_the_decimal_sign(put):
    rows = [("12.03", 2, 0, "1.234"), ("12.03", 3, 0, "1.851"), ("12.03", 3, 5, "1.251")]
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(table(("Date", *NAMES), rows)))
    assert [(problem.line, problem.field) for problem in caught.value.problems] == [(2, NAMES[2])]


@pytest.mark.parametrize("mark", ["x", "1", "*"])
@pytest.mark.parametrize("name", ["ignore", "outlier", "exclude"])
def test_a_mark_in_a_column_for_invalid_rows_leaves_them_out(put, mark, name):
    rows = [(*row, mark if at == 3 else "") for at, row in enumerate(ROWS)]
    assert forces_of(put(table((*NAMES, name), rows))) == FORCES[:3] + FORCES[4:]


def test_numbers_at_the_ends_of_16_bits_and_columns_in_milliamperes_are_reported(put):
    rows = [*ROWS[:4], (2.0, 20.0, 327.67), *ROWS[5:]]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            read_dataset(put(table(rows=rows)))
            assert any("327.67" in str(one.message) for one in caught)
        except DatasetError as error:
            assert [problem.line for problem in error.problems] == [6]
    path = put(table(("p [mA]", *NAMES[1:])))
    assert any("mA" in text for text in read(path, columns={"p [mA]": "pressure_bar"})[1])


@pytest.mark.parametrize(("at", "mark"), [(2, "9.9E37"), (0, "3.4028235E+38"), (1, "-1e30")])
def test_overloads_of_multimeters_are_named_with_line_and_column(put, at, mark):
    rows = [list(row) for row in ROWS]
    rows[4][at] = mark
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(table(rows=rows)))
    assert (6, NAMES[at]) in [(problem.line, problem.field) for problem in caught.value.problems]


def test_exchanged_columns_and_a_pressure_that_a_spreadsheet_counted_up_are_reported(put):
    rows = [(p, round(f / 20, 3), e) for p, e, f in ROWS]
    assert any("exchanged" in text for text in read(put(table(rows=rows)))[1])
    rows = [(1 + at / 4, e, f) for at, (_, e, f) in enumerate(ROWS)]
    assert any("counted" in text for text in read(put(table(rows=rows)))[1])
    assert not read(put(table()))[1]
    noise = [3 + 0.01 * (-1) ** at for at in range(12)]
    rows = [(1 + at / 2, e, 60 * at) for at, e in enumerate(noise)]  # a length that is held, and nominal pressures
    assert not any("counted" in text for text in read(put(table(rows=rows)))[1])


@pytest.mark.parametrize(("first", "reported"), [("0", True), ("0.5", False)])
def test_a_decimal_sign_that_only_an_unread_column_has_is_reported(put, first, reported):
    rows = [f"{p};{e};{6 - p - float(e) / 10:.3f};21.5" for p in (1, 2, 3) for e in (first, "4", "8")]
    found, told = read(put("\n".join(["Pressure [bar];Contraction [%];Force [N];Temp [C]", *rows])))
    assert any("'5.000'" in one or "'4.950'" in one for one in told) == reported
    assert found.force.max() < 6


def book_of(change):
    book = openpyxl.Workbook()
    for row in [NAMES, *ROWS]:
        book.active.append(row)
    change(book.active)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def test_merged_cells_percent_formats_and_white_text_of_a_workbook(put):
    def merge(sheet):
        for first in (2, 7, 12):
            sheet.merge_cells(start_row=first, end_row=first + 4, start_column=1, end_column=1)

    found = read(put(book_of(merge), "a.xlsx"))[0]
    assert found.pressure.tolist() == [1e5 * row[0] for row in ROWS]

    found = read(put(book_of(lambda sheet: sheet.merge_cells("C3:C4")), "last.xlsx"))[0]
    assert found.force[1] == found.force[2] == ROWS[1][2]

    def shares(sheet):
        for cell in sheet["B"][1:]:
            cell.value, cell.number_format = cell.value / 100, "0.0%"

    found = read(put(book_of(shares), "b.xlsx"))[0]
    np.testing.assert_allclose(found.contraction, [row[1] / 100 for row in ROWS])

    def white(sheet):
        sheet["C5"].font = Font(color="FFFFFFFF")

    assert any("coloured" in text and "5" in text for text in read(put(book_of(white), "c.xlsx"))[1])


@pytest.mark.parametrize(
    ("names", "units", "factor", "refused"),
    [(NAMES, (), 1, True), (("p", "eps", "F"), ("bar", "%", "N", "kN"), 1e-3, False)],
    ids=["two sensors", "two units"],
)
def test_a_name_merged_over_two_columns_is_that_of_both(put, names, units, factor, refused):
    book = openpyxl.Workbook()
    for row in [
        names,
        *([units] if units else []),
        *((*row, factor * row[2] if units else row[2] / 2) for row in ROWS),
    ]:
        book.active.append(row)
    book.active.merge_cells("C1:D1")
    book.active.merge_cells("A9:B9")  # its pressure is not a contraction
    stream = io.BytesIO()
    book.save(stream)
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(stream.getvalue(), "a.xlsx"))
    empty = [problem.field for problem in caught.value.problems if problem.line == 9]
    assert empty == [names[1]]
    assert [problem.field for problem in caught.value.problems if problem.line is None] == [names[2]] * refused


@pytest.mark.parametrize("beside", ["N", "ok", None])
def test_a_name_merged_over_a_column_of_units_or_remarks_is_that_of_the_numbers(put, beside):
    book = openpyxl.Workbook()
    for row in [(*NAMES, None), *((*row, beside) for row in ROWS)]:
        book.active.append(row)
    book.active.merge_cells("C1:D1")
    stream = io.BytesIO()
    book.save(stream)
    assert len(read_dataset(put(stream.getvalue(), "a.xlsx"))) == len(ROWS)


def test_a_name_that_begins_like_another_format_is_read(put):
    names = ("Par1", "Par2", "Par3")
    text = "\n".join(",".join(map(str, row)) for row in [names, *ROWS])
    assert len(read(put(text), columns=dict(zip(names, NAMES, strict=True)))[0]) == len(ROWS)


@pytest.mark.parametrize(
    ("start", "word"),
    [(b"\x1f\x8b\x08", "gzip"), (b'[{"a": 1}]', "JSON"), (b" <html><table>", "HTML"), (b"SQLite format 3\0", "SQLite")],
)
def test_files_of_other_formats_say_what_they_are(put, start, word):
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(start + b"\n1;2;3\n"))
    (problem,) = caught.value.problems
    assert word in problem.message and problem.remedy
