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
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from mckibben.control import Setpoint
from mckibben.export.gym import JointVectorEnv, RewardTerms
from mckibben.joint import Measurement
from mckibben.numerics.compiled import numeric
from mckibben.study.benchmark.suite import Suite
from mckibben.units import bar, deg

SUITE = Suite.read("examples/comparison/knee.yaml")
REPEAT, HISTORY, LANES = 5, 4, 256
REWARD = RewardTerms(angle_scale=1 * deg, stiffness_scale=1.0, air_price=0.1)
FAILURE = 10.0  # cost of a failed run, as much as ten steps can earn
TRAINING, UNSEEN = 0, 1  # seeds of the plants
FACTORS = np.array(list(product((1.0, 4.0, 16.0, 64.0), (0.25, 0.5, 1.0, 2.0), (0.3, 1.0, 3.0, 10.0))))
"""Factors of the PID: integral gain and other gains of the angle, gains of the stiffness."""


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


def measured(envs, act):
    """Errors of angle [deg] and stiffness [N*m/rad], root mean square, and air [L] of each joint over an episode.

    The error of the angle is infinite if it exceeded 90 deg.
    """
    observation, _ = envs.reset(seed=7)
    errors, air, lost = [], np.zeros(envs.num_envs), np.zeros(envs.num_envs, bool)
    for _ in range(envs.joint.most_steps):
        observation, _, failed, _, info = envs.step(act(observation))
        errors.append([observation[:, 0] - observation[:, 4], info["stiffness"] - observation[:, 5]])
        air += info["air"]
        lost |= failed
    angle, stiffness = np.sqrt(np.mean(np.square(errors), axis=0))
    return np.where(lost, np.inf, angle / deg), stiffness, air


def pid_actions(envs, factors):
    """A PID in each environment, with its gains scaled by factors of shape (lanes, 3)."""
    scenario = envs.joint.scenario
    nominal, period = numeric(scenario.control().with_period(scenario.control_period)), scenario.control_period
    low, high = (envs.joint.settings.low, envs.joint.settings.high)

    def seen(one):
        return Measurement(one[0], (one[2] * bar, one[3] * bar))

    def step(factor, state, one):
        gains = lambda it: (it.position.ki, it.position.kp, it.position.kd, it.stiffness.kp, it.stiffness.ki)  # noqa: E731
        integral, others, stiffness = factor
        scales = integral * others, others, others, stiffness, stiffness
        controller = eqx.tree_at(gains, nominal, [a * b for a, b in zip(gains(nominal), scales, strict=True)])
        state, commands = controller.step(state, Setpoint(one[4], one[5]), seen(one), period)
        return state, 2 * (jnp.stack(commands) - low) / (high - low) - 1

    begin, go_on = jax.jit(jax.vmap(lambda one: nominal.init(seen(one)))), jax.jit(jax.vmap(step))
    state = None

    def act(observation):
        nonlocal state
        now = observation.astype(float)
        state = begin(now) if state is None else state
        state, actions = go_on(factors, state, now)
        return np.clip(np.asarray(actions), -1, 1)

    return act


def best_pid(air):
    """Factors with the least error of the angle on training plants, of all and of those with no more air [L]."""
    each = LANES // 8
    envs = joints(len(FACTORS) * each, TRAINING, repeat=1, history=1)
    found = measured(envs, pid_actions(envs, np.repeat(FACTORS, each, axis=0)))
    angle, stiffness, used = (np.median(one.reshape(-1, each), axis=1) for one in found)
    fair = stiffness <= 1.0
    return [FACTORS[np.argmin(np.where(fair & (used <= most), angle, np.inf))] for most in (np.inf, air)]


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
    air = np.median(measured(joints(LANES, TRAINING), policy)[2])
    rows = {f"PPO, {model.num_timesteps / 1e6:.1f} million steps": measured(joints(LANES, UNSEEN), policy)}
    for name, factors in zip(("PID", "PID at equal air"), best_pid(air), strict=True):
        envs = joints(LANES, UNSEEN, repeat=1, history=1)
        rows[f"{name}, factors {factors}"] = measured(envs, pid_actions(envs, np.tile(factors, (LANES, 1))))
    print("| | angle, deg | stiffness, N*m/rad | air, L |\n|---|---|---|---|")
    for name, row in rows.items():
        print(f"| {name} | " + " | ".join(f"{np.median(one):.3g} ({np.quantile(one, 0.9):.3g})" for one in row) + " |")


if __name__ == "__main__":
    main()
