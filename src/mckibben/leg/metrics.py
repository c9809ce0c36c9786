"""Metrics of a leg that are accumulated along a run."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.leg.plant import LegPlant, LegSample
from mckibben.simulation.result import UNITS

Scalar = Float[Array, ""]

IMPACT = 10e-3
"""Time [s] after the first touch in which the force is that of the foot's own impact, `peak_force_late` leaves out."""


class LegMetrics(NamedTuple):
    """Metrics of a run.

    Attributes
    ----------
    peak_force, peak_force_late
        Largest upward force of the ground [N], and the largest more than 10 ms after the first touch, without the
        impact of the foot's own mass.
    peak_trunk_force
        Largest upward force [N] on the trunk: its mass times the acceleration of the hip, gravity included.
    deflection
        How far the hip sinks below its height at the first touch [m].
    stop_torque
        Largest torque of the stops of each joint [N*m]; above 0 it has bottomed out.
    apex
        Largest height of the centre of mass [m] that the run reaches or is on its way to when the foot is in the air,
        after the first touch, in any flight; NaN if the foot stays on the ground.
    take_off_speed
        Upward speed of the centre of mass [m/s] that belongs to `apex`.
    muscle_work
        Work of the muscles [J]: the integral of tension times rate of shortening. Until the take-off of the flight that
        `apex` is of, or, without one, to the end of the run.
    air_mass
        Mass of the air [kg] that flows into the muscles until then, at room temperature.
    time_outside_domain
        Time [s] with a contraction outside its muscle's domain.
    """

    peak_force: Scalar
    peak_force_late: Scalar
    peak_trunk_force: Scalar
    deflection: Scalar
    stop_torque: tuple[Scalar, ...]
    apex: Scalar
    take_off_speed: Scalar
    muscle_work: Scalar
    air_mass: Scalar
    time_outside_domain: Scalar


LEG_UNITS = UNITS | {
    "peak_force": ("N", "largest upward force of the ground"),
    "peak_force_late": ("N", "largest upward force of the ground, without the impact of the foot"),
    "peak_trunk_force": ("N", "largest upward force on the trunk"),
    "deflection": ("m", "depth of the hip below its height at the first touch"),
    "stop_torque": ("N*m", "torque of the stops"),
    "apex": ("m", "greatest height of the centre of mass in flight"),
    "take_off_speed": ("m/s", "upward speed of the centre of mass at take-off"),
    "muscle_work": ("J", "work of the muscles"),
    "air_mass": ("kg", "mass of the air"),
    "x": ("m", "position of the hip, forwards"),
    "z": ("m", "height of the hip"),
    "speed": ("m/s", "upward speed of the hip"),
    "pitch": ("rad", "pitch of the trunk"),
    "pressure": ("Pa", "gauge pressure"),
    "command": ("Pa", "commanded pressure"),
    "tension": ("N", "tension of the muscle"),
    "contraction": ("1", "contraction of the muscle"),
    "ground_forward": ("N", "force of the ground on the foot, forwards"),
    "ground_up": ("N", "force of the ground on the foot, upwards"),
    "mass_height": ("m", "height of the centre of mass"),
    "mass_speed": ("m/s", "upward speed of the centre of mass"),
    "kinetic": ("J", "kinetic energy"),
    "muscle_power": ("W", "power of the muscles"),
    "outside": ("1", "a muscle's contraction is outside its domain"),
    "diverged": ("1", "the run diverged"),
}
"""Unit and meaning of the variables of runs of a leg."""


class MetricSums(NamedTuple):
    """Accumulated metrics."""

    metrics: LegMetrics
    touched: Scalar  # time since the first touch [s], below 0 before
    height: Scalar  # of the hip at the first touch [m]
    speed: Scalar  # of the hip, upwards [m/s]
    work: Scalar  # of the muscles so far [J]
    drawn: Scalar  # air so far [kg]
    air: tuple[Scalar, ...]

    @classmethod
    def of(cls, first: LegSample) -> MetricSums:
        zero = jnp.zeros_like(first.z)
        stops = tuple(zero for _ in first.stop_torque)
        start: dict[str, Any] = dict.fromkeys(LegMetrics._fields, zero)
        metrics = LegMetrics(**start | {"stop_torque": stops, "apex": zero - jnp.inf})
        return cls(metrics, zero - 1, first.z, first.speed, zero, zero, first.air_mass)

    def after(self, sample: LegSample, period: ArrayLike, plant: LegPlant) -> MetricSums:
        """Metrics with a further sample, a period [s] later."""
        gravity, mass = plant.gravity, plant.leg.trunk.mass
        last, force = self.metrics, sample.ground_up
        before = self.touched < 0
        touched = jnp.where(before, jnp.where(force > 0, 0.0, -1.0), self.touched + period)
        height = jnp.where(touched < 0, sample.z, self.height)  # at touchdown, that of the previous sample
        rising = jnp.maximum(sample.mass_speed, 0.0)
        ballistic = sample.mass_height + rising * rising / (2 * gravity)
        flying = (touched > 0) & (force <= 0)
        higher = flying & (ballistic > last.apex + 1e-6)  # in flight it is constant except for rounding
        stops = zip(last.stop_torque, sample.stop_torque, strict=True)
        inflow = [jnp.maximum(new - old, 0.0) for new, old in zip(sample.air_mass, self.air, strict=True)]
        work, drawn = self.work + sample.muscle_power * period, self.drawn + sum(inflow)
        counts = higher | (last.apex == -jnp.inf)
        metrics = LegMetrics(
            peak_force=jnp.maximum(last.peak_force, force),
            peak_force_late=jnp.where(touched > IMPACT, jnp.maximum(last.peak_force_late, force), last.peak_force_late),
            peak_trunk_force=jnp.maximum(
                last.peak_trunk_force, mass * ((sample.speed - self.speed) / period + gravity)
            ),
            deflection=jnp.where(touched >= 0, jnp.maximum(last.deflection, height - sample.z), last.deflection),
            stop_torque=tuple(jnp.maximum(most, jnp.abs(now)) for most, now in stops),
            apex=jnp.where(higher, ballistic, last.apex),
            take_off_speed=jnp.where(higher, sample.mass_speed, last.take_off_speed),
            muscle_work=jnp.where(counts, work, last.muscle_work),
            air_mass=jnp.where(counts, drawn, last.air_mass),
            time_outside_domain=last.time_outside_domain + jnp.where(sample.outside, period, 0.0),
        )
        return MetricSums(metrics, touched, height, sample.speed, work, drawn, sample.air_mass)

    def finished(self) -> LegMetrics:
        """The metrics; NaN for the apex of a foot that never left the ground."""
        apex = self.metrics.apex
        return self.metrics._replace(apex=jnp.where(apex > -jnp.inf, apex, jnp.nan))
