"""`mckibben sweep` and `mckibben tune`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mckibben.cli.command import DETAILS, present
from mckibben.cli.options import (
    Json,
    ModelFollows,
    keeping,
    long_job,
    notify,
    required_folder,
)
from mckibben.errors import ParameterError, ScenarioError
from mckibben.storage.files import atomic_write, check_free
from mckibben.storage.store import STUDY

if TYPE_CHECKING:
    from mckibben.result import Result
    from mckibben.scenario import Scenario
    from mckibben.study.parameters import Table
    from mckibben.study.tune import TuneResult

_KEPT = "what was finished is in {}/study.sqlite; continue with --resume"
StudyFolder = Annotated[Path | None, Option("--out", metavar="DIR", help="Folder of the study and its results.")]
Resume = Annotated[bool, Option("--resume", help="Continue the study in DIR.")]
Engine = Annotated[
    str,
    Option(
        metavar="auto|native|xla|cuda",
        help="auto: the C compiler's programs where possible, else XLA's; cuda: kernels on an NVIDIA GPU (extra gpu).",
    ),
]


def sweep(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario file; see examples/.")],
    over: Annotated[
        list[str] | None,
        Option(
            metavar="'NAME=RANGE'", help="Parameter and its range, such as 'load.mass2=0.2 kg..1.0 kg'; repeatable."
        ),
    ] = None,
    model_follows: ModelFollows = None,
    list_: Annotated[bool, Option("--list", help="List the parameters that can be varied, and exit.")] = False,
    design: Annotated[str | None, Option(metavar="KIND", help="Design: sobol (default), random or grid.")] = None,
    samples: Annotated[int | None, Option(metavar="N", help="Number of runs (default 1024), not for a grid.")] = None,
    seed: Annotated[int | None, Option(metavar="N", help="Seed of the design (default 0).")] = None,
    engine: Engine = "auto",
    out: StudyFolder = None,
    resume: Resume = False,
    dask: Annotated[
        str | None,
        Option(metavar="CLUSTER", help="local (processes of this machine), or tcp://HOST:PORT of a dask scheduler."),
    ] = None,
    details: DETAILS = False,
    json: Json = False,
) -> None:
    """Run a scenario over ranges of its parameters; finished runs are kept, and the sweep can be resumed."""
    from mckibben.scenario import Scenario

    if list_:
        from mckibben.study.parameters.listing import ParameterList

        present(ParameterList.of(Scenario.read(scenario)), json=json, force=False)
        return
    out = required_folder(out, "sweep")
    with long_job(quiet=json, kept=_KEPT.format(out)) as bar:
        from mckibben.study.sweep import SweepResult
        from mckibben.study.sweep import sweep as run

        check_results(out, SweepResult, resume)
        swept = run(
            Scenario.read(scenario),
            over or None,
            out=out,
            design=design,
            samples=samples,
            seed=seed,
            model_follows="all" if model_follows == ["all"] else model_follows or None,
            engine=engine,
            resume=resume,
            dask=dask,
            source=str(scenario),
            progress=bar,
        )
    show_study(swept, out, details=details, json=json)


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
    model_follows: ModelFollows = None,
    cost: Annotated[
        str, Option(metavar="TERMS", help="Sum of metrics, each divided by its scale.")
    ] = "angle_rmse/0.1 deg + stiffness_rmse/0.1 N*m/rad",
    method: Annotated[
        str, Option(metavar="cma|local", help="Search by CMA-ES, or local refinement of the given values.")
    ] = "cma",
    margin: Annotated[
        float, Option(metavar="FACTOR", help="Gain margin: the cost covers gains larger by this factor.")
    ] = 1.5,
    disk_margin: Annotated[
        float | None,
        Option(
            metavar="ALPHA",
            help="Least disk margin of the linearised loop in all scenarios and conditions, such as 0.4; 0 for none. "
            "Default: that of the given gains, at most 0.2.",
        ),
    ] = None,
    conditions: Annotated[
        list[str] | None,
        Option(
            metavar="'NAME=RANGE'",
            help="Parameter, such as 'load.mass2=+-50 %'; all its draws are simulated for each point; repeatable.",
        ),
    ] = None,
    draws: Annotated[int | None, Option(metavar="N", min=1, help="Draws of the conditions; default: 16.")] = None,
    percentile: Annotated[
        float | None,
        Option(
            metavar="PERCENT",
            help="Minimise this percentile of the cost over scenarios and conditions, 100 for the worst one, "
            "in place of the mean.",
        ),
    ] = None,
    iterations: Annotated[int, Option(metavar="N", help="Generations, or steps of the refinement.")] = 30,
    population: Annotated[int, Option(metavar="N", help="Points per generation.")] = 32,
    seed: Annotated[int, Option(metavar="N", help="Seed of the search.")] = 0,
    out: StudyFolder = None,
    resume: Resume = False,
    details: DETAILS = False,
    json: Json = False,
) -> None:
    """Minimise a cost over gains or other parameters of scenarios; a search can be resumed."""
    from mckibben.scenario import Scenario
    from mckibben.study.parameters import parse_sweeps, sample
    from mckibben.study.tune import TuneResult, parse_cost, parse_ranges
    from mckibben.study.tune import tune as run

    read = [Scenario.read(path) for path in scenarios]
    ranges = parse_ranges(parameters or [], read[0])
    wanted = parse_cost(cost, gain_margin=margin, percentile=percentile, disk_margin=disk_margin)
    if not conditions and (draws is not None or (percentile is not None and len(read) == 1)):
        raise ParameterError("--draws and --percentile apply to conditions", remedy="add --conditions 'NAME=RANGE'")
    drawn = sample(parse_sweeps(conditions, read[0]), samples=draws or 16, seed=seed) if conditions else {}
    _check_varied(drawn)
    out = required_folder(out, "search")  # after the mistakes of other options
    check_results(out, TuneResult, resume, *tuned_names(scenarios))
    with long_job(quiet=json, kept=_KEPT.format(out)) as bar:
        tuned = run(
            read,
            ranges,
            wanted,
            method=method,
            iterations=iterations,
            population=population,
            seed=seed,
            out=out,
            resume=resume,
            model_follows="all" if model_follows == ["all"] else model_follows or (),
            conditions=drawn,
            progress=bar,
        )
        with keeping(out, "make room, and continue with --resume"):
            written = _write_scenarios(tuned, scenarios, out)
    show_study(tuned, out, *written, details=details, json=json)


def check_results(out: Path, kind: type[Result], resume: bool, *further: str) -> None:
    """Raise `FileError` if a new study would replace results; an existing study is reported by the study itself."""
    if not resume and not (out / STUDY).exists():
        check_free(out, (*kind.file_names(), *further))


def show_study(result: Result, out: Path, *written: str, details: bool, json: bool) -> None:
    """Write the results of a study to its folder, and print them."""
    with keeping(out, "make room, and continue with --resume"):
        names = [*written, *result.save(out, force=True), STUDY]
    try:
        present(result, details=details, json=json, force=False)
    finally:
        notify(f"wrote {', '.join(names)} to {out}", json)


def _check_varied(drawn: Table) -> None:
    for name, values in drawn.items():
        if len(values) > 1 and values.min() == values.max():
            raise ParameterError(f"the condition {name} does not vary", field=name, remedy="give a range")


def _write_scenarios(tuned: TuneResult, paths: list[Path], out: Path) -> list[str]:
    """Write the tuned scenarios, editing the user's text in place if its relative paths remain valid."""
    from mckibben.scenario import Scenario, edit_scenario

    names = tuned_names(paths)
    for name, scenario, path in zip(names, tuned.scenarios, paths, strict=True):
        text = edit_scenario(path.read_text(encoding="utf-8-sig"), tuned.values, folder=path.parent)
        if _is_text_of(scenario, text, out, Scenario):
            with atomic_write(out / name, overwrite=True) as part:
                part.write_text(text, encoding="utf-8")
        else:  # a relative path in the text is invalid in the new folder
            scenario.to_yaml(out / name)
    return names


def _is_text_of(scenario: Scenario, text: str, folder: Path, kind: type[Scenario]) -> bool:
    with suppress(ScenarioError):
        return kind.parse(text, folder=folder) == scenario
    return False


def tuned_names(paths: list[Path]) -> list[str]:
    """Return unique file names of the tuned scenarios."""
    names: list[str] = []
    for i, path in enumerate(paths, start=1):
        name = f"{path.stem}-tuned.yaml"
        names.append(name if name not in names else f"{path.stem}-tuned-{i}.yaml")
    return names
