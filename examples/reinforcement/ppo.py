"""Proximal policy optimisation (Stable-Baselines3) of both pressures of a knee, against its PID on unseen plants.

    pip install 'mckibben[gym]' stable-baselines3
    python examples/reinforcement/ppo.py [--minutes 8]

Plants, disturbances and the reference (a sine of the angle, a step of the stiffness) are drawn from the conditions of
`examples/comparison/knee.yaml`, 256 plants for training and 256 others for the table. The policy sets both pressures
every 5 ms from the last four observations, the PID every 1 ms. The gains of the PID are scaled by factors: those with
the least error of the angle on the training plants, and those with the least error among those with no more air than
the policy. Both are measured by the same environment.
"""

import argparse
import time

import numpy as np
import torch
from judge import LANES, TRAINING, compare
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from mckibben.export.gym import JointVectorEnv, RewardTerms
from mckibben.study.compare.suite import Suite
from mckibben.units import deg

SUITE = Suite.read("examples/comparison/knee.yaml")
REPEAT, HISTORY = 5, 4
REWARD = RewardTerms(angle_scale=1 * deg, stiffness_scale=1.0, air_price=0.1)
FAILURE = 10.0  # cost of a failed run, as much as ten steps can earn


def joints(lanes, seed, repeat=REPEAT, history=HISTORY):
    """Environments with the plants of a seed."""
    return JointVectorEnv(SUITE, lanes, repeat=repeat, history=history, reward=REWARD, plants=LANES, plants_seed=seed)


def features(observation):
    """Observations at the scale of a network, with the error of the angle in place of its reference."""
    rows = np.pad(observation, ((0, 0), (0, 2))).reshape(len(observation), HISTORY, 8)
    angle, velocity, first, second, reference, stiffness, *actions = np.moveaxis(rows, -1, 0)
    scaled = [angle / 0.2, velocity / 2, (first - 3) / 2, (second - 3) / 2, (reference - angle) / 0.03]
    return np.stack([*scaled, (stiffness - 15) / 2, *actions], -1).reshape(len(observation), -1).astype(np.float32)


class Joints(VecEnv):
    """The environments as Stable-Baselines3 takes them: an episode is done when its plant is replaced.

    A failed run terminates, and costs; the end of the scenario truncates.
    """

    def __init__(self, envs):
        from gymnasium.spaces import Box

        self.envs = envs
        space = Box(-np.inf, np.inf, (8 * HISTORY,), np.float32)
        super().__init__(envs.num_envs, space, envs.single_action_space)

    def reset(self):
        self.failed = self.ended = np.zeros(self.num_envs, bool)
        self.last = features(self.envs.reset(seed=0)[0])
        return self.last

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        observation, reward, failed, ended, _ = self.envs.step(self.actions)
        done, truncated, before = self.failed | self.ended, self.ended & ~self.failed, self.last
        self.failed, self.ended, self.last = failed, ended, features(observation)
        infos = [{"terminal_observation": before[lane], "TimeLimit.truncated": bool(truncated[lane])} if one else {}
                 for lane, one in enumerate(done)]  # fmt: skip
        return self.last, np.where(failed, -FAILURE, reward).astype(np.float32), done, infos

    def close(self):
        pass

    def get_attr(self, name, indices=None):
        return [getattr(self, name, None)] * self.num_envs

    def set_attr(self, name, value, indices=None):
        raise NotImplementedError

    def env_method(self, name, *args, indices=None, **options):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper, indices=None):
        return [False] * self.num_envs


class Clock(BaseCallback):
    """Ends the training after a time [s]."""

    def __init__(self, seconds):
        super().__init__()
        self.until = time.monotonic() + seconds

    def _on_step(self):
        return time.monotonic() < self.until


def main():
    """Train, and print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--minutes", type=float, default=8.0, help="of training")
    minutes = options.parse_args().minutes
    torch.set_num_threads(1)  # the network is small
    model = PPO("MlpPolicy", Joints(joints(128, TRAINING)), n_steps=100, batch_size=3200, n_epochs=8, gamma=0.98,
                learning_rate=1e-3, policy_kwargs={"log_std_init": -2.0}, seed=0, device="cpu")  # fmt: skip
    model.learn(10**9, callback=Clock(60 * minutes))
    policy = lambda one: model.predict(features(one), deterministic=True)[0]  # noqa: E731
    compare(joints, f"PPO, {model.num_timesteps / 1e6:.1f} million steps", policy)


if __name__ == "__main__":
    main()
