"""Result of a simulated run: its columns over time, metrics and outcome."""

from __future__ import annotations

import abc
import functools
import importlib.util
import io
import os
from collections import UserDict
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.binding import call
from mckibben.codegen.engine import BatchFunction, compiled
from mckibben.codegen.native import over_periods
from mckibben.component.columns import Label, attributes, declare, labels_of
from mckibben.errors import FileError, Problem, SimulationError, no_attribute, suggest
from mckibben.joint.antagonistic import SMALL_MOTION, AntagonisticJoint
from mckibben.joint.geometry import Pressures
from mckibben.muscle import Domain
from mckibben.numerics.compiled import numeric
from mckibben.result import Column, Remark, Result, TableColumns
from mckibben.simulation.accuracy import Resolution
from mckibben.simulation.feasibility import Feasibility
from mckibben.simulation.metrics import Metrics, first_of_end, last_change, measure
from mckibben.simulation.outcome import OUTCOMES, Outcome, outcomes
from mckibben.simulation.trajectories import Trajectory, trajectory
from mckibben.storage.files import atomic_write
from mckibben.storage.mcap import write_samples
from mckibben.units import bar, deg, percent

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.control.base import Setpoint
    from mckibben.plant import JointPlant, PlantState
    from mckibben.simulation.trajectories import Record

_CHATTER = "stiffness_oscillation", "command_oscillation", "command_reversals", "command_travel"
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
    """Arrays by name; a function in place of one is called when the array is first asked for."""

    def __getitem__(self, key: str) -> np.ndarray:
        value = super().__getitem__(key)
        if not isinstance(value, np.ndarray):
            value = self[key] = np.asarray(value() if callable(value) else value)
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


class RunResult(Result, abc.ABC):
    """A simulated run; ``result["angle"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), those of several joints or muscles (joints, periods) or (muscles, periods), in SI.

    Attributes
    ----------
    columns
        Arrays by name.
    control_period
        Time between two values [s].
    scenario
        Text of the scenario, or empty.
    engine
        Engine that computed the run, "native" or "xla", or empty.
    resolution
        Integration steps per control period with the estimated error of the angle; None if unknown.
    """

    kind: ClassVar[type]
    """Class of the metrics."""

    columns: Mapping[str, Any]
    control_period: float
    scenario: str = ""
    engine: str = ""
    resolution: Resolution | None = None

    @abc.abstractmethod
    def _measure(self) -> Any:
        """Return the metrics, of the class `kind`."""

    @functools.cached_property
    def metrics(self) -> dict[str, Any]:
        """The numbers of the class `kind` by name, in SI; an array where there is one for each joint."""
        values = self._measure()._asdict().items()
        return Measured({name: np.array(value) if isinstance(value, tuple) else float(value) for name, value in values})

    @property
    def times(self) -> NDArray[np.float64]:
        """Start of each control period [s], shape (periods,)."""
        first = next(iter(self.columns))
        return np.arange(np.shape(self.columns[first])[-1]) * self.control_period

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.times.size * self.control_period

    def declared(self) -> TableColumns:
        """The metrics, with their units."""
        return metric_columns(self.kind, self.metrics)

    def remarks(self) -> Iterable[Remark]:
        """The integration error: a warning if the run is not resolved, else a note."""
        if self.resolution:
            remark = Remark.note if self.resolution.resolved else Remark.warning
            yield remark("accuracy", self.resolution.describe())

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "time":
            return self.times
        if name not in self.columns:
            raise unknown_column(name, self.columns)
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getattr__(self, name: str) -> Any:
        metrics, columns = labels_of(self.kind), self.__dict__.get("columns", ())
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
        variables |= {name: ((*self._rows_of(name), "time"), self[name], attributes(name)) for name in self.columns}
        return variables

    def _attributes(self) -> dict[str, Any]:
        """Attributes of the dataset."""
        own = {"control_period": self.control_period, "scenario": self.scenario, "engine": self.engine}
        return own | (self.resolution.attributes if self.resolution else {})

    def _rows_of(self, name: str) -> tuple[str, ...]:
        """Dimensions of a column other than time."""
        return ()

    def _coordinates(self) -> dict[str, list[str]]:
        """Names along these dimensions."""
        return {}


def metric_columns(kind: type, metrics: Mapping[str, Any]) -> dict[str, tuple[Column, Any]]:
    """Columns of metrics with their values [SI], by name; `kind` is the class that declares them."""
    return {name: (label, metrics[name]) for name, label in labels_of(kind).items() if name in metrics}


class SimulationResult(RunResult):
    """A simulated run of a joint; ``result["angle"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), SI: the fields of `Trajectory`, the attainable stiffness (``lowest_stiffness``,
    ``highest_stiffness``), and the controller's telemetry.

    Attributes
    ----------
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
    """

    kind = Metrics
    figures: ClassVar = ("tracking",)
    files: ClassVar = ("result.nc", "result.mcap", "scenario.yaml")

    angle_resolution: float = 0.0
    domains: Callable[[], tuple[Domain, ...]] = tuple
    known_outcome: Outcome | None = None
    feasibility: Feasibility | None = None
    notes: Callable[[], list[Remark]] = list

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
        return cls(columns, control_period, scenario, angle_resolution=angle_resolution)

    @functools.cached_property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        if self.known_outcome is not None:
            return self.known_outcome
        desired = self["desired_angle"]
        end = slice(first_of_end(desired.size), None)
        at_end = np.sqrt(np.mean((self["angle"] - desired)[end] ** 2))
        return OUTCOMES[int(outcomes(self.metrics, angle_at_end=at_end, span=np.ptp(desired)))]

    def _measure(self) -> Metrics:
        moved = Trajectory(*(self[name] for name in Trajectory._fields))  # type: ignore[arg-type]
        rest = self.control_period, self.angle_resolution, last_change(moved.desired_stiffness, np)
        return _metrics((over_periods(moved), *jax.tree.map(np.asarray, rest)))

    @property
    def ok(self) -> bool:
        """Whether the run did not fail."""
        return not self.outcome.failed

    @property
    def poor_tracking(self) -> str:
        """Remark on an angle that follows its reference worse than a joint at rest; empty if it does not, or failed."""
        desired = self["desired_angle"]
        if not self.outcome.usable or np.ptp(desired) < 1e-9:
            return ""
        error, resting = (np.sqrt(np.mean((angle - desired) ** 2)) / deg for angle in (self["angle"], self["angle"][0]))
        if error <= resting:
            return ""
        rmse = f"RMSE {error:.3g} instead of {resting:.3g} deg"
        return f"the angle follows the reference worse than a joint at rest ({rmse})"

    def verdict(self) -> str:
        """The outcome as a sentence, with the time saturated, slack or outside the domain."""
        sentence, times = self.outcome.value, self.times
        if self.outcome is Outcome.DIVERGED:
            # Pressures within limits cannot drive the true motion to infinity.
            last = max(np.flatnonzero(np.isfinite(self["angle"])), default=0)
            commanded = np.isfinite(self["command1"][last]) and np.isfinite(self["command2"][last])
            cause = "too few substeps for this plant" if commanded else "commands of the controller that are not finite"
            return f"{sentence} after {times[last]:.4g} s; likely cause: {cause}"
        if self.outcome is Outcome.LIMIT_CYCLE:
            amplitude, period = self.metrics["oscillation_amplitude"] / deg, self.metrics["oscillation_period"]
            sentence = f"{sentence}, with an amplitude of {amplitude:.3g} deg and a period of {period:.3g} s"
        if self.outcome is Outcome.CHATTER:
            stiffness, command, rate, travel = (self.metrics[name] for name in _CHATTER)
            sentence = (
                f"{sentence}, with amplitudes of {stiffness:.3g} N*m/rad and {command / bar:.3g} bar; "
                f"a command reverses {rate:.3g} times per second and travels {travel / bar:.3g} bar/s"
            )
        peak = max(self["force1"].max(), self["force2"].max())
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
        return f"{sentence} ({'; '.join(spans)})" if spans else sentence

    def _outside(self) -> str:
        """Quantities that left the domain, by how much, and the domain."""
        furthest, pressures = float(self["excursion"].max()), (self["pressure1"], self["pressure2"])
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
        """Infeasible reference, poor tracking and integration error; notes on the plant and on friction."""
        if self.feasibility and not self.feasibility.feasible:
            yield Remark.warning("reference", self.feasibility.verdict())
        if self.poor_tracking:
            remedy = "check by `mckibben envelope` whether the motion is too fast for the joint, or tune the controller"
            yield Remark.warning("controller", self.poor_tracking, remedy)
        yield from super().remarks()
        yield from self.notes()
        if "small_motion_stiffness" in self.columns and not self.outcome.failed:
            small, isobaric = (
                f"{self[name].min():.3g}..{self[name].max():.3g} N*m/rad"
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
        if self.scenario:
            call("write_scenario", folder / "scenario.yaml", self.scenario)

    def _attributes(self) -> dict[str, Any]:
        own = {"outcome": self.outcome.name, "angle_resolution": self.angle_resolution}
        boxes = [(d.contraction_min, d.contraction_max, d.pressure_min, d.pressure_max) for d in self.domains()]
        return super()._attributes() | own | ({"domains": np.ravel(np.array(boxes, float))} if boxes else {})

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file of `to_netcdf`; `FileError` if it is missing, is not NetCDF, damaged, or lacks a column."""
        from mckibben.dataset.schema import load_netcdf

        table = load_netcdf(Path(path))
        period: Any = table.attrs.get("control_period")
        boxes: Any = table.attrs.get("domains", ())
        columns = (*Trajectory._fields, *BAND)
        wrong = [name for name in columns if name not in table or table[name].dims != ("time",)]
        wrong += [] if str(table.attrs.get("outcome")) in Outcome.__members__ else ["outcome"]
        wrong += [] if isinstance(period, float | np.floating) and period > 0 else ["control_period"]
        if wrong:
            raise FileError(str(path), [Problem(f"it is not a simulation result: it lacks {', '.join(wrong)}")])
        return cls(
            {str(name): variable.to_numpy() for name, variable in table.data_vars.items()},
            float(period),
            *(str(table.attrs.get(name, "")) for name in ("scenario", "engine")),
            resolution=Resolution.of(table.attrs),
            angle_resolution=float(table.attrs.get("angle_resolution", 0.0)),
            domains=functools.partial(tuple, [Domain(*bounds) for bounds in np.reshape(boxes, (-1, 4)).tolist()]),
            known_outcome=Outcome[str(table.attrs["outcome"])],
        )


@BatchFunction
def _trajectories(shared: tuple[JointPlant, ArrayLike | None], lane: tuple[Setpoint, Record, Array]) -> Trajectory:
    """Trajectory at one control period."""
    return trajectory(shared[0], *lane, shared[1])


def compute_trajectory(
    plant: JointPlant,
    setpoints: Setpoint,
    record: Record,
    angle_without_step: ArrayLike,
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
        Angle [rad] of the same run without the last change of the desired stiffness.
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
        "small_motion_stiffness": joint.secant_stiffness(angle, pressures, SMALL_MOTION),
    }


def path_columns(
    joint: AntagonisticJoint, state: PlantState, stiffness_amplitude: ArrayLike | None
) -> dict[str, Callable[[], Array]]:
    """Functions that compute the columns of the muscles' friction and creep, by name; empty without them.

    The stiffness of small motion is one of them unless the controller has a `stiffness_amplitude`.
    """
    lanes = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), state[:4])
    computed = functools.cache(lambda: _path_columns(joint, lanes))
    names = ["friction_torque"] * joint.has_friction + ["creep_torque"] * joint.has_creep
    names += ["small_motion_stiffness"] * (joint.has_friction and stiffness_amplitude is None)
    return {name: functools.partial(lambda name: computed()[name], name) for name in names}
