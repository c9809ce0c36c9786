"""`mckibben compare`: controllers tuned with the same budget and compared on the same unseen runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mckibben.cli.command import DETAILS, present
from mckibben.cli.options import Json, echo, long_job, required_folder
from mckibben.cli.sweep import Resume, StudyFolder, check_results, show_study
from mckibben.errors import ParameterError
from mckibben.storage.files import make_folder

if TYPE_CHECKING:
    from mckibben.study.compare import Suite


def compare(
    suite: Annotated[
        Path,
        Argument(
            metavar="SUITE.yaml",
            help="Suite file, see examples/comparison; or a scenario, compared with PID loops and decoupling.",
        ),
    ],
    out: StudyFolder = None,
    resume: Resume = False,
    runs: Annotated[int | None, Option(metavar="N", help="Number of unseen runs, overriding the suite.")] = None,
    quick: Annotated[bool, Option("--quick", help="Short searches, at most 128 runs.")] = False,
    repeat: Annotated[
        str | None,
        Option(
            metavar="'CONTROLLER RUN'",
            help="Print one run of the comparison in DIR as a scenario for `mckibben simulate`, such as 'PID 17'.",
        ),
    ] = None,
    details: DETAILS = False,
    json: Json = False,
) -> None:
    """Tune controllers with the same budget, and compare them on the same unseen runs."""
    out = required_folder(out, "comparison")
    read = _smaller(_read(suite), runs, quick)
    if repeat is not None:
        echo(_repeated(out, repeat), nl=False)
        return
    from mckibben import report
    from mckibben.study.compare import CompareResult
    from mckibben.study.compare import compare as run
    from mckibben.study.compare.checks import filename
    from mckibben.study.compare.result import PooledResult

    suites = {name: read.of_setup(name) for name in read.setups} or {"": read}
    folders = {name: out / filename(name) if name else out for name in suites}
    for name, folder in folders.items():
        check_results(folder, CompareResult, resume, "comparison.html")
        if not (make_folder(folder) / "suite.yaml").exists():  # before the search, which may be interrupted
            suites[name].to_yaml(folder / "suite.yaml")
    results = {}
    with long_job(quiet=json, kept=f"the evaluated points are in {out}; continue with --resume") as bar:
        for number, (name, own) in enumerate(suites.items()):

            def step(task: str, part: float, name: str = name, number: int = number) -> None:
                if bar:
                    bar(f"{name}: {task}" if name else task, (number + part) / len(suites))

            again = resume and (folders[name] / "study.sqlite").exists()
            results[name] = run(own, out=folders[name], resume=again, progress=step)
            report.write_comparison(results[name], folders[name])
    if not read.setups:
        show_study(results[""], out, "comparison.html", details=details, json=json)
        return
    for name, result in results.items():
        result.save(folders[name], force=True)
    pooled = PooledResult(read.name, results)
    pooled.save(out, force=True)
    present(pooled, details=details, json=json, force=False)


def _read(file: Path) -> Suite:
    """Read a suite, or the default one of a scenario."""
    from mckibben.config.document import read_document
    from mckibben.config.model import read_text
    from mckibben.scenario import Scenario
    from mckibben.study.compare import Suite

    if "controller" not in (read_document(read_text(file)).data or ()):
        return Suite.read(file)
    suite = Suite.of(Scenario.read(file))
    echo(
        f"suite of the scenario: {', '.join(suite.controllers)}; varied: {', '.join(suite.conditions)}. For other "
        "controllers and conditions, edit suite.yaml in DIR, and compare that",
        err=True,
    )
    return suite


def _smaller(suite: Suite, runs: int | None, quick: bool) -> Suite:
    """Return the suite with fewer runs or a smaller tuning budget."""
    tuning, evaluation = suite.tuning, suite.evaluation
    if quick:
        fewer = {
            "generations": max(tuning.generations // 10, 1),
            "starts": 1,
            "starts_of": {name: max(count // tuning.starts, 1) for name, count in tuning.starts_of.items()},
            "finalist_runs": min(tuning.finalist_runs, 100),
        }
        tuning = tuning.model_copy(update=fewer)
        evaluation = evaluation.model_copy(update={"runs": min(evaluation.runs, 128)})
    if runs is not None:
        if not 2 <= runs <= 1_000_000:
            raise ParameterError(f"--runs {runs}", value=runs, lower=2, upper=1_000_000, remedy="give 2 to 1000000")
        evaluation = evaluation.model_copy(update={"runs": runs})
    return suite.model_copy(update={"tuning": tuning, "evaluation": evaluation})


def _repeated(out: Path, repeat: str) -> str:
    """Return one run of a finished comparison as the text of a scenario."""
    from mckibben.study.compare import draw
    from mckibben.study.compare.result import read_runs

    table = out / "runs.nc"  # verified by its checksum
    if not table.is_file():
        raise ParameterError(f"{out} does not contain a comparison", remedy="run it first, without --repeat")
    suite, tuned, count = read_runs(table)
    name, _, run = repeat.rpartition(" ")
    if name not in tuned:
        raise ParameterError(f"there is no controller {name!r}", value=name, remedy=f"known are {', '.join(tuned)}")
    if not run.isdecimal() or int(run) >= count:
        raise ParameterError(f"there is no run {run!r}", value=run, remedy=f"give 0 to {count - 1}")
    return draw(suite, count, suite.evaluation.seed).scenario(name, int(run), tuned[name]).dumps()
