"""`mckibben calibrate`: a simulated experiment, recordings from files, and mistakes."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from mckibben.actuator import Actuator, FirstOrderValve
from mckibben.calibration import read_joint_recording
from mckibben.component.schema import read_component
from mckibben.scenario import Scenario

EXAMPLE = Path("examples/calibration/knee.yaml").resolve()
WEIGHT = ("--weight", "0.5 kg, 200 mm", "--limb", "estimated")

ROOT = Path(__file__).parents[2]


def estimates(numbers):
    """Rows of the table of estimates by quantity, in the unit of their row."""
    table = next(table["columns"] for table in numbers["tables"] if table["title"] == "calibration")
    names = table.pop("quantity")["values"]
    return {name: {key: column["values"][i] for key, column in table.items()} for i, name in enumerate(names)}


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    from typer.testing import CliRunner

    from mckibben.cli import app

    folder = tmp_path_factory.mktemp("calibration")
    done = CliRunner().invoke(app, ["calibrate", str(EXAMPLE), *WEIGHT, "--out", str(folder)])
    assert done.exit_code == 0, done.output
    return folder


@pytest.mark.slow
def test_the_calibrated_model_is_nearer_to_the_muscles(calibrated):
    before, after = Scenario.read(EXAMPLE), Scenario.read(calibrated / "scenario.yaml")
    true, believed, found = before.joint, before.controller.model, after.controller.model
    assert after.joint == found and after.load == after.controller.load
    angle, pressures = np.linspace(-0.12, 0.12, 7), (4.8e5, 4.5e5)
    wanted = np.asarray(true.evaluate(angle, pressures)[1])
    errors = [np.abs(np.asarray(one.evaluate(angle, pressures)[1]) - wanted).mean() for one in (believed, found)]
    assert errors[1] < 0.4 * errors[0]
    numbers = json.loads((calibrated / "results.json").read_text(encoding="utf-8"))
    rows = estimates(numbers)
    assert rows["friction"]["determined"]
    assert not rows["added_mass"]["determined"]  # the weight is the scale
    for name in ("scenario.yaml", "model.yaml"):
        assert not re.search(r"\d\.\d{8}", (calibrated / name).read_text(encoding="utf-8"))


@pytest.mark.parametrize("finished", [True, False])
def test_records_of_an_earlier_experiment_are_used_only_if_they_are_complete(cli, tmp_path, finished):
    (tmp_path / "x" / "bare_slow").mkdir(parents=True)
    (tmp_path / "x" / "bare_slow" / "record-0001.mcap").touch()
    if finished:
        (tmp_path / "x" / "bare_slow" / "result.nc").touch()
    found = cli("calibrate", str(EXAMPLE), "--limb", "weighed", "--duration", "20 s", "--out", "x")
    assert found.code == 2
    assert ("--recording x/bare_slow/result.nc" in found.err) == finished


@pytest.mark.slow
def test_recordings_give_the_same_as_the_experiment(cli, calibrated):
    parts = [(option, name) for option, name in (("--recording", "bare"), ("--weighted", "weighted"))]
    files = [
        each
        for option, name in parts
        for pace in ("slow", "fast")
        for each in (option, calibrated / f"{name}_{pace}" / "result.nc")
    ]
    found = cli("calibrate", str(EXAMPLE), *WEIGHT, *map(str, files), "--out", "again", "--json")
    assert found.code == 0, found.err
    again, kept = json.loads(found.out), json.loads((calibrated / "results.json").read_text(encoding="utf-8"))
    masses = [estimates(numbers)["load.mass"]["estimate"] for numbers in (again, kept)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-3)


@pytest.mark.slow
def test_parts_are_slow_and_fast_within_the_angles(calibrated):
    for name in ("bare", "weighted"):
        for pace, most in (("slow", 11.0), ("fast", 12.0)):
            recording = read_joint_recording(calibrated / f"{name}_{pace}" / "result.nc")
            moved = np.degrees(np.abs(recording.angle).max())
            assert 4.0 < moved < most
            assert recording.time[-1] == pytest.approx(15.0, abs=0.01)
            crossings = np.count_nonzero(np.diff(np.sign(recording.angle - recording.angle.mean())))
            assert (crossings > 30) == (pace == "fast")


def test_a_robot_without_recordings_is_asked_for_them(cli):
    robot = str(ROOT / "examples/robot/lei-leg-control.yaml")
    found = cli("calibrate", robot, "--limb", "weighed", "--out", "kept")
    assert found.code == 2 and "--recording" in found.err


def test_it_is_asked_whether_the_limb_was_weighed(cli):
    found = cli("calibrate", str(EXAMPLE), "--weight", "0.5 kg, 200 mm", "--out", "x")
    assert found.code == 2 and "--limb weighed" in found.err and "--limb estimated" in found.err


VALVES = ("--valves", "--duration", "20 s", "--angles", "-8..12 deg")


@pytest.mark.slow
def test_valves_are_calibrated_and_their_recordings_give_the_same(cli, calibrated, tmp_path):
    """The scenario's valve has 20 ms, and the controller's 30 ms; its model of the joint is calibrated, and stays."""
    before = Scenario.read(calibrated / "scenario.yaml")
    controller = dataclasses.replace(before.controller, valve=FirstOrderValve(0.03))
    before.model_copy(update={"controller": controller}).to_yaml(tmp_path / "s.yaml")
    done = cli("calibrate", "s.yaml", *VALVES, "--out", "valves", "--json")
    assert done.code == 0, done.err
    found = estimates(json.loads(done.out))
    for number in (1, 2):
        lag = found[f"valve{number}.time_constant"]
        assert lag["determined"]
        assert abs(lag["estimate"] - 20) < 4 * lag["deviation"]
    after = Scenario.read(tmp_path / "valves" / "scenario.yaml")
    assert after.controller.valve.time_constant == pytest.approx(0.02, rel=0.05)
    assert after.valve == after.controller.valve != before.valve
    assert after.controller.model == before.controller.model == after.joint
    assert after.command_delay == pytest.approx(0.0, abs=1e-3)
    loop = next(table["columns"] for table in json.loads(done.out)["tables"] if "loop" in table["title"])
    assert loop["plant"]["values"][0] == "calibrated" and len(set(loop["disk margin"]["values"])) > 1
    assert (tmp_path / "valves" / "valve_calibration.png").stat().st_size > 10_000
    valve = read_component(Actuator, tmp_path / "valves" / "valve.yaml")  # as `valve: valve.yaml` does
    assert valve == after.controller.valve
    recordings = [f"valves/{part}/result.nc" for part in ("steps", "multisine")]
    files = [one for path in recordings for one in ("--recording", path)]
    again = cli("calibrate", "s.yaml", "--valves", *files, "--out", "again", "--json")
    assert again.code == 0, again.err
    assert estimates(json.loads(again.out)) == found
