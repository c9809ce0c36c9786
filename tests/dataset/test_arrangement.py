"""Tables with a column, block, sheet or line of labels for each pressure, read as one row per point, or asked about."""

import io

import openpyxl
import pytest

from mckibben.dataset import read_dataset
from mckibben.errors import DatasetError, McKibbenWarning

POINTS = ([1e5, 1e5, 1e5, 3e5, 3e5, 3e5], [0, 0.05, 0.1, 0, 0.05, 0.1], [200, 150, 100, 600, 480, 370])


def read(path, **options):
    found = read_dataset(path, **options)
    return [found.pressure.tolist(), found.contraction.round(12).tolist(), found.force.tolist()]


@pytest.mark.parametrize(
    "header",
    [
        "Contraction [%];Force at 1 bar [N];Force at 3 bar [N]",
        "Contraction [%];Force [N] at 1 bar;Force [N] at 3 bar",
        "Contraction [%];F_100kPa [N];F_300kPa [N]",
        "Kontraktion [%];Kraft bei 1,0 bar (N);Kraft bei 3,0 bar (N)",
    ],
)
def test_a_column_of_forces_for_each_pressure(put, header):
    assert read(put(f"{header}\n0;200;600\n5;150;480\n10;100;370\n")) == list(POINTS)


def test_columns_of_both_directions(put):
    rows = "2;0;600;640\n2;5;480;500\n3;0;900;950\n"
    found = read_dataset(put(f"Pressure [bar];Contraction [%];Force unloading [N];Force loading [N]\n{rows}"))
    assert found.force.tolist() == [600, 480, 900, 640, 500, 950]
    assert found.table["direction"].values.tolist() == ["unloading"] * 3 + ["loading"] * 3


@pytest.mark.parametrize(
    "header",
    [
        "Pressure [bar];Contraction [%];Force at 1 bar [N];Force at 3 bar [N]",
        "Contraction [%];Force at 1 bar [N];Force at 1 bar [N]",
        "Contraction [%];Force at 1 bar [N];Force at 3 bar [kN]",
        "Contraction [%];Force at 1 bar abs [N];Force at 3 bar abs [N]",
        "Contraction [%];Force at 1 bar [N];Force [N]",
        "Time [s];Contraction [%];Force at 1 bar [N];Force at 3 bar [N]",
        "Contraction [%];Force -0.5 bar [N];Force -0.9 bar [N]",
    ],
)
def test_columns_that_contradict_each_other_are_asked_about(put, header):
    row = ";".join(map(str, range(1, header.count(";") + 2)))
    with pytest.raises(DatasetError):
        read_dataset(put(f"{header}\n{row}\n{row}\n"))


def test_a_row_of_such_a_table_is_left_out_at_all_pressures(put):
    path = put("Contraction [%];Force at 1 bar [N];Force at 3 bar [N]\n0;200;600\n5;x;480\n10;100;370\n12;90;350\n")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    assert [problem.line for problem in caught.value.problems] == [3]
    with pytest.warns(McKibbenWarning):
        found = read_dataset(path, on_corrupt="report")
    assert found.force.tolist() == [200, 100, 90, 600, 370, 350]


BLOCKS = "Pressure [bar];Contraction [%];Force [N]\n1;0;200\n;5;150\n;10;100\n3;0;600\n;5;480\n;10;370\n"


def test_a_pressure_in_the_first_row_of_each_block(put):
    with pytest.warns(McKibbenWarning, match="4 empty cells"):
        assert read(put(BLOCKS)) == list(POINTS)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n1;0", "\n;0"),  # none above the first
        ("\n;5;150", "\n1;5;150"),  # a block of one row: it may be a missing cell
        ("\n3;0;600\n;5;480\n;10;370", "\n3;11;600\n;12;480\n;13;370"),  # a pressure recorded rarely, in one motion
        ("\n3;0", "\n1;0"),
    ],
)
def test_other_empty_pressures_are_asked_about(put, old, new):
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(BLOCKS.replace(old, new)))
    assert {problem.field for problem in caught.value.problems} == {"Pressure [bar]"}


@pytest.mark.parametrize(
    "text",
    [
        "Contraction [%];Force [N]\np = 1 bar\n0;200\n5;150\n10;100\np = 3 bar\n0;600\n5;480\n10;370\n",
        "--- p = 1 bar ---\nContraction [%];Force [N]\n0;200\n5;150\n10;100\n"
        "--- p = 3 bar ---\nContraction [%];Force [N]\n0;600\n5;480\n10;370\n",
    ],
)
def test_titles_of_blocks(put, text):
    assert read(put(text)) == list(POINTS)


def test_a_pressure_above_the_table_alone_is_not_taken_for_that_of_the_muscle(put):
    with pytest.raises(DatasetError):
        read_dataset(put("Pressure: 6 bar\nContraction [%];Force [N]\n0;200\n5;150\n10;100\n"))


@pytest.mark.parametrize(
    "text",
    [
        "Pressure [bar];Contraction [%];Force [N]\n1;0;200\n1;5;150\np = 3 bar\n1;10;100\n",
        "Contraction [%];Force [N]\nPressure: 1 bar\n0;200\n5;150\nPressure: 3 bar (again)\n0;600\n5;480\n",
    ],
)
def test_a_line_that_may_be_a_title_is_asked_about(put, text):
    with pytest.raises(DatasetError) as caught:
        read_dataset(put(text))
    assert caught.value.problems[0].message.startswith("has 1 cell")


def workbook(titles, header, blocks):
    book = openpyxl.Workbook()
    del book["Sheet"]
    for title, rows in zip(titles, blocks, strict=True):
        sheet = book.create_sheet(title)
        for row in [header, *rows]:
            sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


FORCES = [[(0, 200), (5, 150), (10, 100)], [(0, 600), (5, 480), (10, 370)]]


def test_a_sheet_for_each_pressure(put):
    header = ("Pressure [bar]", "Contraction [%]", "Force [N]")
    levels = [[(pressure, *row) for row in rows] for pressure, rows in zip((1, 3), FORCES, strict=True)]
    with pytest.warns(McKibbenWarning, match="'first', 'second'"):
        assert read(put(workbook(("first", "second"), header, levels), "a.xlsx")) == list(POINTS)
    with pytest.warns(McKibbenWarning):
        assert read(put(workbook(("1 bar", "p=3 bar"), header[1:], FORCES), "b.xlsx")) == list(POINTS)
    same = [[(2, *row[1:]) for row in rows] for rows in levels]
    for titles, head, rows in (
        (("first", "second"), header, same),
        (("muscle 1", "muscle 2"), header[1:], FORCES),
        (("1 bar", "3 psi"), header[1:], FORCES),
    ):
        with pytest.raises(DatasetError):
            read_dataset(put(workbook(titles, head, rows), "c.xlsx"))


@pytest.mark.parametrize(
    "line",
    ["pressure={}bar, contraction={}%, force={}N", '{{"pressure_bar": {}, "contraction_percent": {}, "force_N": {}}}'],
)
def test_lines_of_labelled_numbers(put, line):
    rows = [(p / 1e5, 100 * c, f) for p, c, f in zip(*POINTS, strict=True)]
    assert read(put("\n".join(line.format(*row) for row in rows))) == list(POINTS)
    with pytest.raises(DatasetError):  # a label is missing
        read_dataset(put("\n".join([line.format(*rows[0]), line.format(*rows[1]).replace("force", "power")])))


def test_cells_in_several_units(put):
    header = "Pressure [bar];Contraction [%];Force [N]\n"
    assert read(put(header + "1000 mbar;0;0.2 kN\n1;5;150\n1;10 %;100\n3;0;600\n3;5;480\n300 kPa;10;370\n")) == list(
        POINTS
    )
    with pytest.raises(DatasetError) as caught:  # 1.234 stays ambiguous
        read_dataset(put(header + "2;0;1.234 kN\n3;5;2000\n"))
    assert [(problem.line, problem.field) for problem in caught.value.problems] == [(2, "Force [N]")]
    found = read_dataset(put("p [bar];eps [%];Force\n2;0;0.2 kN\n2;5;150 N\n3;0;300 N\n"), columns={"Force": "force_N"})
    assert found.force.tolist() == [200, 150, 300]


def test_a_header_with_another_delimiter_and_numbers_of_columns_above(put):
    rows = "1,0;0;200,5\n1,0;5;150,5\n3,0;0;600,5\n"
    found = read(put(f"Pressure [bar],Contraction [%],Force [N]\n{rows}"))
    assert found == [[1e5, 1e5, 3e5], [0, 0.05, 0], [200.5, 150.5, 600.5]]
    assert read(put(f"1;2;3\nPressure [bar];Contraction [%];Force [N]\n{rows}")) == found


def test_a_line_of_words_among_the_rows_is_reported(put):
    path = put("pressure_bar,contraction_percent,force_N\n1,0,200\nSensor restarted\n1,5,150\n3,0,600\n")
    with pytest.warns(McKibbenWarning, match="line 3 .*Sensor restarted"):
        assert read_dataset(path).force.tolist() == [200, 150, 600]
