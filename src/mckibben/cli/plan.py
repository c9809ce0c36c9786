"""`mckibben plan`, `mckibben stiffness`, `mckibben margins` and `mckibben envelope`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import (
    Data,
    Extrapolate,
    Force,
    Json,
    Out,
    Reading,
    check_choice,
    echo,
    job_progress,
    keeping,
    notify,
    on_command_line,
    parse_limits,
    parse_optional_quantity,
    parse_quantity,
    reads_files,
    results_folder,
    table,
)
from mckibben.errors import ParameterError, UnitError
from mckibben.storage.files import to_json, write_json
from mckibben.units import deg, mm, quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mckibben.experiment_design import ExperimentPlan
    from mckibben.muscle import Domain, Specimen
    from mckibben.reachability import Design, Envelope
    from mckibben.scenario import Scenario
    from mckibben.simulation import Margins


_DIRECTIONS = {"both": ("loading", "unloading"), "loading": ("loading",), "unloading": ("unloading",)}


@reads_files("contraction", "sample_rate", "specimen")
def plan(
    data: Data,
    law: Annotated[str, Option(help="Kind of law; 'mckibben catalog' lists them.")] = "exponential",
    of: Annotated[
        str,
        Option(
            "--for",
            metavar="QUANTITY",
            help="Quantity of interest: 'coefficients', or names such as 'decay'; 'force', or 'force at 0..10 %, "
            "3..6 bar'; 'stiffness' or 'torque', or 'stiffness at 5 deg, 2 bar, 4 bar'.",
        ),
    ] = "force",
    points: Annotated[int, Option(metavar="N", help="Number of points.")] = 8,
    joint: Annotated[
        str, Option(metavar="JOINT", help="Joint for stiffness and torque: from the catalog, or a scenario file.")
    ] = "knee-table-2",
    contraction: Annotated[str, Option(metavar="RANGE", help="Limits, '0..20 %' (default: the specimen's).")] = "",
    pressure: Annotated[str, Option(metavar="RANGE", help="Limits, '1..6 bar' (default: the specimen's).")] = "",
    contraction_step: Annotated[str, Option(metavar="STEP", help="Resolution, '0.5 %' or '1 mm' (default).")] = "",
    pressure_step: Annotated[str, Option(metavar="STEP", help="Resolution of the rig's pressure.")] = "0.25 bar",
    directions: Annotated[
        str, Option(metavar="|".join(_DIRECTIONS), help="Directions in which the rig measures.")
    ] = "both",
    repeats: Annotated[int, Option(metavar="N", help="Maximum repetitions of a point.")] = 2,
    friction: Annotated[bool | None, Option(help="Friction is unknown (default: if directions are recorded).")] = None,
    noise: Annotated[str, Option(metavar="FORCE", help="Error of a point (default: from the residuals).")] = "",
    stroke_error: Annotated[str, Option(metavar="FORCE", help="Error of a stroke (default: from the residuals).")] = "",
    guess: Annotated[
        str, Option(metavar="LAW", help="Fit file or catalog law to linearise about if the data do not determine one.")
    ] = "",
    specimen: Annotated[
        str, Option(metavar="NAME", help="Specimen, or its file (default: the one named in the data).")
    ] = "",
    *,
    reading: Reading,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Plan the next test: the points that most reduce the uncertainty of a quantity, and diagnostics of the data."""
    results_folder(out, ("plan.csv", "results.json", "plan.png", "plan.svg"), force)
    check_choice(directions, _DIRECTIONS, "a direction")
    from mckibben import catalog
    from mckibben.experiment_design import parse_quantity_of_interest
    from mckibben.experiment_design import plan as run
    from mckibben.study.inputs import joint_named, law_named, law_type_named, specimen_named

    law_type = law_type_named(law)
    known = specimen_named(specimen) if specimen else None
    quantity = parse_quantity_of_interest(of, law_type, lambda: joint_named(joint))
    initial = law_named(guess, specimen=specimen) if guess else None
    read = reading.data(data)
    in_catalog = read.table.attrs["specimen"] in catalog.names("specimens")
    muscle = known or (catalog.specimen(read.table.attrs["specimen"]) if in_catalog else None)
    length = read.table.attrs.get("initial_length") or (float(muscle.initial_length) if muscle else None)
    found = run(
        read,
        quantity,
        law_type,
        points=points,
        limits=_limits(contraction, pressure, muscle),
        specimen=known,
        contraction_step=_contraction_step(contraction_step, length),
        pressure_step=parse_quantity("--pressure-step", pressure_step, "Pa"),
        directions=_DIRECTIONS[directions],
        repeats=repeats,
        friction=friction,
        noise=parse_optional_quantity("--noise", noise, "N"),
        stroke_error=parse_optional_quantity("--stroke-error", stroke_error, "N"),
        guess=initial,
    )
    numbers = found.records()
    if out:
        from mckibben.report.study import planned
        from mckibben.report.style import save

        with keeping(out):
            found.to_csv(out / "plan.csv")
            write_json(out / "results.json", numbers)
            save(planned(found), out, "plan")
    if json:
        echo(to_json(numbers))
    else:
        _show(found, read.table.attrs["specimen"] or "unnamed specimen")
    if out:
        notify(f"wrote plan.csv, results.json, plan.png and plan.svg to {out}", json)


def _show(found: ExperimentPlan, specimen: str) -> None:
    headers, *rows = found.rows()
    law = type(found.law).__name__.removesuffix("Law")
    table(f"{specimen}, {law} law: {len(rows)} points to measure next, by gain", headers, rows)
    echo(found.summary())
    for sentence in found.sentences():
        echo(sentence)


def _limits(contraction: str, pressure: str, specimen: Specimen | None) -> Domain | None:
    """Design region; missing limits are the specimen's."""
    if not contraction and not pressure:
        return None
    from mckibben.muscle import Domain

    if specimen is None and not (contraction and pressure):
        raise ParameterError(
            "the specimen is unknown: both limits are needed", remedy="give --contraction and --pressure, or --specimen"
        )

    box = specimen.domain if specimen else Domain()
    ends = (box.contraction_min, box.contraction_max), (box.pressure_min, box.pressure_max)
    return Domain(
        *(parse_limits("--contraction", contraction, "1") if contraction else ends[0]),
        *(parse_limits("--pressure", pressure, "Pa") if pressure else ends[1]),
    )


def _contraction_step(text: str, length: float | None) -> float | None:
    if not text:
        return None

    try:
        return quantity(text, "1")
    except UnitError:
        step = parse_quantity("--contraction-step", text, "m")
    if length is None:
        raise ParameterError(
            f"--contraction-step {text!r} is a length, and the initial length of the muscle is unknown",
            remedy="give the step in percent, or --initial-length",
        )
    return step / length


def stiffness(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with joint, valve and controller.")],
    amplitude: Annotated[str, Option(metavar="RANGE", help="Amplitudes of the motion.")] = "0.01..10 deg",
    rate: Annotated[str, Option(metavar="RANGE", help="Rates of the motion.")] = "0.1..10 Hz",
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Test the stiffness of a joint over amplitude and rate of a motion, at the setpoint held by its controller."""
    results_folder(out, ("results.json", "stiffness.png", "stiffness.svg"), force)
    sizes, rates = parse_limits("--amplitude", amplitude, "rad"), parse_limits("--rate", rate, "Hz")
    from mckibben.component.checks import check_positive

    for option, (low, _), unit in (("--amplitude", sizes, "rad"), ("--rate", rates, "Hz")):
        check_positive(option, unit, lowest=low)
    import numpy as np

    from mckibben.scenario import Scenario
    from mckibben.study.stiffness import stiffness_tests

    read = Scenario.read(scenario)
    with job_progress(quiet=json) as report:
        found = stiffness_tests(
            read, np.unique(np.geomspace(*sizes, 13)), np.unique(np.geomspace(*rates, 5)), progress=report
        )
    numbers = found.records()

    def show() -> None:
        table(f"{read.name}: stiffness [N*m/rad]", *found.rows())
        echo(found.describe())

    def draw() -> Figure:
        from mckibben.report.joint import stiffness

        return stiffness(found)

    _present(numbers, "stiffness", draw, show, out, json)


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


def envelope(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with the joint and reference.")],
    margin: Annotated[
        str, Option(metavar="FRACTION", help="Margin of nearest references to both ends of the stiffness band.")
    ] = "5 %",
    smoothing: Annotated[
        str, Option(metavar="TIME", help="Smoothing of jumps and corners. Default: the narrowest trackable one.")
    ] = "",
    design: Annotated[
        str | None,
        Option(metavar="TARGET", help="Size the joint for 'stiffness 12..18 N*m/rad over -20..20 deg' instead."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        Option(
            metavar="'NAME=RANGE'",
            help="Design variable with its bounds, a length of the geometry or muscle_length: "
            "'connector_length=150..260 mm'; 'radius=20..40 mm' or path1.radius of two pulleys. Repeatable.",
        ),
    ] = None,
    torque_reserve: Annotated[
        str, Option(metavar="TORQUE", help="Torque of a design in either direction in excess of gravity.")
    ] = "0 N*m",
    minimum_tension: Annotated[str, Option(metavar="FORCE", help="Minimum muscle tension of a design.")] = "0 N",
    extrapolate: Extrapolate = False,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Show the attainable set, whether the reference is trackable and the nearest feasible ones; or size the joint."""
    name = "envelope" if design is None else "design"
    nearest = [f"nearest-{kind}" for kind in ("angle", "amplitude", "stiffness")] if design is None else [name]
    results_folder(out, ("results.json", f"{name}.png", f"{name}.svg", *(f"{one}.yaml" for one in nearest)), force)
    fraction = parse_quantity("--margin", margin, "1")
    width = parse_optional_quantity("--smoothing", smoothing, "s")
    reserve = parse_quantity("--torque-reserve", torque_reserve, "N*m")
    tension = parse_quantity("--minimum-tension", minimum_tension, "N")
    if design is None and (vary or reserve or tension):
        raise ParameterError(
            "--vary, --torque-reserve and --minimum-tension apply to a design",
            remedy="add --design 'stiffness 12..18 N*m/rad over -20..20 deg'",
        )
    if design is not None and not vary:
        raise ParameterError("a design varies nothing", remedy="add --vary 'connector_length=150..260 mm'")
    from mckibben import reachability
    from mckibben.scenario import Scenario

    read = Scenario.read(scenario)
    read = read.with_extrapolation() if extrapolate else read
    if design is None:
        _show_envelope(reachability.envelope(read, margin=fraction, smoothing=width), json, out)
        return
    target = reachability.parse_target(design, torque_reserve=reserve)
    variables = [reachability.parse_variable(text) for text in vary or []]
    _show_design(read, reachability.design(read.plant(), target, variables, minimum_tension=tension), json, out)


def _show_envelope(found: Envelope, json: bool, out: Path | None) -> None:
    from mckibben.reachability import save_reference

    numbers, static = found.records(), found.static
    names = ["results.json"]
    if out:
        from mckibben.report.joint import envelope as draw
        from mckibben.report.style import save

        with keeping(out):
            for near in found.nearest:
                names += save_reference(found.scenario, near, out, f"nearest-{near.preserved.name.lower()}")
            write_json(out / "results.json", numbers)
            save(draw(found), out, "envelope")
    if json:
        echo(to_json(numbers))
    else:
        if static.exists:
            angles = f"{static.angle_min / deg:.4g} to {static.angle_max / deg:.4g} deg"
            table(f"{found.scenario.name}: static range {angles}", found.headers, found.rows())
        echo(found.verdict())
        for remark in numbers["remarks"]:
            echo(on_command_line(remark))
        for near in found.nearest:
            echo(f"nearest, {near.preserved.name.lower()} preserved: {near.describe()}")
        if not found.trackability.trackable and not found.nearest:
            echo("no smaller or slower motion about this centre is feasible either")
    if out:
        notify(f"wrote {', '.join(names)}, envelope.png and envelope.svg to {out}", json)


def _show_design(scenario: Scenario, found: Design, json: bool, out: Path | None) -> None:
    from mckibben.reachability import save_design, static_envelope

    numbers = found.records()
    names = ["results.json"]
    if out:
        from mckibben.report.joint import design as draw
        from mckibben.report.style import save

        with keeping(out):
            names += ["design.yaml"] if save_design(scenario, found, out / "design.yaml") else []
            write_json(out / "results.json", numbers)
            about = sum(found.target.angles) / 2
            save(draw(found, static_envelope(scenario.plant(), about=about)), out, "design")
    if json:
        echo(to_json(numbers))
    else:
        rows = [
            (name.replace("_", " "), f"{found.initial[name] / mm:.4g} mm", f"{value / mm:.4g} mm")
            for name, value in found.lengths.items()
        ]
        table(f"{scenario.name}: {found.target.describe()}", ("length", "initial", "design"), rows)
        table("Attained", ("angle", "stiffness"), found.rows())
        echo(found.describe())
        for remark in found.plant.joint.remarks:
            echo(remark)
    if out:
        if "design.yaml" not in names:
            echo("no scenario written: a length belongs to a specimen or a geometry in the catalog", err=True)
        notify(f"wrote {', '.join(names)}, design.png and design.svg to {out}", json)
