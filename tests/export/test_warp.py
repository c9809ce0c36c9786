"""Muscles for MuJoCo Warp, in 32 bits on its CPU device, against the plant in 64 bits."""

import ast
import importlib.util
import sys

import equinox as eqx
import jax
import mujoco
import numpy as np
import pytest

import mckibben as mk
from mckibben.export import export
from mckibben.export.mjcf import joint_model
from mckibben.export.warp import warp_muscles
from mckibben.muscle import MaxwellCreep, MaxwellSlip

LOAD = mk.KneeLoad(0.5, 0.5, 0.1, 0.2, 0.02, 0.015)
LAGS = mk.FirstOrderValve(time_constant=0.02)
FLOW = mk.FlowValve(conductance=1e-9, supply=7e5)
CAM = mk.PairedPaths(mk.Cam(0.03, 0.162, arm_slope=0.008), mk.Pulley(0.025, 0.16))
FRICTION = MaxwellSlip(12.0, 5e-4, viscous=30.0, elements=1)
STEP, PERIOD = 5e-4, 2e-3  # s


def loaded(path):
    """Module of a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def exported(plant, name, folder, start):
    """Model of MuJoCo at the start, and the module of its muscles."""
    made = joint_model(plant, name, STEP, start, plugin=False)
    path = folder / f"{name}_warp.py"
    path.write_text(warp_muscles(made.module, made.muscles, "a test", STEP))
    model = mujoco.MjModel.from_xml_string(made.xml)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return model, data, loaded(path)


def angles_in_warp(model, data, muscles, worlds, commands):
    """Angle after each control period, of each world."""
    warp = pytest.importorskip("mujoco_warp")
    m, d = warp.put_model(model), warp.put_data(model, data, nworld=worlds)
    muscles.install(m)
    angles = []
    for now in commands:
        d.ctrl.fill_(0.0)
        d.ctrl.assign(np.tile([*now, *[0.0] * (model.nu - 2)], (worlds, 1)).astype(np.float32))
        for _ in range(round(PERIOD / STEP)):
            warp.step(m, d)
        angles.append(d.qpos.numpy()[:, 0].copy())  # on the CPU a view
    return np.array(angles)


@eqx.filter_jit
def angles_of(plant, state, commands):
    """Angle after each control period."""

    def period(state, commands):
        state = plant.advance(state, (commands[0], commands[1]), PERIOD, round(PERIOD / STEP))
        return state, state.angle

    return jax.lax.scan(period, state, commands)[1]


def wave(periods=500):
    """Commands of 1 s."""
    swing = 1e5 * np.sin(12 * PERIOD * np.arange(periods))
    return np.stack([2.5e5 + swing, 3e5 - swing], -1)


def plants(knee):
    """Plants with friction, creep, and valves of all kinds."""
    parts = knee.muscle1.specimen, knee.muscle1.law
    slipping, creeping = mk.Muscle(*parts, FRICTION), mk.Muscle(*parts, FRICTION, MaxwellCreep(900.0, 0.5))
    tube = mk.Tube(FLOW, volume=1e-5, conductance=5e-10)
    return {
        "lags": mk.JointPlant(mk.AntagonisticJoint(knee.geometry, creeping, creeping), LOAD, LAGS),
        "ideal": mk.JointPlant(mk.AntagonisticJoint(CAM, slipping, slipping), LOAD, mk.IdealValve()),
        "flow": mk.JointPlant(mk.AntagonisticJoint(knee.geometry, slipping, knee.muscle2), LOAD, FLOW),
        "unequal": mk.JointPlant(knee, LOAD, mk.UnequalValves(FLOW, tube)),
        "rate": mk.JointPlant(knee, LOAD, mk.FirstOrderValve(0.02, rate=2e6)),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lags", "ideal", "flow", "unequal", "rate"])
def test_a_second_with_friction_creep_and_air_agrees(name, knee, tmp_path):
    pytest.importorskip("mujoco_warp")
    plant = plants(knee)[name]
    start = plant.init_state(0.0, (0.0, 0.0))
    model, data, module = exported(plant, name, tmp_path, start)
    found = angles_in_warp(model, data, module.Muscles(model, worlds=2), 2, wave())
    wanted = np.asarray(angles_of(plant, start, wave()))
    assert np.ptp(wanted) > 0.05
    np.testing.assert_allclose(found, wanted[:, None].repeat(2, axis=1), atol=1e-5)


@pytest.mark.slow
def test_every_law_has_the_force_of_the_joint(request, known, tmp_path):
    warp = pytest.importorskip("mujoco_warp")
    joint = request.node.callspec.params["known"]
    name = "".join(letter if letter.isalnum() else "_" for letter in joint)
    plant = mk.JointPlant(request.getfixturevalue("joints")[joint](), LOAD, mk.IdealValve())
    model, data, module = exported(plant, name, tmp_path, plant.init_state(0.0, (0.0, 0.0)))
    m, d = warp.put_model(model), warp.put_data(model, data, nworld=len(known.angles))
    module.Muscles(model, worlds=len(known.angles)).install(m)
    d.qpos.assign(np.asarray(known.angles, np.float32)[:, None])
    d.ctrl.assign(np.asarray(known.pressures, np.float32))
    warp.forward(m, d)
    torque = np.asarray(known.torque)
    np.testing.assert_allclose(d.qfrc_actuator.numpy()[:, 0], torque, atol=2e-5 * np.abs(torque).max())


@pytest.mark.slow
def test_worlds_have_parameters_of_their_own(knee, tmp_path):
    pytest.importorskip("mujoco_warp")
    plant = mk.JointPlant(knee, LOAD, LAGS)
    start = plant.init_state(0.0, (0.0, 0.0))
    model, data, module = exported(plant, "worlds", tmp_path, start)
    muscles = module.Muscles(model, worlds=3)
    muscles.set("valve.time_constant", [0.02, 0.04, 0.02])
    muscles.set("command_delay", [0.0, 0.0, 2 * PERIOD])
    commands = wave(100)
    found = angles_in_warp(model, data, muscles, 3, commands)
    slow = mk.JointPlant(knee, LOAD, mk.FirstOrderValve(time_constant=0.04))
    late = np.concatenate([commands[:1], commands[:1], commands[:-2]])
    for world, (other, given) in enumerate(((plant, commands), (slow, commands), (plant, late))):
        np.testing.assert_allclose(found[:, world], np.asarray(angles_of(other, start, given)), atol=1e-5)
    assert np.ptp(found[-1]) > 1e-3
    assert muscles.get("valve.time_constant").tolist() == [0.02, 0.04, 0.02]
    with pytest.raises(KeyError, match=r"valve\.time_constant"):
        muscles.set("valve.lag", 0.02)
    with pytest.raises(ValueError, match="command_delay"):
        muscles.set("command_delay", -1e-3)


def test_the_export_has_all_files_and_names_what_is_left_out(tmp_path):
    made = export(mk.Scenario.read("examples/pre-contracted-step-pid.yaml"), "warp", tmp_path)
    assert sorted(made.files) == ["joint.xml", "joint_warp.py", "scenario.yaml"]
    assert len(made.left_out) == 1  # the controller
    names = {
        node.name for node in ast.walk(ast.parse((tmp_path / "joint_warp.py").read_text())) if hasattr(node, "name")
    }
    assert {"force1", "rates2", "Muscles", "prepare"} <= names
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "joint.xml"))
    assert (model.nu, model.na) == (2, 2)
