"""`mckibben points` and `plan`: points from raw recordings, and the points to measure next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.cli.command import command
from mckibben.cli.options import on_command_line, parse_limits, parse_optional, parse_pair, parse_quantity
from mckibben.cli.reading import Data, Reading
from mckibben.errors import ParameterError, UnitError
from mckibben.units import quantity

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints
    from mckibben.experiment_design import ExperimentPlan


@command
def points(
    recording: list[Path], dwell: str = "1 s", settle: str = "0 s", tolerance: str = "0.1 %, 2 kPa", *, reading: Reading
) -> ExtractedPoints:
    """Extract points from a raw recording: means over the plateaus, where pressure and length are steady.

    With --out, points.csv and points.nc are files for `mckibben identify`, and recipe.yaml reads the next recording.

    Parameters
    ----------
    recording : RECORDING...
        CSV, .xlsx, .mat, .tdms, .lvm or .nc, over time.
    dwell : TIME
        Shortest duration of a plateau.
    settle : TIME
        Excluded start of a plateau.
    tolerance : RATIO, PRESSURE
        Tolerances of contraction and pressure within a plateau.
    """
    contraction, pressure = parse_pair("--tolerance", tolerance, "0.1 %, 2 kPa")
    limits = {
        "contraction_tolerance": parse_quantity("--tolerance", contraction, "1"),
        "pressure_tolerance": parse_quantity("--tolerance", pressure, "Pa"),
        "dwell": parse_quantity("--dwell", dwell, "s"),
        "settle": parse_quantity("--settle", settle, "s"),
    }
    samples = reading.recording(recording)
    plateaus = samples.plateaus(**limits)
    repairs = samples.table.attrs.get("repairs", "").splitlines()
    notes = [*plateaus.notes, *(f"left out: {repair}" for repair in repairs)]
    return replace(plateaus, notes=tuple(map(on_command_line, notes)), recipe=reading.recipe)


@command
def plan(
    data: Data,
    law: str = "exponential",
    for_: str = "force",
    points: int = 8,
    joint: str = "knee-table-2",
    limits: str = "",
    step: str = "",
    noise: str = "",
    *,
    reading: Reading,
) -> ExperimentPlan:
    """Plan the next test: the points that most reduce the uncertainty of a quantity, and diagnostics of the data.

    Parameters
    ----------
    law
        Kind of law, see 'mckibben catalog'.
    for_ : QUANTITY
        Quantity of interest: a coefficient such as 'decay'; 'force', or 'force at 0..10 %, 3..6 bar';
        'stiffness', or 'stiffness at 5 deg, 2 bar, 4 bar'.
    points : N
        Number of points.
    joint : JOINT
        Joint for stiffness: from the catalog, or a scenario file.
    limits : RANGES
        Contraction and pressure, '0..20 %, 1..6 bar' (default: the specimen's).
    step : STEPS
        Resolution of the rig, '0.5 %, 0.25 bar'; or a length, '1 mm' (default).
    noise : FORCE
        Error of a point (default: from the residuals).
    """
    from mckibben import catalog
    from mckibben.experiment_design import parse_quantity_of_interest
    from mckibben.experiment_design import plan as run
    from mckibben.muscle import Domain
    from mckibben.study.inputs import joint_named, law_type_named

    law_type = law_type_named(law)
    interest = parse_quantity_of_interest(for_, law_type, lambda: joint_named(joint))
    contraction, pressure = parse_pair("--limits", limits, "0..20 %, 1..6 bar")
    box = None
    if limits:
        box = Domain(*parse_limits("--limits", contraction, "1"), *parse_limits("--limits", pressure, "Pa"))
    read = reading.data(data)
    name = read.table.attrs["specimen"]
    muscle = catalog.specimen(name) if name in catalog.names("specimens") else None
    length = read.table.attrs.get("initial_length") or (float(muscle.initial_length) if muscle else None)
    steps = parse_pair("--step", step, "0.5 %, 0.25 bar")
    return run(
        read,
        interest,
        law_type,
        points=points,
        limits=box,
        contraction_step=_contraction_step(steps[0], length),
        pressure_step=parse_quantity("--step", steps[1] or "0.25 bar", "Pa"),
        noise=parse_optional("--noise", noise, "N"),
    )


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
