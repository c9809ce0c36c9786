"""`mckibben export`: controllers and models for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mckibben.cli.command import present
from mckibben.cli.options import Force, Json, keeping, notify, required_folder
from mckibben.errors import ParameterError

_FORMATS = (
    "c: the controller as C99, for microcontrollers. js: the controller as JavaScript, for pages. fmu, fmu-controller, "
    "fmu-muscle: FMUs, the joint with load and valves, the controller, or a muscle. mjcf, warp, osim: joint and "
    "muscles for MuJoCo, MuJoCo Warp and OpenSim. For a leg: mjcf or warp."
)


def export(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario or leg; see examples/.")],
    to: Annotated[str, Option(metavar="FORMAT", help=_FORMATS)] = "",
    out: Annotated[Path | None, Option(metavar="DIR", help="Output folder.")] = None,
    name: Annotated[str, Option(metavar="NAME", help="Name of the program or model.")] = "",
    single: Annotated[
        bool, Option("--single", help="32-bit numbers, with c: for processors without 64-bit units.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a scenario's controller or plant, or a leg, for other programs."""
    if not to:
        raise ParameterError("the export needs a format", remedy="give one with --to FORMAT, such as --to c --out DIR")
    folder = required_folder(out, "export")
    from mckibben.config.document import read_document
    from mckibben.config.model import read_text
    from mckibben.export import export as write
    from mckibben.leg import LegScenario
    from mckibben.scenario import Scenario

    kind = LegScenario if "leg" in (read_document(read_text(scenario)).data or ()) else Scenario
    with keeping(folder):
        exported = write(kind.read(scenario), to, folder, name=name, single=single, overwrite=force)
    present(exported, json=json, out=None, force=False)
    notify(f"wrote {', '.join(exported.contents)} to {folder}", json)
