"""Sweeps of a joint under its controller, bare and with a known weight, and scenarios with the calibrated model."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from mckibben.calibration.equations import CREEP_TIMES, samples_of
from mckibben.calibration.estimation import JointCalibration, calibrate_model, predicted_deviation
from mckibben.calibration.loop import PLANTS, loop_margins, with_estimates
from mckibben.calibration.models import HingeModel, Moved, RobotModel
from mckibben.calibration.recordings import Floats, JointPrior, JointRecording
from mckibben.calibration.service import write_posterior, write_settings
from mckibben.codegen.engine import compiled
from mckibben.codegen.native import over_periods
from mckibben.component.schema import independent, inherited_fields, replaced, write_text
from mckibben.config.document import shortened
from mckibben.config.model import DocumentModel
from mckibben.control import Multisine, OpenLoopControl, Reference, Sine, Sum
from mckibben.control.base import field_of, with_fields
from mckibben.dataset import Recipe
from mckibben.dataset.reading import read_signals
from mckibben.errors import IdentificationError, ParameterError, StoppedError
from mckibben.joint import AntagonisticJoint, Load, Measurement
from mckibben.joint.attainable import stiffness_range
from mckibben.joint.geometry import Pair
from mckibben.muscle import MaxwellCreep
from mckibben.plant.sensors import PerfectSensors, SampledSensors, Sensors
from mckibben.result import Column, Listing
from mckibben.rig import JointRig, JointRunResult, prepare
from mckibben.rig.channels import Channels
from mckibben.rig.simulated.joint import Sensing
from mckibben.scenario import Scenario, Start, run_scenario
from mckibben.simulation import SimulationResult
from mckibben.storage.files import atomic_write, make_folder
from mckibben.units import deg

_PRESSURES = ("pressure1", "pressure2")
_BAND = 0.7  # swept fraction of the attainable stiffness
_WIDEST = 10 * deg  # amplitude of fast motion, on a hinge
_FAST = (1.0, 1.45, 1.95, 2.45, 2.95, 3.45, 4.0)  # Hz
_PHASES = tuple(math.pi * k * k / len(_FAST) % (2 * math.pi) for k in range(len(_FAST)))  # M. Schroeder, 1970
_HEAD = """\
# A joint calibrated by `mckibben calibrate`, for controllers: `model: model.yaml`.
"""


@dataclass(frozen=True)
class Sweeps:
    """A calibration experiment: slow sweeps, then fast motion, without and with a weight.

    Attributes
    ----------
    lowest, highest
        Angles [rad], of a slide positions [m].
    duration
        Duration of all parts [s].
    added_mass, distance, weight_inertia
        Weight of the later parts [kg], the distance of its centre from the axis [m], and its inertia about that
        [kg*m^2]; without a weight there are half of the parts.
    tube
        Lag [s] of the pressure in the muscles behind that at the sensors.
    """

    lowest: float
    highest: float
    duration: float
    added_mass: float = 0.0
    distance: float = 0.0
    weight_inertia: float = 0.0
    tube: float = 0.0

    def parts(self, scenario: Scenario, results: Mapping[str, SimulationResult]) -> Iterator[tuple[str, Scenario]]:
        """Yield name and scenario of each part, once those before it are in the results.

        Slow parts sweep the angle three times and the stiffness twice under the scenario's controller. Fast ones are a
        multisine of 1 to 4 Hz of the differential pressure, without feedback, while the co-contraction is swept twice;
        their pressures are those of the model that the parts before give. Raises `ParameterError` if no stiffness is
        attainable at all angles, and for a model that is calibrated already.
        """
        first_model_of(scenario)
        self._attainable(scenario)
        for name, mass in self.weights.items():
            yield f"{name}_slow", self._slow(scenario, mass)
            model = calibrate_model(first_model_of(scenario), self.recordings(results)).model
            if (fast := self._fast(scenario, model, mass)) is not None:
                yield f"{name}_fast", fast

    def prediction(self, scenario: Scenario, prior: JointPrior) -> Listing:
        """Return the deviation of the stiffness that weights are expected to leave, before anything moves.

        The experiment is simulated on the controller's model. The duration changes it little: an error of the model
        repeats with the motion.
        """
        model: Any = first_model_of(scenario)
        nominal = scenario.model_copy(update={"joint": model.joint, "load": model.load})
        mass, deviations = self.added_mass or 0.5, []
        weights = [0.0, mass, 2 * mass]
        for weight in weights:
            trial = replace(self, added_mass=weight, distance=self.distance or 0.2)
            results = {}
            for name, heavy in trial.weights.items():
                results[f"{name}_slow"] = simulated(trial._slow(nominal, heavy))
                if (fast := trial._fast(nominal, model, heavy)) is not None:
                    results[f"{name}_fast"] = simulated(fast)
            deviations.append(predicted_deviation(model, trial.recordings(results), prior))
        columns: Any = {"weight": (Column("kg", digits=3), weights)}
        columns["stiffness"] = (Column("1", shown="%", digits=2), deviations)
        return Listing("expected standard deviation", columns)

    @property
    def weights(self) -> dict[str, float]:
        """Added mass [kg] by the beginning of the names of its parts."""
        return {"bare": 0.0, **({"weighted": self.added_mass} if self.added_mass else {})}

    @property
    def instructions(self) -> dict[str, str]:
        """What a person has to confirm before each part on a physical rig."""
        weight = {"bare": "no weight is on the limb", "weighted": f"the weight of {self.added_mass:g} kg is clipped on"}
        return {f"{name}_{pace}": weight[name] for name in self.weights for pace in ("slow", "fast")}

    def recordings(self, results: Mapping[str, SimulationResult]) -> list[JointRecording]:
        """Recordings of the parts that have been run, with their weights."""
        weight: Any = {"distance": self.distance, "weight_inertia": self.weight_inertia}
        return [
            replace(recording_of(result), tube=self.tube, added_mass=mass, **(weight if mass else {}))
            for name, mass in self.weights.items()
            for part, result in results.items()
            if part.startswith(name)
        ]

    def _part_duration(self, scenario: Scenario) -> float:
        return round(self.duration / len(self.instructions) / scenario.control_period) * scenario.control_period

    def _slow(self, scenario: Scenario, mass: float, *, sweeps: int = 3, stiffnesses: int = 2) -> Scenario:
        """Sweeps within the attainable set of the controller's model, in periods of angle and stiffness."""
        middle, amplitude = (self.lowest + self.highest) / 2, (self.highest - self.lowest) / 2
        (low, high), duration = self._attainable(scenario), self._part_duration(scenario)
        stiffness = Sine(_BAND * (high - low) / 2, stiffnesses / duration, offset=(low + high) / 2)
        signals = Reference(
            Sine(amplitude, sweeps / duration, offset=middle), stiffness if scenario.follows_stiffness else None
        )
        control = independent(scenario.control())
        if (load := field_of(control, "load")) is not None:
            control = with_fields(control, {"load": self._weighted(load, mass)})
        changes = {"controller": control, "load": self._weighted(scenario.load, mass), "duration": duration}
        return part_of(scenario, f"calibration with {mass:g} kg, slow", middle, signals=signals, **changes)

    def _fast(self, scenario: Scenario, model: HingeModel, mass: float, *, trials: int = 8) -> Scenario | None:
        """Multisine whose amplitude moves a model by 10 deg or 10 mm, or by 90 % of the way to the next of the angles.

        With slow valves the commands reach their limits before; None if the muscles then move too little to tell their
        forces from friction. Raises `ParameterError` if the model does not come near that in some trials.
        """
        middle, duration = (self.lowest + self.highest) / 2, self._part_duration(scenario)
        target = min(_WIDEST * scenario.joint_type.scale, 0.9 * (self.highest - self.lowest) / 2)
        load = self._weighted(model.load, mass)
        plant = scenario.model_copy(update={"joint": model.joint, "load": load}).plant()
        low, high = (float(bound[0]) for bound in _bands((plant.supplied_joint, [load], middle), np.array([middle]))[0])
        edge, follows = (1 - _BAND) / 2 * (high - low), scenario.follows_stiffness
        held = (low + edge, high - edge) if follows else (None,)
        ends = np.array([plant.equilibrium(middle, stiffness=K).pressures for K in held], float)
        swept = [
            Sine(half, 2 / duration, offset=mean) for mean, half in zip(ends.mean(0), np.ptp(ends, 0) / 2, strict=True)
        ]
        amplitude = 0.02 * float(ends.max())
        for _ in range(trials):
            first, second = (
                Sum((sweep, Multisine((sign * amplitude,) * len(_FAST), _FAST, _PHASES)))
                for sign, sweep in zip((-1.0, 1.0), swept, strict=True)
            )
            part = part_of(
                scenario,
                f"calibration with {mass:g} kg, fast",
                middle,
                controller=OpenLoopControl(first, second, model_of(scenario)),
                load=self._weighted(scenario.load, mass),
                signals=Reference(middle, (low + high) / 2 if follows else None),
                duration=duration,
            )
            run = run_scenario(part.model_copy(update={"joint": model.joint, "load": load}))
            moved = np.abs(run["angle"] - middle)
            if 0.85 * target < moved.max() < target:
                return part
            if moved.max() < target and run["saturated"].any():
                return part if _tells(model, run) else None
            amplitude *= float(
                np.clip(math.sqrt(0.92 * target / moved.max()), 0.5, 2.0)
            )  # resonance: more than in proportion
        far = scenario.joint_type.show(target, "deg", 3)
        raise ParameterError(
            f"no differential pressure moves the model by {far} with {mass:g} kg",
            remedy="give wider --angles, or a smaller weight",
        )

    def _weighted(self, load: Load, mass: float) -> Load:
        """Return a load with the weight."""
        loaded = jax.tree.map(float, _loaded((load, mass, self.distance)))
        if not (mass and self.weight_inertia):
            return loaded
        return replace(loaded, inertia=loaded.inertia + self.weight_inertia)

    def _attainable(self, scenario: Scenario) -> tuple[float, float]:
        """Stiffness range [N*m/rad] attainable at all angles with each weight; `ParameterError` if there is none."""
        joint, load = model_of(scenario), load_of(scenario)
        angles = np.linspace(self.lowest, self.highest, 41)
        loads = [self._weighted(load, mass) for mass in self.weights.values()]
        bands = np.asarray(_bands((joint, loads, (self.lowest + self.highest) / 2), angles))
        low, high = float(bands[:, 0].max()), float(bands[:, 1].min())
        if any(joint.springs):  # the angle determines the stiffness, so none is attainable at all angles
            low = high = float(bands.mean())
        if not low <= high:
            message = "no stiffness is attainable at all of the angles, with and without weight"
            raise ParameterError(message, remedy="give other angles, or a smaller weight")
        return low, high


def simulated_calibration(scenario: Scenario, sweeps: Sweeps, prior: JointPrior) -> JointCalibration:
    """Simulate an experiment on the plant of a scenario, and identify the model of its controller.

    Parts in which the muscles move too little to tell their forces from friction are left out.

    Raises `ParameterError` and `StoppedError` as `Sweeps.parts` and `simulated`, `IdentificationError` as
    `calibrate_joint`.
    """
    results: dict[str, SimulationResult] = {}
    model = first_model_of(scenario)
    for name, part in sweeps.parts(scenario, results):
        if _tells(model, run := simulated(part), lengths=6.0):
            results[name] = run
    return calibrate_model(model, sweeps.recordings(results), prior)


def _tells(model: Moved, run: SimulationResult, *, lengths: float = 9.0) -> bool:
    """Whether muscles forget their friction in a simulated motion, which has more lengths than a calibration asks."""
    try:
        samples_of(model, recording_of(run), lengths=lengths)
    except IdentificationError:
        return False
    return True


@compiled
def _loaded(shared: tuple[Load, Array, Array], _: None) -> Load:
    return shared[0].with_weight(*shared[1:])


@compiled
def _bands(shared: tuple[AntagonisticJoint, list[Load], Array], angle: Array) -> list[Pair]:
    """Attainable stiffness [N*m/rad] with each load at an angle, of muscles that are well taut.

    Their tension is 15 % of the highest force at the middle contraction, as a muscle may be weaker than its model; that
    of a muscle alone is what load and spring need.
    """
    joint, loads, centre = shared
    middle = joint.contractions(centre, (0.0, 0.0))
    muscles = zip((joint.muscle1, joint.muscle2), middle, joint.springs, strict=True)
    highest = [muscle.tension(at, muscle.domain.pressure_max) for muscle, at, spring in muscles if not spring]
    least: Any = 0.0 if any(joint.springs) else 0.15 * jnp.stack(highest).min()
    return [stiffness_range(joint, angle, -load.gravity_torque(angle), None, least) for load in loads]


def part_of(scenario: Scenario, title: str, angle: float, **changes: object) -> Scenario:
    """Part of an experiment: the scenario with a title, from rest at an angle [rad], and with other sections."""
    start = {"name": f"{scenario.name[:150]}, {title}", "start": Start(angle=angle)}
    return scenario.model_copy(update=start | changes)


def model_of(scenario: Scenario) -> AntagonisticJoint:
    """Return the controller's model of the joint, or the joint of the scenario."""
    return field_of(scenario.control(), "model") or scenario.joint


def first_model_of(scenario: Any) -> Moved:
    """Return the controller's model of a joint or a robot, which a calibration corrects.

    Raises `ParameterError` if one has corrected it already, and if controllers of single joints have models of these.
    """
    if not scenario.joint_names:
        model: Moved = HingeModel(model_of(scenario), load_of(scenario))
    else:
        for name, controller in scenario.controllers.items():
            if getattr(controller, "model", None) and "model" not in inherited_fields(controller):
                remedy = "leave it out, so that it follows the robot"
                raise ParameterError(
                    "a joint's controller has a model", field=f"controllers.{name}.model", value=name, remedy=remedy
                )
        model = RobotModel(field_of(scenario.control(), "robot") or scenario.robot)
    if any(muscle.correction for muscle in model.muscles):
        remedy = "give the scenario with the initial model: intervals need its prior"
        raise ParameterError("the controller's model has been calibrated already", remedy=remedy)
    return model


def load_of(scenario: Scenario) -> Load:
    """Return the controller's model of the load."""
    return field_of(scenario.control(), "load") or scenario.load


def run_parts(
    parts: Callable[[Mapping[str, SimulationResult]], Iterable[tuple[str, Scenario]]],
    folder: str | os.PathLike[str],
    *,
    rig: JointRig | None = None,
    firmware: Scenario | None = None,
    ready: Callable[[str], None] | None = None,
    progress: Any = None,
) -> dict[str, SimulationResult]:
    """Run the scenarios of an experiment on a joint rig (default: simulated at once), each in a folder of its name.

    `parts` is called with the results, which grow while it gives names and scenarios.

    The firmware of a board has to be made from the scenario `firmware` (default: from each part). `ready` is called
    with the name before each part. Raises `StoppedError` if a limit or a fault stops a part; the joint is then vented.
    """
    results: dict[str, SimulationResult] = {}
    for name, part in parts(results):
        if rig is None:
            records, results[name] = make_folder(Path(folder) / name), simulated(part)
        else:
            if ready is not None:
                ready(name)
            session, records = prepare(part, rig, paced=rig.physical, firmware=firmware), Path(folder) / name
            run: JointRunResult = session.run(records, progress=progress)
            if run.outcome.error is not None or not isinstance(run.result, SimulationResult):
                raise StoppedError(f"stopped: {run.outcome.text}; {run.outcome.venting}")
            results[name] = run.result
        results[name].to_netcdf(records / "result.nc")
    return results


def simulated(part: Scenario) -> SimulationResult:
    """Return a simulated run of a part, in which angle and pressures are those that its controller measured.

    The sensors are those of the scenario or, if they are perfect, the usual ones of a joint rig (`Sensing`). Raises
    `StoppedError` if the run diverges.
    """
    sensors = part.sensors
    if isinstance(sensors, PerfectSensors):
        sensors = SampledSensors(Sensing.angle_step * part.joint_type.scale, Sensing.pressure_noise)
    result = run_scenario(part.model_copy(update={"sensors": sensors}))
    names = "angle", *_PRESSURES
    if not np.isfinite(result["angle"]).all():
        raise StoppedError("the simulated joint diverges", remedy="mckibben simulate shows the run")
    true = over_periods((np.arange(result.times.size), *(result[name] for name in names)))
    columns = dict(zip(names, _measured((sensors, true, [column[0] for column in true[1:]])), strict=True))
    return replace(result, columns={**result.columns, **columns})


@compiled
def _measured(shared: tuple[Sensors, PyTree, PyTree], _: None) -> PyTree:
    """Measured angles and pressures of all periods, shape (periods,) each, from their numbers and the true ones."""

    def step(state: PyTree, sample: PyTree) -> PyTree:
        state, (angle, pressures) = sensors.measure(state, sample[0], Measurement(sample[1], sample[2:]))
        return state, (angle, *pressures)

    sensors, true, (angle, first, second) = shared
    return jax.lax.scan(step, sensors.init(Measurement(angle, (first, second))), true)[1]


def recording_of(result: SimulationResult) -> JointRecording:
    """The recording of a run of a joint or a robot."""
    angle, pressures, commands = (result[name].T for name in ("angle", "pressure", "command"))
    return JointRecording(result.times, angle, pressures, commands=commands)


def read_joint_recording(
    path: str | os.PathLike[str],
    recipe: Recipe | None = None,
    channels: Channels = Channels(),  # noqa: B008
    **weight: Any,
) -> JointRecording:
    """Read a recording: a file of any format of `read_dataset` with columns such as ``time_s,angle_deg,p1_bar,p2_bar``.

    Those of a robot have the names of its `channels`: ``angle.hip_deg``, ``pressure.hip1_bar``. Columns
    ``command1_bar,command2_bar`` give commands, for the valves, ``tension1_N,tension2_N`` the readings of load cells;
    `recipe` names others. Further attributes of the recording, weight and lag of the tubes, are arguments. A
    ``result.nc`` of `mckibben rig control` or `mckibben simulate` is read as well. Raises a `DatasetError` with every
    problem of the file.
    """
    file = Path(path)
    if file.suffix == ".nc":
        return replace(recording_of(SimulationResult.from_netcdf(file)), **weight)
    groups = [channels.by_muscle(kind) for kind in ("pressure", "command", "tension")]
    columns = read_signals(file, ("time", *channels.readings), recipe, of_muscles=groups)
    pressures, commands, tensions = (
        np.stack([columns[name] for name in names], axis=1) if names[0] in columns else None for names in groups
    )
    angle = np.stack([columns[name] for name in channels.by_joint("angle")], axis=1)
    angle = angle if channels.is_named else angle[:, 0]
    return JointRecording(columns["time"], angle, cast(Floats, pressures), tensions, commands=commands, **weight)


def calibrate_scenario(
    scenario: Any,  # Scenario | RobotScenario
    recordings: Sequence[JointRecording],
    prior: JointPrior | None = None,
    *,
    held_out: Sequence[JointRecording] = (),
) -> JointCalibration:
    """Identify the controller's model of a joint or a robot from recordings.

    Recordings that are `held_out` are not fitted; where the model before predicts them better, the files keep it.
    """
    model = first_model_of(scenario)
    fit = replace(calibrate_model(model, recordings, prior), held_out=tuple(held_out))
    keeps = bool(held_out) and not fit.predicts
    after = scenario if keeps else calibrated_scenario(scenario, fit)
    margins = None if keeps else loop_margins(after, **fit.drawn(PLANTS))
    writers: dict[str, Any] = {"scenario.yaml": partial(write_estimates, after.dumps, scenario, "")}
    if not keeps:
        writers |= {"estimate.json": partial(write_posterior, scenario, fit.posterior), "service.yaml": write_settings}
    if joint := (model if keeps else calibrated_model(fit)).parts.get("joint"):
        writers["model.yaml"] = partial(write_estimates, partial(write_text, joint), scenario, _HEAD)
    return replace(fit, disk_margins=margins).with_files(writers)


def calibrated_model(fit: JointCalibration) -> Moved:
    """Return the model with the estimates; of creep, if the model had none, those that are determined."""
    muscles = []
    for name, muscle in zip(fit.model.muscle_names, fit.model.muscles, strict=True):
        creep = fit.quantities.get(f"{name}.creep")
        if creep and creep.determined and creep.value > 0 and not muscle.has_creep:
            arms = MaxwellCreep(creep.value, float(CREEP_TIMES[0]), arms=2)  # of 1 and 10 s
            muscles.append(replace(muscle, creep=arms))
        else:
            muscles.append(muscle)
    return fit.model.with_muscles(muscles)


def calibrated_scenario(scenario: Any, fit: JointCalibration) -> Any:
    """Return the scenario with the estimates as plant, encoder of a joint included, and as its controller's model."""
    parts = calibrated_model(fit).parts
    if scenario.joint_names:  # whose uncertainty is that of all muscles and bodies
        return with_estimates(scenario, {}, **parts)
    sensors = SampledSensors() if isinstance(scenario.sensors, PerfectSensors) else scenario.sensors
    if isinstance(sensors, SampledSensors):
        parts["sensors"] = replaced(sensors, {"encoder_offset": fit.quantities["zero"].value})
    return with_estimates(scenario, fit.deviations(), **parts)


def write_estimates(text: Callable[..., str], before: DocumentModel, comment: str, path: Path) -> None:
    """Write a file, such as ``model: FILE`` of a controller, below a comment.

    Numbers that do not stand in the scenario before have six digits: the estimates.
    """
    content = shortened(text(folder=path.parent), before.dumps(folder=path.parent))
    with atomic_write(path, overwrite=True) as file:
        file.write_text(comment + content, encoding="utf-8")
