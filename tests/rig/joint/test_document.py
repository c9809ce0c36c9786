"""The file of a joint rig, and the calibrations of a card."""

import json
from pathlib import Path

import pytest

from mckibben.errors import ScenarioError
from mckibben.rig import JointRig, RunConditions, Wiring
from mckibben.rig.joint_rig import JointCardSettings
from mckibben.units import bar, deg, kPa, ms

EXAMPLE = Path(__file__).parents[3] / "examples" / "rig" / "joint-rig.yaml"


def test_the_example_says_what_the_defaults_are_but_for_the_angles():
    rig = JointRig.read(EXAMPLE)
    assert rig.rig.angle_step == pytest.approx(0.022 * deg) and rig.rig.pressure_noise == 4 * kPa
    assert rig.limits.lowest_angle == -30 * deg and rig.limits.pressure == pytest.approx(8.4 * bar)
    assert rig.limits.silence == 20 * ms and rig.limits.late == 50 * ms
    assert (rig.approach.raising, rig.approach.settling, rig.patience) == (2.0, 2.0, 0.1)


def test_calibrations_come_back_from_their_file(tmp_path):
    path = tmp_path / "knee.json"
    path.write_text(json.dumps(Wiring().to_json()), encoding="utf-8")
    assert Wiring.of(JointCardSettings(calibration=path).calibrations()) == Wiring()


def test_all_that_is_wrong_with_calibrations_is_said_at_once(tmp_path):
    form = Wiring().to_json()
    del form["valve2"]
    form["angle"]["unit"] = "deg"
    form["force"] = form["valve1"]
    del form["pressure1"]["gain"]
    path = tmp_path / "knee.json"
    path.write_text(json.dumps(form), encoding="utf-8")
    with pytest.raises(ScenarioError) as error:
        JointCardSettings(calibration=path).calibrations()
    assert {problem.field for problem in error.value.problems} == {"valve2", "angle", "force", "pressure1"}


def test_a_card_is_wired_as_it_is_said(tmp_path, stiff):
    (tmp_path / "knee.json").write_text(json.dumps(Wiring().to_json()), encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(
        "rig: {nidaqmx: {device: Dev2, pressure2: ai5, calibration: knee.json}}\n", encoding="utf-8"
    )
    card = JointRig.read(tmp_path / "rig.yaml").rig.backend(stiff.plant, RunConditions(2 * ms, 0.5))
    assert Wiring(**card.calibrations) == Wiring() and (card.rate, card.patience) == (500.0, 0.5)
    assert {channel.name: channel.where for channel in (*card.inputs, *card.outputs)} == {
        "angle": "Dev2/ai0",
        "pressure1": "Dev2/ai1",
        "pressure2": "Dev2/ai5",
        "valve1": "Dev2/ao0",
        "valve2": "Dev2/ao1",
    }
