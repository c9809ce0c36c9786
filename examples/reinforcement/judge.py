"""Comparison of a policy with a PID whose gains are scaled by factors, in the same environments."""

from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mckibben.control import Setpoint
from mckibben.joint import Measurement
from mckibben.numerics.compiled import numeric
from mckibben.units import bar, deg

TRAINING, UNSEEN = 0, 1  # seeds of the plants
FACTORS = np.array(list(product((1.0, 4.0, 16.0, 64.0), (0.25, 0.5, 1.0, 2.0), (0.3, 1.0, 3.0, 10.0))))
"""Factors of the PID: integral gain and other gains of the angle, gains of the stiffness."""
LANES = 256  # joints of a measurement


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


def best_pid(joints, air, fair):
    """Factors with the least error of the angle on training plants, of all and of those with no more air [L].

    Their median error of the stiffness is at most `fair` [N*m/rad].
    """
    each = LANES // 8
    envs = joints(len(FACTORS) * each, TRAINING, repeat=1, history=1)
    found = measured(envs, pid_actions(envs, np.repeat(FACTORS, each, axis=0)))
    angle, stiffness, used = (np.median(one.reshape(-1, each), axis=1) for one in found)
    return [FACTORS[np.argmin(np.where((stiffness <= fair) & (used <= most), angle, np.inf))] for most in (np.inf, air)]


def compare(joints, name, policy, fair=1.0):
    """Print the errors and the air of a policy and of the best PID on unseen plants.

    `joints` makes environments for a number of joints and a seed of their plants.
    """
    air = np.median(measured(joints(LANES, TRAINING), policy)[2])
    rows = {name: measured(joints(LANES, UNSEEN), policy)}
    for kind, factors in zip(("PID", "PID at equal air"), best_pid(joints, air, fair), strict=True):
        envs = joints(LANES, UNSEEN, repeat=1, history=1)
        rows[f"{kind}, factors {factors}"] = measured(envs, pid_actions(envs, np.tile(factors, (LANES, 1))))
    print("| | angle, deg | stiffness, N*m/rad | air, L |\n|---|---|---|---|")
    for kind, row in rows.items():
        print(f"| {kind} | " + " | ".join(f"{np.median(one):.3g} ({np.quantile(one, 0.9):.3g})" for one in row) + " |")
