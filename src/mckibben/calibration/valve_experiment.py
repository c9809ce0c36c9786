"""Experiment for the identification of valves: steps and a multisine of the commanded pressures."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mckibben.actuator import Actuator
from mckibben.calibration.experiment import load_of, model_of, part_of, recording_of, write_estimates
from mckibben.calibration.loop import PLANTS, loop_margins, with_estimates
from mckibben.calibration.recordings import Floats, JointPrior, JointRecording
from mckibben.calibration.valves import ValveCalibration, calibrate_valves
from mckibben.component.schema import write_text
from mckibben.control import Multisine, OpenLoopControl, RandomSteps, Reference, Sum
from mckibben.control.base import field_of
from mckibben.errors import McKibbenWarning, ParameterError
from mckibben.joint import AntagonisticJoint
from mckibben.plant import JointPlant
from mckibben.rig.bench import JointLimits
from mckibben.scenario import Scenario
from mckibben.simulation import SimulationResult, simulate
from mckibben.units import bar, deg

_HEAD = """\
# Valves calibrated by `mckibben calibrate --valves`: `valve: valve.yaml`.
"""


@dataclass(frozen=True)
class ValveExperiment:
    """Steps of both commands, then a multisine, each for half of a duration [s].

    By the model the joint stays between angles [rad], also if one muscle is stronger and the other weaker by the
    standard deviation `strength`; and the pressures stay within half of the deviation [Pa] from their commands at which
    a joint rig stops (`JointLimits`).
    """

    lowest: float
    highest: float
    duration: float
    pressure_error: float = JointLimits.pressure_error
    following: float = JointLimits.following
    strength: float = 0.1

    def scenarios(self, scenario: Scenario) -> dict[str, Scenario]:
        """Scenario of each part by its name.

        The commands lie between those of the lowest and the highest stiffness in the middle of the angles, or with a
        return spring, between those of both angles. The range is narrowed until the model stays within all limits.
        Raises `ParameterError` if it does not, after ten steps of 0.8, and warns where less than half of the range is
        left.
        """
        model, middle = model_of(scenario), (self.lowest + self.highest) / 2
        plant = scenario.model_copy(update={"joint": model, "load": load_of(scenario)}).plant()
        ends, rest = self._ends(plant, middle), plant.equilibrium(middle)
        signals = Reference(middle, float(plant.stiffness(middle, rest.pressures)))
        centre, reason, duration = ends.mean(axis=0), "", self._half(scenario)
        for share in 0.8 ** np.arange(10):
            changes: dict[str, Any] = {"signals": signals, "duration": duration}
            parts = {
                name: part_of(
                    scenario,
                    f"calibration of the valves, {name}",
                    middle,
                    controller=OpenLoopControl(*pair, model),
                    **changes,
                )
                for name, pair in _commands(centre + share * (ends - centre)).items()
            }
            violations = (self._violation(part, joint) for joint in self._joints(model) for part in parts.values())
            if violation := next(filter(None, violations), ""):
                reason = violation
                continue
            if share < 0.5:
                text = f"the commands have {share:.0%} of the attainable range, as otherwise {reason}: wider --angles "
                text += "or a smaller `strength` in --prior may determine more quantities of the valves"
                warnings.warn(text, McKibbenWarning, stacklevel=2)
            return parts
        raise ParameterError(
            f"even commands of {share:.0%} of the range are too wide: {reason}",
            remedy="give wider --angles, a smaller `strength` in --prior, or a valve closer to the real one",
        )

    @property
    def instructions(self) -> dict[str, str]:
        """What a person has to confirm before each part on a physical rig."""
        return dict.fromkeys(("steps", "multisine"), "the joint moves freely with no weight on the limb")

    def parts(self, scenario: Scenario, _: Mapping[str, SimulationResult]) -> Iterator[tuple[str, Scenario]]:
        """Yield name and scenario of each part."""
        yield from self.scenarios(scenario).items()

    def recordings(self, results: Mapping[str, SimulationResult]) -> list[JointRecording]:
        """Recordings of the parts."""
        return [recording_of(result) for result in results.values()]

    def _half(self, scenario: Scenario) -> float:
        return round(self.duration / 2 / scenario.control_period) * scenario.control_period

    def _ends(self, plant: JointPlant, middle: float) -> Floats:
        """Lowest and highest pressures [Pa] of both muscles, shape (2, 2)."""
        if any(plant.joint.springs):
            states = [plant.equilibrium(angle) for angle in (self.lowest, self.highest)]
        else:
            torque = -plant.load.gravity_torque(middle)
            low, high = (float(bound) for bound in plant.supplied_joint.attainable_stiffness(middle, torque))
            inside = 0.05 * (high - low)
            states = [plant.equilibrium(middle, stiffness=stiffness) for stiffness in (low + inside, high - inside)]
        return np.array([[float(pressure) for pressure in state.pressures] for state in states])

    def _joints(self, model: AntagonisticJoint) -> list[AntagonisticJoint]:
        """The model, and those in which one muscle is stronger and the other weaker."""
        joints = []
        for error in (0.0, self.strength, -self.strength):
            first, second = (
                dataclasses.replace(muscle, strength=(muscle.strength or 1.0) * (1 + sign * error))
                for muscle, sign in ((model.muscle1, 1), (model.muscle2, -1))
            )
            joints.append(dataclasses.replace(model, muscle1=first, muscle2=second))
        return joints

    def _violation(self, part: Scenario, model: AntagonisticJoint) -> str:
        """Violated limit of a simulated run, as text; empty if there is none."""
        from scipy.signal import lfilter  # 1 s

        plant = part.model_copy(update={"joint": model, "load": load_of(part)}).plant()
        ran = simulate(plant, part.control(), part.reference(), initial=part.initial(plant), **part.timing)
        angle, share = ran["angle"], min(1.0, part.control_period / self.following)
        errors = (ran[f"pressure{i}"] - ran[f"command{i}"] for i in (1, 2))
        late = max(float(np.abs(lfilter([share], [1, share - 1], error)).max()) for error in errors)
        lowest, highest = angle.min() / deg, angle.max() / deg
        if not self.lowest <= angle.min() <= angle.max() <= self.highest:  # not a number where the run diverges
            return f"the joint of the model, or one with unequal muscles, moves from {lowest:.1f} to {highest:.1f} deg"
        if not late <= self.pressure_error / 2:
            return f"the pressures are up to {late / bar:.2g} bar from their commands, as the valves are too slow"
        return ""


def _commands(
    ends: Floats,
    *,
    frequencies: tuple[float, ...] = (0.1, 0.23, 0.47, 0.97, 1.9, 3.7, 7.3),
    difference: float = 0.1,
    pitches: tuple[float, ...] = (0.17, 0.41),
) -> dict[str, tuple[Any, Any]]:
    """Commands [Pa] of both muscles in both parts, between their ends.

    Steps last 0.4 to 2.5 s. The sines of the multisine have `frequencies` [Hz], and common amplitudes; those with the
    `pitches` [Hz] move the joint: they have opposite signs, and a `difference` relative to the range as amplitude.
    """
    count = len(frequencies)
    phases = tuple(math.pi * k * k / count % (2 * math.pi) for k in range(count))  # M. Schroeder, 1970: a low crest
    steps, waves = [], []
    for sign, (low, high) in zip((1.0, -1.0), ends.T.tolist(), strict=True):
        span = high - low
        steps.append(RandomSteps(low, high, 0.4, longest_dwell=2.5))
        common = Multisine((span / 2 / math.sqrt(2 * count),) * count, frequencies, phases, (low + high) / 2)
        waves.append(Sum((common, Multisine((sign * difference * span,) * len(pitches), pitches))))
    return {"steps": (steps[0], steps[1]), "multisine": (waves[0], waves[1])}


def calibrate_scenario_valves(
    scenario: Scenario, recordings: list[JointRecording], prior: JointPrior | None = None
) -> ValveCalibration:
    """Identify the valves of a scenario from recordings of commanded and measured pressures."""
    delay = field_of(scenario.control(), "command_delay") or scenario.command_delay
    valve = field_of(scenario.control(), "valve") or scenario.valve
    fit = calibrate_valves(model_of(scenario), valve, recordings, prior, delay=delay)
    after = scenario_with_valves(scenario, fit)
    valve_text = partial(write_text, fit.valve, base=Actuator)
    writers = {
        "valve.yaml": partial(write_estimates, valve_text, scenario, _HEAD),
        "scenario.yaml": partial(write_estimates, after.dumps, scenario, ""),
    }
    margins = loop_margins(after, **fit.drawn(PLANTS))
    return dataclasses.replace(fit, disk_margins=margins).with_files(writers)


def scenario_with_valves(scenario: Scenario, fit: ValveCalibration) -> Scenario:
    """Return the scenario with the estimates as its plant's valve and delay, and as its controller's model of them."""
    return with_estimates(scenario, fit.deviations(), valve=fit.valve, command_delay=fit.delay)
