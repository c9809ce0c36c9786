"""Episodes for reinforcement learning: a plant under the commands of an agent, step by step, as pure functions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction
from mckibben.control import Reference, Setpoint
from mckibben.errors import ExportError
from mckibben.numerics.batching import lanes_of
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import Plant
from mckibben.rig.compiled import FlatTree, compile_flat
from mckibben.scenario import Scenario, batched, valid_rows
from mckibben.scenario.scenario import BatchParts, StudiedScenario
from mckibben.simulation.outcome import SWUNG_OVER_AT
from mckibben.study.compare.suite import ControllerSuite
from mckibben.study.parameters import parse_sweeps, sample
from mckibben.units import atm, bar, deg, litre

OBSERVATION = {
    "angle": ("rad", np.pi),
    "velocity": ("rad/s", 100.0),
    "pressure": ("bar", 20.0),
    "reference_angle": ("rad", np.pi),
    "reference_stiffness": ("N*m/rad", 1e4),
}
"""Quantities of an observation, their units and largest magnitudes; larger values are clipped.

There is a pressure of each muscle; all others are of each joint.
"""


class RewardTerms(NamedTuple):
    r"""Terms of the reward of a control period, the mean over the joints.

    .. math:: \frac{1}{1 + (e_\theta / s_\theta)^2 + (e_K / s_K)^2} - c \dot V

    with the errors of the true angle and isobaric stiffness from their references, and the flow of air into the muscles
    [L/s, at atmospheric pressure] per joint. The first term is between 0 and 1, so ending an episode early reduces the
    return.

    Attributes
    ----------
    angle_scale, stiffness_scale
        Errors [rad], of a slide 1 mm for 1 deg, and [N*m/rad] that halve the reward; infinite to ignore an error.
    air_price
        c [s/L]; needs the volume of the muscles.
    """

    angle_scale: float = 2 * deg
    stiffness_scale: float = 2.0
    air_price: float = 0.0


Numbers = Array | NDArray[np.float64]
ScenarioLike = StudiedScenario | ControllerSuite | str | os.PathLike[str]
"""Scenario, its file, or a suite."""


class Settings(NamedTuple):
    """Settings of a step.

    Attributes
    ----------
    period
        Control period [s].
    low, high
        Commands [Pa] at the actions -1 and 1, of each muscle.
    reward
        Terms of the reward.
    """

    period: ArrayLike
    low: Numbers
    high: Numbers
    reward: RewardTerms


class Plants(NamedTuple):
    """Plants with their references and starts, one per row.

    Attributes
    ----------
    varying, fixed
        Leaves with a row per plant, and those that all plants share.
    starts
        State of each plant at rest at the first setpoints.
    rows
        Number of plants.
    """

    varying: BatchParts
    fixed: BatchParts
    starts: PyTree
    rows: int

    def row(self, row: PyTree) -> tuple[BatchParts, PyTree]:
        """Plant with the references of its joints, and start, of a row."""
        varying, start = jax.tree.map(lambda leaf: leaf[row], (self.varying, self.starts))
        return eqx.combine(varying, self.fixed), start


class Episode(NamedTuple):
    """State of an episode.

    Attributes
    ----------
    period
        Control periods so far.
    state
        State of the plant.
    angles
        The last measured angles [rad].
    seen
        Observations, latest first, each with the action before it: shape (history, 4 joints + 2 muscles).
    """

    period: Array
    state: PyTree
    angles: tuple[Array, ...]
    seen: Array


class EpisodeStep(NamedTuple):
    """Result of a step.

    Attributes
    ----------
    observation
        Its elements are those of `elements_of`.
    reward
        Mean of the rewards of the control periods.
    failed
        Whether an angle left its reference by more than 90 deg, or a stiffness is not finite.
    stiffness, air
        True stiffness [N*m/rad] of each joint at the end, and air into the muscles during the step [L].
    """

    observation: Numbers
    reward: Numbers
    failed: Numbers
    stiffness: PyTree
    air: Numbers


def conditions_of(suite: ControllerSuite) -> tuple[str, ...]:
    """Variations of a suite's plants and of its first reference, with another sensor noise in each plant."""
    varied = (*suite.conditions, *(text for case in list(suite.references.values())[:1] for text in case.over))
    noise = suite.has_noise and "sensors.seed" not in {text.partition("=")[0].strip() for text in varied}
    return (*varied, "sensors.seed=0..99999") if noise else varied


def example_of(scenario: ScenarioLike, random_plant: Sequence[str]) -> tuple[StudiedScenario, tuple[str, ...]]:
    """Scenario, and the variations of its plant; a suite adds its conditions.

    Raises `ExportError` if its robot follows no references.
    """
    random_plant = (random_plant,) if isinstance(random_plant, str) else tuple(random_plant)
    if isinstance(scenario, ControllerSuite):
        return scenario.example(), (*conditions_of(scenario), *random_plant)
    example = scenario if isinstance(scenario, StudiedScenario) else Scenario.read(scenario)
    if not example.references():
        message = f"{example.name}: the joints have no reference to follow"
        remedy = "give the robot `reference`, `duration` and `controller`, as in examples/robot/lei-leg-control.yaml"
        raise ExportError(message, field="reference", remedy=remedy)
    return example, random_plant


def plants_of(scenario: StudiedScenario, random_plant: Sequence[str], count: int, seed: int) -> Plants:
    """Plants with varied parameters (``load.mass2=+-50 %``), those without start dropped.

    Raises `ExportError` if no plant is valid, or none has an equilibrium at the start.

    Parameters
    ----------
    random_plant
        Variations, as for a sweep.
    count, seed
        Number of plants that are drawn, and the seed of the draw.
    """
    table = {}
    if random_plant:
        table = sample(parse_sweeps(random_plant, scenario), "random", count, seed)
        valid = valid_rows(scenario, table)
        table = {name: column[valid] for name, column in table.items()}
    varied = batched(scenario, table) if table and len(next(iter(table.values()))) else scenario
    plant, reference, start = varied.batch_parts()
    references = tuple(reference[name] for name in scenario.joint_names) or (reference,)
    parts = numeric(BatchParts(plant.with_period(scenario.control_period), references, start))
    lanes, flags = lanes_of(parts)
    if table and lanes is None:
        message = "no random plant is valid, or none of its parameters belongs to the plant or the reference"
        remedy = "vary numbers of the plant, its valve and sensors, or of a reference"
        raise ExportError(message, field="random_plant", value=list(random_plant), remedy=remedy)
    rows = lanes or 1
    if lanes is None:
        parts, flags = jax.tree.map(lambda leaf: np.asarray(leaf)[None], parts), True
    varying, fixed = eqx.partition(parts, flags)
    starts, exist = _starts(Plants(varying, fixed, (), 0), np.arange(rows))
    existing = np.flatnonzero(np.asarray(exist))
    if not existing.size:
        raise ExportError("no plant has an equilibrium at the start", field="start", remedy="give another `start`")
    take = lambda tree: jax.tree.map(lambda leaf: np.asarray(leaf)[existing], tree)  # noqa: E731
    return Plants(take(varying._replace(start=())), fixed._replace(start=()), take(starts), len(existing))


@jit_arrays
def _starts(plants: Plants, rows: PyTree) -> tuple[PyTree, Array]:
    """State at rest of each plant, and whether it exists."""

    def start(row: Array) -> tuple[PyTree, Array]:
        (plant, references, at_rest), _ = plants.row(row)
        state, exists = at_rest.state(plant, first_setpoints(plant, references))
        return jax.tree.map(jnp.asarray, state), exists

    return jax.vmap(start)(rows)


def first_setpoints(plant: Plant, references: Sequence[Reference]) -> PyTree:
    """Setpoints at the start, shape (1,), of a joint or of the joints of a robot."""
    setpoints = tuple(reference(jnp.zeros(1)) for reference in references)
    return setpoints if plant.mechanism.joint_names else setpoints[0]


def elements_of(joints: Sequence[str], muscles: Sequence[str], history: int) -> dict[str, tuple[str, float]]:
    """Elements as in `OBSERVATION`, of the last observations and the actions between them.

    Parameters
    ----------
    joints, muscles
        Ends of the names of elements of each joint, and of each muscle.
    history
        Number of observations.

    Examples
    --------
    >>> list(elements_of([""], "12", 2))[5:9], len(elements_of([""], "12", 100))
    (['reference_stiffness', 'action1_before1', 'action2_before1', 'angle_before1'], 798)
    """
    ends = dict.fromkeys(OBSERVATION, joints) | {"pressure": muscles}
    now = {f"{name}{end}": element for name, element in OBSERVATION.items() for end in ends[name]}
    elements = dict(now)
    for back in range(1, history):
        elements |= {f"action{end}_before{back}": ("1", 1.0) for end in muscles}
        elements |= {f"{name}_before{back}": element for name, element in now.items()}
    return elements


def begin(parts: BatchParts, start: PyTree, period: ArrayLike, history: int) -> tuple[Episode, Array]:
    """The start of an episode, and the first observation, which is repeated as its history, with actions of 0.

    Parameters
    ----------
    parts
        Plant, and the references of its joints.
    start
        State of the plant.
    period
        Control period [s].
    history
        Observations in an observation.
    """
    state, measured = parts.plant.sample(start, period)
    angles = tuple(map(jnp.asarray, parts.plant.mechanism.by_joint(measured[0])))
    zero = jnp.zeros_like(angles[0])
    now = _observation(angles, [zero] * len(angles), measured[1], [each.finite(each(zero)) for each in parts.reference])
    muscles = len(measured[1])
    seen = jnp.tile(jnp.concatenate([now, jnp.zeros(muscles)]), (history, 1))
    return Episode(jnp.asarray(0), state, angles, seen), seen.ravel()[:-muscles]


def advance(
    parts: BatchParts, episode: Episode, action: Array, settings: Settings, substeps: int, repeat: int
) -> tuple[Episode, EpisodeStep]:
    """Advance by several control periods under an action of -1 to 1 per muscle; the reward is their mean.

    After a failure the reward is 0.

    Parameters
    ----------
    parts
        Plant, and the references of its joints.
    action
        Shape (muscles,), mapped to commands by `Settings`.
    substeps, repeat
        Integration steps per control period, and control periods.
    """
    plant, (period, low, high, terms) = parts.plant, settings
    mechanism, joints, muscles = plant.mechanism, len(parts.reference), action.shape[0]
    targets = low + (high - low) * (action + 1) / 2
    commands = plant.clip_commands([targets[muscle] for muscle in range(muscles)])

    def next_period(_: Array, carry: tuple[Episode, Array, EpisodeStep]) -> tuple[Episode, Array, EpisodeStep]:
        episode, content, so_far = carry
        state = plant.follow(episode.state, commands, period, substeps)
        state, measured = plant.sample(state, period)
        angles = tuple(mechanism.by_joint(measured[0]))
        velocities = [(angle - before) / period for angle, before in zip(angles, episode.angles, strict=True)]
        following = Episode(episode.period + 1, state, angles, episode.seen)
        setpoints = [each.finite(each(following.period * period)) for each in parts.reference]
        stiffnesses = mechanism.stiffness(state[0], state.pressures)
        failed, fit = so_far.failed, 0.0
        joints_now = zip(parts.reference, mechanism.by_joint(state[0]), stiffnesses, setpoints, strict=True)
        for reference, angle, stiffness, setpoint in joints_now:
            angle_error = (angle - setpoint.angle) / mechanism.joint_type.scale
            cost = (angle_error / terms.angle_scale) ** 2
            if reference.stiffness is not None:
                cost += ((stiffness - setpoint.stiffness) / terms.stiffness_scale) ** 2
            fit += 1 / (1 + cost)
            failed |= ~(jnp.abs(angle_error) <= SWUNG_OVER_AT) | ~jnp.isfinite(stiffness)
        now = _content(plant, state)
        air = jnp.sum(jnp.maximum(now - content, 0.0))
        reward = jnp.where(failed, 0.0, (fit - terms.air_price * air / period) / joints)
        observation = _observation(angles, velocities, measured[1], setpoints)
        stiffness = mechanism.like_joints(stiffnesses)
        return following, now, EpisodeStep(observation, so_far.reward + reward, failed, stiffness, so_far.air + air)

    zero = jnp.zeros(())
    nothing = jnp.zeros(episode.seen.shape[1] - muscles)
    first = EpisodeStep(nothing, zero, jnp.asarray(False), mechanism.like_joints([zero] * joints), zero)
    episode, _, step = lax.fori_loop(0, repeat, next_period, (episode, _content(plant, episode.state), first))
    seen = jnp.concatenate([jnp.concatenate([step.observation, jnp.clip(action, -1, 1)])[None], episode.seen[:-1]])
    step = step._replace(observation=seen.ravel()[:-muscles], reward=step.reward / repeat)
    return episode._replace(seen=seen), step


class SingleProgram:
    """Compiled episodes of one plant, whose parameters are arguments, so that a new one does not recompile."""

    def __init__(self, plants: Plants, settings: Settings, *, substeps: int, repeat: int, history: int) -> None:
        self._plants, action = plants, jnp.zeros_like(settings.low)
        parts, start = plants.row(0)
        at, _ = jax.eval_shape(lambda: begin(parts, start, settings.period, history))
        _, step = jax.eval_shape(lambda at: advance(parts, at, action, settings, substeps, repeat), at)
        numbers, starts, episodes, self._steps = map(FlatTree.like, (parts, start, at, step))
        self._layouts = numbers, starts

        def first(packed: Array, start: Array) -> tuple[Array, Array]:
            episode, observation = begin(numbers.unpack(packed), starts.unpack(start), settings.period, history)
            return episodes.pack(episode, jnp), observation

        def following(packed: Array, episode: Array, action: Array) -> tuple[Array, Array]:
            unpacked = numbers.unpack(packed), episodes.unpack(episode)
            at, step = advance(*unpacked, action, settings, substeps, repeat)
            return episodes.pack(at, jnp), self._steps.pack(step, jnp)

        self._first = compile_flat(first, numbers.size, starts.size)
        self._following = compile_flat(following, numbers.size, episodes.size, action.size)

    def begin(self, row: int) -> NDArray[np.float64]:
        """Begin an episode with the plant of a row; return its observation."""
        numbers, start = (layout.pack(part) for layout, part in zip(self._layouts, self._plants.row(row), strict=True))
        self._numbers = jnp.asarray(numbers)
        self._episode, observation = self._first(self._numbers, start)
        return np.asarray(observation)

    def advance(self, action: ArrayLike) -> EpisodeStep:
        """Advance the episode."""
        self._episode, values = self._following(self._numbers, self._episode, np.asarray(action, float))
        return self._steps.unpack(np.asarray(values))


def _begun(shared: PyTree, lane: PyTree) -> tuple[Episode, Array]:
    """`begin` for a lane of a batch."""
    (fixed, settings, history), (varying, start) = shared, lane
    return begin(eqx.combine(varying, fixed), start, settings.period, history)


def _advanced(shared: PyTree, lane: PyTree) -> tuple[Episode, EpisodeStep]:
    """`advance` for a lane of a batch."""
    (fixed, settings, counts), (varying, episode, action) = shared, lane
    return advance(eqx.combine(varying, fixed), episode, action, settings, *counts)


_BEGIN, _ADVANCE = BatchFunction(_begun), BatchFunction(_advanced)


class ManyProgram:
    """Episodes of many plants, compiled as C, or by XLA without a C compiler; finished episodes restart."""

    def __init__(self, plants: Plants, settings: Settings, *, substeps: int, repeat: int, history: int) -> None:
        self._plants = plants
        self._shared = (plants.fixed, settings, history), (plants.fixed, settings, (substeps, repeat))

    def begin(self, rows: PyTree) -> NDArray[np.float64]:
        """Begin all episodes with the plants of the given rows; return their observations, shape (n, size)."""
        table = self._plants.varying, self._plants.starts
        self._varying, starts = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf)[rows], 0, -1), table)
        (self._episodes, observations), _ = _BEGIN("auto", self._shared[0], (self._varying, starts))
        return np.asarray(observations).T

    def advance(self, rows: PyTree, actions: NDArray[np.float32], over: NDArray[np.bool_]) -> EpisodeStep:
        """Advance; finished episodes restart with the plants of the given rows and ignore their action."""
        lanes = self._varying, self._episodes, np.asarray(actions, float).T
        (moved, step), _ = _ADVANCE("auto", self._shared[1], lanes)
        columns = [np.asarray(column) for column in step]
        if over.any():
            starting = [self.begin(rows).T, *map(np.zeros_like, columns[1:])]
            moved = jax.tree.map(lambda new, old: np.where(over, new, old), self._episodes, moved)
            columns = [np.where(over, new, old) for new, old in zip(starting, columns, strict=True)]
        self._episodes = moved
        return EpisodeStep(*(column.T for column in columns))


def _content(plant: Plant, state: PyTree) -> Array:
    """Air in the muscles as volumes at atmospheric pressure [L]; zero if a volume is unknown."""
    if not all(muscle.specimen.has_volume for muscle in plant.muscles):
        return jnp.zeros(len(plant.muscles))
    volumes = plant.air_volumes(state)
    content = [air.volume * (pressure + atm) for air, pressure in zip(volumes, state.pressures, strict=True)]
    return jnp.stack(content) / (atm * litre)


def _observation(
    angles: Sequence[Array], velocities: Sequence[Array], pressures: Sequence[Array], setpoints: Sequence[Setpoint]
) -> Array:
    """Observation in the units of `OBSERVATION`, within its limits; numbers that are not finite become 0 or a limit."""
    in_bar = [pressure / bar for pressure in pressures]
    quantities = zip((angles, velocities, in_bar, *zip(*setpoints, strict=True)), OBSERVATION.values(), strict=True)
    clipped = [jnp.clip(jnp.nan_to_num(jnp.stack(values)), -limit, limit) for values, (_, limit) in quantities]
    return jnp.concatenate(clipped)
