"""Files of each kind of `benchmarks/messy.py`: none is read wrong in silence."""

import importlib
import io
import warnings
from itertools import permutations
from pathlib import Path

import h5py
import openpyxl
import pytest
from openpyxl.comments import Comment

from mckibben.dataset import read_dataset
from mckibben.errors import DatasetError, McKibbenWarning, RangeError
from mckibben.units import bar, percent

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
THOUSANDS = "Pressure [bar];Contraction [%];Force [N]\n2;0;1.234\n3;0;1.851\n"


@pytest.fixture
def messy(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("messy")


@pytest.mark.slow
def test_no_kind_of_file_is_read_wrong_in_silence(messy, tmp_path):
    found = {kind: messy.read(kind, 1, tmp_path) for kind in messy.KINDS}
    assert len(messy.KINDS) >= 80
    assert {kind: read.text for kind, read in found.items() if read.outcome == "wrong in silence"} == {}


def test_the_kinds_of_the_finding_are_right_or_asked(messy, tmp_path):
    expected = {
        "comma_and_point": "right",
        "hdf5_scale_factor": "right",
        "hdf5_scale_and_offset": "right",
        "hdf5_missing_value": "right",
        "matlab_nan": "asked",
        "units_in_the_cells": "right",
        "exponents_of_fortran": "right",
        "german_header": "right",
        "chinese_of_windows": "right",
        "numpy_savetxt": "right",
        "gnuplot_blocks": "right",
        "origin_with_three_rows_of_header": "right",
        "words_at_the_end": "right",
        "mean_at_the_end": "right",
        "no_units": "asked",
        "hdf5_rows_of_records": "right",
        "labview_without_times": "right",
        "pounds_and_inches": "right",
        "excel_thousands_as_text": "asked",
        "excel_hidden_rows": "wrong with a warning",
        "thousands_points_with_semicolons": "asked",
        "thousands_unquoted_before_an_empty_note": "asked",
        "decimal_comma_in_the_first_column": "asked",
        "comment_on_preprocessing_and_negative_pull": "asked",
        "minus_9999_among_pascals": "asked",
        "shortening_in_millimetres": "right",
        "same_force_in_two_units": "right",
        "units_in_columns_of_their_own": "right",
        "restart_with_preamble": "right",
        "workbook_with_merged_pressures": "right",
        "thousands_with_decimal_index": "asked",
        "unit_column_contradicts": "asked",
        "comment_force_in_kgf": "wrong with a warning",
        "series_filled_by_excel": "wrong with a warning",
        "force_and_contraction_swapped": "wrong with a warning",
    }
    assert {kind: messy.read(kind, 0, tmp_path).outcome for kind in expected} == expected


def test_the_option_settles_ambiguous_thousands(put):
    path = put(THOUSANDS)
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (2, "Force [N]")
    assert "1234" in problem.message and "1.234" in problem.message and "--decimal" in problem.remedy
    assert read_dataset(path, decimal=",").force.tolist() == [1234, 1851]
    with pytest.raises(RangeError):
        read_dataset(path, decimal=";")


def test_a_wrong_decimal_sign_is_one_problem(put):
    path = put("pressure_bar;contraction_percent;force_N\n2,5;0;200,1\n3,5;0;300,2\n")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, decimal=".")
    (problem,) = caught.value.problems
    assert problem.line == 2 and "--decimal ','" in problem.remedy
    assert read_dataset(path, decimal=",").force.tolist() == [200.1, 300.2]


@pytest.mark.parametrize("decimal", ["", ".", ","])
def test_no_option_is_advised_for_two_decimal_signs(put, decimal):
    path = put("pressure_bar;contraction_percent;force_N\n2,5;0;200,1\n3,5;0;300.2\n")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, decimal=decimal)
    assert caught.value.problems
    assert not any("--decimal" in (problem.remedy or "") for problem in caught.value.problems)


def test_a_header_without_units_is_found_below_a_preamble(put):
    path = put("Rig 3;Muscle 12\nDate;12.11.2026\n\nDruck;Kraft;Weg\n2,5;200,1;0,0\n3,5;300,2;0,5\n")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    found = [(one.line, one.field) for one in caught.value.problems]
    assert found == [(4, "Druck"), (4, "Kraft"), (4, "Weg")]


@pytest.mark.parametrize("units", ["", "bar\tN\tmm\t\n"])
def test_a_header_of_unknown_names_is_found_above_the_rows_as_wide(put, units):
    rows = "".join(f"{p}\t{100 * p},5\t{k}\tup\n" for p in (2, 3) for k in range(8))
    path = put(f"Bench; No 17\nJ. Martin\nP1\tA2\tA3\tWay\n{units}{rows}")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    assert {one.line for one in caught.value.problems} == {3}


@pytest.mark.parametrize("order", [one for one in permutations(range(3)) if one != (0, 1, 2)])
@pytest.mark.parametrize("third", ["contraction_percent", "length_mm"])
def test_exchanged_columns_are_one_problem_with_the_names_that_are_meant(put, order, third):
    names = ["pressure_bar", third, "force_N"]
    points = read_dataset(BENCHMARKS.parent / "examples" / "rig.csv")
    numbers = [points.pressure / bar, points.contraction / percent, points.force.round(2)]
    numbers[1] = 180 * (1 - points.contraction) if third == "length_mm" else numbers[1]

    def read(*columns, **options):
        rows = [",".join(f"{one:.6g}" for one in row) for row in zip(*columns, strict=True)]
        return read_dataset(put("\n".join([",".join(names), *rows])), initial_length=0.18, **options)

    with pytest.raises(DatasetError) as caught:
        read(*(numbers[at] for at in order))
    (problem,) = caught.value.problems
    meant = {names[at]: names[which] for at, which in enumerate(order) if at != which}
    assert all(f"--column '{column}={name}'" in problem.remedy for column, name in meant.items())
    with pytest.warns(McKibbenWarning, match="its name says"):
        assert read(*(numbers[at] for at in order), columns=meant).force.max() == points.force.max().round(2)
    with pytest.raises(DatasetError) as caught:  # a wrong unit stays one
        read(*numbers[:2], numbers[2] / 1000)
    assert [one.field for one in caught.value.problems] == ["force"]


def test_cells_with_units_say_their_unit(put):
    rows = "Pressure;Contraction;Force\n2 bar;0 %;{} N\n3 bar;5 %;150 N\n"
    found = read_dataset(put(rows.format("0,2e3")))
    assert found.pressure.tolist() == [2e5, 3e5]
    assert found.force.tolist() == [200, 150]
    assert read_dataset(put(rows.format("0.2 kN").replace("kN N", "kN"))).force.tolist() == [200, 150]
    for other in ("200", "200 N N", "N"):
        with pytest.raises(DatasetError):
            read_dataset(put(rows.format(other).replace(f"{other} N", other)))
    with pytest.raises(DatasetError) as caught:
        read_dataset(put("Pressure [kPa];Contraction;Force\n2 bar;0 %;200 N\n3 bar;5 %;150 N\n"))
    assert [problem.field for problem in caught.value.problems] == ["Pressure [kPa]"]
    path = put("Druck;Contraction;Force\n2 psi;0 %;200 N\n3 psi;5 %;150 N\n")
    with pytest.warns(McKibbenWarning) as heard:
        read_dataset(path, columns={"Druck": "pressure_bar"})
    assert any("Druck" in str(one.message) and "psi" in str(one.message) for one in heard)


def test_rows_with_values_that_the_file_marks_as_missing_are_left_out(put):
    def file(missing):
        stream = io.BytesIO()
        with h5py.File(stream, "w") as made:
            made["pressure_bar"], made["contraction_percent"] = [2.0, 2, 3, 3, 3], [0.0, 5, 0, 5, 10]
            made["force_N"] = [200.0, 150, 300, 240, 180]
            made["force_N"].attrs["missing_value"] = missing
        return put(stream.getvalue(), "a.h5")

    with pytest.warns(McKibbenWarning):
        found = read_dataset(file([150.0]))
    assert found.force.tolist() == [200, 300, 240, 180]
    assert "row 2, force_N" in found.table.attrs["repairs"]
    with pytest.raises(DatasetError):  # more than half of the rows
        read_dataset(file([150.0, 240.0, 180.0]))


def test_a_comment_that_looks_like_a_row_is_reported(put):
    header = "pressure_bar;contraction_percent;force_N\n"
    with pytest.warns(McKibbenWarning, match="line 3"):
        found = read_dataset(put(header + "2;0;200\n#2;2;180\n2;5;150\n# end\n"))
    assert found.force.tolist() == [200, 150]
    with pytest.raises(DatasetError):
        read_dataset(put(header + "2;0;200\n#N/A;2;180\n2;5;150\n"))


def test_a_header_in_a_comment_needs_a_name_for_each_column(put):
    rows = "2 0 200\n2 5 150\n"
    assert read_dataset(put("# rig 3\n# pressure_bar contraction_percent force_N\n" + rows)).force.tolist() == [
        200,
        150,
    ]
    with pytest.raises(DatasetError):
        read_dataset(put("# pressure_bar force_N\n" + rows))


def test_scales_that_are_not_applied_are_reported(put):
    def hdf5(change):
        stream = io.BytesIO()
        with h5py.File(stream, "w") as made:
            made["pressure_bar"], made["contraction_percent"] = [2.0, 2, 3, 3, 3], [0.0, 5, 0, 5, 10]
            made["force_N"] = [200.0, 150, 300, 240, 180]
            change(made)
        return put(stream.getvalue(), "a.h5")

    def beside(file):
        file["force_scale"] = 0.05

    for change in (
        lambda file: file["force_N"].attrs.update(sensitivity=0.05),
        lambda file: file["force_N"].attrs.update(note="half bridge, multiply by 2"),
        lambda file: file.attrs.update(force_scale=0.05),
        beside,
    ):
        with pytest.warns(McKibbenWarning, match="not applied"):
            read_dataset(hdf5(change))
    read_dataset(hdf5(lambda file: file["force_N"].attrs.update(channel=3, date="2024-03-01")))


@pytest.mark.parametrize(
    ("line", "reported"),
    [
        ("# Hint: force in N, pressure in bar", False),
        ("Units: bar, %, N", False),
        ("# Hint: force in kN, pressure in bar", True),
        ("# Hint: force in N, pressure in bar abs", True),
        ("# force in N / 2", True),
        ("# force in -N", True),
    ],
)
def test_a_line_that_repeats_the_units_of_the_columns_is_not_reported(put, line, reported):
    rows = [f"{p},{e},{300 * p * (1 - e / 26) ** 2:.1f}" for p in (1, 2, 3) for e in (0, 4, 8, 12)]
    path = put("\n".join([line, "pressure_bar,contraction_percent,force_N", *rows]) + "\n")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", McKibbenWarning)
        read_dataset(path)
    assert [str(one.message).startswith(f"{path}: line 1 says") for one in caught] == [True] * reported


def test_notes_at_cells_of_a_workbook_are_reported_and_shares_shown_in_percent_are_ratios(put):
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    sheet.append(["Pressure [bar]", "Contraction", "Force [N]"])
    for row in ((2, 0, 200), (2, 0.05, 150), (3, 0, 300)):
        sheet.append(row)
    for row in (2, 3, 4):
        sheet.cell(row, 2).number_format = "0.0%"

    def content():
        stream = io.BytesIO()
        book.save(stream)
        return stream.getvalue()

    assert read_dataset(put(content(), "a.xlsx")).contraction.tolist() == [0, 0.05, 0]
    sheet["C3"].comment = Comment("cable slipped", "AB")
    with pytest.warns(McKibbenWarning, match="C3"):
        read_dataset(put(content(), "b.xlsx"))
