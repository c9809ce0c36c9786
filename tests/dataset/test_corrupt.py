import warnings

import numpy as np
import pytest

from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import DatasetError, McKibbenWarning

from .conftest import said_of

HEADER = "pressure_bar,contraction_percent,force_N\n"
ROWS = [f"{p},{c},{f}.25\n" for p, c, f in zip(range(1, 13), range(12), range(100, 112), strict=True)]
DAMAGED = ROWS.copy()
DAMAGED[2] = "3,2,1\x0002.25\n"
DAMAGED[5] = "6,5\n"
DAMAGED[7] = "8,,107.25\n"
LEFT = [0, 1, 3, 4, 6, 8, 9, 10, 11]


def test_corrupt_rows_are_an_error_that_names_all(put):
    found = said_of(put(HEADER + "".join(DAMAGED)))
    assert found == [
        "line 4, force_N: '1\\x0002.25' is not a number",
        "line 7: has 2 cells, the header 3",
        "line 9, contraction_percent: the cell is empty",
    ]


def test_corrupt_rows_are_left_out_and_every_one_is_reported(put, tmp_path):
    path = put(HEADER + "".join(DAMAGED))
    with pytest.warns(McKibbenWarning, match=r"3 of 12 rows are left out: line 4, force_N: .*; line 7: has 2"):
        data = read_dataset(path, on_corrupt="report")
    assert data.force.tolist() == [100.25 + i for i in LEFT]
    assert data.table.attrs["repairs"].splitlines() == said_of(path)
    data.to_csv(tmp_path / "kept.csv")
    data.to_netcdf(tmp_path / "kept.nc")
    for kept in ("kept.csv", "kept.nc"):
        assert read_dataset(tmp_path / kept).table.attrs["repairs"] == data.table.attrs["repairs"]


def test_the_remedy_of_a_corrupt_row_names_the_option(put):
    def remedies(rows):
        with pytest.raises(DatasetError) as caught:
            read_dataset(put(HEADER + "".join(rows)))
        return [one.remedy for one in caught.value.problems]

    assert all("'report' (command line: --skip-corrupt)" in remedy for remedy in remedies(DAMAGED))
    named = ["--skip-corrupt" in remedy for remedy in remedies([*DAMAGED[:11], "-9,1,1\n"])]
    assert all(named[:-1]) and not named[-1]  # the last one is not corrupt
    assert not any("--skip-corrupt" in remedy for remedy in remedies(["a,b,c\n"] * 7 + ROWS[:6]))


def test_what_is_a_number_and_cannot_be_meant_stays_an_error(put):
    rows = [*DAMAGED[:11], "-9,1,1\n"]
    found = said_of(put(HEADER + "".join(rows)), on_corrupt="report")
    assert found[-1] == "line 13, pressure_bar: -9 bar is below a vacuum (-1.0132 bar, gauge)"
    assert len(found) == 4


def test_more_than_half_of_the_rows_are_never_left_out(put):
    rows = ["a,b,c\n"] * 7 + ROWS[:6]
    found = said_of(put(HEADER + "".join(rows)), on_corrupt="report")
    assert "7 of 13 rows are not numeric: more than half cannot be left out" in found
    with pytest.warns(McKibbenWarning, match="6 of 12 rows"):
        assert len(read_dataset(put(HEADER + "".join(rows[1:])), on_corrupt="report")) == 6


@pytest.mark.slow
@pytest.mark.parametrize("row", ["1,2\n", '"1,2,3\n'])
def test_the_corrupt_rows_of_a_large_file_are_listed_in_part(row, put):
    """The child process does not send a problem for each of them."""
    path = put(HEADER + "".join(ROWS) + row * (2**20 // len(row)))
    for on_corrupt in ("raise", "report"):
        with pytest.raises(DatasetError) as caught:
            read_dataset(path, on_corrupt=on_corrupt)
        total, *listed = caught.value.problems
        assert total.line is None
        assert [one.line for one in listed] == list(range(14, 1014))


@pytest.mark.parametrize("end", ["12,11", "12", "12,"])
def test_a_last_line_that_was_cut_off_is_recognised(end, put):
    path = put(HEADER + "".join(ROWS[:11]) + end)
    cells = "2 cells" if "," in end else "1 cell"
    assert said_of(path) == [f"line 13: has {cells}, the header 3, and no line end: the file was truncated here"]
    with pytest.warns(McKibbenWarning, match="1 of 12 rows are left out: line 13: .* truncated here"):
        assert len(read_dataset(path, on_corrupt="report")) == 11


def test_a_last_number_that_may_have_lost_decimals_is_warned_of(put):
    for cut in ("12,11,1", "12,11,111", "12,11,111.2"):
        with pytest.warns(
            McKibbenWarning, match="line 13 has no line end and its last number has . decimals where others"
        ):
            assert len(read_dataset(put(HEADER + "".join(ROWS[:11]) + cut))) == 12
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_dataset(put(HEADER + "".join(ROWS)[:-1]))


def test_zero_bytes_at_the_end_are_a_cut_and_not_a_binary_file(put):
    path = put((HEADER + "".join(ROWS[:11]) + "12,11,").encode() + bytes(300))
    found = said_of(path)
    assert "the file ends in 300 zero bytes: it was truncated while being written" in found[-1]
    with pytest.warns(McKibbenWarning, match="zero bytes"):
        assert len(read_dataset(path, on_corrupt="report")) == 11


def test_a_stray_quotation_mark_does_not_swallow_rows_in_silence(put):
    rows = [row.replace("\n", ",ok\n") for row in ROWS]
    rows[3] = rows[3].replace(",ok", ',"ok')
    rows[8] = rows[8].replace(",ok", ',o"k')
    path = put(HEADER.replace("\n", ",note\n") + "".join(rows))
    assert [line.split(":")[0] for line in said_of(path)] == ["line 5"]
    legal = [row.replace(",ok", ',"two\nlines"') for row in rows[:3]]
    assert len(read_dataset(put(HEADER.replace("\n", ",note\n") + "".join(legal)))) == 3


def test_words_that_are_no_directions_are_corrupt_rows(put):
    rows = [row.replace("\n", f",{'loading' if i else 'l?ading'}\n") for i, row in enumerate(ROWS)]
    path = put(HEADER.replace("\n", ",direction\n") + "".join(rows))
    with pytest.warns(McKibbenWarning, match="'l.ading' is not a direction"):
        assert read_dataset(path, on_corrupt="report").table["direction"].values.tolist() == ["loading"] * 11


def test_an_unknown_direction_is_one_problem_per_word_and_all_its_rows_are_left_out(put):
    words = ["bajada", "subida", "bajada", *["loading"] * (len(ROWS) - 3)]
    rows = [row.replace("\n", f",{word}\n") for row, word in zip(ROWS, words, strict=True)]
    path = put(HEADER.replace("\n", ",direction\n") + "".join(rows))
    with pytest.raises(DatasetError) as refused:
        read_dataset(path)
    assert [one.message for one in refused.value.problems] == [
        "'bajada' is not a direction",
        "'subida' is not a direction",
    ]
    with pytest.warns(McKibbenWarning, match="3 of 12 rows"):
        assert len(read_dataset(path, on_corrupt="report")) == len(ROWS) - 3


def test_a_recording_keeps_the_time_of_what_is_left(put):
    path = put(HEADER + "".join(DAMAGED))
    with pytest.warns(McKibbenWarning, match="3 of 12 rows"):
        record = read_recording(path, on_corrupt="report", sample_rate=10.0)
    np.testing.assert_allclose(record.time, np.array(LEFT) / 10)
    assert len(record.table.attrs["repairs"].splitlines()) == 3
