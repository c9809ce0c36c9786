"""`mckibben calibrate`: identification of the controller's model, or of its valves, on the joint."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from mckibben.cli.command import DETAILS, present
from mckibben.cli.options import (
    Force,
    Json,
    echo,
    keeping,
    parse_limits,
    parse_optional_quantity,
    required_folder,
    results_folder,
)
from mckibben.cli.rig import run_line
from mckibben.errors import ParameterError, StoppedError, quoted

if TYPE_CHECKING:
    from mckibben.calibration import JointRecording, Sweeps, ValveExperiment
    from mckibben.realtime import JointRig
    from mckibben.scenario import Scenario

_LEAST, _MOST = 20.0, 600.0  # s of an experiment
_DURATION = 60.0  # s; twice that for valves


def calibrate(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with joint, controller and its model.")],
    weight: Annotated[str, Option(metavar="MASS", help="A known weight to clip on, such as '0.5 kg'.")] = "",
    distance: Annotated[str, Option(metavar="LENGTH", help="Its distance from the axis, such as '200 mm'.")] = "",
    valves: Annotated[
        bool, Option("--valves", help="Identify the valves instead, by steps and a multisine of their commands.")
    ] = False,
    angles: Annotated[str, Option(metavar="RANGE", help="Angles to sweep, or to stay within.")] = "-10..10 deg",
    duration: Annotated[
        str, Option(metavar="TIME", help="Duration of all parts, 20 to 600 s (default: 60 s, or 120 s with --valves).")
    ] = "",
    rig: Annotated[Path | None, Option(metavar="RIG.yaml", help="Rig, see examples/rig/ (default: simulated).")] = None,
    recording: Annotated[
        list[Path] | None,
        Option(metavar="FILE", help="Use a recording (CSV, or result.nc of `rig control`) instead; repeatable."),
    ] = None,
    weighted: Annotated[
        list[Path] | None, Option(metavar="FILE", help="A recording with the weight clipped on; repeatable.")
    ] = None,
    held_out: Annotated[
        list[Path] | None,
        Option(metavar="FILE", help="A recording of commands to simulate, not used for the estimate; repeatable."),
    ] = None,
    prior: Annotated[
        Path | None, Option(metavar="PRIOR.yaml", help="Standard deviations before, such as `mass: 5 %`.")
    ] = None,
    details: DETAILS = False,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder of records, model and figure.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Identify the controller's joint model on the joint, with a known weight, or its valves.

    Exit codes: 0 done, 1 stopped (the joint is vented), 2 refused before anything moved.
    """
    mass = _positive("--weight", weight, "kg")
    length = _positive("--distance", distance, "m")
    if (mass is None) != (length is None):
        raise ParameterError("--weight and --distance go together", remedy="give both, such as '0.5 kg' and '200 mm'")
    _check_files(weight, valves, recording or [], weighted or [], held_out or [])
    seconds = _duration(duration, 2 * _DURATION if valves else _DURATION)
    out = required_folder(out, "calibration")
    from mckibben import calibration
    from mckibben.scenario import Scenario

    results_folder(out, calibration.Calibration.file_names(), force)
    low, high = parse_limits("--angles", angles, "rad")
    deviations = calibration.JointPrior() if prior is None else calibration.JointPrior.read(prior)
    read = Scenario.read(scenario)
    bare, heavy, unused = (
        [calibration.read_joint_recording(path, **options) for path in paths or ()]
        for paths, options in (
            (recording, {}),
            (weighted, {"added_mass": mass or 0.0, "distance": length or 0.0}),
            (held_out, {}),
        )
    )
    experiment: Sweeps | ValveExperiment
    if valves:
        experiment = calibration.ValveExperiment(low, high, seconds, strength=deviations.strength)
    else:
        experiment = calibration.Sweeps(low, high, seconds, mass or 0.0, length or 0.0)
    recordings = [*bare, *heavy] or _measured(read, experiment, out, rig, quiet=json)
    fit: calibration.Calibration
    if valves:
        fit = calibration.calibrate_scenario_valves(read, recordings, deviations)
    else:
        fit = calibration.calibrate_scenario(read, recordings, deviations, held_out=unused)
    present(fit, details=details, json=json, out=out, force=True)


def _check_files(weight: str, valves: bool, recording: list[Path], weighted: list[Path], held_out: list[Path]) -> None:
    """Raise `ParameterError` for recordings that do not go together."""
    if weighted and not weight:
        raise ParameterError("--weighted without a weight", remedy="add --weight and --distance")
    if valves and (weight or held_out or weighted):
        raise ParameterError("--valves with a weight, or with --held-out", remedy="calibrate joint and valves in turn")
    if held_out and not (recording or weighted):
        raise ParameterError("--held-out without a recording", remedy="add --recording")


def _positive(option: str, text: str, unit: str) -> float | None:
    """Return a positive quantity; None without one."""
    value = parse_optional_quantity(option, text, unit)
    if value is not None and not value > 0:
        raise ParameterError(f"{option} is {quoted(text)}", value=value, remedy="give a value above 0")
    return value


def _duration(text: str, default: float) -> float:
    seconds = parse_optional_quantity("--duration", text, "s") or default
    if not _LEAST <= seconds <= _MOST:
        remedy = f"give {_LEAST:g} to {_MOST:g} s"
        raise ParameterError(f"--duration is {quoted(text)}", value=seconds, unit="s", remedy=remedy)
    return seconds


def _measured(
    scenario: Scenario, experiment: Sweeps | ValveExperiment, out: Path, rig: Path | None, *, quiet: bool
) -> list[JointRecording]:
    """Recordings of the parts of an experiment, run on a rig."""
    from mckibben.calibration import run_parts
    from mckibben.realtime import JointRig

    device = None if rig is None else JointRig.read(rig)
    parts = experiment.scenarios(scenario)
    with _running(out, experiment.instructions, device, quiet) as options:
        return experiment.recordings(run_parts(parts, out, **options))


@contextmanager
def _running(out: Path, parts: dict[str, str], rig: JointRig | None, quiet: bool) -> Iterator[dict[str, Any]]:
    """Options of a run of the parts of an experiment, each with what to confirm before it."""
    from mckibben.rig.record import segments

    if recorded := [name for name in parts if (out / name).is_dir() and segments(out / name)]:
        results = [out / name / "result.nc" for name in recorded if (out / name / "result.nc").is_file()]
        use = " ".join(f"--recording {path}" for path in results)
        remedy = f"use them with {use}, or choose" if results else "they are incomplete; choose"
        raise ParameterError(f"{out} already contains records", remedy=f"{remedy} another folder")

    def ready(name: str) -> None:
        if rig is not None and rig.physical:
            typer.confirm(f"{parts[name]}, and nobody is within reach of the joint?", abort=True, err=True)

    try:
        with keeping(out), run_line(quiet=quiet) as line:
            yield {"rig": rig, "ready": ready, "progress": line}
    except StoppedError as stopped:
        echo(str(stopped), err=True)
        raise typer.Exit(1) from None
