"""The line of a sensor from readings at known values."""

import pytest

from mckibben.errors import McKibbenError
from mckibben.rig.sensor_line import sensor_line


@pytest.mark.parametrize(
    ("readings", "gain", "offset", "unit"),
    [
        (["0.02 = 0 N", "2.96 = 588 N"], 200.0, -4.0, "N"),
        (["1 = 0 kg", "3 = 1 kg"], 9.81 / 2, -9.81 / 2, "N"),
        (["-1 = 90 deg", "1 = 0 deg"], -0.7853981634, 0.7853981634, "rad"),
        (["0.5 = -0.1 bar", "4.5 = 5.9 bar", "2.5 = 2.9 bar"], 1.5e5, -0.85e5, "Pa"),
    ],
)
def test_gain_and_offset_are_those_of_the_sensor(readings, gain, offset, unit):
    line = sensor_line(readings)
    assert (line.gain, line.offset, line.unit) == (pytest.approx(gain), pytest.approx(offset), unit)
    assert [remark.field for remark in line.remarks()].count("value") == ("kg" in readings[0])


def test_what_is_off_the_line_is_shown():
    line = sensor_line(["0 = 0 N", "1 = 100 N", "2 = 206 N"])
    assert line.deviation == pytest.approx([1.0, -2.0, 1.0])


@pytest.mark.parametrize(
    ("readings", "value"),
    [
        ([], 0),
        (["1 = 2 N"], 1),
        (["1 = 2 N", "1 = 3 N"], 2),
        (["1 = 2 N", "2 = 2 N"], 2),
        (["0,5 = 2 N", "1 = 3 N"], "0,5 = 2 N"),
        (["0.5 = 2", "1 = 3 N"], "0.5 = 2"),
        (["nan = 2 N", "1 = 3 N"], "nan = 2 N"),
        (["1 = 2 s", "1 = 3 s"], "1 = 2 s"),
        (["1 = 2 bar", "2 = 3 N"], None),
    ],
)
def test_what_is_no_line_is_refused(readings, value):
    with pytest.raises(McKibbenError) as error:
        sensor_line(readings)
    assert getattr(error.value, "value", None) == value and error.value.remedy
