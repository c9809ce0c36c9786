"""`mckibben envelope` and `mckibben size`: reachability of a scenario, and a joint from a requirement."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import Extrapolate, parse_optional_quantity

if TYPE_CHECKING:
    from mckibben.reachability import Envelope, Selection


@command
def envelope(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with the joint and reference.")],
    smoothing: Annotated[
        str, Option(metavar="TIME", help="Smoothing of jumps and corners. Default: the narrowest trackable one.")
    ] = "",
    extrapolate: Extrapolate = False,
) -> Envelope:
    """Show the attainable set, whether the reference is trackable, and what would be."""
    width = parse_optional_quantity("--smoothing", smoothing, "s")
    from mckibben import reachability
    from mckibben.scenario import Scenario

    read = Scenario.read(scenario)
    read = read.with_extrapolation() if extrapolate else read
    return reachability.envelope(read, smoothing=width)


@command
def size(
    requirement: Annotated[
        Path, Argument(metavar="REQUIREMENT.yaml", help="Load, motion, stiffness and supply, see docs/size.md.")
    ],
) -> Selection:
    """Size a joint: muscles and pulleys, or lengths of a given joint, with valves and air supply; simulate it."""
    from mckibben.reachability import Requirement
    from mckibben.reachability import size as run

    return run(Requirement.read(requirement)).simulated()
