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
from mckibben.mechanism.robot import Robot
from mckibben.numerics.calculus import evenly_spaced
from mckibben.result import Column, Remark, TableColumns
from mckibben.scenario.robot import RobotScenario
from mckibben.scenario.scenario import errors_of
from mckibben.simulation.problem import check_frequencies, sampled
from mckibben.simulation.robot_metrics import TrackingMetrics, TrackingSample, inflow
from mckibben.simulation.robots import RobotResult, simulate_robot
from mckibben.statics.reference import POSTURES, check_postures
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
        times, some = parts[0][0], evenly_spaced(parts[0][0].size, POSTURES)
        rows = (values[:, some].T for values in desired.values())
        found = check_postures(scenario.robot, times[some], *rows, supply=scenario.supply)
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
