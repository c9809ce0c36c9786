"""`mckibben envelope`: static envelope, trackability of the reference, nearest feasible references, and sizing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.cli.options import Json, Out, notify, parse_optional_quantity, parse_quantity, table
from mckibben.errors import ParameterError
from mckibben.storage.files import make_folder

if TYPE_CHECKING:
    from mckibben.reachability import Design, Envelope
    from mckibben.study.scenario import Scenario


def envelope(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="Scenario with the joint and reference.")],
    margin: Annotated[
        str, typer.Option(metavar="FRACTION", help="Margin of nearest references to both ends of the stiffness band.")
    ] = "5 %",
    smoothing: Annotated[
        str,
        typer.Option(metavar="TIME", help="Smoothing of jumps and corners; the narrowest trackable one unless given."),
    ] = "",
    design: Annotated[
        str | None,
        typer.Option(metavar="TARGET", help="Size the joint for 'stiffness 12..18 N*m/rad over -20..20 deg' instead."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'NAME=RANGE'",
            help="Design variable with its bounds: 'connector_length=150..260 mm', joint_radius, joint_length, "
            "muscle_length, muscle1_length, muscle2_length. May be given several times.",
        ),
    ] = None,
    torque_reserve: Annotated[
        str, typer.Option(metavar="TORQUE", help="Torque of a design in either direction beyond that against gravity.")
    ] = "0 N*m",
    minimum_tension: Annotated[str, typer.Option(metavar="FORCE", help="Minimum muscle tension of a design.")] = "0 N",
    json: Json = False,
    out: Out = None,
) -> None:
    """Show the static envelope, whether the reference is trackable, and the nearest that is; or size the joint."""
    if out:
        make_folder(out)
    fraction = parse_quantity("--margin", margin, "1")
    width = parse_optional_quantity("--smoothing", smoothing, "s")
    reserve = parse_quantity("--torque-reserve", torque_reserve, "N*m")
    tension = parse_quantity("--minimum-tension", minimum_tension, "N")
    if design is None and (vary or reserve or tension):
        raise ParameterError(
            "--vary, --torque-reserve and --minimum-tension are for a design",
            remedy="add --design 'stiffness 12..18 N*m/rad over -20..20 deg'",
        )
    if design is not None and not vary:
        raise ParameterError("a design varies nothing", remedy="add --vary 'connector_length=150..260 mm'")
    from mckibben import reachability
    from mckibben.study.scenario import Scenario

    read = Scenario.read(scenario)
    if design is None:
        _show(reachability.envelope(read, margin=fraction, smoothing=width), json, out)
        return
    target = reachability.parse_target(design, torque_reserve=reserve)
    variables = [reachability.parse_variable(text) for text in vary or []]
    _show_design(read, reachability.design(read.plant(), target, variables, minimum_tension=tension), json, out)


def _show(found: Envelope, json: bool, out: Path | None) -> None:
    from mckibben.reachability import HEADERS, save_reference
    from mckibben.storage.files import to_json, write_json
    from mckibben.units import deg

    numbers, static = found.records(), found.static
    if json:
        typer.echo(to_json(numbers))
    else:
        if static.exists:
            angles = f"{static.angle_min / deg:.4g} to {static.angle_max / deg:.4g} deg"
            table(f"{found.scenario.name}: static range {angles}", HEADERS, found.rows())
        typer.echo(found.verdict())
        for near in found.nearest:
            typer.echo(f"nearest, {near.preserved.name.lower()} preserved: {near.describe()}")
        if not found.trackability.trackable and not found.nearest:
            typer.echo("no smaller or slower motion about this centre is feasible either")
    if out:
        from mckibben.report.joint import envelope as draw
        from mckibben.report.style import save

        names = ["results.json"]
        for near in found.nearest:
            names += save_reference(found.scenario, near, out, f"nearest-{near.preserved.name.lower()}")
        write_json(out / "results.json", numbers)
        save(draw(found), out, "envelope")
        notify(f"kept {', '.join(names)} and envelope.png and .svg in {out}", json)


def _show_design(scenario: Scenario, found: Design, json: bool, out: Path | None) -> None:
    from mckibben.reachability import save_design, static_envelope
    from mckibben.storage.files import to_json, write_json
    from mckibben.units import mm

    numbers = found.records()
    if json:
        typer.echo(to_json(numbers))
    else:
        rows = [
            (name.replace("_", " "), f"{found.initial[name] / mm:.4g} mm", f"{value / mm:.4g} mm")
            for name, value in found.lengths.items()
        ]
        table(f"{scenario.name}: {found.target.describe()}", ("length", "initial", "design"), rows)
        table("Attained", ("angle", "stiffness"), found.rows())
        typer.echo(found.describe())
    if out:
        from mckibben.report.joint import design as draw
        from mckibben.report.style import save

        names = ["results.json"]
        if save_design(scenario, found, out / "design.yaml"):
            names.append("design.yaml")
        else:
            typer.echo("no scenario written: the length of a muscle belongs to its specimen in the catalog", err=True)
        write_json(out / "results.json", numbers)
        about = sum(found.target.angles) / 2
        save(draw(found, static_envelope(scenario.plant(), about=about)), out, "design")
        notify(f"kept {', '.join(names)} and design.png and .svg in {out}", json)
