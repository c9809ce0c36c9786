"""`mckibben envelope`: table, verdict, nearest references, designs and errors."""

import csv
import json
import re

import pytest

from mckibben.scenario import Scenario
from mckibben.simulation import check_reference

INFEASIBLE = ("amplitude: 2 deg, frequency: 0.5 Hz", "amplitude: 20 deg, frequency: 5 Hz")


@pytest.fixture
def printed(shortened, tmp_path):
    """The knee as printed, with a reference of 20 deg."""
    text = shortened("as-printed-constant-pid").replace(*INFEASIBLE)
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_a_trackable_reference(cli, shortened, tmp_path):
    (tmp_path / "s.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    found = cli("envelope", "s.yaml")
    assert (found.code, found.err) == (0, "")
    assert "static range -36.49 to 38.57 deg" in found.out
    assert re.search(
        r"0 deg +-0.736 N\*m +-7.28..7.28 N\*m +9.96..19.53 N\*m/rad +3.05, 2.72 bar +6, 5.67 bar", found.out
    )
    assert "trackable throughout" in found.out
    assert "nearest" not in found.out


@pytest.mark.slow
def test_an_infeasible_reference_and_the_nearest(cli, printed):
    found = cli("envelope", "s.yaml", "--out", "kept")
    assert (found.code, found.err) == (0, "")
    assert "not even statically trackable: " in found.out
    kept = printed / "kept"
    numbers = json.loads((kept / "results.json").read_text(encoding="utf-8"))
    assert numbers["trackable"] is False and numbers["verdict"] in found.out
    assert numbers["static_range_deg"] == pytest.approx([-10.37, 10.37], abs=0.01)
    assert [near["preserved"] for near in numbers["nearest"]] == ["angle", "stiffness"]
    names = {"results.json", "envelope.png", "envelope.svg", "nearest-angle.yaml", "nearest-stiffness.yaml"}
    assert {path.name for path in kept.iterdir()} == names | {"nearest-angle.csv"}
    for near in numbers["nearest"]:
        assert f"nearest, {near['preserved']} preserved: {near['described']}" in found.out
        scenario = Scenario.read(kept / f"nearest-{near['preserved']}.yaml")
        sine = scenario.signals.angle
        assert sine.frequency == 5 and sine.amplitude == pytest.approx(near["amplitude"] * 20 * 0.0174532925)
        plant = scenario.plant()
        reach = check_reference(plant, scenario.reference(), duration=0.2)
        assert reach.feasible or near["preserved"] == "stiffness"
        scenario.initial(plant)
    with (kept / "nearest-angle.csv").open() as file:
        header, *rows = csv.reader(file)
    assert header == ["time_s", "stiffness_N*m/rad"] and len(rows) == 200
    again = cli("envelope", "kept/nearest-angle.yaml", "--json")
    assert json.loads(again.out)["trackable"] is True


@pytest.mark.slow
def test_json_alone_on_standard_output(cli, printed):
    found = cli("envelope", "s.yaml", "--json", "--out", "kept")
    assert json.loads(found.out) == json.loads((printed / "kept" / "results.json").read_text(encoding="utf-8"))
    assert "results.json, nearest-angle.yaml" in found.err


@pytest.mark.slow
def test_a_load_that_is_too_heavy(cli, printed):
    text = (printed / "s.yaml").read_text(encoding="utf-8")
    heavy = text.replace("load: knee-table-2", "load: {from: knee-table-2, mass2: 500 kg, hanging_angle: 90 deg}")
    (printed / "heavy.yaml").write_text(heavy, encoding="utf-8")
    found = cli("envelope", "heavy.yaml", "--out", "kept")
    assert found.code == 0
    assert "the joint cannot hold its load at any angle" in found.out and "outside the attainable" in found.out
    assert (printed / "kept" / "envelope.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_design(cli, printed):
    target = "stiffness 14..18 N*m/rad over -15..15 deg"
    vary = ("--vary", "connector_length=190..240 mm", "--vary", "joint_radius=20..50 mm")
    found = cli("envelope", "s.yaml", "--design", target, *vary, "--out", "kept")
    assert (found.code, found.err) == (0, "")
    assert f"{target}: attained with connector_length 209.4 mm" in found.out
    assert re.search(r"joint radius +30 mm +31\.\d+ mm", found.out)
    numbers = json.loads((printed / "kept" / "results.json").read_text(encoding="utf-8"))
    scenario = Scenario.read(printed / "kept" / "design.yaml")
    assert scenario.joint.geometry.connector_length * 1e3 == pytest.approx(numbers["lengths_mm"]["connector_length"])
    assert scenario.joint.geometry.joint_radius * 1e3 == pytest.approx(numbers["lengths_mm"]["joint_radius"])
    scenario.initial(scenario.plant())
    band = scenario.plant().joint.attainable_stiffness(0.1, 0.0)
    assert float(band[0]) < 14 and float(band[1]) > 18
    assert (printed / "kept" / "design.svg").exists()


@pytest.mark.slow
def test_a_design_of_one_muscle_leaves_the_other(cli, printed):
    target, vary = "stiffness 10..12 N*m/rad over -1..1 deg", ("--vary", "muscle2_length=175..178 mm")
    found = cli("envelope", "s.yaml", "--design", target, *vary, "--out", "kept", "--force")
    assert found.code == 0, found.err
    (length,) = json.loads((printed / "kept" / "results.json").read_text(encoding="utf-8"))["lengths_mm"].values()
    joint = Scenario.read(printed / "kept" / "design.yaml").plant().joint
    assert float(joint.muscle1.specimen.initial_length) == 0.18
    assert float(joint.muscle2.specimen.initial_length) * 1e3 == pytest.approx(length)
    assert 175 <= length <= 178


@pytest.mark.slow
def test_a_design_that_holds_nothing_is_drawn_too(cli, printed):
    target, vary = "stiffness 14..18 N*m/rad over -10..10 deg", ("--vary", "muscle_length=1e-9..40 mm")
    found = cli("envelope", "s.yaml", "--design", target, *vary, "--out", "kept", "--force")
    assert found.code in (0, 1), found.err
    assert "infeasible" in found.out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--margin", "60 %"), "the margin is 0.6"),
        (("--margin", "5 mm"), "--margin: "),
        (("--smoothing", "0 s"), "the smoothing is 0 s"),
        (("--vary", "joint_radius=20..50 mm"), "apply to a design; add --design"),
        (("--torque-reserve", "1 N*m"), "apply to a design; add --design"),
        (("--design", "stiffness 14..18 N*m/rad over 0..5 deg"), "varies nothing; add --vary"),
        (("--design", "much", "--vary", "joint_radius=20..50 mm"), "not a design target"),
        (("--design", "14..18 N*m/rad over 0..5 deg", "--vary", "radius=20..50 mm"), "joint_radius"),
    ],
)
def test_a_mistake_is_one_error(cli, printed, arguments, named):
    found = cli("envelope", "s.yaml", *arguments)
    assert (found.code, found.out) == (2, "")
    assert found.err.startswith("error: ") and named in found.err
    assert "Traceback" not in found.err
