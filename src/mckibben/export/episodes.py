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

from mckibben.control import Setpoint
from mckibben.errors import ExportError
from mckibben.joint import Measurement
from mckibben.numerics.batching import lanes_of
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.rig.compiled import FlatTree, compile_flat
from mckibben.scenario import Scenario, batched, initial_state, valid_rows
from mckibben.simulation.engine import BatchFunction
from mckibben.simulation.outcome import SWUNG_OVER_AT
from mckibben.simulation.problem import SimulationProblem
from mckibben.study.compare.suite import Suite
from mckibben.study.parameters import parse_sweeps, sample
from mckibben.units import atm, bar, deg, litre

OBSERVATION = {
    "angle": ("rad", np.pi),
    "velocity": ("rad/s", 100.0),
    "pressure1": ("bar", 20.0),
    "pressure2": ("bar", 20.0),
    "reference_angle": ("rad", np.pi),
    "reference_stiffness": ("N*m/rad", 1e4),
}
"""Elements of an observation, their units and largest magnitudes; larger values are clipped."""


class RewardTerms(NamedTuple):
    r"""Terms of the reward of a control period.

    .. math:: \frac{1}{1 + (e_\theta / s_\theta)^2 + (e_K / s_K)^2} - c \dot V

    with the errors of the true angle and isobaric stiffness from their references, and the flow of air into the muscles
    [L/s, at atmospheric pressure]. The first term is between 0 and 1, so ending an episode early reduces the return.

    Attributes
    ----------
    angle_scale, stiffness_scale
        Errors [rad], [N*m/rad] that halve the reward; infinite to ignore an error.
    air_price
        c [s/L]; needs the volume of the muscles.
    """

    angle_scale: float = 2 * deg
    stiffness_scale: float = 2.0
    air_price: float = 0.0


Numbers = Array | NDArray[np.float64]


class Settings(NamedTuple):
    """Settings of a step.

    Attributes
    ----------
    period
        Control period [s].
    low, high
        Commands [Pa] at the actions -1 and 1, of both muscles.
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
        State of each plant at rest at the first setpoint.
    rows
        Number of plants.
    """

    varying: SimulationProblem
    fixed: SimulationProblem
    starts: PlantState
    rows: int

    def row(self, row: PyTree) -> tuple[SimulationProblem, PlantState]:
        """Plant, reference and start of a row."""
        varying, start = jax.tree.map(lambda leaf: leaf[row], (self.varying, self.starts))
        return eqx.combine(varying, self.fixed), start


class Episode(NamedTuple):
    """State of an episode.

    Attributes
    ----------
    period
        Control periods so far.
    measured
        The last measurement.
    seen
        Observations, latest first, and the action before each, shape (history, 8).
    """

    period: Array  # control periods so far
    state: PlantState
    measured: Measurement  # the last one
    seen: Array  # a row for each observation, the latest first: 6 elements, and the action before it


class EpisodeStep(NamedTuple):
    """Result of a step.

    Attributes
    ----------
    observation
        Shape (8 history - 2,), see `elements_of`.
    reward
        Mean of the rewards of the control periods.
    failed
        Whether the angle left its reference by more than 90 deg, or the stiffness is not finite.
    stiffness, air
        True stiffness [N*m/rad] at the end, and air into the muscles during the step [L].
    """

    observation: Numbers
    reward: Numbers
    failed: Numbers
    stiffness: Numbers
    air: Numbers


def conditions_of(suite: Suite) -> tuple[str, ...]:
    """Variations of a suite's plants and of its first reference, with another sensor noise in each plant."""
    varied = (*suite.conditions, *next(iter(suite.references.values())).over)
    noise = suite.has_noise and "sensors.seed" not in {text.partition("=")[0].strip() for text in varied}
    return (*varied, "sensors.seed=0..99999") if noise else varied


def example_of(
    scenario: Scenario | Suite | str | os.PathLike[str], random_plant: Sequence[str]
) -> tuple[Scenario, tuple[str, ...]]:
    """Scenario, and the variations of its plant; a suite adds its conditions."""
    random_plant = (random_plant,) if isinstance(random_plant, str) else random_plant
    if isinstance(scenario, Suite):
        return scenario.example(), (*conditions_of(scenario), *random_plant)
    return (scenario if isinstance(scenario, Scenario) else Scenario.read(scenario)), tuple(random_plant)


def plants_of(scenario: Scenario, random_plant: Sequence[str], count: int, seed: int) -> Plants:
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
    plant = varied.plant().with_period(scenario.control_period)
    problem = numeric(SimulationProblem(plant, (), varied.reference(), initial_state(varied)))  # type: ignore
    lanes, flags = lanes_of(problem)
    if table and lanes is None:
        message = "no random plant is valid, or none of its parameters belongs to the plant or the reference"
        remedy = "vary numbers of joint, load, valve, sensors, disturbance or reference"
        raise ExportError(message, field="random_plant", value=list(random_plant), remedy=remedy)
    rows = lanes or 1
    if lanes is None:
        problem, flags = jax.tree.map(lambda leaf: np.asarray(leaf)[None], problem), True
    varying, fixed = eqx.partition(problem, flags)
    plants = Plants(varying, fixed, (), rows)  # type: ignore[arg-type]
    starts, exist = _starts(plants._replace(rows=0), np.arange(rows))
    existing = np.flatnonzero(np.asarray(exist))
    if not existing.size:
        raise ExportError("no plant has an equilibrium at the start", field="start", remedy="give another `start`")
    take = lambda tree: jax.tree.map(lambda leaf: np.asarray(leaf)[existing], tree)  # noqa: E731
    return Plants(take(varying), fixed, take(starts), len(existing))


@jit_arrays
def _starts(plants: Plants, rows: PyTree) -> tuple[PlantState, Array]:
    """State at rest of each plant, and whether it exists."""

    def start(row: Array) -> tuple[PlantState, Array]:
        problem, _ = plants.row(row)
        setpoint = problem.reference(jnp.zeros(1))
        state, exists = problem.start(setpoint)
        return jax.tree.map(jnp.asarray, state), exists

    return jax.vmap(start)(rows)


def elements_of(history: int) -> dict[str, tuple[str, float]]:
    """Elements as in `OBSERVATION`, of the last observations and the actions between them.

    Examples
    --------
    >>> list(elements_of(2))[5:9], len(elements_of(100))
    (['reference_stiffness', 'action1_before1', 'action2_before1', 'angle_before1'], 798)
    """
    elements = dict(OBSERVATION)
    for back in range(1, history):
        elements |= {f"action{number}_before{back}": ("1", 1.0) for number in (1, 2)}
        elements |= {f"{name}_before{back}": element for name, element in OBSERVATION.items()}
    return elements


def begin(problem: SimulationProblem, start: PlantState, period: ArrayLike, history: int) -> tuple[Episode, Array]:
    """The start of an episode, and the first observation, which is repeated as its history, with actions of 0.

    Parameters
    ----------
    start
        State of the plant.
    period
        Control period [s].
    history
        Observations in an observation.
    """
    state, measured = problem.plant.sample(start, period)
    measured = jax.tree.map(jnp.asarray, measured)
    zero = jnp.zeros_like(measured.angle)
    now = _observation(measured, zero, problem.reference(zero))
    seen = jnp.tile(jnp.concatenate([now, jnp.zeros(2)]), (history, 1))
    return Episode(jnp.asarray(0), state, measured, seen), seen.ravel()[:-2]


def advance(
    problem: SimulationProblem, episode: Episode, action: Array, settings: Settings, substeps: int, repeat: int
) -> tuple[Episode, EpisodeStep]:
    """Advance by several control periods under an action of -1 to 1 per muscle; the reward is their mean.

    After a failure the reward is 0.

    Parameters
    ----------
    action
        Shape (2,), mapped to commands by `Settings`.
    substeps, repeat
        Integration steps per control period, and control periods.
    """
    plant, (period, low, high, terms) = problem.plant, settings
    wanted = low + (high - low) * (action + 1) / 2
    commands = plant.clip_commands((wanted[0], wanted[1]))

    def next_period(_: Array, carry: tuple[Episode, Array, EpisodeStep]) -> tuple[Episode, Array, EpisodeStep]:
        episode, content, so_far = carry
        state = plant.follow(episode.state, commands, period, substeps)
        state, measured = plant.sample(state, period)
        velocity = (measured.angle - episode.measured.angle) / period
        following = Episode(episode.period + 1, state, measured, episode.seen)
        setpoint = problem.reference(following.period * period)
        stiffness = plant.joint.evaluate(state.angle, state.pressures)[1]
        angle_error, stiffness_error = state.angle - setpoint.angle, stiffness - setpoint.stiffness
        now = _content(plant, state)
        air = jnp.sum(jnp.maximum(now - content, 0.0))
        cost = (angle_error / terms.angle_scale) ** 2 + (stiffness_error / terms.stiffness_scale) ** 2
        reward = 1 / (1 + cost) - terms.air_price * air / period
        failed = ~(jnp.abs(angle_error) <= SWUNG_OVER_AT) | ~jnp.isfinite(stiffness)
        observation = _observation(measured, velocity, setpoint)
        reward = jnp.where(so_far.failed | failed, 0.0, reward)
        step = EpisodeStep(observation, so_far.reward + reward, so_far.failed | failed, stiffness, so_far.air + air)
        return following, now, step

    zero = jnp.zeros(())
    first = EpisodeStep(jnp.zeros(len(OBSERVATION)), zero, jnp.asarray(False), zero, zero)
    episode, _, step = lax.fori_loop(0, repeat, next_period, (episode, _content(plant, episode.state), first))
    seen = jnp.concatenate([jnp.concatenate([step.observation, jnp.clip(action, -1, 1)])[None], episode.seen[:-1]])
    step = step._replace(observation=seen.ravel()[:-2], reward=step.reward / repeat)
    return episode._replace(seen=seen), step


class _FlatEpisodes:
    """`begin` and `advance` with episode and `EpisodeStep` packed as arrays."""

    def __init__(self, plants: Plants, settings: Settings, substeps: int, repeat: int, history: int) -> None:
        """Begin with the layout of an episode as an array."""
        self._settings, self._counts, self._history = settings, (substeps, repeat), history
        self._layout = FlatTree.like(jax.eval_shape(lambda: begin(*plants.row(0), settings.period, history)[0]))
        self.size = self._layout.size

    def begin(self, problem: SimulationProblem, start: PlantState) -> tuple[Array, Array]:
        """Begin an episode."""
        episode, observation = begin(problem, start, self._settings.period, self._history)
        return self._layout.pack(episode, jnp), jnp.concatenate([observation, jnp.zeros(len(EpisodeStep._fields) - 1)])

    def advance(self, problem: SimulationProblem, episode: Array, action: Array) -> tuple[Array, Array]:
        """Advance an episode."""
        at, step = advance(problem, self._layout.unpack(episode), action, self._settings, *self._counts)
        return self._layout.pack(at, jnp), jnp.concatenate([step.observation, jnp.stack(step[1:], dtype=float)])


def _step(values: ArrayLike) -> EpisodeStep:
    """`EpisodeStep` from an array with its elements along the last axis."""
    values, others = np.asarray(values), len(EpisodeStep._fields) - 1
    return EpisodeStep(values[..., :-others], *np.moveaxis(values[..., -others:], -1, 0))


class SingleProgram:
    """Compiled episodes of one joint, whose parameters are arguments, so that a new plant does not recompile."""

    def __init__(self, plants: Plants, settings: Settings, **counts: int) -> None:
        flat, self._plants = _FlatEpisodes(plants, settings, **counts), plants
        numbers, starts = self._layouts = tuple(map(FlatTree.like, plants.row(0)))

        def first(packed: Array, start: Array) -> tuple[Array, Array]:
            return flat.begin(numbers.unpack(packed), starts.unpack(start))

        def following(packed: Array, episode: Array, action: Array) -> tuple[Array, Array]:
            return flat.advance(numbers.unpack(packed), episode, action)

        self._first = compile_flat(first, numbers.size, starts.size)
        self._following = compile_flat(following, numbers.size, flat.size, 2)

    def begin(self, row: int) -> EpisodeStep:
        """Begin an episode with the plant of a row."""
        numbers, start = (layout.pack(part) for layout, part in zip(self._layouts, self._plants.row(row), strict=True))
        self._numbers = jnp.asarray(numbers)
        self._episode, values = self._first(self._numbers, start)
        return _step(values)

    def advance(self, action: ArrayLike) -> EpisodeStep:
        """Advance the episode."""
        self._episode, values = self._following(self._numbers, self._episode, np.asarray(action, float))
        return _step(values)


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
    """Episodes of many joints, compiled as C, or by XLA without a C compiler; finished episodes restart."""

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
        step = EpisodeStep(np.asarray(step.observation).T, *map(np.asarray, step[1:]))
        if over.any():
            first = self.begin(rows)
            moved = jax.tree.map(lambda new, old: np.where(over, new, old), self._episodes, moved)
            ended = over.reshape(-1, 1)
            rest = (np.where(over, 0, column).astype(column.dtype) for column in step[1:])
            step = EpisodeStep(np.where(ended, first, step.observation), *rest)
        self._episodes = moved
        return step


def _content(plant: JointPlant, state: PlantState) -> Array:
    """Air in both muscles as volumes at atmospheric pressure [L]; zero if a volume is unknown."""
    muscles = plant.joint.muscle1, plant.joint.muscle2
    if not all(muscle.specimen.has_volume for muscle in muscles):
        return jnp.zeros(2)
    volumes = plant.air_volumes(state)
    content = [air.volume * (pressure + atm) for air, pressure in zip(volumes, state.pressures, strict=True)]
    return jnp.stack(content) / (atm * litre)


def _observation(measured: Measurement, velocity: Array, setpoint: Setpoint) -> Array:
    """Observation in the units of `OBSERVATION`, within its limits; numbers that are not finite become 0 or a limit."""
    pressure1, pressure2 = measured.pressures
    observation = jnp.stack([measured.angle, velocity, pressure1 / bar, pressure2 / bar, *setpoint])
    limit = jnp.array([limit for _, limit in OBSERVATION.values()])
    return jnp.clip(jnp.nan_to_num(observation), -limit, limit)
