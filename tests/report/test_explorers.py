"""What the page computes when sliders are moved, in Node, against the same in Python."""

import dataclasses
import json
import re
import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest

from mckibben.paper.settings import PRE_CONTRACTED, StiffnessReference, pid_scenario
from mckibben.paper.tracking import ControllerRun
from mckibben.report.explorers import explorers
from mckibben.report.page import write_explorers
from mckibben.scenario import run_scenario
from mckibben.units import deg

pytestmark = pytest.mark.slow


NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="needs Node, which runs the scripts of the page")


@pytest.fixture(scope="module")
def case():
    scenario = pid_scenario(PRE_CONTRACTED, StiffnessReference.STEP)
    return ControllerRun(scenario, run_scenario(scenario), None)


@pytest.fixture(scope="module")
def found(case):
    return explorers(case.scenario)


def run(explorer, body, **parameters):
    """What the script of an explorer computes with other parameters [SI], beside those of its sliders."""
    values = {one.name: one.value * one.factor for one in explorer.sliders} | parameters
    program = f"""
        let options, module;
        const explorer = new Proxy({{}}, {{get: () => (name, made, given) => {{ module = made; options = given; }}}});
        (function (module) {{ {explorer.script} }})();
        const self = module.defaults();
        Object.assign(self.parameters, {json.dumps(values)});
        module.prepare(self);
        const say = (x) => console.log(JSON.stringify(x, (_, v) => Number.isNaN(v) ? "NaN" : v));
        {body}"""
    done = subprocess.run([NODE, "-"], input=program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_sliders_start_at_the_values_of_the_report(found):
    for explorer in found.values():
        for one in explorer.sliders:
            steps = (one.value - one.low) / one.step
            assert one.low < one.value <= one.high
            assert steps == pytest.approx(round(steps), abs=1e-6)  # else a browser moves the slider


@needs_node
def test_run(found, case):
    body = """const [low, high, count] = options.range, rows = [];
              module.init(self);
              for (let k = 0; k < count; ++k) rows.push(module.row(self, low + (high - low) * k / (count - 1)));
              say([rows.map((row) => row.angle), rows.map((row) => row.stiffness), module.summary(self)]);"""
    *columns, summary = run(found["run"], body)
    for values, expected in zip(columns, ("angle", "stiffness"), strict=True):
        assert np.allclose(values, case.result[expected], rtol=1e-9, atol=1e-11)
    metrics = case.result.metrics
    assert summary["angle"] == pytest.approx(metrics["angle_rmse"] / deg, rel=1e-9)
    assert summary["stiffness"] == pytest.approx(metrics["stiffness_rmse"], rel=1e-9)
    assert summary["air"] == pytest.approx(metrics["air"] / 1e-3, rel=1e-9)
    assert summary["amplitude"] == metrics["oscillation_amplitude"] == summary["diverged"] == 0


@needs_node
def test_the_joint_that_is_played_has_the_lengths_of_its_geometry(found, case):
    body = "say(module.picture(self, 0.2, 2e5, 3e5));"
    drawn = run(found["run"], body)
    joint = case.scenario.plant().joint
    contractions = joint.contractions(0.2, (2e5, 3e5))
    for i, (path, contraction) in enumerate(zip(joint.geometry.path_lengths(0.2), contractions, strict=True), 1):
        across = np.hypot(drawn[f"moving_x{i}"] - drawn[f"fixed_x{i}"], drawn[f"moving_y{i}"] - drawn[f"fixed_y{i}"])
        assert across - joint.geometry.connector_length == pytest.approx(float(path), rel=1e-12)
        assert drawn[f"length{i}"] == pytest.approx(0.18 * (1 - float(contraction)), rel=1e-12)
        volume = float(joint.muscle1.specimen.volume(contraction))
        assert np.pi / 4 * drawn[f"diameter{i}"] ** 2 * drawn[f"length{i}"] == pytest.approx(volume, rel=1e-9)


@needs_node
def test_attainable_stiffness(found, case):
    angles = np.linspace(-0.7, 0.7, 29)
    body = f"say({angles.tolist()}.map((angle) => module.at(self, angle)));"
    rows = run(found["attainable"], body, connector=0.2, radius=0.04, supply=5e5)
    plant = case.scenario.plant()
    geometry = dataclasses.replace(plant.joint.geometry, connector_length=0.2, joint_radius=0.04)
    joint = dataclasses.replace(plant.joint, geometry=geometry)
    expected = joint.attainable_stiffness(angles, -plant.load.gravity_torque(angles), pressure_limits=(0.0, 5e5))
    values = np.array([[row["lowest"], row["highest"]] for row in rows], float)
    assert 5 < np.isfinite(values).all(1).sum() < 29
    assert np.allclose(values, np.stack(expected, 1), rtol=1e-9, equal_nan=True)


@needs_node
def test_force(found, case):
    contractions = [-0.02, 0.0, 0.1, 0.2]
    body = f"say({contractions}.map((contraction) => module.force(self, contraction, 4e5)));"
    muscle = case.scenario.plant().joint.muscle1
    law = dataclasses.replace(muscle.law, a1=-200.0, decay=20.0)
    expected = dataclasses.replace(muscle, law=law).tension(np.array(contractions), 4e5)
    assert np.allclose(run(found["force"], body, a1=-200.0, decay=20.0), expected, rtol=1e-12)


@needs_node
def test_the_script_of_the_page_is_valid():
    script = (files("mckibben.report") / "explorers.js").read_text()
    done = subprocess.run([NODE, "--check", "-"], input=script, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not any(word in script for word in ("fetch(", "import", "XMLHttpRequest", "</"))


def test_the_page_of_the_documentation_has_all_and_loads_nothing(case, found, tmp_path):
    text = write_explorers(found.values(), tmp_path / "explorers.html").read_text(encoding="utf-8")
    assert [key for key in found if f'id="explore-{key}"' in text] == list(found)
    assert not re.search(r"(src|href)=|https?:|@import", text.replace("http://www.w3.org/2000/svg", ""))
