"""Muscles as an actuator of mjlab, on a GPU if there is one, against the plant in 64 bits (another environment)."""

import dataclasses
import re
from pathlib import Path
from runpy import run_path

import equinox as eqx
import jax
import mujoco
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import ExportError
from mckibben.export.episodes import plants_of
from mckibben.export.warp import split_parameters, warp_files
from mckibben.leg import LegScenario, LegStart
from mckibben.numerics.batching import with_leaves

SCENARIO = "examples/pre-contracted-step-pid.yaml"
VARIED = ["valve.time_constant=10..50 ms", "joint.muscle.strength=+-10 %", "command_delay=3 ms", "load.mass2=+-1 %"]
PERIOD, PERIODS, DELAY, WORLDS, SEED = 1e-3, 1000, 3, 3, 4
TOLERANCE = 1e-5  # rad


def test_drawn_parameters_are_those_of_the_environments(tmp_path):
    scenario = mk.Scenario.read(SCENARIO)
    known = {"valve.time_constant", "joint.muscle1.strength", "joint.muscle2.strength"}
    plants = plants_of(scenario, VARIED, WORLDS, SEED)
    found, others = split_parameters(plants.varying, dict.fromkeys(known))
    assert set(found) == known | {"command_delay"}
    assert others == ["load.mass2"]
    for row in range(plants.rows):
        plant = plants.row(row)[0].plant
        assert found["valve.time_constant"][row] == plant.valve.time_constant
        assert found["joint.muscle1.strength"][row] == plant.joint.muscle1.strength
    assert np.ptp(found["valve.time_constant"]) > 1e-3
    names = warp_files(scenario, "joint", tmp_path).files["joint_warp.py"]
    assert all(f"'{name}'" in names for name in known)


def simulated(entity, commands, again=(), **others):
    """Angles of all joints after each control period; the worlds `again` are reset after 20 periods and begin anew.

    Other entities in the scene are without pressure.
    """
    torch = pytest.importorskip("torch")
    from mjlab.scene import Scene, SceneCfg
    from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

    device = "cuda:0" if torch.cuda.is_available() else "cpu"
    scene = Scene(SceneCfg(num_envs=WORLDS, entities={"knee": entity, **others}), device=device)
    config = SimulationCfg(mujoco=MujocoCfg(timestep=PERIOD))
    sim = Simulation(num_envs=WORLDS, cfg=config, model=scene.compile(), device=device)
    sim.wp_model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    scene.initialize(sim.mj_model, sim.model, sim.data)
    sim.create_graph()
    knee, found = scene["knee"], []

    def reset(worlds):
        sim.reset(worlds)
        scene.reset(worlds)
        start = knee.data.default_joint_pos, knee.data.default_joint_vel
        knee.write_joint_state_to_sim(*(one if worlds is None else one[worlds] for one in start), env_ids=worlds)

    reset(None)
    period = torch.zeros(WORLDS, dtype=torch.long, device=device)
    for now in range(len(commands)):
        if now == 20 and again:
            reset(torch.tensor(again, device=device))
            period[list(again)] = 0
        sim.forward()  # as the environment does for its observations
        knee.set_tendon_effort_target(torch.tensor(commands, dtype=torch.float, device=device)[period])
        scene.write_data_to_sim()
        sim.step()
        scene.update(PERIOD)
        period += 1
        found.append(knee.data.joint_pos.cpu().numpy().copy())
    return np.array(found)


@eqx.filter_jit
def wanted(plant, state, commands):
    """Angles of a plant without delay after each control period."""

    def period(state, commands):
        state = plant.advance(state, tuple(commands), PERIOD, 1)
        return state, state.angle if hasattr(state, "angle") else jax.numpy.stack(state.posture.angles)

    return jax.lax.scan(period, state, commands)[1]


@pytest.mark.slow
def test_a_second_in_mjlab_agrees_in_every_world_after_a_reset_and_next_to_another_joint():
    pytest.importorskip("mjlab", reason="mjlab is not installed")
    from mckibben.export.mjlab import muscle_entity

    varied = VARIED[:-1]
    entity = muscle_entity(SCENARIO, varied, plants=WORLDS, seed=SEED)
    scenario = mk.Scenario.read(SCENARIO)
    plants = plants_of(scenario, varied, WORLDS, SEED)
    swing = 5e4 * np.sin(12 * PERIOD * np.arange(PERIODS))
    commands = np.stack([2.5e5 + swing, 3e5 - swing], -1)
    late = np.concatenate([np.repeat(commands[:1], DELAY, axis=0), commands[:-DELAY]])
    start, angles = scenario.initial(scenario.plant()), []
    for row in range(WORLDS):
        plant = dataclasses.replace(plants.row(row % plants.rows)[0].plant, command_delay=None)
        angles.append(np.asarray(wanted(plant, plant.complete_state(start), late)))
    angles = np.stack(angles, -1)
    assert np.min(np.ptp(angles, axis=0)) > 0.05
    assert np.max(np.abs(angles[:, 0] - angles[:, 1])) > 1e-3
    np.testing.assert_allclose(simulated(entity, commands)[..., 0], angles, atol=TOLERANCE)
    other = muscle_entity("examples/own-joint.yaml")
    found = simulated(entity, commands[:60], again=(1,), other=other)[..., 0]
    np.testing.assert_allclose(found[20:, 1], angles[:40, 1], atol=TOLERANCE)
    np.testing.assert_allclose(found[:, 0], angles[:60, 0], atol=TOLERANCE)


@pytest.mark.slow
def test_a_second_of_an_arm_with_two_joints_agrees_in_every_world():
    pytest.importorskip("mjlab", reason="mjlab is not installed")
    from mckibben.export.mjlab import leg_entity

    plant = LegScenario.read("examples/reinforcement/arm.yaml").plant()
    varied = {
        "valve.time_constant": np.linspace(0.02, 0.04, WORLDS),
        "leg.joints.1.muscles.muscle2.law.a1": np.linspace(-440.0, -420.0, WORLDS),
        "command_delay": np.full(WORLDS, DELAY * PERIOD),
        "leg.links.1.mass": np.full(WORLDS, 0.7),
    }
    plants = with_leaves({"plant": plant}, varied)["plant"]
    start = LegStart((0.05, -0.05), (3.3e5,) * 4, clearance=0.5)
    entity = leg_entity(plants, start)
    (actuator,) = entity.articulation.actuators
    assert set(actuator.parameters) == set(varied) - {"leg.links.1.mass"}
    assert "variation of leg.links.1.mass" in actuator.left_out
    commands = 3.3e5 + 5e4 * np.sin(12 * PERIOD * np.arange(PERIODS)[:, None] + np.arange(4))
    late = np.concatenate([np.repeat(commands[:1], DELAY, axis=0), commands[:-DELAY]])
    angles = []
    for row in range(WORLDS):
        one = with_leaves({"plant": plant}, {name: values[row] for name, values in varied.items()})["plant"]
        one = dataclasses.replace(one, command_delay=None)
        angles.append(np.asarray(wanted(one, one.begin(start), late)))
    angles = np.stack(angles, 1)
    assert np.min(np.ptp(angles, axis=0)) > 0.03
    assert np.max(np.abs(angles[:, 0] - angles[:, 1])) > 1e-3
    np.testing.assert_allclose(simulated(entity, commands), angles, atol=TOLERANCE)


@pytest.mark.slow
def test_the_joint_of_the_example_observes_its_pressures_and_is_rewarded_at_its_goal(monkeypatch):
    torch = pytest.importorskip("torch")
    pytest.importorskip("mjlab", reason="mjlab is not installed")
    monkeypatch.syspath_prepend("examples/reinforcement")  # for judge.py
    example = run_path("examples/reinforcement/in_mjlab.py")
    env = example["environment"](0)
    env.reset()
    for _ in range(60):
        seen = env.step(torch.tensor([[-0.2, 0.1]]).repeat(env.num_envs, 1))[0]["actor"]
    joint, closeness = env.scene["joint"], env.reward_manager.get_term_cfg("closeness").func
    pressures = joint.actuators[0].pressures()
    assert torch.allclose(seen[:, -6:-4] * 2 + 3, pressures / 1e5, atol=0.3)
    angle = joint.data.joint_pos[:, 0].numpy().astype(float)
    stiffness = closeness.stiffness(angle, tuple(pressures.numpy().astype(float).T))
    env.goal[:] = torch.stack([joint.data.joint_pos[:, 0], torch.as_tensor(np.array(stiffness))], 1)
    assert torch.allclose(closeness(env), torch.ones(env.num_envs))


@pytest.mark.slow
def test_the_arm_of_the_example_observes_its_pressures_and_moves_towards_its_goal(monkeypatch):
    torch = pytest.importorskip("torch")
    pytest.importorskip("mjlab", reason="mjlab is not installed")
    monkeypatch.syspath_prepend("examples/reinforcement")
    example = run_path("examples/reinforcement/reach_in_mjlab.py")
    env = example["environment"](seed=0, worlds=2)
    env.reset()
    env.goal[:] = torch.tensor(example["hand_of"](0.2, 0.0)).reshape(2, 1)  # the shoulder forwards
    near = [example["closeness"](env)]
    for _ in range(60):
        seen = env.step(torch.zeros(2, 4))[0]["actor"]
        near.append(example["closeness"](env))
    assert torch.all(near[-1] > near[0])
    pressures = env.scene["arm"].actuators[0].pressures()
    assert seen.shape == (2, example["HISTORY"] * 16)
    assert torch.allclose(seen[:, -12:-8] * 2 + 3, pressures / 1e5, atol=0.3)
    assert torch.all(pressures[:, 1] > pressures[:, 0] + 5e4)


@pytest.mark.slow
def test_the_example_of_the_documentation_runs():
    pytest.importorskip("mjlab", reason="mjlab is not installed")
    page = Path("docs/export-simulators.md").read_text()
    (example,) = re.findall(r"## mjlab\n.*?```py\n(.*?)```", page, re.DOTALL)
    names = {}
    exec(example, names)
    angles = names["knee"].data.joint_pos[:, 0].numpy()
    assert np.all(angles > 0.1)
    assert np.ptp(angles) > 0.01


def test_joints_without_tendons_are_refused(tmp_path):
    pytest.importorskip("mjlab", reason="mjlab is not installed")
    from mckibben.export.mjlab import muscle_entity

    text = Path("examples/own-joint.yaml").read_text()
    path = tmp_path / "cam.yaml"
    path.write_text(text.replace("{class: Pulley, radius: 30 mm,", "{class: Cam, arm: 30 mm,"))
    with pytest.raises(ExportError) as caught:
        muscle_entity(path)
    assert caught.value.field == "geometry"
    actuator = muscle_entity(SCENARIO, ["load.mass2=+-50 %"], plants=4).articulation.actuators[0]
    assert not actuator.parameters
    assert len(actuator.left_out) == 2  # the controller, and the mass
