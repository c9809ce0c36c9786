"""Training of both pressures of a joint in mjlab, for an angle and a stiffness, and test on our plant with real valves.

    pip install mjlab 'mckibben[gym]'
    python examples/reinforcement/in_mjlab.py [--steps 3e6] [--seed 0]

In mjlab, on the CPU device, each of 2048 worlds has a joint of `joint.yaml` with VPPE-6 regulators of different lag and
supply, a delay of 0 to 8 ms, muscles of different strength, and a force law drawn from the uncertainty of the fit. The
policy sets both pressures every 5 ms from the last four observations. It is then measured on the plant of `joint.yaml`,
in 64 bits with encoder and noise; masses vary, too. The PID acts every 1 ms, with the gains that are best on 256 other
plants of this kind.
"""

import argparse
import math
from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np
import torch
from judge import LANES, TRAINING, compare
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.observation_manager import ObservationGroupCfg, ObservationTermCfg
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.managers.termination_manager import TerminationTermCfg
from mjlab.rl import MjlabOnPolicyRunner, RslRlModelCfg, RslRlOnPolicyRunnerCfg, RslRlVecEnvWrapper
from mjlab.scene import SceneCfg
from mjlab.sim import MujocoCfg, SimulationCfg

from mckibben.export.episodes import plants_of
from mckibben.export.gym import JointVectorEnv
from mckibben.export.mjlab import muscle_entity
from mckibben.scenario import Scenario
from mckibben.units import bar, deg, ms

REAL = Scenario.read("examples/reinforcement/joint.yaml")
MUSCLES = ["joint.muscle.law=fit", "joint.muscle1.strength=+-10 %", "joint.muscle2.strength=+-10 %"]
IN_MJLAB = [*MUSCLES, "valve.time_constant=20..40 ms", "valve.supply=6.5..7.5 bar", "command_delay=0..8 ms"]
GOALS = ["reference.angle.after=-15..15 deg", "reference.stiffness.after=16..24 N*m/rad"]
ON_PLANT = [
    *MUSCLES,
    *GOALS,
    "load.mass=+-20 %",
    "valve.supply=6.5..7.5 bar",
    "command_delay=0..8 ms",
    "sensors.seed=0..9999",
]
WORLDS, STEPS, REPEAT, HISTORY = 2048, 16, 5, 4
HIGHEST = float(REAL.plant().joint.muscle1.specimen.domain.pressure_max)  # Pa


def features(angle, velocity, first, second, goal_angle, goal_stiffness):
    """Observations at the scale of a network: rad, rad/s, bar, bar, rad, N*m/rad."""
    return (
        angle / 0.2,
        velocity / 2,
        (first - 3) / 2,
        (second - 3) / 2,
        (goal_angle - angle) / 0.05,
        (goal_stiffness - 20) / 4,
    )


def joints(lanes, seed, repeat=REPEAT, history=HISTORY + 1):
    """Environments of our plant with real valves."""
    return JointVectorEnv(
        REAL, lanes, random_plant=ON_PLANT, repeat=repeat, history=history, plants=LANES, plants_seed=seed
    )


def seen(env):
    """Observation of all worlds in mjlab, with the noise of the sensors, and the last action."""
    joint, noise = env.scene["joint"], torch.randn(env.num_envs, 4)
    measured = torch.cat([joint.data.joint_pos, joint.data.joint_vel, joint.actuators[0].pressures() / bar], 1)
    measured += noise * torch.tensor([0.01 * deg, 0.15, 0.04, 0.04])
    goal = getattr(env, "goal", torch.zeros(env.num_envs, 2))
    return torch.cat([torch.stack(features(*measured.T, *goal.T), 1), env.action_manager.action.clip(-1, 1)], 1)


def new_goal(env, env_ids):
    """Goals of worlds that begin."""
    env.goal = getattr(env, "goal", torch.zeros(env.num_envs, 2))
    low, high = torch.tensor([-15 * deg, 16.0]), torch.tensor([15 * deg, 24.0])
    env.goal[env_ids] = low + (high - low) * torch.rand(env.num_envs, 2)[env_ids]


class Closeness:
    """Reward: 1 / (1 + errors of angle [deg] and stiffness [N*m/rad]), of the drawn joint in each world."""

    def __init__(self, cfg, env):
        plants = plants_of(REAL, IN_MJLAB, LANES, TRAINING)
        rows = np.arange(WORLDS) % plants.rows
        varying, starts = jax.tree.map(jnp.asarray, (plants.varying, plants.starts))
        plants = plants._replace(varying=varying, starts=starts)

        def stiffness(row, angle, pressures):
            return plants.row(row)[0].plant.joint.evaluate(angle, pressures)[1]

        self.stiffness = jax.jit(lambda *state: jax.vmap(stiffness)(rows, *state))

    def __call__(self, env):
        joint = env.scene["joint"]
        angle, pressures = joint.data.joint_pos[:, 0], joint.actuators[0].pressures().numpy().astype(float)
        stiffness = self.stiffness(angle.numpy().astype(float), (pressures[:, 0], pressures[:, 1]))
        errors = (angle - env.goal[:, 0]) / deg, torch.as_tensor(np.array(stiffness)) - env.goal[:, 1]
        return (1 / (1 + errors[0].abs() + errors[1].abs())).float()


def environment(seed):
    """The joint in mjlab."""
    entity = muscle_entity(REAL, IN_MJLAB, plants=LANES, seed=TRAINING)
    terms = ObservationGroupCfg({"seen": ObservationTermCfg(func=seen, history_length=HISTORY)})
    action = mdp.actions.TendonEffortActionCfg(
        entity_name="joint", actuator_names=("muscle1", "muscle2"), scale=HIGHEST / 2, offset=HIGHEST / 2
    )
    return ManagerBasedRlEnv(
        ManagerBasedRlEnvCfg(
            scene=SceneCfg(num_envs=WORLDS, entities={"joint": entity}),
            sim=SimulationCfg(mujoco=MujocoCfg(timestep=1.25 * ms, integrator="euler", disableflags=("contact",))),
            decimation=4,
            episode_length_s=REAL.duration,
            scale_rewards_by_dt=False,
            observations={"actor": terms, "critic": terms},
            actions={"pressures": action},
            events={
                "start": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset"),
                "goal": EventTermCfg(func=new_goal, mode="reset"),
            },
            rewards={
                "closeness": RewardTermCfg(func=Closeness, weight=1.0),
                "changes": RewardTermCfg(func=mdp.action_rate_l2, weight=-0.2),  # they cost air
            },
            terminations={"end": TerminationTermCfg(func=mdp.time_out, time_out=True)},
            seed=seed,
        ),
        device="cpu",
    )


def trained(env, updates, steps, gamma, seed):
    """Runner after updates by PPO, each from some steps in every world."""
    torch.set_num_threads(1)  # the network is small
    env = RslRlVecEnvWrapper(env, clip_actions=1.0)
    network = {"hidden_dims": (64, 64), "activation": "elu"}
    spread = {"class_name": "GaussianDistribution", "init_std": 0.2, "std_type": "scalar"}
    settings = RslRlOnPolicyRunnerCfg(
        actor=RslRlModelCfg(**network, distribution_cfg=spread),
        critic=RslRlModelCfg(**network),
        num_steps_per_env=steps,
        seed=seed,
        logger="tensorboard",
        upload_model=False,
    )
    settings.algorithm.gamma, settings.algorithm.entropy_coef, settings.algorithm.num_mini_batches = gamma, 0.0, 8
    runner = MjlabOnPolicyRunner(env, asdict(settings), None, "cpu")
    runner.learn(updates, init_at_random_ep_len=True)
    return runner


def main():
    """Train, and print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--steps", type=float, default=3e6, help="of training, over all worlds")
    options.add_argument("--seed", type=int, default=0, help="of training")
    asked = options.parse_args()
    updates = math.ceil(asked.steps / (WORLDS * STEPS))
    runner = trained(environment(asked.seed), updates, STEPS, 0.98, asked.seed)
    act = runner.get_inference_policy("cpu")

    def policy(observation):
        rows = np.pad(observation, ((0, 0), (0, 2))).reshape(len(observation), -1, 8)[:, :HISTORY][:, ::-1]
        given = np.stack([*features(*np.moveaxis(rows[..., :6], -1, 0)), rows[..., 6], rows[..., 7]], -1)
        given = torch.as_tensor(given.reshape(len(rows), -1), dtype=torch.float)
        with torch.inference_mode():
            return act({"actor": given}).clip(-1, 1).numpy()

    compare(joints, f"PPO in mjlab, {updates * WORLDS * STEPS / 1e6:.1f} million steps", policy)


if __name__ == "__main__":
    main()
