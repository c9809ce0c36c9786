"""`mckibben tune`: the numbers of scenarios that cost least."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mckibben.cli.options import INTERRUPTED, Json, late_progress, metric, table
from mckibben.errors import McKibbenError, ParameterError, ScenarioError
from mckibben.storage.files import atomic_write

if TYPE_CHECKING:
    from mckibben.study.scenario import Scenario
    from mckibben.study.tune import TuningResult

_METHODS = ("gradient", "evolution", "cma")


def tune(
    scenarios: Annotated[
        list[Path], typer.Argument(metavar="SCENARIO.yaml...", help="The runs that count, all at once.")
    ],
    parameters: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'NAME=RANGE'",
            help="Search this number over a range, such as 'controller.position.kp=0.2..20 bar/rad log' or "
            "'load.damping=+-50 %'; a name alone goes from a hundredth to a hundredfold. May be given several times; "
            "all gains unless given. `mckibben sweep SCENARIO.yaml --list` shows the names.",
        ),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="A tuned number of the plant that the controller's model follows, or all of them; may be "
            "given several times. Unless given, the model stays that of the file.",
        ),
    ] = None,
    cost: Annotated[
        str, typer.Option(metavar="TERMS", help="Metrics over what of each costs 1, added up.")
    ] = "angle_rmse/0.1 deg + stiffness_rmse/0.1 N*m/rad",
    method: Annotated[str, typer.Option(metavar="|".join(_METHODS), help="How to search.")] = "gradient",
    margin: Annotated[
        float, typer.Option(metavar="FACTOR", help="By which all tuned gains may rise without harm; 1 for no margin.")
    ] = 1.5,
    worst: Annotated[bool, typer.Option("--worst", help="The worst scenario counts, not the mean of all.")] = False,
    starts: Annotated[int, typer.Option(metavar="N", help="From how many points a gradient is followed.")] = 4,
    iterations: Annotated[int, typer.Option(metavar="N", help="Steps of each descent, or generations.")] = 30,
    population: Annotated[int, typer.Option(metavar="N", help="Points a generation.")] = 32,
    seed: Annotated[int, typer.Option(metavar="N", help="Of the search: the same seed finds the same.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the history, the tuned scenarios and a figure here.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the search in DIR.")] = False,
    json: Json = False,
) -> None:
    """Search gains, or other numbers, of scenarios for the least cost; what was tried is never lost."""
    if out is None:
        raise ParameterError("there is no folder for the search", remedy="say where to keep it: --out DIR")
    if method not in _METHODS:
        raise ParameterError(f"{method!r} is no method", value=method, remedy=f"choose of {', '.join(_METHODS)}")
    from mckibben.storage.files import check_free
    from mckibben.study.scenario import Scenario

    read = [Scenario.read(path) for path in scenarios]
    from mckibben.study.tune import Method, parse_cost, parse_ranges
    from mckibben.study.tune import tune as run

    ranges = parse_ranges(parameters or [], read[0])
    asked = parse_cost(cost, gain_margin=margin, worst=worst)
    history = out / "history.journal"
    if not resume and not history.exists():  # else `run` says what to do
        check_free(out, ("results.json", "tuning.png", "tuning.svg", *_tuned_names(scenarios)))
    try:
        with late_progress(quiet=json) as bar:
            shown = None if bar is None else _Shown(bar)
            tuned = run(
                read,
                ranges,
                asked,
                method=Method(method),
                starts=starts,
                iterations=iterations,
                population=population,
                seed=seed,
                history=history,
                resume=resume,
                known="all" if known == ["all"] else known or (),
                progress=shown and shown.part,
                least=shown and shown.least,
            )
    except KeyboardInterrupt:
        typer.echo(f"interrupted: what was tried is kept in {history}; go on with --resume", err=True)
        raise typer.Exit(INTERRUPTED) from None
    _show(tuned, read, scenarios, ranges, out, json)


def _show(tuned: TuningResult, before: list[Scenario], paths: list[Path], ranges: Any, out: Path, json: bool) -> None:
    from mckibben import report
    from mckibben.study.reporting import METRICS, to_json, write_json

    kept = _keep_scenarios(tuned, paths, out)
    runs = [
        {"scenario": old.name, "before": _measured(old), "tuned": _measured(new)}
        for old, new in zip(before, tuned.scenarios, strict=True)
    ]
    shown_values = {each.name: each.parameter.show(tuned.values[each.name]) for each in ranges}
    numbers = {
        "cost_before": tuned.cost_before,
        "cost": tuned.cost,
        "evaluated": tuned.evaluated,
        "at_bound": list(tuned.at_bound),
        "values": {name: {"si": tuned.values[name], "shown": text} for name, text in shown_values.items()},
        "runs": runs,
    }
    write_json(out / "results.json", numbers)
    report.save(report.tuning(tuned), out, "tuning")
    if json:
        typer.echo(to_json(numbers))
    else:
        rows = [
            (each.name, each.parameter.show(each.parameter.nominal) if each.parameter.nominal is not None else "-", now)
            for each, now in zip(ranges, shown_values.values(), strict=True)
        ]
        table(
            f"cost {metric('cost', tuned.cost_before)} -> {tuned.cost:.4g}, {tuned.evaluated} points tried",
            ("parameter", "before", "tuned"),
            rows,
        )
        for run in runs:
            changes = [(name, run["before"][name], value) for name, value in run["tuned"].items()]
            rows = [
                (METRICS[n][0].replace("_", " "), metric(n, old), metric(n, new), METRICS[n][1])
                for n, old, new in changes
            ]
            table(run["scenario"], ("metric", "before", "tuned", "unit"), rows)
        if tuned.at_bound:
            typer.echo(f"at an end of its range: {', '.join(tuned.at_bound)}; a wider range may hold better ones")
    typer.echo(f"kept {', '.join(kept)}, history.journal, results.json and tuning.png and .svg in {out}", err=json)


def _measured(scenario: Scenario) -> dict[str, float]:
    """The metrics as they are shown; NaN where the scenario cannot be run: tuning may have mended just that."""
    from mckibben.study.reporting import METRICS, shown
    from mckibben.study.scenario.running import run_scenario

    try:
        return shown(run_scenario(scenario).result.metrics())
    except McKibbenError:
        return dict.fromkeys(METRICS, float("nan"))


def _keep_scenarios(tuned: TuningResult, paths: list[Path], out: Path) -> list[str]:
    """Write the tuned scenarios: the user's own text with other numbers, where it reads the same in its new place."""
    from mckibben.study.parameters import edit_yaml
    from mckibben.study.scenario import Scenario

    names = _tuned_names(paths)
    for name, scenario, path in zip(names, tuned.scenarios, paths, strict=True):
        text = edit_yaml(path.read_text(encoding="utf-8-sig"), tuned.values, folder=path.parent)
        try:
            same = Scenario.parse(text, folder=out) == scenario
        except ScenarioError:
            same = False
        if not same:  # a path in it is relative to where it stood
            scenario.to_yaml(out / name)
            continue
        with atomic_write(out / name, overwrite=True) as part:
            part.write_text(text, encoding="utf-8")
    return names


def _tuned_names(paths: list[Path]) -> list[str]:
    """What the tuned scenarios are called, no two of them the same."""
    names: list[str] = []
    for i, path in enumerate(paths, start=1):
        name = f"{path.stem}-tuned.yaml"
        names.append(name if name not in names else f"{path.stem}-tuned-{i}.yaml")
    return names


class _Shown:
    """A bar with the part of the search that is done, and the least cost so far."""

    def __init__(self, bar: Callable[[str, float], None]) -> None:
        self._bar, self._least = bar, ""

    def part(self, part: float) -> None:
        self._bar(f"searching{self._least}", part)

    def least(self, cost: float) -> None:
        self._least = f", least cost so far {cost:.4g}"
