"""`mckibben leg`: landing and jumping of a leg, and stiffness of its foot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mckibben.cli.command import command
from mckibben.cli.options import Progress, check_results, check_unused, required_folder
from mckibben.cli.report import Report
from mckibben.storage.store import STUDY, check_study

if TYPE_CHECKING:
    from mckibben.leg.scenario import LegScenario
    from mckibben.result import Result


@command
def leg(
    study: Literal["land", "jump", "stiffness"],
    file: Path,
    *,
    out: Path | None,
    resume: bool,
    progress: Progress = None,
) -> Result:
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
    elif out or resume:
        check_study(required_folder(out, "study to be continued") / STUDY, resume=resume)
    from mckibben.leg.jumping import JumpStudy, study_jump
    from mckibben.leg.landing import LandingStudy, study_landing
    from mckibben.leg.scenario import LegScenario

    kind = {"land": LandingStudy, "jump": JumpStudy}.get(study, Report)
    if out:
        check_results(out, kind, resume)
    read = LegScenario.read(file)
    if study == "stiffness":
        return _stiffness(read, str(file))
    run = study_landing if study == "land" else study_jump
    return run(read, source=str(file), out=out, resume=resume, progress=progress)


def _stiffness(read: LegScenario, source: str) -> Report:
    from mckibben import report
    from mckibben.leg.foot_pressures import solve_foot_stiffness
    from mckibben.report.leg import foot_ellipses

    solved = solve_foot_stiffness(read, source=source)
    assert read.stiffness is not None
    angles = read.leg.posture_angles(read.stiffness.posture)

    def write(folder: Path) -> None:
        read.to_yaml(folder / "leg.yaml")
        report.save(foot_ellipses(read.leg, angles, found=solved), folder, "foot_stiffness")

    return Report(solved.describe(), (solved.listing(read.leg),), (), write, solved.record(read.leg))
