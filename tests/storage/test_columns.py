"""Samples over time in CSV files: units, order, and the line of each mistake."""

import pytest

from mckibben.errors import ScenarioError
from mckibben.storage.columns import read_columns
from mckibben.units import deg


def test_columns_are_read_in_the_units_of_their_titles(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("note,angle_deg, time_ms\n,1,0\n\n,-2.5,500\n,3e1,1000\n", encoding="utf-8")
    times, columns = read_columns(file, lambda titles: dict.fromkeys(["angle"] * ("note" in titles), "rad"))
    assert times.tolist() == [0.0, 0.5, 1.0]
    assert columns["angle"] == pytest.approx([1 * deg, -2.5 * deg, 30 * deg])


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("time_s,angle_deg\n0,1\n1,x\n2,3\n", [3]),
        ("time_s,angle_deg\n0,1\n1\n2,inf\n3,1_0\n", [3, 4, 5]),
        ("time_s,angle_deg\n0,1\n2,1\n2,2\n1,2\n3,2\n", [4, 5]),  # times must rise
        ("time_s,torque_Nm\n0,1\n", [1]),
        ("time_s,angle_deg,angle_rad\n0,1,2\n", [1]),
        ("time_bar,angle_deg\n0,1\n", [1]),
        ("time_s,angle_deg\n", [None]),
        ("time_s,angle_deg\n0,1\n1,2,3,4\n", [None]),
        ("", [None]),
        (f"time_s,angle_deg\n0,1{' ' * 100}", [None]),  # too large
        (None, [None]),
    ],
)
def test_each_bad_row_or_title_is_named(tmp_path, text, lines):
    file = tmp_path / "a.csv"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError) as refused:
        read_columns(file, lambda _: {"angle": "deg"}, largest=100)
    assert [problem.line for problem in refused.value.problems] == lines
