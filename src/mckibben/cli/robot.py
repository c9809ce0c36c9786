"""`mckibben robot`: landing and jumping of a robot, and stiffness of its foot."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument

from mckibben.cli.command import command
from mckibben.cli.options import Progress, check_results, check_unused, parse_limits, required_folder
from mckibben.errors import ParameterError
from mckibben.result import Listing, Remark, Result, TableColumns, table

if TYPE_CHECKING:
    from mckibben.scenario.robot import RobotScenario
    from mckibben.statics.attainable import JointRange
    from mckibben.statics.pressures import StaticPressures

_MUSCLE = "Muscle of all tendons that are read; or `muscles`, by patterns of their names."


@command
def robot(
    study: Literal["land", "jump", "pressures", "stiffness", "read"],
    file: Path,
    muscle: Annotated[Path | None, Argument(metavar="MUSCLE.yaml", help=_MUSCLE)] = None,
    *,
    root: str | None = None,
    range_: str | None = None,
    hold_slides: bool = False,
    out: Path | None,
    resume: bool,
    force: bool,
    progress: Progress = None,
) -> Result:
    """Study a robot: drop landings over stiffness, height and valve; the highest jumps; pressures for a stiffness of
    its foot or joints. Landings and jumps are kept in DIR, and can be resumed. Or read MJCF or URDF, and write
    DIR/robot.yaml.

    Parameters
    ----------
    study : land|jump|pressures|read
        Study, of which the file has the settings; or read.
    file : ROBOT.yaml
        Robot, see examples/robot/; or a file of MJCF or URDF to read.
    root : BODY
        Base, or first body, of the robot that is read, where others move beside it.
    range_ : RANGE
        Range of hinges that are read and have none [default: -180..180 deg].
    hold_slides
        Hold the slides that are read where they are.
    """
    if study == "stiffness":
        remedy = f"mckibben robot pressures {file}; `mckibben stiffness` measures what a push feels"
        raise ParameterError("the pressures for a stiffness are called pressures", field="robot", remedy=remedy)
    if study in ("pressures", "read"):
        check_unused(f"robot {study}", resume=resume)
    elif resume:
        required_folder(out, "study to be continued")
    if study == "read":
        return _read(file, muscle, root, range_, out, hold_slides=hold_slides)
    check_unused(f"robot {study}", muscle=muscle, root=root, range=range_, hold_slides=hold_slides)
    from mckibben.scenario.robot import RobotScenario
    from mckibben.study.jumping import JumpStudy, study_jump
    from mckibben.study.landing import LandingStudy, study_landing

    kind = {"land": LandingStudy, "jump": JumpStudy}.get(study, RobotPressures)
    if out:
        check_results(out, kind.file_names(), resume=resume, force=force)
    scenario = RobotScenario.read(file)
    if study == "pressures":
        return _pressures(scenario, str(file))
    run = study_landing if study == "land" else study_jump
    return run(scenario, source=str(file), out=out, resume=resume, progress=progress)


def _read(
    file: Path, muscle: Path | None, root: str | None, limits: str | None, out: Path | None, *, hold_slides: bool
) -> Result:
    from mckibben.scenario.reading import read_mjcf, read_tendon_muscles

    angles = parse_limits("--range", limits or "-180..180 deg", "rad")
    muscles = None if muscle is None else read_tendon_muscles(muscle)
    read = read_mjcf(file, muscles, root=root, angles=angles, hold_slides=hold_slides)
    if out:
        read.scenario()  # fails before anything is written
    return read


class RobotPressures(Result):
    """Pressures for a stiffness that the file of a robot asks for, and what is attainable in its posture."""

    attainable: dict[str, JointRange]
    pressures: StaticPressures | None
    in_posture: bool

    def verdict(self) -> str:
        """Return the verdict on the pressures."""
        posture = "in the posture of the file" if self.in_posture else "with angles near 0"
        missing = "" if self.in_posture else "no section `stiffness`: "
        return self.pressures.verdict() if self.pressures else f"{missing}what is attainable {posture}"

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks on the pressures."""
        return self.pressures.remarks() if self.pressures else ()

    def declared(self) -> TableColumns:
        """Return the numbers of the pressures."""
        return self.pressures.declared() if self.pressures else {}

    @table()
    def joints(self) -> list[Listing]:
        """Attainable torque and stiffness of each joint."""
        from mckibben.statics.attainable import attainable_listing

        return [attainable_listing(self.attainable)]


def _pressures(read: RobotScenario, source: str) -> Result:
    from mckibben.report.robot import point_ellipses, posture
    from mckibben.scenario.statics import solve_statics

    attainable, solved = solve_statics(read, source=source)
    angles = read.robot.posture_angles({} if read.stiffness is None else read.stiffness.posture)
    pressures, stiffness = (None, None) if solved is None else (solved.pressures, solved.joint_stiffness)
    point = None if read.stiffness is None else read.stiffness.point
    drawings = {"posture": lambda: posture(read.robot, angles, pressures, stiffness=stiffness, point=point)}
    if solved is not None and solved.stiffness is not None:
        drawings["point_stiffness"] = lambda: point_ellipses(read.robot, angles, found=solved, point=point)
    result = RobotPressures(attainable, solved, read.stiffness is not None)
    return result.with_files({"robot.yaml": read.to_yaml}, drawings)
