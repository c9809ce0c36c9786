import dataclasses
import json

import numpy as np
import pytest

from mckibben.errors import RangeError, RigError, ScenarioError
from mckibben.rig.bench import Drive
from mckibben.rig.calibration import Calibration, calibrate, read_calibrations, to_json
from mckibben.units import bar, mm

FORCE = Calibration(name="force", unit="N", gain=-200.0, offset=0.05, low=-2000.0, high=2000.0)
TARED = dataclasses.replace(FORCE, tare=-12.0)
WEIGHTS = np.array([0.0, 98.1, 294.3, 588.6, 784.8])  # N, of 0, 10, 30, 60 and 80 kg


def test_volts_and_newtons_are_each_others_inverse():
    loads = np.linspace(-2000, 2000, 9)
    for calibration in (FORCE, TARED):
        np.testing.assert_allclose(calibration.si(calibration.volts(loads)), loads, atol=1e-9)
    assert FORCE.si(0.05) == 0 and FORCE.si(-0.95) == pytest.approx(200)


def test_least_squares_line_is_that_of_numpy():
    volts = 0.02 + WEIGHTS / 200 + np.array([1, -2, 1.5, 0.5, -1]) * 1e-3
    made = calibrate("force", "N", volts=volts, known=WEIGHTS, low=0, high=1000)
    slope, intercept = np.polyfit(volts, WEIGHTS, 1)
    np.testing.assert_allclose(made.si(volts), slope * volts + intercept, rtol=0, atol=1e-9)
    assert made.residual == pytest.approx(np.abs(made.si(volts) - WEIGHTS).max())
    two = calibrate("force", "N", volts=volts[[0, -1]], known=WEIGHTS[[0, -1]], low=0, high=1000)
    np.testing.assert_allclose(two.si(volts[[0, -1]]), WEIGHTS[[0, -1]], atol=1e-9)


def test_large_residual_is_refused_with_its_point():
    volts = WEIGHTS / 200
    volts[2] += 0.1  # 20 N
    with pytest.raises(RigError, match=r"294\.3 N is 1[0-9.]+ N off the line"):
        calibrate("force", "N", volts=volts, known=WEIGHTS, low=0, high=1000)


@pytest.mark.parametrize(
    ("known", "low", "high", "share"),
    [(WEIGHTS, 0, 2000, "39 %"), (WEIGHTS, -2000, 2000, "39 %"), (WEIGHTS, 0, 700, "112 %")],
)
def test_span_that_is_not_covered_is_refused(known, low, high, share):
    with pytest.raises(RigError, match=share):
        calibrate("force", "N", volts=known / 200, known=known, low=low, high=high)


def test_line_through_one_point_is_refused():
    with pytest.raises(RigError, match="two different points"):
        calibrate("force", "N", volts=[1.0, 1.1], known=[200.0, 200.0], low=0, high=200)
    with pytest.raises(RigError, match="two different points"):
        calibrate("force", "N", volts=[1.0, 1.0], known=[0.0, 200.0], low=0, high=200)
    with pytest.raises(RigError, match="give one for each"):
        calibrate("force", "N", volts=[1.0], known=[0.0, 200.0], low=0, high=200)


def test_sensor_is_lost_outside_its_span_and_on_a_rail():
    pressure = Calibration(name="pressure", unit="Pa", gain=1 * bar, low=0.0, high=8 * bar)
    channel = pressure.channel("ai1", -10.0, 10.0)
    assert (channel.low, channel.high) == pytest.approx((-0.16 * bar, 8.16 * bar))
    wide = Calibration(name="pressure", unit="Pa", gain=1 * bar, low=0.0, high=10 * bar).channel("", -10.0, 10.0)
    assert 9.99 * bar < wide.high < 10 * bar
    # The other way round, and a tare does not move the sensor's own span.
    for calibration in (FORCE, TARED):
        channel = calibration.channel("ai0", -20.0, 20.0)
        ends = sorted(map(float, calibration.volts([channel.low, channel.high])))
        assert ends == pytest.approx([-10.35, 10.45])


def test_a_file_comes_back_as_it_went(tmp_path):
    made = calibrate("pressure", "Pa", volts=0.02 + WEIGHTS / 200, known=WEIGHTS, low=0, high=1000, by="us")
    path, units = tmp_path / "calibrations.json", {"force": "N", "pressure": "Pa"}
    both = {"force": FORCE, "pressure": dataclasses.replace(made, tare=3.0)}
    path.write_text(to_json(both))
    assert read_calibrations(path, units) == both


@pytest.mark.parametrize(
    ("wrong", "fields"),
    [
        ({"pressure": None}, {"pressure"}),
        ({"unit": "deg"}, {"force"}),
        ({"gain": "much", "colour": "red", "high": None}, {"force.gain", "force.colour", "force.high"}),
    ],
)
def test_all_that_is_wrong_in_a_file_is_told_at_once(tmp_path, wrong, fields):
    forms = json.loads(to_json({"force": FORCE, "pressure": dataclasses.replace(FORCE, name="pressure", unit="Pa")}))
    for key, value in wrong.items():
        form = forms if key in forms else forms["force"]
        form[key] = value
        if value is None:
            del form[key]
    path = tmp_path / "calibrations.json"
    path.write_text(json.dumps(forms))
    with pytest.raises(ScenarioError) as refused:
        read_calibrations(path, {"force": "N", "pressure": "Pa"})
    assert {problem.field for problem in refused.value.problems} == fields


@pytest.mark.parametrize("wrong", [{"gain": 0.0}, {"low": 3000.0}])
def test_a_calibration_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(RangeError):
        dataclasses.replace(FORCE, **wrong)


def test_drive_is_that_of_the_paper():
    drive = Drive()
    # 200 steps, reduced 10 times, make 5 mm; the pulses of 1 mm at 0.2 mm/s take the paper's 5 s.
    assert drive.pulses(5 * mm) == 200 * 10 and drive.pulses(-1 * mm) / drive.rate(0.2 * mm) == -5.0
    assert drive.travel(drive.pulses(0.007)) == 0.007
    for way in (0.1 * mm / 3, np.nan):
        with pytest.raises(RangeError):
            drive.pulses(way)
    for speed in (0.0, 5.01 * mm, np.nan):
        with pytest.raises(RangeError):
            drive.rate(speed)
