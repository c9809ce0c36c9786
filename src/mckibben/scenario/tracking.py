"""Runs of a robot whose joints follow references of angle and stiffness."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Array, PyTree

from mckibben.codegen.engine import compiled
from mckibben.component.checks import check_positive
from mckibben.errors import McKibbenError
from mckibben.mechanism.robot import Robot
from mckibben.result import Column, Remark, TableColumns
from mckibben.scenario.robot import RobotScenario
from mckibben.scenario.scenario import errors_of
from mckibben.simulation.problem import check_frequencies, sampled
from mckibben.simulation.robot_metrics import TrackingMetrics, TrackingSample, inflow
from mckibben.simulation.robots import RobotResult, simulate_robot
from mckibben.statics.attainable import attainable_statics
from mckibben.statics.posture import EXACT, Floats, holding_torques, is_affine
from mckibben.statics.pressures import pressures_for_joint_stiffness
from mckibben.units import deg


class TrackingResult(RobotResult):
    """A controlled run of a robot: columns of `RobotResult`, references, and stiffness of the joints.

    Attributes
    ----------
    notes
        What is not attainable, computed before the run.
    """

    kind = TrackingMetrics
    figures: ClassVar = ("robot_tracking",)
    files: ClassVar = ("result.nc", "scenario.yaml")

    notes: tuple[Remark, ...] = ()

    def _measure(self) -> TrackingMetrics:
        angle, stiffness = (tuple(self[name] - self[f"desired_{name}"]) for name in ("angle", "stiffness"))
        air: PyTree = self["air_mass"]
        drawn = inflow(air, tuple(np.concatenate([air[:, :1], air[:, :-1]], axis=1)))
        rest: PyTree = self["saturated"], self["outside"], drawn
        return TrackingMetrics.of(TrackingSample(angle, stiffness, *rest), self.control_period)

    def verdict(self) -> str:
        """Return duration, size of the robot, and the errors of the worst joints."""
        angle, stiffness = self.metrics["angle_rmse"] / deg, self.metrics["stiffness_rmse"]
        return (
            f"{self.size}; RMS errors up to {angle.max():.3g} deg ({self.joints[angle.argmax()]}) and "
            f"{stiffness.max():.3g} N*m/rad ({self.joints[stiffness.argmax()]})"
        )

    def declared(self) -> TableColumns:
        """Return the joints, and the metrics."""
        return {"joint": (Column(), list(self.joints))} | super().declared()

    def remarks(self) -> Iterator[Remark]:
        """Return what is not attainable, muscles outside their domain, and the integration error."""
        yield from self.notes
        if left := self.metrics["time_outside_domain"]:
            yield Remark.warning("domain", f"a muscle is outside its domain for {left:.4g} s")
        yield from super().remarks()

    def write(self, folder: Path) -> None:
        """Write the columns as NetCDF, and the scenario."""
        self.to_netcdf(folder / "result.nc")
        RobotScenario.parse(self.scenario).to_yaml(folder / "scenario.yaml")


def run_tracking(scenario: RobotScenario, *, source: str = "") -> TrackingResult:
    """Simulate a robot under the controller of its scenario; `source` is its file, for errors.

    Raises `ScenarioError` if the scenario has no controller, or its parts do not fit together.
    """
    period = scenario.control_period
    with errors_of(scenario, source):
        duration = scenario.run_duration
        references = scenario.references()
        for name, reference in references.items():
            check_frequencies(reference, period, f"reference.{name}")
        parts = [sampled(references[joint.name], duration, period) for joint in scenario.robot.joints]
        desired = {
            "desired_angle": np.stack([np.asarray(setpoints.angle) for _, setpoints in parts]),
            "desired_stiffness": np.stack([np.asarray(setpoints.stiffness) for _, setpoints in parts]),
        }
        check_positive("reference", "N*m/rad", stiffness=desired["desired_stiffness"])
        found = _unattainable(scenario, parts[0][0], desired["desired_angle"], desired["desired_stiffness"])
        notes = (*scenario.reference_notes, *found)
        start, plant = scenario.initial(), scenario.plant()
        run = simulate_robot(plant, scenario.control(), start, **scenario.timing)
    lanes = tuple(run["angle"]), tuple(run["pressure"])
    stiffness = joint_stiffness(scenario.robot, lanes)
    columns = dict(run.columns) | desired | {"stiffness": np.stack(stiffness)}
    given = {field.name: getattr(run, field.name) for field in dataclasses.fields(run)}  # type: ignore[arg-type]
    return TrackingResult(**given | {"columns": columns, "scenario": scenario.dumps(), "notes": notes})


@compiled
def joint_stiffness(robot: Robot, lane: tuple[tuple[Array, ...], tuple[Array, ...]]) -> tuple[Array, ...]:
    """Return the stiffness [N*m/rad] of the joints at angles [rad] and pressures [Pa], many along the last axis."""
    return robot.stiffness(*lane)


def _unattainable(
    scenario: RobotScenario, times: Floats, angles: Floats, stiffness: Floats, postures: int = 25
) -> Iterator[Remark]:
    """Remarks on postures that the muscles cannot hold, and on stiffness that they do not attain there, at rest."""
    robot, supply = scenario.robot, scenario.supply
    if not is_affine(robot):
        yield Remark.note("reference", "not checked: a law is not affine in pressure, or a tendon not rigid")
        return
    worst: dict[str, tuple[float, Remark]] = {}
    for index in np.unique(np.linspace(0, times.size - 1, postures).astype(int)):
        posture, wanted, at = angles[:, index].tolist(), stiffness[:, index].tolist(), f"at {times[index]:.3g} s"
        try:
            torques = holding_torques(robot, posture)
            found = pressures_for_joint_stiffness(robot, posture, wanted, torques=torques, supply=supply)
            if found.exact:
                continue
            ranges = attainable_statics(robot, posture, torques=torques, supply=supply)
        except McKibbenError as error:
            yield Remark.warning("reference", f"{at}: {error.message}", error.remedy)
            return
        own = {joint.name: value for joint, value in zip(robot.joints, wanted, strict=True) if joint.name in ranges}
        for name, value in own.items():
            (low, high), limits = ranges[name].stiffness, ranges[name].limits
            if (excess := max(low - value, value - high)) > max(EXACT * value, worst.get(name, (0.0,))[0]):
                text = f"{name}: {value:.3g} N*m/rad is outside of {low:.3g}..{high:.3g} N*m/rad that it attains {at}"
                by = limits[2 if value < low else 3]
                worst[name] = excess, Remark.warning("reference", f"{text} ({by})", "choose a stiffness between")
        if not worst:
            text = f"{at} the joints do not attain their stiffness together: relative error {found.error:.2g}"
            worst["all"] = found.error, Remark.warning("reference", text, "the nearest is given")
    yield from (remark for _, remark in worst.values())
