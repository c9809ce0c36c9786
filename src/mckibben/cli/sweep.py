"""`mckibben sweep`, `mckibben merge` and `mckibben tune`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from mckibben.cli.options import (
    Accuracy,
    Json,
    Known,
    check_choice,
    echo,
    format_metrics,
    keeping,
    long_job,
    metric,
    parse_quantity,
    required_folder,
    table,
    with_accuracy,
)
from mckibben.errors import ParameterError, ScenarioError
from mckibben.storage.files import atomic_write, check_free, to_json, write_json

if TYPE_CHECKING:
    from mckibben.scenario import Scenario
    from mckibben.study.parameters import Table
    from mckibben.study.sweep import SweepResult
    from mckibben.study.tune import TuningResult


_ENGINES = ("auto", "native", "xla", "cuda")
_ENGINE = "auto: the C compiler's programs where possible, else XLA's; cuda: kernels on an NVIDIA GPU (extra gpu)."


def sweep(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario file; see examples/.")],
    over: Annotated[
        list[str] | None,
        Option(
            metavar="'NAME=RANGE'", help="Parameter and its range, such as 'load.mass2=0.2 kg..1.0 kg'; repeatable."
        ),
    ] = None,
    known: Known = None,
    list_: Annotated[bool, Option("--list", help="List the parameters that can be varied, and exit.")] = False,
    design: Annotated[str | None, Option(metavar="KIND", help="Design: sobol (default), random or grid.")] = None,
    samples: Annotated[int | None, Option(metavar="N", help="Number of runs (default 1024), not for a grid.")] = None,
    seed: Annotated[int | None, Option(metavar="N", help="Seed of the design (default 0).")] = None,
    metrics: Annotated[
        list[str] | None,
        Option(metavar="NAME,NAME", help="Metrics to compute, such as angle_rmse,coupling (default: all)."),
    ] = None,
    precision: Annotated[
        int | None, Option(metavar="BITS", help="64 (default), or 32: half the time, 5 digits, fewer with an encoder.")
    ] = None,
    engine: Annotated[str, Option(metavar="|".join(_ENGINES), help=_ENGINE)] = "auto",
    out: Annotated[Path | None, Option(metavar="DIR", help="Output folder; each finished block is stored.")] = None,
    resume: Annotated[bool, Option("--resume", help="Continue the sweep in DIR with its options.")] = False,
    part: Annotated[
        str | None, Option(metavar="K/N", help="Compute the K-th of N parts of the runs; `mckibben merge` joins them.")
    ] = None,
    dask: Annotated[
        str | None,
        Option(metavar="CLUSTER", help="local (processes of this machine), or tcp://HOST:PORT of a dask scheduler."),
    ] = None,
    accuracy: Accuracy = "",
    json: Json = False,
) -> None:
    """Run a scenario over ranges of its parameters; finished runs are kept, and the sweep can be resumed."""
    if list_:
        _list(scenario, json)
        return
    out = required_folder(out, "sweep")
    with long_job(quiet=json, kept=f"finished blocks are in {out}; continue with --resume") as bar:
        from mckibben.scenario import Scenario
        from mckibben.study.sweep import sweep as run
        from mckibben.study.sweep.sweep import JOURNAL

        read = with_accuracy(Scenario.read(scenario), accuracy)
        if not resume and not (out / JOURNAL).exists():  # an existing sweep is reported by `run`
            check_free(out, ("results.json", "sweep.png", "sweep.svg"))
        names = None if metrics is None else [name.strip() for each in metrics for name in each.split(",")]
        swept = run(
            read,
            over or None,
            out=out,
            design=design,
            samples=samples,
            seed=seed,
            metrics=names,
            precision=precision,
            known="all" if known == ["all"] else known or None,
            engine=engine,
            part=part,
            resume=resume,
            dask=dask,
            source=str(scenario),
            progress=bar,
        )
    _show(swept, out, json)


def _write_statistics(swept: SweepResult, out: Path) -> dict[str, Any]:
    from mckibben.study.sweep import summary

    numbers = summary(swept)
    write_json(out / "results.json", numbers)
    return numbers


def _print(runs: int, numbers: dict[str, Any]) -> None:
    from mckibben.simulation.accuracy import integration_sentence
    from mckibben.study.sweep.result import correlation_rows, feasibility_sentence, metric_rows, outcome_rows

    table(f"{numbers['scenario']}: {runs} runs", ("runs", "share", "outcome"), outcome_rows(numbers))
    headers = ("metric", "unit", "median", "5 %", "95 %", "worst", "in run", "")
    table("Runs that completed", headers, metric_rows(numbers))
    ranked = ("parameter", "metric", "Spearman")
    table("Rank correlations, strongest first", ranked, correlation_rows(numbers))
    echo(feasibility_sentence(numbers))
    echo(integration_sentence(numbers["integration"]))


def _show(swept: SweepResult, out: Path, json: bool) -> None:
    """Write and print the statistics, and write the figure."""
    from mckibben import report

    with keeping(out, "make room, and continue with --resume"):
        numbers = _write_statistics(swept, out)
        report.save(report.sweep(swept), out, "sweep")
    if json:
        echo(to_json(numbers))
    else:
        if not swept.computed:
            echo(f"the sweep in {out} is already complete")
        _print(swept.count, numbers)
    echo(f"wrote sweep.nc, results.json, sweep.png and sweep.svg to {out}", err=json)


def _list(path: Path, json: bool) -> None:
    from mckibben.scenario import Scenario
    from mckibben.study.sweep.result import parameter_rows

    read: Scenario = Scenario.read(path)
    numbers = parameter_rows(read)
    if json:
        echo(to_json(numbers))
        return
    rows = [(each["name"], each["nominal"] or "-", each["range"], each["unit"]) for each in numbers]
    table(read.name, ("parameter", "value", "range", "unit"), rows)


_LARGEST = 10.0  # factor on gains
_METHODS = ("gradient", "evolution", "cma")


def tune(
    scenarios: Annotated[list[Path], Argument(metavar="SCENARIO.yaml...", help="Scenarios whose costs are combined.")],
    parameters: Annotated[
        list[str] | None,
        Option(
            "--parameters",
            "--over",
            metavar="'NAME=RANGE'",
            help="Parameter and its range, such as 'controller.position.kp=0.2..20 bar/rad log' or "
            "'load.damping=+-50 %'; a name alone spans 0.01 to 100 times its value. Repeatable (default: all gains). "
            "`mckibben sweep SCENARIO.yaml --list` lists the names.",
        ),
    ] = None,
    known: Known = None,
    cost: Annotated[
        str, Option(metavar="TERMS", help="Sum of metrics, each divided by its scale.")
    ] = "angle_rmse/0.1 deg + stiffness_rmse/0.1 N*m/rad",
    method: Annotated[
        str | None,
        Option(metavar="|".join(_METHODS), help="Search method. Default: cma, or evolution of a single parameter."),
    ] = None,
    margin: Annotated[
        float, Option(metavar="FACTOR", help="Gain margin: the cost covers gains larger by this factor.")
    ] = 1.5,
    delay_margin: Annotated[
        str,
        Option(
            metavar="TIME", help="Delay margin: the cost covers commands that arrive this much later, such as '5 ms'."
        ),
    ] = "0 ms",
    disk_margin: Annotated[
        float | None,
        Option(
            metavar="ALPHA",
            help="Least disk margin of the linearised loop in all scenarios and conditions, such as 0.4; 0 for none. "
            "Default: that of the given gains, at most 0.2; none with the method gradient.",
        ),
    ] = None,
    worst: Annotated[bool, Option("--worst", help="Minimise the worst scenario or condition, not the mean.")] = False,
    conditions: Annotated[
        list[str] | None,
        Option(
            metavar="'NAME=RANGE'",
            help="Parameter, such as 'load.mass2=+-50 %'; all its draws are simulated for each point; repeatable.",
        ),
    ] = None,
    draws: Annotated[int | None, Option(metavar="N", min=1, help="Draws of the conditions; default: 16.")] = None,
    percentile: Annotated[
        float | None, Option(metavar="PERCENT", help="Minimise this percentile of the cost over the conditions.")
    ] = None,
    starts: Annotated[int, Option(metavar="N", help="Starting points of the gradient method.")] = 4,
    iterations: Annotated[int, Option(metavar="N", help="Steps of each descent, or generations.")] = 30,
    population: Annotated[int, Option(metavar="N", help="Points per generation.")] = 32,
    seed: Annotated[int, Option(metavar="N", help="Seed of the search.")] = 0,
    engine: Annotated[str, Option(metavar="|".join(_ENGINES), help=f"{_ENGINE} Not for gradients.")] = "auto",
    out: Annotated[Path | None, Option(metavar="DIR", help="Output folder: history, tuned scenarios, figure.")] = None,
    resume: Annotated[bool, Option("--resume", help="Continue the search in DIR.")] = False,
    accuracy: Accuracy = "",
    json: Json = False,
) -> None:
    """Minimise a cost over gains or other parameters of scenarios; a search can be resumed."""
    if method is not None:
        check_choice(method, _METHODS, "a method")
    from mckibben.scenario import Scenario

    read = [with_accuracy(Scenario.read(path), accuracy) for path in scenarios]
    from mckibben.study.parameters import parse_sweeps, sample
    from mckibben.study.tune import parse_cost, parse_ranges
    from mckibben.study.tune import tune as run
    from mckibben.study.tune.margin import metrics_and_margins

    ranges = parse_ranges(parameters or [], read[0])
    late = parse_quantity("--delay-margin", delay_margin, "s")
    asked = parse_cost(
        cost, gain_margin=margin, worst=worst, percentile=percentile, delay_margin=late, disk_margin=disk_margin
    )
    if not conditions and (draws is not None or (percentile is not None and len(read) == 1)):
        raise ParameterError("--draws and --percentile apply to conditions", remedy="add --conditions 'NAME=RANGE'")
    drawn = sample(parse_sweeps(conditions, read[0]), samples=draws or 16, seed=seed) if conditions else {}
    for name, values in drawn.items():
        if len(values) > 1 and values.min() == values.max():
            raise ParameterError(f"the condition {name} does not vary", field=name, remedy="give a range")
    followed: Any = "all" if known == ["all"] else known or ()
    out = required_folder(out, "search")  # after the mistakes of other options
    history = out / "history.journal"
    if not resume and not history.exists():  # an existing search is reported by `run`
        check_free(out, ("results.json", "tuning.png", "tuning.svg", *_tuned_names(scenarios)))
    with long_job(quiet=json, kept=f"the evaluated points are in {history}; continue with --resume") as bar:
        tuned = run(
            read,
            ranges,
            asked,
            method=method,
            starts=starts,
            iterations=iterations,
            population=population,
            seed=seed,
            history=history,
            resume=resume,
            known=followed,
            conditions=drawn,
            engine=engine,
            progress=bar,
        )
        pairs = zip(read, tuned.scenarios, strict=True)
        runs = [(metrics_and_margins(old), metrics_and_margins(new)) for old, new in pairs]
        within = (
            [_in_conditions(one, tuned, percentile or 90.0, drawn, followed) for one in tuned.scenarios]
            if drawn
            else []
        )
    _show_tuned(tuned, read, runs, scenarios, ranges, drawn, within, out, json)


def _show_tuned(
    tuned: TuningResult,
    before: list[Scenario],
    found: list[Any],
    paths: list[Path],
    ranges: Any,
    drawn: Table,
    within: list[dict[str, Any]],
    out: Path,
    json: bool,
) -> None:
    from mckibben import report
    from mckibben.study.tune.margin import DISK_MARGIN, UNSTABLE, lost_margin

    runs: list[dict[str, Any]] = []
    for old, ((was, had), (now, has)) in zip(before, found, strict=True):
        margins = {"before": had, "tuned": has}
        runs.append({"scenario": old.name, "before": was, "tuned": now, "least_margins": margins})
    shown_values = {each.name: each.parameter.show(tuned.values[each.name]) for each in ranges}
    numbers = {
        "cost_before": tuned.cost_before,
        "cost": tuned.cost,
        "evaluated": tuned.evaluated,
        "disk_margin": tuned.disk_margin,
        "at_bound": list(tuned.at_bound),
        "values": {name: {"si": tuned.values[name], "shown": text} for name, text in shown_values.items()},
        "runs": runs,
    }
    if drawn:
        numbers["conditions"] = {name: values.tolist() for name, values in drawn.items()}
        runs[:] = [{**run, "in_conditions": one} for run, one in zip(runs, within, strict=True)]
    with keeping(out, "make room, and continue with --resume"):
        kept = _keep_scenarios(tuned, paths, out)
        write_json(out / "results.json", numbers)
        report.save(report.tuning(tuned), out, "tuning")
    if json:
        echo(to_json(numbers))
    else:
        named = [(each.parameter, each.parameter.nominal) for each in ranges]
        old = ["-" if nominal is None else parameter.show(nominal) for parameter, nominal in named]
        rows = list(zip(shown_values, old, shown_values.values(), strict=True))
        where = f"disk margin of at least {tuned.disk_margin:g} kept at four points of a run"
        points = f"{tuned.evaluated} points evaluated, {where if tuned.disk_margin else 'no margin kept'}"
        table(f"{tuned.change}, {points}", ("parameter", "before", "tuned"), rows)
        if tuned.invalid_before:
            echo(tuned.invalid_before)
        for run in runs:
            pairs = zip(format_metrics(run["before"]), format_metrics(run["tuned"]), strict=True)
            rows = [(name, old, new, unit) for (name, old, _), (_, new, unit) in pairs]
            for name in run["least_margins"]["tuned"]:
                what, _, unit = name.partition("_")
                old, new = (metric("", run["least_margins"][when][name]) for when in ("before", "tuned"))
                rows.append((f"least {what} margin", old, new, unit or "1"))
            title = f"{run['scenario']}{', without the conditions' if drawn else ''}"
            table(title, ("metric", "before", "tuned", "unit"), rows)
            was, now = (run["least_margins"][when]["disk"] for when in ("before", "tuned"))
            if lost := lost_margin(was, now):
                echo(f"{lost}; `--disk-margin {DISK_MARGIN}` bounds it")
            elif not tuned.disk_margin and 0 < now < DISK_MARGIN:
                echo(f"the least disk margin is {now:.2g}; `--disk-margin {DISK_MARGIN}` asks for more")
            if now == 0:
                echo(UNSTABLE)
        if drawn:
            count = len(next(iter(drawn.values())))
            title = f"angle RMSE [deg] in the {count} conditions, and gain margin in all of them"
            table(title, *_condition_rows(runs, count))
            echo(
                "gain margin: factor on all tuned gains up to which a step of 0.2 deg does not make the loop oscillate"
            )
        for remark in dict.fromkeys(remark for one in before for remark in one.joint.remarks):
            echo(remark)
        if tuned.remark:
            echo(f"{tuned.remark} (--method cma)")
        if tuned.at_bound:
            echo(f"at a bound of the range: {', '.join(tuned.at_bound)}; consider a wider range")
    echo(f"wrote {', '.join(kept)}, history.journal, results.json, tuning.png and tuning.svg to {out}", err=json)


def _in_conditions(
    scenario: Scenario, tuned: TuningResult, percentile: float, drawn: Table, known: Any
) -> dict[str, Any]:
    import numpy as np

    from mckibben.study.tune.margin import in_conditions
    from mckibben.study.tune.search import is_gain
    from mckibben.units import deg

    gains = [name for name, value in tuned.values.items() if is_gain(name) and value]
    found = in_conditions(scenario, gains, drawn, largest=_LARGEST, known=known)
    shares = {"median": 50.0, "percentile": percentile, "worst": 100.0}
    ranked = {name: np.percentile(found.angle_rmse, one, method="inverted_cdf") for name, one in shares.items()}
    return {
        "angle_rmse_deg": {name: float(one / deg) if np.isfinite(one) else None for name, one in ranked.items()},
        "percentile": percentile,
        "diverged": int(np.isinf(found.angle_rmse).sum()),
        "unstable": found.unstable,
        "gain_margin": found.gain_margin,
    }


def _condition_rows(runs: list[dict[str, Any]], count: int) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    share = runs[0]["in_conditions"]["percentile"]
    few = ", here the worst" if (1 - share / 100) * count < 1 and share < 100 else ""
    headers = ("scenario", "nominal", "median", f"{share:g} %{few}", "worst", "diverged", "gain margin")
    rows: list[tuple[str, ...]] = []
    for run in runs:
        found = run["in_conditions"]
        errors = ["diverged" if one is None else metric("", one) for one in found["angle_rmse_deg"].values()]
        margin = found["gain_margin"]
        stable = "-" if margin is None else f"{margin:.2g}" if margin < _LARGEST else f"{_LARGEST:g} or more"
        shown = f"none, unstable in {found['unstable']}" if found["unstable"] else stable
        rows.append(
            (run["scenario"], metric("", run["tuned"]["angle_rmse_deg"]), *errors, str(found["diverged"]), shown)
        )
    return headers, rows


def _keep_scenarios(tuned: TuningResult, paths: list[Path], out: Path) -> list[str]:
    """Write the tuned scenarios, editing the user's text in place if its relative paths remain valid."""
    from mckibben.scenario import Scenario, edit_scenario

    names = _tuned_names(paths)
    for name, scenario, path in zip(names, tuned.scenarios, paths, strict=True):
        text = edit_scenario(path.read_text(encoding="utf-8-sig"), tuned.values, folder=path.parent)
        with suppress(ScenarioError):
            if Scenario.parse(text, folder=out) == scenario:
                with atomic_write(out / name, overwrite=True) as part:
                    part.write_text(text, encoding="utf-8")
                continue
        scenario.to_yaml(out / name)  # a relative path in the text is invalid in the new folder
    return names


def _tuned_names(paths: list[Path]) -> list[str]:
    """Unique file names of the tuned scenarios."""
    names: list[str] = []
    for i, path in enumerate(paths, start=1):
        name = f"{path.stem}-tuned.yaml"
        names.append(name if name not in names else f"{path.stem}-tuned-{i}.yaml")
    return names
