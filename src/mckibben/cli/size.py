"""`mckibben size`: muscles, pulleys, valves and air supply from a requirement."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from mckibben.cli.options import (
    Force,
    Json,
    Out,
    echo,
    keeping,
    notify,
    parse_limits,
    parse_optional_quantity,
    parse_positive,
    parse_quantity,
    results_folder,
    table,
)
from mckibben.errors import ParameterError
from mckibben.storage.files import atomic_write, to_json, write_json

if TYPE_CHECKING:
    from mckibben.joint import Load
    from mckibben.reachability import Selection
    from mckibben.scenario import Scenario

_FIGURES = ("joint", "selection")


def size(
    muscles: Annotated[
        list[Path] | None,
        Argument(metavar="[MUSCLE.yaml]...", help="Muscles of any length, in addition to those of the catalog."),
    ] = None,
    angles: Annotated[str, Option(metavar="RANGE", help="Range of motion, such as '-30..30 deg'.")] = "",
    cycle: Annotated[str, Option(metavar="TIME", help="Time from one end to the other and back.")] = "",
    speed: Annotated[str, Option(metavar="SPEED", help="Highest speed in place of --cycle, such as '90 deg/s'.")] = "",
    supply: Annotated[str, Option(metavar="PRESSURE", help="Pressure of the supply.")] = "6 bar",
    mass: Annotated[str, Option(metavar="MASS", help="Mass of the load, at the end of the arm.")] = "",
    arm: Annotated[str, Option(metavar="LENGTH", help="Distance of the mass from the axis.")] = "",
    hanging: Annotated[str, Option(metavar="ANGLE", help="Angle at which the mass hangs below the axis.")] = "",
    inertia: Annotated[
        str, Option(metavar="INERTIA", help="Inertia of a load without gravity, in place of mass and arm.")
    ] = "",
    torque: Annotated[
        str, Option(metavar="TORQUE", help="Torque in either direction, in addition to gravity and inertia.")
    ] = "0 N*m",
    stiffness: Annotated[
        str, Option(metavar="STIFFNESS", help="Stiffness or range, such as '15..25 N*m/rad', throughout the motion.")
    ] = "",
    catalog: Annotated[bool, Option(help="Consider the muscles of the catalog.")] = True,
    spread: Annotated[
        str, Option(metavar="FRACTION", help="Spread of the forces among specimens of a muscle file.")
    ] = "10 %",
    longest: Annotated[str, Option(metavar="LENGTH", help="Longest muscle.")] = "1 m",
    widest: Annotated[str, Option(metavar="LENGTH", help="Largest radius of a pulley.")] = "150 mm",
    tube: Annotated[str, Option(metavar="LENGTH", help="Tube between valve and muscle.")] = "1 m",
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Select muscles, pulleys, valves and air supply of a joint for load, motion, stiffness and supply pressure."""
    names = [f"{name}.{end}" for name in _FIGURES for end in ("png", "svg")]
    results_folder(out, ("results.json", "scenario.yaml", "parts.csv", *names), force)
    if not angles:
        raise ParameterError("the range of motion is missing", remedy="add --angles '-30..30 deg'")
    ends = parse_limits("--angles", angles, "rad")
    if bool(cycle) == bool(speed):
        raise ParameterError("the duration is given by --cycle or by --speed", remedy="add --cycle '2 s'")
    if cycle:
        period = parse_quantity("--cycle", cycle, "s")
    else:
        period = math.pi * (ends[1] - ends[0]) / parse_positive("--speed", speed, "rad/s")
    from mckibben.reachability import Requirement, catalog_makes, read_make
    from mckibben.reachability import size as run

    requirement = Requirement(
        _load(mass, arm, hanging, inertia),
        ends,
        period,
        parse_quantity("--supply", supply, "Pa"),
        stiffness=parse_limits("--stiffness", stiffness, "N*m/rad") if stiffness else None,
        torque=parse_quantity("--torque", torque, "N*m"),
        longest=parse_quantity("--longest", longest, "m"),
        widest=parse_quantity("--widest", widest, "m"),
    )
    part = parse_quantity("--spread", spread, "1")
    makes = [read_make(path, part) for path in muscles or ()] + list(catalog_makes() if catalog else ())
    found = run(requirement, makes, tube_length=parse_positive("--tube", tube, "m"))
    scenario = found.scenario()
    checks = found.verify(scenario.simulate())
    numbers = {**found.records(), "simulated": [one._asdict() for one in checks]}
    if out:
        with keeping(out):
            _keep(out, found, scenario)
            write_json(out / "results.json", numbers)
    if json:
        echo(to_json(numbers))
    else:
        table(requirement.describe(), found.headers, found.rows())
        for remark in found.remarks():
            echo(remark)
        table(f"Parts of {found.best.make.name}", ("number", "part", "size"), found.parts())
        rows = [(one.requirement, one.found, "met" if one.met else "not met") for one in checks]
        table("Simulated with these parts", ("requirement", "found", ""), rows)
    if out:
        kept = "joint (.png, .svg) and selection (.png, .svg)"
        notify(f"wrote results.json, scenario.yaml, parts.csv, {kept} to {out}", json)
    if not all(one.met for one in checks):
        raise Exit(1)


def _load(mass: str, arm: str, hanging: str, inertia: str) -> Load:
    from mckibben.joint import GeneralLoad, PendulumLoad

    heavy, distance = parse_optional_quantity("--mass", mass, "kg"), parse_optional_quantity("--arm", arm, "m")
    turning = parse_optional_quantity("--inertia", inertia, "kg*m^2")
    if turning is not None and heavy is None and distance is None and not hanging:
        return GeneralLoad(inertia=turning, greatest_gravity_torque=0.0)
    if turning is not None or heavy is None or distance is None:
        raise ParameterError(
            "the load is a mass on an arm, or an inertia",
            remedy="give --mass '2 kg' --arm '250 mm' and, if it does not hang at 0, --hanging; or --inertia alone",
        )
    return PendulumLoad(heavy, distance, hanging_angle=parse_optional_quantity("--hanging", hanging, "rad") or 0.0)


def _keep(out: Path, found: Selection, scenario: Scenario) -> None:
    from mckibben import report

    scenario.to_yaml(out / "scenario.yaml")
    with atomic_write(out / "parts.csv", overwrite=True) as part, part.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("number", "part", "size"), *found.parts()])
    report.save(report.draw_joint(found.best.plant, found.requirement.middle), out, "joint")
    report.save(report.selection(found), out, "selection")
