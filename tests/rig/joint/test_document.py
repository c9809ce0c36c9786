"""The file of a joint rig, and the wiring of a card."""

import importlib
from pathlib import Path

import pytest

from mckibben.rig import JointRig, RunConditions
from mckibben.units import bar, deg, kPa, ms

pytest.importorskip("grpc", reason="needs the extra daq")
device = importlib.import_module("device_server")

EXAMPLE = Path(__file__).parents[3] / "examples" / "rig" / "joint-rig.yaml"


def test_the_example_says_what_the_defaults_are_but_for_the_angles():
    rig = JointRig.read(EXAMPLE)
    assert rig.rig.angle_step == pytest.approx(0.022 * deg) and rig.rig.pressure_noise == 4 * kPa
    assert rig.limits.lowest_angle == -30 * deg and rig.limits.pressure == pytest.approx(8.4 * bar)
    assert rig.limits.silence == 20 * ms and rig.limits.late == 50 * ms
    assert (rig.approach.raising, rig.approach.settling, rig.patience) == (2.0, 2.0, 0.1)


def test_a_card_is_wired_as_it_is_said(tmp_path, stiff):
    device.wired("", device.KNEE, device="Dev2").to_yaml(tmp_path / "card.yaml")
    (tmp_path / "rig.yaml").write_text("rig: {nidaqmx: {card: card.yaml}}\n", encoding="utf-8")
    card = JointRig.read(tmp_path / "rig.yaml").rig.backend(stiff.plant, RunConditions(2 * ms, 0.5))
    assert (card.rate, card.patience) == (500.0, 1.0)
    assert {channel.name: channel.where for channel in (*card.inputs, *card.outputs)} == {
        "angle": "Dev2/ai0",
        "pressure1": "Dev2/ai1",
        "pressure2": "Dev2/ai2",
        "valve1": "Dev2/ao0",
        "valve2": "Dev2/ao1",
    }
    assert card.outputs[1].high == pytest.approx(9 * bar, rel=1e-3)
