"""Controllers of all joints of a robot as C99: they repeat the recorded run."""

import shutil
import subprocess

import numpy as np
import pytest

from mckibben.codegen.native import compiler
from mckibben.errors import ExportError, ParameterError
from mckibben.export import export
from mckibben.export.containment.limits import Limits, containment_of
from mckibben.export.controller_files import c_files
from mckibben.export.hardware import Hardware
from mckibben.export.targets import Exported, filled
from mckibben.result import Severity
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario
from tests.codegen.test_javascript import NODE, run
from tests.robot.test_control import DECOUPLING, ONE, TORQUE

FILE = "examples/robot/lei-leg-control.yaml"


@pytest.mark.parametrize(("scenario", "single"), [("leg", False), ("joint", True), ("joint", False)])
@pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
@pytest.mark.slow
def test_it_repeats_the_recorded_run(scenario, single, tmp_path):
    read = RobotScenario.read(FILE) if scenario == "leg" else RobotScenario.parse(ONE + DECOUPLING)
    read = read.replace(duration=0.4)
    export(read, "c", tmp_path, name="robot", hardware=Hardware(single=True) if single else None)
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("200 of 200 steps")
    assert float(done.stdout.split(",")[1].split()[0]) < (1e-4 if single else 1e-11)
    if scenario == "joint" and not single and NODE:
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


MANY = "".join(
    f"""    - name: m{k}
      connector_length: 208 mm
      through:
        - {{body: thigh, place: [{x} mm, {5 * k} mm, 185 mm]}}
        - {{body: shank, place: [{x} mm, {5 * k} mm, -185 mm]}}
      muscle: {{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}
"""
    for k, x in enumerate((30, -31, 29, -30, 31, -29, 30, -30, 31, -31))
)
TOY = """#include <stdbool.h>
typedef struct { double y; } toy_measurement;
typedef struct { double r; } toy_setpoint;
typedef struct { double pressure1; } toy_commands;
typedef struct { int fault; } toy_telemetry;
typedef struct { double x; } toy;
static void toy_defaults(toy *self) { self->x = 0; }
static bool toy_init(toy *self, double period, const toy_measurement *m) { (void)period; self->x = m->y; return true; }
static void toy_step(toy *self, const toy_setpoint *s, const toy_measurement *m, toy_commands *c, toy_telemetry *t)
{
    self->x = POLE * self->x + m->y + s->r;
    c->pressure1 = self->x;
    t->fault = 0;
}
"""
"""A controller with a pole; above 1 it is unstable without its plant, and amplifies rounding."""


@pytest.mark.skipif(compiler() is None, reason="there is no cc")
@pytest.mark.parametrize(
    ("pole", "rounding", "wrong", "passes"),
    [
        (0.5, 0.0, 0.0, True),
        (0.5, 1e-4, 0.0, False),
        (1.1, 1e-14, 0.0, True),
        (1.1, 1e-9, 0.0, False),
        (1.1, 0.0, 1e-5, False),
        (1.3, 1e-14, 0.0, True),  # the run is longer than the comparison
        (1.3, 0.0, 1e-5, False),
    ],
)
def test_a_controller_that_amplifies_rounding_is_told_from_a_wrong_program(pole, rounding, wrong, passes, tmp_path):
    """Rounding of the first sample grows in the replay as it does by a known change; another command does not pass."""
    noise = 1e-3 * np.random.default_rng(1).normal(size=201)
    state, rows = noise[0] * (1 + rounding), [[np.nan, noise[0], np.nan]]
    for disturbance in noise[1:]:
        y = (0.9 - pole) * state + disturbance  # the plant makes the loop stable
        state = pole * state + y
        rows.append([0.0, y, state])
    table = np.array(rows)
    table[20, 2] *= 1 + wrong
    np.savetxt(tmp_path / "replay.csv", table, "%.17g", ",", header="setpoint.r,measurement.y,commands.pressure1")
    columns = [("setpoint", "r"), ("measurement", "y"), ("commands", "pressure1")]
    values = {"name": "toy", "rows": len(table), "columns": columns, "first_command": 2, "real": "double"}
    (tmp_path / "replay.c").write_text(filled("replay.c", values | {"tolerance": "1e-9", "seconds": "0.001"}))
    (tmp_path / "toy.h").write_text(TOY.replace("POLE", repr(pole)))
    subprocess.run([compiler(), "-Wall", "-Werror", "-o", "replay", "replay.c", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode == 0) == passes, done.stdout
    assert ("amplifies rounding" in done.stdout) == (passes and rounding > 0)


def test_a_stiffness_of_0_is_out_of_range():
    limits = containment_of(RobotScenario.parse(ONE + TORQUE), Limits())
    (low,), (high,) = (side.setpoint["stiffness"] for side in (limits.lowest, limits.highest))
    assert 0 < low < 1 < 16 <= high < 200
    assert 100 < limits.highest.measurement.ground_force < 1e5
    (given,) = containment_of(RobotScenario.parse(ONE + TORQUE), Limits(highest_stiffness=30)).highest.setpoint[
        "stiffness"
    ]
    assert given == 30


def test_muscles_that_soften_a_joint_do_not_lower_the_limit_of_its_stiffness():
    """Straight through the axis: with a pressure in these the joint is as soft as -27 N*m/rad."""
    soft = "".join(
        f"""    - name: soft{x}
      connector_length: 175 mm
      through: [{{body: thigh, place: [{x} mm, 0 mm, 170 mm]}}, {{body: shank, place: [{x} mm, 0 mm, -170 mm]}}]
      muscle: {{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}
"""
        for x in (4, -4)
    )
    many = (ONE + TORQUE, ONE.replace("valve:", soft + "valve:") + TORQUE)
    alone, together = (
        containment_of(RobotScenario.parse(text), Limits()).highest.setpoint["stiffness"] for text in many
    )
    np.testing.assert_allclose(together, alone, rtol=0.02)
    assert float(alone[0]) > 18


@pytest.mark.parametrize(
    ("operations", "severity"), [(30_000, []), (80_000, [Severity.WARNING]), (130_000, [Severity.SEVERE])]
)
def test_a_step_that_takes_the_period_is_reported(operations, severity):
    """On a processor of 600 MHz, with ten instructions for an operation."""
    exported = Exported({}, worst_case={"additions": operations}, period=2e-3)
    assert exported.step_time == pytest.approx(operations / 60e6)
    assert [remark.severity for remark in exported.remarks()] == severity
    assert not list(Exported({}, worst_case={"additions": operations}).remarks())


def test_what_cannot_be_exported_is_refused(tmp_path):
    landing = RobotScenario.read("examples/robot/lei-leg.yaml")
    with pytest.raises(ExportError) as caught:
        export(landing, "c", tmp_path / "out")
    assert caught.value.field == "controller" and caught.value.remedy
    joint = Scenario.read("examples/pre-contracted-step-pid.yaml")
    with pytest.raises(ParameterError) as unknown:
        export(joint, "matlab", tmp_path / "out")
    assert (unknown.value.field, unknown.value.value) == ("to", "matlab") and "firmware" in unknown.value.remedy
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_run_beyond_the_limits_is_refused(tmp_path):
    scenario = RobotScenario.parse(ONE + DECOUPLING)
    with pytest.raises(ExportError) as caught:
        c_files(scenario, "robot", tmp_path, limits=Limits(highest_angle=0.01))
    assert caught.value.field.startswith(("setpoint.angles", "measurement.angles"))


def test_an_export_under_another_name_replaces_the_files_of_the_one_before_and_no_others(tmp_path):
    def write(format, **files):
        Exported({name.replace("_", "."): "text" for name in files}, format=format).save(tmp_path, force=True)
        return {path.name for path in tmp_path.iterdir()} - {"exports.json"}

    (tmp_path / "mine.c").touch()
    assert write("c", knee_c=1, knee_h=1, scenario_yaml=1) == {"mine.c", "knee.c", "knee.h", "scenario.yaml"}
    assert write("js", knee_js=1, scenario_yaml=1) >= {"knee.c", "knee.js", "scenario.yaml"}
    assert write("c", leg_c=1, leg_h=1) == {"mine.c", "leg.c", "leg.h", "knee.js", "scenario.yaml"}
    (tmp_path / "exports.json").write_text('{"c": ["../outside", "leg.h"]}')
    (tmp_path.parent / "outside").touch()
    assert write("c", arm_c=1) == {"mine.c", "arm.c", "leg.c", "knee.js", "scenario.yaml"}
    assert (tmp_path.parent / "outside").exists()
