"""Samples over time in CSV files: units, order, and what is wrong with a file."""

import pytest

from mckibben.errors import ScenarioError
from mckibben.storage.columns import read_columns, read_samples
from mckibben.units import deg


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def problems(path, text, name="angle", unit="deg"):
    with pytest.raises(ScenarioError) as refused:
        read_samples(written(path, text), name, unit)
    return refused.value.problems


def test_columns_are_read_in_the_units_of_their_titles(tmp_path):
    file = written(tmp_path / "a.csv", "note,angle_deg,time_ms\n,1,0\n\n,-2.5,500\n,3e1,1000\n")
    assert read_samples(file, "angle", "rad") == ([0.0, 0.5, 1.0], pytest.approx([1 * deg, -2.5 * deg, 30 * deg]))
    times, values = read_columns(file, lambda titles: dict.fromkeys(["angle"] * ("note" in titles), "deg"))
    assert times == [0.0, 0.5, 1.0] and values == {"angle": pytest.approx([1.0, -2.5, 30.0])}


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("time_s,angle_deg\n0,1\n1,x\n2,3\n", [3]),
        ("time_s,angle_deg\n0,1\n1\n2,inf\n", [3, 4]),
        ("time_s,angle_deg\n0,1\n2,1\n2,2\n1,2\n3,2\n", [4, 5]),  # times must rise
        ("time_s,angle_deg\n-2,1\n-1,0\n", []),
        ("time_s,torque_Nm\n0,1\n", [1]),
        ("time_s,angle_deg,angle_rad\n0,1,2\n", [1]),
        ("time_bar,angle_deg\n0,1\n", [1]),
        ("time_s,angle_deg\n", [None]),
        ("", [1, 1]),
    ],
)
def test_each_bad_row_or_title_is_named(tmp_path, text, lines):
    if lines:
        assert [one.line for one in problems(tmp_path / "a.csv", text)] == lines
    else:
        read_samples(written(tmp_path / "a.csv", text), "angle", "deg")


def test_a_file_that_is_too_large_or_missing_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("mckibben.storage.columns._LARGEST", 20)
    text = "time_s,angle_deg\n0,1\n"
    assert len(text) == 21
    assert len(problems(tmp_path / "a.csv", text)) == 1
    read_samples(written(tmp_path / "b.csv", text[:-1]), "angle", "deg")
    with pytest.raises(ScenarioError):
        read_samples(tmp_path / "missing.csv", "angle", "deg")
