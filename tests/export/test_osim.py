"""OpenSim models against JAX: the expressions by themselves, and in OpenSim where that is installed."""

import math

import pytest

import mckibben as mk
from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.export.osim import osim_model
from mckibben.muscle import HuntLaw

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


@pytest.fixture
def known(known):
    """Without the law whose force is the root of an equation, and without series of tables: they are refused."""
    joint = known.joint
    tables = any(isinstance(getattr(joint.geometry, path, None), mk.TabulatedPath) for path in ("path1", "path2"))
    if tables or isinstance(joint.muscle1.law, HuntLaw):
        with pytest.raises(ExportError) as caught:
            osim_model(mk.JointPlant(joint, LOAD, mk.IdealValve()), (2e5, 3e5))
        assert caught.value.field == "muscle1"
        assert caught.value.remedy
        pytest.skip("refused, as it should be")
    return known


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


def test_opensim_gives_the_same_acceleration(known, tmp_path):
    opensim = pytest.importorskip("opensim", reason="72 MB, not needed to write a model")
    opensim.Logger.setLevelString("error")
    plant = mk.JointPlant(known.joint, LOAD, mk.IdealValve())
    file = tmp_path / "joint.osim"
    for at in (0, 8):
        angle, pressures = known.angles[at], known.pressures[at]
        file.write_text(osim_model(plant, tuple(pressures)).text)
        model = opensim.Model(str(file))
        state = model.initSystem()
        coordinate = model.getCoordinateSet().get("angle")
        coordinate.setValue(state, angle)
        coordinate.setSpeedValue(state, 0.7)
        model.realizeAcceleration(state)
        wanted = float(LOAD.acceleration(angle, 0.7, known.torque[at]))
        inertia = float(LOAD.total_inertia)
        assert coordinate.getAccelerationValue(state) * inertia == pytest.approx(wanted * inertia, abs=1e-9)


def test_a_scenario_is_at_the_pressures_of_its_start(tmp_path):
    scenario = mk.Scenario.read("examples/pre-contracted-step-pid.yaml")
    made = export(scenario, "osim", tmp_path)
    plant = scenario.plant()
    pressures = scenario.initial(plant).pressures
    assert made.files["joint.osim"] == osim_model(plant, pressures).text == (tmp_path / "joint.osim").read_text()
    assert any("valves" in one for one in made.left_out)
    assert any("controller" in one for one in made.left_out)
