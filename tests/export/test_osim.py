"""OpenSim models against JAX: the expressions by themselves, and in OpenSim where that is installed."""

import math
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.export.osim import osim_model

LOAD = mk.KneeLoad(0.5, 0.5, 0.1, 0.2, 0.02, 0.015)
FUNCTIONS = {name: getattr(math, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan")}
FUNCTIONS |= {"max": max, "min": min, "abs": abs, "step": lambda x: float(x >= 0), "tanh": math.tanh}


def value(expression: str, **variables: float) -> float:
    """Value of an expression with definitions, in Python."""
    whole, *definitions = expression.split(";")
    for definition in reversed(definitions):
        name, text = definition.split("=")
        variables[name] = eval(text.replace("^", "**"), FUNCTIONS | variables)
    return eval(whole.replace("^", "**"), FUNCTIONS | variables)


REFUSED = ("HuntLaw", "tables", "arms and a pulley")
"""The law whose force is the root of an equation, and series of tables."""
WRITTEN = [name for name in run_path(str(Path(__file__).with_name("conftest.py")))["JOINTS"] if name not in REFUSED]


@pytest.mark.parametrize("name", REFUSED)
def test_roots_and_tables_are_refused(joints, name):
    with pytest.raises(ExportError) as caught:
        osim_model(mk.JointPlant(joints[name](), LOAD, mk.IdealValve()), (2e5, 3e5))
    assert caught.value.field == "muscle1"
    assert caught.value.remedy


@pytest.mark.parametrize("known", WRITTEN, indirect=True)
@pytest.mark.slow
def test_expressions_give_the_torque_and_none_pushes(known):
    plant = mk.JointPlant(known.joint, LOAD, mk.IdealValve())
    for at in range(0, 40, 8):
        angle, pressures = known.angles[at], known.pressures[at]
        model = osim_model(plant, tuple(pressures))
        paths, arms = known.joint.geometry.paths_and_arms(angle)
        total = 0.0
        for number in (0, 1):
            specimen = (known.joint.muscle1, known.joint.muscle2)[number].specimen
            sign = 1 if number else -1
            if model.rest[number] is None:
                torque = value(model.expressions[number], q=angle)
                assert sign * torque >= 0
            else:
                tension = value(model.expressions[number], s=float(paths[number]) - specimen.initial_length)
                assert tension >= 0
                torque = sign * tension * float(arms[number])
            total += torque
        assert total == pytest.approx(known.torque[at], abs=1e-9)
    assert len(model.left_out) == 1 + model.rest.count(None)


IN_OPENSIM = """
import sys
import opensim
opensim.Logger.setLevelString("error")
for file, angle, velocity in zip(*[iter(sys.argv[1:])] * 3):
    model = opensim.Model(file)
    state = model.initSystem()
    coordinate = model.getCoordinateSet().get("angle")
    coordinate.setValue(state, float(angle))
    coordinate.setSpeedValue(state, float(velocity))
    model.realizeAcceleration(state)
    print(repr(coordinate.getAccelerationValue(state)))
"""


@pytest.mark.slow
@pytest.mark.skipif(find_spec("opensim") is None, reason="OpenSim has no wheel for this platform")
def test_opensim_gives_the_same_acceleration(joints, tmp_path):
    """In a process of its own: it brings a CasADi that does not go with another one."""
    pressures, angles, arguments, wanted = (2e5, 3e5), (-0.2, 0.15), [], []
    for name in WRITTEN:
        plant = mk.JointPlant(joints[name](), LOAD, mk.IdealValve())
        for angle in angles:
            file = tmp_path / f"{len(wanted)}.osim"
            file.write_text(osim_model(plant, pressures).text)
            arguments += [str(file), repr(angle), "0.7"]
            wanted.append(float(LOAD.acceleration(angle, 0.7, plant.joint.torque(angle, pressures))))
    made = subprocess.run([sys.executable, "-c", IN_OPENSIM, *arguments], capture_output=True, text=True, check=True)
    found = np.array(made.stdout.split()[-len(wanted) :], float)
    inertia = float(LOAD.total_inertia)
    np.testing.assert_allclose(found * inertia, np.array(wanted) * inertia, rtol=0, atol=1e-9)


def test_a_scenario_is_at_the_pressures_of_its_start(tmp_path):
    scenario = mk.Scenario.read("examples/pre-contracted-step-pid.yaml")
    made = export(scenario, "osim", tmp_path)
    plant = scenario.plant()
    pressures = scenario.initial(plant).pressures
    assert made.contents["joint.osim"] == osim_model(plant, pressures).text == (tmp_path / "joint.osim").read_text()
    assert any("valves" in one for one in made.left_out)
    assert any("controller" in one for one in made.left_out)
