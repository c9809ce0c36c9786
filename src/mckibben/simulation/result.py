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
from mckibben.simulation.metrics import compiled_measure
from mckibben.simulation.trajectory import Trajectory

_ANGLE, _STIFFNESS, _PRESSURE = "rad", "N*m/rad", "Pa"
_UNITS = {
    "angle": (_ANGLE, "joint angle"),
    "velocity": ("rad/s", "angular velocity"),
    "desired_angle": (_ANGLE, "desired joint angle"),
    "desired_stiffness": (_STIFFNESS, "desired joint stiffness"),
    "stiffness": (_STIFFNESS, "isobaric joint stiffness of the plant's muscles"),
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
    "outside_domain": ("1", "a muscle's contraction is outside its domain"),
    "lowest_stiffness": (_STIFFNESS, "lowest attainable stiffness at the desired angle"),
    "highest_stiffness": (_STIFFNESS, "highest attainable stiffness at the desired angle"),
}


class Outcome(enum.Enum):
    """How a run ended; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a pressure at its limit part of the time"
    LEFT_DOMAIN = "completed, but a muscle left the domain of its law: what happened there is extrapolation"
    DIVERGED = "diverged: the state is no longer finite"


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

    def metrics(self, *, settling_band: float = 0.1) -> dict[str, float]:
        """The numbers of `mckibben.simulation.metrics.Metrics`, by name, in SI."""
        measured = compiled_measure(self.trajectory, self.control_period, settling_band=settling_band)
        return {name: float(value) for name, value in measured._asdict().items()}

    def describe(self) -> str:
        """The outcome as a sentence, with how long the run was saturated, slack or outside the domain."""
        table, sentence = self.table, self.outcome.value
        if self.outcome is Outcome.DIVERGED:
            last = int(np.flatnonzero(np.isfinite(table["angle"].to_numpy()))[-1])
            return f"{sentence} after {float(table['time'][last]):.4g} s"
        times = table["time"].to_numpy()
        spans = [
            f"{what} for {mask.sum() * self.control_period:.4g} s, first at {times[mask.argmax()]:.4g} s"
            for what, mask in (
                ("outside the domain", table["outside_domain"].to_numpy()),
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
        path = Path(path)
        part = path.with_name(f".{path.name}.part")
        try:
            self.to_xarray().to_netcdf(part, engine="h5netcdf")
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `to_netcdf` wrote.

        Raises
        ------
        FileError
            If the file is missing, is no NetCDF file, or lacks something.
        """
        try:
            table = xr.load_dataset(path, engine="h5netcdf")
        except (OSError, ValueError) as error:
            raise FileError(str(path), [Problem(f"it cannot be read as NetCDF: {error}")]) from error
        missing = [name for name in Trajectory._fields if name not in table] + [
            name for name in ("control_period", "outcome") if name not in table.attrs
        ]
        if missing:
            raise FileError(str(path), [Problem(f"it is no simulation result: {', '.join(missing)} not in it")])
        outcome = Outcome[table.attrs.pop("outcome")]
        return cls(table, outcome)


def _attributes(name: str) -> dict[str, str]:
    units, meaning = _UNITS.get(name, ("", name.replace("_", " ")))
    return {"units": units, "long_name": meaning} if units else {"long_name": meaning}


def _outcome(table: xr.Dataset) -> Outcome:
    if not (np.isfinite(table["angle"][-1]) and np.isfinite(table["velocity"][-1])):
        return Outcome.DIVERGED
    if table["outside_domain"].any():
        return Outcome.LEFT_DOMAIN
    return Outcome.SATURATED if table["saturated"].any() else Outcome.COMPLETED
