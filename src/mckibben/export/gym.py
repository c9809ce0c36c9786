"""Gymnasium environments, single and vectorised: a joint or robot that follows references of angle and stiffness.

Importing this module registers ``mckibben/Joint-v0``; ``gymnasium.make("mckibben.export.gym:mckibben/Joint-v0",
scenario="scenario.yaml")`` imports it automatically.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict, Unpack

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mckibben.component.calls import CheckedCalls
from mckibben.errors import ExportError
from mckibben.export.episodes import (
    ManyProgram,
    RewardTerms,
    ScenarioLike,
    Settings,
    SingleProgram,
    elements_of,
    example_of,
    plants_of,
)
from mckibben.numerics.compiled import numeric
from mckibben.units import bar

Floats = NDArray[np.float32]
Info = dict[str, Any]  # as Gymnasium has it
DEFAULT_REWARD = RewardTerms()


class Options(TypedDict, total=False):
    """Options of both environments, described in `JointEnv`."""

    random_plant: Sequence[str]
    repeat: int
    history: int
    reward: RewardTerms
    plants: int
    plants_seed: int


_MOST_HISTORY = 100


class Environment(metaclass=CheckedCalls):
    """Common part of both environments: plants, spaces, and settings of a step."""

    def __init__(
        self,
        scenario: ScenarioLike,
        *,
        random_plant: Sequence[str] = (),
        repeat: int = 1,
        history: int = 1,
        reward: RewardTerms = DEFAULT_REWARD,
        plants: int = 256,
        plants_seed: int = 0,
    ) -> None:
        self.scenario, random_plant = example_of(scenario, random_plant)
        nominal, reward = self.scenario.plant(), RewardTerms(*map(float, reward))
        if reward.air_price and not all(muscle.specimen.has_volume for muscle in nominal.muscles):
            raise ExportError(
                "the reward has a price of air, but the volume of a muscle is unknown",
                field="air_price",
                value=reward.air_price,
                remedy="give the specimen its initial_diameter and braid_angle, or an air_price of 0",
            )
        period = self.scenario.control_period
        periods = round(self.scenario.timing["duration"] / period)
        for name, value, most in (("repeat", repeat, periods), ("history", history, _MOST_HISTORY)):
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
                remedy = f"choose a whole number, 1 to {most}"
                raise ExportError(f"{name} is {value!r}", field=name, value=value, remedy=remedy)
        self.plants = plants_of(self.scenario, random_plant, plants, plants_seed)
        self.most_steps = -(-periods // repeat)
        self.options = {"substeps": self.scenario.needed_substeps(), "repeat": repeat, "history": history}
        joints = [f".{name}" for name in self.scenario.joint_names] or [""]
        muscles = [f".{name}" for name in self.scenario.muscle_names] or ["1", "2"]
        low, high = (np.array(nominal.clip_commands([limit] * len(muscles)), float) for limit in (-np.inf, np.inf))
        unit, shown = (1.0, "1") if self.scenario.valve.direct else (bar, "bar")
        self.settings = numeric(Settings(period, low, high, reward))
        units, largest = zip(*(elements := elements_of(joints, muscles, history)).values(), strict=True)
        limit = np.array(largest, np.float32)
        self.observation_space = Box(-limit, limit, dtype=np.float32)
        self.action_space = Box(-1, 1, low.shape, dtype=np.float32)
        ranges = zip(muscles, low.tolist(), high.tolist(), strict=True)
        self.metadata = {
            "render_modes": [],
            "observation_units": dict(zip(elements, units, strict=True)),
            "action_ranges": {f"command{end}": (x / unit, y / unit, shown) for end, x, y in ranges},
            "step": repeat * period,  # s
            "left_out": ("controller of the scenario", "its reference beyond the current period"),
        }


class JointEnv(gymnasium.Env[Floats, Floats]):
    """A joint or robot controlled by an agent for the duration of a scenario, whose controller is ignored.

    A step is `repeat` control periods. Actions of -1 to 1 map to commands from the lowest to the highest pressure of
    each muscle, or to valve openings if commands are `direct`; ``metadata["action_ranges"]`` has both in their unit.
    Observations are sensor values: angle [rad], velocity [rad/s] (the change of the measured angle over the last
    control period), gauge pressures [bar]; and the references of angle [rad] and stiffness [N*m/rad]. Each quantity of
    a robot has an element for each joint or muscle, such as ``angle.knee`` or ``pressure.knee1``. An episode is
    terminated if an angle error exceeds 90 deg, and truncated at the end of the scenario. `info` has the true
    stiffness [N*m/rad], an array over the joints of a robot, and the air used in the step [L].

    Raises `ScenarioError` or `ParameterError` for mistakes in scenario and parameters; `ExportError` if a robot follows
    no references, no plant has a start, or the reward needs an unknown volume; `UnreachableError` if the muscles of a
    robot cannot hold its start.

    Parameters
    ----------
    scenario
        Scenario, or its file; or a benchmark suite, whose conditions, and variations of its first reference, are then
        part of `random_plant`, each plant with its own sensor noise.
    random_plant
        Variations as for ``mckibben sweep``, such as ``load.mass2=+-50 %``: an episode uses one of `plants` plants,
        drawn with `plants_seed`. Parameters of the reference, of sensors, of disturbances and the delay of the commands
        may vary as well.
    repeat
        Control periods per step.
    history
        Observations in an observation, latest first, with the actions between them (at most 100), for plants with
        delays.
    reward
        Terms of the reward, see `RewardTerms`.
    """

    metadata: Info = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: ScenarioLike,
        *,
        render_mode: None = None,
        **options: Unpack[Options],
    ) -> None:
        self.render_mode = render_mode
        self.joint = Environment(scenario, **options)
        self.observation_space, self.action_space = self.joint.observation_space, self.joint.action_space
        self.metadata = self.joint.metadata
        self._program = SingleProgram(self.joint.plants, self.joint.settings, **self.joint.options)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Floats, Info]:
        """Begin an episode with one of the plants, drawn by the seed of the environment.

        Parameters
        ----------
        seed
            Seed of this and the following draws.
        options
            ``{"plant": 3}`` selects a plant in place of a draw.
        """
        super().reset(seed=seed)
        row = (options or {}).get("plant")
        row = int(self.np_random.integers(self.joint.plants.rows) if row is None else row)
        self._steps = 0
        return self._program.begin(row).astype(np.float32), {"plant": row}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, Info]:
        """Apply commands for a step.

        Returns the observation, the reward, whether the episode failed, whether the scenario is over, and `info`.
        """
        step = self._program.advance(action)
        self._steps += 1
        info = {"stiffness": np.asarray(step.stiffness)[()], "air": float(step.air)}
        observation, ended = np.asarray(step.observation, np.float32), self._steps >= self.joint.most_steps
        return observation, float(step.reward), bool(step.failed), ended, info


class JointVectorEnv(VectorEnv[Floats, Floats, NDArray[Any]]):
    """Many `JointEnv` in one compiled program; a finished episode restarts at the next step.

    All arrays have a row per environment; `info` has arrays too, and for each of them, with an underscore before its
    name, which rows are valid.

    Parameters
    ----------
    num_envs
        Number of environments. All other parameters are as for `JointEnv`.
    """

    def __init__(
        self,
        scenario: ScenarioLike,
        num_envs: int = 1,
        *,
        render_mode: None = None,
        **options: Unpack[Options],
    ) -> None:
        self.num_envs, self.render_mode = num_envs, render_mode
        self.joint = Environment(scenario, **options)
        self.single_observation_space, self.single_action_space = self.joint.observation_space, self.joint.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._program = ManyProgram(self.joint.plants, self.joint.settings, **self.joint.options)
        self.metadata = {**self.joint.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Floats, Info]:
        """Begin all episodes; one seed determines all of them."""
        super().reset(seed=seed)
        self._rows = self._draw()
        self._steps, self._over = np.zeros(self.num_envs, int), np.zeros(self.num_envs, bool)
        observations = self._program.begin(self._rows)
        return observations.astype(np.float32), {"plant": self._rows, "_plant": np.ones(self.num_envs, bool)}

    def step(self, actions: Floats) -> tuple[Floats, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Apply the commands of all environments for a step.

        One whose episode ended in the step before begins another; its action is ignored and its reward is 0.
        """
        if self._over.any():
            self._rows = np.where(self._over, self._draw(), self._rows)
        step = self._program.advance(self._rows, actions, self._over)
        self._steps = np.where(self._over, 0, self._steps + 1)
        failed, ended = np.asarray(step.failed, bool), self._steps >= self.joint.most_steps
        self._over = failed | ended
        info: Info = {"stiffness": step.stiffness, "air": step.air, "plant": self._rows}
        info |= {f"_{name}": np.ones(self.num_envs, bool) for name in info}
        return np.asarray(step.observation, np.float32), np.asarray(step.reward), failed, ended, info

    def _draw(self) -> NDArray[np.int64]:
        """A plant for each environment."""
        return self.np_random.integers(self.joint.plants.rows, size=self.num_envs)


gymnasium.register(
    id="mckibben/Joint-v0",
    entry_point="mckibben.export.gym:JointEnv",
    vector_entry_point="mckibben.export.gym:JointVectorEnv",
)
