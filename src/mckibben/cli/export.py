"""`mckibben export`: controllers and models for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mckibben.cli.options import Force, Json, echo, keeping, required_folder
from mckibben.storage.files import to_json

_FORMATS = (
    "c: the controller as C99, for microcontrollers. js: the controller as JavaScript, for pages. fmu, fmu-controller, "
    "fmu-muscle: FMI 2.0, the joint with load and valves, the controller, or a muscle. mjcf, osim: joint and "
    "muscles for MuJoCo and OpenSim."
)


def export(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario file; see examples/.")],
    to: Annotated[str, Option(metavar="FORMAT", help=_FORMATS)],
    out: Annotated[Path | None, Option(metavar="DIR", help="Output folder.")] = None,
    name: Annotated[str, Option(metavar="NAME", help="Of the program or model.")] = "",
    single: Annotated[bool, Option("--single", help="Numbers of 32 bits, of c: for processors without 64.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a scenario's controller or plant for other programs."""
    out = required_folder(out, "export")
    from mckibben.export import export as write
    from mckibben.study.scenario import Scenario

    with keeping(out):
        made = write(Scenario.read(scenario), to, out, name=name, single=single, overwrite=force)
    if json:
        echo(to_json({"files": list(made.files), "left_out": list(made.left_out)}))
        return
    echo(f"wrote {', '.join(made.files)} to {out}")
    for one in made.left_out:
        echo(f"left out: {one}")
