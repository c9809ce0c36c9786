"""Muscles for MuJoCo Warp, in 32 bits on its CPU device, against the plant in 64 bits."""

import ast
import dataclasses
import importlib.util
import sys
from importlib import metadata
from itertools import cycle, islice
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import NamedTuple

import equinox as eqx
import jax
import mujoco
import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import SecondOrderValve
from mckibben.export import export
from mckibben.export.warp import warp_plant
from mckibben.muscle import ForceCorrection, MaxwellCreep, MaxwellSlip, NoCreep, NoFriction
from mckibben.numerics.compiled import numeric

JOINTS = run_path(str(Path(__file__).parent / "conftest.py"))
VALVES = run_path(str(Path(__file__).parents[1] / "actuator" / "test_actuator_contract.py"))["EXAMPLES"]
LOAD = mk.KneeLoad(0.5, 0.5, 0.1, 0.2, 0.02, 0.015)
LAGS = mk.FirstOrderValve(time_constant=0.02)
STEP, PERIOD, PERIODS = 1e-3, 2e-3, 250  # 0.5 s, a cycle of the commands
TOLERANCE = 1e-5  # rad


def loaded(path):
    """Module of a file; to compile its kernels takes longer than to run them."""
    importlib.import_module("warp").config.optimization_level = 0
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Made(NamedTuple):
    """A joint for MuJoCo Warp: MJCF, its module and its plant."""

    xml: str
    module: object
    plant: mk.JointPlant


def made(plant, name, folder):
    """Files of a plant at rest without pressure, with its strengths as numbers."""
    muscles = (dataclasses.replace(one, strength=1.0) for one in (plant.joint.muscle1, plant.joint.muscle2))
    parts = (plant.joint.geometry, *muscles, plant.joint.tendon)
    plant = dataclasses.replace(plant, joint=mk.AntagonisticJoint(*parts))
    files = warp_plant(plant, name, STEP, plant.init_state(0.0, (0.0, 0.0))).contents
    path = folder / f"{name}_warp.py"
    path.write_text(files[path.name])
    return Made(files[f"{name}.xml"], loaded(path), plant)


def together(joints):
    """One model of MuJoCo with several joints, and the state of each at its start."""
    whole = mujoco.MjSpec()
    whole.option.timestep, whole.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    for name, one in joints.items():
        whole.attach(mujoco.MjSpec.from_string(one.xml), prefix=f"{name}_", frame=whole.worldbody.add_frame())
    model = whole.compile()
    data = mujoco.MjData(model)
    for name, one in joints.items():
        alone = mujoco.MjModel.from_xml_string(one.xml)
        begun = mujoco.MjData(alone)
        mujoco.mj_resetDataKeyframe(alone, begun, 0)
        data.joint(f"{name}_joint").qpos[:] = begun.qpos
        for actuator in range(alone.nu):
            there = model.actuator(f"{name}_{alone.actuator(actuator).name}")
            if there.actnum[0]:
                data.act[there.actadr[0]] = begun.act[alone.actuator(actuator).actadr[0]]
    return model, data


def angles_in_warp(model, data, muscles, worlds, commands):
    """Angles of all joints after each control period, of each world; every joint has the same commands."""
    warp = pytest.importorskip("mujoco_warp")
    m, d = warp.put_model(model), warp.put_data(model, data, nworld=worlds)
    for one in muscles:
        one.install(m)
    angles, control = [], np.zeros((worlds, model.nu), np.float32)
    for now in commands:
        for one in muscles:
            control[:, one.actuators] = now
        d.ctrl.assign(control)
        for _ in range(round(PERIOD / STEP)):
            warp.step(m, d)
        angles.append(d.qpos.numpy().copy())  # on the CPU a view
    return np.array(angles)


@eqx.filter_jit
def angles_of(plant, state, commands):
    """Angle after each control period."""

    def period(state, commands):
        state = plant.advance(state, (commands[0], commands[1]), PERIOD, round(PERIOD / STEP))
        return state, state.angle

    return jax.lax.scan(period, state, commands)[1]


def wave(periods=PERIODS):
    """Commands."""
    swing = 1e5 * np.sin(12 * PERIOD * np.arange(periods))
    return np.stack([2.5e5 + swing, 3e5 - swing], -1)


def opened(valve):
    """A valve without the reservoir that couples the muscles."""
    fields = {"reservoir_volume", "line_conductance"} & {one.name for one in dataclasses.fields(valve)}
    return dataclasses.replace(valve, **dict.fromkeys(fields))


def cases():
    """Plants by the names of their parts: each law, geometry, friction, creep and valve occurs in one of them."""
    laws, valves = list(JOINTS["LAWS"]), [opened(one) for one in VALVES if not one.switches]
    geometries = JOINTS["GEOMETRIES"]
    frictions = [MaxwellSlip(12.0, 5e-4, viscous=30.0, elements=1), NoFriction(),
                 MaxwellSlip(12.0, 5e-4, growth=1e-5, tension_growth=0.02, viscous=20.0, elements=4)]  # fmt: skip
    creeps = [
        NoCreep(),
        MaxwellCreep(900.0, 0.5),
        MaxwellCreep(900.0, 0.5, pressure_share=0.2, pressure_time_constant=0.3),
    ]
    valves += [mk.IdealValve(), LAGS, *(SecondOrderValve(60.0, damping=one) for one in (1.0, 3.0))]
    count = max(len(valves), len(geometries), -(-len(laws) // 2))
    parts = [islice(cycle(each), count) for each in (geometries, valves, frictions, creeps)]
    pairs = zip(islice(cycle(laws), 0, 2 * count, 2), islice(cycle(laws), 3, 2 * count + 2, 2), strict=True)
    found = {}
    for number, (pair, geometry, valve, friction, creep) in enumerate(zip(pairs, *parts, strict=True)):
        ones = [dataclasses.replace(JOINTS["law_joint"](one).muscle1, friction=friction, creep=creep) for one in pair]
        if not number:
            ones[1] = dataclasses.replace(ones[1], correction=ForceCorrection((-20.0, 5.0), (1e-5, 0.0), 0.1, 0.05))
        plant = mk.JointPlant(mk.AntagonisticJoint(geometries[geometry], *ones), LOAD, valve)
        found["-".join([*pair, geometry, type(valve).__name__, str(number)])] = plant
    return found


CASES = cases()
BRANCHING = "HuntLaw", "TonduLopezVariableLaw", "tables", "arms and a pulley", "two bones"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Angles of all cases by MuJoCo Warp; in the second world each parameter is larger by 1 %."""
    pytest.importorskip("mujoco_warp", reason="the extra warp is not installed")
    folder = tmp_path_factory.mktemp("warp")
    joints = {f"j{number}": made(plant, f"j{number}", folder) for number, plant in enumerate(CASES.values())}
    model, data = together(joints)
    muscles = [one.module.Muscles(model, worlds=2, prefix=f"{name}_") for name, one in joints.items()]
    for one, joint in zip(muscles, joints.values(), strict=True):
        for name in joint.module.PARAMETERS:
            one.set(name, one.get(name) * np.array([1.0, 1.01]).reshape(2, *[1] * (one.get(name).ndim - 1)))
    angles = angles_in_warp(model, data, muscles, 2, wave())
    places = [model.joint(f"{name}_joint").qposadr[0] for name in joints]
    return {case: (one, angles[:, :, place]) for case, place, one in zip(CASES, places, joints.values(), strict=True)}


def larger(plant, names):
    """A plant whose parameters of some names are larger by 1 %."""

    def changed(path, leaf):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        return leaf * 1.01 if name in names else leaf

    return jax.tree_util.tree_map_with_path(changed, numeric(plant))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_each_law_path_friction_creep_and_valve_agrees(case, runs):
    one, found = runs[case]
    for world, names in enumerate(((), one.module.PARAMETERS)):
        plant = larger(one.plant, names)
        wanted = np.asarray(angles_of(plant, plant.init_state(0.0, (0.0, 0.0)), wave()))
        assert np.ptp(wanted) > 0.05
        np.testing.assert_allclose(found[:, world], wanted, atol=TOLERANCE)


@pytest.mark.slow
@pytest.mark.parametrize("known", BRANCHING, indirect=True)
def test_laws_and_geometries_with_branches_give_the_torque_and_none_pushes(known, tmp_path):
    """The torque of the muscles of a joint is that in 64 bits; needs no MuJoCo Warp."""
    wp = pytest.importorskip("warp", reason="the extra warp is not installed")
    one = made(mk.JointPlant(known.joint, LOAD, mk.IdealValve()), "torque", tmp_path)
    model, count = mujoco.MjModel.from_xml_string(one.xml), len(known.angles)
    data = mujoco.MjData(model)
    lengths, arms = np.empty((2, count, 2))
    for row, angle in enumerate(known.angles):
        data.qpos[0] = angle
        mujoco.mj_forward(model, data)
        lengths[row], arms[row] = data.actuator_length, data.actuator_moment.ravel()
    names = "ctrl", "actuator_length", "actuator_velocity", "actuator_force", "act", "act_dot"
    arrays = (wp.array(each, dtype=float) for each in (known.pressures, lengths, *[np.zeros((count, 2))] * 4))
    d = SimpleNamespace(time=wp.zeros(count, dtype=float), **dict(zip(names, arrays, strict=True)))
    muscles = one.module.Muscles(model, worlds=count)
    muscles.act_dyn(None, d)
    muscles.act_bias(None, d)
    force = d.actuator_force.numpy()
    np.testing.assert_allclose(np.sum(force * arms, -1), known.torque, atol=2e-5 * np.abs(known.torque).max())
    signs = np.where(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, (1, -1), 1)  # there it is a torque
    assert np.all(force * signs <= 0)


@pytest.mark.slow
def test_worlds_have_delays_and_start_again_after_a_reset(knee, tmp_path):
    warp = pytest.importorskip("mujoco_warp", reason="the extra warp is not installed")
    rough = dataclasses.replace(knee.muscle1, friction=MaxwellSlip(12.0, 5e-4, viscous=30.0, elements=1))
    plant = mk.JointPlant(mk.AntagonisticJoint(knee.geometry, rough, rough), LOAD, LAGS, command_delay=PERIOD)
    one = made(plant, "delays", tmp_path)
    model = mujoco.MjModel.from_xml_string(one.xml)
    data = mujoco.MjData(model)
    muscles = one.module.Muscles(model, worlds=3)
    prompt, commands = dataclasses.replace(one.plant, command_delay=None), wave(60)
    angles = [np.asarray(angles_of(prompt, prompt.init_state(0.0, (0.0, 0.0)), late(commands, n))) for n in range(3)]
    for delays, periods in ((None, (1, 1, 1)), ((0.0, PERIOD, 2 * PERIOD), (0, 1, 2))):
        if delays is not None:
            muscles.set("command_delay", delays)
        found = angles_in_warp(model, data, [muscles], 3, commands)[:, :, 0]
        np.testing.assert_allclose(found, np.stack([angles[n] for n in periods], -1), atol=TOLERANCE)
    assert np.ptp(found[-1]) > 1e-3
    m, d = warp.put_model(model), warp.put_data(model, data, nworld=3)
    muscles.install(m)
    again = []
    for _ in range(2):
        for now in commands[:20]:
            d.ctrl.assign(np.tile(now, (3, 1)).astype(np.float32))
            for _ in range(round(PERIOD / STEP)):
                warp.step(m, d)
        again.append(d.qpos.numpy().copy())
        warp.reset_data(m, d)
    np.testing.assert_array_equal(*again)
    np.testing.assert_allclose(again[0][:, 0], found[19], atol=TOLERANCE)


def late(commands, periods):
    """Commands that arrive some periods later; the first is there from the start."""
    return np.concatenate([np.repeat(commands[:1], periods, axis=0), commands[: len(commands) - periods]])


def test_the_export_has_all_files_and_names_what_is_left_out(tmp_path):
    files = export(mk.Scenario.read("examples/pre-contracted-step-pid.yaml"), "warp", tmp_path)
    assert sorted(files.contents) == ["joint.xml", "joint_warp.py", "scenario.yaml"]
    assert len(files.left_out) == 1  # the controller
    tree = ast.parse((tmp_path / "joint_warp.py").read_text())
    names = {node.name for node in ast.walk(tree) if hasattr(node, "name")}
    assert {"force1", "rates2", "Muscles", "prepare"} <= names
    packages = {one.name for node in ast.walk(tree) if isinstance(node, ast.Import) for one in node.names}
    assert packages - sys.stdlib_module_names == {"numpy", "warp"}
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "joint.xml"))
    assert (model.nu, model.na) == (2, 2)


def test_delays_are_rounded_up_to_the_steps_of_the_model_in_the_same_arrays(knee, tmp_path):
    """Captured CUDA graphs hold the addresses of the arrays."""
    pytest.importorskip("warp", reason="the extra warp is not installed")
    one = made(mk.JointPlant(knee, LOAD, LAGS), "steps", tmp_path)
    model = mujoco.MjModel.from_xml_string(one.xml)
    model.opt.timestep = 2e-3
    muscles = one.module.Muscles(model, worlds=2)
    arrays = lambda: [one.ptr for one in (muscles.delay, muscles.sent, muscles.model.parameters)]  # noqa: E731
    before = arrays()
    muscles.set("command_delay", [7e-3, 8e-3])
    muscles.set("valve.time_constant", 0.03)
    assert muscles.delay.numpy().tolist() == [4, 4]
    assert arrays() == before


def test_mistakes_are_refused(knee, tmp_path, monkeypatch):
    pytest.importorskip("warp", reason="the extra warp is not installed")
    one = made(mk.JointPlant(knee, LOAD, LAGS), "refused", tmp_path)
    muscles = one.module.Muscles(mujoco.MjModel.from_xml_string(one.xml), worlds=2)
    muscles.set("valve.time_constant", [0.02, 0.04])
    assert muscles.get("valve.time_constant").tolist() == [0.02, 0.04]
    muscles.get("valve.time_constant")[:] = 1.0  # a copy
    assert muscles.get("valve.time_constant").tolist() == [0.02, 0.04]
    with pytest.raises(ValueError, match="finite"):
        muscles.set("valve.time_constant", np.nan)
    with pytest.raises(KeyError, match=r"valve\.time_constant"):
        muscles.set("valve.lag", 0.02)
    with pytest.raises(ValueError, match="command_delay"):
        muscles.set("command_delay", -1e-3)
    for version in ("3.10.0", "3.10rc1", "5.0.0"):
        monkeypatch.setattr(metadata, "version", lambda name, version=version: version)
        with pytest.raises(ImportError, match=r"3\.11.*5\.0"):
            muscles.install(SimpleNamespace())
