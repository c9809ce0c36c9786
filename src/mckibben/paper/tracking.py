"""The runs behind Figs. 7 and 8: PID and BP, on moderate and on tuned gains, in both geometries, over many seeds."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mckibben.control import Setpoint
from mckibben.paper.settings import BOUND, FREE, SETTINGS, Setting, Wish, bp_scenario, gains_of, pid_scenario
from mckibben.simulation import (
    SETTLING_PART,
    Metrics,
    Result,
    compiled_measure,
    rms,
    run_episode,
    sampled,
)
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.running import run_scenario
from mckibben.study.tune import Cost, Method, TuningResult, gain_ranges, tune
from mckibben.units import quantity

PID, BP, TUNED_PID = "PID", "BP", "PID tuned"
TUNED_BP, FREE_TUNED_BP = "BP on tuned gains", "BP on tuned gains, free"
_MARGIN = 1.5  # all tuned gains may rise by this factor together without harm
CONTROLLERS = (PID, BP, TUNED_PID, TUNED_BP, FREE_TUNED_BP)


@dataclass(frozen=True)
class Run:
    """One controller on one wish in one geometry.

    Attributes
    ----------
    scenario, result
        The run that the figures show (for BP that of the first seed).
    seeds
        Metrics over the seeds, each of shape (seeds,), where the controller has a seed.
    """

    scenario: Scenario
    result: Result
    seeds: Metrics | None

    def median(self, metric: str) -> float:
        """The median over the seeds, a run that never settles being the longest; without seeds the value itself."""
        return _finite(np.median(self._ranked(metric)))

    def worst(self, metric: str) -> float:
        """The largest over the seeds."""
        return _finite(np.max(self._ranked(metric)))

    @property
    def lost(self) -> int:
        """How many runs were lost: not finite, or worse than not moving at all (an RMSE above the RMS of the wish)."""
        wish = float(rms(self.result.trajectory.desired_angle))
        return int(np.sum(~(self._values("angle_rmse") < wish)))

    def _ranked(self, metric: str) -> np.ndarray:
        """The values, with NaN (never settled, lost) as the largest of all."""
        values = self._values(metric)
        return np.where(np.isnan(values), np.inf, values)

    def _values(self, metric: str) -> np.ndarray:
        if self.seeds is None:
            return np.array([self.result.metrics()[metric]])
        return np.asarray(getattr(self.seeds, metric))


@dataclass(frozen=True)
class Coupling:
    """How position and stiffness disturb each other under PID with moderate gains.

    Attributes
    ----------
    angle_by_step
        The largest difference of the angle [rad] between a run with the stiffness step and one without it, after the
        step.
    stiffness_by_motion
        RMS error of the stiffness [N*m/rad] over the second half of a run with constant desired stiffness, the angle
        moving.
    stiffness_at_rest
        The same with the desired angle held at 0.
    """

    angle_by_step: float
    stiffness_by_motion: float
    stiffness_at_rest: float


@dataclass(frozen=True)
class Tracking:
    """All runs, by setting, wish and controller.

    Attributes
    ----------
    runs
        Keys (setting key, wish, controller name).
    tuned, coupling
        By setting key.
    seeds
        How many seeds BP was run with.
    """

    runs: dict[tuple[str, Wish, str], Run]
    tuned: dict[str, TuningResult]
    coupling: dict[str, Coupling]
    seeds: int


def run_tracking(
    *, seeds: int, generations: int, population: int = 32, progress: Callable[[float], None] | None = None
) -> Tracking:
    """Run everything.

    Parameters
    ----------
    seeds
        How many initial networks BP is run with.
    generations, population
        Of the tuning.
    progress
        Called with the part that is done, 0 to 1.
    """
    # The runs on moderate gains do not wait for the tuning: what takes time in both is their compilation.
    with ThreadPoolExecutor(max_workers=1) as beside:
        moderate = beside.submit(_moderate_runs, seeds)
        tuned: dict[str, TuningResult] = {}
        for i, setting in enumerate(SETTINGS):

            def report(part: float, start: float = i / len(SETTINGS)) -> None:
                if progress:
                    progress(0.7 * (start + part / len(SETTINGS)))

            tuned[setting.key] = _tune(setting, generations, population, report)
        runs = moderate.result()
    for i, setting in enumerate(SETTINGS):
        runs |= _tuned_runs(setting, tuned[setting.key], seeds)
        if progress:
            progress(0.7 + 0.3 * (i + 1) / len(SETTINGS))
    coupling = {setting.key: _coupling(setting, runs[setting.key, Wish.STEP, PID]) for setting in SETTINGS}
    return Tracking(runs, tuned, coupling, seeds)


def _moderate_runs(seeds: int) -> dict[tuple[str, Wish, str], Run]:
    runs: dict[tuple[str, Wish, str], Run] = {}
    for setting in SETTINGS:
        for wish in Wish:
            runs[setting.key, wish, PID] = _run_pid(pid_scenario(setting, wish, name=PID))
            runs[setting.key, wish, BP] = _run_bp(bp_scenario(setting, wish, gain_ratio=FREE, name=BP), seeds)
    return runs


def _tuned_runs(setting: Setting, tuned: TuningResult, seeds: int) -> dict[tuple[str, Wish, str], Run]:
    gains = gains_of(tuned.scenarios[0])
    runs: dict[tuple[str, Wish, str], Run] = {}
    for wish in Wish:
        runs[setting.key, wish, TUNED_PID] = _run_pid(pid_scenario(setting, wish, gains, name=TUNED_PID))
        for name, ratio in ((TUNED_BP, BOUND), (FREE_TUNED_BP, FREE)):
            scenario = bp_scenario(setting, wish, gains, gain_ratio=ratio, name=name)
            runs[setting.key, wish, name] = _run_bp(scenario, seeds)
    return runs


def _tune(setting: Setting, generations: int, population: int, progress: Callable[[float], None]) -> Tuned:
    scenarios = [pid_scenario(setting, wish) for wish in Wish]
    scales = {
        "angle_rmse": quantity(setting.angle_scale, "rad") / 10,
        "stiffness_rmse": quantity(setting.stiffness_scale, "N*m/rad") / 10,
    }
    return tune(
        scenarios,
        gain_ranges(scenarios[0]),
        Cost.of(scales, gain_margin=_MARGIN),
        method=Method.EVOLUTION,
        iterations=generations,
        population=population,
        progress=progress,
    )


def _run_pid(scenario: Scenario) -> Run:
    return Run(scenario, run_scenario(scenario).result, None)


def _run_bp(scenario: Scenario, seeds: int) -> Run:
    plant = scenario.plant()
    _, wishes = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    control, initial = scenario.control(), scenario.initial(plant)

    def measured(seed: int) -> Metrics:
        seeded = eqx.tree_at(lambda c: (c.position.seed, c.stiffness.seed), control, (seed, seed))
        moved, _ = run_episode(plant, seeded, wishes, initial, scenario.control_period, scenario.substeps)
        return compiled_measure(moved, scenario.control_period, settling_part=SETTLING_PART)

    # One by one: the programs are those of the single run, and a batch would first have to be compiled.
    over_seeds = [measured(seed) for seed in range(seeds)]
    return Run(scenario, run_scenario(scenario).result, jax.tree.map(lambda *each: jnp.stack(each), *over_seeds))


def _coupling(setting: Setting, stepping: Run) -> Coupling:
    """From the run with the step, and two more with the constant wish: the angle moving, and held."""
    scenario = pid_scenario(setting, Wish.CONSTANT)
    plant = scenario.plant()
    _, moving = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    held = moving._replace(angle=jnp.zeros_like(moving.angle))
    control, start = scenario.control(), scenario.initial(plant)

    def late_error(wishes: Setpoint) -> float:
        moved, _ = run_episode(plant, control, wishes, start, scenario.control_period, scenario.substeps)
        late = moved.angle.size // 2
        return float(rms((moved.stiffness - moved.desired_stiffness)[late:]))

    return Coupling(
        angle_by_step=stepping.result.metrics()["coupling"],
        stiffness_by_motion=late_error(moving),
        stiffness_at_rest=late_error(held),
    )


def _finite(value: np.floating) -> float:
    return float(value) if np.isfinite(value) else float("nan")
