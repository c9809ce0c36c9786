"""The page of a scenario: its program in Node and in a browser against Python."""

import json
import re
import shutil
import subprocess
import time

import numpy as np
import pytest

from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario, with_values
from tests.web.chromium import PROGRAM, browser

NODE = shutil.which("node")
LABORATORY = "examples/own-joint.yaml"  # friction, creep, a valve with flow, delay, noise
SLIDERS = ["load.mass2=0.2..2 kg", "joint.muscle.friction.half_width=2..15 N", "reference.angle.amplitude=1..60 deg"]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Scenario, and its page with sliders."""
    scenario = Scenario.read(LABORATORY).model_copy(update={"duration": 0.5})
    folder = tmp_path_factory.mktemp("page")
    exported = export(scenario, "page", folder, over=SLIDERS)
    assert exported.left_out == () and len((folder / "page.html").read_bytes()) < 350_000
    return scenario, folder / "page.html"


def computed(path, values, *, knows):
    """What the page's program computes with values of its sliders [SI], in Node."""
    (program,) = re.findall(r'<script id="program">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    tail = """
    const run = simulated(adjusted(VALUES, KNOWS), SETTINGS.periods), band = bandAt(adjusted(VALUES, KNOWS), [0, 0.1]);
    const plain = object => Object.fromEntries(Object.entries(object).map(([k, v]) => [k, [v].flat().map(String)]));
    const columns = Object.fromEntries(Object.entries(run.columns).map(([k, v]) => [k, [...v].map(String)]));
    console.log(JSON.stringify({columns, metrics: plain(run.metrics), outcome: run.outcome, start: run.start,
        band: [[...band.low], [...band.high]]}));"""
    text = tail.replace("VALUES", json.dumps(values)).replace("KNOWS", json.dumps(knows))
    done = subprocess.run([NODE, "-"], input=program + text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(NODE is None, reason="needs Node, which runs the emitted JavaScript")
@pytest.mark.parametrize(
    ("values", "knows"),
    [
        ({}, False),
        ({"load.mass2": 1.1, "joint.muscle.friction.half_width": 12.0}, False),
        ({"load.mass2": 0.3, "reference.angle.amplitude": 0.04}, True),
        ({"reference.angle.amplitude": 0.12}, False),
    ],
)
def test_the_page_computes_what_python_does(page, values, knows):
    scenario, path = page
    found = computed(path, values, knows=knows)
    substeps = int(re.search(r"(\d+) steps per control period", path.read_text(encoding="utf-8"))[1])
    start = {f"start.{name}": value for name, value in found["start"].items()}
    varied = with_values(scenario, start | values, model_follows="all" if knows else ())
    run = varied.model_copy(update={"substeps": substeps}).run_once()
    for name, column in found["columns"].items():
        expected = np.asarray(run[name], float)
        np.testing.assert_allclose(np.array(column, float), expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())
    assert np.abs(np.array(found["columns"]["angle"], float) - run["angle"]).max() < 1e-11
    assert found["outcome"] == run.outcome.name
    for name in ("angle_rmse", "angle_max", "command_travel", "air", "time_saturated"):
        (text,) = found["metrics"][name]
        np.testing.assert_allclose(float(text.replace("Infinity", "inf")), run.metrics[name], rtol=1e-8)
    plant = varied.plant()
    band = plant.supplied_joint.attainable_stiffness(
        np.array([0.0, 0.1]), -plant.load.gravity_torque(np.array([0.0, 0.1]))
    )
    np.testing.assert_allclose(found["band"], band, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.skipif(NODE is None, reason="needs Node, which runs the emitted JavaScript")
def test_the_page_of_a_slide_computes_what_python_does(tmp_path):
    scenario = Scenario.read("examples/linear-axis.yaml").model_copy(update={"duration": 0.5})
    export(scenario, "page", tmp_path, over=["load.mass=1..3 kg", "reference.position.amplitude=1..8 mm"])
    values = {"load.mass": 1.2, "reference.position.amplitude": 0.006}
    found = computed(tmp_path / "page.html", values, knows=False)
    run = with_values(scenario, values, model_follows=()).run_once()
    np.testing.assert_allclose(np.array(found["columns"]["angle"], float), run["angle"], atol=1e-12)
    assert found["outcome"] == run.outcome.name and found["metrics"]["stiffness_rmse"] == ["NaN"]


@pytest.mark.slow
@pytest.mark.skipif(NODE is None, reason="needs Node, which runs the emitted JavaScript")
def test_a_start_that_cannot_be_held_is_said(page):
    _, path = page
    found = computed(path, {"reference.angle.amplitude": 1.0}, knows=False)
    assert found["outcome"] == "NO_START" and set(found["columns"]["angle"]) == {"NaN"}


@pytest.mark.slow
@pytest.mark.skipif(PROGRAM is None, reason="no Chromium is installed: apt-get install chromium")
def test_the_joint_moves_under_a_finger(page, tmp_path):
    _, path = page
    with browser(tmp_path) as tab:
        tab.open(f"file://{path}", 390)
        tab.wait("window.joint && joint.shown")
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390
        assert "completed" in tab.evaluate("document.querySelector('#verdict b').textContent").lower()
        box = tab.evaluate(
            "(({x, y, width, height}) => [x + width / 2, y + height / 2])"
            "(document.querySelector('[role=slider]').getBoundingClientRect())"
        )
        for kind, (dx, dy) in (("mousePressed", (0, 0)), ("mouseMoved", (25, -5)), ("mouseReleased", (25, -5))):
            event = {"x": box[0] + dx, "y": box[1] + dy, "button": "left", "buttons": 1, "clickCount": 1}
            tab.send("Input.dispatchMouseEvent", type=kind, **event)
        tab.wait("document.querySelector('#live').getAttribute('aria-pressed') === 'true'")
        tab.wait("joint.shown.columns.angle.at(-1) > 0.02")
        time.sleep(0.5)
        tab.evaluate("document.querySelector('[role=slider]').focus()")
        before = tab.evaluate("Number(document.querySelector('[role=slider]').ariaValueNow)")
        tab.send("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight", code="ArrowRight")
        tab.wait(f"Number(document.querySelector('[role=slider]').ariaValueNow) > {before}")
        assert tab.errors == []


def test_robots_unclear_sliders_and_other_formats_are_refused(tmp_path):
    scenario = Scenario.read(LABORATORY)
    with pytest.raises(ExportError) as error:
        export(RobotScenario.read("examples/robot/lei-leg-control.yaml"), "page", tmp_path)
    assert error.value.field == "joints"
    with pytest.raises(ExportError) as error:
        export(scenario, "c", tmp_path, over=SLIDERS)
    assert error.value.field == "over"
    with pytest.raises(ExportError) as error:  # a delay changes the length of a queue
        export(scenario, "page", tmp_path, over=["command_delay=0..9 ms"])
    assert error.value.field == "command_delay"
