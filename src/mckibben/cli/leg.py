"""`mckibben leg`: landing and jumping of a leg, and stiffness of its foot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from mckibben.cli.options import (
    Accuracy,
    Commands,
    Force,
    Json,
    Out,
    echo,
    keeping,
    long_job,
    notify,
    required_folder,
    results_folder,
    table,
    with_accuracy,
)
from mckibben.storage.files import to_json, write_json

if TYPE_CHECKING:
    from mckibben.leg.scenario import LegScenario

leg = typer.Typer(
    cls=Commands, name="leg", help="Landing and jumping of a leg, and stiffness of its foot.", no_args_is_help=True
)

Resume = Annotated[bool, Option("--resume", help="Continue the study in DIR.")]
_FIGURE = "foot_stiffness"
LegFile = Annotated[Path, Argument(metavar="LEG.yaml", help="Leg; see examples/leg/.")]


@leg.command()
def land(
    file: LegFile,
    json: Json = False,
    out: Out = None,
    force: Force = False,
    resume: Resume = False,
    accuracy: Accuracy = "",
) -> None:
    """Simulate drop landings over stiffness, drop height and valve, with intervals; can be resumed."""
    if resume:
        required_folder(out, "study to be continued")
    journal = out / "landing.journal" if out else None
    results_folder(
        out, ("results.json", "landing.nc", "leg.yaml", "landing.journal", *_drawn("landing")), force or resume
    )
    from mckibben.leg.landing import study_landing

    read = _read(file, accuracy)
    if journal and not resume:
        journal.unlink(missing_ok=True)  # of the study that --force replaces
    with long_job(quiet=json, kept="finished landings are kept; continue with --resume" if out else "") as report:
        study = study_landing(read, source=str(file), journal=journal, resume=resume, progress=report)
    numbers = study.records()
    if out:
        from mckibben import report as figures
        from mckibben.dataset.schema import write_netcdf

        with keeping(out):
            write_json(out / "results.json", numbers)
            write_netcdf(study.table, out / "landing.nc")
            read.to_yaml(out / "leg.yaml")
            figures.save(figures.landing_forces(study), out, "landing")
    _show(read.name, study, numbers, json)
    if out:
        notify(f"wrote results.json, landing.nc, leg.yaml and figures to {out}", json)


@leg.command()
def jump(
    file: LegFile,
    json: Json = False,
    out: Out = None,
    force: Force = False,
    resume: Resume = False,
    accuracy: Accuracy = "",
    limit: Annotated[
        bool, Option("--limit", help="Find the greatest height of the planned jump as well, and what limits it.")
    ] = False,
) -> None:
    """Find the highest jumps with constant and timed pressures, and simulate a planned one; can be resumed."""
    if resume:
        required_folder(out, "study to be continued")
    journal = out / "jump.journal" if out else None
    runs = ("constant.nc", "timed.nc", "planned.nc")
    drawn = _drawn("jump", "plan")
    results_folder(out, ("results.json", *runs, "leg.yaml", "jump.journal", *drawn), force or resume)
    from mckibben.leg.jumping import study_jump

    read = _read(file, accuracy)
    names = ["constant", "timed", *(["planned"] if read.jump and read.jump.plan else [])]
    if journal and not resume:
        journal.unlink(missing_ok=True)  # of the study that --force replaces
    with long_job(quiet=json, kept="the search is kept; continue with --resume" if out else "") as report:
        given = {"journal": journal, "resume": resume, "limit": limit}
        study = study_jump(read, source=str(file), **given, progress=report)
    numbers = study.records()
    if out:
        from mckibben import report as figures

        with keeping(out):
            write_json(out / "results.json", numbers)
            for name in ("planned.nc", *drawn):  # of a study with a plan that --force replaces
                (out / name).unlink(missing_ok=True)
            for name, one in study.jumps.items():
                one.run.to_netcdf(out / f"{name}.nc")
            read.to_yaml(out / "leg.yaml")
            figures.save(figures.jump_traces(study), out, "jump")
            if study.plan is not None and study.plan.foot:
                figures.save(figures.plan_stiffness(study), out, "plan")
    _show(read.name, study, numbers, json)
    if out:
        results = ", ".join(f"{name}.nc" for name in names)
        notify(f"wrote results.json, {results}, leg.yaml and figures to {out}", json)


@leg.command()
def stiffness(file: LegFile, json: Json = False, out: Out = None, force: Force = False) -> None:
    """Find the pressures for a stiffness of the foot: exact, or the nearest with a bound of the error."""
    results_folder(out, ("results.json", "leg.yaml", *_drawn(_FIGURE)), force)
    from mckibben.leg.foot_pressures import solve_foot_stiffness

    read = _read(file)
    found = solve_foot_stiffness(read, source=str(file))
    numbers = found.record(read.leg)
    if out:
        from mckibben.report.leg import foot_ellipses
        from mckibben.report.style import save

        assert read.stiffness is not None
        with keeping(out):
            write_json(out / "results.json", numbers)
            read.to_yaml(out / "leg.yaml")
            save(foot_ellipses(read.leg, read.leg.posture_angles(read.stiffness.posture), found=found), out, _FIGURE)
    if json:
        echo(to_json(numbers))
    else:
        table(read.name, *found.rows(read.leg))
        echo(found.describe())
    if out:
        notify(f"wrote results.json, leg.yaml, foot_stiffness.svg and foot_stiffness.png to {out}", json)


def _drawn(*names: str) -> list[str]:
    """Files of figures."""
    return [f"{name}.{end}" for name in names for end in ("png", "svg")]


def _read(file: Path, accuracy: str = "") -> LegScenario:
    from mckibben.leg.scenario import LegScenario

    return with_accuracy(LegScenario.read(file), accuracy)


def _show(name: str, study: Any, numbers: dict[str, Any], json: bool) -> None:
    if json:
        echo(to_json(numbers))
    else:
        table(f"{name}; intervals are 5 to 95 % of the draws", *study.rows())
        echo(study.describe())
