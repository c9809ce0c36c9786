"""Identification of creep: relaxation of the force within plateaus, after moves or after steps of the pressure."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset, Recording
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.estimator import Bools, Floats, t_quantile
from mckibben.identification.loading_path import LoadingPaths
from mckibben.identification.pressure_plateaus import DelayedForce, RecordedBins
from mckibben.identification.relaxation import GRID, RelaxationFit
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.muscle.creep import retained_fraction
from mckibben.result import Remark, Result, column
from mckibben.units import percent

_SIGNIFICANT = 0.01
_WIDE = 2.5  # ratio of the ends of its interval above which a time constant is not determined
_ROUNDS = 2


class CreepFit(Result):
    """Creep within plateaus, or its absence; returned by `identify_creep` and `identify_pressure_creep`.

    Attributes
    ----------
    creep
        `MaxwellCreep` with one element: a stiffness after moves, a `pressure_share` after steps of the pressure;
        `NoCreep` if no creep is significant.
    p_value
        Upper bound of the probability of this reduction of the squares if there is no creep (test of the nested models,
        with errors that are correlated within plateaus). Creep is significant below 0.01.
    amplitude, amplitude_interval
        Stiffness of the element [N/m], or share of the law that follows with a delay [-], and its 95 % interval;
        infinite where the data impose no bound on the time constant, with which it varies.
    time_constant, time_constant_interval
        Time constant [s] and its 95 % profile interval; 0 or infinite where the data impose no bound.
    residual, creep_force
        Root mean square [N] of the residuals within plateaus, averaged to 16 blocks each, and of the fitted creep.
    common_rate
        Rate of the force common to all plateaus, such as sensor drift [N/s].
    plateaus
        Number of plateaus used.
    notes
        Reasons not to rely on the results.
    mean_force
        After moves: shape (points,), mean force in the element [N], the contribution of creep to a plateau mean.
    """

    creep: MaxwellCreep | NoCreep
    p_value: float = column("1", "probability without creep", digits=2)
    amplitude: float = column("", "stiffness [N/m] or share")
    amplitude_interval: tuple[float, float]
    time_constant: float = column("s", "time constant", digits=3)
    time_constant_interval: tuple[float, float]
    residual: float = column("N", "RMS residual", digits=2)
    creep_force: float = column("N", "RMS creep", digits=2)
    common_rate: float = column("N/s", "rate common to all plateaus", digits=2)
    plateaus: int = column("", "plateaus used")
    notes: tuple[Remark, ...] = ()
    mean_force: Floats | None = None

    @property
    def is_significant(self) -> bool:
        """True if creep is significant."""
        return isinstance(self.creep, MaxwellCreep)

    def verdict(self) -> str:
        """Return amplitude and time constant with their intervals."""
        if not self.is_significant:
            return f"no significant creep in {self.plateaus} plateaus (p = {self.p_value:.2g})"
        (low, high), (short, long) = self.amplitude_interval, self.time_constant_interval
        name, unit, size = ("share", "%", percent) if self.mean_force is None else ("stiffness", "N/mm", 1e3)
        span = f"{low / size:.3g} .. {high / size:.3g}" if math.isfinite(low) else "not determined"
        return (
            f"creep with a {name} of {self.amplitude / size:.3g} {unit} ({span}) and a time constant of "
            f"{self.time_constant:.3g} s ({short:.3g} .. {long:.3g}), 95 % intervals in parentheses"
        )

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """Plateau means of the identified dataset without creep; `IdentificationError` for any other dataset."""
        means = dataset.plateau_means()
        if self.mean_force is None or len(means) != len(self.mean_force):
            raise IdentificationError(
                f"{means!r} is not the dataset that the creep was identified from", remedy="give the whole dataset"
            )
        return IsobaricDataset(means.table.assign(force=("point", means.force - self.mean_force)))


def _result(
    fit: RelaxationFit, creep: MaxwellCreep | NoCreep, notes: Sequence[Remark], mean_force: Floats | None
) -> CreepFit:
    """Result of a fit, with the creep if it is significant."""
    amplitude, rate, residuals, _ = fit.solution
    tau, (low, high) = fit.time_constant, fit.time_constant_interval
    half = float(t_quantile(0.95, fit.error[2])) * fit.error[0] if 0 < low and high < math.inf else math.inf
    significant = fit.p_value < _SIGNIFICANT and isinstance(creep, MaxwellCreep)
    notes = list(notes)
    if significant and not high < _WIDE * low:
        bounds = f"at least {low:.3g} s" if high == math.inf else f"{low:.3g} to {high:.3g} s"
        bounds = f"at most {high:.3g} s" if low == 0 else bounds
        remedy = "record longer plateaus, sooner after the step, or more of them"
        notes.append(Remark.warning("time_constant", f"the time constant is not determined: {bounds}", remedy))
    return CreepFit(
        creep=creep if significant else NoCreep(),
        p_value=fit.p_value,
        amplitude=amplitude,
        amplitude_interval=(amplitude - half, amplitude + half),
        time_constant=tau,
        time_constant_interval=(low, high),
        residual=fit.root_mean_square(residuals),
        creep_force=fit.root_mean_square(amplitude * fit.columns(np.array([tau]))[:, 0]),
        common_rate=rate,
        plateaus=int(fit.owner.max()) + 1,
        notes=tuple(notes),
        mean_force=mean_force if mean_force is None or significant else np.zeros_like(mean_force),
    )


# Creep after steps of the pressure ------------------------------------------------------------------------------------

_STRUCTURED, _LEAST_PART = 1e-3, 0.05  # p-value, and part of the creep, of a dependence that is reported
_FURTHER = 4.0  # ratio to the time constant of further ones that are tested


def identify_pressure_creep(recordings: Recording | Sequence[Recording]) -> CreepFit:
    r"""Identify the share of the force that follows steps of the pressure with a delay, at fixed lengths.

    Within plateau j of the pressure

    .. math:: F = a_j + b_j p + f(p) + \varphi \big(f(y) - f(p)\big) + v t, \qquad \dot y = \frac{p - y}{\tau}

    with a free line over the pressure per plateau, a rate v common to all, and the force f over the pressure at each
    length, interpolated between the means of the plateaus (docs/hysteresis.md).

    Parameters
    ----------
    recordings
        Recordings of isometric tests: each at one fixed length, or at several lengths one after another.

    Raises
    ------
    IdentificationError
        If there are fewer than 3 levels of the pressure at each length, or fewer than 6 plateaus.

    Examples
    --------
    Steps between 1, 2 and 3 bar at 100 N/bar, of which 8 % follow with 4 s:

    >>> import numpy as np
    >>> time = np.arange(0, 120, 0.01)
    >>> pressure, delayed = 1e5 * (1 + np.array([0, 1, 2, 1, 0, 2])[(time // 20).astype(int)]), np.full(len(time), 1e5)
    >>> for k in range(1, len(time)):
    ...     delayed[k] = delayed[k - 1] + 0.01 / 4 * (pressure[k - 1] - delayed[k - 1])
    >>> noise = np.random.default_rng(1).normal(0, 0.2, len(time))
    >>> force = 1e-3 * (pressure + 0.08 * (delayed - pressure)) + noise
    >>> fit = identify_pressure_creep(Recording.of(time=time, pressure=pressure, force=force, contraction=0.05))
    >>> round(fit.amplitude, 2), round(fit.time_constant, 1), fit.plateaus
    (0.08, 4.0, 6)
    """
    bins = [RecordedBins.of(one) for one in ([recordings] if isinstance(recordings, Recording) else recordings)]
    delayed = DelayedForce.of(bins)
    fit = delayed.fit()
    for _ in range(_ROUNDS):
        delayed = delayed.corrected(fit)
        fit = delayed.fit()
    share = fit.solution[0]
    bounded = min(max(share, -0.5), 0.5)
    notes = [] if fit.p_value >= _SIGNIFICANT else list(_structure(fit, delayed.conditions()))
    if bounded != share and fit.p_value < _SIGNIFICANT:
        text = f"the share of {share / percent:.3g} % is beyond the 50 % of the form"
        notes.append(Remark.warning("creep", text))
    return _result(fit, MaxwellCreep(0.0, fit.time_constant, pressure_share=bounded), notes, None)


def _structure(fit: RelaxationFit, conditions: dict[str, Floats]) -> Iterable[Remark]:
    """Remarks on significant dependences that the residuals show, and that the form lacks."""
    from scipy.special import fdtrc

    base = fit.columns(np.array([fit.time_constant]))
    base = np.column_stack([base, fit.line])
    creep, scale = base[:, 0], fit.root_mean_square(fit.solution[0] * base[:, 0])
    further = {
        f"the share depends on the {name}": creep[:, None] * (values - values.mean())[fit.owner][:, None]
        for name, values in conditions.items()
    }
    tau = fit.time_constant
    others = np.array([tau * math.exp(1e-3), tau / _FURTHER, tau * _FURTHER])
    further["the relaxation has more than one time constant"] = fit.columns(others)
    for text, columns in further.items():
        every = np.column_stack([base, columns])
        values, residuals, _ = fit.least_squares(every)
        variance, freedom = fit.errors(every, residuals)
        chances = fdtrc(1, freedom[2:], values[2:] ** 2 / variance[2:])
        p_value = min(1.0, len(chances) * float(chances.min()))
        part = fit.root_mean_square(columns @ values[2:]) / scale
        if p_value < _STRUCTURED and part > _LEAST_PART:
            size = f"({part / percent:.2g} % of the creep, p = {p_value:.1g})"
            yield Remark.warning("creep", f"the residuals are structured: {text}, which the form lacks {size}")


# Creep after moves ----------------------------------------------------------------------------------------------------

_FEWEST_SAMPLES = 3
_FEWEST_PLATEAUS = 10  # in each direction
_SLIP = 0.25  # of the force: if more relaxes, the element may have slipped
_QUICK, _SLOW = 0.1, 3.0  # range of time constants, in dwells and in durations of the longest path
_BLOCKS = 16  # blocks to which the samples of a plateau are averaged: an exponential is smooth
_CLOCK_ERROR = 0.05  # s, of the times of points
_REGULATOR = 0.2  # of the creep: a larger part that the drift of the pressure explains is reported


def identify_creep(dataset: IsobaricDataset, *, interval: float, dwell: float, speed: float) -> CreepFit:
    r"""Identify creep from the samples within plateaus as a Maxwell element in parallel with an arbitrary, unknown law.

    The element is fitted along all loading paths: the samples of plateau j, less their mean, are

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
    >>> fit = identify_creep(data, interval=0.05, dwell=test.dwell, speed=test.speed)
    >>> round(fit.creep.stiffness, -2), round(fit.creep.time_constant, 0)
    (1000.0, 8.0)
    """
    for name, value, unit in (("interval", interval, "s"), ("dwell", dwell, "s"), ("speed", speed, "m/s")):
        if not (math.isfinite(value) and (value > 0 or (name == "dwell" and value == 0))):
            raise RangeError(f"{name} is {value:g} {unit}", value=value, unit=unit, remedy="give a positive number")
    if "force_samples" not in dataset.table or dataset.table.sizes["sample"] < _FEWEST_SAMPLES:
        raise IdentificationError(
            "the dataset has no raw samples of the force: plateau means do not show relaxation",
            remedy=f"keep at least {_FEWEST_SAMPLES} samples per plateau (NetCDF keeps them, CSV does not)",
        )
    means, samples = dataset.plateau_means(), dataset.table["force_samples"].to_numpy()
    paths = _TimedPaths.of(means, dwell, speed, interval * samples.shape[1])
    times = np.arange(samples.shape[1]) * interval
    span = dwell + float(times[-1])
    grid = np.geomspace(max(0.01, _QUICK * dwell, 3 * interval), max(_SLOW * paths.longest, 10 * span), GRID)
    taut = used = ~means.slack & (means.force > 0)
    fit = paths.fit(samples, times, used, grid)
    for _ in range(_ROUNDS):  # without the points at which the element may have slipped
        within = taut & (np.abs(fit.solution[0] * paths.deflection(fit.time_constant)) < _SLIP * means.force)
        if within.sum() < taut.sum() / 2:  # the element is uncertain, as if its time constant is not determined
            break
        used = within
        fit = paths.fit(samples, times, used, grid)
    stiffness, tau = fit.solution[0], fit.time_constant
    notes = []
    if stiffness <= 0:
        text = "the force continues in the direction of the move, which is not relaxation"
        notes = [Remark.warning("creep", text, "check the pressure regulator, dwell, speed and the order of the rows")]
    elif "pressure_samples" not in dataset.table:
        text = "without pressure samples, a slow pressure regulator cannot be distinguished from creep"
        notes = [Remark.note("creep", text)]
    else:
        pressure = paths.fit(dataset.table["pressure_samples"].to_numpy(), times, used, grid)
        columns = np.column_stack([fit.columns(np.array([tau])), fit.line])
        (drift, _), residuals, _ = pressure.least_squares(columns)
        pressurised = used & (means.pressure > 0)
        gain = float(np.median(means.force[pressurised] / means.pressure[pressurised])) if pressurised.any() else 0.0
        sure = abs(drift) > 3 * math.sqrt(pressure.errors(columns, residuals)[0][0])
        if sure and abs(drift * gain) > _REGULATOR * stiffness:
            text = f"the pressure drifts too, which explains {100 * drift * gain / stiffness:.2g} % of the creep"
            notes = [Remark.warning("creep", text, "that part is due to the regulator")]
    bound = np.maximum(means.force, 0.0) / 2
    initial = np.where(taut, np.clip(stiffness * paths.deflection(tau), -bound, bound), 0.0)
    creep = MaxwellCreep(stiffness, tau) if stiffness > 0 else NoCreep()
    return _result(fit, creep, notes, initial * np.exp(-times / tau).mean())


@dataclasses.dataclass(frozen=True, eq=False)
class _TimedPaths:
    """Loading paths with the durations of moves and plateaus [s]."""

    paths: LoadingPaths
    moving: Floats
    before: Floats
    slack: Bools
    dwell: float

    @classmethod
    def of(cls, means: IsobaricDataset, dwell: float, speed: float, acquisition: float) -> _TimedPaths:
        """Paths of plateau means, with dwell and duration of the samples [s], and speed of the moves [m/s]."""
        if len(means.directions) < 2:
            raise IdentificationError(
                "the dataset lacks one direction: sensor drift cannot be distinguished from creep",
                remedy="measure while stretching and while shortening, and give the direction of each point",
            )
        paths = LoadingPaths.of(means)
        moving = np.abs(paths.displacement) / speed
        before = moving + dwell + acquisition
        if "time" in means.table:
            time = means.table["time"].to_numpy()[paths.place]
            elapsed = np.diff(time, axis=0, prepend=time[:1])
            real = np.arange(len(time))[:, None] < paths.counts
            real[0] = False
            lacking = float((before - elapsed)[real].max(initial=-math.inf))
            if lacking > _CLOCK_ERROR:
                message = f"move, wait and samples take {lacking:.3g} s longer than the time between two points"
                remedy = "check interval, dwell, speed and the times of the points"
                raise IdentificationError(message, value=lacking, unit="s", remedy=remedy)
            before = np.where(real, elapsed, before)
        return cls(paths, moving, before, means.slack[paths.place], dwell)

    @property
    def longest(self) -> float:
        """Duration of the longest path [s]."""
        return float(self.before.sum(axis=0).max())

    def deflection(self, time_constant: float) -> Floats:
        """Deflection [m] of a Maxwell element's spring at the first sample, shape (rows,)."""
        decay = np.exp(-self.before / time_constant)
        added = self.paths.displacement * retained_fraction(self.moving, time_constant)
        deflections = np.empty_like(added)
        now = np.zeros(added.shape[1])
        for k in range(len(added)):
            now = np.where(self.slack[k], 0.0, now * decay[k] + added[k])
            deflections[k] = now
        return self.paths.scattered(deflections) * math.exp(-self.dwell / time_constant)

    def fit(self, samples: NDArray, times: Floats, used: Bools, grid: Floats) -> RelaxationFit:
        """Fit to the samples of the used plateaus, shape (rows, samples), averaged in blocks."""
        displacement = self.paths.scattered(self.paths.displacement)
        for side, word in ((1, "stretching"), (-1, "shortening")):
            count = int(np.count_nonzero(used & (side * displacement > 1e-9)))
            if count < _FEWEST_PLATEAUS:
                message = f"{count} taut plateaus follow a move by {word}"
                remedy = f"measure at least {_FEWEST_PLATEAUS} in each direction"
                raise IdentificationError(message, value=count, lower=_FEWEST_PLATEAUS, remedy=remedy)
        edges = np.unique(np.linspace(0, len(times), min(_BLOCKS, len(times)) + 1).astype(np.int64))
        sizes, plateaus = np.diff(edges), int(used.sum())

        def blocks(curves: NDArray) -> Floats:
            """Curves, shape (..., samples), averaged in blocks, less their mean."""
            means = np.add.reduceat(curves, edges[:-1], axis=-1, dtype=np.float64) / sizes
            return means - (means @ sizes / len(times))[..., None]

        def columns(time_constants: Floats) -> Floats:
            courses = blocks(np.exp(-times / time_constants[:, None]))
            return np.column_stack(
                [
                    np.outer(self.deflection(tau)[used], course).ravel()
                    for tau, course in zip(time_constants, courses, strict=True)
                ]
            )

        line, weight = np.tile(blocks(times), plateaus), np.tile(sizes / len(times), plateaus)
        owner = np.repeat(np.arange(plateaus), len(sizes))
        return RelaxationFit(blocks(samples[used]).ravel(), line, weight, owner, columns, grid, removed=1)
