"""What a workbook says of its numbers beside them, and tests over several sheets."""

import io
import zipfile

import numpy as np
import openpyxl
import pytest
from openpyxl.comments import Comment
from openpyxl.styles import Font, PatternFill

from mckibben.dataset import read_dataset

from .conftest import C, F, P, are_the_points, problems_of

HEADER = ("Pressure [bar]", "Contraction [%]", "Force [N]")
YELLOW, RED, STRUCK = PatternFill("solid", fgColor="FFFF00"), Font(color="FFFF0000"), Font(strike=True)
BOX = '<w xmlns:a="http://schemas.openxmlformats.org/drawingml/2006/main"><a:t>forces </a:t><a:t>in kgf</a:t></w>'
THREAD = '<T xmlns="http://schemas.microsoft.com/office/spreadsheetml/2018/threadedcomments"><text>see Ann</text></T>'


def saved(book: openpyxl.Workbook, parts: dict[str, str] | None = None) -> bytes:
    stream = io.BytesIO()
    book.save(stream)
    with zipfile.ZipFile(stream, "a") as archive:
        for name, text in (parts or {}).items():
            archive.writestr(name, text)
    return stream.getvalue()


def points(*above: tuple[str, ...]) -> openpyxl.Workbook:
    book = openpyxl.Workbook()
    for row in (*above, HEADER, *zip(P.tolist(), C.tolist(), F.tolist(), strict=True)):
        book.active.append(list(row))
    return book


def marked(cell: str, *above: tuple[str, ...], **marks: object) -> bytes:
    book = points(*above)
    for name, mark in marks.items():
        setattr(book.active[cell], name, mark)
    return saved(book)


@pytest.mark.slow
@pytest.mark.parametrize(
    "content",
    [
        marked("C1", comment=Comment("actually in kgf", "A")),
        marked("A1", ("Rig 3",), (), comment=Comment("see below", "A")),
        marked("F9", comment=Comment("slipped", "A")),
        marked("C1", fill=YELLOW),
        marked("B1", ("Rig 3", "U9C"), fill=YELLOW),
        marked("C1", font=RED),
        marked("C7", font=RED),
        marked("C1", font=STRUCK),
        saved(points(), {"xl/threadedComments/threadedComment1.xml": THREAD}),
    ],
)
def test_a_mark_on_some_cells_is_a_question_wherever_they_are(content, put):
    (problem,) = problems_of(put(content, "rig.xlsx"))
    assert problem.startswith("layout") and "accept=layout" in problem


def test_marks_on_all_cells_of_a_row_are_a_style(put):
    book = points(("Rig 3",), ())
    for cell in (*book.active[1], *book.active[3]):
        cell.fill, cell.font = YELLOW, RED
    are_the_points(read_dataset(put(saved(book), "rig.xlsx")))


def test_units_of_a_format_and_texts_of_a_box_are_words(put):
    book = points()
    for row in range(2, 20):
        book.active.cell(row, 3).number_format = '0.0 "kgf"'
    for content in (saved(book), saved(points(), {"xl/drawings/drawing7.xml": BOX})):
        (problem,) = problems_of(put(content, "rig.xlsx"))
        assert "kgf" in problem and "--column 'Force [N]=force_kgf'" in problem
    for row in range(2, 20):
        book.active.cell(row, 3).number_format = '0.0 "N"'
    are_the_points(read_dataset(put(saved(book), "rig.xlsx")))


def test_the_initial_length_in_a_sheet_of_notes_is_named_and_answered(put):
    book = points()
    book.create_sheet("Notes").append(["Muskel 190 mm"])
    path = put(saved(book), "rig.xlsx")
    (problem,) = problems_of(path)
    assert "--initial-length '190 mm'" in problem
    are_the_points(read_dataset(path, initial_length=0.19))
    assert problems_of(path, initial_length=0.18)


def loads(titles: list[str], note: str = "") -> bytes:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, load in zip(titles, (300.0, 600.0, 900.0), strict=True):
        sheet = book.create_sheet(title)
        sheet.append(["Druck [bar]", "Kontraktion [%]"])
        for pressure in np.linspace(2, 6, 9):
            sheet.append([pressure, 28 * (1 - np.sqrt(load / (643.0 * pressure)))])
    if note:
        book.create_sheet("Notes").append([note])
    return saved(book)


@pytest.mark.slow
def test_sheets_with_a_load_each_are_one_test(put):
    path = put(loads(["300N", "600N", "900N"]), "rig.xlsx")
    (problem,) = problems_of(path)
    assert "--read 'from_name={force_N}N'" in problem and "part=[300N, 600N]" in problem
    data = read_dataset(path, from_name="{force_N}N", accept=["range"])
    assert np.unique(data.force).tolist() == [300, 600, 900]
    assert [table.path.name for table in data.lines] == [f"rig.xlsx: {load}N" for load in (300, 600, 900)]
    some = read_dataset(path, from_name="{force_N}N", part=["300N", "900N"], accept=["range"])
    assert np.unique(some.force).tolist() == [300, 900]
    path = put(loads(["A", "B", "C"]), "L190mm.xlsx")
    assert problems_of(path, from_name="L{length_mm}mm")[0].startswith("has several sheets")
    data = read_dataset(path, part=["A", "B", "C"], loads=["300 N", "600 N", "900 N"], accept=["range"])
    assert np.unique(data.force).tolist() == [300, 600, 900]


def test_notes_are_read_beside_a_chosen_sheet(put):
    path = put(loads(["300N", "600N", "900N"], "hook of 1.2 kg not included"), "rig.xlsx")
    problems = problems_of(path, from_name="{force_N}N", part="300N", accept=["range"])
    assert any("hook" in problem for problem in problems)
