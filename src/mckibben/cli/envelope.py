"""`mckibben envelope`: what a joint can hold, whether a reference can be followed, and what would be needed for it."""

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
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="Whose joint and reference.")],
    margin: Annotated[
        str, typer.Option(metavar="PART", help="Of the band, that nearest references stay off either end.")
    ] = "5 %",
    rounding: Annotated[
        str,
        typer.Option(
            metavar="TIME", help="Over which jumps and corners are rounded off; the least that does, unless given."
        ),
    ] = "",
    design: Annotated[
        str | None,
        typer.Option(metavar="WISH", help="Choose lengths instead, for 'stiffness 12..18 N*m/rad over -20..20 deg'."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'NAME=RANGE'",
            help="What a design may choose: 'connector_length=150..260 mm', joint_radius, joint_length, "
            "muscle_length, muscle1_length, muscle2_length. May be given several times.",
        ),
    ] = None,
    spare_torque: Annotated[
        str, typer.Option(metavar="TORQUE", help="That a design gives either way besides holding the load.")
    ] = "0 N*m",
    minimum_tension: Annotated[str, typer.Option(metavar="FORCE", help="That each muscle of a design keeps.")] = "0 N",
    json: Json = False,
    out: Out = None,
) -> None:
    """Show what a joint can hold, whether the reference can be followed, and the nearest that can; or design it."""
    if out:
        make_folder(out)
    part = parse_quantity("--margin", margin, "1")
    time = parse_optional_quantity("--rounding", rounding, "s")
    spare = parse_quantity("--spare-torque", spare_torque, "N*m")
    tension = parse_quantity("--minimum-tension", minimum_tension, "N")
    if design is None and (vary or spare or tension):
        raise ParameterError(
            "--vary, --spare-torque and --minimum-tension are for a design",
            remedy="add --design 'stiffness 12..18 N*m/rad over -20..20 deg'",
        )
    if design is not None and not vary:
        raise ParameterError("a design varies nothing", remedy="add --vary 'connector_length=150..260 mm'")
    from mckibben.study.scenario import Scenario

    read = Scenario.read(scenario)
    if design is None:
        from mckibben.reachability import envelope as run

        _show(run(read, margin=part, rounding=time), json, out)
        return
    from mckibben.reachability import design as choose
    from mckibben.reachability import read_choice, read_wanted

    wanted = read_wanted(design, torque=spare)
    choices = [read_choice(text) for text in vary or []]
    _show_design(read, choose(read.plant(), wanted, choices, minimum_tension=tension), json, out)


def _show(found: Envelope, json: bool, out: Path | None) -> None:
    from mckibben.reachability import HEADERS, keep_offer
    from mckibben.study.reporting import to_json, write_json
    from mckibben.units import deg

    numbers, holds = found.records(), found.holds
    if json:
        typer.echo(to_json(numbers))
    else:
        title = f"{found.scenario.name}: held standing from {holds.first / deg:.4g} to {holds.last / deg:.4g} deg"
        if holds.first <= holds.last:
            table(title, HEADERS, found.rows())
        typer.echo(found.verdict())
        for offer in found.offers:
            typer.echo(f"nearest that keeps the {offer.kept.name.lower()}: {offer.describe()}")
        if not found.following.reachable and not found.offers:
            typer.echo("no smaller or slower motion about this centre can be followed either")
    if out:
        from mckibben.report.joint import envelope as draw
        from mckibben.report.style import save

        names = ["results.json"]
        for offer in found.offers:
            names += keep_offer(found.scenario, offer, out, f"nearest-{offer.kept.name.lower()}")
        write_json(out / "results.json", numbers)
        save(draw(found), out, "envelope")
        notify(f"kept {', '.join(names)} and envelope.png and .svg in {out}", json)


def _show_design(scenario: Scenario, found: Design, json: bool, out: Path | None) -> None:
    from mckibben.reachability import holdable, keep_design
    from mckibben.study.reporting import to_json, write_json
    from mckibben.units import mm

    numbers = found.records()
    if json:
        typer.echo(to_json(numbers))
    else:
        rows = [
            (name.replace("_", " "), f"{found.before[name] / mm:.4g} mm", f"{value / mm:.4g} mm")
            for name, value in found.lengths.items()
        ]
        table(f"{scenario.name}: {found.wanted.describe()}", ("length", "before", "found"), rows)
        table("Attained", ("angle", "stiffness"), found.rows())
        typer.echo(found.describe())
    if out:
        from mckibben.report.joint import design as draw
        from mckibben.report.style import save

        names = ["results.json"]
        if keep_design(scenario, found, out / "design.yaml"):
            names.append("design.yaml")
        else:
            typer.echo(
                "no scenario is kept: a muscle's length belongs to its specimen, which the catalog has", err=True
            )
        write_json(out / "results.json", numbers)
        about = sum(found.wanted.angles) / 2
        save(draw(found, holdable(scenario.plant(), about=about)), out, "design")
        notify(f"kept {', '.join(names)} and design.png and .svg in {out}", json)
