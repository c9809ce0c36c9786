import dataclasses
import json

import numpy as np
import pytest

from mckibben.errors import RangeError, RigError, ScenarioError
from mckibben.rig.backend import AnalogChannel
from mckibben.rig.bench import Drive
from mckibben.rig.calibration import Calibration, calibrate, read_calibrations
from mckibben.units import bar, mm

FORCE = Calibration(name="force", unit="N", gain=-200.0, offset=0.05, low=-2000.0, high=2000.0)
CHANNEL = AnalogChannel("force", -10.0, 10.0)
WEIGHTS = np.array([0.0, 98.1, 294.3, 588.6, 784.8])  # N, of 0, 10, 30, 60 and 80 kg


def test_volts_and_newtons_are_each_others_inverse():
    loads = np.linspace(-2000, 2000, 9)
    for calibration in (FORCE, FORCE.tared([0.1, 0.12])):
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
    volts = [-0.1, 0.0, 8.1, 8.2, 10.0, np.nan]
    assert pressure.lost(volts).tolist() == [False, False, False, True, True, True]
    wide = Calibration(name="pressure", unit="Pa", gain=1 * bar, low=0.0, high=10 * bar)
    assert wide.lost([9.99, 10.0, -10.0], CHANNEL).tolist() == [False, True, True]
    assert not wide.lost([10.0]).any()
    # The other way round, and a tare does not move the sensor's own span.
    assert FORCE.tared([0.5]).limits == FORCE.limits == pytest.approx((-10.35, 10.45))


def test_tare_of_a_loaded_or_lost_sensor_is_refused():
    assert FORCE.tared([0.0, 0.2]).si(0.1) == pytest.approx(0, abs=1e-12)
    with pytest.raises(RigError, match="a tenth"):
        FORCE.tared([3.0])
    for readings in ([], [12.0]):
        with pytest.raises(RigError, match="lost"):
            FORCE.tared(readings)


def test_what_leaves_the_span_or_the_converter_is_told():
    assert FORCE.check(0, 1900, CHANNEL) == []
    (span,) = FORCE.check(0, 2001)
    assert "0..2001 N leaves its span" in str(span)
    (volts,) = FORCE.check(0, 630, AnalogChannel("force", -3.0, 3.0))
    assert "-3.1..0.05 V" in str(volts)


def test_form_comes_back_as_it_went():
    made = calibrate("force", "N", volts=0.02 + WEIGHTS / 200, known=WEIGHTS, low=0, high=1000, by="us")
    for calibration in (FORCE, made, made.tared([0.03])):
        assert Calibration.from_json(json.loads(json.dumps(calibration.to_json()))) == calibration


def test_all_that_is_wrong_in_a_form_is_told_at_once():
    with pytest.raises(RangeError) as caught:
        Calibration.from_json({"name": "force", "unit": 1, "gain": "200", "low": 0.0, "colour": "red"})
    for text in ("high: missing", "unit: 1 is not text", "gain: '200' is not a number", "colour: is not a known key"):
        assert text in str(caught.value)
    for wrong in ({"gain": 0.0}, {"gain": np.inf}, {"low": 3000.0}):
        with pytest.raises(RangeError):
            dataclasses.replace(FORCE, **wrong)


def test_all_calibrations_of_a_rig_are_in_a_file_in_its_units(tmp_path):
    path, units = tmp_path / "calibrations.json", {"force": "N", "pressure": "Pa"}
    forms = {"force": FORCE.to_json(), "pressure": dataclasses.replace(FORCE, name="pressure", unit="Pa").to_json()}
    path.write_text(json.dumps(forms))
    assert read_calibrations(path, units)["force"] == FORCE
    for wrong, field in (
        ({"force": forms["force"]}, "pressure"),  # one is missing
        (forms | {"angle": forms["force"]}, "angle"),
        (forms | {"pressure": forms["force"]}, "pressure"),  # of another sensor
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(ScenarioError) as refused:
            read_calibrations(path, units)
        assert [one.field for one in refused.value.problems] == [field]


def test_a_damaged_form_is_refused_unless_its_checksum_was_taken_out():
    text = json.dumps(FORCE.to_json())
    for place in range(len(text)):
        for bit in (1, 2, 4):
            damaged = text[:place] + chr(ord(text[place]) ^ bit) + text[place + 1 :]
            try:
                form = json.loads(damaged)
            except ValueError:
                continue
            if form.get("checksum") is not None and form != json.loads(text):
                with pytest.raises(RangeError, match="checksum"):
                    Calibration.from_json(form)
    form = FORCE.to_json() | {"gain": 300.0}
    del form["checksum"]
    assert Calibration.from_json(form).gain == 300.0


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
