"""Tables of results: the columns of one run over time, and the metrics of many runs."""

from __future__ import annotations

import abc
import functools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.component.columns import attributes, labels_of
from mckibben.errors import SimulationError, no_attribute, suggest
from mckibben.notebook import html_table
from mckibben.simulation.accuracy import Resolution
from mckibben.simulation.metrics import Metrics
from mckibben.simulation.outcome import OUTCOMES, Outcome

if TYPE_CHECKING:
    import xarray as xr


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


class UnknownMetricError(SimulationError, KeyError):
    """A metric that a result does not have."""

    __str__ = SimulationError.__str__


class Measured(dict[str, Any]):
    """Metrics by name; the error of an unknown one has a suggestion."""

    def __missing__(self, name: str) -> NoReturn:
        raise _unknown(name, self)


def _unknown(name: str, known: Iterable[Any]) -> UnknownMetricError:
    """Error of a metric that is none of the known ones."""
    remedy = suggest(str(name), [str(one) for one in known])
    return UnknownMetricError(f"there is no metric {name!r}", value=name, remedy=remedy)


class RunResult(abc.ABC):
    """A simulated run; ``result["angle"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), those of several joints or muscles (joints, periods) or (muscles, periods), in SI.
    `control_period` is the time between two values [s], `scenario` the text of the scenario, or empty, `engine` the one
    that computed it, "native" or "xla", or empty, and `resolution` the integration steps per control period with the
    estimated error of the angle, None if unknown.
    """

    kind: ClassVar[type]
    """Class of the metrics."""

    def __init__(
        self,
        columns: Mapping[str, Any],
        control_period: float,
        scenario: str = "",
        engine: str = "",
        resolution: Resolution | None = None,
    ) -> None:
        self.columns = columns
        self.control_period = control_period
        self.scenario = scenario
        self.engine = engine
        self.resolution = resolution

    @abc.abstractmethod
    def _measure(self) -> Any:
        """Return the metrics, of the class `kind`."""

    @functools.cached_property
    def metrics(self) -> dict[str, Any]:
        """The numbers of the class `kind` by name, in SI; an array where there is one for each joint."""
        found = self._measure()._asdict().items()
        return Measured({name: np.array(value) if isinstance(value, tuple) else float(value) for name, value in found})

    @abc.abstractmethod
    def describe(self) -> str:
        """Return the outcome as a sentence."""

    @property
    def times(self) -> np.ndarray:
        """Start of each control period [s], shape (periods,)."""
        first = next(iter(self.columns))
        return np.arange(np.shape(self.columns[first])[-1]) * self.control_period

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.times.size * self.control_period

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "time":
            return self.times
        if name not in self.columns:
            raise SimulationError(
                f"there is no column {name!r}", value=name, remedy=suggest(str(name), list(self.columns))
            )
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getattr__(self, name: str) -> Any:
        metrics, columns = labels_of(self.kind), self.__dict__.get("columns", ())
        meant = {one: f'result.metrics["{one}"]' for one in metrics} | {one: f'result["{one}"]' for one in columns}
        if name not in meant and not name.startswith("_") and (metric := f"angle_{name}") in metrics:
            meant[name] = meant[metric]
        raise no_attribute(self, name, meant)

    def _ipython_key_completions_(self) -> list[str]:
        return ["time", *self.columns]

    def _repr_html_(self) -> str:
        rows = []
        for name, label in labels_of(self.kind).items():
            shown, size = label.displayed
            values = np.atleast_1d(self.metrics[name]) / size
            rows.append((label.meaning, ", ".join(f"{value:.4g}" for value in values), shown))
        about = [self.describe(), *([self.resolution.describe()] if self.resolution else [])]
        return html_table("; ".join(about), ("metric", "value", "unit"), rows)

    def to_xarray(self) -> xr.Dataset:
        """Columns along ``time`` [s], with ``units`` and ``long_name``; period, scenario and engine as attributes."""
        import xarray as xr  # 0.15 s

        time = {"time": ("time", self.times, {"units": "s", "long_name": "time"})}
        table = {name: ((*self._rows_of(name), "time"), self[name], attributes(name)) for name in self.columns}
        return xr.Dataset(table, coords=time | self._coordinates(), attrs=self._attributes())

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write to a NetCDF file, atomically and with a checksum."""
        from mckibben.dataset.schema import write_netcdf

        write_netcdf(self.to_xarray(), Path(path))

    def _attributes(self) -> dict[str, Any]:
        """Attributes of the dataset."""
        found = {"control_period": self.control_period, "scenario": self.scenario, "engine": self.engine}
        return found | (self.resolution.attributes if self.resolution else {})

    def _rows_of(self, name: str) -> tuple[str, ...]:
        """Dimensions of a column other than time."""
        return ()

    def _coordinates(self) -> dict[str, list[str]]:
        """Names along these dimensions."""
        return {}


@dataclass(frozen=True, eq=False, repr=False)
class RunTable:
    """Results of many runs, in their order; ``result["angle_rmse"]`` is a column as an array.

    `table` has along ``run`` the metrics (SI) and ``outcome``, a code; its attribute ``flag_meanings`` lists the names.
    """

    table: xr.Dataset

    @property
    def count(self) -> int:
        """Number of runs."""
        return self.table.sizes["run"]

    @property
    def outcomes(self) -> list[Outcome]:
        """Outcome of each run."""
        return [OUTCOMES[code] for code in self["outcome"]]

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Mask of the runs that diverged or could not start."""
        return np.array([outcome.failed for outcome in OUTCOMES])[self["outcome"]]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of the runs that did not fail, and did not end in a limit cycle."""
        return np.array([outcome.usable for outcome in OUTCOMES])[self["outcome"]]

    @property
    def chaotic(self) -> NDArray[np.bool_]:
        """Mask of the runs that were found to be chaotic: they do not converge with the number of integration steps."""
        return self["chaotic"].astype(bool)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.table:
            raise _unknown(name, self.table)
        return self.table[name].to_numpy()

    def __contains__(self, name: object) -> bool:
        return name in self.table

    def __iter__(self) -> Iterator[Any]:
        return iter(self.table)


@dataclass(frozen=True, eq=False, repr=False)
class Batch(RunTable):
    """Results of a batch; ``batch["angle_rmse"]`` is a column as an array.

    `table` has as well ``substeps`` (integration steps per control period), ``error_estimate`` (of the angle by the
    integration [rad]), ``chaotic``, and the values of `over`; along ``run`` and ``time`` the kept parts of the
    trajectories. Metrics of several joints are along ``joint`` and ``run``. `kind` is the class of the metrics.
    """

    kind: type = Metrics

    @property
    def engine(self) -> str:
        """Engine that computed the runs, "native", "xla" or "cuda"; empty if unknown."""
        return self.table.attrs.get("engine", "")

    @property
    def metrics(self) -> dict[str, NDArray[np.floating]]:
        """The computed metrics by name, shape (runs,) or (joints, runs), SI; NaN for a run that could not start."""
        return Measured({name: self[name] for name in labels_of(self.kind) if name in self.table})

    def _counted(self) -> str:
        counts = np.bincount(self["outcome"], minlength=len(OUTCOMES))
        counted = [f"{n} {outcome.name.lower()}" for n, outcome in zip(counts, OUTCOMES, strict=True) if n]
        return ", ".join(counted + [f"{n} chaotic" for n in (int(self.chaotic.sum()),) if n])

    def __repr__(self) -> str:
        return f"<Batch: {self.count} runs ({self._counted()}), metrics {', '.join(self.metrics)}>"

    def _repr_html_(self) -> str:
        parts = (0, 50, 100)
        rows = []
        for name, values in self.metrics.items():
            about = attributes(name)
            for part, row in zip(self.table.get("joint", [""]), np.atleast_2d(values), strict=False):
                finite = row[np.isfinite(row)]
                numbers = np.percentile(finite, parts) if finite.size else np.full(len(parts), np.nan)
                what = about["long_name"] if values.ndim == 1 else f"{about['long_name']}, {part}"
                rows.append((what, *(f"{number:.4g}" for number in numbers), about.get("units", "")))
        head = ("metric", "least", "median", "largest", "unit")
        return html_table(f"{self.count} runs: {self._counted()}", head, rows)


def batch_table(
    columns: dict[str, Any], codes: NDArray[np.int8], over: Mapping[str, ArrayLike], **attrs: str
) -> xr.Dataset:
    """Return the table of a batch: values of `over`, outcomes by code, and further variables."""
    import xarray as xr

    table: dict[str, Any] = {}
    for name, values in over.items():
        given = np.asarray(values)
        axes = [f"{name}.{axis}" for axis in range(given.ndim)]
        dims = ["run", *axes[1:]] if given.ndim and given.shape[0] == codes.size else axes
        table[name] = (dims, given, {"long_name": f"value of {name}"})
    return xr.Dataset(table | outcome_variable(codes) | columns, attrs=attrs)


def outcome_variable(codes: NDArray[np.int8]) -> dict[str, Any]:
    """Return the variable ``outcome`` along ``run``, whose attributes name the codes."""
    flags = {
        "long_name": "outcome of the run",
        "flag_values": np.arange(len(OUTCOMES), dtype=np.int8),
        "flag_meanings": " ".join(outcome.name for outcome in OUTCOMES),
    }
    return {"outcome": ("run", codes, flags)}
