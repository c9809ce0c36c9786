"""Identification of creep from the samples within plateaus."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.estimator import Bools, Floats
from mckibben.identification.fit import DatasetSummary
from mckibben.identification.relaxation import MaxwellElementFit, RelaxationCurves, TimedLoadingPaths
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.units import percent, show

_PARAMETERS = ("stiffness", "time_constant")


@dataclass(frozen=True, eq=False, repr=False)
class CreepFit:
    """Creep in the samples of plateaus, or its absence; returned by `identify_creep`.

    Attributes
    ----------
    creep
        Creep model with one Maxwell element; `NoCreep` if the data show no creep.
    significance
        Relaxation rate in standard errors; significant from 3 on. Negative: the force continues in the direction of the
        move.
    rate, rate_error
        Mean rate of the force against the direction of the preceding move, and its standard error [N/s].
    standard_errors
        Cluster-robust, of ``stiffness`` [N/m] and ``time_constant`` [s]; NaN where not determined.
    time_constant_interval
        95 % profile interval [s]; 0 or infinite where the data impose no bound.
    relative_stiffness
        Stiffness of the element per median stiffness of the muscle [-].
    initial_force, mean_force
        Shape (points,), in dataset order: force in the element at the first sample, and its mean over the samples,
        which is the contribution of creep to a plateau mean [N].
    common_rate
        Rate common to both directions, such as sensor drift [N/s].
    interval
        Sampling interval [s].
    points_used, warnings, dataset
        Number of plateaus used, reasons not to rely on the results, and summary of the data.
    """

    creep: MaxwellCreep | NoCreep
    significance: float
    rate: float
    rate_error: float
    initial_force: Floats
    mean_force: Floats
    common_rate: float
    interval: float
    points_used: int
    warnings: tuple[str, ...]
    dataset: DatasetSummary
    standard_errors: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_PARAMETERS, math.nan))
    time_constant_interval: tuple[float, float] = (math.nan, math.nan)
    relative_stiffness: float = 0.0

    @property
    def is_significant(self) -> bool:
        """True if the data show creep."""
        return isinstance(self.creep, MaxwellCreep)

    def relaxation(self, times: ArrayLike) -> Floats:
        """Force of creep [N] at each point at times [s] after its first sample; shape (points, times)."""
        times = np.asarray(times, np.float64)
        if isinstance(self.creep, NoCreep):
            return np.zeros((len(self.initial_force), len(times)))
        return self.initial_force[:, None] * np.exp(-times / self.creep.time_constant)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """Plateau means of the identified dataset without creep; `IdentificationError` for any other dataset."""
        means = dataset.plateau_means()
        if len(means) != len(self.mean_force):
            raise IdentificationError(
                f"{means!r} is not the dataset that the creep was identified from", remedy="give the whole dataset"
            )
        return IsobaricDataset(means.table.assign(force=("point", means.force - self.mean_force)))

    def report(self) -> str:
        """Fit as text."""
        lines = [
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} plateaus used",
            f"relaxation rate within a plateau: {self.rate:.3g} N/s (standard error {self.rate_error:.2g}), "
            f"{self.significance:.1f} standard errors",
        ]
        if isinstance(self.creep, MaxwellCreep):
            creep, errors, (lower, upper) = self.creep, self.standard_errors, self.time_constant_interval
            lines += [
                "",
                f"{'':13}  {'estimate':>8}  {'standard error':>14}",
                f"{'stiffness':13}  {creep.stiffness / 1e3:>8.4g}  {errors['stiffness'] / 1e3:>14.2g}  N/mm, "
                f"{self.relative_stiffness / percent:.2g} % of the muscle's",
                f"{'time constant':13}  {creep.time_constant:>8.4g}  {errors['time_constant']:>14.2g}  s, "
                f"95 % interval {lower:.3g} .. {upper:.3g} s",
                f"largest force at a first sample: {show(float(np.abs(self.initial_force).max(initial=0.0)), 'N', 3)}",
            ]
        else:
            lines.append("no significant creep")
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def __repr__(self) -> str:
        found = "no significant creep"
        if isinstance(self.creep, MaxwellCreep):
            found = f"{self.creep.stiffness / 1e3:.3g} N/mm, {self.creep.time_constant:.3g} s"
        return f"<CreepFit: {found}, {self.points_used} plateaus>"


_SIGNIFICANT = 3.0  # standard errors
_FEWEST_SAMPLES = 3
_FEWEST_PLATEAUS = 10  # in each direction
_SLIP = 0.25  # of the force: if more relaxes, the element may have slipped
_ROUNDS = 2
_WIDE = 2.5  # ratio of the ends of its interval above which a time constant is not determined
_QUICK, _SLOW = 0.1, 3.0  # range of time constants, in dwells and in durations of the longest path
_REGULATOR = 0.2  # of the force drift: a larger part explained by pressure drift is reported


def identify_creep(dataset: IsobaricDataset, *, interval: float, dwell: float, speed: float) -> CreepFit:
    r"""Identify creep from the samples within plateaus as a Maxwell element in parallel with an arbitrary, unknown law.

    Significance is tested on the mean slopes of the force after stretching and after shortening (docs/hysteresis.md).
    The element is then fitted along all loading paths: the samples of plateau j, less their mean, are

    .. math:: x_j e^{-t/\tau} + v t, \qquad x_j = e^{-t_\mathrm{dwell}/\tau} k\, g_j(\tau)

    with a common rate v and the deflection :math:`g_j` after all moves to the plateau; a slack muscle has none.

    Parameters
    ----------
    dataset
        Raw samples of the force, directions, initial length, and nominal pressures if measured ones scatter, in the
        order of the test or with the times of the first samples.
    interval, dwell
        Sampling interval, and time from the end of a move to the first sample [s].
    speed
        Speed of the moves [m/s].

    Raises
    ------
    IdentificationError
        If there are no samples, too few plateaus, only one direction, or times that contradict the speed.
    RangeError
        If `interval`, `dwell` or `speed` is not positive.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import MaxwellCreep, Muscle
    >>> from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
    >>> from mckibben.units import bar
    >>> law = catalog.law("lei-mas-10-180n")
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law, creep=MaxwellCreep(1000.0, 8.0))
    >>> test = IsobaricProtocol(pressures=[3 * bar, 5 * bar], repeats=2, samples=100, acquisition=5.0)
    >>> data = SimulatedIsobaricTest(muscle, force_noise=0.05).run(test, seed=1)
    >>> found = identify_creep(data, interval=0.05, dwell=test.dwell, speed=test.speed)
    >>> round(found.creep.stiffness, -2), round(found.creep.time_constant, 0)
    (1000.0, 8.0)
    """
    for name, value, unit in (("interval", interval, "s"), ("dwell", dwell, "s"), ("speed", speed, "m/s")):
        if not (math.isfinite(value) and (value > 0 or (name == "dwell" and value == 0))):
            raise RangeError(f"{name} is {value:g} {unit}", value=value, unit=unit, remedy="give a positive number")
    force = _samples(dataset)
    means = dataset.plateau_means()
    paths = TimedLoadingPaths.of(means, dwell, speed, interval * force.shape[1])
    element = MaxwellElementFit(RelaxationCurves.of(force, interval), paths)
    taut = ~means.slack & (means.force > 0)
    rate, error, common = _drift(element.curves.slopes, paths, taut)
    warnings = _pressure_warning(dataset, interval, paths, taut, rate, means)
    found = CreepFit(
        creep=NoCreep(),
        significance=rate / error,
        rate=rate,
        rate_error=error,
        initial_force=np.zeros(len(means)),
        mean_force=np.zeros(len(means)),
        common_rate=common,
        interval=interval,
        points_used=int(taut.sum()),
        warnings=tuple(warnings),
        dataset=DatasetSummary.of(means.select(taut)),
    )
    span = dwell + element.curves.duration
    if found.significance < _SIGNIFICANT:
        return dataclasses.replace(found, warnings=(*warnings, *_insignificant(element, taut, found, span, dwell)))

    ends = max(0.01, _QUICK * dwell, 3 * interval), max(_SLOW * paths.longest, 10 * span)
    used, tau = taut, element.time_constant(taut, *ends)
    for _ in range(_ROUNDS):  # without the points at which the element may have slipped
        relaxing = np.abs(element.stiffness_and_rate(tau, used)[0] * paths.deflection(tau))
        within = taut & (relaxing < _SLIP * means.force)
        if within.sum() < taut.sum() / 2:  # the element is uncertain, as if its time constant is not determined
            break
        _check_directions(paths, within)
        used = within
        tau = element.time_constant(used, *ends)
    stiffness, common = element.stiffness_and_rate(tau, used)
    if not stiffness > 0:
        raise IdentificationError(
            "the force drifts as in creep, but not along the loading paths of the test",
            remedy="check dwell, speed and the order of the rows",
        )
    errors, inflation = element.uncertainty(tau, used)
    time_constants = element.time_constant_interval(tau, used, *ends, inflation)
    if not time_constants[1] < _WIDE * time_constants[0]:
        warnings.append(_undetermined(time_constants, stiffness / tau, span, dwell))
        errors = dict.fromkeys(errors, math.nan)
    bound = np.maximum(means.force, 0.0) / 2
    initial = np.where(taut, np.clip(stiffness * paths.deflection(tau), -bound, bound), 0.0)
    return dataclasses.replace(
        found,
        creep=MaxwellCreep(stiffness, tau),
        standard_errors=errors,
        time_constant_interval=time_constants,
        relative_stiffness=stiffness / paths.stiffness(means, used),
        initial_force=initial,
        mean_force=initial * np.exp(-element.curves.times / tau).mean(),
        common_rate=common,
        points_used=int(used.sum()),
        warnings=tuple(warnings),
        dataset=DatasetSummary.of(means.select(used)),
    )


def _samples(dataset: IsobaricDataset) -> NDArray:
    if "force_samples" not in dataset.table or dataset.table.sizes["sample"] < _FEWEST_SAMPLES:
        raise IdentificationError(
            "the dataset has no raw samples of the force: plateau means do not show relaxation",
            remedy=f"keep at least {_FEWEST_SAMPLES} samples per plateau (NetCDF keeps them, CSV does not)",
        )
    return dataset.table["force_samples"].to_numpy()


def _check_directions(paths: TimedLoadingPaths, used: Bools) -> None:
    for side, word in ((1, "stretching"), (-1, "shortening")):
        count = int(np.count_nonzero(used & (paths.sides == side)))
        if count < _FEWEST_PLATEAUS:
            message = f"{count} taut plateaus follow a move by {word}"
            remedy = f"measure at least {_FEWEST_PLATEAUS} in each direction"
            raise IdentificationError(message, value=count, lower=_FEWEST_PLATEAUS, remedy=remedy)


def _drift(slopes: Floats, paths: TimedLoadingPaths, used: Bools) -> tuple[float, float, float]:
    """Rate against the direction of the move, its standard error, and the common rate of both directions [N/s]."""
    _check_directions(paths, used)
    up, down = (slopes[used & (paths.sides == side)] for side in (1, -1))
    rate = float(down.mean() - up.mean()) / 2
    error = math.sqrt(up.var(ddof=1) / len(up) + down.var(ddof=1) / len(down)) / 2
    return rate, max(error, 1e-300), float(down.mean() + up.mean()) / 2


def _insignificant(element: MaxwellElementFit, used: Bools, found: CreepFit, span: float, dwell: float) -> list[str]:
    """Warnings if there is no significant creep."""
    bound = element.stiffness_and_rate(span, used)[0] + _SIGNIFICANT * element.stiffness_error(span, used)
    onwards = (
        f"the force continues in the direction of the move ({-found.rate:.2g} N/s), which is not relaxation; check the "
        "pressure regulator, and when samples begin"
    )
    detectable = (
        f"an element of {span:.3g} s is detectable from {bound / 1e3:.2g} N/mm on; faster ones have relaxed before the "
        f"first sample ({dwell:g} s), slower ones hardly relax within {element.curves.duration:.3g} s"
    )
    return [onwards, detectable] if found.significance < -_SIGNIFICANT else [detectable]


def _undetermined(interval: tuple[float, float], ratio: float, span: float, dwell: float) -> str:
    """Warning of a time constant that the data do not determine."""
    low, high = interval
    if high == math.inf:
        return (
            f"the time constant is not determined: at least {low:.3g} s, as a plateau of {span:.3g} s is too short; "
            f"stiffness per time constant is {ratio / 1e3:.3g} N/mm/s"
        )
    if low == 0:
        return (
            f"the time constant is not determined: at most {high:.3g} s, as the wait of {dwell:g} s before the first "
            "sample is too long; sample sooner"
        )
    return (
        f"the time constant is not determined: {low:.3g} to {high:.3g} s; sample for longer than {span - dwell:.3g} s, "
        "sooner after a move, or more plateaus"
    )


def _pressure_warning(
    dataset: IsobaricDataset,
    interval: float,
    paths: TimedLoadingPaths,
    used: Bools,
    rate: float,
    means: IsobaricDataset,
) -> list[str]:
    """Warning of a pressure that drifts within plateaus with the direction of the move."""
    if "pressure_samples" not in dataset.table:
        return ["without pressure samples, a slow pressure regulator cannot be distinguished from creep"]
    slopes = RelaxationCurves.of(dataset.table["pressure_samples"].to_numpy(), interval).slopes
    drift, error, _ = _drift(slopes, paths, used)
    pressurised = used & (means.pressure > 0)
    if not pressurised.any():
        return []
    equivalent = drift * float(np.median(means.force[pressurised] / means.pressure[pressurised]))
    if abs(drift) < _SIGNIFICANT * error or abs(equivalent) < _REGULATOR * abs(rate):
        return []
    return [
        f"the pressure drifts too, by {drift:.3g} Pa/s against the direction of the move, which explains some "
        f"{equivalent:.2g} N/s of the {rate:.2g} N/s: that part is due to the regulator, not creep"
    ]
