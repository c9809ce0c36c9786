"""`mckibben leg`: landing and jumping of a leg, and stiffness of its foot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from mckibben.cli.command import command
from mckibben.cli.options import Progress, check_unused, required_folder
from mckibben.cli.report import Report
from mckibben.errors import FileError, Problem
from mckibben.result import Listing
from mckibben.storage.files import check_free, make_folder
from mckibben.storage.store import STUDY

if TYPE_CHECKING:
    from mckibben.leg.scenario import LegScenario


@command
def leg(
    study: Literal["land", "jump", "stiffness"],
    file: Path,
    *,
    out: Path | None,
    resume: bool,
    progress: Progress = None,
) -> Report:
    """Study a leg: drop landings over stiffness, height and valve; the highest jumps; pressures for a stiffness of its
    foot. Landings and jumps are kept in DIR, and can be resumed.

    Parameters
    ----------
    study : land|jump|stiffness
        Study, of which the file has the settings.
    file : LEG.yaml
        Leg; see examples/leg/.
    """
    if study == "stiffness":
        check_unused("leg stiffness", resume=resume)
    if resume and not (file_of_study := required_folder(out, "study to be continued") / STUDY).is_file():
        problem = Problem("there is no study to continue", remedy="leave out --resume")
        raise FileError(str(file_of_study), [problem])
    from mckibben.leg.scenario import LegScenario

    if out and not resume:
        names = ("results.json", *Report.files, STUDY)
        check_free(make_folder(out), names, "choose another folder, or continue the study with --resume")
    settings = {"out": out, "resume": resume, "progress": progress}
    read = LegScenario.read(file)
    done = _STUDIES[study](read, str(file), settings)

    def write(folder: Path) -> None:
        read.to_yaml(folder / "leg.yaml")
        done.write(folder)

    return Report(done.text, (done.table,), (), write, done.numbers)


class _Done(NamedTuple):
    """A finished study: its verdict, its table, data for JSON, and the function that writes its files."""

    text: str
    table: Listing
    numbers: dict[str, object]
    write: Callable[[Path], None]


def _land(read: LegScenario, source: str, settings: dict[str, Any]) -> _Done:
    from mckibben import report
    from mckibben.dataset.schema import write_netcdf
    from mckibben.leg.landing import study_landing

    study = study_landing(read, source=source, **settings)

    def write(folder: Path) -> None:
        write_netcdf(study.table, folder / "landing.nc")
        report.save(report.landing_forces(study), folder, "landing")

    return _Done(study.describe(), study.listing(), study.records(), write)


def _jump(read: LegScenario, source: str, settings: dict[str, Any]) -> _Done:
    from mckibben import report
    from mckibben.leg.jumping import study_jump

    study = study_jump(read, source=source, **settings)

    def write(folder: Path) -> None:
        for name, jump in study.jumps.items():
            jump.run.to_netcdf(folder / f"{name}.nc")
        report.save(report.jump_traces(study), folder, "jump")

    return _Done(study.describe(), study.listing(), study.records(), write)


def _stiffness(read: LegScenario, source: str, settings: dict[str, Any]) -> _Done:
    from mckibben import report
    from mckibben.leg.foot_pressures import solve_foot_stiffness
    from mckibben.report.leg import foot_ellipses

    solved = solve_foot_stiffness(read, source=source)
    assert read.stiffness is not None
    angles = read.leg.posture_angles(read.stiffness.posture)

    def write(folder: Path) -> None:
        report.save(foot_ellipses(read.leg, angles, found=solved), folder, "foot_stiffness")

    return _Done(solved.describe(), solved.listing(read.leg), solved.record(read.leg), write)


_STUDIES = {"land": _land, "jump": _jump, "stiffness": _stiffness}
