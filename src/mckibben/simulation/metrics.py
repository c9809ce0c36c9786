"""Metrics: numbers to which the trajectory of a run is reduced, by sums and maxima over its control periods."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.component.columns import Label, labelled, labels_of
from mckibben.mechanism.base import over_joints
from mckibben.simulation.oscillation import Oscillation, Signals
from mckibben.simulation.trajectories import Trajectory

M = TypeVar("M")


class Totals(NamedTuple):
    """Sums and maxima by name; of one control period, of some, or of all.

    Metrics with the same term share it: the RMS and the largest error are made of one error, which is computed once.
    """

    sums: dict[str, PyTree]
    maxima: dict[str, PyTree]

    @classmethod
    def of(cls, metrics: Iterable[Metric], sample: PyTree) -> Totals:
        """Totals of single control periods, elementwise: of scalars, or of arrays of shape (periods,)."""
        totals = cls({}, {})
        for metric in metrics:
            terms = metric.terms(sample)
            totals.sums.update(terms.sums)
            totals.maxima.update(terms.maxima)
        return totals

    def empty(self) -> Totals:
        """Totals of no control period."""
        return jax.tree.map(jnp.zeros_like, self)

    def merge(self, other: Totals) -> Totals:
        """Totals of the periods of both."""
        return Totals(
            jax.tree.map(operator.add, self.sums, other.sums), jax.tree.map(larger, self.maxima, other.maxima)
        )


class Run(NamedTuple):
    """A whole run: number of control periods, their length [s], what has been tracked, and the last change."""

    periods: Array
    period: ArrayLike
    tracked: PyTree = None  # from each control period to the next
    change: PyTree = None  # of the desired stiffness


@dataclass(frozen=True)
class Metric(Label, abc.ABC):
    """Number to which a run is reduced, the annotation of a field of a class of metrics.

    It is made of terms of single control periods, which are added or whose largest is kept, so that a run of any
    duration needs the same memory, and a batch can be computed in lanes.
    """

    _: KW_ONLY
    of: str  # name of the quantity of a sample that it is made of

    def terms(self, sample: PyTree) -> Totals:
        """Return the terms of single control periods, by names that metrics may share.

        `sample` has the quantity `of` as an attribute, a scalar or an array of shape (periods,).
        """
        return Totals({}, {})

    @abc.abstractmethod
    def value(self, totals: Totals, run: Run) -> PyTree:
        """Return the metric of a whole run."""


class RootMeanSquare(Metric):
    """Root mean square of an error; its derivative at 0 is 0."""

    def terms(self, sample: PyTree) -> Totals:
        return Totals({f"{self.of}^2": jax.tree.map(jnp.square, getattr(sample, self.of))}, {})

    def value(self, totals: Totals, run: Run) -> PyTree:
        return jax.tree.map(lambda square: root(square / run.periods), totals.sums[f"{self.of}^2"])


class Largest(Metric):
    """Largest value of a quantity, 0 if all are below."""

    def terms(self, sample: PyTree) -> Totals:
        return Totals({}, {self.of: getattr(sample, self.of)})

    def value(self, totals: Totals, run: Run) -> PyTree:
        return totals.maxima[self.of]


class LargestError(Metric):
    """Largest absolute value of a quantity."""

    def terms(self, sample: PyTree) -> Totals:
        return Totals({}, {f"|{self.of}|": jax.tree.map(jnp.abs, getattr(sample, self.of))})

    def value(self, totals: Totals, run: Run) -> PyTree:
        return totals.maxima[f"|{self.of}|"]


class Total(Metric):
    """Sum of a quantity over the control periods."""

    def terms(self, sample: PyTree) -> Totals:
        return Totals({self.of: getattr(sample, self.of)}, {})

    def value(self, totals: Totals, run: Run) -> PyTree:
        return totals.sums[self.of]


class Duration(Total):
    """Time [s] with a flag, which is 0 or 1."""

    def value(self, totals: Totals, run: Run) -> PyTree:
        return totals.sums[self.of] * run.period


class LargerRate(Metric):
    """Largest of the sums of a quantity of the muscles, per second."""

    def terms(self, sample: PyTree) -> Totals:
        return Totals({self.of: getattr(sample, self.of)}, {})

    def value(self, totals: Totals, run: Run) -> PyTree:
        return functools.reduce(larger, totals.sums[self.of]) / (run.periods * run.period)


class Tracked(Metric):
    """Quantity of the state that is tracked from each control period to the next, at the end of a run."""

    def value(self, totals: Totals, run: Run) -> PyTree:
        return getattr(run.tracked, self.of)


@functools.cache
def metrics_of(kind: type) -> dict[str, Metric]:
    """Return the metrics of a class by name."""
    return cast(dict[str, Metric], labels_of(kind))


def values_of(kind: type[M], totals: Totals, run: Run) -> M:
    """Return the metrics of a class, of a whole run."""
    return kind(**{name: metric.value(totals, run) for name, metric in metrics_of(kind).items()})


def root(mean: Array) -> Array:
    """The square root; its derivative at 0 is 0."""
    return jnp.where(mean > 0, jnp.sqrt(jnp.where(mean > 0, mean, 1.0)), mean)


def larger(first: ArrayLike, second: ArrayLike) -> Array:
    """The larger of two, NaN if one of them is: XLA's own maximum does not always propagate it."""
    first, second = jnp.asarray(first), jnp.asarray(second)
    return jnp.where((first >= second) | jnp.isnan(first), first, second)


SETTLING_PART = 0.1
"""Half the width of the settling band, as a fraction of the step of the desired stiffness."""
_END = 10  # the last 1/10 of a run is its end
_SETTLED = 10  # the last 1/10 of the time since the change has to be inside the band
_BAND_FLOOR = 1e-3  # least half width of the band, as a fraction of the setpoint


class SettlingTime(Largest):
    """Time [s] from the last change until a quantity, the number of the period from 1 if outside a band, stays 0."""

    def value(self, totals: Totals, run: Run) -> PyTree:
        def of_joint(last: Array, change: Change) -> Array:
            unsettled = jnp.maximum(last - 1, change.at - 1)
            in_band = run.periods - 1 - unsettled  # periods at the end
            never = (_SETTLED * in_band < run.periods - change.at) | ((change.at > 0) & ~change.ends)
            return jnp.where(never, jnp.nan, (unsettled + 1 - change.at) * run.period)

        return over_joints(of_joint, totals.maxima[self.of], run.change)


class LargestAfterChange(Largest):
    """Largest value of a quantity since the last change of the setpoint; NaN without one."""

    def value(self, totals: Totals, run: Run) -> PyTree:
        return over_joints(
            lambda largest, change: jnp.where(change.ends, largest, jnp.nan), totals.maxima[self.of], run.change
        )


@labelled
class Metrics(NamedTuple):
    """Numbers in SI; errors are those of the plant's true angle and stiffness from the setpoints.

    Those along joints are scalars of an unnamed joint, else tuples.
    """

    angle_rmse: Annotated[
        Array,
        RootMeanSquare("rad", "root mean square error of the angle", of="angle_error", shown="deg", along="joint"),
    ]
    angle_max: Annotated[
        Array, LargestError("rad", "largest error of the angle", of="angle_error", shown="deg", along="joint")
    ]
    stiffness_rmse: Annotated[
        Array, RootMeanSquare("N*m/rad", "root mean square error of the stiffness", of="stiffness_error", along="joint")
    ]
    stiffness_max: Annotated[
        Array, LargestError("N*m/rad", "largest error of the stiffness", of="stiffness_error", along="joint")
    ]
    stiffness_settling: Annotated[
        Array,
        SettlingTime(
            "s",
            "settling time of the stiffness",
            of="unsettled",
            along="joint",
            note="from the last change of the desired stiffness, or from the start if it never changes; NaN if the "
            "stiffness is not in the settling band for at least the last tenth of the time since the change (a limit "
            "cycle, or an entry just before the end), or if the setpoint ends with a ramp or changes until the "
            "very end",
        ),
    ]
    coupling: Annotated[
        Array,
        LargestAfterChange(
            "rad",
            "largest change of the angle by the last change of the desired stiffness",
            of="coupling",
            along="joint",
            shown="deg",
            note="from the same run without that change; NaN if the desired stiffness never changes, ends with a ramp "
            "or changes until the very end",
        ),
    ]
    estimate_rmse: Annotated[
        Array,
        RootMeanSquare(
            "N*m/rad",
            "root mean square error of the estimated stiffness",
            of="estimate_error",
            along="joint",
            note="NaN if the controller has no estimate",
        ),
    ]
    time_saturated: Annotated[Array, Duration("s", "time with a command at a pressure limit", of="saturated")]
    time_slack: Annotated[Array, Duration("s", "time with a muscle slack", of="slack")]
    time_outside_domain: Annotated[Array, Duration("s", "time with a muscle outside its domain", of="outside_domain")]
    time_overloaded: Annotated[Array, Duration("s", "time with a muscle above its rated force", of="overloaded")]
    force_max: Annotated[Array, Largest("N", "largest tension", of="force")]
    air: Annotated[
        Array,
        Total(
            "m^3",
            "air consumption, as a volume at atmospheric pressure",
            of="inflow",
            shown="L",
            note="sum of the rises of the muscles' contents at room temperature, as what is let out is lost; NaN where "
            "the volumes are not known",
        ),
    ]
    oscillation_amplitude: Annotated[
        Array,
        Tracked(
            "rad",
            "amplitude of a limit cycle of the angle",
            of="angle",
            along="joint",
            shown="deg",
            note="0 without one",
        ),
    ]
    oscillation_period: Annotated[
        Array, Tracked("s", "period of a limit cycle of the angle", of="period", along="joint", note="NaN without one")
    ]
    stiffness_oscillation: Annotated[
        Array,
        Tracked(
            "N*m/rad",
            "amplitude of a limit cycle of the stiffness",
            of="stiffness",
            along="joint",
            note="0 without one",
        ),
    ]
    command_oscillation: Annotated[
        Array, Tracked("Pa", "amplitude of a limit cycle of a command", of="command", shown="bar", note="0 without one")
    ]
    command_reversals: Annotated[
        Array, Tracked("1/s", "reversals of a command per second", of="reversals", note="of 0.1 bar or more")
    ]
    command_travel: Annotated[Array, LargerRate("Pa/s", "travel of a command per second", of="travel", shown="bar/s")]


def usual_metrics(kind: Any) -> tuple[str, ...]:
    """Return the metrics of a class that batches compute unless others are asked for: `coupling` needs a second run."""
    return tuple(name for name in kind._fields if name != "coupling")


USUAL_METRICS = usual_metrics(Metrics)
"""Those of a joint."""

OF_STIFFNESS_SETPOINT = ("stiffness_rmse", "stiffness_max", "stiffness_settling", "coupling")
"""Metrics that are NaN without a setpoint of the stiffness, as of one muscle alone."""

_SUFFIXES = {"N*m/rad": "", "1/s": "_per_s", "bar/s": "_bar_per_s"}
METRICS: dict[str, tuple[str, str, float]] = {
    f"{name}{_SUFFIXES.get(label.shown_unit, f'_{label.shown_unit}')}": (name, label.shown_unit, label.size)
    for name, label in metrics_of(Metrics).items()
}
"""Field of `Metrics`, shown unit and its factor to SI, by the name in results."""


def measure(
    moved: Trajectory,
    period: ArrayLike,
    angle_resolution: ArrayLike = 0.0,
    change: Change | None = None,
    scale: float = 1.0,
) -> Metrics:
    """Metrics of a trajectory.

    Parameters
    ----------
    moved
        Columns of shape (periods,), SI.
    period
        Control period [s].
    angle_resolution
        Step of the sensor of the angle [rad].
    change
        Last change of the desired stiffness, if it is known (`last_change`).
    scale
        That of the `JointType`.
    """
    change = over_joints(last_change, moved.desired_stiffness) if change is None else change
    moved = jax.tree.map(jnp.asarray, moved)
    periods = jnp.asarray(moved.saturated.shape[0])

    def following(so_far: Accumulation, at: tuple[Array, Trajectory]) -> tuple[Accumulation, None]:
        return so_far.after(at[1], at[0], periods, change, angle_resolution, scale), None

    start = Accumulation.empty(form_of_period(moved))
    so_far, _ = lax.scan(following, start, (lax.iota(int, moved.saturated.shape[0]), moved))
    return values_of(Metrics, so_far.totals, so_far.run(periods, period, change))


def form_of_period(values: PyTree) -> PyTree:
    """Return shapes and types of one control period of arrays, whose elements are used one after the other alone."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), values)


class Change(NamedTuple):
    """Last change of the desired stiffness."""

    at: Array  # first control period with the new setpoint; 0 if it never changes
    before: Array  # setpoint [N*m/rad]
    after: Array  # setpoint at the end of the run [N*m/rad]
    ends: Array  # whether there is a change, a step and not the end of a ramp, and a time after it without one


def first_of_end(periods: Any) -> Any:
    """First control period of the end of a run, its last tenth."""
    return periods - (periods // _END + (periods < _END))


def last_change(setpoints: ArrayLike, xp: Any = jnp) -> Change:
    """Return the last change of setpoints of shape (periods, ...); `xp` computes it, `jax.numpy` or `numpy`.

    >>> import numpy as np
    >>> change = last_change([14.0, 14.0, 16.0, 16.0], np)
    >>> int(change.at), float(change.before), float(change.after), bool(change.ends)
    (2, 14.0, 16.0, True)
    """
    desired: Any = xp.asarray(setpoints)
    differ = (desired[1:] != desired[:-1]) & ~xp.isnan(desired[1:])  # NaN without a setpoint
    changed = xp.concatenate([xp.zeros_like(desired[:1], dtype=bool), differ])
    number = xp.arange(len(desired)).reshape(-1, *[1] * (desired.ndim - 1))
    index = xp.max(xp.where(changed, number, 0), axis=0)
    earlier = xp.maximum(index - 1, 0)[None]
    before, ramp = (xp.take_along_axis(rows, earlier, axis=0)[0] for rows in (desired, changed))
    return Change(index, before, desired[-1], (index > 0) & (index < len(desired) - 1) & ~ramp)


class MetricSample(NamedTuple):
    """Quantities of a control period that metrics are made of; flags are 0 or 1. The first six are by joint."""

    angle_error: PyTree  # [rad]
    angle_error_at_end: PyTree  # [rad], 0 before the end of the run
    stiffness_error: PyTree  # [N*m/rad]
    estimate_error: PyTree  # [N*m/rad]
    unsettled: PyTree  # number of the period from 1, if the stiffness is outside its band; else 0
    coupling: PyTree  # [rad], 0 before the change
    saturated: Array
    slack: Array
    outside_domain: Array
    overloaded: Array
    force: Array  # [N]
    inflow: Array  # [m^3]
    travel: tuple[Array, ...]  # of the commands [Pa]

    @classmethod
    def of(
        cls,
        moved: Trajectory,
        index: ArrayLike,
        periods: Array,
        change: PyTree,
        stiffness_at_change: PyTree,
        before: Before,
    ) -> MetricSample:
        """Samples of single control periods, elementwise: scalars or shape (periods,)."""
        index, error = jnp.asarray(index), functools.partial(over_joints, _difference)
        angle_error, stiffness_error = (
            error(moved.angle, moved.desired_angle),
            error(moved.stiffness, moved.desired_stiffness),
        )

        rises = map(_difference, moved.air, before.air)

        def number(flag: ArrayLike) -> Array:
            return jnp.asarray(flag).astype(jax.tree.leaves(stiffness_error)[0].dtype)

        def unsettled(error: Array, change: Change, at_change: ArrayLike) -> Array:
            settled = jnp.abs(error) <= _band(change, at_change)
            return number(jnp.where((index >= change.at) & ~settled, index + 1, 0))

        def coupling(angle: ArrayLike, without: ArrayLike, change: Change) -> Array:
            return jnp.where(index >= change.at, jnp.abs(_difference(angle, without)), 0.0)

        return cls(
            angle_error=angle_error,
            angle_error_at_end=over_joints(
                lambda own: jnp.where(index >= first_of_end(periods), own, 0.0), angle_error
            ),
            stiffness_error=stiffness_error,
            estimate_error=error(moved.stiffness_estimate, moved.stiffness),
            unsettled=over_joints(unsettled, stiffness_error, change, stiffness_at_change),
            coupling=over_joints(coupling, moved.angle, moved.angle_without_step, change),
            saturated=number(moved.saturated),
            slack=number(moved.slack),
            outside_domain=number(moved.outside_domain),
            overloaded=number(moved.overloaded),
            force=functools.reduce(larger, moved.force),
            inflow=functools.reduce(operator.add, [larger(rise, 0.0) for rise in rises]),
            travel=tuple(map(jnp.abs, map(_difference, moved.command, before.command))),
        )

    def totals(self) -> Totals:
        """Terms of the metrics, and of `angle_at_end`."""
        return Totals.of((*metrics_of(Metrics).values(), _ANGLE_AT_END), self)


class Before(NamedTuple):
    """Air [m^3] and commands [Pa] of the muscles a period earlier."""

    air: tuple[Array, ...]
    command: tuple[Array, ...]


def _difference(first: ArrayLike, other: ArrayLike) -> Array:
    return jnp.asarray(first) - other


def _signals(now: Trajectory) -> Signals:
    return Signals(*(getattr(now, name) for name in Signals._fields))


class Accumulation(NamedTuple):
    """Metrics of the control periods so far, before they are numbers of a run."""

    totals: Totals
    before: Before
    stiffness_at_change: PyTree
    oscillation: Oscillation

    @classmethod
    def empty(cls, like: Trajectory) -> Accumulation:
        """Return the state before the first period, with the form and the float types of one."""
        like = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)
        kind, before = jax.tree.leaves(like.stiffness)[0], Before(like.air, like.command)
        change = over_joints(lambda own: Change(jnp.zeros((), int), own, own, jnp.asarray(False)), like.stiffness)
        sample = MetricSample.of(like, 0, jnp.asarray(1), change, like.stiffness, before)
        totals = jax.tree.map(lambda _: jnp.zeros_like(kind), sample.totals())
        return cls(totals, before, like.stiffness, Oscillation.empty(_signals(like)))

    def after(
        self,
        now: Trajectory,
        index: Array,
        periods: Array,
        change: PyTree,
        angle_resolution: ArrayLike,
        scale: float = 1.0,
    ) -> Accumulation:
        """Return the state after one more period of a run of so many, with the last `Change` of each joint."""
        at_change = over_joints(
            lambda new, old, change: jnp.where(index == change.at, new, old),
            now.stiffness,
            self.stiffness_at_change,
            change,
        )
        values = Before(now.air, now.command)
        before = jax.tree.map(lambda new, old: jnp.where(index == 0, new, old), values, self.before)
        sample = MetricSample.of(now, index, periods, change, at_change, before)
        oscillation = self.oscillation.after(_signals(now), index, angle_resolution, scale)
        return Accumulation(self.totals.merge(sample.totals()), values, at_change, oscillation)

    def run(self, periods: Array, period: ArrayLike, change: PyTree) -> Run:
        """Return the run as a whole, with its oscillations."""
        return Run(periods, period, self.oscillation.found(periods, period), change)


_ANGLE_AT_END = RootMeanSquare("rad", "root mean square error of the angle at the end", of="angle_error_at_end")


def angle_at_end(totals: Totals, run: Run) -> PyTree:
    """Root mean square error of the angle [rad] of each joint over the end of a run."""
    return _ANGLE_AT_END.value(totals, run._replace(periods=run.periods - first_of_end(run.periods)))


def rms(error: ArrayLike) -> Array:
    """Return the root mean square; its derivative at zero error is 0.

    >>> float(rms([3.0, -4.0, 0.0, 0.0]))
    2.5
    """
    return root(jnp.mean(jnp.square(jnp.asarray(error))))


def settling_band(desired_stiffness: ArrayLike, stiffness: ArrayLike) -> Array:
    """Half the width of the settling band of the stiffness [N*m/rad]: a fraction of the step of its setpoint."""
    change = last_change(desired_stiffness)
    return _band(change, jnp.asarray(stiffness)[change.at])


def _band(change: Change, stiffness_at_change: ArrayLike) -> Array:
    step = jnp.abs(change.after - stiffness_at_change)
    return jnp.maximum(SETTLING_PART * step, _BAND_FLOOR * jnp.abs(change.after))
