"""Sweeps of a joint under its controller, bare and with a known weight, and scenarios with the calibrated model."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from mckibben.calibration.equations import CREEP_TIMES, JointPrior, JointRecording, sliding_from
from mckibben.calibration.estimation import JointCalibration, calibrate_joint
from mckibben.calibration.loop import PLANTS, field_of, loop_margins, with_estimates, with_fields
from mckibben.codegen.engine import compiled
from mckibben.codegen.native import over_periods
from mckibben.component.schema import independent, replaced, write_text
from mckibben.control import Multisine, Reference, Sine
from mckibben.dataset import Recipe
from mckibben.dataset.reading import read_signals
from mckibben.errors import McKibbenWarning, ParameterError, StoppedError
from mckibben.joint import AntagonisticJoint, GeneralLoad, Load, Measurement, ScaledArms
from mckibben.joint.attainable import stiffness_range
from mckibben.joint.geometry import Pair
from mckibben.muscle import MaxwellCreep
from mckibben.muscle.adjusted import AdjustedLaw
from mckibben.plant.sensors import PerfectSensors, SampledSensors, Sensors
from mckibben.rig import JointRig, JointRunResult, prepare
from mckibben.rig.simulated.joint import Sensing
from mckibben.scenario import Scenario, Start, run_scenario
from mckibben.simulation import SimulationResult
from mckibben.storage.files import atomic_write, make_folder

_PRESSURES = ("pressure1", "pressure2")
_HEAD = """\
# A joint calibrated by `mckibben calibrate`, for controllers: `model: model.yaml`.
"""


@dataclass(frozen=True)
class Sweeps:
    """A calibration experiment.

    Attributes
    ----------
    lowest, highest
        Angles [rad].
    duration
        Duration of all parts [s].
    added_mass, distance
        Weight of the second part [kg], and its distance from the axis [m]; without a weight there is one part.
    """

    lowest: float
    highest: float
    duration: float
    added_mass: float = 0.0
    distance: float = 0.0

    def scenarios(
        self,
        scenario: Scenario,
        *,
        sweeps: int = 3,
        cocontractions: int = 2,
        band: float = 0.7,
        fast: float = 1.0,
        least: tuple[float, float] = (0.15, 1.0),
        most: tuple[float, float] = (0.35, 4.0),
    ) -> dict[str, Scenario]:
        """Scenario of each part, "bare" and "weighted": sweeps within the attainable set of the controller's model.

        Angles are swept slowly, three times a minute or part, with a motion of 1 Hz, from which the inertia follows,
        and the stiffness twice over 70 % of the range attainable at all angles, bare and with the weight (but not with
        a return spring). With a weight the faster motion is larger in the middle of the range. Raises `ParameterError`
        if there is no such range, `IdentificationError` if the angles do not overcome the friction of the model. Warns
        of a weight whose torque is below that friction, as it hardly determines the forces.

        Parameters
        ----------
        scenario
            Joint, controller and times.
        sweeps, cocontractions
            Periods of angle and stiffness in a part, or a minute of it: creep hides the inertia in slow motion.
        band
            Swept fraction of the attainable stiffness.
        fast, least, most
            Frequency [Hz] of the faster motion, and its largest part of the amplitude and acceleration [rad/s^2], bare
            and, in the middle, with a weight.
        """
        middle, amplitude = (self.lowest + self.highest) / 2, (self.highest - self.lowest) / 2
        sliding_from(first_model_of(scenario), np.array([self.lowest, self.highest, self.highest]))
        low, high = self._attainable(scenario)
        if self.added_mass:
            self._check_weight(first_model_of(scenario), load_of(scenario))
        slight, strong = (
            float(min(share * amplitude, fastest / (2 * np.pi * fast) ** 2)) for share, fastest in (least, most)
        )
        duration = self.part_duration(scenario)
        rounds = max(round(duration / 60.0), 1)
        slow, half = rounds * sweeps / duration, (strong - slight) / 2 if self.added_mass else 0.0
        signals = Reference(
            Multisine(  # the slow sine, and a fast one that grows with the square of the slow cosine
                (float(amplitude) - slight, slight + half, half / 2, half / 2),
                (slow, fast, fast + 2 * slow, fast - 2 * slow),
                offset=float(middle),
            ),
            Sine(band * (high - low) / 2, rounds * cocontractions / duration, offset=(low + high) / 2),
        )
        control = independent(scenario.control())
        load = field_of(control, "load")
        parts = {}
        for name, mass in self.weights.items():
            controller = control if load is None else with_fields(control, {"load": self._weighted(load, mass)})
            changes = {"controller": controller, "load": self._weighted(scenario.load, mass), "duration": duration}
            parts[name] = part_of(scenario, f"calibration with {mass:g} kg", middle, signals=signals, **changes)
        return parts

    @property
    def weights(self) -> dict[str, float]:
        """Added mass [kg] of each part by its name."""
        return {"bare": 0.0, **({"weighted": self.added_mass} if self.added_mass else {})}

    @property
    def instructions(self) -> dict[str, str]:
        """What a person has to confirm before each part on a physical rig."""
        weighted = {"weighted": f"the weight of {self.added_mass:g} kg is clipped on"} if self.added_mass else {}
        return {"bare": "no weight is on the limb", **weighted}

    def part_duration(self, scenario: Scenario) -> float:
        """Duration of each part [s], a multiple of the control period."""
        return round(self.duration / len(self.weights) / scenario.control_period) * scenario.control_period

    def recordings(self, results: Mapping[str, SimulationResult]) -> list[JointRecording]:
        """Recordings of the parts, with their weights."""
        return [
            recording_of(results[name], added_mass=mass, distance=self.distance) for name, mass in self.weights.items()
        ]

    def _weighted(self, load: Load, added_mass: float) -> GeneralLoad:
        """Return a load with the weight."""
        return jax.tree.map(float, _loaded((load, added_mass, self.distance)))

    def _check_weight(self, joint: AntagonisticJoint, load: Load) -> None:
        """Warn if the weight turns the joint by less than friction holds it, in the middle at the highest pressures."""
        ends = self.lowest, self.highest
        friction, most = map(float, _holding((joint, load, self._weighted(load, self.added_mass), ends)))
        if most < friction:
            text = f"the torque of the weight, at most {most:.2g} N*m, is below the friction, {friction:.2g} N*m: "
            text += "it hardly determines the forces; use a heavier weight, or wider angles"
            warnings.warn(text, McKibbenWarning, stacklevel=2)

    def _attainable(self, scenario: Scenario) -> tuple[float, float]:
        """Stiffness range [N*m/rad] attainable at all angles with each weight; `ParameterError` if there is none."""
        joint, load = first_model_of(scenario), load_of(scenario)
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


@compiled
def _loaded(shared: tuple[Load, Array, Array], _: None) -> GeneralLoad:
    return shared[0].with_weight(*shared[1:])


@compiled
def _holding(shared: tuple[AntagonisticJoint, Load, Load, Pair], _: None) -> tuple[Array, Array]:
    """Friction torque [N*m] midway between the ends at the highest pressures, and the most that the weight adds."""
    joint, load, loaded, (low, high) = shared
    middle, pressures = (low + high) / 2, (joint.muscle1.domain.pressure_max, joint.muscle2.domain.pressure_max)
    states = joint.update_state(joint.init_state(low, pressures), middle, pressures)
    added = [jnp.abs(loaded.gravity_torque(end) - load.gravity_torque(end)) for end in (low, high)]
    return jnp.abs(joint.friction_torque(middle, None, pressures, states)), jnp.maximum(*added)


@compiled
def _bands(shared: tuple[AntagonisticJoint, list[Load], Array], angle: Array) -> list[Pair]:
    """Attainable stiffness [N*m/rad] with each load at an angle, of muscles that are well taut.

    Their tension is 8 % of the highest force at the middle contraction, as a muscle may be weaker than its model.
    """
    joint, loads, centre = shared
    middle = joint.contractions(centre, (0.0, 0.0))
    muscles = zip((joint.muscle1, joint.muscle2), middle, joint.springs, strict=True)
    highest = [muscle.tension(at, muscle.domain.pressure_max) for muscle, at, spring in muscles if not spring]
    least: Any = 0.08 * jnp.stack(highest).min()
    return [stiffness_range(joint, angle, -load.gravity_torque(angle), None, least) for load in loads]


def part_of(scenario: Scenario, title: str, angle: float, **changes: object) -> Scenario:
    """Part of an experiment: the scenario with a title, from rest at an angle [rad], and with other sections."""
    start = {"name": f"{scenario.name[:150]}, {title}", "start": Start(angle=angle)}
    return scenario.model_copy(update=start | changes)


def model_of(scenario: Scenario) -> AntagonisticJoint:
    """Return the controller's model of the joint, or the joint of the scenario."""
    return field_of(scenario.control(), "model") or scenario.joint


def first_model_of(scenario: Scenario) -> AntagonisticJoint:
    """Return `model_of`, which a calibration corrects; `ParameterError` if one has corrected it already."""
    model = model_of(scenario)
    if isinstance(model.geometry, ScaledArms) or model.muscle1.correction or model.muscle2.correction:
        remedy = "give the scenario with the initial model: intervals need its prior"
        raise ParameterError("the controller's model has been calibrated already", remedy=remedy)
    return model


def load_of(scenario: Scenario) -> Load:
    """Return the controller's model of the load."""
    return field_of(scenario.control(), "load") or scenario.load


def run_parts(
    parts: Mapping[str, Scenario],
    folder: str | os.PathLike[str],
    *,
    rig: JointRig | None = None,
    firmware: Scenario | None = None,
    ready: Callable[[str], None] | None = None,
    progress: Any = None,
) -> dict[str, SimulationResult]:
    """Run the scenarios of an experiment on a joint rig (default: simulated at once), each in a folder of its name.

    The firmware of a board has to be made from the scenario `firmware` (default: from each part). `ready` is called
    with the name before each part. Raises `StoppedError` if a limit or a fault stops a part; the joint is then vented.
    """
    results = {}
    for name, part in parts.items():
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
        sensors = SampledSensors(Sensing.angle_step, Sensing.pressure_noise)
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


def recording_of(result: SimulationResult, *, added_mass: float = 0.0, distance: float = 0.0) -> JointRecording:
    """The recording of a run on a joint rig."""
    pressures, commands = (
        np.stack([result[f"{kind}1"], result[f"{kind}2"]], axis=1) for kind in ("pressure", "command")
    )
    return JointRecording(result.times, result["angle"], pressures, None, added_mass, distance, commands=commands)


def read_joint_recording(
    path: str | os.PathLike[str], recipe: Recipe | None = None, *, added_mass: float = 0.0, distance: float = 0.0
) -> JointRecording:
    """Read a recording: a file of any format of `read_dataset` with columns such as ``time_s,angle_deg,p1_bar,p2_bar``.

    Columns ``command1_bar,command2_bar`` give commands, for the valves, ``tension1_N,tension2_N`` the readings of load
    cells; `recipe` names others. A ``result.nc`` of `mckibben rig control` is read as well. Raises a `DatasetError`
    with every problem of the file.
    """
    file = Path(path)
    if file.suffix == ".nc":
        return recording_of(SimulationResult.from_netcdf(file), added_mass=added_mass, distance=distance)
    columns = read_signals(file, ("time", "angle", *_PRESSURES), recipe)
    times = columns["time"]

    def pair(kind: str) -> Any:
        return np.stack([columns[f"{kind}{i}"] for i in (1, 2)], axis=1) if f"{kind}1" in columns else None

    readings = columns["angle"], pair("pressure"), pair("tension")
    return JointRecording(times, *readings, added_mass, distance, commands=pair("command"))


def calibrate_scenario(
    scenario: Scenario,
    recordings: Sequence[JointRecording],
    prior: JointPrior | None = None,
    *,
    held_out: Sequence[JointRecording] = (),
) -> JointCalibration:
    """Identify the controller's model of a scenario from recordings.

    Recordings that are `held_out` are not fitted; where the model before predicts them better, the files keep it.
    """
    joint, load = first_model_of(scenario), load_of(scenario)
    fit = replace(calibrate_joint(joint, load, recordings, prior), held_out=tuple(held_out))
    keeps = bool(held_out) and not fit.predicts
    after = scenario if keeps else calibrated_scenario(scenario, fit)
    model = joint if keeps else calibrated_model(scenario, fit)
    margins = None if keeps else loop_margins(after, **fit.drawn(PLANTS))
    writers = {"model.yaml": partial(write_section, model, _HEAD), "scenario.yaml": after.to_yaml}
    return replace(fit, disk_margins=margins).with_files(writers)


def calibrated_model(scenario: Scenario, fit: JointCalibration) -> AntagonisticJoint:
    """Return the controller's model with the estimates."""
    model, joint, muscles = first_model_of(scenario), fit.joint, {}
    for name in ("muscle1", "muscle2"):
        before, after = getattr(model, name), getattr(joint, name)
        if isinstance(after.law, AdjustedLaw):
            parts = {"correction": after.law.correction, "friction": after.friction}
            creep = fit.quantities.get(f"{name}.creep")
            if creep and creep.determined and creep.value > 0 and not before.has_creep:
                parts["creep"] = MaxwellCreep(creep.value, float(CREEP_TIMES[0]), arms=2)  # of 1 and 10 s
            muscles[name] = replaced(before, parts)
    assert isinstance(joint.geometry, ScaledArms)
    return replaced(model, {**muscles, "geometry": ScaledArms(model.geometry, joint.geometry.scale)})


def calibrated_scenario(scenario: Scenario, fit: JointCalibration) -> Scenario:
    """Return the scenario with the estimates as its plant, encoder included, and as its controller's model."""
    parts: dict[str, Any] = {"joint": calibrated_model(scenario, fit), "load": fit.load}
    sensors = SampledSensors() if isinstance(scenario.sensors, PerfectSensors) else scenario.sensors
    if isinstance(sensors, SampledSensors):
        parts["sensors"] = replaced(sensors, {"encoder_offset": fit.quantities["zero"].value})
    if mass := fit.load.estimated_mass:
        parts["load"] = replaced(load_of(scenario), {mass: getattr(fit.load, mass)})
    return with_estimates(scenario, fit.deviations(), **parts)


def write_section(part: eqx.Module, comment: str, path: Path, *, base: type | None = None) -> None:
    """Write a part of a scenario, such as ``model: FILE`` of a controller, below a comment."""
    text = comment + write_text(part, folder=path.parent, base=base)
    with atomic_write(path, overwrite=True) as file:
        file.write_text(text, encoding="utf-8")
