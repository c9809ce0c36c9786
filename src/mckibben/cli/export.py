"""`mckibben export`: controllers and models for other programs."""

from __future__ import annotations

from pathlib import Path

from mckibben.cli.command import plain_command, present
from mckibben.cli.options import echo, keeping, required_folder
from mckibben.errors import ParameterError


@plain_command
def export(
    scenario: Path,
    to: str = "",
    out: Path | None = None,
    name: str = "",
    hardware: Path | None = None,
    over: list[str] | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Write a scenario's controller or plant, or a robot, for other programs.

    Parameters
    ----------
    scenario : SCENARIO.yaml
        Scenario or robot; see examples/.
    to : FORMAT
        c: the controller as C99. firmware: with drivers and protocol, for a board. js: the controller as JavaScript,
        for pages. fmu, fmu-controller: FMUs, the joint with load and valves, or the controller. mjcf: joint and muscles
        for MuJoCo. page: one HTML file in which the joint moves and its runs are computed, without an installation.
    out : DIR
        Output folder.
    name : NAME
        Name of the program or model.
    hardware : HARDWARE.yaml
        Limits of a controller's samples, size of its numbers, board and parts of firmware.
    over : NAME=LOW..HIGH
        Slider of a page, repeatable; by default the reference and what is uncertain.
    force
        Replace the results of an earlier run in DIR.
    json
        Print machine-readable results instead of a table.
    """
    if not to:
        raise ParameterError("the export needs a format", remedy="give one with --to FORMAT, such as --to c --out DIR")
    from mckibben.export import export as write
    from mckibben.export.hardware import Hardware
    from mckibben.export.targets import CONTROLLERS, check_target
    from mckibben.scenario import Scenario

    check_target(to)
    folder = required_folder(out, "export")
    with keeping(folder):
        read = Scenario.read(scenario)
        parts = None if hardware is None else Hardware.read(hardware, joint_type=read.joint_type)
        if to != "mjcf" and (count := len(read.muscle_names)):
            seconds, what = (count**2 / 4, " with margins") if to in CONTROLLERS else (count**2 / 15, "")
            echo(f"the export of {count} muscles{what} takes about {seconds:.0f} s of processor time", err=True)
        exported = write(read, to, folder, name=name, hardware=parts, over=over or (), margins=True, overwrite=force)
    present(exported, json=json)
    echo(f"wrote {', '.join(exported.contents)} to {folder}", err=json)
