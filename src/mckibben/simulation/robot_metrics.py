"""Metrics of a robot that are accumulated along a run."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.columns import labelled
from mckibben.muscle.air import ATMOSPHERE, ENERGY
from mckibben.plant.robot_plant import RobotPlant, RobotSample
from mckibben.simulation.metrics import (
    Duration,
    Largest,
    LargestError,
    RootMeanSquare,
    Run,
    Total,
    Totals,
    Tracked,
    metrics_of,
    values_of,
)

Scalar = Float[Array, ""]


@labelled
class RobotMetrics(NamedTuple):
    """Metrics of a run of a robot, in SI."""

    peak_force: Annotated[Scalar, Largest("N", "largest upward force of the ground", of="ground_up")]
    peak_trunk_force: Annotated[
        Scalar,
        Largest(
            "N",
            "largest upward force on the trunk",
            of="trunk_force",
            note="its mass times the acceleration of the base, gravity included",
        ),
    ]
    deflection: Annotated[Scalar, Largest("m", "depth of the base below its height at the first touch", of="depth")]
    stop_torque: Annotated[
        tuple[Scalar, ...],
        LargestError(
            "N*m", "torque of the stops", of="stop_torque", along="joint", note="above 0 the joint has bottomed out"
        ),
    ]
    apex: Annotated[
        Scalar,
        Tracked(
            "m",
            "greatest height of the centre of mass in flight",
            of="apex",
            note="that the run reaches or is on its way to, after the first touch, in any flight; NaN if the "
            "foot stays on the ground",
        ),
    ]
    peak_landing_force: Annotated[
        Scalar,
        Tracked(
            "N",
            "largest upward force of the ground after the flight",
            of="landing_force",
            note="that `apex` is of; 0 if the run ends before it lands",
        ),
    ]
    muscle_work: Annotated[
        Scalar,
        Tracked(
            "J",
            "work of the muscles",
            of="muscle_work",
            note="the integral of tension times rate of shortening, until the take-off of the flight that `apex` is "
            "of, or, without one, to the end of the run",
        ),
    ]
    stop_energy: Annotated[
        Scalar, Tracked("J", "energy that the stops have absorbed", of="stop_energy", note="until then")
    ]
    air_mass: Annotated[
        Scalar,
        Tracked(
            "kg",
            "mass of the air",
            of="air_mass",
            note="that flows into the muscles until then, at room temperature",
        ),
    ]
    time_outside_domain: Annotated[Scalar, Duration("s", "time with a muscle outside its domain", of="outside")]


@labelled
class TrackingMetrics(NamedTuple):
    """Metrics of a robot whose joints follow references, in SI: those of `Metrics` of each joint, or of all."""

    angle_rmse: Annotated[
        tuple[Scalar, ...], RootMeanSquare("rad", "angle error (RMS)", of="angle_error", shown="deg", along="joint")
    ]
    angle_max: Annotated[
        tuple[Scalar, ...], LargestError("rad", "largest angle error", of="angle_error", shown="deg", along="joint")
    ]
    stiffness_rmse: Annotated[
        tuple[Scalar, ...], RootMeanSquare("N*m/rad", "stiffness error (RMS)", of="stiffness_error", along="joint")
    ]
    time_saturated: Annotated[Scalar, Duration("s", "time saturated", of="saturated")]
    time_outside_domain: Annotated[Scalar, Duration("s", "time with a muscle outside its domain", of="outside")]
    air: Annotated[Scalar, Total("m^3", "air consumption, as a volume at atmospheric pressure", of="inflow", shown="L")]

    @classmethod
    def of(cls, samples: TrackingSample, period: ArrayLike) -> TrackingMetrics:
        """Return the metrics of samples of shape (periods,)."""
        sums, maxima = samples.totals
        sums = jax.tree.map(lambda terms: np.sum(terms, axis=-1), sums)
        maxima = jax.tree.map(lambda terms: np.max(terms, axis=-1), maxima)
        return values_of(cls, Totals(sums, maxima), Run(jnp.asarray(len(samples.saturated)), period))


class TrackingSample(NamedTuple):
    """Quantities of a control period that `TrackingMetrics` are made of; flags are 0 or 1."""

    angle_error: tuple[Array, ...]  # [rad]
    stiffness_error: tuple[Array, ...]  # [N*m/rad]
    saturated: Array
    outside: Array
    inflow: Array  # of air into all muscles since the period before, as a volume at atmospheric pressure [m^3]

    @property
    def totals(self) -> Totals:
        """Terms of the metrics."""
        return Totals.of(metrics_of(TrackingMetrics).values(), self)


def inflow(air: Sequence[Array], before: Sequence[Array]) -> Array:
    """Return the air [m^3 at atmospheric pressure] that flows into muscles, from their contents [kg] a period apart."""
    rises = [jnp.maximum(new - old, 0.0) for new, old in zip(air, before, strict=True)]
    return functools.reduce(operator.add, rises) * (ENERGY / ATMOSPHERE)


class RobotMetricSample(NamedTuple):
    """Quantities of a sample that metrics are made of; flags are 0 or 1."""

    ground_up: Scalar  # [N]
    trunk_force: Scalar  # [N]
    depth: Scalar  # of the base below its height at the first touch [m], 0 before
    stop_torque: tuple[Scalar, ...]  # [N*m]
    outside: Scalar


class Flight(NamedTuple):
    """Contact with the ground and the highest flight so far, tracked from sample to sample."""

    touched: Scalar  # time since the first touch [s], below 0 before
    height: Scalar  # of the base at the first touch [m]
    speed: Scalar  # of the base, upwards [m/s]
    work: Scalar  # of the muscles so far [J]
    absorbed: Scalar  # by the stops so far [J]
    drawn: Scalar  # air so far [kg]
    air: tuple[Scalar, ...]
    apex: Scalar  # -inf before a flight
    landing_force: Scalar
    muscle_work: Scalar
    stop_energy: Scalar
    air_mass: Scalar

    @classmethod
    def of(cls, first: RobotSample) -> Flight:
        zero = jnp.zeros_like(first.z)
        none = zero - jnp.inf
        return cls(zero - 1, first.z, first.speed, zero, zero, zero, first.air_mass, none, *[zero] * 4)

    def after(self, sample: RobotSample, period: ArrayLike, plant: RobotPlant) -> tuple[Flight, RobotMetricSample]:
        """Return the state after a further sample, a period [s] later, and what metrics are made of."""
        gravity, force = plant.gravity, sample.ground_up
        before = self.touched < 0
        touched = jnp.where(before, jnp.where(force > 0, 0.0, -1.0), self.touched + period)
        height = jnp.where(touched < 0, sample.z, self.height)  # at touchdown, that of the previous sample
        rising = jnp.maximum(sample.mass_speed, 0.0)
        ballistic = sample.mass_height + rising * rising / (2 * gravity)
        flying = (touched > 0) & (force <= 0)
        higher = flying & (ballistic > self.apex + 1e-6)  # in flight it is constant except for rounding
        rises = [jnp.maximum(new - old, 0.0) for new, old in zip(sample.air_mass, self.air, strict=True)]
        work, drawn = self.work + sample.muscle_power * period, self.drawn + sum(rises)
        absorbed = self.absorbed - sample.stop_power * period
        counts = higher | (self.apex == -jnp.inf)
        following = Flight(
            touched=touched,
            height=height,
            speed=sample.speed,
            work=work,
            absorbed=absorbed,
            drawn=drawn,
            air=sample.air_mass,
            apex=jnp.where(higher, ballistic, self.apex),
            landing_force=jnp.where(counts, 0.0, jnp.maximum(self.landing_force, force)),
            muscle_work=jnp.where(counts, work, self.muscle_work),
            stop_energy=jnp.where(counts, absorbed, self.stop_energy),
            air_mass=jnp.where(counts, drawn, self.air_mass),
        )
        return following, RobotMetricSample(
            ground_up=force,
            trunk_force=plant.robot.bodies[0].mass * ((sample.speed - self.speed) / period + gravity),
            depth=jnp.where(touched >= 0, height - sample.z, 0.0),
            stop_torque=sample.stop_torque,
            outside=sample.outside.astype(sample.z.dtype),
        )


class MetricSums(NamedTuple):
    """Accumulated sums and maxima, and the state that is tracked."""

    totals: Totals
    flight: Flight

    @classmethod
    def of(cls, first: RobotSample) -> MetricSums:
        zero = jnp.zeros_like(first.z)
        nothing = RobotMetricSample(zero, zero, zero, tuple(zero for _ in first.stop_torque), zero)
        return cls(_totals(nothing).empty(), Flight.of(first))

    def after(self, sample: RobotSample, period: ArrayLike, plant: RobotPlant) -> MetricSums:
        """Return the sums with a further sample, a period [s] later."""
        flight, quantities = self.flight.after(sample, period, plant)
        return MetricSums(self.totals.merge(_totals(quantities)), flight)

    def finished(self, periods: Array, period: ArrayLike) -> RobotMetrics:
        """Return the metrics of a whole run; NaN for the apex of a foot that never left the ground."""
        apex = jnp.where(self.flight.apex > -jnp.inf, self.flight.apex, jnp.nan)
        return values_of(RobotMetrics, self.totals, Run(periods, period, self.flight._replace(apex=apex)))


def measure(samples: RobotSample, last: RobotSample, period: ArrayLike, plant: RobotPlant) -> RobotMetrics:
    """Return the metrics of a finished run, from its samples of shape (periods,) and that at its end."""

    def advance(sums: MetricSums, sample: RobotSample) -> tuple[MetricSums, None]:
        return sums.after(sample, period, plant), None

    first, rest = (jax.tree.map(lambda x, at=at: x[at], samples) for at in (0, slice(1, None)))
    sums = lax.scan(advance, MetricSums.of(first), rest)[0]
    return sums.after(last, period, plant).finished(jnp.asarray(samples.z.shape[0]), period)


def _totals(quantities: Any) -> Totals:
    return Totals.of(metrics_of(RobotMetrics).values(), quantities)
