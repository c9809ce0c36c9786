"""Result of a simulated run: its columns over time, metrics and outcome."""

from __future__ import annotations

import functools
import importlib.util
import io
import os
from collections import UserDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction, compiled
from mckibben.codegen.native import over_periods
from mckibben.component.columns import Label, attributes, declare, labels_of
from mckibben.config.model import DocumentModel
from mckibben.errors import FileError, Problem, SimulationError, no_attribute, suggest
from mckibben.joint.antagonistic import AntagonisticJoint
from mckibben.joint.geometry import Pressures
from mckibben.mechanism.base import angles_of, over_joints
from mckibben.muscle import Domain
from mckibben.numerics.compiled import numeric
from mckibben.result import Column, Remark, Result, Severity, TableColumns, table
from mckibben.simulation.accuracy import Resolution
from mckibben.simulation.feasibility import Feasibility
from mckibben.simulation.metrics import OF_STIFFNESS_SETPOINT, Metrics, first_of_end, last_change, measure
from mckibben.simulation.outcome import OUTCOMES, Demand, Outcome, outcomes
from mckibben.simulation.robot_metrics import BODY, RobotMetrics, body_columns
from mckibben.simulation.trajectories import (
    LABELS,
    REFERENCES,
    Trajectory,
    column_names,
    column_of,
    trajectory,
    trajectory_of,
)
from mckibben.storage.files import atomic_write
from mckibben.storage.mcap import write_samples
from mckibben.units import HINGE, JOINT_TYPES, JointType, bar, deg, percent

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.plant import Plant, PlantState
    from mckibben.simulation.trajectories import Record

_FIVE = "angle_rmse", "angle_max", "stiffness_rmse", "command_travel", "air"
_REMEDIES = {
    Outcome.NOT_FOLLOWED: "`mckibben envelope` shows what the joint can follow; else tune the controller or calibrate",
    Outcome.CHATTER: "lower the bandwidth of observers or the gains, or tune the controller with the sensors' noise",
    Outcome.LATE: "free the computer of other work, or choose a longer control period",
}
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


class Columns(UserDict[str, Any]):
    """Arrays by name; a function in place of one is called with its name when the array is first asked for.

    A tuple has a value for each joint or muscle.
    """

    def __getitem__(self, key: str) -> np.ndarray:
        value = self.data[key]
        if not isinstance(value, np.ndarray):
            value = self.data[key] = np.asarray(value(key) if callable(value) else value)
        return value

    def __reduce__(self) -> tuple[type, tuple[dict[str, np.ndarray]]]:
        return dict, (dict(self),)


class Measured(dict[str, Any]):
    """Metrics by name; the error of an unknown one has a suggestion."""

    def __missing__(self, name: str) -> NoReturn:
        raise unknown_column(name, self)


def unknown_column(name: str, known: Iterable[object]) -> SimulationError:
    """Return the error of a metric or column that is none of the known ones, with the closest one."""
    remedy = suggest(str(name), list(map(str, known)))
    return SimulationError(f"the result has no {name!r}", value=name, remedy=remedy)


def metric_columns(kind: type, metrics: Mapping[str, Any], *axes: str) -> dict[str, tuple[Column, Any]]:
    """Columns of metrics along some axes [SI], by name; `kind` is the class that declares them."""
    labels = {name: label for name, label in labels_of(kind).items() if name in metrics and label.along in axes}
    return {name: (label, metrics[name]) for name, label in labels.items()}


class SimulationResult(Result):
    """A simulated run; ``result["angle"]`` is a column as an array, ``result["time"]`` its times.

    Columns are in SI: the quantities of `Trajectory`, of a joint the attainable stiffness (``lowest_stiffness``,
    ``highest_stiffness``), of a robot those of `BodySample`, and the controller's telemetry. Of an unnamed joint they
    have shape (periods,), and ``result["pressure"]`` is ``pressure1`` and ``pressure2``, shape (2, periods); those of
    named joints and muscles have shape (joints, periods) and (muscles, periods).

    Attributes
    ----------
    columns
        Arrays by name.
    control_period
        Time between two values [s].
    source
        The scenario, its text, or empty.
    engine
        Engine that computed the run, "native" or "xla", or empty.
    resolution
        Integration steps per control period with the estimated error of the positions; None if unknown.
    angle_resolution
        Step of the sensor of the angle [rad], 0 for none.
    domains
        Function of the domains of the two muscles, as boxes if read from a file; of none if unknown.
    known_outcome
        Outcome of a stored run; None to derive it from the columns.
    feasibility
        Static feasibility of the reference; None if unknown.
    notes
        Function of the remarks on the plant, which take longer than a run.
    missed, deadlines
        Numbers of missed and of all deadlines of a measured run; 0 of others.
    joints, muscles
        Names of the joints and muscles of a robot.
    joint_type
        How the joints move: of a slide, columns of angles are in m, of torques in N, of stiffness in N/m.
    landing
        Function of the metrics of a run that follows no references; None for others.
    """

    figures: ClassVar = ("tracking",)
    files: ClassVar = ("result.nc", "result.mcap", "scenario.yaml")

    columns: Mapping[str, Any]
    control_period: float
    source: str | DocumentModel = ""
    engine: str = ""
    resolution: Resolution | None = None
    angle_resolution: float = 0.0
    domains: Callable[[], tuple[Domain, ...]] = tuple
    known_outcome: Outcome | None = None
    feasibility: Feasibility | None = None
    notes: Callable[[], list[Remark]] = list
    joints: tuple[str, ...] = ()
    muscles: tuple[str, ...] = ()
    joint_type: JointType = HINGE
    landing: Callable[[], RobotMetrics] | None = None
    missed: int = 0
    deadlines: int = 0

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
        known = {name: column_of(moved, name) for name in column_names(())} | dict(zip(BAND, band, strict=True))
        columns = {name: np.asarray(value) for name, value in (known | dict(telemetry) | known).items()}
        return cls(columns, control_period, scenario, angle_resolution=angle_resolution)

    @property
    def kind(self) -> type:
        """Class of the metrics: `Metrics` of a run that follows references, else `RobotMetrics`."""
        return Metrics if self.landing is None else RobotMetrics

    @functools.cached_property
    def metrics(self) -> dict[str, Any]:
        """The numbers of the class `kind` by name, in SI; an array where there is one for each joint."""
        values = self._measure()._asdict().items()
        return Measured({name: np.array(value) if isinstance(value, tuple) else float(value) for name, value in values})

    @functools.cached_property
    def scenario(self) -> str:
        """Text of the scenario, or empty."""
        return self.source if isinstance(self.source, str) else self.source.dumps()

    @property
    def times(self) -> NDArray[np.float64]:
        """Start of each control period [s], shape (periods,)."""
        return np.arange(np.shape(self.columns["angle"])[-1]) * self.control_period

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.times.size * self.control_period

    def declared(self) -> TableColumns:
        """The metrics, with their units, and the joints that they are of; five that are known and not 0 come first."""
        columns = metric_columns(self.kind, self.metrics, "joint", "")
        if self.landing:
            return columns
        joints: TableColumns = {"joint": (Column(), list(self.joints))} if self.joints else {}
        shown = {name for name in _FIVE if np.any(np.nan_to_num(self.metrics[name]))}
        columns = {name: (replace(mark, detail=name not in shown), value) for name, (mark, value) in columns.items()}
        columns = joints | columns
        alone = np.isnan(self["desired_stiffness"]).all()
        return {name: column for name, column in columns.items() if not alone or name not in OF_STIFFNESS_SETPOINT}

    @table("by muscle")
    def muscle_metrics(self) -> TableColumns:
        """The metrics that each muscle has."""
        columns = metric_columns(self.kind, self.metrics, "muscle")
        count = len(next(iter(columns.values()), (None, ()))[1])
        names = self.muscles or tuple(str(number + 1) for number in range(count))
        return {"muscle": (Column(), list(names))} | columns if columns else {}

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "time":
            return self.times
        if name in self.columns:
            return self.columns[name]
        names = column_names(())
        if not self.joints and f"{name}2" in names:
            return np.stack([self.columns[f"{name}{number}"] for number in (1, 2)])
        if self.joints and name in names and name[:-1] in self.columns:
            return self.columns[name[:-1]][int(name[-1]) - 1]
        raise unknown_column(name, self.columns)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getattr__(self, name: str) -> Any:
        columns = self.__dict__.get("columns", ())
        metrics = labels_of(Metrics)
        meant = {key: f'result.metrics["{key}"]' for key in metrics} | {key: f'result["{key}"]' for key in columns}
        if name not in meant and not name.startswith("_") and (metric := f"angle_{name}") in metrics:
            meant[name] = meant[metric]
        raise no_attribute(self, name, meant)

    def _ipython_key_completions_(self) -> list[str]:
        return ["time", *self.columns]

    def to_dataset(self) -> xr.Dataset:
        """Columns along ``time`` [s], with ``units`` and ``long_name``; period, scenario and engine as attributes."""
        import xarray as xr  # 0.15 s

        return xr.Dataset(self._variables(), attrs=self._attributes())

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write the dataset to a NetCDF file, atomically."""
        import h5netcdf  # importing xarray would take half as long as the whole simulation
        import h5py

        content = io.BytesIO()  # HDF5 crashes on a full disk
        with h5netcdf.File(content, "w") as file:
            file.attrs.update(self._attributes())
            for name, (dims, values, labels) in self._variables().items():
                values = np.asarray(values)
                if values.dtype == bool:  # as xarray writes and reads them
                    values, labels = values.astype(np.int8), labels | {"dtype": "bool"}
                dtype = h5py.string_dtype() if values.dtype.kind == "U" else values.dtype
                sizes = zip(dims, values.shape, strict=True)
                file.dimensions.update({dim: size for dim, size in sizes if dim not in file.dimensions})
                file.create_variable(name, dims, dtype, values.astype(dtype, copy=False)).attrs.update(labels)
        with atomic_write(path, overwrite=True) as sibling:
            sibling.write_bytes(content.getbuffer())

    def _variables(self) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
        """Dimensions, values and attributes of the coordinates and columns of the dataset."""
        variables: dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]
        variables = {name: ((name,), values, {}) for name, values in self._coordinates().items()}
        variables["time"] = ("time",), self.times, {"units": "s", "long_name": "time"}
        variables |= {
            name: ((*self._rows_of(name), "time"), self[name], attributes(name, self.joint_type))
            for name in self.columns
        }
        return variables

    def _rows_of(self, name: str) -> tuple[str, ...]:
        """Dimensions of a column other than time."""
        label = LABELS.get(name) or BODY.get(name)
        return (label.along if label else "joint",) if np.ndim(self.columns[name]) > 1 else ()

    def _coordinates(self) -> dict[str, list[str]]:
        """Names along these dimensions."""
        return {"joint": list(self.joints), "muscle": list(self.muscles)} if self.joints else {}

    @functools.cached_property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        if self.known_outcome is not None:
            return self.known_outcome
        if self.kind is not Metrics:
            worst = np.max([0.0 * self.metrics["peak_force"], 0.0 * self.metrics["peak_trunk_force"]])
            return OUTCOMES[int(outcomes(self.metrics | {"angle_max": worst}))]
        errors = (self["angle"] - self["desired_angle"])[..., first_of_end(self.times.size) :]
        at_end = np.sqrt(np.mean(errors**2, axis=-1))
        options: dict[str, Any] = {"missed": self.missed / max(self.deadlines, 1), "by_joint": bool(self.joints)}
        options |= {"angle_at_end": at_end, "scale": self.joint_type.scale}
        return OUTCOMES[int(outcomes(self.metrics, self.demand, **options))]

    @functools.cached_property
    def demand(self) -> Demand:
        """Demand of the reference on each joint and on the valves."""
        angle, stiffness = (np.moveaxis(self[name], -1, 0) for name in ("desired_angle", "desired_stiffness"))
        return Demand.of(angle, stiffness, self.duration, self.joint_type.scale)

    def _measure(self) -> Any:
        if self.landing is not None:
            return self.landing()
        moved = trajectory_of(self, self.joints)
        change = over_joints(lambda own: last_change(own, np), moved.desired_stiffness)
        rest = self.control_period, self.angle_resolution, change, self.joint_type.scale
        return _metrics((over_periods(moved), *jax.tree.map(np.asarray, rest)))

    @property
    def ok(self) -> bool:
        """Whether the reference is attainable, and the run follows it in time, within limits and without wear."""
        return self.outcome.ok and super().ok

    @functools.cached_property
    def unattained(self) -> list[Remark]:
        """Severe remarks on what the joints cannot hold of their reference at rest, as far as that is known."""
        remedy = "`mckibben envelope` shows what is attainable"
        reach = self.feasibility
        own = [] if reach is None or reach.feasible else [Remark.severe("reference", reach.verdict(), remedy)]
        return own + [note for note in self.notes() if (note.field, note.severity) == ("reference", Severity.SEVERE)]

    def _rows(self, name: str) -> NDArray[np.float64]:
        """Column with a row for each joint, also for an unnamed one."""
        return self[name].reshape(-1, self.times.size)

    @property
    def size(self) -> str:
        """Duration, and numbers of named joints and muscles, in words."""
        counts = ((len(self.joints), "joint"), (len(self.muscles), "muscle"))
        return ", ".join([f"{self.duration:g} s", *(f"{count} {noun}{'s' * (count != 1)}" for count, noun in counts)])

    def verdict(self) -> str:
        """The outcome with the time saturated, slack or outside the domain; of a robot its size and errors, too."""
        if self.landing is not None:
            return f"{self.size}, ground force up to {self['ground_up'].max():.4g} N"
        if not self.joints:
            return self._sentence()
        angle, stiffness = self.metrics["angle_rmse"] / deg, self.metrics["stiffness_rmse"]
        errors = (
            f"RMS errors up to {angle.max():.3g} deg ({self.joints[angle.argmax()]}) and "
            f"{stiffness.max():.3g} N*m/rad ({self.joints[stiffness.argmax()]})"
        )
        return f"{self.size}; {self._sentence()}; {errors}"

    def _sentence(self) -> str:
        """The outcome as a sentence, with the time saturated, slack or outside the domain."""
        sentence, times, shown = self.outcome.sentence(self.joint_type), self.times, self.joint_type.show
        if self.outcome is Outcome.DIVERGED:
            # Pressures within limits cannot drive the true motion to infinity.
            last = max(np.flatnonzero(np.isfinite(self._rows("angle")).all(axis=0)), default=0)
            commanded = np.isfinite(self["command"][:, last]).all()
            cause = "too few substeps for this plant" if commanded else "commands of the controller that are not finite"
            return f"{sentence} after {times[last]:.4g} s; likely cause: {cause}"
        if self.outcome is Outcome.LIMIT_CYCLE:
            amplitude = shown(np.max(self.metrics["oscillation_amplitude"]), "deg", 3)
            period = np.nanmax(self.metrics["oscillation_period"])
            sentence = f"{sentence}, with an amplitude of {amplitude} and a period of {period:.3g} s"
        if self.outcome is Outcome.CHATTER:
            travel = self.metrics["command_travel"] / bar
            needed = self.demand.travel_needed(by_joint=bool(self.joints)) / bar
            rate = self.metrics["command_reversals"]
            sentence = (
                f"{sentence}; one reverses {rate:.3g} times and travels {travel:.3g} bar per second, of which the "
                f"reference needs at most {needed:.3g} bar"
            )
        if self.missed:
            sentence = f"{sentence}; {self.missed} of {self.deadlines} deadlines missed"
        if self.outcome is Outcome.NOT_FOLLOWED:
            sentence = f"{sentence}: {self._not_followed()}"
        peak = self["force"].max()
        spans = [
            f"{what} for {mask.sum() * self.control_period:.4g} s, first at {times[mask.argmax()]:.4g} s"
            for what, mask in (
                (self._outside(), self["outside_domain"]),
                (f"above the rated force (up to {peak:.4g} N)", self["overloaded"]),
                ("saturated", self["saturated"]),
                ("slack", self["slack"]),
            )
            if mask.any()
        ]
        sentence = f"{sentence} ({'; '.join(spans)})" if spans else sentence
        return f"the reference is not attainable; {sentence}" if self.unattained else sentence

    def _not_followed(self) -> str:
        """Largest errors of angle and stiffness, of the joint that follows least, with the range of its reference."""
        texts = []
        kind = self.joint_type
        for name, unit, allowed in (
            ("angle", "deg", self.demand.angle),
            ("stiffness", "N*m/rad", self.demand.stiffness),
        ):
            rmse, largest = (np.atleast_1d(self.metrics[f"{name}_{which}"]) for which in ("rmse", "max"))
            if not np.any(rmse > allowed):
                continue
            worst = int(np.argmax(rmse / allowed))
            desired = self._rows(f"desired_{name}")[worst] + 0.0
            low, high = float(desired.min()), float(desired.max())
            asked = kind.show(low, unit, 3) if low == high else kind.span((low, high), unit, 3)
            joint = f"{self.joints[worst]}, " if self.joints else ""
            error = kind.show(largest[worst], unit, 3)
            texts.append(f"{joint}{kind.words(name)} error up to {error}, reference {asked}")
        return "; ".join(texts)

    def _outside(self) -> str:
        """Quantities that left the domain, by how much, and the domain."""
        furthest, pressures = float(self["excursion"].max()), self["pressure"]
        parts = [f"contraction by up to {furthest / percent:.3g} %"] if furthest > 0 else []
        limits = [(float(domain.pressure_min), float(domain.pressure_max)) for domain in self.domains()]
        beyond = [
            max(low - float(p.min()), float(p.max()) - high) for p, (low, high) in zip(pressures, limits, strict=False)
        ]
        if max(beyond, default=0.0) > 1e-3:
            parts.append(f"pressure by up to {max(beyond) / bar:.3g} bar")
        elif not parts:
            parts.append(f"pressure {np.min(pressures) / bar:.3g}..{np.max(pressures) / bar:.3g} bar")
        known = " or ".join(dict.fromkeys(domain.bounds() for domain in self.domains()))
        return f"outside the domain ({' and '.join(parts)}{f' outside {known}' if known else ''})"

    def remarks(self) -> Iterable[Remark]:
        """Infeasible reference, remedy and integration error; notes on the plant, its domains, and friction."""
        yield from self.unattained
        if self.outcome in _REMEDIES:
            yield Remark.warning("controller", _REMEDIES[self.outcome])
        if self.resolution:
            remark = Remark.note if self.resolution.resolved else Remark.warning
            yield remark("accuracy", self.resolution.describe(self.joint_type))
        yield from (note for note in self.notes() if note not in self.unattained)
        if self.joints and (left := self.metrics["time_outside_domain"]):
            yield Remark.warning("domain", f"a muscle is outside its domain for {left:.4g} s")
        if "small_motion_stiffness" in self.columns and not self.outcome.failed:
            small, isobaric = (
                self.joint_type.span((self[name].min(), self[name].max()), "N*m/rad", 3)
                for name in ("small_motion_stiffness", "stiffness")
            )
            yield Remark.note("stiffness", f"small-motion stiffness {small}, isobaric stiffness {isobaric}")

    def write(self, folder: Path) -> None:
        """Write the columns as NetCDF and, with the package mcap, as MCAP; and the scenario if it is known."""
        self.to_netcdf(folder / "result.nc")
        if importlib.util.find_spec("mcap"):
            columns = {
                name: (labels.get("units", ""), np.asarray(values))
                for name, (dims, values, labels) in self._variables().items()
                if dims == ("time",)
            }
            write_samples(folder / "result.mcap", columns, {"scenario.yaml": self.scenario.encode()})
        if not isinstance(self.source, str):
            self.source.to_yaml(folder / "scenario.yaml")
        elif self.source:
            (folder / "scenario.yaml").write_text(self.source, encoding="utf-8")

    def _attributes(self) -> dict[str, Any]:
        """Attributes of the dataset."""
        own: dict[str, Any] = {"control_period": self.control_period, "scenario": self.scenario, "engine": self.engine}
        own |= self.resolution.attributes if self.resolution else {}
        own |= {"outcome": self.outcome.name, "angle_resolution": self.angle_resolution}
        own |= {"joint_type": self.joint_type.name, "missed": self.missed, "deadlines": self.deadlines}
        own |= {"unattained": "; ".join(remark.text for remark in self.unattained)}
        boxes = [(d.contraction_min, d.contraction_max, d.pressure_min, d.pressure_max) for d in self.domains()]
        return own | ({"domains": np.ravel(np.array(boxes, float))} if boxes else {})

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file of `to_netcdf`; `FileError` if it is missing, is not NetCDF, damaged, or lacks a column."""
        from mckibben.dataset.schema import load_netcdf

        table = load_netcdf(Path(path))
        period: Any = table.attrs.get("control_period")
        boxes: Any = table.attrs.get("domains", ())
        joints, muscles = (
            tuple(map(str, table[axis].to_numpy())) if axis in table else () for axis in ("joint", "muscle")
        )
        columns = column_names(joints) if joints else (*column_names(()), *BAND)
        wrong = [name for name in columns if name not in table or table[name].dims[-1:] != ("time",)]
        wrong += [] if str(table.attrs.get("outcome")) in Outcome.__members__ else ["outcome"]
        wrong += [] if isinstance(period, float | np.floating) and period > 0 else ["control_period"]
        if wrong:
            raise FileError(str(path), [Problem(f"it is not a simulation result: it lacks {', '.join(wrong)}")])
        unattained = str(table.attrs.get("unattained", ""))
        return cls(
            {str(name): variable.to_numpy() for name, variable in table.data_vars.items()},
            float(period),
            *(str(table.attrs.get(name, "")) for name in ("scenario", "engine")),
            resolution=Resolution.of(table.attrs),
            angle_resolution=float(table.attrs.get("angle_resolution", 0.0)),
            domains=functools.partial(tuple, [Domain(*bounds) for bounds in np.reshape(boxes, (-1, 4)).tolist()]),
            known_outcome=Outcome[str(table.attrs["outcome"])],
            joints=joints,
            muscles=muscles,
            joint_type=JOINT_TYPES[str(table.attrs.get("joint_type", HINGE.name))],
            notes=lambda: [Remark.severe("reference", unattained)] if unattained else [],
            missed=int(table.attrs.get("missed", 0)),
            deadlines=int(table.attrs.get("deadlines", 0)),
        )


@BatchFunction
def _trajectories(shared: tuple[Plant, ArrayLike | None], lane: tuple[PyTree, Record, PyTree]) -> Trajectory:
    """Trajectory at one control period."""
    return trajectory(shared[0], *lane, shared[1])


def compute_trajectory(
    plant: Plant,
    setpoints: PyTree,
    record: Record,
    angle_without_step: PyTree,
    stiffness_amplitude: ArrayLike | None = None,
    *,
    engine: str = "auto",
) -> Trajectory:
    """Return the trajectory of a record as arrays of NumPy, each of shape (periods,).

    Parameters
    ----------
    plant
        Plant whose laws give stiffness, torque, forces and air.
    setpoints, record
        Setpoints and record of all control periods.
    angle_without_step
        Angles [rad] of the same run without the last changes of the desired stiffness.
    stiffness_amplitude
        Amplitude [rad] of the motion whose stiffness is meant; None for the isobaric stiffness.
    engine
        "native", "xla" or "auto".
    """
    shared = numeric((plant, stiffness_amplitude))
    lanes = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), (setpoints, record, angle_without_step))
    moved, _ = _trajectories(engine, shared, lanes)
    return jax.tree.map(np.asarray, moved)


@compiled
def _metrics(parts: Any, _: None) -> Metrics:
    return measure(*parts)


@compiled
def _path_columns(joint: AntagonisticJoint, lane: tuple[Array, Array, Pressures, PyTree]) -> dict[str, Array]:
    """Columns of the muscles' friction and creep at one control period, by name."""
    angle, velocity, pressures, muscles = lane
    return {
        "friction_torque": joint.friction_torque(angle, velocity, pressures, muscles),
        "creep_torque": joint.creep_torque(angle, pressures, muscles),
        "small_motion_stiffness": joint.secant_stiffness(angle, pressures, joint.small_motion),
    }


def path_columns(
    joint: AntagonisticJoint, state: PlantState, stiffness_amplitude: ArrayLike | None
) -> dict[str, Callable[[str], Array]]:
    """Function that computes each column of the muscles' friction and creep, by name; empty without them.

    The stiffness of small motion is one of them unless the controller has a `stiffness_amplitude`.
    """
    names = ["friction_torque"] * joint.has_friction + ["creep_torque"] * joint.has_creep
    names += ["small_motion_stiffness"] * (joint.has_friction and stiffness_amplitude is None)

    @functools.cache
    def computed() -> dict[str, Array]:
        parts = state.position, state.velocity, state.pressures, state.muscles
        return _path_columns(joint, jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), parts))

    return dict.fromkeys(names, lambda name: computed()[name])


def columns_of_run(
    plant: PyTree,
    setpoints: PyTree,
    record: Record,
    without_step: Callable[[], PyTree],
    stiffness_amplitude: ArrayLike | None,
    reach: Feasibility | None,
    engine: str,
) -> Columns:
    """Return the columns of a run, of which those that its record lacks are computed when they are first asked for."""
    mechanism, state, follows = plant.mechanism, record.state, not hasattr(setpoints, "dtype")
    joints = mechanism.joint_names

    @functools.cache
    def derived() -> Trajectory:
        return compute_trajectory(plant, setpoints, record, state.angle, stiffness_amplitude, engine=engine)

    @functools.cache
    def bodies() -> dict[str, PyTree]:
        return body_columns(plant, state)

    columns: dict[str, PyTree] = dict.fromkeys(column_names(joints), lambda name: column_of(derived(), name))
    columns |= dict(zip(BAND, (reach.lowest, reach.highest), strict=True)) if reach else {}
    columns |= {name: value for name, value in record.telemetry.items() if name != "saturated"}
    columns |= {"angle": state.angle, "velocity": angles_of(state.velocity)}
    recorded = {"pressure": state.pressures, "command": record.commands}
    if joints:
        columns |= recorded | dict.fromkeys(BODY, lambda name: bodies()[name])
    else:
        columns |= path_columns(plant.joint, state, stiffness_amplitude)
        columns |= {f"{name}{number}": value for name, pair in recorded.items() for number, value in enumerate(pair, 1)}
    if follows:
        columns |= {
            "desired_angle": over_joints(lambda own: own.angle, setpoints),
            "desired_stiffness": over_joints(lambda own: own.stiffness, setpoints),
            "angle_without_step": lambda _: without_step(),
        }
    else:
        columns = {name: value for name, value in columns.items() if name not in REFERENCES}
    return Columns(columns)
