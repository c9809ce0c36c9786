"""A robot in MuJoCo Warp, in 32 bits on its CPU device, against the plant in 64 bits."""

import ast
import dataclasses
import importlib
import importlib.util
import sys
from pathlib import Path
from runpy import run_path

import jax
import mujoco
import numpy as np
import pytest

import mckibben as mk
from mckibben.cli.export import export
from mckibben.errors import ParameterError
from mckibben.export.warp import warp_plant
from mckibben.muscle import MaxwellCreep, MaxwellSlip
from mckibben.robot import RobotScenario, RobotStart
from mckibben.units import bar, deg

ROBOT = Path("examples/robot/lei-leg.yaml")
OTHERS = run_path(str(Path(__file__).with_name("test_mujoco.py")))
STEP, PERIOD, PERIODS = 1e-3, 2e-3, 100  # 0.2 s
PRESSURES = tuple(one * bar for one in (4.3, 4.6, 4.2, 4.5, 4.9, 4.5, 1.0))  # that hold the robot near 0
START = RobotStart((2 * deg, -3 * deg, 1 * deg), PRESSURES, clearance=0.5)
REGULATOR = mk.PressureRegulator(conductance=0.5e-8, supply=7 * bar, time_constant=0.01, dead_volume=5e-6)
TOLERANCE = 1e-5  # rad


def arm(valve, **parts):
    """The robot with its trunk held: three joints of which two have straight paths, and a muscle over two of them."""
    muscle, known = dataclasses.replace(OTHERS["MUSCLE"], strength=1.0, **parts), lambda one: isinstance(one, mk.Muscle)
    plant = OTHERS["plant_of"]("fixed", valve=valve)
    return jax.tree.map(lambda one: muscle if known(one) else one, plant, is_leaf=known)


def commands():
    """Commands of all muscles in each period."""
    return PRESSURES + 0.3 * bar * np.sin(50 * PERIOD * np.arange(PERIODS)[:, None] + np.arange(7))


@jax.jit
def angles_of(plant, state, commands):
    """Angles after each control period."""

    def period(state, commands):
        state = plant.advance(state, tuple(commands), PERIOD, round(PERIOD / STEP))
        return state, jax.numpy.stack(state.posture.angles)

    return jax.lax.scan(period, state, commands)[1]


@pytest.mark.slow
def test_three_joints_and_a_muscle_over_two_agree(tmp_path):
    warp = pytest.importorskip("mujoco_warp", reason="the extra warp is not installed")
    importlib.import_module("warp").config.optimization_level = 0  # compiling takes longer than running
    plant = arm(REGULATOR, friction=MaxwellSlip(12.0, 5e-4, viscous=30.0, elements=2), creep=MaxwellCreep(900.0, 0.5))
    state = plant.begin(START)
    made = warp_plant(plant, "arm", STEP, state)
    model = mujoco.MjModel.from_xml_string(made.contents["arm.xml"])
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    made.save(tmp_path)
    spec = importlib.util.spec_from_file_location("arm_warp", tmp_path / "arm_warp.py")
    module = sys.modules["arm_warp"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    muscles = module.Muscles(model, worlds=1)
    m, d = warp.put_model(model), warp.put_data(model, data, nworld=1)
    muscles.install(m)
    found, control = [], np.zeros((1, model.nu), np.float32)
    for now in commands():
        control[:, muscles.actuators] = now
        d.ctrl.assign(control)
        for _ in range(round(PERIOD / STEP)):
            warp.step(m, d)
        found.append(d.qpos.numpy()[0].copy())
    wanted = np.asarray(angles_of(plant, state, commands()))
    assert np.min(np.ptp(wanted, axis=0)) > 0.02
    np.testing.assert_allclose(found, wanted, atol=TOLERANCE)


def test_the_command_writes_model_and_module_of_a_robot(tmp_path, capsys):
    plant = RobotScenario.read(ROBOT).plant()
    export(scenario=ROBOT, to="warp", out=tmp_path, name="knee")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["knee.xml", "knee_warp.py", "scenario.yaml"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "knee.xml"))
    assert [model.actuator(one).name for one in range(4)] == list(plant.robot.muscle_names)
    assert (model.nu, model.na) == (8, 8)  # of each muscle the pressure, and the regulator's own
    tree = ast.parse((tmp_path / "knee_warp.py").read_text())
    (names,) = (one.value for one in tree.body if isinstance(one, ast.Assign) and one.targets[0].id == "ACTUATORS")
    assert ast.literal_eval(names) == plant.robot.muscle_names
    with pytest.raises(ParameterError) as caught:
        export(scenario=ROBOT, to="osim", out=tmp_path)
    assert caught.value.field == "to"
