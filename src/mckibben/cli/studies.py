"""`mckibben sweep`, `tune` and `compare`: studies of scenarios, kept in one file, which can be resumed."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.cli.command import command
from mckibben.cli.options import Progress, ScenarioFile, check_results, echo, required_folder
from mckibben.errors import ParameterError, ScenarioError
from mckibben.storage.files import atomic_write, make_folder
from mckibben.storage.store import STUDY

if TYPE_CHECKING:
    from mckibben.result import Result
    from mckibben.scenario import StudiedScenario
    from mckibben.study.compare import CompareResult
    from mckibben.study.compare.result import PooledResult
    from mckibben.study.compare.suite import ControllerSuite
    from mckibben.study.tune import TuneResult

Texts = list[str] | None


@command
def sweep(
    scenario: ScenarioFile,
    over: Texts = None,
    model_follows: Texts = None,
    list_: bool = False,
    design: str | None = None,
    samples: int | None = None,
    seed: int | None = None,
    engine: str = "auto",
    dask: str | None = None,
    *,
    out: Path | None,
    resume: bool,
    force: bool,
    progress: Progress = None,
) -> Result:
    """Run a scenario over ranges of its parameters; finished runs are kept, and the sweep can be resumed.

    Parameters
    ----------
    over : 'NAME=RANGE'
        Parameter and its range, such as 'load.mass2=0.2 kg..1.0 kg', 'load.damping=+-50 %' or
        'controller.position.kp=0.2..20 bar/rad log'; repeatable. `mckibben sweep SCENARIO.yaml --list` lists the names.
    model_follows : NAME
        Varied plant parameter that the controller's model follows, or 'all'; repeatable. Default: the controller's
        model keeps the values of the file.
    list_
        List the parameters that can be varied, and exit.
    design : KIND
        Design: sobol (default), random or grid.
    samples : N
        Number of runs (default 1024), not for a grid.
    seed : N
        Seed of the design (default 0).
    engine : auto|native|xla|cuda
        auto: the C compiler's programs where possible, else XLA's; cuda: kernels on an NVIDIA GPU (extra gpu).
    dask : ADDRESS
        tcp://HOST:PORT of a dask scheduler, to whose workers the runs go. Default: threads.
    """
    from mckibben.scenario import Scenario

    read = Scenario.read(scenario)
    if list_:
        from mckibben.study.parameters.listing import ParameterList

        return ParameterList.of(read)
    out = required_folder(out, "sweep")
    from mckibben.study.sweep import SweepResult
    from mckibben.study.sweep import sweep as run

    check_results(out, SweepResult.file_names(), resume=resume, force=force)
    return run(
        read,
        over or None,
        out=out,
        design=design,
        samples=samples,
        seed=seed,
        model_follows=_followed(model_follows) or None,
        engine=engine,
        resume=resume,
        dask=dask,
        progress=progress,
    )


@command
def tune(
    scenarios: list[Path],
    over: Texts = None,
    model_follows: Texts = None,
    cost: str | None = None,
    method: str | None = None,
    margin: float | None = None,
    disk_margin: float | None = None,
    conditions: Texts = None,
    percentile: float | None = None,
    iterations: int = 30,
    seed: int | None = None,
    *,
    out: Path | None,
    resume: bool,
    force: bool,
    progress: Progress = None,
) -> TuneResult:
    """Minimise a cost over gains or other parameters of scenarios (default: all gains); a search can be resumed.

    Parameters
    ----------
    scenarios : SCENARIO.yaml...
        Scenarios whose costs are combined.
    over : 'NAME=RANGE'
        Parameter and its range, such as 'load.mass2=0.2 kg..1.0 kg', 'load.damping=+-50 %' or
        'controller.position.kp=0.2..20 bar/rad log'; repeatable. `mckibben sweep SCENARIO.yaml --list` lists the names.
    model_follows : NAME
        Varied plant parameter that the controller's model follows, or 'all'; repeatable. Default: the controller's
        model keeps the values of the file.
    cost : TERMS
        Sum of metrics, each divided by its scale (default: 'angle_rmse/0.1 deg + stiffness_rmse/0.1 N*m/rad').
    method : cma|local
        Search by CMA-ES (default), or local refinement of the given values.
    margin : FACTOR
        Gain margin (default: 1, none): the cost covers gains larger by this factor.
    disk_margin : ALPHA
        Least disk margin (default: 0.2) of the linearised loop in all scenarios and conditions (without any: for the
        uncertainty of the plant, which the cost covers, too), such as 0.4; 0 for none, and the nominal plant alone. If
        no gains have it, the exit code is 1, and the file is NAME-without-margin.yaml.
    conditions : 'NAME=RANGE'
        Parameter, such as 'load.mass2=+-50 %'; 16 draws are simulated for each point; repeatable.
    percentile : PERCENT
        Minimise this percentile of the cost over scenarios and conditions, 100 for the worst one, in place of
        the mean.
    iterations : N
        Generations, or steps of the refinement.
    seed : N
        Seed of the search (default 0).
    """
    from mckibben.scenario import Scenario
    from mckibben.study.parameters import parse_sweeps, sample
    from mckibben.study.parameters.sampling import check_count
    from mckibben.study.scenarios import begun_settings
    from mckibben.study.tune import TuneResult, parse_ranges
    from mckibben.study.tune import tune as run
    from mckibben.study.tune.tune import FORMAT, cost_of

    check_count("iterations", iterations, 1, 10**9)
    read = [Scenario.read(path) for path in scenarios]
    texts = [path.read_text(encoding="utf-8-sig") for path in scenarios]
    ranges = parse_ranges(over, read[0]) if over else None
    begun = begun_settings(out, FORMAT, resume=resume)
    target = cost_of(read[0], begun, cost=cost, gain_margin=margin, percentile=percentile, disk_margin=disk_margin)
    if percentile is not None and len(read) == 1 and not (conditions or begun.get("conditions")):
        raise ParameterError("--percentile applies to conditions", remedy="add --conditions 'NAME=RANGE'")
    draws = begun.get("seed", 0) if seed is None else seed
    drawn = sample(parse_sweeps(conditions, read[0]), samples=16, seed=draws) if conditions else None
    for name, values in (drawn or {}).items():
        if values.min() == values.max():
            raise ParameterError(f"the condition {name} does not vary", field=name, remedy="give a range")
    out = required_folder(out, "search")  # after the mistakes of other options
    names, refused = _tuned_names(scenarios, "tuned"), _tuned_names(scenarios, "without-margin")
    check_results(out, (*TuneResult.file_names(), *names, *refused), resume=resume, force=force)
    tuned = run(
        read,
        ranges,
        target,
        method=method,
        iterations=iterations,
        seed=seed,
        out=out,
        resume=resume,
        model_follows=_followed(model_follows) or None,
        conditions=drawn,
        progress=progress,
    )
    written = zip(tuned.scenarios, texts, scenarios, strict=True)
    names = names if tuned.keeps_margin else refused
    return tuned.with_files({name: partial(_write_tuned, tuned, *of) for name, of in zip(names, written, strict=True)})


@command
def compare(
    suite: Path, quick: bool = False, *, out: Path | None, resume: bool, force: bool, progress: Progress = None
) -> CompareResult | PooledResult:
    """Tune controllers with the same budget, and compare them on the same unseen runs.

    Parameters
    ----------
    suite : SUITE.yaml
        Suite file, see examples/comparison; or a scenario, compared with PID loops and decoupling.
    quick
        Short searches, at most 128 runs.
    """
    out = required_folder(out, "comparison")
    read = _suite(suite)
    from mckibben.study.compare import CompareResult
    from mckibben.study.compare import compare as run
    from mckibben.study.compare.checks import filename
    from mckibben.study.compare.result import PooledResult

    suites = (_quick(read) if quick else read).each
    folders = {name: out / filename(name) if name else out for name in suites}
    again = {name: resume and (folder / STUDY).exists() for name, folder in folders.items()}
    for name, folder in folders.items():
        file, text = make_folder(folder) / "suite.yaml", suites[name].dumps(folder=folder)
        begun = file.is_file() and file.read_text(encoding="utf-8") == text  # by a run that was killed
        check_results(
            folder, {*CompareResult.file_names()} - ({file.name} if begun else set()), resume=again[name], force=force
        )
        if not file.exists():  # before the search, which may be interrupted
            suites[name].to_yaml(file)
    results = {}
    for number, (name, setup) in enumerate(suites.items()):

        def step(task: str, fraction: float, name: str = name, number: int = number) -> None:
            if progress:
                progress(f"{name}: {task}" if name else task, (number + fraction) / len(suites))

        results[name] = run(setup, out=folders[name], resume=again[name], progress=step)
    if "" in results:
        return results[""]
    for name, result in results.items():
        result.save(folders[name], force=True)
    return PooledResult(read.name, results)


def _followed(names: list[str] | None) -> list[str] | str:
    """Parameters that the controller's model follows, or all."""
    return "all" if names == ["all"] else names or []


def _tuned_names(paths: list[Path], kind: str) -> list[str]:
    """Unique file names of the tuned scenarios, which are to be used or not."""
    stems = [path.stem for path in paths]
    return [f"{stem}-{kind}{f'-{i}' if stem in stems[: i - 1] else ''}.yaml" for i, stem in enumerate(stems, start=1)]


def _write_tuned(tuned: TuneResult, scenario: StudiedScenario, before: str, source: Path, target: Path) -> None:
    """Write a tuned scenario, editing the user's text in place if its relative paths remain valid."""
    from mckibben.scenario import edit_scenario

    text = edit_scenario(before, tuned.values, folder=source.parent)
    with suppress(ScenarioError):
        if type(scenario).parse(text, folder=target.parent) == scenario:
            with atomic_write(target, overwrite=True) as temporary:
                temporary.write_text(text, encoding="utf-8")
            return
    scenario.to_yaml(target)  # a relative path in the text is invalid in the new folder


def _suite(file: Path) -> ControllerSuite:
    """Read a suite, or the default one of a scenario."""
    from mckibben.config.document import read_document
    from mckibben.config.model import read_text
    from mckibben.scenario import Scenario
    from mckibben.study.compare import Suite
    from mckibben.study.compare.robots import RobotSuite

    keys = read_document(read_text(file)).data or {}
    if "scenario" in keys:
        return RobotSuite.read(file)
    if not {"controller", "robot"} & {*keys}:
        return Suite.read(file)
    suite: ControllerSuite = Scenario.read(file).suite()
    echo(
        f"suite of the scenario: {', '.join(suite.controllers)}; varied: {', '.join(suite.conditions)}. For other "
        "controllers and conditions, edit suite.yaml in DIR, and compare that",
        err=True,
    )
    return suite


def _quick(suite: ControllerSuite) -> ControllerSuite:
    """The suite with fewer runs and a smaller tuning budget."""
    tuning = suite.tuning
    fewer = {
        "generations": max(tuning.generations // 10, 1),
        "starts": 1,
        "finalist_runs": min(tuning.finalist_runs, 100),
    }
    evaluation = suite.evaluation.model_copy(update={"runs": min(suite.evaluation.runs, 128)})
    return suite.model_copy(update={"tuning": tuning.model_copy(update=fewer), "evaluation": evaluation})
