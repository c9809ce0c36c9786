"""Controllers of all joints of a robot as C99: they repeat the recorded run."""

import shutil
import subprocess

import numpy as np
import pytest

from mckibben.codegen.native import compiler
from mckibben.containment.limits import Limits
from mckibben.errors import ExportError, ParameterError
from mckibben.export import export
from mckibben.export.controller_files import c_files
from mckibben.firmware import Hardware
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario
from tests.codegen.test_javascript import NODE, run
from tests.robot.test_control import DECOUPLING, ONE

FILE = "examples/robot/lei-leg-control.yaml"


@pytest.mark.parametrize(("scenario", "single"), [("leg", False), ("leg", True), ("joint", False)])
@pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
@pytest.mark.slow
def test_it_repeats_the_recorded_run(scenario, single, tmp_path):
    read = RobotScenario.read(FILE) if scenario == "leg" else RobotScenario.parse(ONE + DECOUPLING)
    read = read.replace(duration=0.4)
    export(read, "c", tmp_path, name="robot", hardware=Hardware(single=True) if single else None)
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("200 steps")
    assert float(done.stdout.split(",")[1].split()[0]) < (1e-4 if single else 1e-11)
    if scenario == "joint" and NODE:
        export(read, "js", tmp_path, name="robot", overwrite=True)
        commands, expected = run((tmp_path / "robot.js").read_text(), REPLAY, (tmp_path / "replay.csv").read_text())
        np.testing.assert_allclose(commands, expected, rtol=1e-9)


REPLAY = """const rows = given.trim().split("\\n").map(row => row.split(",")), names = rows.shift();
            const part = (row, owner) => Object.fromEntries(names.map((name, k) => [name.split("."), +row[k]])
                .filter(([name]) => name[0] === owner).map(([name, value]) => [name[1], value]));
            const self = robot.defaults(), first = rows.shift();
            robot.init(self, 0.002, part(first, "measurement"));
            const step = row => robot.step(self, part(row, "setpoint"), part(row, "measurement")).commands;
            const values = of => rows.map(row => Object.values(of(row)));
            return [values(step), values(row => part(row, "commands"))];"""


def test_what_cannot_be_exported_is_refused(tmp_path):
    landing = RobotScenario.read("examples/robot/lei-leg.yaml")
    with pytest.raises(ExportError) as caught:
        export(landing, "c", tmp_path / "out")
    assert caught.value.field == "controller" and caught.value.remedy
    joint = Scenario.read("examples/pre-contracted-step-pid.yaml")
    for scenario, target, other in ((landing, "firmware", "mjcf"), (joint, "matlab", "firmware")):
        with pytest.raises(ParameterError) as unknown:
            export(scenario, target, tmp_path / "out")
        assert (unknown.value.field, unknown.value.value) == ("to", target) and other in unknown.value.remedy
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_run_beyond_the_limits_is_refused(tmp_path):
    scenario = RobotScenario.parse(ONE + DECOUPLING)
    with pytest.raises(ExportError) as caught:
        c_files(scenario, "robot", tmp_path, limits=Limits(highest_angle=0.01))
    assert caught.value.field.startswith(("setpoint.angles", "measurement.angles"))
