"""Environments: spaces, seeds, the reward, and the same motion as the plant's, single and vectorised."""

import functools
import warnings
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import CallError, ExportError, ParameterError
from mckibben.plant import PerfectSensors
from mckibben.robot import RobotScenario
from mckibben.scenario import with_values
from mckibben.study.compare.robots import RobotSuite
from mckibben.study.compare.suite import Suite
from mckibben.units import bar
from tests.robot.conftest import as_joint

gymnasium = pytest.importorskip("gymnasium", reason="the extra gym is not installed")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from mckibben.export.episodes import example_of, plants_of  # noqa: E402
from mckibben.export.gym import JointEnv, JointVectorEnv, RewardTerms  # noqa: E402

RANDOM = ("load.mass2=+-50 %", "reference.angle.amplitude=5..15 deg")
STEPS, REPEAT = 4, 5
REWARD = RewardTerms(stiffness_scale=3.0, air_price=0.1)
LEG = "examples/robot/lei-leg-control.yaml"
KNEE = "\ncontrollers: {knee: {class: decoupling, feedback: {bandwidth: 40 rad/s}}}\n"


@pytest.fixture(scope="module")
def scenario():
    """20 control periods of the example."""
    whole = mk.Scenario.read("examples/pre-contracted-step-pid.yaml")
    return whole.model_copy(update={"duration": STEPS * REPEAT * whole.control_period})


@pytest.fixture(scope="module")
def env(scenario):
    return JointEnv(scenario, random_plant=RANDOM, repeat=REPEAT, reward=REWARD, plants=8)


@pytest.fixture(scope="module")
def envs(scenario):
    return JointVectorEnv(scenario, 3, random_plant=RANDOM, repeat=REPEAT, reward=REWARD, plants=8)


def episode(env, **reset):
    """Observations, rewards and ends of an episode with actions from its own seed."""
    observation, info = env.reset(**reset)
    draw, rows = np.random.default_rng(1), [[*observation, 0.0, False, False]]
    while not (rows[-1][-1] or rows[-1][-2]):
        observation, reward, *ends, _ = env.step(draw.uniform(-1, 1, 2).astype(np.float32))
        rows.append([*observation, reward, *ends])
    return np.array(rows), info


@pytest.mark.slow
def test_it_passes_the_check_of_gymnasium_without_a_warning(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


@pytest.mark.slow
def test_spaces_have_units(env):
    assert len(env.metadata["observation_units"]) == env.observation_space.shape[0]
    assert env.metadata["observation_units"]["reference_stiffness"] == "N*m/rad"
    assert env.metadata["action_ranges"]["command2"] == (0.0, 8.0, "bar")
    assert env.metadata["step"] == pytest.approx(5e-3)


def test_the_same_seed_is_the_same_episode(env):
    first, info = episode(env, seed=3)
    again, _ = episode(env, seed=3)
    np.testing.assert_array_equal(first, again)
    assert len(first) == STEPS + 1
    assert first[-1, -1]  # truncated, not terminated
    assert not first[:, -2].any()
    others = {episode(env)[1]["plant"] for _ in range(8)}
    assert len(others | {info["plant"]}) > 3
    assert np.abs(episode(env, options={"plant": 0})[0] - episode(env, options={"plant": 1})[0]).max() > 1e-3


@eqx.filter_jit
def advanced(plant, state, commands, substeps):
    state = plant.advance(state, commands, 1e-3, substeps)
    return state, plant.joint.stiffness(state.angle, state.pressures)


@pytest.mark.slow
def test_it_moves_as_the_plant_does_and_the_reward_is_the_documented_one(scenario):
    env = JointEnv(scenario, reward=RewardTerms(stiffness_scale=3.0))
    observation, _ = env.reset(seed=0)
    plant, reference = scenario.plant(), scenario.reference()
    state = scenario.initial(plant)
    assert observation[:4] == pytest.approx([0, 0, *(float(one) / bar for one in state.pressures)], rel=1e-6)
    for period in range(1, 4):
        low, high, _ = env.metadata["action_ranges"]["command1"]
        action = np.array([-0.5, 0.25], np.float32)
        before = state
        commands = tuple((low + (high - low) * (action.astype(float) + 1) / 2) * bar)
        state, stiffness = advanced(plant, state, commands, scenario.needed_substeps())
        observation, reward, terminated, _, info = env.step(action)
        setpoint = [float(one) for one in reference(period * 1e-3)]
        wanted = [state.angle, (state.angle - before.angle) / 1e-3, *(one / bar for one in state.pressures), *setpoint]
        assert observation == pytest.approx(np.array(wanted, float), rel=1e-6, abs=1e-9)
        assert info["stiffness"] == pytest.approx(float(stiffness), rel=1e-9)
        cost = ((float(state.angle) - setpoint[0]) / np.radians(2)) ** 2
        cost += ((float(stiffness) - setpoint[1]) / 3.0) ** 2
        assert reward == pytest.approx(1 / (1 + cost), rel=1e-9)
        assert not terminated


def test_a_history_has_the_last_observations_and_the_actions_between_them(scenario, env):
    deep = JointEnv(scenario, random_plant=RANDOM, repeat=REPEAT, reward=REWARD, plants=8, history=3)
    draw, rows = np.random.default_rng(3), []
    start, now = env.reset(options={"plant": 2})[0], deep.reset(options={"plant": 2})[0]
    np.testing.assert_allclose(now, [*start, 0, 0, *start, 0, 0, *start], rtol=1e-6)
    for _ in range(3):
        action = draw.uniform(-1, 1, 2).astype(np.float32)
        rows.append((env.step(action)[0], action))
        now = deep.step(action)[0]
    (before2, _), (before1, action1), (latest, action) = rows
    np.testing.assert_allclose(now, [*latest, *action, *before1, *action1, *before2], rtol=1e-6, atol=1e-7)
    assert len(deep.metadata["observation_units"]) == deep.observation_space.shape[0] == 22
    assert deep.observation_space.contains(now)


@pytest.mark.slow
def test_a_suite_gives_its_conditions():
    suite = Suite.read("examples/comparison/knee.yaml")
    made = JointVectorEnv(suite, 2, plants=6, history=2, random_plant=["command_delay=0..3 ms"])
    plant = made.joint.plants.varying.plant
    for values in (plant.load.mass2, plant.valve.time_constant, plant.sensors.seed, plant.command_delay):
        assert len(np.unique(values)) == made.joint.plants.rows > 3
    observation, _ = made.reset(seed=0)
    assert made.observation_space.contains(observation)
    assert np.isfinite(made.step(made.action_space.sample())[1]).all()


def test_air_costs(env, scenario):
    free = JointEnv(scenario, random_plant=RANDOM, repeat=REPEAT, reward=REWARD._replace(air_price=0.0), plants=8)
    action = np.array([1.0, 1.0], np.float32)
    rewards, used = [], []
    for one in (env, free):
        one.reset(seed=0)
        _, reward, _, _, info = one.step(action)
        rewards.append(reward)
        used.append(info["air"])
    assert used[0] == used[1] > 0
    assert rewards[1] - rewards[0] == pytest.approx(0.1 * used[0] / 5e-3, rel=1e-9)


@pytest.mark.slow
def test_random_plants_are_within_their_ranges_and_belong_to_a_seed(env, envs, scenario):
    masses = np.asarray(env.joint.plants.varying.plant.load.mass2)
    assert masses.shape == (8,)
    assert 0.25 <= masses.min() < masses.max() <= 0.75
    np.testing.assert_array_equal(masses, envs.joint.plants.varying.plant.load.mass2)
    other = JointEnv(scenario, random_plant="load.mass2=+-50 %", repeat=REPEAT, plants=8, plants_seed=1)
    assert not np.any(np.isin(masses, other.joint.plants.varying.plant.load.mass2))


@pytest.mark.slow
def test_many_are_as_single_ones_and_begin_anew(env, envs):
    observations, info = envs.reset(seed=5)
    plants, draw, steps = info["plant"], np.random.default_rng(2), []
    for _ in range(STEPS):
        actions = draw.uniform(-1, 1, (3, 2)).astype(np.float32)
        steps.append((actions, envs.step(actions)))
    for lane, plant in enumerate(plants):
        alone, _ = env.reset(options={"plant": int(plant)})
        np.testing.assert_allclose(observations[lane], alone, rtol=1e-6, atol=1e-7)
        for actions, (observation, reward, terminated, truncated, told) in steps:
            found = env.step(actions[lane])
            np.testing.assert_allclose(observation[lane], found[0], rtol=1e-6, atol=1e-7)
            assert reward[lane] == pytest.approx(found[1], rel=1e-9)
            assert (terminated[lane], truncated[lane]) == found[2:4]
            assert told["stiffness"][lane] == pytest.approx(found[4]["stiffness"], rel=1e-9)
    assert truncated.all()
    observation, reward, terminated, truncated, info = envs.step(actions)
    assert not (terminated | truncated | reward.astype(bool)).any()
    for lane, plant in enumerate(info["plant"]):
        np.testing.assert_allclose(observation[lane], env.reset(options={"plant": int(plant)})[0], rtol=1e-6, atol=1e-7)
    assert envs.observation_space.contains(observation)


@pytest.mark.slow
def test_an_episode_that_swings_over_ends_without_reward(scenario):
    env = JointEnv(with_values(scenario, {"reference.angle.offset": np.radians(95)}))
    env.reset(seed=0)
    _, reward, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
    assert (reward, terminated, truncated) == (0.0, True, False)


@pytest.fixture(scope="module")
def knee():
    """A robot of one joint with noise and delay."""
    return RobotScenario.parse(Path("tests/robot/one-joint.yaml").read_text(encoding="utf-8") + KNEE)


@pytest.mark.slow
def test_a_robot_of_one_joint_is_the_joint(knee):
    robot, alone = (JointEnv(scenario, reward=REWARD, history=2, repeat=REPEAT) for scenario in (knee, as_joint(knee)))
    now = ["angle.knee", "velocity.knee", "pressure.knee1", "pressure.knee2"]
    now += ["reference_angle.knee", "reference_stiffness.knee"]
    assert list(robot.metadata["observation_units"])[:8] == [*now, "action.knee1_before1", "action.knee2_before1"]
    assert [*robot.metadata["action_ranges"].values()] == [*alone.metadata["action_ranges"].values()]
    assert robot.observation_space == alone.observation_space
    np.testing.assert_allclose(robot.reset(seed=0)[0], alone.reset(seed=0)[0], rtol=1e-6)
    draw, over = np.random.default_rng(0), False
    while not over:
        action = draw.uniform(-0.4, 0.4, 2).astype(np.float32)  # within the stops, which a joint lacks
        (observation, reward, *ends, info), own = robot.step(action), alone.step(action)
        np.testing.assert_allclose(observation, own[0], rtol=1e-6)
        assert (reward, info["air"]) == pytest.approx((own[1], own[4]["air"]), rel=1e-9)
        np.testing.assert_allclose(info["stiffness"], [own[4]["stiffness"]], rtol=1e-9)
        assert tuple(ends) == own[2:4]
        over = any(ends)
    check_env(robot, skip_render_check=True)


@pytest.mark.slow
def test_joints_of_a_robot_share_the_reward_and_one_of_them_ends_the_episode():
    whole = RobotScenario.read(LEG)
    start = whole.start.model_copy(update={"angles": dict.fromkeys(whole.joint_names, 0.0)})
    leg = whole.model_copy(update={"duration": 0.2, "substeps": 4, "sensors": PerfectSensors(), "start": start})
    random = ["robot.bodies.1.mass=+-20 %", "reference.hip.angle.offset=0 deg, 95 deg"]
    envs = JointVectorEnv(leg, 64, random_plant=random, plants=16, reward=REWARD)
    assert len(np.unique(envs.joint.plants.varying.plant.robot.bodies[1].mass)) == 16
    first, info = envs.reset(seed=0)
    assert first.shape == (64, 18)
    actions = np.random.default_rng(0).uniform(-1, 1, (64, 6)).astype(np.float32)
    observation, reward, terminated, _, told = envs.step(actions)
    assert envs.observation_space.contains(observation)
    names = list(envs.metadata["observation_units"])
    angle, wanted, stiffness = (
        observation[:, [names.index(f"{quantity}.{joint}") for joint in leg.joint_names]].astype(float)
        for quantity in ("angle", "reference_angle", "reference_stiffness")
    )
    far = np.radians(95) == np.asarray(envs.joint.plants.varying.reference[1].angle.offset)[info["plant"]]
    np.testing.assert_array_equal(terminated, far)
    assert 0 < far.sum() < 64
    fit = 1 / (1 + ((angle - wanted) / np.radians(2)) ** 2 + ((told["stiffness"] - stiffness) / 3.0) ** 2)
    shared = fit.mean(axis=1) - 0.1 * told["air"] / 3 / leg.control_period
    np.testing.assert_allclose(reward, np.where(far, 0, shared), rtol=1e-5)
    after, reward, terminated, _, info = envs.step(actions)
    assert not (reward[far].any() or terminated[far].any())
    np.testing.assert_allclose(after[far][:, :6], 0, atol=1e-9)


def test_a_suite_of_a_robot_gives_its_conditions(knee):
    suite = RobotSuite(name="knee", scenario=knee, conditions=("robot.bodies.1.mass=+-20 %",))
    example, varied = example_of(suite, "command_delay=0..3 ms")
    assert isinstance(example, RobotScenario)
    assert [text.partition("=")[0] for text in varied] == ["robot.bodies.1.mass", "sensors.seed", "command_delay"]


def test_a_robot_without_references_is_refused():
    with pytest.raises(ExportError) as caught:
        JointVectorEnv("examples/robot/lei-leg.yaml", 2)
    assert caught.value.field == "reference"
    assert caught.value.remedy


@pytest.mark.parametrize(("masses", "rows"), [("80..90 kg", 0), ("1..80 kg", 4)])
@pytest.mark.slow
def test_robots_without_a_start_are_left_out(knee, masses, rows):
    start = knee.start.model_copy(update={"angles": {"knee": np.radians(15)}})
    leaning = knee.model_copy(update={"start": start})
    plants = functools.partial(plants_of, leaning, [f"robot.bodies.1.mass={masses}"], 16, 0)
    if rows:
        assert plants().rows == rows
    else:
        with pytest.raises(ExportError) as caught:
            plants()
        assert caught.value.field == "start"


@pytest.mark.slow
def test_gymnasium_makes_both_by_their_id():
    scenario = "examples/pre-contracted-step-pid.yaml"
    name = "mckibben.export.gym:mckibben/Joint-v0"
    made = gymnasium.make(name, scenario=scenario)
    assert isinstance(made.unwrapped, JointEnv)
    many = gymnasium.make_vec(name, num_envs=2, vectorization_mode="vector_entry_point", scenario=scenario)
    assert isinstance(many.unwrapped, JointVectorEnv)


def test_mistakes_are_refused(scenario):
    with pytest.raises(ParameterError):
        JointEnv(scenario, random_plant=["load.mass3=+-50 %"])
    with pytest.raises(ExportError) as caught:
        JointEnv(scenario, repeat=0)
    assert caught.value.field == "repeat"
    with pytest.raises(ExportError) as caught:
        JointEnv(scenario, history=101)
    assert caught.value.field == "history"
    with pytest.raises(ExportError) as caught:
        JointEnv(scenario, random_plant=["controller.position.kp=+-50 %"])
    assert caught.value.field == "random_plant"
    with pytest.raises(CallError, match="'history'"):
        JointEnv(scenario, histori=2)
    own = mk.Scenario.read("examples/your-muscle/joint.yaml")
    with pytest.raises(ExportError) as caught:
        JointEnv(own, reward=RewardTerms(air_price=1.0))
    assert caught.value.field == "air_price"
