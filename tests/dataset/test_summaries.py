"""Rows that are not measurements: summaries without a label, and rows that another column marks as invalid."""

import warnings

import numpy as np
import openpyxl
import pytest
from openpyxl.styles import Font, PatternFill

from mckibben.dataset import read_dataset
from mckibben.dataset.summaries import integer_rows
from mckibben.errors import DatasetError, McKibbenWarning

HEADER = "pressure_bar,contraction_percent,force_N"
EPS = np.array([0.0, 3.0, 6.0, 9.0, 12.0])
ROWS = np.array([[p, e, round(83.7 * p * (1 - e / 28) ** 2, 1)] for p in (2.0, 3.0, 4.0) for e in EPS])


def written(rows):
    return [",".join(f"{value:g}" for value in row) for row in rows]


def means(rows):
    return "{:.2f},{:.1f},{:.1f}".format(*rows.mean(axis=0))


@pytest.fixture
def heard(tmp_path):
    """Write lines, read them, and return the dataset and its warnings."""

    def read(lines, header=HEADER):
        path = tmp_path / "rig.csv"
        path.write_text("\n".join([header, *lines]) + "\n")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", McKibbenWarning)
            data = read_dataset(path)
        return data, [str(one.message) for one in caught]

    return read


@pytest.mark.parametrize(
    "spoil",
    [
        lambda lines: [*lines, means(ROWS)],
        lambda lines: [means(ROWS), *lines],
        lambda lines: [*lines[:10], means(ROWS[:10]), *lines[10:]],
        lambda lines: [*lines[:5], means(ROWS[:5]), *lines[5:]],
        lambda lines: [*lines, "{:.2f},{:.2f},{:.2f}".format(*np.median(ROWS, axis=0))],
        lambda lines: [*lines, means(ROWS), "{:.3f},{:.3f},{:.2f}".format(*ROWS.std(axis=0, ddof=1))],
        lambda lines: [*lines, "{:g},{:g},{:g}".format(*ROWS.max(axis=0))],
    ],
    ids=["below", "above", "in the middle", "of a pressure", "median", "deviation", "maximum"],
)
def test_summaries_without_a_label_are_left_out(heard, spoil):
    data, told = heard(spoil(written(ROWS)))
    np.testing.assert_allclose(data.force, ROWS[:, 2])
    assert len(told) == 1
    assert "summary" in data.table.attrs["repairs"]


@pytest.mark.parametrize("row", ["Mean,,102.3", "Mittelwert:,6.0,102,3", "3.00,6.0,total"])
def test_rows_with_the_word_of_a_summary_in_place_of_a_number_are_left_out(heard, row):
    data, told = heard([*written(ROWS), ",".join(row.split(",")[:3])])
    np.testing.assert_allclose(data.force, ROWS[:, 2])
    assert len(told) == 1
    assert "line 17" in data.table.attrs["repairs"]


def test_other_words_in_place_of_a_number_are_errors(heard):
    with pytest.raises(DatasetError) as caught:
        heard([*written(ROWS), "OVL,6,102"])
    assert [problem.line for problem in caught.value.problems] == [17]


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_points_at_the_middle_of_a_stroke_are_kept(heard, order):
    strokes = np.concatenate([EPS, EPS[-2::-1]])
    rows = np.array([[p, e, 300 - 20 * e] for p in (2.0, 3.0) for e in strokes])[order]  # a straight line
    data, told = heard(written(rows))
    assert len(data) == len(rows)
    assert told == []


def test_a_linear_ramp_has_no_summary(heard):
    p = np.linspace(1, 5, 401)
    data, _ = heard(written(np.stack([p, 0 * p + 5, 100 * p], axis=1)))
    assert len(data) == len(p)


@pytest.mark.parametrize(
    ("name", "usual", "mark"),
    [
        ("status", "OK", "FAULT"),
        ("valid", "1", "0"),
        ("Overload", "FALSE", "TRUE"),
        ("note", "", "outlier"),
        ("remark", "ok", "Invalid; repeat"),
        ("run", "2", "mean"),
    ],
)
def test_rows_that_another_column_marks_are_left_out(heard, name, usual, mark):
    lines = [f"{line},{mark if at == 7 else usual}" for at, line in enumerate(written(ROWS))]
    data, told = heard(lines, f"{HEADER},{name}")
    np.testing.assert_allclose(data.force, np.delete(ROWS[:, 2], 7))
    assert len(told) == 1
    assert name in data.table.attrs["repairs"]


@pytest.mark.parametrize(
    ("name", "usual", "mark"),
    [("quality", "192", "0"), ("error code", "0", "17"), ("state", "M", "E"), ("note", "", "leak test passed")],
)
def test_states_whose_meaning_is_unknown_are_reported(heard, name, usual, mark):
    lines = [f"{line},{mark if at == 7 else usual}" for at, line in enumerate(written(ROWS))]
    data, told = heard(lines, f"{HEADER},{name}")
    assert len(data) == len(ROWS)
    assert [name in one and "line 9" in one for one in told] == [True]


@pytest.mark.parametrize(("name", "cell"), [("status", "OK"), ("valid", "1"), ("sample", "a"), ("note", "")])
def test_other_columns_are_not_reported(heard, name, cell):
    data, told = heard([f"{line},{cell}" for line in written(ROWS)], f"{HEADER},{name}")
    assert len(data) == len(ROWS)
    assert told == []


def test_a_column_of_states_that_is_assigned_to_a_quantity_is_reported(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("\n".join(["valve state,contraction_percent,force_N", *written(ROWS)]) + "\n")
    with pytest.warns(McKibbenWarning, match="states"):
        read_dataset(path, columns={"valve state": "pressure_bar"})


def test_struck_out_cells_are_reported(tmp_path):
    book = openpyxl.Workbook()
    for row in [HEADER.split(","), *ROWS.tolist()]:
        book.active.append(row)
    for cell in book.active[5]:
        cell.font = Font(strike=True)
    book.save(tmp_path / "rig.xlsx")
    with pytest.warns(McKibbenWarning, match="rows 5"):
        read_dataset(tmp_path / "rig.xlsx")


@pytest.mark.parametrize("line", ["# pressures are absolute", "Sensor: Absolutdruck 0..10 bar"])
def test_words_above_the_header_that_mean_absolute_pressures_are_reported(heard, line):
    data, told = heard([HEADER, *written(ROWS)], line)
    assert len(data) == len(ROWS)
    assert ["line 1" in one for one in told] == [True]


def test_paths_of_names_are_read_by_their_last_part(heard):
    data, told = heard(written(ROWS), "/rig/pressure_bar,/rig/contraction_percent,Untitled/Force (N)")
    assert len(data) == len(ROWS)
    assert told == []
    with pytest.raises(DatasetError):
        heard(written(ROWS), "/set/pressure_bar,/rig/contraction_percent,/rig/force_N")


def test_headers_and_signs_of_loggers_are_read(heard):
    header = "pressure_bar:1,Contraction (%) Ave,Force [N] mean"
    data, told = heard([",".join(f"+ {value}" for value in line.split(",")) for line in written(ROWS)], header)
    np.testing.assert_allclose(data.force, ROWS[:, 2])
    assert told == []
    with pytest.raises(DatasetError):
        heard(written(ROWS), "pressure_bar,contraction_percent,Force [N] Max")


@pytest.mark.parametrize("header", ["101 <Force> (N)", "Force Last (N)", "Force mean [N]", "Load [N]"])
def test_names_of_scanners_and_averages_are_read(heard, header):
    data, told = heard(written(ROWS), f"pressure_bar,contraction_percent,{header}")
    np.testing.assert_allclose(data.force, ROWS[:, 2])
    assert told == []


@pytest.mark.parametrize(("name", "reported"), [("Specimen", True), ("Muscle no", True), ("Muscle temperature", False)])
def test_rows_of_several_muscles_are_reported(heard, name, reported):
    lines = [f"{line},{'AB'[at % 2]}" for at, line in enumerate(written(ROWS))]
    told = heard(lines, f"{HEADER},{name}")[1]
    assert [name in one for one in told] == [True] * reported


def test_time_stamps_of_a_serial_monitor_are_skipped(heard):
    lines = [f"14:33:07.250 -> {line}" for line in written(ROWS)]
    data, told = heard(lines, f"14:33:07.001 -> {HEADER}")
    np.testing.assert_allclose(data.force, ROWS[:, 2])
    assert told == []


def test_units_that_number_formats_show_are_read(tmp_path):
    book = openpyxl.Workbook()
    for row in [["Pressure", "Contraction [%]", "Force [N]"], *ROWS.tolist()]:
        book.active.append(row)
    for (cell,) in book.active.iter_rows(min_row=2, max_col=1):
        cell.number_format = '0.0" bar"'
    book.save(path := tmp_path / "rig.xlsx")
    np.testing.assert_allclose(read_dataset(path).pressure, 1e5 * ROWS[:, 0])
    book.active["A1"] = "Pressure [kPa]"
    book.save(path)
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    assert [problem.field for problem in caught.value.problems] == ["Pressure [kPa]"]


@pytest.mark.parametrize("factor", [1, 2])
def test_columns_that_are_not_read_may_have_the_same_name_and_copies_are_left_out(heard, factor):
    lines = [f"{at},{line},{factor * at}" for at, line in enumerate(written(ROWS))]
    assert len(heard(lines, f"X_Value,{HEADER},X_Value")[0]) == len(ROWS)
    forces = [line.rpartition(",")[2] for line in written(ROWS)]
    name = HEADER.rpartition(",")[2]
    lines = [f"{line},{factor * float(force):g}" for line, force in zip(written(ROWS), forces, strict=True)]
    if factor == 1:
        assert len(heard(lines, f"{HEADER},{name}")[0]) == len(ROWS)
    else:
        with pytest.raises(DatasetError):
            heard(lines, f"{HEADER},{name}")


@pytest.mark.parametrize(("name", "usual", "other"), [("material", "steel", "total"), ("not saturated", "0", "1")])
def test_words_and_truth_values_that_may_mean_anything_drop_no_row(heard, name, usual, other):
    lines = [f"{line},{other if at == 7 else usual}" for at, line in enumerate(written(ROWS))]
    data, told = heard(lines, f"{HEADER},{name}")
    np.testing.assert_allclose(data.force, ROWS[:, 2])
    assert len(told) == 1


def test_a_range_is_left_out(heard):
    data, _ = heard([*written(ROWS), ",".join(f"{value:.6g}" for value in np.ptp(ROWS, axis=0))])
    assert len(data) == len(ROWS)


def test_rows_named_by_words_in_a_column_of_numbers(heard):
    numbered = [f"{line},{number}" for number, line in enumerate(written(ROWS))]
    data, said = heard(["0.01,0.2,1.5,Offset", *numbered], f"{HEADER},No")
    assert len(data) == len(ROWS)
    _, said = heard([*numbered[:-1], f"{written(ROWS)[-1]},x"], f"{HEADER},No")
    assert any("'No' is not read" in text and "'x'" in text for text in said)


DECIMALS = written(np.add(ROWS, [0.013, 0.1, 0.17]))


@pytest.mark.parametrize(("place", "row"), [(0, "1,2,3"), (0, "10,30,5000"), (len(ROWS), "9,20,4000")])
def test_channel_numbers_and_full_scales_are_left_out(heard, place, row):
    data, said = heard([*DECIMALS[:place], row, *DECIMALS[place:]])
    assert len(data) == len(ROWS)
    assert any(f"line {place + 2}: contains only integers" in text for text in said)


@pytest.mark.parametrize(("place", "row"), [(0, "3,1,2"), (7, "0,0,0"), (7, "9,20,4000")])
def test_a_row_of_integers_that_may_be_a_point_is_reported(heard, place, row):
    data, said = heard([*DECIMALS[:place], row, *DECIMALS[place:]])
    assert len(data) == len(ROWS) + 1
    assert any(f"line {place + 2} contains only integers" in text for text in said)


@pytest.mark.parametrize("first", ["0,0,0", "2,0,167"])
def test_a_muscle_at_rest_and_points_of_integers_are_not_reported(heard, first):
    assert not any("integers" in text for text in heard([first, *written(ROWS)])[1])


def test_a_vented_muscle_between_levels_is_a_point(heard):
    lines = [line for at in range(0, len(DECIMALS), 4) for line in ("0,0,0", *DECIMALS[at : at + 4])]
    data, said = heard(lines)
    assert len(data) == len(lines)
    assert not any("integers" in text for text in said)


def test_whole_kilopascals_millimetres_and_newtons_are_points():
    pressure, length = (one.ravel() for one in np.meshgrid([200, 300, 400, 500, 600], np.arange(150, 200, 8)))
    force = np.round(pressure * (length - 130.0) ** 1.5 / 600)
    order = np.random.default_rng(2).permutation(len(force))
    columns = {"pressure": (pressure * 1e3, 1e3), "length": (length * 1e-3, 1e-3), "force": (force, 1.0)}
    assert not list(integer_rows({name: (values[order], unit) for name, (values, unit) in columns.items()}))


@pytest.mark.parametrize("value", ["NaN", "n/a", "1e-05", ""])
def test_a_missing_value_in_a_column_that_is_not_read_is_no_mark(heard, value):
    marks = ["21.5", "21.6", value, *["21.7"] * len(ROWS)]
    _, said = heard([f"{line},{mark}" for line, mark in zip(DECIMALS, marks, strict=False)], f"{HEADER},temperature_C")
    assert not any("temperature_C" in text and "marks" in text for text in said)


def test_comments_among_the_rows_are_reported_and_others_are_not(heard):
    lines = written(ROWS)
    _, said = heard([*lines[:5], "# tared, 10:30", *lines[5:]])
    assert any("line 7" in text and "'# tared, 10:30'" in text for text in said)
    assert not any("comment" in text for text in heard(["# muscle 3", *lines, "# end"])[1])


def test_a_few_coloured_rows_are_reported_and_stripes_are_not(tmp_path):
    for coloured, reported in (([4], True), (range(2, 16, 2), False), ([1], False)):
        book = openpyxl.Workbook()
        for row in (HEADER.split(","), *ROWS.tolist()):
            book.active.append(row)
        for row in coloured:
            book.active.cell(row, 1).fill = PatternFill("solid", fgColor="FFFF0000")
        book.save(tmp_path / "rig.xlsx")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", McKibbenWarning)
            read_dataset(tmp_path / "rig.xlsx")
        assert any("coloured cells in rows 4" in str(one.message) for one in caught) == reported
