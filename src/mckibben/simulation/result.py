"""The result of a simulated run: its columns, metrics and outcome."""

from __future__ import annotations

import enum
import functools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.errors import FileError, Problem, SimulationError
from mckibben.notebook import html_table
from mckibben.simulation.accuracy import Resolution
from mckibben.simulation.metrics import METRICS, Trajectory, compiled_measure, first_of_end
from mckibben.simulation.oscillation import compiled_limit_cycle
from mckibben.units import bar, deg, percent

if TYPE_CHECKING:
    import xarray as xr


SWUNG_OVER_AT = 90 * deg
"""Angle error beyond which a run has diverged."""
LEFT_REFERENCE_AT = 5 * deg
"""RMS angle error at the end of a run beyond which it has diverged, unless the reference moves by more."""


class Outcome(enum.Enum):
    """Outcome of a run; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a command at a pressure limit part of the time"
    LEFT_DOMAIN = "completed, but a muscle left its domain or its rating: the law is extrapolated there"
    SWUNG_OVER = "diverged: the angle error exceeded 90 deg"
    DIVERGED = "diverged: the state is not finite"
    NO_START = "not run: no pressures within limits hold the joint at the start"
    LEFT_REFERENCE = (
        "diverged: over the last tenth of the run the angle was further from its reference (RMS) than the reference "
        "moves, and than 5 deg"
    )
    LIMIT_CYCLE = "completed, in a limit cycle: the angle oscillates faster than its reference"

    @property
    def diverged(self) -> bool:
        """Whether the run left its reference for good.

        Its state is not finite, its angle error exceeded 90 deg, or over the last tenth of the run the RMS angle error
        exceeds 5 deg and the span of the reference, highest less lowest angle: a joint that stands still within that
        span is never so far off, however slow its controller.
        """
        return self in (Outcome.SWUNG_OVER, Outcome.DIVERGED, Outcome.LEFT_REFERENCE)

    @property
    def failed(self) -> bool:
        """Whether the run has no usable end: diverged, or not started."""
        return self.diverged or self is Outcome.NO_START

    @property
    def usable(self) -> bool:
        """Whether the run did not fail, and did not end in a limit cycle."""
        return not self.failed and self is not Outcome.LIMIT_CYCLE


BAND: tuple[str, str] = ("lowest_stiffness", "highest_stiffness")
"""Columns of the attainable stiffness."""

OUTCOMES = tuple(Outcome)
"""In the order of the codes of `outcomes`."""


def outcomes(
    *,
    angle_max: ArrayLike,
    left_domain: ArrayLike,
    saturated: ArrayLike,
    oscillates: ArrayLike = False,
    angle_at_end: ArrayLike = 0.0,
    span: ArrayLike = 0.0,
    started: ArrayLike = True,
) -> NDArray[np.int8]:
    """Index of each run's outcome in `OUTCOMES`, from angle errors [rad] and the span [rad] of the reference angle."""
    angle_max = np.asarray(angle_max)
    worst_first = [
        (~np.asarray(started, bool), Outcome.NO_START),
        (~np.isfinite(angle_max), Outcome.DIVERGED),
        (angle_max > SWUNG_OVER_AT, Outcome.SWUNG_OVER),
        (np.asarray(angle_at_end) > np.maximum(span, LEFT_REFERENCE_AT), Outcome.LEFT_REFERENCE),
        (np.asarray(oscillates, bool), Outcome.LIMIT_CYCLE),
        (np.asarray(left_domain, bool), Outcome.LEFT_DOMAIN),
        (np.asarray(saturated, bool), Outcome.SATURATED),
    ]
    conditions = np.broadcast_arrays(*(condition for condition, _ in worst_first))
    codes = [OUTCOMES.index(outcome) for _, outcome in worst_first]
    return np.select(conditions, codes, OUTCOMES.index(Outcome.COMPLETED)).astype(np.int8)


_ANGLE, _STIFFNESS, _PRESSURE = "rad", "N*m/rad", "Pa"
UNITS = {
    "angle": (_ANGLE, "joint angle"),
    "velocity": ("rad/s", "angular velocity"),
    "desired_angle": (_ANGLE, "desired joint angle"),
    "angle_without_step": (_ANGLE, "joint angle of the same run without the last change of the desired stiffness"),
    "desired_stiffness": (_STIFFNESS, "desired joint stiffness"),
    "stiffness": (_STIFFNESS, "isobaric joint stiffness of the plant's muscles"),
    "total_stiffness": (_STIFFNESS, "joint stiffness of the plant's muscles and gravity"),
    "stiffness_estimate": (_STIFFNESS, "controller's estimate of the joint stiffness"),
    "torque": ("N*m", "torque of the muscles"),
    "friction_torque": ("N*m", "torque of the muscles' friction"),
    "joint_friction_torque": ("N*m", "torque of the joint's own friction"),
    "creep_torque": ("N*m", "torque of the muscles' creep"),
    "friction_compensation": ("N*m", "friction torque compensated by the controller"),
    "velocity_estimate": ("rad/s", "controller's estimate of the angular velocity"),
    "disturbance_estimate": ("N*m", "controller's estimate of the disturbance torque"),
    "strength1_estimate": ("1", "controller's estimate of the strength of muscle 1 relative to its law"),
    "strength2_estimate": ("1", "controller's estimate of the strength of muscle 2 relative to its law"),
    "valve_time_constant_estimate": ("s", "controller's estimate of the time constant of the valves"),
    "pressure1": (_PRESSURE, "gauge pressure in muscle 1"),
    "pressure2": (_PRESSURE, "gauge pressure in muscle 2"),
    "command1": (_PRESSURE, "commanded pressure of muscle 1"),
    "command2": (_PRESSURE, "commanded pressure of muscle 2"),
    "opening1": ("1", "opening of the valve of muscle 1, to the supply or where negative to the exhaust"),
    "opening2": ("1", "opening of the valve of muscle 2, to the supply or where negative to the exhaust"),
    "reservoir": (_PRESSURE, "gauge pressure at the inlets of the valves"),
    "force1": ("N", "tension of muscle 1"),
    "force2": ("N", "tension of muscle 2"),
    "contraction1": ("1", "contraction of muscle 1"),
    "contraction2": ("1", "contraction of muscle 2"),
    "saturated": ("1", "a command is at a pressure limit"),
    "slack": ("1", "a muscle is slack"),
    "outside_domain": ("1", "a muscle's contraction or pressure is outside its domain"),
    "overloaded": ("1", "a muscle's tension is above its rating"),
    "air1": ("m^3", "air in muscle 1, as a volume at atmospheric pressure"),
    "air2": ("m^3", "air in muscle 2, as a volume at atmospheric pressure"),
    "excursion": ("1", "distance of a contraction from its domain"),
    "angle_rmse": (_ANGLE, "root mean square error of the angle"),
    "angle_max": (_ANGLE, "largest error of the angle"),
    "stiffness_rmse": (_STIFFNESS, "root mean square error of the stiffness"),
    "stiffness_max": (_STIFFNESS, "largest error of the stiffness"),
    "stiffness_settling": ("s", "settling time of the stiffness"),
    "coupling": (_ANGLE, "largest change of the angle by the last change of the desired stiffness"),
    "estimate_rmse": (_STIFFNESS, "root mean square error of the estimated stiffness"),
    "time_saturated": ("s", "time with a command at a pressure limit"),
    "time_slack": ("s", "time with a muscle slack"),
    "time_outside_domain": ("s", "time with a muscle outside its domain"),
    "time_overloaded": ("s", "time with a muscle above its rated force"),
    "oscillation_amplitude": (_ANGLE, "amplitude of a limit cycle of the angle"),
    "oscillation_period": ("s", "period of a limit cycle of the angle"),
    "excursion_max": ("1", "largest distance of a contraction from its domain"),
    "force_max": ("N", "largest tension"),
    "air": ("m^3", "air consumption, as a volume at atmospheric pressure"),
    "stiffness_ripple": (_STIFFNESS, "root mean square of the stiffness error about its mean"),
    "position_kp": ("Pa/rad", "proportional gain of the position loop"),
    "position_ki": ("Pa/(rad*s)", "integral gain of the position loop"),
    "position_kd": ("Pa*s/rad", "derivative gain of the position loop"),
    "stiffness_kp": ("Pa/(N*m/rad)", "proportional gain of the stiffness loop"),
    "stiffness_ki": ("Pa/(N*m*s/rad)", "integral gain of the stiffness loop"),
    "stiffness_kd": ("Pa*s/(N*m/rad)", "derivative gain of the stiffness loop"),
    "feedforward_differential": (_PRESSURE, "feedforward differential pressure"),
    "feedforward_cocontraction": (_PRESSURE, "feedforward co-contraction"),
    "inverse_error_differential": (_PRESSURE, "error of the learned inverse in differential pressure"),
    "inverse_error_cocontraction": (_PRESSURE, "error of the learned inverse in co-contraction"),
    "lowest_stiffness": (_STIFFNESS, "lowest attainable stiffness at the desired angle"),
    "highest_stiffness": (_STIFFNESS, "highest attainable stiffness at the desired angle"),
}


class Columns(Mapping[str, np.ndarray]):
    """Arrays by name; some are computed when they are first asked for."""

    def __init__(
        self,
        names: Iterable[str],
        known: Mapping[str, Any],
        computed: Iterable[tuple[Iterable[str], Callable[[], Mapping[str, Any]]]] = (),
    ) -> None:
        self._names = tuple(dict.fromkeys(names))
        self._known = dict(known)
        self._computed = {name: compute for group, compute in computed for name in group}

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._known and name in self._computed:
            self._known = dict(self._computed[name]()) | self._known
        value = self._known[name] = np.asarray(self._known[name])
        return value

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __reduce__(self) -> tuple[Any, ...]:
        return Columns, (self._names, dict(self))


class Result:
    """A simulated run; ``result["angle"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), SI: the fields of `Trajectory`, the attainable stiffness (``lowest_stiffness``,
    ``highest_stiffness``), and the controller's telemetry. `control_period` is the time between two values [s],
    `scenario` the text of the scenario, or empty, `engine` what computed it, "native" or "xla", or empty, and
    `resolution` the integration steps per control period with the estimated error of the angle, None if unknown.
    """

    def __init__(
        self,
        columns: Mapping[str, Any],
        control_period: float,
        outcome: Outcome | None = None,
        scenario: str = "",
        engine: str = "",
        resolution: Resolution | None = None,
    ) -> None:
        self.columns = columns
        self.control_period = control_period
        self.scenario = scenario
        self.engine = engine
        self.resolution = resolution
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
    ) -> Self:
        """From a trajectory, the attainable stiffness and the controller's telemetry, each of shape (periods,)."""
        known = moved._asdict() | dict(zip(BAND, band, strict=True))
        columns = {name: np.asarray(value) for name, value in (known | dict(telemetry) | known).items()}
        return cls(columns, control_period, scenario=scenario)

    @functools.cached_property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return _outcome(self.columns, self.control_period)

    @functools.cached_property
    def metrics(self) -> dict[str, float]:
        """The numbers of `mckibben.simulation.metrics.Metrics`, by name, in SI."""
        moved = Trajectory(*(self[name] for name in Trajectory._fields))  # type: ignore[arg-type]
        return {name: float(value) for name, value in compiled_measure(moved, self.control_period)._asdict().items()}

    @property
    def times(self) -> np.ndarray:
        """Start of each control period [s], shape (periods,)."""
        return np.arange(self["angle"].size) * self.control_period

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "time":
            return self.times
        if name not in self.columns:
            known = ", ".join(self.columns)
            raise SimulationError(f"there is no column {name!r}", value=name, remedy=f"there are {known}")
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __repr__(self) -> str:
        errors = [
            f"{axis} RMSE {float(np.sqrt(np.mean((self[axis] - self['desired_' + axis]) ** 2))) / size:.3g} {unit}"
            for axis, size, unit in (("angle", deg, "deg"), ("stiffness", 1.0, "N*m/rad"))
        ]
        duration = self["angle"].size * self.control_period
        return f"<Result: {duration:g} s, {self.outcome.name.lower()}, {', '.join(errors)}>"

    def _repr_html_(self) -> str:
        rows = [(UNITS[name][1], f"{self.metrics[name] / size:.4g}", unit) for name, unit, size in METRICS.values()]
        about = [self.describe(), *([self.resolution.describe()] if self.resolution else [])]
        return html_table("; ".join(about), ("metric", "value", "unit"), rows)

    def describe(self) -> str:
        """The outcome as a sentence, with the time saturated, slack or outside the domain."""
        columns, sentence, times = self.columns, self.outcome.value, self.times
        if self.outcome is Outcome.DIVERGED:
            # Pressures within limits cannot drive the true motion to infinity.
            last = max(np.flatnonzero(np.isfinite(columns["angle"])), default=0)
            commanded = np.isfinite(columns["command1"][last]) and np.isfinite(columns["command2"][last])
            cause = "too few substeps for this plant" if commanded else "commands of the controller that are not finite"
            return f"{sentence} after {times[last]:.4g} s; likely cause: {cause}"
        if self.outcome is Outcome.LIMIT_CYCLE:
            amplitude, period = self.metrics["oscillation_amplitude"] / deg, self.metrics["oscillation_period"]
            sentence = f"{sentence}, by {amplitude:.3g} deg either way with a period of {period:.3g} s"
        peak = max(columns["force1"].max(), columns["force2"].max())
        spans = [
            f"{what} for {mask.sum() * self.control_period:.4g} s, first at {times[mask.argmax()]:.4g} s"
            for what, mask in (
                (_outside(columns), columns["outside_domain"]),
                (f"above the rated force (up to {peak:.4g} N)", columns["overloaded"]),
                ("saturated", columns["saturated"]),
                ("slack", columns["slack"]),
            )
            if mask.any()
        ]
        return f"{sentence} ({'; '.join(spans)})" if spans else sentence

    def to_xarray(self) -> xr.Dataset:
        """Columns along ``time`` [s], with ``units`` and ``long_name``; period, scenario and outcome as attributes."""
        import xarray as xr  # 0.15 s

        return xr.Dataset(
            variables(self.columns, "time"),
            coords={"time": ("time", self.times, {"units": "s", "long_name": "time"})},
            attrs={
                "control_period": self.control_period,
                "scenario": self.scenario,
                "outcome": self.outcome.name,
                "engine": self.engine,
                **({} if self.resolution is None else self.resolution.attributes),
            },
        )

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write to a NetCDF file, atomically and with a checksum."""
        from mckibben.dataset.schema import write_netcdf

        write_netcdf(self.to_xarray(), Path(path))

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
        return cls(values, float(period), Outcome[outcome], scenario, engine, Resolution.of(table.attrs))


def _outside(columns: Mapping[str, np.ndarray]) -> str:
    furthest = float(columns["excursion"].max())
    pressures = np.concatenate([columns["pressure1"], columns["pressure2"]]) / bar
    how_far = (
        f"contraction by up to {furthest / percent:.3g} %"
        if furthest > 0
        else f"pressure {pressures.min():.3g}..{pressures.max():.3g} bar"
    )
    return f"outside the domain ({how_far})"


def attributes(name: str, known: Mapping[str, tuple[str, str]] = UNITS) -> dict[str, str]:
    """Unit and meaning of a variable as NetCDF attributes."""
    units, meaning = known.get(name, ("", name.replace("_", " ")))
    return {"units": units, "long_name": meaning} if units else {"long_name": meaning}


def variables(
    columns: Mapping[str, Any],
    along: str,
    parts: Callable[[str], str] = str,
    known: Mapping[str, tuple[str, str]] = UNITS,
) -> dict[str, Any]:
    """Variables of a dataset along a dimension; tuples have first the dimension that `parts` gives for their name."""
    found = {}
    for name, column in columns.items():
        several = isinstance(column, tuple)
        dims = (parts(name), along) if several else along
        found[name] = (dims, np.stack(column) if several else column, attributes(name, known))
    return found


def _outcome(columns: Mapping[str, np.ndarray], period: float) -> Outcome:
    ended = np.isfinite(columns["velocity"][-1])
    error = columns["angle"] - columns["desired_angle"]
    code = outcomes(
        angle_max=np.abs(error).max() if ended else np.inf,
        angle_at_end=np.sqrt(np.mean(error[first_of_end(error.size) :] ** 2)),
        span=np.ptp(columns["desired_angle"]),
        left_domain=columns["outside_domain"].any() or columns["overloaded"].any(),
        saturated=columns["saturated"].any(),
        oscillates=ended and compiled_limit_cycle(columns["angle"], columns["desired_angle"], period).amplitude > 0,
    )
    return OUTCOMES[int(code)]
