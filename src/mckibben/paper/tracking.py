"""Runs of Figs. 7 and 8: PID and BP, on moderate and on tuned gains, in both geometries, over many seeds."""

from __future__ import annotations

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
from mckibben.simulation import (
    Metrics,
    Result,
    rms,
    run_episode,
    sampled,
)
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.building import run_scenario
from mckibben.study.tune import Cost, Method, TuningResult, gain_ranges, tune
from mckibben.units import quantity

PID, BP, TUNED_PID = "PID", "BP", "PID tuned"
TUNED_BP, FREE_TUNED_BP = "BP on tuned gains", "BP on tuned gains, free"
CONTROLLERS = (PID, BP, TUNED_PID, TUNED_BP, FREE_TUNED_BP)
_GAIN_MARGIN = 1.5


@dataclass(frozen=True)
class ControllerRun:
    """Run of one controller with one stiffness reference in one geometry.

    Attributes
    ----------
    scenario, result
        The run in the figures; for BP that of the first seed.
    seeds
        Metrics of each seed, shape (seeds,); None for a controller without seeds.
    """

    scenario: Scenario
    result: Result
    seeds: Metrics | None

    def median(self, metric: str) -> float:
        """Median over the seeds, NaN ranking above all values; without seeds the value itself."""
        return _finite(np.median(self._ranked(metric)))

    def worst(self, metric: str) -> float:
        """Maximum over the seeds."""
        return _finite(np.max(self._ranked(metric)))

    @property
    def unstable(self) -> int:
        """Number of unstable runs: not finite, or an angle RMSE above the RMS of the reference."""
        reference = float(rms(self.result["desired_angle"]))
        return int(np.sum(~(self._values("angle_rmse") < reference)))

    def _ranked(self, metric: str) -> np.ndarray:
        values = self._values(metric)
        return np.where(np.isnan(values), np.inf, values)

    def _values(self, metric: str) -> np.ndarray:
        if self.seeds is None:
            return np.array([self.result.metrics[metric]])
        return np.asarray(getattr(self.seeds, metric))


@dataclass(frozen=True)
class Coupling:
    """Mutual disturbance of position and stiffness under PID with moderate gains.

    Attributes
    ----------
    angle_by_step
        Largest change of the angle by the stiffness step [rad].
    stiffness_by_motion
        RMS error of a constant stiffness over the second half of a run in motion [N*m/rad].
    stiffness_at_rest
        The same at a desired angle of 0.
    """

    angle_by_step: float
    stiffness_by_motion: float
    stiffness_at_rest: float


@dataclass(frozen=True)
class Tracking:
    """All tracking runs.

    Attributes
    ----------
    runs
        By setting key, stiffness reference and controller name.
    tuned, coupling
        By setting key.
    seeds
        Number of seeds of BP.
    """

    runs: dict[tuple[str, StiffnessReference, str], ControllerRun]
    tuned: dict[str, TuningResult]
    coupling: dict[str, Coupling]
    seeds: int


def run_tracking(
    *, seeds: int, generations: int, population: int = 32, progress: Callable[[float], None] | None = None
) -> Tracking:
    """Tune, run and compare all controllers.

    Parameters
    ----------
    seeds
        Number of initial networks of BP.
    generations, population
        Of the tuning.
    progress
        Called with the fraction done, 0 to 1.
    """
    with ThreadPoolExecutor(max_workers=1) as beside:  # most of both is compilation, which uses one core each
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
    step = StiffnessReference.STEP
    coupling = {setting.key: _coupling(setting, runs[setting.key, step, PID]) for setting in SETTINGS}
    return Tracking(runs, tuned, coupling, seeds)


def _moderate_runs(seeds: int) -> dict[tuple[str, StiffnessReference, str], ControllerRun]:
    runs: dict[tuple[str, StiffnessReference, str], ControllerRun] = {}
    for setting in SETTINGS:
        for reference in StiffnessReference:
            learned = bp_scenario(setting, reference, gain_ratio=FREE, name=BP)
            runs[setting.key, reference, PID] = _run_pid(pid_scenario(setting, reference, name=PID))
            runs[setting.key, reference, BP] = _run_bp(learned, seeds)
    return runs


def _tuned_runs(
    setting: Setting, tuned: TuningResult, seeds: int
) -> dict[tuple[str, StiffnessReference, str], ControllerRun]:
    gains = gains_of(tuned.scenarios[0])
    runs: dict[tuple[str, StiffnessReference, str], ControllerRun] = {}
    for reference in StiffnessReference:
        base = pid_scenario(setting, reference, gains, name=TUNED_PID)
        runs[setting.key, reference, TUNED_PID] = _run_pid(base)
        for name, ratio in ((TUNED_BP, BOUND), (FREE_TUNED_BP, FREE)):
            scenario = bp_scenario(setting, reference, gains, gain_ratio=ratio, name=name)
            runs[setting.key, reference, name] = _run_bp(scenario, seeds)
    return runs


def _tune(setting: Setting, generations: int, population: int, progress: Callable[[float], None]) -> TuningResult:
    scenarios = [pid_scenario(setting, reference) for reference in StiffnessReference]
    scales = {
        "angle_rmse": quantity(setting.angle_scale, "rad") / 10,
        "stiffness_rmse": quantity(setting.stiffness_scale, "N*m/rad") / 10,
    }
    return tune(
        scenarios,
        gain_ranges(scenarios[0]),
        Cost.of(scales, gain_margin=_GAIN_MARGIN),
        method=Method.EVOLUTION,
        iterations=generations,
        population=population,
        progress=progress,
    )


def _run_pid(scenario: Scenario) -> ControllerRun:
    return ControllerRun(scenario, run_scenario(scenario).result, None)


def _run_bp(scenario: Scenario, seeds: int) -> ControllerRun:
    plant = scenario.plant()
    _, setpoints = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    control, initial = scenario.control(), scenario.initial(plant)

    def metrics(seed: int) -> Metrics:
        seeded = eqx.tree_at(lambda c: (c.position.seed, c.stiffness.seed), control, (seed, seed))
        run = run_episode(plant, seeded, setpoints, initial, scenario.control_period, scenario.substeps)
        return Metrics(**run.metrics)  # type: ignore[arg-type]

    # One by one, with the programs of the single run: a batch would need another compilation.
    each = [metrics(seed) for seed in range(seeds)]
    return ControllerRun(scenario, run_scenario(scenario).result, jax.tree.map(lambda *m: jnp.stack(m), *each))


def _coupling(setting: Setting, stepping: ControllerRun) -> Coupling:
    """Coupling from the run with the step and two runs at constant stiffness, in motion and at rest."""
    scenario = pid_scenario(setting, StiffnessReference.CONSTANT)
    plant = scenario.plant()
    _, moving = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    at_rest = moving._replace(angle=jnp.zeros_like(moving.angle))
    control, start = scenario.control(), scenario.initial(plant)

    def late_error(setpoints: Setpoint) -> float:
        run = run_episode(plant, control, setpoints, start, scenario.control_period, scenario.substeps)
        late = run["angle"].size // 2
        return float(rms((run["stiffness"] - run["desired_stiffness"])[late:]))

    return Coupling(
        angle_by_step=stepping.result.metrics["coupling"],
        stiffness_by_motion=late_error(moving),
        stiffness_at_rest=late_error(at_rest),
    )


def _finite(value: np.floating) -> float:
    return float(value) if np.isfinite(value) else float("nan")
