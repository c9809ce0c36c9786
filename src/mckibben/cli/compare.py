"""`mckibben compare`: controllers tuned with the same budget and compared on the same unseen runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from mckibben.cli.options import Accuracy, Json, echo, keeping, long_job, metric, required_folder, table, with_accuracy
from mckibben.errors import FileError, ParameterError, Problem
from mckibben.storage.files import check_free, make_folder, make_subfolder, to_json, write_json

if TYPE_CHECKING:
    from mckibben.study.compare import BenchmarkResult, Suite

# title, metric, statistic
_COLUMNS = (
    ("angle rmse, deg", "angle_rmse_deg", "median"),
    ("95 %", "angle_rmse_deg", "percentile_95"),
    ("stiffness rmse", "stiffness_rmse", "median"),
    ("95 %", "stiffness_rmse", "percentile_95"),
    ("coupling, deg", "coupling_deg", "median"),
    ("air, L", "air_L", "median"),
)
_SPREAD = ("median", "percentile_95")
_KEPT = ("results.json", "runs.nc", "suite.yaml", "comparison.html")


def compare(
    suite: Annotated[
        Path,
        Argument(
            metavar="SUITE.yaml",
            help="Suite file, see examples/comparison; or a scenario, compared with PID loops and decoupling.",
        ),
    ],
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Output folder: searches, all runs, tuned scenarios, report.")
    ] = None,
    resume: Annotated[bool, Option("--resume", help="Continue the searches in DIR.")] = False,
    runs: Annotated[int | None, Option(metavar="N", help="Number of unseen runs, overriding the suite.")] = None,
    quick: Annotated[bool, Option("--quick", help="Short searches, at most 128 runs.")] = False,
    repeat: Annotated[
        str | None,
        Option(
            metavar="'CONTROLLER RUN'",
            help="Print one run of the comparison in DIR as a scenario for `mckibben simulate`, such as 'PID 17'.",
        ),
    ] = None,
    accuracy: Accuracy = "",
    json: Json = False,
) -> None:
    """Tune controllers with the same budget, and compare them on the same unseen runs."""
    out = required_folder(out, "comparison")
    read = _smaller(with_accuracy(_read(suite), accuracy), runs, quick)
    if repeat is not None:
        echo(_alone(out, repeat), nl=False)
        return
    from mckibben.study.compare import compare as run
    from mckibben.study.compare.statistics import pooled
    from mckibben.study.compare.suite import filename

    suites = {name: read.of_setup(name) for name in read.setups} or {"": read}
    folders = {name: out / filename(name) if name else out for name in suites}
    for name, folder in folders.items():
        _prepare(folder, resume)
        if not (made := folder / "suite.yaml").exists():  # before the search, which may be interrupted
            suites[name].to_yaml(made)
    results = {}
    with long_job(quiet=json, kept=f"the evaluated points are in {out}; continue with --resume") as bar:
        for number, (name, own) in enumerate(suites.items()):

            def report(task: str, part: float, name: str = name, number: int = number) -> None:
                if bar:
                    bar(f"{name}: {task}" if name else task, (number + part) / len(suites))

            results[name] = run(own, folder=folders[name] / "tuning", resume=resume, progress=report)
    shown = {name: _show(result, folders[name], json) for name, result in results.items()}
    if read.setups:
        _show_pooled({"setups": shown, "pooled": pooled(results)}, out, json)
    elif json:
        echo(to_json(shown[""]))


def _read(file: Path) -> Suite:
    """Read a suite, or the default one of a scenario."""
    from mckibben.config.document import read_document
    from mckibben.config.model import read_text
    from mckibben.scenario import Scenario
    from mckibben.study.compare import Suite

    if "controller" not in (read_document(read_text(file)).data or ()):
        return Suite.read(file)
    made = Suite.of(Scenario.read(file))
    echo(
        f"suite of the scenario: {', '.join(made.controllers)}; varied: {', '.join(made.conditions)}. For other "
        "controllers and conditions, edit suite.yaml in DIR, and compare that",
        err=True,
    )
    return made


def _prepare(out: Path, resume: bool) -> None:
    """Make the folders of a comparison; without `resume` they have no results."""
    searches = out / "tuning"
    if not resume:
        if searches.is_dir() and any(searches.glob("*.journal")):
            remedy = "continue them with --resume, or choose another folder"
            raise FileError(str(searches), [Problem("search histories already exist", remedy=remedy)])
        check_free(out, _KEPT)
    make_folder(out)
    for name in ("tuning", "figures"):
        make_subfolder(out, name)


def _smaller(suite: Suite, runs: int | None, quick: bool) -> Suite:
    """Return the suite with fewer runs or a smaller tuning budget."""
    tuning, evaluation = suite.tuning, suite.evaluation
    if quick:
        several = {name: max(count // tuning.starts, 1) for name, count in tuning.starts_of.items()}
        fewer = {
            "generations": max(tuning.generations // 10, 1),
            "starts": 1,
            "starts_of": several,
            "finalist_runs": min(tuning.finalist_runs, 100),
        }
        tuning = tuning.model_copy(update=fewer)
        evaluation = evaluation.model_copy(update={"runs": min(evaluation.runs, 128)})
    if runs is not None:
        if not 2 <= runs <= 1_000_000:
            raise ParameterError(f"--runs {runs}", value=runs, lower=2, upper=1_000_000, remedy="give 2 to 1000000")
        evaluation = evaluation.model_copy(update={"runs": runs})
    return suite.model_copy(update={"tuning": tuning, "evaluation": evaluation})


def _alone(out: Path, repeat: str) -> str:
    """Return one run of a finished comparison as the text of a scenario."""
    from mckibben.study.compare import draw
    from mckibben.study.compare.table import read_runs

    kept = out / "runs.nc"  # verified by its checksum
    if not kept.is_file():
        raise ParameterError(f"{out} does not contain a comparison", remedy="run it first, without --repeat")
    suite, tuned, count = read_runs(kept)
    name, _, run = repeat.rpartition(" ")
    if name not in tuned:
        raise ParameterError(f"there is no controller {name!r}", value=name, remedy=f"known are {', '.join(tuned)}")
    if not run.isdecimal() or int(run) >= count:
        raise ParameterError(f"there is no run {run!r}", value=run, remedy=f"give 0 to {count - 1}")
    scenario = draw(suite, count, suite.evaluation.seed).scenario(name, int(run), tuned[name])
    return scenario.dumps()


def _show(result: BenchmarkResult, out: Path, json: bool) -> dict[str, Any]:
    """Write a comparison to its folder, print its tables, and return its statistics."""
    from mckibben import report
    from mckibben.study.compare.statistics import statistics
    from mckibben.study.compare.table import write_table

    numbers = statistics(result)
    with keeping(out, "make room, and continue with --resume"):
        write_json(out / "results.json", numbers)  # before anything is drawn
        write_table(result, out / "runs.nc")
        result.suite.to_yaml(out / "suite.yaml")  # again: a resumed comparison may have other runs
        kept = _tuned_scenarios(result, out)
        page = report.write_benchmark(result, numbers, out)
    if not json:
        _tables(numbers)
    echo(
        f"wrote results.json, runs.nc, suite.yaml, tuning/, {kept} tuned scenarios and figures; the report is {page}",
        err=json,
    )
    return numbers


def _show_pooled(numbers: dict[str, Any], out: Path, json: bool) -> None:
    """Write and print the errors over the runs of all setups."""
    from mckibben.study.compare.statistics import FAILED, failed_runs

    write_json(out / "results.json", numbers)
    if json:
        echo(to_json(numbers))
        return
    for key, title in (("as_tuned", "as tuned"), ("at_air_of_first", "at no more air than the first controller")):
        if key not in numbers["pooled"]:
            continue
        table(
            f"all setups, {title}",
            ("controller", "angle rmse, deg", "95 %", "against the first", "95 % interval", "air, L", FAILED),
            [
                (
                    name,
                    *(metric("angle_rmse_deg", each["metrics"]["angle_rmse_deg"][what]) for what in _SPREAD),
                    *_ratios(each["ratio_to_first"])[:2],
                    metric("air_L", each["metrics"]["air_L"]["median"]),
                    failed_runs(each),
                )
                for name, each in numbers["pooled"][key].items()
            ],
        )
        if left_out := [name for name in numbers["pooled"]["as_tuned"] if name not in numbers["pooled"][key]]:
            echo(f"without {' and '.join(left_out)}, which this table of some setup lacks")


def _tables(numbers: dict[str, Any]) -> None:
    from mckibben.study.compare.statistics import FAILED, failed_runs, left_out_at_air

    found = numbers["controllers"]

    def cell(each: dict[str, Any], key: str, what: str) -> str:
        spread = each["metrics"][key]
        return "-" if spread is None else metric(key, spread[what])

    table(
        f"{numbers['suite']}: {numbers['runs'] - numbers['no_start']} unseen runs",
        ("controller", *(title for title, _, _ in _COLUMNS), FAILED),
        [
            (name, *(cell(found[name], key, what) for _, key, what in _COLUMNS), failed_runs(found[name]))
            for name in numbers["order"]
        ],
    )
    first = next(iter(found))
    table(
        f"medians against {first}",
        ("controller", "angle rmse", "95 % interval", "stiffness rmse", "95 % interval"),
        [(name, *_ratios(found[name]["ratio_to_first"])) for name in numbers["order"] if name != first],
    )
    if at_air := numbers["at_air_of_first"]:
        table(
            f"at no more air than the tuned {first} ({metric('air_L', at_air['air_L'])} L in the training runs)",
            ("controller", "angle rmse, deg", "95 %", f"x {first}", "95 % interval", "air, L", FAILED),
            [
                (
                    name,
                    *(cell(each, "angle_rmse_deg", what) for what in ("median", "percentile_95")),
                    *_ratios(each["ratio_to_first"])[:2],
                    cell(each, "air_L", "median"),
                    failed_runs(each),
                )
                for name, each in at_air["controllers"].items()
            ],
        )
        if left_out := left_out_at_air(numbers):
            echo(left_out)
    if numbers["no_start"]:
        echo(f"{numbers['no_start']} runs were infeasible: no static equilibrium at their start")
    for name, each in found.items():
        if each["at_bound"]:
            echo(f"{name}: at a bound of the range: {', '.join(each['at_bound'])}; consider a wider range")


def _ratios(against: dict[str, dict[str, float]]) -> list[str]:
    return [
        cell
        for each in (against["angle_rmse_deg"], against["stiffness_rmse"])
        for cell in (f"{each['ratio']:.3g} x", f"{each['low']:.3g}..{each['high']:.3g}")
    ]


def _tuned_scenarios(result: BenchmarkResult, out: Path) -> int:
    """Write each tuned controller as a scenario with the plant of its model, also at equal air."""
    from mckibben.scenario import with_values
    from mckibben.study.compare.compare import filename

    kept = make_subfolder(out, "controllers")
    reference = next(iter(result.suite.references))
    at_air = result.at_air.tuned if result.at_air else {}
    for suffix, tuned in (("", result.tuned), (", at equal air", at_air)):
        for name, values in tuned.items():
            scenario = result.suite.scenario(name, reference)
            (with_values(scenario, values) if values else scenario).to_yaml(kept / f"{filename(name + suffix)}.yaml")
    return len(result.tuned)
