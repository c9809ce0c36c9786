"""Trajectories and metrics of an episode: the plant's true torque, stiffness and muscle forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.control.base import Setpoint
from mckibben.joint.antagonistic import NO_STATES
from mckibben.numerics.batching import compute_once
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.simulation.oscillation import LimitCycle, find_limit_cycle
from mckibben.units import atm, deg, litre, percent

if TYPE_CHECKING:
    from mckibben.simulation.loop import Record


class Trajectory(NamedTuple):
    """An episode over time; every leaf has shape (periods,), SI units.

    Stiffness, torque, forces and contractions are those of the plant. Torque and forces include the muscles' friction
    and creep; ``stiffness`` is that of the force laws, or of the controller's `stiffness_amplitude` if it has one,
    ``total_stiffness`` adds gravity's. ``angle_without_step`` is
    the angle of the same run without the last change of the desired stiffness. ``excursion`` is the larger distance of
    the two contractions from their domains. ``air1`` and ``air2`` are the muscles' contents as volumes at atmospheric
    pressure [m^3], from the volumes inside their braids.
    """

    angle: Array
    velocity: Array
    desired_angle: Array
    angle_without_step: Array
    desired_stiffness: Array
    stiffness: Array
    total_stiffness: Array
    stiffness_estimate: Array
    torque: Array
    pressure1: Array
    pressure2: Array
    command1: Array
    command2: Array
    force1: Array
    force2: Array
    contraction1: Array
    contraction2: Array
    saturated: Array
    slack: Array
    outside_domain: Array
    overloaded: Array
    excursion: Array
    air1: Array
    air2: Array


def trajectory(
    plant: JointPlant,
    setpoints: Setpoint,
    record: Record,
    angle_without_step: Array,
    stiffness_amplitude: ArrayLike | None = None,
) -> Trajectory:
    """Trajectory of a record; elementwise, of one control period or of all."""
    state, joint = record.state, plant.joint
    torque, stiffness = compute_once(joint.torque_and_stiffness, state.angle, state.pressures)
    if stiffness_amplitude is not None:
        stiffness = compute_once(joint.secant_stiffness, state.angle, state.pressures, stiffness_amplitude)
    pressure1, pressure2 = state.pressures
    if state.muscles != NO_STATES:
        forces = compute_once(joint.forces, state.angle, state.velocity, state.pressures, state.muscles)
        (force1, force2), torque, (contraction1, contraction2) = forces
    else:
        contraction1, contraction2 = compute_once(joint.contractions, state.angle, state.pressures)
        force1 = joint.muscle1.tension(contraction1, pressure1)
        force2 = joint.muscle2.tension(contraction2, pressure2)
    muscles = ((joint.muscle1, contraction1, pressure1), (joint.muscle2, contraction2, pressure2))
    dead = plant.valve.dead_volume
    air1, air2 = (
        (m.specimen.volume(contraction) + dead) * (pressure + atm) / atm
        if m.specimen.has_volume
        else jnp.full_like(stiffness, jnp.nan)
        for m, contraction, pressure in muscles
    )
    inside = [muscle.domain.contains(contraction, pressure) for muscle, contraction, pressure in muscles]
    beyond = [
        jnp.maximum(muscle.domain.contraction_min - contraction, contraction - muscle.domain.contraction_max)
        for muscle, contraction, _ in muscles
    ]
    rated1, rated2 = joint.muscle1.specimen.force_limit, joint.muscle2.specimen.force_limit
    return Trajectory(
        angle=state.angle,
        velocity=state.velocity,
        desired_angle=setpoints.angle,
        angle_without_step=angle_without_step,
        desired_stiffness=setpoints.stiffness,
        stiffness=stiffness,
        total_stiffness=stiffness + plant.load.gravity_stiffness(state.angle),
        stiffness_estimate=record.telemetry.get("stiffness_estimate", jnp.full_like(stiffness, jnp.nan)),
        torque=torque,
        pressure1=pressure1,
        pressure2=pressure2,
        command1=record.commands[0],
        command2=record.commands[1],
        force1=force1,
        force2=force2,
        contraction1=contraction1,
        contraction2=contraction2,
        saturated=record.limited | record.telemetry.get("saturated", False),
        slack=(force1 <= 0) | (force2 <= 0),
        outside_domain=~(inside[0] & inside[1]),
        overloaded=(force1 > rated1) | (force2 > rated2),
        excursion=jnp.maximum(jnp.maximum(beyond[0], beyond[1]), 0.0),
        air1=air1,
        air2=air2,
    )


compiled_trajectory = compiled(trajectory)


SETTLING_PART = 0.1
"""Half the width of the settling band, as a fraction of the step of the desired stiffness."""
_END = 10  # the last 1/10 of a run is its end
_SETTLED = 10  # the last 1/10 of the time since the change has to be inside the band
_BAND_FLOOR = 1e-3  # least half width of the band, as a fraction of the setpoint


class Metrics(NamedTuple):
    """Scalars in SI; errors are those of the plant's true angle and stiffness from the setpoints.

    Attributes
    ----------
    angle_rmse, angle_max, stiffness_rmse, stiffness_max
        Root mean square and largest absolute error of angle [rad] and stiffness [N*m/rad].
    stiffness_ripple
        Root mean square of the stiffness error about its mean over the run [N*m/rad]: at a constant setpoint, the
        effect of motion on the stiffness, without the constant error of a wrong force law.
    stiffness_settling
        Time from the last change of the desired stiffness (or from the start, if it never changes) until the stiffness
        enters the settling band for good [s]. NaN if it is not inside for at least the last tenth of the time since the
        change (a limit cycle, or an entry just before the end), or if the setpoint ends with a ramp or changes to the
        very end.
    coupling
        Largest deviation of the angle from that of the same run without the last change of the desired stiffness [rad];
        NaN if the desired stiffness never changes, ends with a ramp or changes to the very end.
    estimate_rmse
        Root mean square error of the controller's stiffness estimate [N*m/rad]; NaN if it has none.
    time_saturated, time_slack, time_outside_domain, time_overloaded
        Time with a command at a pressure limit, a muscle slack, outside its domain, above its rated force [s].
    excursion_max, force_max
        Largest distance of a contraction from its domain [-], and largest tension [N].
    oscillation_amplitude, oscillation_period
        Mean amplitude [rad] and period [s] of a limit cycle of the angle (`mckibben.simulation.oscillation`); 0 and NaN
        if there is none.
    air
        Sum of the rises of the muscles' contents at room temperature, as a volume at atmospheric pressure [m^3]; what
        is let out is lost. NaN where the volumes are not known.
    """

    angle_rmse: Array
    angle_max: Array
    stiffness_rmse: Array
    stiffness_max: Array
    stiffness_ripple: Array
    stiffness_settling: Array
    coupling: Array
    estimate_rmse: Array
    time_saturated: Array
    time_slack: Array
    time_outside_domain: Array
    time_overloaded: Array
    excursion_max: Array
    force_max: Array
    air: Array
    oscillation_amplitude: Array
    oscillation_period: Array


METRICS: dict[str, tuple[str, str, float]] = {
    "angle_rmse_deg": ("angle_rmse", "deg", deg),
    "angle_max_deg": ("angle_max", "deg", deg),
    "stiffness_rmse": ("stiffness_rmse", "N*m/rad", 1.0),
    "stiffness_max": ("stiffness_max", "N*m/rad", 1.0),
    "stiffness_ripple": ("stiffness_ripple", "N*m/rad", 1.0),
    "stiffness_settling_s": ("stiffness_settling", "s", 1.0),
    "coupling_deg": ("coupling", "deg", deg),
    "estimate_rmse": ("estimate_rmse", "N*m/rad", 1.0),
    "time_saturated_s": ("time_saturated", "s", 1.0),
    "time_slack_s": ("time_slack", "s", 1.0),
    "time_outside_domain_s": ("time_outside_domain", "s", 1.0),
    "time_overloaded_s": ("time_overloaded", "s", 1.0),
    "excursion_max_percent": ("excursion_max", "%", percent),
    "force_max_N": ("force_max", "N", 1.0),
    "air_L": ("air", "L", litre),
    "oscillation_amplitude_deg": ("oscillation_amplitude", "deg", deg),
    "oscillation_period_s": ("oscillation_period", "s", 1.0),
}
"""Field of `Metrics`, unit and its factor to SI, by the name in results."""


def in_shown_units(metrics: Mapping[str, float]) -> dict[str, float]:
    """Metrics by their names and in their units in results."""
    return {name: metrics[metric] / unit for name, (metric, _, unit) in METRICS.items()}


def measure(
    moved: Trajectory,
    period: ArrayLike,
    *,
    settling_part: float = SETTLING_PART,
    angle_resolution: ArrayLike = 0.0,
) -> Metrics:
    """Metrics of a trajectory with a control period [s].

    `settling_part` as `SETTLING_PART`, and `angle_resolution` a step of the sensor of the angle [rad].
    """
    stiffness = jnp.asarray(moved.stiffness)
    change = last_change(moved.desired_stiffness)
    before = [jnp.concatenate([air[:1], air[:-1]]) for air in map(jnp.asarray, (moved.air1, moved.air2))]
    at_change = stiffness[change.at]
    periods = stiffness.size
    parts = MetricAccumulator.of(moved, jnp.arange(periods), periods, change, at_change, before, settling_part)
    sums = Sums(*(jnp.sum(part) for part in parts.sums))
    peaks = Peaks(*(_largest(part) for part in parts.peaks))
    cycle = find_limit_cycle(moved.angle, moved.desired_angle, period, angle_resolution)
    return MetricAccumulator(sums, peaks, jnp.max(parts.unsettled)).metrics(change, periods, period, cycle)


compiled_measure = compiled(measure)


class Change(NamedTuple):
    """Last change of the desired stiffness."""

    at: Array  # first control period with the new setpoint; 0 if it never changes
    before: Array  # setpoint [N*m/rad]
    after: Array  # setpoint at the end of the run [N*m/rad]
    ends: Array  # whether there is a change, a step and not the end of a ramp, and a time after it without one


def first_of_end(periods: int) -> int:
    """First control period of the end of a run, its last tenth."""
    return periods - max(periods // _END, 1)


def last_change(desired: ArrayLike) -> Change:
    """The last change of setpoints of shape (periods,)."""
    desired = jnp.asarray(desired)
    changed = jnp.concatenate([jnp.zeros(1, bool), desired[1:] != desired[:-1]])
    index = jnp.max(jnp.where(changed, jnp.arange(desired.size), 0))
    ends = (index > 0) & (index < desired.size - 1) & ~changed[index - 1]
    return Change(index, desired[jnp.maximum(index - 1, 0)], desired[-1], ends)


class Sums(NamedTuple):
    """Sums over control periods: errors, squared errors, counts and air."""

    angle: Array
    angle_at_end: Array
    stiffness: Array
    stiffness_bias: Array
    estimate: Array
    saturated: Array
    slack: Array
    outside_domain: Array
    overloaded: Array
    air: Array


class Peaks(NamedTuple):
    """Maxima over control periods."""

    angle: Array
    stiffness: Array
    coupling: Array
    excursion: Array
    force: Array


class MetricAccumulator(NamedTuple):
    """Sums and maxima from which the metrics follow; of one control period, of some, or of all."""

    sums: Sums
    peaks: Peaks
    unsettled: Array  # the last period with the stiffness outside its band; -1 if there is none

    @classmethod
    def empty(cls, like: Array) -> MetricAccumulator:
        """Accumulator before the first period, with the float type of `like`."""
        zero = jnp.zeros_like(like)
        return cls(Sums(*[zero] * len(Sums._fields)), Peaks(*[zero] * len(Peaks._fields)), jnp.asarray(-1))

    @classmethod
    def of(
        cls,
        moved: Trajectory,
        index: ArrayLike,
        periods: int,
        change: Change,
        stiffness_at_change: ArrayLike,
        air_before: Sequence[ArrayLike],
        settling_part: ArrayLike,
    ) -> MetricAccumulator:
        """Accumulators of single control periods, elementwise: scalars or shape (periods,)."""
        angle_error = jnp.asarray(moved.angle) - moved.desired_angle
        stiffness_error = jnp.asarray(moved.stiffness) - moved.desired_stiffness
        estimate_error = jnp.asarray(moved.stiffness_estimate) - moved.stiffness
        since = jnp.asarray(index) >= change.at
        settled = jnp.abs(stiffness_error) <= _band(change, stiffness_at_change, settling_part)
        coupling = jnp.abs(jnp.asarray(moved.angle) - moved.angle_without_step)
        air = _larger(moved.air1 - air_before[0], 0.0) + _larger(moved.air2 - air_before[1], 0.0)

        def count(flag: Array) -> Array:
            return jnp.asarray(flag).astype(stiffness_error.dtype)

        sums = Sums(
            angle=jnp.square(angle_error),
            angle_at_end=jnp.where(jnp.asarray(index) >= first_of_end(periods), jnp.square(angle_error), 0.0),
            stiffness=jnp.square(stiffness_error),
            stiffness_bias=stiffness_error,
            estimate=jnp.square(estimate_error),
            saturated=count(moved.saturated),
            slack=count(moved.slack),
            outside_domain=count(moved.outside_domain),
            overloaded=count(moved.overloaded),
            air=air,
        )
        peaks = Peaks(
            angle=jnp.abs(angle_error),
            stiffness=jnp.abs(stiffness_error),
            coupling=jnp.where(since, coupling, 0.0),
            excursion=jnp.asarray(moved.excursion),
            force=_larger(moved.force1, moved.force2),
        )
        return cls(sums, peaks, jnp.where(since & ~settled, index, -1))

    def merge(self, other: MetricAccumulator) -> MetricAccumulator:
        """Accumulator of the periods of both."""
        return MetricAccumulator(
            Sums(*(a + b for a, b in zip(self.sums, other.sums, strict=True))),
            Peaks(*(_larger(a, b) for a, b in zip(self.peaks, other.peaks, strict=True))),
            jnp.maximum(self.unsettled, other.unsettled),
        )

    def angle_at_end(self, periods: int) -> Array:
        """Root mean square error of the angle [rad] over the end of a run of so many control periods."""
        return _root(self.sums.angle_at_end / (periods - first_of_end(periods)))

    def metrics(self, change: Change, periods: int, period: ArrayLike, cycle: LimitCycle) -> Metrics:
        """The metrics of a whole run of so many control periods [s]."""
        sums, peaks = self.sums, self.peaks
        unsettled = jnp.maximum(self.unsettled, change.at - 1)
        about_mean = sums.stiffness / periods - jnp.square(sums.stiffness_bias / periods)
        in_band = periods - 1 - unsettled  # periods at the end
        never = (_SETTLED * in_band < periods - change.at) | ((change.at > 0) & ~change.ends)
        return Metrics(
            angle_rmse=_root(sums.angle / periods),
            angle_max=peaks.angle,
            stiffness_rmse=_root(sums.stiffness / periods),
            stiffness_max=peaks.stiffness,
            stiffness_ripple=_root(jnp.where(about_mean < 0, 0.0, about_mean)),  # rounding may take it below
            stiffness_settling=jnp.where(never, jnp.nan, (unsettled + 1 - change.at) * period),
            coupling=jnp.where(change.ends, peaks.coupling, jnp.nan),
            estimate_rmse=_root(sums.estimate / periods),
            time_saturated=sums.saturated * period,
            time_slack=sums.slack * period,
            time_outside_domain=sums.outside_domain * period,
            time_overloaded=sums.overloaded * period,
            excursion_max=peaks.excursion,
            force_max=peaks.force,
            air=sums.air,
            oscillation_amplitude=cycle.amplitude,
            oscillation_period=cycle.period,
        )


def rms(error: ArrayLike) -> Array:
    """The root mean square; its derivative at zero error is 0."""
    return _root(jnp.mean(jnp.square(jnp.asarray(error))))


def settling_band(desired_stiffness: ArrayLike, stiffness: ArrayLike, part: float) -> Array:
    """Half the width of the settling band of the stiffness [N*m/rad]: a fraction of the step of its setpoint."""
    change = last_change(desired_stiffness)
    return _band(change, jnp.asarray(stiffness)[change.at], part)


def _band(change: Change, stiffness_at_change: ArrayLike, part: ArrayLike) -> Array:
    step = jnp.abs(change.after - stiffness_at_change)
    return jnp.maximum(part * step, _BAND_FLOOR * jnp.abs(change.after))


def _root(mean: Array) -> Array:
    """The square root; its derivative at 0 is 0."""
    return jnp.where(mean > 0, jnp.sqrt(jnp.where(mean > 0, mean, 1.0)), mean)


def _larger(one: ArrayLike, other: ArrayLike) -> Array:
    """The larger of two, NaN if one of them is: XLA's own maximum does not always pass it on."""
    one, other = jnp.asarray(one), jnp.asarray(other)
    return jnp.where((one >= other) | jnp.isnan(one), one, other)


def _largest(values: Array) -> Array:
    """The maximum along time, NaN if there is one."""
    return jnp.where(jnp.any(jnp.isnan(values)), jnp.nan, jnp.max(values))
