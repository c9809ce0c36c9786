"""How a run ended."""

from __future__ import annotations

import enum
import functools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import FileError, Problem
from mckibben.simulation.metrics import SETTLING_PART, Trajectory, compiled_measure
from mckibben.storage.files import atomic_write
from mckibben.units import bar, deg, percent

if TYPE_CHECKING:
    import xarray as xr


SWUNG_OVER_AT = 90 * deg
"""A joint this far from where it should be is lost."""


class Outcome(enum.Enum):
    """How a run ended; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a pressure at its limit part of the time"
    LEFT_DOMAIN = "completed, but a muscle left its domain or its rating: what happened there is extrapolation"
    SWUNG_OVER = "lost: the joint swung more than 90 deg away from where it should be"
    DIVERGED = "diverged: the state is no longer finite"
    NO_START = "not run: no pressures within limits hold the joint at the start"

    @property
    def lost(self) -> bool:
        """Whether the run came to no end that is of use."""
        return self in (Outcome.SWUNG_OVER, Outcome.DIVERGED, Outcome.NO_START)


OUTCOMES = tuple(Outcome)
"""In the order of the codes that `outcomes` gives."""


def outcomes(
    *, angle_max: ArrayLike, left_domain: ArrayLike, saturated: ArrayLike, started: ArrayLike = True
) -> NDArray[np.int8]:
    """The place of each run's outcome in `OUTCOMES`.

    Parameters
    ----------
    angle_max
        The largest error of the angle [rad]; not finite where the run diverged.
    left_domain, saturated
        Whether a muscle left its domain or its rating, and whether a command was at a limit.
    started
        Whether there was a state to start from.
    """
    angle_max = np.asarray(angle_max)
    worst_first = [
        (~np.asarray(started, bool), Outcome.NO_START),
        (~np.isfinite(angle_max), Outcome.DIVERGED),
        (angle_max > SWUNG_OVER_AT, Outcome.SWUNG_OVER),
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
    "undisturbed_angle": (_ANGLE, "joint angle without the last change of the desired stiffness"),
    "desired_stiffness": (_STIFFNESS, "desired joint stiffness"),
    "stiffness": (_STIFFNESS, "isobaric joint stiffness of the plant's muscles"),
    "total_stiffness": (_STIFFNESS, "joint stiffness of the plant's muscles and of gravity"),
    "stiffness_estimate": (_STIFFNESS, "joint stiffness as the controller's model has it"),
    "torque": ("N*m", "torque of the muscles"),
    "friction_torque": ("N*m", "part of the torque that is the muscles' friction"),
    "creep_torque": ("N*m", "part of the torque that is the muscles' creep"),
    "friction_compensation": ("N*m", "torque of friction that the controller expects and makes up for"),
    "velocity_estimate": ("rad/s", "angular velocity as the controller observes it"),
    "disturbance_estimate": ("N*m", "torque that the controller's model has no cause for"),
    "strength1_estimate": ("1", "strength of muscle 1 against its law, as the controller believes"),
    "strength2_estimate": ("1", "strength of muscle 2 against its law, as the controller believes"),
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
    "air1": ("m^3", "air in muscle 1, as a volume at atmospheric pressure"),
    "air2": ("m^3", "air in muscle 2, as a volume at atmospheric pressure"),
    "excursion": ("1", "how far a contraction is outside its domain"),
    "angle_rmse": (_ANGLE, "root mean square error of the angle"),
    "angle_max": (_ANGLE, "largest error of the angle"),
    "stiffness_rmse": (_STIFFNESS, "root mean square error of the stiffness"),
    "stiffness_max": (_STIFFNESS, "largest error of the stiffness"),
    "stiffness_settling": ("s", "time until the stiffness has settled"),
    "coupling": (_ANGLE, "angle that the last change of the desired stiffness makes"),
    "estimate_rmse": (_STIFFNESS, "root mean square error of the estimated stiffness"),
    "time_saturated": ("s", "time with a command at a pressure limit"),
    "time_slack": ("s", "time with a muscle slack"),
    "time_outside_domain": ("s", "time with a muscle outside its domain"),
    "time_overloaded": ("s", "time with a muscle above its rated force"),
    "excursion_max": ("1", "how far a contraction was outside its domain at most"),
    "force_max": ("N", "largest tension"),
    "air": ("m^3", "air that the muscles take in, as a volume at atmospheric pressure"),
    "stiffness_ripple": (_STIFFNESS, "root mean square of the stiffness error about its mean"),
    "position_kp": ("Pa/rad", "proportional gain of the position loop"),
    "position_ki": ("Pa/(rad*s)", "integral gain of the position loop"),
    "position_kd": ("Pa*s/rad", "derivative gain of the position loop"),
    "stiffness_kp": ("Pa/(N*m/rad)", "proportional gain of the stiffness loop"),
    "stiffness_ki": ("Pa/(N*m*s/rad)", "integral gain of the stiffness loop"),
    "stiffness_kd": ("Pa*s/(N*m/rad)", "derivative gain of the stiffness loop"),
    "forward_differential": (_PRESSURE, "differential pressure that is given beside the loops"),
    "forward_cocontraction": (_PRESSURE, "co-contraction that is given beside the loops"),
    "inverse_error_differential": (_PRESSURE, "differential pressure that the learned inverse was off for the motion"),
    "inverse_error_cocontraction": (_PRESSURE, "co-contraction that the learned inverse was off for the motion"),
    "lowest_stiffness": (_STIFFNESS, "lowest attainable stiffness at the desired angle"),
    "highest_stiffness": (_STIFFNESS, "highest attainable stiffness at the desired angle"),
}


@dataclass(frozen=True, eq=False)
class Result:
    """A simulated run.

    Attributes
    ----------
    columns
        Arrays of shape (periods,), one value a control period, by name: what `Trajectory` lists, the attainable band
        (``lowest_stiffness``, ``highest_stiffness``), and what the controller reports of itself (such as
        ``position_kp``).
    control_period
        The time between two values [s].
    outcome
        How it ended.
    scenario
        Text: what made it; may be empty.
    """

    columns: dict[str, np.ndarray]
    control_period: float
    outcome: Outcome
    scenario: str = ""

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
        return cls(columns, control_period, _outcome(columns), scenario)

    @functools.cached_property
    def table(self) -> xr.Dataset:
        """The columns along ``time`` [s], each with ``units`` and ``long_name``.

        Attributes: ``control_period`` [s] and ``scenario``.
        """
        import xarray as xr  # 0.15 s at import, which a run that is only measured need not wait for

        return xr.Dataset(
            {name: ("time", value, attributes(name)) for name, value in self.columns.items()},
            coords={"time": ("time", self.times, {"units": "s", "long_name": "time"})},
            attrs={"control_period": self.control_period, "scenario": self.scenario},
        )

    @property
    def times(self) -> np.ndarray:
        """The start of each control period [s], shape (periods,)."""
        return np.arange(self.columns["angle"].size) * self.control_period

    @property
    def trajectory(self) -> Trajectory:
        """The columns as the metrics take them."""
        return Trajectory(*(self.columns[name] for name in Trajectory._fields))  # type: ignore[arg-type]

    def metrics(self, *, settling_part: float = SETTLING_PART) -> dict[str, float]:
        """The numbers of `mckibben.simulation.metrics.Metrics`, by name, in SI."""
        measured = compiled_measure(self.trajectory, self.control_period, settling_part=settling_part)
        return {name: float(value) for name, value in measured._asdict().items()}

    def describe(self) -> str:
        """The outcome as a sentence, with how long the run was saturated, slack or outside the domain."""
        columns, sentence, times = self.columns, self.outcome.value, self.times
        if self.outcome is Outcome.DIVERGED:
            whole_until = np.flatnonzero(np.isfinite(columns["angle"]))
            return f"{sentence} after {times[whole_until[-1]] if whole_until.size else 0.0:.4g} s"
        spans = [
            f"{what} for {mask.sum() * self.control_period:.4g} s, first at {times[mask.argmax()]:.4g} s"
            for what, mask in (
                (_outside(columns), columns["outside_domain"]),
                (f"above the rated force (up to {_peak(columns):.4g} N)", columns["overloaded"]),
                ("saturated", columns["saturated"]),
                ("slack", columns["slack"]),
            )
            if mask.any()
        ]
        return f"{sentence} ({'; '.join(spans)})" if spans else sentence

    def to_xarray(self) -> xr.Dataset:
        """The table, with the outcome as an attribute."""
        return self.table.assign_attrs(outcome=self.outcome.name)

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write everything to a NetCDF file; an existing one is replaced only when the new one is whole."""
        with atomic_write(path, overwrite=True) as part:
            self.to_xarray().to_netcdf(part, engine="h5netcdf")

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `to_netcdf` wrote.

        Raises
        ------
        FileError
            If the file is missing, is no NetCDF file, or lacks something.
        """
        import xarray as xr

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
        outcome = table.attrs.pop("outcome", None)
        period: Any = table.attrs.get("control_period")
        if outcome not in Outcome.__members__:
            problems.append(Problem(f"{outcome!r} is no outcome", field="outcome"))
        if not isinstance(period, float | np.floating) or not period > 0:
            problems.append(Problem(f"{period!r} is no time", field="control_period"))
        if problems:
            raise FileError(source, problems)
        values = {str(name): variable.to_numpy() for name, variable in table.data_vars.items()}
        return cls(values, float(period), Outcome[outcome], str(table.attrs.get("scenario", "")))


def _outside(columns: dict[str, np.ndarray]) -> str:
    furthest = float(columns["excursion"].max())
    pressures = np.concatenate([columns["pressure1"], columns["pressure2"]]) / bar
    how_far = (
        f"contraction by up to {furthest / percent:.3g} %"
        if furthest > 0
        else f"pressure {pressures.min():.3g}..{pressures.max():.3g} bar"
    )
    return f"outside the domain ({how_far})"


def _peak(columns: dict[str, np.ndarray]) -> float:
    return float(max(columns["force1"].max(), columns["force2"].max()))


def attributes(name: str) -> dict[str, str]:
    """The unit and the meaning of a variable, as NetCDF has them."""
    units, meaning = UNITS.get(name, ("", name.replace("_", " ")))
    return {"units": units, "long_name": meaning} if units else {"long_name": meaning}


def _outcome(columns: dict[str, np.ndarray]) -> Outcome:
    ended = np.isfinite(columns["velocity"][-1])
    code = outcomes(
        angle_max=np.abs(columns["angle"] - columns["desired_angle"]).max() if ended else np.inf,
        left_domain=columns["outside_domain"].any() or columns["overloaded"].any(),
        saturated=columns["saturated"].any(),
    )
    return OUTCOMES[int(code)]
