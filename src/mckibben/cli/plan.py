"""`mckibben plan`, `mckibben stiffness` and `mckibben margins`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import (
    Data,
    Reading,
    echo,
    keeping,
    notify,
    parse_limits,
    parse_optional_quantity,
    parse_quantity,
    reads_files,
)
from mckibben.errors import ParameterError, UnitError
from mckibben.storage.files import to_json, write_json
from mckibben.units import quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mckibben.experiment_design import ExperimentPlan
    from mckibben.simulation import Margins
    from mckibben.study.stiffness import StiffnessTests


@reads_files("contraction", "sample_rate", "specimen")
@command
def plan(
    data: Data,
    law: Annotated[str, Option(help="Kind of law; 'mckibben catalog' lists them.")] = "exponential",
    of: Annotated[
        str,
        Option(
            "--for",
            metavar="QUANTITY",
            help="Quantity of interest: a coefficient such as 'decay'; 'force', or 'force at 0..10 %, "
            "3..6 bar'; 'stiffness' or 'torque', or 'stiffness at 5 deg, 2 bar, 4 bar'.",
        ),
    ] = "force",
    points: Annotated[int, Option(metavar="N", help="Number of points.")] = 8,
    joint: Annotated[
        str, Option(metavar="JOINT", help="Joint for stiffness and torque: from the catalog, or a scenario file.")
    ] = "knee-table-2",
    limits: Annotated[
        str, Option(metavar="RANGES", help="Contraction and pressure, '0..20 %, 1..6 bar' (default: the specimen's).")
    ] = "",
    step: Annotated[
        str, Option(metavar="STEPS", help="Resolution of the rig, '0.5 %, 0.25 bar'; or a length, '1 mm' (default).")
    ] = "",
    noise: Annotated[str, Option(metavar="FORCE", help="Error of a point (default: from the residuals).")] = "",
    guess: Annotated[
        str, Option(metavar="LAW", help="Fit file or catalog law to linearise about if the data do not determine one.")
    ] = "",
    specimen: Annotated[
        str, Option(metavar="NAME", help="Specimen, or its file (default: the one named in the data).")
    ] = "",
    *,
    reading: Reading,
) -> ExperimentPlan:
    """Plan the next test: the points that most reduce the uncertainty of a quantity, and diagnostics of the data."""
    from mckibben import catalog
    from mckibben.experiment_design import parse_quantity_of_interest
    from mckibben.experiment_design import plan as run
    from mckibben.muscle import Domain
    from mckibben.study.inputs import joint_named, law_named, law_type_named, specimen_named

    law_type = law_type_named(law)
    known = specimen_named(specimen) if specimen else None
    interest = parse_quantity_of_interest(of, law_type, lambda: joint_named(joint))
    initial = law_named(guess, specimen=specimen) if guess else None
    ranges = _pair("--limits", limits, "0..20 %, 1..6 bar")
    box = (
        Domain(*parse_limits("--limits", ranges[0], "1"), *parse_limits("--limits", ranges[1], "Pa"))
        if limits
        else None
    )
    read = reading.data(data)
    in_catalog = read.table.attrs["specimen"] in catalog.names("specimens")
    muscle = known or (catalog.specimen(read.table.attrs["specimen"]) if in_catalog else None)
    length = read.table.attrs.get("initial_length") or (float(muscle.initial_length) if muscle else None)
    steps = _pair("--step", step, "0.5 %, 0.25 bar")
    resolution = {"pressure_step": parse_quantity("--step", steps[1], "Pa")} if step else {}
    return run(
        read,
        interest,
        law_type,
        points=points,
        limits=box,
        specimen=known,
        contraction_step=_contraction_step(steps[0], length),
        noise=parse_optional_quantity("--noise", noise, "N"),
        guess=initial,
        **resolution,
    )


def _pair(option: str, text: str, example: str) -> tuple[str, str]:
    """Both parts of an option; empty without one."""
    first, comma, second = (part.strip() for part in text.partition(","))
    if text and not (first and comma and second):
        raise ParameterError(f"{option} {text!r} is not a pair", value=text, remedy=f"write it like '{example}'")
    return first, second


def _contraction_step(text: str, length: float | None) -> float | None:
    if not text:
        return None
    try:
        return quantity(text, "1")
    except UnitError:
        step = parse_quantity("--step", text, "m")
    if length is None:
        raise ParameterError(
            f"--step {text!r} is a length, and the initial length of the muscle is unknown",
            remedy="give the step in percent, or --initial-length",
        )
    return step / length


@command
def stiffness(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with joint, valve and controller.")],
    amplitude: Annotated[str, Option(metavar="RANGE", help="Amplitudes of the motion.")] = "0.01..10 deg",
    rate: Annotated[str, Option(metavar="RANGE", help="Rates of the motion.")] = "0.1..10 Hz",
    progress: Any = None,
) -> StiffnessTests:
    """Test the stiffness of a joint over amplitude and rate of a motion, at the setpoint held by its controller."""
    amplitudes, rates = parse_limits("--amplitude", amplitude, "rad"), parse_limits("--rate", rate, "Hz")
    from mckibben.component.checks import check_positive

    for option, (low, _), unit in (("--amplitude", amplitudes, "rad"), ("--rate", rates, "Hz")):
        check_positive(option, unit, lowest=low)
    import numpy as np

    from mckibben.scenario import Scenario
    from mckibben.study.stiffness import stiffness_tests

    read = Scenario.read(scenario)
    return stiffness_tests(
        read, np.unique(np.geomspace(*amplitudes, 13)), np.unique(np.geomspace(*rates, 5)), progress=progress
    )


def _present(
    numbers: dict[str, Any],
    name: str,
    draw: Callable[[], Figure],
    show: Callable[[], None],
    out: Path | None,
    json: bool,
) -> None:
    """Keep numbers and a figure in a folder, if there is one, and print the numbers as JSON or as tables."""
    if out:
        from mckibben.report.style import save

        with keeping(out):
            write_json(out / "results.json", numbers)
            save(draw(), out, name)
    if json:
        echo(to_json(numbers))
    else:
        show()
    if out:
        notify(f"wrote results.json, {name}.png and {name}.svg to {out}", json)


@command
def margins(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with joint, valve and controller.")],
    points: Annotated[int, Option(min=1, max=1000, help="Operating points along the reference.")] = 20,
) -> Margins:
    """Compute the stability margins of the sampled loop at operating points along the reference."""
    from mckibben.scenario import Scenario

    return Scenario.read(scenario).margins(points)
