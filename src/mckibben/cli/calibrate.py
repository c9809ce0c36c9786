"""`mckibben calibrate`: identification of the controller's model, or of its valves, on the joint."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from mckibben.cli.command import command
from mckibben.cli.options import (
    ScenarioFile,
    check_unused,
    echo,
    keeping,
    parse_limits,
    parse_pair,
    parse_quantity,
    required_folder,
    results_folder,
)
from mckibben.cli.reading import Reading
from mckibben.cli.rig import run_line
from mckibben.errors import ParameterError, StoppedError

if TYPE_CHECKING:
    from mckibben.calibration import Calibration, JointRecording, Sweeps, ValveExperiment
    from mckibben.scenario import Scenario

Files = list[Path] | None


@command
def calibrate(
    scenario: ScenarioFile,
    weight: str = "",
    valves: bool = False,
    angles: str = "-10..10 deg",
    duration: str = "",
    rig: Path | None = None,
    recording: Files = None,
    weighted: Files = None,
    held_out: Files = None,
    prior: Path | None = None,
    *,
    out: Path | None,
    force: bool,
    json: bool,
    reading: Reading,
) -> Calibration:
    """Identify the controller's joint model with a known weight, or its valves.

    Exit codes: 0 done, 1 stopped (the joint is vented), 2 refused before anything moved.

    Parameters
    ----------
    weight : MASS, LENGTH
        A known weight to clip on, at a distance from the axis: '0.5 kg, 200 mm'.
    valves
        Identify the valves instead, by steps and a multisine of their commands.
    angles : RANGE
        Angles to sweep, or to stay within.
    duration : TIME
        Duration of all parts, 20 to 600 s (default: 60 s, or 120 s with --valves).
    rig : RIG.yaml
        Rig, see examples/rig/ (default: simulated).
    recording : FILE
        Use a recording instead (a data file, or result.nc of `rig control`); repeatable.
    weighted : FILE
        A recording with the weight clipped on; repeatable.
    held_out : FILE
        A recording that is not fitted; if the model before predicts it better, the files keep it; repeatable.
    prior : PRIOR.yaml
        Standard deviations before, such as `mass: 5 %`.
    """
    if valves:
        check_unused("--valves", weight=weight, held_out=held_out, weighted=weighted)
    if weighted and not weight:
        raise ParameterError("--weighted without a weight", remedy="add --weight '0.5 kg, 200 mm'")
    if held_out and not (recording or weighted):
        raise ParameterError("--held-out without a recording", remedy="add --recording")
    mass, length = _weight(weight)
    seconds = parse_quantity("--duration", duration or ("120 s" if valves else "60 s"), "s")
    out = required_folder(out, "calibration")
    from mckibben import calibration
    from mckibben.component.checks import check_within
    from mckibben.scenario import Scenario

    check_within("calibrate", 20.0, 600.0, "s", remedy="give another --duration", duration=seconds)
    results_folder(out, calibration.Calibration.file_names(), force)
    low, high = parse_limits("--angles", angles, "rad")
    deviations = calibration.JointPrior() if prior is None else calibration.JointPrior.read(prior)
    read, measure = Scenario.read(scenario), calibration.read_joint_recording
    recordings = [
        *(measure(path, reading.recipe) for path in recording or ()),
        *(measure(path, reading.recipe, added_mass=mass, distance=length) for path in weighted or ()),
    ]
    unused = [measure(path, reading.recipe) for path in held_out or ()]
    if valves:
        experiment = calibration.ValveExperiment(low, high, seconds)
        recordings = recordings or _measured(read, experiment, out, rig, quiet=json)
        return calibration.calibrate_scenario_valves(read, recordings, deviations)
    recordings = recordings or _measured(
        read, calibration.Sweeps(low, high, seconds, mass, length), out, rig, quiet=json
    )
    return calibration.calibrate_scenario(read, recordings, deviations, held_out=unused)


def _weight(text: str) -> tuple[float, float]:
    """Mass [kg] of a weight, and its distance from the axis [m]; zeros without one."""
    if not text:
        return 0.0, 0.0
    mass, length = parse_pair("--weight", text, "0.5 kg, 200 mm")
    return parse_quantity("--weight", mass, "kg", positive=True), parse_quantity("--weight", length, "m", positive=True)


def _measured(
    scenario: Scenario, experiment: Sweeps | ValveExperiment, out: Path, rig: Path | None, *, quiet: bool
) -> list[JointRecording]:
    """Recordings of the parts of an experiment, run on a rig, each after its preparation is confirmed."""
    from mckibben.calibration import run_parts
    from mckibben.rig import JointRig

    device, instructions = None if rig is None else JointRig.read(rig), experiment.instructions
    if recorded := [name for name in instructions if (out / name).is_dir() and any((out / name).iterdir())]:
        results = [out / name / "result.nc" for name in recorded if (out / name / "result.nc").is_file()]
        use = " ".join(f"--recording {path}" for path in results)
        remedy = f"use them with {use}, or choose" if results else "they are incomplete; choose"
        raise ParameterError(f"{out} already contains records", remedy=f"{remedy} another folder")

    def ready(name: str) -> None:
        if device is not None and device.physical:
            typer.confirm(f"{instructions[name]}, and nobody is within reach of the joint?", abort=True, err=True)

    scenarios = experiment.scenarios(scenario)
    try:
        with keeping(out), run_line(quiet=quiet) as line:
            runs = run_parts(scenarios, out, rig=device, firmware=scenario, ready=ready, progress=line)
            echo(f"wrote {', '.join(f'{name}/result.nc' for name in scenarios)} to {out}", err=True)
            return experiment.recordings(runs)
    except StoppedError as stopped:
        echo(str(stopped), err=True)
        raise typer.Exit(1) from None
