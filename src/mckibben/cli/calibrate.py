"""`mckibben calibrate`: identification of the controller's model, or of its valves, on the joint."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from mckibben.errors import ParameterError, StoppedError, quoted
from mckibben.units import SLIDE, JointType

if TYPE_CHECKING:
    from mckibben.calibration import Calibration, JointPrior, JointRecording, Sweeps, ValveExperiment
    from mckibben.scenario import Scenario

Files = list[Path] | None
_LIMBS = {"weighed": {"mass": 0.02, "inertia": 0.05}, "estimated": {"mass": 0.3, "inertia": 0.2}}
_LIMB = "--limb weighed (mass to 2 %, inertia to 5 %), --limb estimated (30 %, 20 %), or --prior PRIOR.yaml"


@command
def calibrate(
    scenario: ScenarioFile,
    weight: str = "",
    limb: str = "",
    valves: bool = False,
    angles: str = "",
    duration: str = "",
    rig: Path | None = None,
    recording: Files = None,
    weighted: Files = None,
    held_out: Files = None,
    prior: Path | None = None,
    tube: str = "",
    *,
    out: Path | None,
    force: bool,
    json: bool,
    reading: Reading,
) -> Calibration:
    """Identify the controller's model of a joint or a robot, or its valves.

    Exit codes: 0 done, 1 stopped (the joint is vented), 2 refused before anything moved.

    Parameters
    ----------
    weight : MASS, LENGTH
        A known weight to clip on, its centre at a distance from the axis: '0.5 kg, 200 mm'; with the radius of a disc,
        '2 kg, 200 mm, 50 mm'; on a slide '0.5 kg'.
    limb : KNOWN
        'weighed' if the mass of the load is known to 2 % and its inertia to 5 %, else 'estimated'.
    valves
        Identify the valves instead, by steps and a multisine of their commands.
    angles : RANGE
        Angles to sweep, or to stay within (default: -10..10 deg, of a slide -10..10 mm).
    duration : TIME
        Duration of all parts, 20 to 600 s (default: 60 s, or 120 s with --valves).
    rig : RIG.yaml
        Rig, see examples/rig/ (default: simulated).
    recording : FILE
        Use a recording instead (a data file, or result.nc of `rig control`); repeatable.
    weighted : FILE
        A recording with the weight clipped on; repeatable.

    Other Parameters
    ----------------
    held_out : FILE
        A recording that is not fitted; if the model before predicts it better, the files keep it; repeatable.
    prior : PRIOR.yaml
        Standard deviations before, such as `mass: 5 %`, in place of --limb.
    tube : TIME
        Lag of the pressure in the muscles behind the sensors, '5 ms'; '0 ms' for sensors at the muscles.
    """
    if valves:
        check_unused("--valves", weight=weight, held_out=held_out, weighted=weighted, limb=limb, tube=tube)
    _check_files(weight, recording, weighted, held_out)
    seconds = parse_quantity("--duration", duration or ("120 s" if valves else "60 s"), "s")
    out = required_folder(out, "calibration")
    from mckibben import calibration
    from mckibben.component.checks import check_within
    from mckibben.rig.channels import Channels
    from mckibben.scenario import Scenario

    check_within("calibrate", 20.0, 600.0, "s", remedy="give another --duration", duration=seconds)
    results_folder(out, calibration.Calibration.file_names(), force)
    read = Scenario.read(scenario)
    kind, load = read.joint_type, _weight(weight, read.joint_type)
    deviations = _prior(limb, prior, kind, valves=valves)
    low, high = _angles(angles, kind)
    if read.joint_names:
        _check_robot(scenario, recording, valves=valves)
    channels = Channels.of(read)
    measure = partial(calibration.read_joint_recording, recipe=reading.recipe, channels=channels)
    lag: Any = {} if valves else {"tube": _tube(read, tube, simulated=not (rig or recording or weighted))}
    recordings = [
        *(measure(path, **lag) for path in recording or ()),
        *(measure(path, **lag, **load) for path in weighted or ()),
    ]
    if valves:
        steps = calibration.ValveExperiment(low, high, seconds)
        _check_empty(out, () if recordings else steps.instructions)
        recordings = recordings or _measured(read, steps, out, rig, quiet=json)
        return calibration.calibrate_scenario_valves(read, recordings, deviations)
    if not recordings:
        sweeps = calibration.Sweeps(low, high, seconds, **load, **lag)
        _check_empty(out, sweeps.instructions)
        _foretell(sweeps, read, deviations)
        recordings = _measured(read, sweeps, out, rig, quiet=json)
    unused = [measure(path, **lag) for path in held_out or ()]
    return calibration.calibrate_scenario(read, recordings, deviations, held_out=unused)


def _check_robot(scenario: Path, recording: Files, *, valves: bool) -> None:
    """Refuse a robot without recordings, and its valves."""
    if valves or not recording:
        why = "whose joints move each other: the part that drives a pair without feedback is for a single joint"
        message = f"{scenario} is a robot, {why}"
        remedy = "give recordings of all joints at once, --recording RUN.csv or result.nc, and --held-out others"
        raise ParameterError(message, field="scenario", value=str(scenario), remedy=remedy)


def _check_files(weight: str, recording: Files, weighted: Files, held_out: Files) -> None:
    """Refuse recordings without what they need."""
    if weighted and not weight:
        raise ParameterError("--weighted without a weight", remedy="add --weight '0.5 kg, 200 mm'")
    if held_out and not (recording or weighted):
        raise ParameterError("--held-out without a recording", remedy="add --recording")


def _prior(limb: str, file: Path | None, joint_type: JointType, *, valves: bool) -> JointPrior:
    """Deviations by a file, or by what is known of the limb, which is asked for."""
    from mckibben.calibration import JointPrior

    if file is not None:
        check_unused("--prior", limb=limb)
        return JointPrior.read(file, joint_type)
    if valves:
        return JointPrior()
    if limb not in _LIMBS:
        message = f"--limb {quoted(limb)} is none of {', '.join(_LIMBS)}" if limb else "was the limb weighed?"
        raise ParameterError(message, field="--limb", value=limb, remedy=_LIMB)
    return JointPrior(**_LIMBS[limb])


def _angles(text: str, joint_type: JointType) -> tuple[float, float]:
    """Range of the angles [rad], of a slide of its positions [m]."""
    return parse_limits("--angles", text or f"-10..10 {joint_type.shown('deg')}", joint_type.unit("rad"))


def _weight(text: str, joint_type: JointType) -> dict[str, Any]:
    """Mass [kg] of a weight, distance of its centre from the axis [m], and its own inertia, as of a recording."""
    if not text:
        return {}
    if joint_type is SLIDE:
        return {"added_mass": parse_quantity("--weight", text, "kg", positive=True)}
    mass, length, *radius = (
        [number.strip() for number in text.split(",")]
        if text.count(",") == 2
        else parse_pair("--weight", text, "0.5 kg, 200 mm")
    )
    kilograms = parse_quantity("--weight", mass, "kg", positive=True)
    disc = parse_quantity("--weight", radius[0], "m") ** 2 / 2 * kilograms if radius else 0.0  # about its axis
    metres = parse_quantity("--weight", length, "m", positive=True)
    return {"added_mass": kilograms, "distance": metres, "weight_inertia": disc}


def _tube(scenario: Scenario, text: str, *, simulated: bool) -> float:
    """Lag [s] of the pressure in the muscles behind that of the sensors; asked for where the valves have tubes."""
    if not text and not simulated and "outlet1" in scenario.valve.telemetry_labels:
        message = "the valves have tubes: are the pressure sensors at the valves, or at the muscles?"
        raise ParameterError(
            message, field="--tube", remedy="--tube 0 ms for those at the muscles, or the lag, --tube 5 ms"
        )
    return parse_quantity("--tube", text or "0 s", "s")


def _check_empty(out: Path, names: Iterable[str]) -> None:
    """Refuse a folder that contains records of an experiment, with the command that uses them."""
    if recorded := [name for name in names if (out / name).is_dir() and any((out / name).iterdir())]:
        results = [out / name / "result.nc" for name in recorded if (out / name / "result.nc").is_file()]
        use = " ".join(f"--recording {path}" for path in results)
        remedy = f"use them with {use}, or choose" if results else "they are incomplete; choose"
        raise ParameterError(f"{out} already contains records", remedy=f"{remedy} another folder")


def _foretell(sweeps: Sweeps, scenario: Scenario, deviations: JointPrior) -> None:
    """Say what each weight will give, before anything moves."""
    for row in sweeps.prediction(scenario, deviations).rows():
        echo("with {} kg the stiffness is expected to a standard deviation of {} %".format(*row), err=True)


def _measured(
    scenario: Scenario, experiment: Sweeps | ValveExperiment, out: Path, rig: Path | None, *, quiet: bool
) -> list[JointRecording]:
    """Recordings of the parts of an experiment, run on a rig, each after its preparation is confirmed."""
    from mckibben.calibration import run_parts
    from mckibben.rig import JointRig

    device = None if rig is None else JointRig.read(rig, joint_type=scenario.joint_type)
    instructions = experiment.instructions
    confirmed: list[str] = []

    def ready(name: str) -> None:
        if device is not None and device.physical and instructions[name] not in confirmed:
            confirmed.append(instructions[name])
            typer.confirm(f"{instructions[name]}, and nobody is within reach of the joint?", abort=True, err=True)

    try:
        with keeping(out), run_line(quiet=quiet) as line:
            runs = run_parts(
                partial(experiment.parts, scenario), out, rig=device, firmware=scenario, ready=ready, progress=line
            )
            echo(f"wrote {', '.join(f'{name}/result.nc' for name in runs)} to {out}", err=True)
            return experiment.recordings(runs)
    except StoppedError as stopped:
        echo(str(stopped), err=True)
        raise typer.Exit(1) from None
