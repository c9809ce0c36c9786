"""`mckibben export`: controllers and models for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from mckibben.cli.options import Force, Json, echo, keeping, required_folder
from mckibben.errors import ParameterError, quoted
from mckibben.storage.files import to_json

if TYPE_CHECKING:
    from mckibben.export import Exported

_FORMATS = (
    "c: the controller as C99, for microcontrollers. js: the controller as JavaScript, for pages. fmu, fmu-controller, "
    "fmu-muscle: FMUs, the joint with load and valves, the controller, or a muscle. mjcf, osim: joint and "
    "muscles for MuJoCo and OpenSim. For a leg: mjcf, warp, or urdf without its muscles."
)


def export(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario or leg; see examples/.")],
    to: Annotated[str, Option(metavar="FORMAT", help=_FORMATS)] = "",
    out: Annotated[Path | None, Option(metavar="DIR", help="Output folder.")] = None,
    name: Annotated[str, Option(metavar="NAME", help="Name of the program or model.")] = "",
    single: Annotated[
        bool, Option("--single", help="32-bit numbers, with c: for processors without 64-bit units.")
    ] = False,
    fmi: Annotated[
        float | None, Option(metavar="VERSION", help="FMI version of an FMU, 2 or 3. Default: 2.", show_default=False)
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a scenario's controller or plant, or a leg, for other programs."""
    if not to:
        raise ParameterError("the export needs a format", remedy="give one with --to FORMAT, such as --to c --out DIR")
    out = required_folder(out, "export")
    from mckibben.config.document import read_document
    from mckibben.config.model import read_text

    with keeping(out):
        if "leg" in (read_document(read_text(scenario)).data or ()):
            made = _export_leg(scenario, to, out, name, single, fmi, force)
        else:
            from mckibben.export import export as write
            from mckibben.scenario import Scenario

            made = write(Scenario.read(scenario), to, out, name=name, single=single, fmi=fmi, overwrite=force)
    if json:
        echo(to_json({"files": list(made.files), "left_out": list(made.left_out)}))
        return
    echo(f"wrote {', '.join(made.files)} to {out}")
    for one in made.left_out:
        echo(f"left out: {one}")


def _export_leg(file: Path, to: str, out: Path, name: str, single: bool, fmi: float | None, force: bool) -> Exported:
    """Export a leg, as MJCF, or for MuJoCo Warp."""
    if to not in ("mjcf", "warp") or single:
        message = f"a leg cannot be written as {quoted(to)}{' in 32 bits' if single else ''}"
        remedy = "give --to mjcf or --to warp, or a scenario of a joint"
        raise ParameterError(message, field="to", value=to, remedy=remedy)
    if fmi is not None:
        raise ParameterError("a leg cannot be an FMU", field="fmi", value=fmi, remedy="leave it out")
    from mckibben.export.leg_mjcf import export_leg
    from mckibben.leg import LegScenario

    options: dict[str, Any] = {"name": name or "leg", "overwrite": force}
    if to == "warp":
        from mckibben.export.warp import warp_leg

        options["files"] = warp_leg
    return export_leg(LegScenario.read(file), out, **options)
