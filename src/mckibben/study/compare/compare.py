"""Comparison of controllers: tuned with one budget, compared on the same evaluation runs."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from mckibben.errors import McKibbenError
from mckibben.notebook import Progress, notebook_progress, silent
from mckibben.scenario import ModelFollows
from mckibben.storage.store import STUDY, open_store
from mckibben.study.compare.changes import on_changed_plants
from mckibben.study.compare.result import CompareResult
from mckibben.study.compare.runs import draw, evaluate
from mckibben.study.compare.statistics import trial_at_air
from mckibben.study.compare.suite import ControllerSuite, Suite
from mckibben.study.compare.tuning import ControllerTuning
from mckibben.study.tune.space import SearchSpace


def runs_of(suite: ControllerSuite, name: str) -> int:
    """Runs that the comparison takes for a controller, of its tuning, finalists and evaluation.

    >>> from mckibben.study.compare import Suite
    >>> suite = Suite.read("examples/comparison/valves.yaml").of_setup("Festo VPPE-6")
    >>> [runs_of(suite, name) for name in ("PID", "decoupling")]
    [7290, 7290]
    """
    tuning, evaluations = suite.tuning, suite.evaluation.runs
    if not suite.tuned_over(name):
        return evaluations
    trials = tuning.starts * tuning.candidates + (tuning.starts + 1) * tuning.generations * tuning.population
    return trials * tuning.runs + tuning.finalists * tuning.finalist_runs + 2 * evaluations


def compare(
    suite: ControllerSuite,
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> CompareResult:
    """Tune the controllers of a suite and compare them on its evaluation runs.

    Parameters
    ----------
    suite
        Plants, references, conditions and controllers.
    out, resume
        Folder of the study, whose file study.sqlite keeps every trial of all controllers, and whether to continue it.
        Default: nothing is kept.
    progress
        Called with the current step and the completed fraction, 0 to 1. Default: a progress bar in notebooks.

    Raises
    ------
    ParameterError
        If a controller has nothing to tune, no trial succeeds, or no run can start.
    FileError
        As for `tune`.
    """
    progress = progress or notebook_progress() or silent
    training = draw(suite, suite.tuning.runs, suite.tuning.seed)
    evaluation = draw(suite, suite.evaluation.runs, suite.evaluation.seed)
    names = list(suite.controllers)
    efforts = [runs_of(suite, name) for name in names]
    result, at_air = (CompareResult(suite, evaluation, {}, {}, {}, {}) for _ in range(2))
    calibrated = None
    if isinstance(suite, Suite) and suite.calibration is not None:
        calibrated, possible = evaluation.calibrated(partial(progress, "calibration of the models"))
        result = replace(result, calibrated_runs=possible)
    with open_store(None if out is None else Path(out) / STUDY, resume=resume) as store:
        for number, name in enumerate(names):

            def report(task: str, fraction: float, name: str = name, number: int = number) -> None:
                done = sum(efforts[:number]) + fraction * efforts[number]
                progress(f"{name} ({number + 1} of {len(names)}): {task}", done / sum(efforts))

            result.tuned[name], result.at_bound[name] = {}, ()
            if swept := suite.tuned_over(name):
                air = None if number == 0 else result.training_air(names[0])
                wrapped = suite.tuned_inside(name, result.tuned)
                task = ControllerTuning(suite, name, SearchSpace(swept), training, air, wrapped)
                report("tuning", 0.0)
                tuned = task.run(store, lambda fraction: report("tuning", 0.98 * fraction))
                result.tuned[name], result.training_cost[name], result.at_bound[name] = tuned[:3]
                result.trials[name], result.finalists[name] = tuned.trials, tuned.finalists
                trial = trial_at_air(tuned.trials, result.training_air(names[0]))
                if trial is not None:
                    at_air.tuned[name] = task.values(trial)
            report("evaluation runs, the last part", 0.98)
            for kind in (result, at_air):
                if name in kind.tuned:
                    kind.batches[name] = evaluate(evaluation, name, kind.tuned[name])
            if calibrated is not None:
                result.calibrated[name] = evaluate(calibrated, name, result.tuned[name])
            with suppress(McKibbenError):  # its run cannot start or diverges, as the table shows
                result.margins[name] = suite.tuned_scenario(name, result.tuned[name]).margins()
            follows: ModelFollows = "all" if name in suite.true_model else ()
            result.changed[name] = on_changed_plants(suite.tuned_scenario(name, result.tuned[name]), follows)
    progress("done", 1.0)
    return replace(result, at_air=at_air) if at_air.batches else result
