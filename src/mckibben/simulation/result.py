"""The result of a simulated run of a joint: its columns, metrics and outcome."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import jax
import numpy as np
from jaxtyping import Array, ArrayLike

from mckibben.codegen.native import NativeFunction
from mckibben.component.columns import Label, attributes, declare
from mckibben.errors import FileError, Problem
from mckibben.joint.antagonistic import SMALL_MOTION, AntagonisticJoint, MuscleStates
from mckibben.joint.geometry import Pressures
from mckibben.muscle import Domain
from mckibben.notebook import draw
from mckibben.numerics.compiled import jit, numeric
from mckibben.simulation.accuracy import Resolution
from mckibben.simulation.engine import BatchFunction, compute_with
from mckibben.simulation.metrics import (
    Metrics,
    Trajectory,
    first_of_end,
    last_change,
    measure_since,
    trajectory,
)
from mckibben.simulation.outcome import OUTCOMES, Outcome, outcomes
from mckibben.simulation.table import RunResult
from mckibben.units import bar, deg, percent

if TYPE_CHECKING:
    from mckibben.control.base import Setpoint
    from mckibben.plant import JointPlant
    from mckibben.simulation.loop import Record

BAND: tuple[str, str] = ("lowest_stiffness", "highest_stiffness")
"""Columns of the attainable stiffness."""

declare(
    __name__,
    {
        "lowest_stiffness": Label("N*m/rad", "lowest attainable stiffness at the desired angle"),
        "highest_stiffness": Label("N*m/rad", "highest attainable stiffness at the desired angle"),
        "friction_torque": Label("N*m", "torque of the muscles' friction"),
        "joint_friction_torque": Label("N*m", "torque of the joint's own friction"),
        "small_motion_stiffness": Label("N*m/rad", "stiffness of motion by 0.1 deg, with the muscles' friction"),
        "creep_torque": Label("N*m", "torque of the muscles' creep"),
    },
)


def _trajectory_at(shared: tuple[JointPlant, ArrayLike | None], lane: tuple[Setpoint, Record, Array]) -> Trajectory:
    """Trajectory at one control period."""
    return trajectory(shared[0], *lane, shared[1])


_trajectories = BatchFunction(_trajectory_at)


def compute_trajectory(
    plant: JointPlant,
    setpoints: Setpoint,
    record: Record,
    angle_without_step: ArrayLike,
    stiffness_amplitude: ArrayLike | None = None,
    *,
    engine: str = "auto",
) -> Trajectory:
    """`metrics.trajectory` of all control periods, as arrays of NumPy."""
    shared = numeric((plant, stiffness_amplitude))
    lanes = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), (setpoints, record, angle_without_step))
    found, _ = _trajectories(engine, shared, lanes)
    return jax.tree.map(np.asarray, found)


_friction_torque = jit(AntagonisticJoint.friction_torque)
_creep_torque = jit(AntagonisticJoint.creep_torque)


@jit
def _small_motion_stiffness(joint: AntagonisticJoint, angle: ArrayLike, pressures: Pressures) -> Array:
    return joint.secant_stiffness(angle, pressures, SMALL_MOTION)


def joint_columns(
    joint: AntagonisticJoint, angle: Array, velocity: Array, pressures: Pressures, muscles: MuscleStates
) -> list[tuple[tuple[str, ...], Callable[[], dict[str, Any]]]]:
    """Columns of friction and creep, by name, each computed when it is first asked for."""
    forces = {
        "friction_torque": lambda: _friction_torque(joint, angle, velocity, pressures, muscles),
        "creep_torque": lambda: _creep_torque(joint, angle, pressures, muscles),
        "small_motion_stiffness": lambda: _small_motion_stiffness(joint, angle, pressures),
    }
    return [((name,), lambda name=name, one=one: {name: one()}) for name, one in forces.items()]


def domains_of(plant: JointPlant) -> tuple[Domain, ...]:
    """Domains of both muscles, as numbers."""
    return tuple(jax.tree.map(float, muscle.domain) for muscle in plant.muscles)


def compute_metrics(moved: Trajectory, period: float, angle_resolution: float = 0.0) -> Metrics:
    """Metrics of a trajectory with a control period [s], and a step of the sensor of the angle [rad]."""
    change = last_change(moved.desired_stiffness, np)
    at_change = np.asarray(moved.stiffness)[change.at]
    parts = jax.tree.map(np.asarray, (moved, change, at_change, period, angle_resolution))
    return compute_with("auto", lambda: _native_metrics(parts), lambda: _metrics_by_xla(*parts))[0]


@NativeFunction
def _native_metrics(parts: Any, _: None) -> Metrics:
    return measure_since(*parts)


_metrics_by_xla = jit(measure_since)


class Result(RunResult):
    """A simulated run; ``result["angle"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), SI: the fields of `Trajectory`, the attainable stiffness (``lowest_stiffness``,
    ``highest_stiffness``), and the controller's telemetry. `control_period` is the time between two values [s],
    `scenario` the text of the scenario, or empty, `engine` the one that computed it, "native" or "xla", or empty,
    `resolution` the integration steps per control period with the estimated error of the angle, None if unknown,
    `angle_resolution` the step of the sensor of the angle [rad], 0 for none, and `domains` those of the two muscles,
    empty if unknown.
    """

    kind = Metrics

    def __init__(
        self,
        columns: Mapping[str, Any],
        control_period: float,
        outcome: Outcome | None = None,
        scenario: str = "",
        engine: str = "",
        resolution: Resolution | None = None,
        angle_resolution: float = 0.0,
        domains: tuple[Domain, ...] = (),
    ) -> None:
        super().__init__(columns, control_period, scenario, engine, resolution)
        self.angle_resolution = angle_resolution
        self.domains = domains
        if outcome is not None:
            self.outcome = outcome

    @classmethod
    def of(
        cls,
        moved: Trajectory,
        control_period: float,
        *,
        band: tuple[np.ndarray, np.ndarray],
        telemetry: Mapping[str, Any],
        scenario: str = "",
        angle_resolution: float = 0.0,
    ) -> Self:
        """From a trajectory, the attainable stiffness and the controller's telemetry, each of shape (periods,)."""
        known = moved._asdict() | dict(zip(BAND, band, strict=True))
        columns = {name: np.asarray(value) for name, value in (known | dict(telemetry) | known).items()}
        return cls(columns, control_period, scenario=scenario, angle_resolution=angle_resolution)

    @functools.cached_property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return _outcome(self.columns, lambda: self.metrics["oscillation_amplitude"] > 0)

    def _measure(self) -> Metrics:
        moved = Trajectory(*(self[name] for name in Trajectory._fields))  # type: ignore[arg-type]
        return compute_metrics(moved, self.control_period, self.angle_resolution)

    @property
    def poor_tracking(self) -> str:
        """Remark on an angle that follows its reference worse than a joint at rest; empty if it does not, or failed."""
        desired = self["desired_angle"]
        if not self.outcome.usable or np.ptp(desired) < 1e-9:
            return ""
        error, resting = (np.sqrt(np.mean((one - desired) ** 2)) / deg for one in (self["angle"], self["angle"][0]))
        if error <= resting:
            return ""
        return (
            f"the angle follows the reference worse than a joint at rest (RMSE {error:.3g} instead of {resting:.3g} "
            "deg): check by `mckibben envelope` whether the motion is too fast for the joint, or tune the controller"
        )

    def __repr__(self) -> str:
        errors = [
            f"{axis} RMSE {float(np.sqrt(np.mean((self[axis] - self['desired_' + axis]) ** 2))) / size:.3g} {unit}"
            for axis, size, unit in (("angle", deg, "deg"), ("stiffness", 1.0, "N*m/rad"))
        ]
        remark = "; the angle follows the reference worse than a joint at rest" if self.poor_tracking else ""
        return f"<Result: {self.duration:g} s, {self.outcome.name.lower()}, {', '.join(errors)}{remark}>"

    def plot(self, name: str = "run") -> Any:
        """Return time traces of the run, see `mckibben.report.tracking`."""
        return draw("tracking", {name: self})

    def describe(self) -> str:
        """The outcome as a sentence, with the time saturated, slack or outside the domain, and `poor_tracking`."""
        columns, sentence, times = self.columns, self.outcome.value, self.times
        if self.outcome is Outcome.DIVERGED:
            # Pressures within limits cannot drive the true motion to infinity.
            last = max(np.flatnonzero(np.isfinite(columns["angle"])), default=0)
            commanded = np.isfinite(columns["command1"][last]) and np.isfinite(columns["command2"][last])
            cause = "too few substeps for this plant" if commanded else "commands of the controller that are not finite"
            return f"{sentence} after {times[last]:.4g} s; likely cause: {cause}"
        if self.outcome is Outcome.LIMIT_CYCLE:
            amplitude, period = self.metrics["oscillation_amplitude"] / deg, self.metrics["oscillation_period"]
            sentence = f"{sentence}, with an amplitude of {amplitude:.3g} deg and a period of {period:.3g} s"
        peak = max(columns["force1"].max(), columns["force2"].max())
        spans = [
            f"{what} for {mask.sum() * self.control_period:.4g} s, first at {times[mask.argmax()]:.4g} s"
            for what, mask in (
                (self._outside(), columns["outside_domain"]),
                (f"above the rated force (up to {peak:.4g} N)", columns["overloaded"]),
                ("saturated", columns["saturated"]),
                ("slack", columns["slack"]),
            )
            if mask.any()
        ]
        sentence += f" ({'; '.join(spans)})" if spans else ""
        return f"{sentence}; {self.poor_tracking}" if self.poor_tracking else sentence

    def _outside(self) -> str:
        """Quantities that left the domain, by how much, and the domain."""
        furthest, pressures = float(self["excursion"].max()), (self["pressure1"], self["pressure2"])
        parts = [f"contraction by up to {furthest / percent:.3g} %"] if furthest > 0 else []
        limits = [(float(one.pressure_min), float(one.pressure_max)) for one in self.domains]
        beyond = [
            max(low - float(p.min()), float(p.max()) - high) for p, (low, high) in zip(pressures, limits, strict=False)
        ]
        if max(beyond, default=0.0) > 1e-3:
            parts.append(f"pressure by up to {max(beyond) / bar:.3g} bar")
        elif not parts:
            parts.append(f"pressure {np.min(pressures) / bar:.3g}..{np.max(pressures) / bar:.3g} bar")
        known = " or ".join(dict.fromkeys(one.bounds() for one in self.domains))
        return f"outside the domain ({' and '.join(parts)}{f' outside {known}' if known else ''})"

    def _attributes(self) -> dict[str, Any]:
        found = {"outcome": self.outcome.name, "angle_resolution": self.angle_resolution}
        domains = [float(bound) for one in self.domains for bound in vars(one).values()]
        return super()._attributes() | found | ({"domains": np.array(domains)} if domains else {})

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write to a NetCDF file, atomically and with a checksum."""
        from mckibben.dataset.netcdf import write_variables

        columns = {name: (("time",), self[name], attributes(name)) for name in self.columns}
        time = ("time",), self.times, {"units": "s", "long_name": "time"}
        write_variables({**columns, "time": time}, self._attributes(), Path(path))

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file of `to_netcdf`; `FileError` if it is missing, is not NetCDF, damaged, or lacks a column."""
        from mckibben.dataset.schema import load_netcdf

        source = str(path)
        if not Path(path).is_file():
            raise FileError(source, [Problem("there is no such file")])
        table = load_netcdf(Path(path))
        columns = (*Trajectory._fields, *BAND)
        missing = [name for name in columns if name not in table]
        if missing:
            raise FileError(source, [Problem(f"it is not a simulation result: it lacks {', '.join(missing)}")])
        problems = [
            Problem("it is not a numeric column over time", field=name)
            for name in columns
            if table[name].dims != ("time",) or table[name].dtype.kind not in "fb"
        ]
        outcome = table.attrs.pop("outcome", None)
        period: Any = table.attrs.get("control_period")
        if outcome not in Outcome.__members__:
            problems.append(Problem(f"{outcome!r} is not an outcome", field="outcome"))
        if not isinstance(period, float | np.floating) or not period > 0:
            problems.append(Problem(f"{period!r} is not a positive time", field="control_period"))
        if problems:
            raise FileError(source, problems)
        values = {str(name): variable.to_numpy() for name, variable in table.data_vars.items()}
        scenario, engine = (str(table.attrs.get(name, "")) for name in ("scenario", "engine"))
        resolution = Resolution.of(table.attrs)
        angle_resolution = float(table.attrs.get("angle_resolution", 0.0))  # files of earlier versions have none
        bounds = np.reshape(table.attrs.get("domains", ()), (-1, 4)).tolist()
        domains = tuple(Domain(*each) for each in bounds)
        return cls(values, float(period), Outcome[outcome], scenario, engine, resolution, angle_resolution, domains)


def _outcome(columns: Mapping[str, np.ndarray], oscillates: Callable[[], bool]) -> Outcome:
    ended = np.isfinite(columns["velocity"][-1])
    error = columns["angle"] - columns["desired_angle"]
    code = outcomes(
        angle_max=np.abs(error).max() if ended else np.inf,
        angle_at_end=np.sqrt(np.mean(error[first_of_end(error.size) :] ** 2)),
        span=np.ptp(columns["desired_angle"]),
        left_domain=columns["outside_domain"].any() or columns["overloaded"].any(),
        saturated=columns["saturated"].any(),
        oscillates=ended and oscillates(),
    )
    return OUTCOMES[int(code)]
