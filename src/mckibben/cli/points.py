"""`mckibben points` and `plan`: points from raw recordings, and the points to measure next."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.cli.command import command
from mckibben.cli.options import echo, on_command_line, parse_limits, parse_pair, parse_quantity, text_width
from mckibben.cli.reading import Data, Reading
from mckibben.errors import ParameterError, UnitError
from mckibben.units import percent, quantity

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints
    from mckibben.experiment_design import ExperimentPlan


@command
def points(
    recording: list[Path],
    dwell: str = "1 s",
    settle: str = "0 s",
    tolerance: str = "0.1 %, 2 kPa",
    plot: bool = False,
    *,
    json: bool,
    reading: Reading,
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
    plot
        Draw the points in the terminal, force over contraction.
    """
    from mckibben.dataset.faults import LOST

    contraction, pressure = parse_pair("--tolerance", tolerance, "0.1 %, 2 kPa")
    limits = {
        "contraction_tolerance": parse_quantity("--tolerance", contraction, "1"),
        "pressure_tolerance": parse_quantity("--tolerance", pressure, "Pa"),
        "dwell": parse_quantity("--dwell", dwell, "s"),
        "settle": parse_quantity("--settle", settle, "s"),
    }
    samples = reading.recording(recording)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", LOST)  # printed with the points
        plateaus = samples.plateaus(**limits, accept=reading.recipe.accept)
    repairs = samples.table.attrs.get("repairs", "").splitlines()
    notes = [*plateaus.notes, *(f"left out: {repair}" for repair in repairs)]
    if plot and not json:
        echo(_drawn(plateaus, min(text_width(), 76)))
    return replace(plateaus, notes=tuple(map(on_command_line, notes)), recipe=reading.recipe)


def _drawn(points: ExtractedPoints, width: int, rows: int = 14) -> str:
    """Force over contraction in dots of Braille, two by four of them in a character."""
    import numpy as np

    if "utf" not in sys.stdout.encoding.lower():
        remedy = "set the locale to UTF-8, or give --out DIR, which has the figure"
        raise ParameterError(f"--plot draws characters that {sys.stdout.encoding} has not", remedy=remedy)
    low, high = float(points.force.min()), float(points.force.max())
    first, last = (f"{end / percent:.3g} %" for end in (points.contraction.min(), points.contraction.max()))
    labels = dict.fromkeys(range(rows), "") | {0: f"{high:.4g} N", rows - 1: f"{low:.4g} N"}
    margin = max(map(len, labels.values())) + 1
    size, cells = np.array([4 * rows, 2 * (width - margin)]), np.zeros((rows, width - margin), int)
    place = np.array([high - points.force, points.contraction - points.contraction.min()])
    y, x = np.rint(place / np.maximum(np.ptp(place, axis=1), 1e-12)[:, None] * (size - 1)[:, None]).astype(int)
    dots = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
    np.bitwise_or.at(cells, (y // 4, x // 2), dots[y % 4, x % 2])
    lines = [f"{labels[row]:>{margin - 1}} {''.join(chr(0x2800 + dot) for dot in cells[row])}" for row in range(rows)]
    below = "contraction".center(width - margin - len(first) - len(last))
    return "\n".join([*lines, f"{'':{margin}}{first}{below}{last}"])


@command
def plan(
    data: Data,
    law: str = "exponential",
    for_: str = "force",
    points: int = 8,
    joint: str = "knee-table-2",
    limits: str = "",
    step: str = "",
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
    """
    from mckibben import catalog
    from mckibben.experiment_design import parse_quantity_of_interest
    from mckibben.experiment_design import plan as run
    from mckibben.muscle import Domain
    from mckibben.scenario.inputs import joint_named, law_type_named

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
