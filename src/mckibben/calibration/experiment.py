"""Sweeps of a joint under its controller, bare and with a known weight, and scenarios with the calibrated model."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from mckibben.calibration.equations import JointPrior, JointRecording
from mckibben.calibration.estimation import JointCalibration, calibrate_joint
from mckibben.calibration.output_error import CommandedCalibration, calibrate_from_commands
from mckibben.config.document import to_text
from mckibben.errors import ParameterError, StoppedError
from mckibben.identification.storage import find_fit
from mckibben.joint import Load, ScaledArms
from mckibben.muscle.corrected import CorrectedAffineLaw, CorrectedLaw
from mckibben.plant import FirstOrderValve
from mckibben.realtime import JointRig, JointRunResult, prepare
from mckibben.simulation import Result
from mckibben.storage.files import atomic_write
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.building import build_joint
from mckibben.study.scenario.muscle import CorrectionSpec, FrictionSpec, MuscleSpec
from mckibben.study.scenario.plant import GeneralLoadSpec, JointSpec, StartSpec
from mckibben.study.scenario.reference import ReferenceSpec, read_columns
from mckibben.units import show

_SWEEPS, _COCONTRACTIONS = 3, 2  # periods of angle and stiffness in a part
_FAST, _FAST_SHARE, _FASTEST = 1.0, 0.15, 1.0  # Hz; part of the amplitude; rad/s^2, of the faster motion
_BAND = 0.7  # part of the attainable stiffness that is swept
_TAUT = 0.08  # least tension by the model over its highest force at mid contraction: the muscle may be weaker
_ANGLES = 41
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
        Of each part [s].
    added_mass, distance
        Weight of the second part [kg], and its distance from the axis [m]; without, there is one part.
    """

    lowest: float
    highest: float
    duration: float
    added_mass: float = 0.0
    distance: float = 0.0

    @property
    def weights(self) -> tuple[float, ...]:
        """Added mass [kg] of each part."""
        return (0.0, self.added_mass) if self.added_mass else (0.0,)

    def scenarios(self, scenario: Scenario) -> dict[float, Scenario]:
        """Scenario of each part by its added mass [kg]: sweeps within what the controller's model can hold.

        Angles are swept slowly, three times, with a smaller motion of 1 Hz, and the stiffness twice over 70 % of what
        is attainable at all angles, bare and with the weight; not with a return spring. Raises `ParameterError` if
        there is nothing in common.
        """
        middle, amplitude = (self.lowest + self.highest) / 2, (self.highest - self.lowest) / 2
        low, high = self._attainable(scenario)
        if not low <= high:
            raise ParameterError(
                "no stiffness is attainable at all of the angles, with and without weight",
                remedy="give other --angles, or a smaller --weight",
            )
        fast = min(_FAST_SHARE * amplitude, _FASTEST / (2 * np.pi * _FAST) ** 2)
        angle = {
            "amplitudes": (_rad(amplitude - fast), _rad(fast)),
            "frequencies": (f"{_SWEEPS / self.duration!r} Hz", f"{_FAST} Hz"),
            "offset": _rad(middle),
        }
        stiffness = {
            "amplitude": f"{_BAND * (high - low) / 2!r} N*m/rad",
            "frequency": f"{_COCONTRACTIONS / self.duration!r} Hz",
            "offset": f"{(low + high) / 2!r} N*m/rad",
        }
        signals = ReferenceSpec.model_validate({"angle": {"multisine": angle}, "stiffness": {"sine": stiffness}})
        control = scenario.controller.with_model(scenario.joint, scenario.load, scenario.valve).without_adaptation()
        parts = {}
        for mass in self.weights:
            known = control if control.load is None else control.with_load(self._weighted(control.load, mass))
            parts[mass] = scenario.model_copy(
                update={
                    "name": f"{scenario.name[:150]}, calibration with {mass:g} kg",
                    "controller": known,
                    "load": self._weighted(scenario.load, mass),
                    "signals": signals,
                    "start": StartSpec(angle=middle),
                    "duration": self.duration,
                }
            )
        return parts

    def _weighted(self, load: Any, added_mass: float) -> Any:
        """Section of a load with the weight."""
        return _general(load.build().with_weight(added_mass, self.distance))

    def _attainable(self, scenario: Scenario) -> tuple[float, float]:
        """Stiffness [N*m/rad] attainable at all angles with each weight; the first above the second for none."""
        joint, load = build_joint(model_of(scenario)), load_of(scenario)
        angles = np.linspace(self.lowest, self.highest, _ANGLES)
        middle = joint.contractions((self.lowest + self.highest) / 2, (0.0, 0.0))
        muscles = zip((joint.muscle1, joint.muscle2), middle, joint.springs, strict=True)
        highest = [muscle.tension(at, muscle.domain.pressure_max) for muscle, at, spring in muscles if not spring]
        least = _TAUT * float(min(highest))
        bands = []
        for mass in self.weights:
            torque = -self._weighted(load, mass).build().gravity_torque(jnp.asarray(angles))
            bands += [np.asarray(joint.attainable_stiffness(angles, torque, minimum_tension=least))]
        low, high = np.max([band[0] for band in bands]), np.min([band[1] for band in bands])
        if any(joint.springs):  # the angle determines it, and none is held at all angles
            low = high = np.mean(bands)
        return (float(low), float(high)) if np.isfinite(low + high) else (1.0, 0.0)


def _general(load: Load) -> GeneralLoadSpec:
    return GeneralLoadSpec(
        inertia=float(load.total_inertia),
        gravity_torque=float(load.gravity_moment),
        damping=float(load.damping),
        hanging_angle=float(load.hanging_angle),
    )


def _rad(angle: float) -> str:
    return f"{float(angle)!r} rad"


def model_of(scenario: Scenario) -> JointSpec:
    """Section of the controller's model of the joint, which a calibration corrects."""
    model = scenario.controller.model or scenario.joint
    muscles = filter(None, (model.muscle, model.muscle1, model.muscle2))
    if model.arm_scale is not None or any(muscle.correction is not None for muscle in muscles):
        raise ParameterError(
            "the controller's model has been calibrated already",
            remedy="give the scenario with the model before: intervals need its prior",
        )
    return model


def load_of(scenario: Scenario) -> Any:
    """Section of the controller's model of the load."""
    return scenario.controller.load or scenario.load


def run_sweeps(
    scenario: Scenario,
    sweeps: Sweeps,
    folder: str | os.PathLike[str],
    *,
    rig: JointRig | None = None,
    ready: Callable[[float], None] | None = None,
    progress: Any = None,
) -> list[JointRecording]:
    """Run all parts of an experiment on a joint rig, the simulated joint unless given, and record them in a folder.

    `ready` is called with the added mass [kg] before a part. Raises `StoppedError` if a part is stopped by a limit or a
    fault; the joint is vented then.
    """
    recordings = []
    for mass, part in sweeps.scenarios(scenario).items():
        if ready is not None:
            ready(mass)
        session = prepare(part, rig, paced=rig is not None and rig.physical)
        kept = Path(folder) / ("weighted" if mass else "bare")
        ran: JointRunResult = session.run(kept, progress=progress)
        if ran.outcome.error is not None or ran.result is None:
            raise StoppedError(f"stopped: {ran.outcome.text}; {ran.outcome.venting}")
        ran.result.to_netcdf(kept / "result.nc")
        recordings.append(recording_of(ran.result, added_mass=mass, distance=sweeps.distance))
    return recordings


def recording_of(result: Result, *, added_mass: float = 0.0, distance: float = 0.0) -> JointRecording:
    """The recording of a run on a joint rig."""
    pressures = np.stack([result["pressure1"], result["pressure2"]], axis=1)
    return JointRecording(result.times, result["angle"], pressures, None, added_mass, distance)


def read_joint_recording(
    path: str | os.PathLike[str], *, added_mass: float = 0.0, distance: float = 0.0
) -> JointRecording:
    """Read a recording: a CSV file with columns such as ``time_s,angle_deg,pressure1_bar,pressure2_bar``.

    Commands are in ``command1_bar,command2_bar`` in place of pressures; two columns ``tension1_N,tension2_N`` are those
    of load cells. A ``result.nc`` of `mckibben rig control` is read as well.
    """
    file = Path(path)
    if file.suffix == ".nc":
        return recording_of(Result.from_netcdf(file), added_mass=added_mass, distance=distance)

    def wanted(header: list[str]) -> dict[str, str]:
        begins = {title.partition("_")[0] for title in header}
        kind = "command" if "command1" in begins and "pressure1" not in begins else "pressure"
        cells = ("tension1", "tension2") if "tension1" in begins else ()
        return {"angle": "rad", f"{kind}1": "Pa", f"{kind}2": "Pa", **dict.fromkeys(cells, "N")}

    times, columns = read_columns(file, wanted)
    angle, first, second, *tensions = map(np.asarray, columns.values())
    return JointRecording(
        np.asarray(times),
        angle,
        np.stack([first, second], axis=1),
        np.stack(tensions, axis=1) if tensions else None,
        added_mass,
        distance,
        commanded="command1" in columns,
    )


def with_fits(scenario: Scenario, prior: JointPrior) -> JointPrior:
    """The prior with the fits that the laws of the controller's model are from."""
    model = model_of(scenario)
    muscles = (model.muscle1 or model.muscle, model.muscle2 or model.muscle)
    first, second = (find_fit(one.law) if one and isinstance(one.law, Path) else None for one in muscles)
    return replace(prior, fits=(first, second))


def calibrate_scenario(
    scenario: Scenario, recordings: list[JointRecording], prior: JointPrior | None = None
) -> JointCalibration:
    """The controller's model of a scenario identified from recordings of measured or of commanded pressures."""
    joint, load = build_joint(model_of(scenario)), load_of(scenario).build()
    prior = with_fits(scenario, prior or JointPrior())
    if not any(one.commanded for one in recordings):
        return calibrate_joint(joint, load, recordings, prior)
    if not all(one.commanded for one in recordings):
        raise ParameterError("recordings of commands and of measured pressures", remedy="give those of one kind")
    valve = None if scenario.valve is None else scenario.valve.build()
    if not isinstance(valve, FirstOrderValve):
        raise ParameterError(
            "recordings of commands need a valve with a first-order lag",
            field="valve",
            remedy="give the scenario one that may be, such as `valve: {time_constant: 50 ms}`",
        )
    friction = None if scenario.friction is None else scenario.friction.build()
    delay = scenario.command_delay
    return calibrate_from_commands(joint, load, valve, recordings, prior, friction=friction, delay=delay)


def calibrated_model(scenario: Scenario, found: JointCalibration) -> JointSpec:
    """Section of the controller's model with the estimates."""
    spec, joint = model_of(scenario), found.joint
    update: dict[str, Any] = {"muscle": None}
    for i, muscle in enumerate((joint.muscle1, joint.muscle2), 1):
        before: MuscleSpec | None = getattr(spec, f"muscle{i}") or spec.muscle
        if before is None or not isinstance(muscle.law, CorrectedLaw | CorrectedAffineLaw):
            continue
        friction = {name: getattr(muscle.friction, name) for name in FrictionSpec.model_fields}
        given = {name: one for name, one in friction.items() if one is not None}
        correction = muscle.law.correction
        update[f"muscle{i}"] = before.model_copy(
            update={
                "correction": CorrectionSpec(
                    offset=tuple(map(float, correction.offset)),
                    gain=tuple(map(float, correction.gain)),
                    centre=float(correction.centre),
                    half_width=float(correction.half_width),
                ),
                "friction": FrictionSpec(**given),
            }
        )
    assert isinstance(joint.geometry, ScaledArms)
    return spec.model_copy(update={**update, "arm_scale": float(joint.geometry.scale)})


def calibrated_scenario(scenario: Scenario, found: JointCalibration) -> Scenario:
    """The scenario with the estimates as its controller's model of joint and load.

    Those from commands are its plant, too.
    """
    if isinstance(found, CommandedCalibration):
        joint, load = calibrated_model(scenario, found), _general(found.load)
        control = scenario.controller.with_load(load)
        if control.model is not None:
            control = control.model_copy(update={"model": joint})
        assert scenario.valve is not None  # or nothing could have been found
        rows = {name: float(getattr(found.valve, name)) for name in ("time_constant", "rate")}
        valve = scenario.valve.model_copy(update=rows)
        update: dict[str, Any] = {"joint": joint, "load": load, "valve": valve, "controller": control}
        update["command_delay"] = found.delay
        if found.friction is not None:
            rows = {name: float(getattr(found.friction, name)) for name in ("torque", "presliding")}
            update["friction"] = scenario.friction.model_copy(update=rows)  # type: ignore[union-attr]
        return scenario.model_copy(update=update)
    control = scenario.controller.with_model(scenario.joint, scenario.load, scenario.valve)
    mass = found.load.adapted_mass
    if mass and control.load is not None:
        control = control.with_load(control.load.model_copy(update={mass: float(getattr(found.load, mass))}))
    control = control.model_copy(update={"model": calibrated_model(scenario, found)})
    return scenario.model_copy(update={"controller": control})


def expected(
    scenario: Scenario, sweeps: Sweeps, folder: str | os.PathLike[str], prior: JointPrior | None = None
) -> tuple[float, float]:
    """Standard deviation of the stiffness [N*m/rad] before and after an experiment on the model itself, simulated."""
    model, load = model_of(scenario), load_of(scenario)
    recordings = run_sweeps(scenario.model_copy(update={"joint": model, "load": load}), sweeps, folder)
    prior = with_fits(scenario, prior or JointPrior())
    return deviations(calibrate_joint(build_joint(model), load.build(), recordings, prior), recordings)


def deviations(found: JointCalibration, recordings: list[JointRecording]) -> tuple[float, float]:
    """Root mean square standard deviation of the stiffness [N*m/rad] along recordings, before and after."""
    angle = np.concatenate([one.angle[::100] for one in recordings])
    pressures = np.concatenate([one.pressures[::100] for one in recordings])
    before, after = (
        float(np.sqrt(np.mean(stiffness(angle, (pressures[:, 0], pressures[:, 1]))[1] ** 2)))
        for stiffness in (found.prior_stiffness, found.stiffness)
    )
    return before, after


SHOWN = {"m": "mm", "rad": "deg", "s": "ms", "Pa/s": "bar/s"}
SHOWN |= {unit: unit for unit in ("1", "N", "N/m", "kg", "kg*m^2", "N*m", "N*m*s/rad")}
"""Units of quantities in reports, by those of SI."""


def statements(found: JointCalibration, *, weighted: bool) -> list[str]:
    """Return one sentence for each quantity that is not determined; on the weight only where there was one."""
    names = {"added_mass": "the weight", "zero": "the encoder's zero", "arm_scale": "the scale of the moment arms"}
    apart = ("friction.torque", "muscle1.friction", "muscle2.friction")
    together = "friction.total" in found.quantities and found.quantities["friction.total"].determined
    said = [
        f"{name} cannot be told apart from the other friction; friction.total is determined"
        for name in apart
        if together and name in found.quantities and not found.quantities[name].determined
    ]
    return said + [
        f"not determined: {names.get(name, name)}, {show(one.value, SHOWN[one.unit], 4)} with a standard deviation of "
        f"{show(one.deviation, SHOWN[one.unit], 2)} ({show(one.prior, SHOWN[one.unit], 2)} before)"
        for name, one in found.quantities.items()
        if not one.determined and (weighted or name != "added_mass")
    ]


def write_model(scenario: Scenario, found: JointCalibration, path: str | os.PathLike[str]) -> None:
    """Write the section of the controller's model with the estimates, for ``model: FILE`` of a controller."""
    spec, folder = calibrated_model(scenario, found), Path(path).parent
    data = spec.model_dump(mode="json", by_alias=True, exclude_none=True, context={"folder": folder})
    with atomic_write(path, overwrite=True) as part:
        part.write_text(_HEAD + to_text(data), encoding="utf-8")
