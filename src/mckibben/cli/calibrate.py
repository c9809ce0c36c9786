"""`mckibben calibrate`: identification of the controller's model on the joint."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

from mckibben.cli.options import (
    Force,
    Json,
    echo,
    job_progress,
    keeping,
    notify,
    parse_limits,
    parse_optional_quantity,
    parse_quantity,
    required_folder,
    results_folder,
    table,
)
from mckibben.cli.rig import run_line
from mckibben.errors import ParameterError, StoppedError, quoted
from mckibben.storage.files import to_json, write_json
from mckibben.units import kPa, show

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mckibben.calibration import JointEstimate, JointPrior, JointRecording, Sweeps, ValveExperiment
    from mckibben.realtime import JointRig
    from mckibben.scenario import Scenario

_KEPT = ("model.yaml", "scenario.yaml", "results.json", "calibration.png", "calibration.svg")
_PLANNED_WEIGHTS, _PLANNED_DURATIONS = (0.0, 0.5, 1.0, 2.0), (1 / 3, 1.0)
_VALVE_FILES = ("valve.yaml", *_KEPT[1:])
_VALVE_HEAD = """\
# Valves calibrated by `mckibben calibrate --valves`: `valve: valve.yaml`.
"""
_LEAST, _MOST = 20.0, 600.0  # s of an experiment
_WEIGHT, _STRENGTH, _MASS, _ZERO, _ARMS, _SUPPLY = "1 %", "10 %", "30 %", "0.5 deg", "2 %", "5 %"  # deviations


def calibrate(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario with joint, controller and its model.")],
    weight: Annotated[str, Option(metavar="MASS", help="A known weight to clip on, such as '0.5 kg'.")] = "",
    distance: Annotated[str, Option(metavar="LENGTH", help="Its distance from the axis, such as '200 mm'.")] = "",
    weight_error: Annotated[str, Option(metavar="PERCENT", help="Standard deviation of the weight.")] = _WEIGHT,
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
    strength_error: Annotated[
        str, Option(metavar="PERCENT", help="Standard deviation of the strength of the model's muscles.")
    ] = _STRENGTH,
    mass_error: Annotated[
        str, Option(metavar="PERCENT", help="Standard deviation of the mass of the model's load (not with --valves).")
    ] = _MASS,
    zero_error: Annotated[str, Option(metavar="ANGLE", help="Standard deviation of the encoder's zero.")] = _ZERO,
    arm_error: Annotated[
        str, Option(metavar="PERCENT", help="Standard deviation of the scale of the moment arms.")
    ] = _ARMS,
    supply_error: Annotated[
        str, Option(metavar="PERCENT", help="Standard deviation of the pressure of the supply, for --valves.")
    ] = _SUPPLY,
    plan: Annotated[
        bool,
        Option("--plan", help="Show the expected accuracy for other weights and durations, without moving the joint."),
    ] = False,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder of records, model and figure.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Identify the controller's joint model on the joint, with a known weight, or its valves.

    Exit codes: 0 done, 1 stopped (the joint is vented), 2 refused before anything moved.
    """
    mass = parse_optional_quantity("--weight", weight, "kg") or 0.0
    at = parse_optional_quantity("--distance", distance, "m") or 0.0
    if bool(weight) != bool(distance):
        raise ParameterError("--weight and --distance go together", remedy="give both, such as '0.5 kg' and '200 mm'")
    for name, given, text in (("--weight", mass, weight), ("--distance", at, distance)):
        if text and not given > 0:
            raise ParameterError(f"{name} is {quoted(text)}", value=given, remedy="give a value above 0")
    low, high = parse_limits("--angles", angles, "rad")
    duration = duration or ("120 s" if valves else "60 s")
    seconds = parse_quantity("--duration", duration, "s")
    if not _LEAST <= seconds <= _MOST:
        remedy = f"give {_LEAST:g} to {_MOST:g} s"
        raise ParameterError(f"--duration is {quoted(duration)}", value=seconds, unit="s", remedy=remedy)
    if weighted and not mass:
        raise ParameterError("--weighted without a weight", remedy="add --weight and --distance")
    if valves and (weight or held_out):
        raise ParameterError("--valves with a weight, or with --held-out", remedy="calibrate joint and valves in turn")
    if held_out and not (recording or weighted):
        raise ParameterError("--held-out without a recording", remedy="add --recording")
    from mckibben.calibration import JointPrior, Sweeps, ValveExperiment
    from mckibben.scenario import Scenario

    strength = _deviation("--strength-error", strength_error, _STRENGTH)
    prior = JointPrior(
        strength,
        strength / 2,
        mass=_deviation("--mass-error", mass_error, _MASS, unused=valves and "with --valves"),
        added_mass=_deviation("--weight-error", weight_error, _WEIGHT, unused=not weight and "without --weight"),
        zero=_deviation("--zero-error", zero_error, _ZERO, "rad"),
        arm_scale=_deviation("--arm-error", arm_error, _ARMS),
        supply=_deviation("--supply-error", supply_error, _SUPPLY, unused=not valves and "without --valves"),
    )
    read, count = Scenario.read(scenario), 2 if mass else 1
    if valves:
        experiment = ValveExperiment(low, high, seconds, strength=strength)
        folder = None if plan else required_folder(out, "calibration")
        _valves(read, experiment, recording or [], prior, rig, folder, force, json)
        return
    period = read.control_period
    sweeps = Sweeps(low, high, round(seconds / count / period) * period, mass, at)
    if plan:
        _plan(read, sweeps, prior, json)
        return
    out = required_folder(out, "calibration")
    results_folder(out, _KEPT, force)
    if recording or weighted:
        recordings = _read(recording or [], weighted or [], mass, at)
    else:
        recordings = _measured(read, sweeps, out, rig, json)
    kept = _read(held_out or [], [], 0.0, 0.0)
    names = [*map(str, recording or []), *map(str, weighted or []), *map(str, held_out or [])]
    _report(read, recordings, kept, names, prior, out, json)


def _deviation(option: str, text: str, default: str, unit: str = "1", unused: str | Literal[False] = False) -> float:
    """Return a standard deviation, above 0 and at most 100 % or 1 rad; `unused` says where the option has no effect."""
    value = parse_quantity(option, text, unit)
    if unused and text != default:
        raise ParameterError(f"{option} has no effect {unused}", value=value, remedy=f"leave {option} out")
    if not 0 < value <= 1:
        most = "100 %" if unit == "1" else f"1 {unit}"
        remedy = f"give a standard deviation above 0, at most {most}, such as {quoted(default)}"
        raise ParameterError(f"{option} is {quoted(text)}", value=value, lower=0, upper=1, unit=unit, remedy=remedy)
    return value


def _read(bare: list[Path], weighted: list[Path], mass: float, distance: float) -> list[JointRecording]:
    from mckibben.calibration import read_joint_recording

    found = [read_joint_recording(path) for path in bare]
    return [*found, *(read_joint_recording(path, added_mass=mass, distance=distance) for path in weighted)]


def _measured(scenario: Scenario, sweeps: Sweeps, out: Path, rig: Path | None, quiet: bool) -> list[JointRecording]:
    from mckibben.calibration import run_sweeps
    from mckibben.realtime import JointRig

    on: JointRig | None = None if rig is None else JointRig.read(rig)
    what = {"bare": "no weight is on the limb", "weighted": f"the weight of {sweeps.added_mass:g} kg is clipped on"}
    with _running(out, what, on, quiet) as options:
        return run_sweeps(scenario, sweeps, out, **options)


@contextmanager
def _running(out: Path, parts: Mapping[str, str], rig: JointRig | None, quiet: bool) -> Iterator[dict[str, Any]]:
    """Options of a run of the parts of an experiment, each with what to confirm before it."""
    from mckibben.rig.record import segments

    if kept := [name for name in parts if (out / name).is_dir() and segments(out / name)]:
        results = [out / name / "result.nc" for name in kept if (out / name / "result.nc").is_file()]
        use = " ".join(f"--recording {path}" for path in results)
        remedy = f"use them with {use}, or choose" if results else "they are incomplete; choose"
        raise ParameterError(f"{out} already contains records", remedy=f"{remedy} another folder")

    def ready(name: str) -> None:
        if rig is not None and rig.physical:
            typer.confirm(f"{parts[name]}, and nobody is within reach of the joint?", abort=True, err=True)

    try:
        with run_line(quiet=quiet) as line:
            yield {"rig": rig, "ready": ready, "progress": line}
    except StoppedError as stopped:
        echo(str(stopped), err=True)
        raise typer.Exit(1) from None


def _valves(
    scenario: Scenario,
    experiment: ValveExperiment,
    recording: list[Path],
    prior: JointPrior,
    rig: Path | None,
    out: Path | None,
    force: bool,
    json: bool,
) -> None:
    from mckibben.actuator import Actuator
    from mckibben.calibration import (
        calibrate_scenario_valves,
        read_joint_recording,
        run_parts,
        scenario_with_valves,
        valve_for,
        valve_statements,
    )
    from mckibben.calibration.experiment import recording_of
    from mckibben.component.schema import write_text
    from mckibben.realtime import JointRig
    from mckibben.report.joint import valve_calibration as draw
    from mckibben.storage.files import atomic_write, sealed

    on = None if rig is None else JointRig.read(rig)
    if out is not None:
        results_folder(out, _VALVE_FILES, force)
    parts = {} if recording and out is not None else experiment.scenarios(scenario)
    if parts and not json:
        _show_commands(_commands(parts))
    if out is None:
        if json:
            echo(to_json(_commands(parts)))
        return
    if recording:
        recordings = [read_joint_recording(path) for path in recording]
    else:
        what = dict.fromkeys(parts, "the joint moves freely with no weight on the limb")
        with _running(out, what, on, json) as options:
            recordings = [recording_of(one) for one in run_parts(parts, out, **options).values()]
    found = calibrate_scenario_valves(scenario, recordings, prior)
    numbers = {"residual_Pa": found.residual, "noise_Pa": found.noise, "quantities": _quantities_json(found.quantities)}
    with keeping(out):
        text = _VALVE_HEAD + write_text(valve_for(scenario, found), folder=out, base=Actuator)
        with atomic_write(out / "valve.yaml", overwrite=True) as part:
            part.write_bytes(sealed(text.encode()))
        _keep(out, scenario_with_valves(scenario, found), numbers, draw(found, recordings))
    if json:
        echo(to_json(numbers))
    else:
        _show_quantities(found.quantities)
        echo(f"residual {found.residual / kPa:.2g} kPa, noise {found.noise / kPa:.2g} kPa")
        for line in valve_statements(found, valve_for(scenario, found)):
            echo(line)
    echo(f"wrote valve.yaml (for `valve: valve.yaml`), scenario.yaml and figure to {out}", err=json)


def _commands(parts: Mapping[str, Scenario]) -> list[dict[str, Any]]:
    """Name, duration [s] and commanded pressures [Pa] of each part."""
    import numpy as np

    rows = []
    for name, part in parts.items():
        control: Any = part.control()
        time = np.arange(0.0, part.duration, part.control_period)
        pairs = [np.asarray(signal(time)) for signal in (control.pressure1, control.pressure2)]
        ranges = {f"command{i}_Pa": [float(one.min()), float(one.max())] for i, one in enumerate(pairs, 1)}
        rows.append({"part": name, "duration_s": part.duration, **ranges})
    return rows


def _show_commands(rows: list[dict[str, Any]]) -> None:
    def text(limits: list[float]) -> str:
        return " to ".join(show(one, "bar", 3) for one in limits)

    table(
        "commands of the experiment",
        ("part", "duration", "muscle 1", "muscle 2"),
        [(r["part"], f"{r['duration_s']:g} s", text(r["command1_Pa"]), text(r["command2_Pa"])) for r in rows],
    )


def _keep(out: Path, scenario: Scenario, numbers: dict[str, Any], figure: Figure) -> None:
    from mckibben.report.style import save

    scenario.to_yaml(out / "scenario.yaml")
    write_json(out / "results.json", numbers)
    save(figure, out, "calibration")


def _quantities_json(found: Mapping[str, JointEstimate]) -> dict[str, Any]:
    return {
        name: {
            "value": one.value,
            "standard_deviation": one.deviation,
            "interval": list(one.interval),
            "before": one.prior,
            "unit": one.unit,
            "determined": one.determined,
        }
        for name, one in found.items()
    }


def _show_quantities(found: Mapping[str, JointEstimate]) -> None:
    from mckibben.calibration.experiment import SHOWN

    rows = [
        (
            name,
            show(one.value, SHOWN[one.unit], 4),
            show(one.deviation, SHOWN[one.unit], 2),
            show(one.prior, SHOWN[one.unit], 2),
            "yes" if one.determined else "no",
        )
        for name, one in found.items()
    ]
    table("calibration", ("quantity", "estimate", "standard deviation", "before", "determined"), rows)


def _report(
    scenario: Scenario,
    recordings: list[JointRecording],
    held_out: list[JointRecording],
    names: list[str],
    prior: JointPrior,
    out: Path,
    json: bool,
) -> None:
    from mckibben.calibration import CommandedCalibration, calibrate_scenario, calibrated_scenario
    from mckibben.calibration.experiment import deviations, statements, write_model
    from mckibben.report.joint import calibration as draw

    commanded = any(one.commanded for one in recordings)
    if held_out and not (commanded and all(one.commanded for one in held_out)):
        raise ParameterError(
            "--held-out applies to recordings of commands", remedy="give columns command1_bar,command2_bar in all files"
        )
    found = calibrate_scenario(scenario, recordings, prior)
    simulated: list[dict[str, Any]] = []
    if isinstance(found, CommandedCalibration):
        for number, (name, one) in enumerate(zip(names, [*recordings, *held_out], strict=True)):
            errors = found.simulate(one).errors
            row = {"file": name, "held_out": number >= len(recordings)}
            simulated.append({**row, "angle_error_before": errors[0], "angle_error": errors[1]})
    before, after = deviations(found, recordings)
    numbers: dict[str, Any] = {
        "residual_angle_rad" if commanded else "residual_torque_Nm": found.residual,
        **({} if commanded else {"noise_torque_Nm": found.noise}),
        "stiffness_deviation_before": before,
        "stiffness_deviation": after,
        "quantities": _quantities_json(found.quantities),
    }
    if simulated:
        numbers["simulated"] = simulated
    with keeping(out):
        write_model(scenario, found, out / "model.yaml")
        _keep(out, calibrated_scenario(scenario, found), numbers, draw(found, recordings))
    if json:
        echo(to_json(numbers))
    else:
        _show_quantities(found.quantities)
        unit = "rad" if commanded else "N*m"
        echo(
            f"stiffness: standard deviation {after:.2g} N*m/rad, {before:.2g} before; "
            f"residual {found.residual:.2g} {unit}" + ("" if commanded else f", noise {found.noise:.2g} {unit}")
        )
        if simulated:
            table(
                "simulated from the commands: root mean square error of the angle",
                ("recording", "used as", "model before", "calibrated"),
                [
                    (
                        str(row["file"]),
                        "held out" if row["held_out"] else "fitted",
                        show(row["angle_error_before"], "deg", 3),
                        show(row["angle_error"], "deg", 3),
                    )
                    for row in simulated
                ],
            )
        for line in statements(found, weighted=any(one.added_mass for one in recordings)):
            echo(line)
    echo(f"wrote model.yaml (for `model: model.yaml` of a controller), scenario.yaml and figure to {out}", err=json)


def _plan(scenario: Scenario, sweeps: Sweeps, prior: JointPrior, json: bool) -> None:
    from mckibben.calibration import expected

    if not sweeps.added_mass:
        raise ParameterError("a plan needs a weight", remedy="add --weight '0.5 kg' --distance '200 mm'")
    period, total = scenario.control_period, 2 * sweeps.duration
    cases = [(sweeps.added_mass * share, total * part) for share in _PLANNED_WEIGHTS for part in _PLANNED_DURATIONS]
    rows, failed = [], []
    with job_progress(quiet=json) as bar:
        for number, (mass, seconds) in enumerate(cases):
            if bar:
                bar(f"{mass:g} kg, {seconds:g} s", number / len(cases))
            each = round(seconds / (2 if mass else 1) / period) * period
            one = dataclasses.replace(sweeps, added_mass=mass, duration=each)
            with tempfile.TemporaryDirectory() as folder:
                try:
                    before, after = expected(scenario, one, folder, prior)
                    rows.append({"weight_kg": mass, "duration_s": seconds, "before": before, "deviation": after})
                except ParameterError as error:  # the weight is too heavy
                    failed.append((f"{mass:g} kg, {seconds:g} s", error))
    if not rows:
        raise failed[0][1]
    for case, error in failed:
        notify(f"left out: {case}: {error}", json)
    if json:
        echo(to_json(rows))
        return
    table(
        "expected standard deviation of the stiffness if the model were exact",
        ("weight", "duration", "before, N*m/rad", "after, N*m/rad"),
        [
            (f"{r['weight_kg']:g} kg", f"{r['duration_s']:g} s", f"{r['before']:.2g}", f"{r['deviation']:.2g}")
            for r in rows
        ],
    )
