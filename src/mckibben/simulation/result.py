"""What a simulation answers: trajectories with units, how it ended, and how well it went."""

from __future__ import annotations

import enum
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import jax.numpy as jnp
import numpy as np
import xarray as xr

from mckibben.errors import FileError, Problem
from mckibben.files import whole
from mckibben.simulation.metrics import SETTLING_PART, compiled_measure
from mckibben.simulation.trajectory import Trajectory
from mckibben.units import bar, deg, percent

_ANGLE, _STIFFNESS, _PRESSURE = "rad", "N*m/rad", "Pa"
_UNITS = {
    "angle": (_ANGLE, "joint angle"),
    "velocity": ("rad/s", "angular velocity"),
    "desired_angle": (_ANGLE, "desired joint angle"),
    "undisturbed_angle": (_ANGLE, "joint angle without the last change of the desired stiffness"),
    "desired_stiffness": (_STIFFNESS, "desired joint stiffness"),
    "stiffness": (_STIFFNESS, "isobaric joint stiffness of the plant's muscles"),
    "total_stiffness": (_STIFFNESS, "joint stiffness of the plant's muscles and of gravity"),
    "stiffness_estimate": (_STIFFNESS, "joint stiffness as the controller's model has it"),
    "torque": ("N*m", "torque of the muscles"),
    "pressure1": (_PRESSURE, "gauge pressure in muscle 1"),
    "pressure2": (_PRESSURE, "gauge pressure in muscle 2"),
    "command1": (_PRESSURE, "commanded pressure of muscle 1"),
    "command2": (_PRESSURE, "commanded pressure of muscle 2"),
    "force1": ("N", "tension of muscle 1"),
    "force2": ("N", "tension of muscle 2"),
    "contraction1": ("1", "contraction of muscle 1"),
    "contraction2": ("1", "contraction of muscle 2"),
    "saturated": ("1", "a command is at a pressure limit"),
    "slack": ("1", "a muscle is slack"),
    "outside_domain": ("1", "a muscle's contraction or pressure is outside its domain"),
    "overloaded": ("1", "a muscle's tension is above its rating"),
    "excursion": ("1", "how far a contraction is outside its domain"),
    "position_kp": ("Pa/rad", "proportional gain of the position loop"),
    "position_ki": ("Pa/(rad*s)", "integral gain of the position loop"),
    "position_kd": ("Pa*s/rad", "derivative gain of the position loop"),
    "stiffness_kp": ("Pa/(N*m/rad)", "proportional gain of the stiffness loop"),
    "stiffness_ki": ("Pa/(N*m*s/rad)", "integral gain of the stiffness loop"),
    "stiffness_kd": ("Pa*s/(N*m/rad)", "derivative gain of the stiffness loop"),
    "lowest_stiffness": (_STIFFNESS, "lowest attainable stiffness at the desired angle"),
    "highest_stiffness": (_STIFFNESS, "highest attainable stiffness at the desired angle"),
}


_SWUNG_OVER = 90 * deg


class Outcome(enum.Enum):
    """How a run ended; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a pressure at its limit part of the time"
    LEFT_DOMAIN = "completed, but a muscle left its domain or its rating: what happened there is extrapolation"
    SWUNG_OVER = "lost: the joint swung more than 90 deg away from where it should be"
    DIVERGED = "diverged: the state is no longer finite"

    @property
    def lost(self) -> bool:
        """Whether the run came to no end that is of use."""
        return self in (Outcome.SWUNG_OVER, Outcome.DIVERGED)


@dataclass(frozen=True, eq=False)
class Result:
    """A simulated run.

    Attributes
    ----------
    table
        Along ``time`` [s], one row a control period: what `Trajectory` lists, each with ``units`` and ``long_name``;
        the attainable band (``lowest_stiffness``, ``highest_stiffness``), and what the controller reports of itself
        (such as ``position_kp``). Attributes: ``control_period`` [s], ``scenario`` (text, may be empty).
    outcome
        How it ended.
    """

    table: xr.Dataset
    outcome: Outcome

    @classmethod
    def of(
        cls,
        moved: Trajectory,
        control_period: float,
        *,
        band: tuple[np.ndarray, np.ndarray],
        telemetry: dict[str, np.ndarray],
        scenario: str = "",
    ) -> Self:
        """From a trajectory, the attainable band and the controller's telemetry, each of shape (periods,)."""
        columns = {name: np.asarray(value) for name, value in moved._asdict().items()}
        columns |= {"lowest_stiffness": band[0], "highest_stiffness": band[1]}
        columns |= {name: np.asarray(value) for name, value in telemetry.items() if name not in columns}
        times = np.arange(columns["angle"].size) * control_period
        table = xr.Dataset(
            {name: ("time", value, _attributes(name)) for name, value in columns.items()},
            coords={"time": ("time", times, {"units": "s", "long_name": "time"})},
            attrs={"control_period": control_period, "scenario": scenario},
        )
        return cls(table, _outcome(table))

    @property
    def control_period(self) -> float:
        """The control period [s]."""
        return float(self.table.attrs["control_period"])

    @property
    def trajectory(self) -> Trajectory:
        """The arrays of the table, as the metrics take them."""
        return Trajectory(*(jnp.asarray(self.table[name].to_numpy()) for name in Trajectory._fields))

    def metrics(self, *, settling_part: float = SETTLING_PART) -> dict[str, float]:
        """The numbers of `mckibben.simulation.metrics.Metrics`, by name, in SI."""
        measured = compiled_measure(self.trajectory, self.control_period, settling_part=settling_part)
        return {name: float(value) for name, value in measured._asdict().items()}

    def describe(self) -> str:
        """The outcome as a sentence, with how long the run was saturated, slack or outside the domain."""
        table, sentence = self.table, self.outcome.value
        if self.outcome is Outcome.DIVERGED:
            whole_until = np.flatnonzero(np.isfinite(table["angle"].to_numpy()))
            return f"{sentence} after {float(table['time'][whole_until[-1]]) if whole_until.size else 0.0:.4g} s"
        times = table["time"].to_numpy()
        spans = [
            f"{what} for {mask.sum() * self.control_period:.4g} s, first at {times[mask.argmax()]:.4g} s"
            for what, mask in (
                (_outside(table), table["outside_domain"].to_numpy()),
                (f"above the rated force (up to {_peak(table):.4g} N)", table["overloaded"].to_numpy()),
                ("saturated", table["saturated"].to_numpy()),
                ("slack", table["slack"].to_numpy()),
            )
            if mask.any()
        ]
        return f"{sentence} ({'; '.join(spans)})" if spans else sentence

    def to_xarray(self) -> xr.Dataset:
        """The table, with the outcome as an attribute."""
        return self.table.assign_attrs(outcome=self.outcome.name)

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write everything to a NetCDF file; an existing one is replaced only when the new one is whole."""
        with whole(path) as part:
            self.to_xarray().to_netcdf(part, engine="h5netcdf")

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `to_netcdf` wrote.

        Raises
        ------
        FileError
            If the file is missing, is no NetCDF file, or lacks something.
        """
        source = str(path)
        if not Path(path).is_file():
            raise FileError(source, [Problem("there is no such file")])
        try:
            table = xr.load_dataset(path, engine="h5netcdf")
        except Exception as error:  # HDF5 has many ways to say that a file is damaged
            raise FileError(source, [Problem(f"it cannot be read as NetCDF: {error}")]) from error
        columns = (*Trajectory._fields, "lowest_stiffness", "highest_stiffness")
        missing = [name for name in columns if name not in table]
        if missing:
            raise FileError(source, [Problem(f"it is no simulation result: {', '.join(missing)} are not in it")])
        problems = [
            Problem("it is no number over time", field=name)
            for name in columns
            if table[name].dims != ("time",) or table[name].dtype.kind not in "fb"
        ]
        outcome, period = table.attrs.pop("outcome", None), table.attrs.get("control_period")
        if outcome not in Outcome.__members__:
            problems.append(Problem(f"{outcome!r} is no outcome", field="outcome"))
        if not isinstance(period, float | np.floating) or not period > 0:
            problems.append(Problem(f"{period!r} is no time", field="control_period"))
        if problems:
            raise FileError(source, problems)
        return cls(table, Outcome[outcome])


def _outside(table: xr.Dataset) -> str:
    furthest = float(table["excursion"].max())
    low, high = (float(extreme) / bar for extreme in _pressure_range(table))
    how_far = (
        f"contraction by up to {furthest / percent:.3g} %" if furthest > 0 else f"pressure {low:.3g}..{high:.3g} bar"
    )
    return f"outside the domain ({how_far})"


def _pressure_range(table: xr.Dataset) -> tuple[np.floating, np.floating]:
    pressures = np.concatenate([table["pressure1"].to_numpy(), table["pressure2"].to_numpy()])
    return pressures.min(), pressures.max()


def _peak(table: xr.Dataset) -> float:
    return float(max(table["force1"].max(), table["force2"].max()))


def _attributes(name: str) -> dict[str, str]:
    units, meaning = _UNITS.get(name, ("", name.replace("_", " ")))
    return {"units": units, "long_name": meaning} if units else {"long_name": meaning}


def _outcome(table: xr.Dataset) -> Outcome:
    if not (np.isfinite(table["angle"][-1]) and np.isfinite(table["velocity"][-1])):
        return Outcome.DIVERGED
    if float(np.abs(table["angle"] - table["desired_angle"]).max()) > _SWUNG_OVER:
        return Outcome.SWUNG_OVER
    if table["outside_domain"].any() or table["overloaded"].any():
        return Outcome.LEFT_DOMAIN
    return Outcome.SATURATED if table["saturated"].any() else Outcome.COMPLETED
