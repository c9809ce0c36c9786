"""`mckibben robot`: landing and jumping of a robot, and stiffness of its foot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mckibben.cli.command import command
from mckibben.cli.options import Progress, check_results, check_unused, required_folder
from mckibben.cli.report import Report
from mckibben.storage.store import STUDY, check_study

if TYPE_CHECKING:
    from mckibben.result import Result
    from mckibben.robot.scenario import RobotScenario


@command
def robot(
    study: Literal["land", "jump", "stiffness"],
    file: Path,
    *,
    out: Path | None,
    resume: bool,
    progress: Progress = None,
) -> Result:
    """Study a robot: drop landings over stiffness, height and valve; the highest jumps; pressures for a stiffness of
    its foot. Landings and jumps are kept in DIR, and can be resumed.

    Parameters
    ----------
    study : land|jump|stiffness
        Study, of which the file has the settings.
    file : ROBOT.yaml
        Robot; see examples/robot/.
    """
    if study == "stiffness":
        check_unused("robot stiffness", resume=resume)
    elif out or resume:
        check_study(required_folder(out, "study to be continued") / STUDY, resume=resume)
    from mckibben.robot.jumping import JumpStudy, study_jump
    from mckibben.robot.landing import LandingStudy, study_landing
    from mckibben.robot.scenario import RobotScenario

    kind = {"land": LandingStudy, "jump": JumpStudy}.get(study, Report)
    if out:
        check_results(out, kind, resume)
    read = RobotScenario.read(file)
    if study == "stiffness":
        return _stiffness(read, str(file))
    run = study_landing if study == "land" else study_jump
    return run(read, source=str(file), out=out, resume=resume, progress=progress)


def _stiffness(read: RobotScenario, source: str) -> Report:
    from mckibben import report
    from mckibben.report.robot import foot_ellipses
    from mckibben.robot.foot_pressures import solve_foot_stiffness

    solved = solve_foot_stiffness(read, source=source)
    assert read.stiffness is not None
    angles = read.robot.posture_angles(read.stiffness.posture)

    def write(folder: Path) -> None:
        read.to_yaml(folder / "robot.yaml")
        report.save(foot_ellipses(read.robot, angles, found=solved), folder, "foot_stiffness")

    return Report(solved.describe(), (solved.listing(read.robot),), (), write, solved.record(read.robot))
