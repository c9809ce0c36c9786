"""Runs of Figs. 7 and 8: PID and BP, with moderate and with tuned gains, in both geometries, over many seeds."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mckibben.control import Setpoint
from mckibben.paper.settings import (
    BOUND,
    FREE,
    SETTINGS,
    Setting,
    StiffnessReference,
    bp_scenario,
    gains_of,
    pid_scenario,
)
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import Metrics, SimulationResult, rms, run_episode, sampled
from mckibben.study.tune import Cost, TuneResult, gain_ranges, tune
from mckibben.study.tune.search import Costs, Vector
from mckibben.units import quantity

PID, BP, DOUBLED_PID, TUNED_PID = "PID", "BP", "PID, position gains doubled", "PID tuned"
TUNED_BP, FREE_TUNED_BP = "BP on tuned gains", "BP on tuned gains, free"
CONTROLLERS = (PID, BP, DOUBLED_PID, TUNED_PID, TUNED_BP, FREE_TUNED_BP)
_GAIN_MARGIN = 1.5


@dataclass(frozen=True)
class ControllerRun:
    """A run, and the metrics over seeds.

    A metric that is not finite, such as the settling time of a run that never settles, ranks above all others.

    Parameters
    ----------
    scenario, result
        The scenario and its run; for BP, with the first seed.
    seeds
        Metrics of each seed in SI, arrays of shape (seeds,); None for a controller without seeds.
    """

    scenario: Scenario
    result: SimulationResult
    seeds: Metrics | None

    def median(self, metric: str) -> float:
        """Median over the seeds, NaN ranking above all values; without seeds the value itself."""
        return self._ranked(np.median, metric)

    def worst(self, metric: str) -> float:
        """Maximum over the seeds."""
        return self._ranked(np.max, metric)

    @property
    def unstable(self) -> int:
        """Number of unstable runs: not finite, or an angle RMSE above the RMS of the reference."""
        reference = float(rms(self.result["desired_angle"]))
        return int(np.sum(~(self._values("angle_rmse") < reference)))

    def _ranked(self, take: Callable[[np.ndarray], np.floating], metric: str) -> float:
        value = float(take(np.nan_to_num(self._values(metric), nan=np.inf, posinf=np.inf)))
        return value if np.isfinite(value) else np.nan

    def _values(self, metric: str) -> np.ndarray:
        if self.seeds is None:
            return np.array([self.result.metrics[metric]])
        return np.asarray(getattr(self.seeds, metric))


_Runs = dict[tuple[str, StiffnessReference, str], ControllerRun]


@dataclass(frozen=True)
class Coupling:
    """Mutual disturbance of position and stiffness under PID with moderate gains.

    Parameters
    ----------
    angle_by_step
        Largest change [rad] of the angle by the step of the stiffness.
    stiffness_by_motion, stiffness_at_rest
        RMS error [N*m/rad] of the stiffness in the second half of a run in motion, and of one at rest.
    """

    angle_by_step: float
    stiffness_by_motion: float
    stiffness_at_rest: float


@dataclass(frozen=True)
class Tracking:
    """Runs of the paper's simulations.

    Parameters
    ----------
    runs
        Runs by setting key, stiffness reference and controller (`CONTROLLERS`).
    tuned, coupling
        Tuning of the PID gains, and coupling, by setting key.
    seeds
        Number of initial weights of BP.
    """

    runs: _Runs
    tuned: dict[str, TuneResult]
    coupling: dict[str, Coupling]
    seeds: int


def run_tracking(
    *, seeds: int, generations: int, population: int = 32, progress: Callable[[float], None] | None = None
) -> Tracking:
    """Tune, run and compare all controllers in both geometries, with constant and stepping stiffness.

    Parameters
    ----------
    seeds
        Number of initial weights of BP; the metrics are medians over them.
    generations, population
        Size of the tuning of the PID gains by differential evolution, on both references together.
    progress
        Called with the fraction done, 0 to 1.
    """
    report = progress or (lambda fraction: None)
    count = len(SETTINGS)
    with ThreadPoolExecutor(max_workers=1) as pool:  # both spend most time compiling, on one core each
        moderate = pool.submit(_moderate_runs, seeds)
        tuned = {
            setting.key: _tune(
                setting, generations, population, lambda fraction, i=i: report(0.7 * (i + fraction) / count)
            )
            for i, setting in enumerate(SETTINGS)
        }
        runs = moderate.result()
    for i, setting in enumerate(SETTINGS, start=1):
        runs |= _tuned_runs(setting, tuned[setting.key], seeds)
        report(0.7 + 0.3 * i / count)
    step = StiffnessReference.STEP
    coupling = {setting.key: _coupling(setting, runs[setting.key, step, PID]) for setting in SETTINGS}
    return Tracking(runs, tuned, coupling, seeds)


def _moderate_runs(seeds: int) -> _Runs:
    """Runs with gains set by hand: PID, BP, and PID with doubled position gains."""
    runs: _Runs = {}
    for setting, reference in itertools.product(SETTINGS, StiffnessReference):
        pid = pid_scenario(setting, reference)
        doubled = {name: gain * (1 + name.startswith("position")) for name, gain in gains_of(pid).items()}
        runs[setting.key, reference, PID] = _run_pid(pid)
        runs[setting.key, reference, BP] = _run_bp(bp_scenario(setting, reference), seeds)
        more = pid_scenario(setting, reference, doubled, name=DOUBLED_PID)
        runs[setting.key, reference, DOUBLED_PID] = _run_pid(more)
    return runs


def _tuned_runs(setting: Setting, tuned: TuneResult, seeds: int) -> _Runs:
    """Runs of a setting with tuned gains: PID, and BP that may change them by 10 % or by a factor of 2."""
    gains = gains_of(tuned.scenarios[0])
    runs: _Runs = {}
    for reference in StiffnessReference:
        base = pid_scenario(setting, reference, gains, name=TUNED_PID)
        runs[setting.key, reference, TUNED_PID] = _run_pid(base)
        for name, ratio in ((TUNED_BP, BOUND), (FREE_TUNED_BP, FREE)):
            scenario = bp_scenario(setting, reference, gains, gain_ratio=ratio, name=name)
            runs[setting.key, reference, name] = _run_bp(scenario, seeds)
    return runs


def _tune(setting: Setting, generations: int, population: int, progress: Callable[[float], None]) -> TuneResult:
    """Tune the PID gains of a setting on both stiffness references, with a gain margin of 1.5."""
    scenarios = [pid_scenario(setting, reference) for reference in StiffnessReference]
    scales = {
        "angle_rmse": quantity(setting.angle_scale, "rad") / 10,
        "stiffness_rmse": quantity(setting.stiffness_scale, "N*m/rad") / 10,
    }
    return tune(
        scenarios,
        gain_ranges(scenarios[0], 2.0),
        Cost.of(scales, gain_margin=_GAIN_MARGIN, disk_margin=0.0),
        method=_by_evolution,
        iterations=generations,
        population=population,
        progress=lambda _, fraction: progress(fraction),
    )


def _by_evolution(
    costs: Costs, first: Vector, *, population: int, generations: int, seed: int, progress: Callable[[float], object]
) -> None:
    """Differential evolution (Storn and Price, J. Global Optim. 11 (1997) 341) from random points and the first one."""
    from scipy.optimize import differential_evolution  # 0.3 s at import

    steps = itertools.count(1)
    differential_evolution(
        lambda columns: costs(columns.T),
        [(0.0, 1.0)] * first.size,
        x0=first,
        init=np.random.default_rng(seed).uniform(0.0, 1.0, (population, first.size)),
        maxiter=generations,
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
        rng=seed,
        callback=lambda *_: progress(min(next(steps) / generations, 1.0)),
    )


def _run_pid(scenario: Scenario) -> ControllerRun:
    return ControllerRun(scenario, run_scenario(scenario), None)


def _steps(scenario: Scenario) -> tuple[float, int | None]:
    return scenario.control_period, scenario.substeps


def _run_bp(scenario: Scenario, seeds: int) -> ControllerRun:
    plant = scenario.plant()
    _, setpoints = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    control, initial = scenario.control(), scenario.initial(plant)

    def metrics(seed: int) -> Metrics:
        seeded = eqx.tree_at(lambda c: (c.position.seed, c.stiffness.seed), control, (seed, seed))
        run = run_episode(plant, seeded, setpoints, initial, *_steps(scenario))
        return Metrics(**run.metrics)

    # One by one, with the program of the single run: a batch would need another compilation.
    by_seed = [metrics(seed) for seed in range(seeds)]
    return ControllerRun(scenario, run_scenario(scenario), jax.tree.map(lambda *m: jnp.stack(m), *by_seed))


def _coupling(setting: Setting, stepping: ControllerRun) -> Coupling:
    """Coupling from the run with the step and two runs at constant stiffness, in motion and at rest."""
    scenario = pid_scenario(setting, StiffnessReference.CONSTANT)
    plant = scenario.plant()
    _, moving = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    at_rest = moving._replace(angle=jnp.zeros_like(moving.angle))
    control, start = scenario.control(), scenario.initial(plant)

    def late_error(setpoints: Setpoint) -> float:
        run = run_episode(plant, control, setpoints, start, *_steps(scenario))
        late = run["angle"].size // 2
        return float(rms((run["stiffness"] - run["desired_stiffness"])[late:]))

    return Coupling(
        angle_by_step=stepping.result.metrics["coupling"],
        stiffness_by_motion=late_error(moving),
        stiffness_at_rest=late_error(at_rest),
    )
