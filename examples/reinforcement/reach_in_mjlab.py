"""Training of an arm with two joints in mjlab, to reach points with its hand, and test on our plant with real valves.

    pip install mjlab mckibben
    python examples/reinforcement/reach_in_mjlab.py [--steps 0.75e6] [--seed 0]

In mjlab, on the CPU device, each of 512 worlds has the arm of `arm.yaml` with VPPE-6 regulators of different lag and
supply, a delay of 0 to 8 ms, muscles of different strength, and a force law drawn from the uncertainty of the fit. The
policy corrects, every 10 ms and from the last four observations, the pressures of all four muscles that would hold the
nominal arm at the goal. It is then measured on the plant of `arm.yaml`, in 64 bits with encoders and noise; masses
vary, too. The PID of each joint acts every 1 ms at the angles of inverse kinematics, with or without the same pressures
as feedforward; its gains and its stiffness are the best on other plants of this kind.
"""

import argparse
import math
from itertools import product
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import torch
from in_mjlab import trained as ppo
from jax import lax
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.observation_manager import ObservationGroupCfg, ObservationTermCfg
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.managers.termination_manager import TerminationTermCfg
from mjlab.scene import SceneCfg
from mjlab.sim import MujocoCfg, SimulationCfg

import mckibben as mk
from mckibben.control import Constant, Reference
from mckibben.export.mjlab import leg_entity
from mckibben.leg import JointwiseControl, LegScenario, LegStart, TimedReference
from mckibben.leg.dynamics import joint_equations
from mckibben.leg.uncertainty import drawn_plant
from mckibben.numerics.batching import lanes_of, with_leaves
from mckibben.numerics.compiled import numeric
from mckibben.simulation.loop import control_period, initial_loop
from mckibben.units import atm, bar, deg, litre, mm, ms

REAL = LegScenario.read("examples/reinforcement/arm.yaml")
ARM = REAL.plant()
TRAINING, UNSEEN = 0, 1  # seeds of the plants
WORLDS, STEPS, REPEAT, HISTORY = 512, 24, 10, 4
PERIODS, PERIOD, SUBSTEPS = 1000, REAL.step, REAL.substeps
LINKS = [float(one.length) for one in ARM.leg.links]
BENT = [float(one.link_angle) for one in ARM.leg.joints]
REST = [float(one) for one in joint_equations(ARM.leg, (0.0, 0.0), (0.0, 0.0), ARM.gravity).bias]  # N*m
START = LegStart((0.0, 0.0), ARM.leg.pressures_for((0.0, 0.0), REST, (18.0, 18.0)), clearance=0.5)
STRONGEST = 1.5 * bar  # of an action
GAINS = list(product((0.15, 0.5, 1.5), (1.5, 5.0), (0.02, 0.06), (20.0, 24.0), (0.0, 1.0)))
"""Of the PID of both joints: kp [bar/rad], ki/kp [1/s], kd/kp [s], stiffness [N*m/rad], share of the feedforward."""


def plants(seed):
    """Arms with arrays over draws in place of uncertain numbers, and goals [rad] of their joints, shape (draws, 2)."""
    spread = REAL.uncertainty.model_copy(update={"seed": seed})
    plant, draw = drawn_plant(REAL.model_copy(update={"uncertainty": spread})), np.random.default_rng(seed)
    count = spread.draws + 1
    others = {
        "valve.time_constant": draw.uniform(20 * ms, 40 * ms, count),
        "valve.supply": draw.uniform(6.5 * bar, 7.5 * bar, count),
        "command_delay": draw.uniform(0, 8 * ms, count),
        "sensors.seed": draw.integers(0, 10_000, count),
    }
    return with_leaves({"plant": plant}, others)["plant"], draw.uniform(-15 * deg, 15 * deg, (count, 2))


def hand_of(angle1, angle2, of=np):
    """Place of the hand [m] from the shoulder, forwards and up, at angles of the joints [rad]."""
    upper, lower = angle1 + BENT[0], angle1 + angle2 + sum(BENT)
    return LINKS[0] * of.sin(upper) + LINKS[1] * of.sin(lower), -LINKS[0] * of.cos(upper) - LINKS[1] * of.cos(lower)


def angles_at(x, z):
    """Angles of the joints [rad] with the hand at a place [m]."""
    bent = jnp.arccos((x**2 + z**2 - LINKS[0] ** 2 - LINKS[1] ** 2) / (2 * LINKS[0] * LINKS[1]))
    upper = jnp.arctan2(x, -z) - jnp.arctan2(LINKS[1] * jnp.sin(bent), LINKS[0] + LINKS[1] * jnp.cos(bent))
    return upper - BENT[0], bent - BENT[1]


def holding():
    """Pressures [Pa] that hold the nominal arm with its hand at a place, as a matrix times x [m], z [m] and 1."""
    angles = list(product(np.linspace(-15, 15, 5) * deg, repeat=2))
    torques = [[float(one) for one in joint_equations(ARM.leg, at, (0.0, 0.0), ARM.gravity).bias] for at in angles]
    pressures = [ARM.leg.pressures_for(at, by, (18.0, 18.0)) for at, by in zip(angles, torques, strict=True)]
    places = np.column_stack([*hand_of(*np.transpose(angles)), np.ones(len(angles))])
    return np.linalg.lstsq(places, np.array(pressures))[0].T


HOLDING = holding().tolist()


def commands(goal, action):
    """Commands [Pa] of an action for a goal [m]: those that hold the nominal arm there, and up to `STRONGEST` more."""
    held = (row[0] * goal[0] + row[1] * goal[1] + row[2] for row in HOLDING)
    return [one + STRONGEST * more for one, more in zip(held, action, strict=True)]


def features(angles, velocities, pressures, goal, of):
    """Observation at the scale of a network; each argument is a sequence, and the goal a place [m]."""
    hand = hand_of(*angles, of)
    scaled = [one / 0.2 for one in angles] + [one / 2 for one in velocities] + [(p / bar - 3) / 2 for p in pressures]
    scaled += [(wanted - one) / (20 * mm) for wanted, one in zip(goal, hand, strict=True)]
    return [*scaled, (goal[0] - 0.1) / 0.1, (goal[1] + 0.5) / 0.1]


def seen(env):
    """Observation of all worlds in mjlab, with the noise of the sensors, and the last action."""
    data, acts = env.scene["arm"].data, env.scene["arm"].actuators[0].pressures()
    noise = [torch.randn(2, env.num_envs) * one for one in (0.01 * deg, 0.04)] + [torch.randn(4, env.num_envs) * 4e3]
    given = (one.T + more for one, more in zip((data.joint_pos, data.joint_vel, acts), noise, strict=True))
    found = features(*given, getattr(env, "goal", torch.zeros(2, env.num_envs)), torch)
    return torch.cat([torch.stack(found, 1), env.action_manager.action.clip(-1, 1)], 1)


def new_goal(env, env_ids):
    """Goals of worlds that begin."""
    env.goal = getattr(env, "goal", torch.zeros(2, env.num_envs))
    goals = hand_of(*(30 * deg * (torch.rand(2, env.num_envs) - 0.5)), torch)
    env.goal[:, env_ids] = torch.stack(goals)[:, env_ids]


def closeness(env):
    """Reward: 1 / (1 + distance of the hand from the goal / 10 mm), minus the distance over 50 mm."""
    hand = torch.stack(hand_of(*env.scene["arm"].data.joint_pos.T, torch))
    distance = (hand - env.goal).norm(dim=0)
    return 1 / (1 + distance / (10 * mm)) - distance / (50 * mm)


class Commands(mdp.actions.TendonEffortAction):
    """Actions of the policy as `commands` of the muscles."""

    def process_actions(self, actions):
        super().process_actions(actions)
        self._processed_actions = torch.stack(commands(self._env.goal, actions.T), 1)


class CommandsCfg(mdp.actions.TendonEffortActionCfg):
    """Configuration of `Commands`."""

    def build(self, env):
        return Commands(self, env)


def environment(seed, worlds=WORLDS):
    """The arm in mjlab."""
    entity = leg_entity(plants(TRAINING)[0], START)
    terms = ObservationGroupCfg({"seen": ObservationTermCfg(func=seen, history_length=HISTORY)})
    return ManagerBasedRlEnv(
        ManagerBasedRlEnvCfg(
            scene=SceneCfg(num_envs=worlds, entities={"arm": entity}),
            sim=SimulationCfg(mujoco=MujocoCfg(timestep=1.25 * ms, integrator="euler", disableflags=("contact",))),
            decimation=8,
            episode_length_s=PERIODS * PERIOD,
            scale_rewards_by_dt=False,
            observations={"actor": terms, "critic": terms},
            actions={"pressures": CommandsCfg(entity_name="arm", actuator_names=ARM.leg.muscle_names)},
            events={
                "start": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset"),
                "goal": EventTermCfg(func=new_goal, mode="reset"),
            },
            rewards={
                "closeness": RewardTermCfg(func=closeness, weight=1.0),
                "changes": RewardTermCfg(func=mdp.action_rate_l2, weight=-0.1),  # they cost air
            },
            terminations={"end": TerminationTermCfg(func=mdp.time_out, time_out=True)},
            seed=seed,
        ),
        device="cpu",
    )


def trained(steps, seed):
    """Weights and biases of the layers of a policy."""
    runner = ppo(environment(seed), math.ceil(steps / (WORLDS * STEPS)), STEPS, 0.99, seed)
    layers = [one for one in runner.alg.get_policy().modules() if isinstance(one, torch.nn.Linear)]
    return [(one.weight.detach().double().numpy(), one.bias.detach().double().numpy()) for one in layers]


def policy_for(layers):
    """The policy as a controller of the arm for a goal [m]; its state is periods, angles, action, and observations."""

    def init(measurement):
        return jnp.asarray(0), jnp.stack(measurement.angles), jnp.zeros(4), jnp.zeros((HISTORY, 16))

    def controller(goal):
        def step(state, time, measurement, period):
            count, before, action, rows = state
            angles = jnp.stack(measurement.angles)
            speeds = (angles - before) / (REPEAT * PERIOD)
            row = jnp.stack([*features(angles, speeds, measurement.pressures, goal, jnp), *action])
            rows = jnp.where(count == 0, row, jnp.concatenate([rows[1:], row[None]]))
            found = rows.ravel()
            for number, (weight, bias) in enumerate(layers):
                found = weight @ (jax.nn.elu(found) if number else found) + bias
            now = count % REPEAT == 0
            new = count + 1, angles, jnp.clip(found, -1, 1), rows
            kept = count + 1, *state[1:]
            state = jax.tree.map(lambda one, other: jnp.where(now, one, other), new, kept)
            return state, tuple(commands(goal, state[2]))

        return SimpleNamespace(init=init, step=step, telemetry=lambda state: {})

    return controller


def pid(goal, kp, rate, lead, stiffness, share):
    """A PID of each joint as a controller of the arm for a goal [m]; the other arguments are those of `GAINS`."""
    angle, cocontraction = mk.PID(kp=kp * bar, ki=kp * rate * bar, kd=kp * lead * bar), mk.PID(0.05 * bar, 2 * bar, 0.0)
    loops = tuple(
        mk.PositionStiffnessControl(angle, cocontraction, model=joint.muscles, minimum_tension=5.0)
        for joint in ARM.leg.joints
    )
    wanted = tuple(Reference(Constant(at), Constant(stiffness)) for at in angles_at(*goal))
    inner, start = JointwiseControl(loops, TimedReference(wanted)), commands(hand_of(0.0, 0.0), [0.0] * 4)
    added = [share * (one - begun) for one, begun in zip(commands(goal, [0.0] * 4), start, strict=True)]

    def step(*arguments):
        state, found = inner.step(*arguments)
        return state, tuple(one + more for one, more in zip(found, added, strict=True))

    return SimpleNamespace(init=inner.init, step=step, telemetry=lambda state: {})


def measured(drawn, controller, rows, *settings):
    """Distance of the hand from its goal [mm], root mean square and in the last 0.2 s, and air [L], of some arms."""
    plant, goals = drawn
    plant = numeric(plant.with_period(PERIOD))
    varying, fixed = eqx.partition(plant, lanes_of(plant)[1])

    def content(plant, state):
        volumes = zip(plant.air_volumes(state), state.pressures, strict=True)
        return jnp.stack([one.volume * (pressure + atm) for one, pressure in volumes]) / (atm * litre)

    def run(varying, goal, *setting):
        plant, goal = eqx.combine(varying, fixed), hand_of(*goal, jnp)
        control = controller(goal, *setting)

        def period(carry, time):
            loop, before = carry
            loop, _ = control_period(plant, control, loop, time, PERIOD, SUBSTEPS)
            now, hand = content(plant, loop[0]), hand_of(*loop[0].posture.angles, jnp)
            square = sum((one - wanted) ** 2 for one, wanted in zip(hand, goal, strict=True))
            return (loop, now), (square, jnp.sum(jnp.maximum(now - before, 0.0)))

        begun = initial_loop(plant, control, START)
        squares, air = lax.scan(period, (begun, content(plant, begun[0])), PERIOD * jnp.arange(PERIODS))[1]
        late = squares[-PERIODS // 5 :]
        return jnp.sqrt(jnp.mean(squares)) / mm, jnp.sqrt(jnp.mean(late)) / mm, jnp.sum(air)

    own = jax.tree.map(lambda one: jnp.asarray(one)[rows], varying)
    return np.stack(jax.jit(jax.vmap(run))(own, goals[rows], *settings))


def best_gains(drawn, air):
    """Gains with the least median distance over an episode, of all and of those with no more air [L]."""
    each = 16
    rows, table = np.tile(np.arange(1, each + 1), len(GAINS)), np.repeat(np.array(GAINS), each, axis=0)
    distance, _, used = measured(drawn, pid, rows, *table.T)
    distance, used = (np.median(one.reshape(-1, each), axis=1) for one in (np.nan_to_num(distance, nan=np.inf), used))
    return [GAINS[np.argmin(np.where(used <= most, distance, np.inf))] for most in (np.inf, air)]


def main():
    """Train, and print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--steps", type=float, default=0.75e6, help="of training, over all worlds")
    options.add_argument("--seed", type=int, default=0, help="of training")
    asked = options.parse_args()
    policy = policy_for(trained(asked.steps, asked.seed))
    known, unseen, every = plants(TRAINING), plants(UNSEEN), np.arange(1, REAL.uncertainty.draws + 1)
    air = np.median(measured(known, policy, every)[2])
    rows = {"no correction": measured(unseen, policy_for([(np.zeros((4, HISTORY * 16)), np.zeros(4))]), every)}
    rows[f"PPO in mjlab, {asked.steps / 1e6:g} million steps"] = measured(unseen, policy, every)
    best = best_gains(known, air)
    both = measured(unseen, pid, np.tile(every, 2), *np.repeat(best, len(every), axis=0).T)
    for kind, gains, row in zip(("PID", "PID at equal air"), best, np.split(both, 2, axis=1), strict=True):
        rows[f"{kind}, gains {gains}"] = row
    print("| | distance, mm | in the last 0.2 s, mm | air, L |\n|---|---|---|---|")
    for kind, row in rows.items():
        print(f"| {kind} | " + " | ".join(f"{np.median(one):.3g} ({np.quantile(one, 0.9):.3g})" for one in row) + " |")


if __name__ == "__main__":
    main()
