"""Files that claim much, and rows that a mark in one of them must not take away."""

import io
import os
import time
import warnings

import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter

from mckibben.dataset import read_dataset, read_recording
from mckibben.dataset.formats import read_table
from mckibben.errors import DatasetError, McKibbenWarning
from mckibben.storage.columns import read_samples

HEADER = "pressure_bar,contraction_percent,force_N"
ROWS = [f"{1 + i % 5},{4 - i / 10:g},{i}.5" for i in range(40)]
SECONDS = 5.0


def refused(path, **more):
    start = time.process_time()
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, **more)
    assert time.process_time() - start < SECONDS
    return caught.value.problems[0]


@pytest.mark.parametrize("line", [0, 2, 38])
@pytest.mark.parametrize("place", ["start", "end"])
def test_a_stray_quotation_mark_takes_its_own_row_alone(put, line, place):
    rows = ROWS.copy()
    rows[line] = f'"{rows[line]}' if place == "start" else rows[line].replace(",", ',"', 2).replace(',"', ",", 1)
    path = put("\n".join([HEADER, *rows]) + "\n")
    with pytest.warns(McKibbenWarning, match="1 of 40 rows"):
        data = read_dataset(path, on_corrupt="report")
    assert data.force.tolist() == [i + 0.5 for i in range(40) if i != line]


def test_a_last_line_of_a_lone_quotation_mark_is_listed(put):
    path = put("\n".join([HEADER, *ROWS, '"']))
    with pytest.warns(McKibbenWarning, match="1 of 41 rows"):
        assert len(read_dataset(path, on_corrupt="report")) == 40


def test_a_text_between_quotation_marks_may_have_two_lines(put):
    text = "\n".join([f"{HEADER},note", '1,0,80,"two\nlines"', "2,0,90,one", "3,0,95,x"])
    assert read_dataset(put(text)).force.tolist() == [80, 90, 95]


def test_a_header_of_thousands_of_columns_is_refused_at_once(put):
    many = ",".join(f"c{i}" for i in range(80_000))
    assert refused(put(f"{HEADER},{many}\n{'1,' * 80_002}1\n")).line == 1
    assert refused(put(f"{HEADER},{','.join('abcd' * 1200)}\n1,2,3\n")).line == 1
    assert refused(put(f"{HEADER},{'x' * 5_000_000}\n1,2,3,4\n")).line == 1
    assert refused(put(f"{'x in ' * 30_000}\n1\n")).message


def test_a_cell_in_the_last_column_of_a_sheet_is_refused(put):
    book, stream = openpyxl.Workbook(), io.BytesIO()
    book.active.append(HEADER.split(","))
    book.active.append([1, 2, 3])
    book.active["XFD3"] = 1
    book.save(stream)
    problem = refused(put(stream.getvalue(), "rig.xlsx"))
    assert problem.line == 3
    assert "columns" in problem.message


def test_a_file_cut_off_in_a_character_is_utf_8_up_to_there(put):
    content = "\n".join([f"{HEADER},note", *(f"{row},ü" for row in ROWS)]).encode()[:-1]
    assert len(read_dataset(put(content))) == 40


@pytest.mark.parametrize("text", ["1_0", "\u0661", "0x1", "infinity"])
def test_numbers_are_those_that_people_write(put, text):
    problem = refused(put(f"{HEADER}\n{text},0,80\n2,0,90\n"))
    assert (problem.line, problem.field) == (2, "pressure_bar")
    table = put(f"time_s,angle_deg\n0,1\n1,{text}\n", "samples.csv")
    with pytest.raises(ValueError, match="line 3"):
        read_samples(table, "angle", "deg")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("name", ["rig.csv", "rig.nc", "rig.mat"])
@pytest.mark.parametrize("read", [read_dataset, read_recording])
def test_pipes_and_devices_are_refused_whatever_their_name(tmp_path, name, read):
    os.mkfifo(tmp_path / name)
    with pytest.raises(DatasetError):
        read(tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises(DatasetError):
        read(tmp_path / name)


def test_a_long_text_that_many_cells_refer_to_is_shortened(put):
    book, stream = openpyxl.Workbook(), io.BytesIO()
    book.active.append([*HEADER.split(","), "note"])
    for row in ROWS:
        book.active.append([*map(float, row.split(",")), "y" * 10_000])
    book.active.append([1, 2, "x" * 10_000, "y"])
    book.save(stream)
    notes = read_table(put(stream.getvalue(), "rig.xlsx"), {}).channels[3].cells
    assert max(map(len, notes)) < 1000
    assert len(set(map(id, notes[:40]))) == 1
    assert refused(put(stream.getvalue(), "rig.xlsx")).line == 42


@pytest.mark.parametrize("wrong", ["", "n/a"])
@pytest.mark.parametrize("how", ["raise", "report"])
def test_the_problems_of_a_column_without_numbers_are_few(put, wrong, how):
    count = 40_000
    rows = [f"{1 + i % 5},{i % 20},{wrong if i % 3 else i}" for i in range(count)]
    with pytest.raises(DatasetError) as caught:
        read_dataset(put("\n".join([HEADER, *rows, ""])), on_corrupt=how)
    problems = caught.value.problems
    assert len(problems) < count / 2
    assert {one.field for one in problems} <= {"force_N", ""}
    assert any(one.line is None and one.field == "force_N" for one in problems)
    assert [one.line for one in problems if one.line][:3] == [3, 4, 6]


def test_a_unit_as_long_as_a_file_is_no_unit(tmp_path):
    path = tmp_path / "rig.tdms"
    columns = {"pressure_bar": [1.0, 2.0], "contraction_percent": [0.0, 1.0], "force_N": [30.0, 50.0]}
    with TdmsWriter(str(path)) as writer:
        for name, values in columns.items():
            properties = {"unit_string": "y" * 10_000_000} if name == "force_N" else {}
            writer.write_segment([ChannelObject("rig", name, np.array(values), properties=properties)])
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", McKibbenWarning)
        assert len(read_dataset(path)) == 2
    assert time.process_time() - start < SECONDS / 5
