"""What follows from a recorded episode: the plant's true torque, stiffness and muscles, computed once, vectorised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.control.base import Setpoint
from mckibben.joint.antagonistic import NO_STATES
from mckibben.numerics.batching import apart
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.simulation.loop import Record
from mckibben.units import atm, deg, litre, percent


class Trajectory(NamedTuple):
    """An episode over time; every leaf has shape (periods,), SI units.

    Stiffness, torque, forces and contractions are the plant's own, not the controller's belief. Torque and forces
    contain the muscles' friction and creep; ``stiffness`` is that of the muscles' laws, ``total_stiffness`` that and
    gravity's. ``undisturbed_angle`` is the angle of the same run without the last change of the desired stiffness,
    where there is one to leave out. ``excursion`` is how far the worse of the two contractions lies outside its domain.
    ``air1`` and ``air2`` are what the muscles hold, as volumes at atmospheric pressure [m^3], by the volumes inside
    their braids.
    """

    angle: Array
    velocity: Array
    desired_angle: Array
    undisturbed_angle: Array
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
    plant: JointPlant, setpoints: Setpoint, record: Record, undisturbed_angle: Array, period: ArrayLike = 1.0
) -> Trajectory:
    """Work out the trajectory of a record. Pure and elementwise: of one control period or of all of them.

    Parameters
    ----------
    plant, setpoints, record
        As `episode` took and gave them.
    undisturbed_angle
        The angle [rad] of a run to the same wishes `without_last_change`; the same angle where there is none.
    period
        The control period [s]; only looked at in programs for many runs.
    """
    state, joint = record.state, plant.joint
    torque, stiffness = apart(joint.torque_and_stiffness, state.angle, state.pressures, witness=period)
    pressure1, pressure2 = state.pressures
    if state.muscles != NO_STATES:
        motion = state.angle, state.velocity, state.pressures
        forces = apart(joint.forces, *motion, state.muscles, witness=period)
        (force1, force2), torque, (contraction1, contraction2) = forces
    else:
        contraction1, contraction2 = apart(joint.contractions, state.angle, state.pressures, witness=period)
        force1 = joint.muscle1.tension(contraction1, pressure1)
        force2 = joint.muscle2.tension(contraction2, pressure2)
    muscles = ((joint.muscle1, contraction1, pressure1), (joint.muscle2, contraction2, pressure2))
    air1, air2 = (m.specimen.volume(contraction) * (pressure + atm) / atm for m, contraction, pressure in muscles)
    inside = [muscle.domain.contains(contraction, pressure) for muscle, contraction, pressure in muscles]
    beyond = [
        jnp.maximum(muscle.domain.contraction_min - contraction, contraction - muscle.domain.contraction_max)
        for muscle, contraction, _ in muscles
    ]
    rated1, rated2 = joint.muscle1.specimen.rated_force, joint.muscle2.specimen.rated_force
    return Trajectory(
        angle=state.angle,
        velocity=state.velocity,
        desired_angle=setpoints.angle,
        undisturbed_angle=undisturbed_angle,
        desired_stiffness=setpoints.stiffness,
        stiffness=stiffness,
        total_stiffness=stiffness + plant.load.gravity_stiffness(state.angle),
        stiffness_estimate=record.telemetry["stiffness_estimate"],
        torque=torque,
        pressure1=pressure1,
        pressure2=pressure2,
        command1=record.command1,
        command2=record.command2,
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
"""Half the width of the settling band, as a part of the change of stiffness that was asked for."""
_SETTLED = 10  # of the time since the change this many-th part, the last, has to be spent in the band
_BAND_FLOOR = 1e-3  # of the wish: a band narrower than this is no band


class Metrics(NamedTuple):
    """Each a scalar in SI; errors are those of the plant's true angle and stiffness against the wish.

    Attributes
    ----------
    angle_rmse, angle_max
        Root mean square and largest absolute error of the angle [rad].
    stiffness_rmse, stiffness_max
        The same of the stiffness [N*m/rad].
    stiffness_ripple
        The same about its own mean over the run: what of the error of the stiffness moves [N*m/rad]. A wrong law leaves
        an error that stands still; this is without it, and where the wish is constant it is what motion does to the
        stiffness: the other way of the coupling.
    stiffness_settling
        From the last change of the desired stiffness (or from the start, if it never changes) until the stiffness
        enters the band for good [s]; the band is a part of the change. Settled is what stays in the band for at least
        the last tenth of the time since the change: of a limit cycle, or of a response that enters only just before the
        end, it is not known whether it stays. NaN if it never settles so, or if the wish never stops changing.
    coupling
        By how much the last change of the desired stiffness moves the angle at most, against the same run without that
        change [rad]; NaN if the desired stiffness never changes, or never stops changing.
    estimate_rmse
        Root mean square error of the controller's estimate of the stiffness [N*m/rad].
    time_saturated, time_slack, time_outside_domain, time_overloaded
        For how long a command was at a pressure limit, a muscle slack, outside its domain, above its rated force [s].
    excursion_max
        How far a contraction was outside its domain at most [-].
    force_max
        The largest tension [N].
    air
        What the muscles take in, as a volume at atmospheric pressure [m^3]; what either lets out is lost to both.
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
}
"""Field of `Metrics`, unit and its factor to SI, by the name in results."""


def in_shown_units(metrics: Mapping[str, float]) -> dict[str, float]:
    """Metrics by their names and in their units in results."""
    return {name: metrics[metric] / unit for name, (metric, _, unit) in METRICS.items()}


def measure(moved: Trajectory, period: ArrayLike, *, settling_part: float = SETTLING_PART) -> Metrics:
    """The metrics of a trajectory.

    Parameters
    ----------
    moved
        The trajectory.
    period
        Its control period [s].
    settling_part
        Half the width of the settling band, as a part of the change of stiffness that was asked for.
    """
    stiffness = jnp.asarray(moved.stiffness)
    change = last_change(moved.desired_stiffness)
    before = [jnp.concatenate([air[:1], air[:-1]]) for air in map(jnp.asarray, (moved.air1, moved.air2))]
    parts = tally(moved, jnp.arange(stiffness.size), change, stiffness[change.at], before, settling_part)
    sums = Sums(*(jnp.sum(part) for part in parts.sums))
    peaks = Peaks(*(_largest(part) for part in parts.peaks))
    return metrics_of(Tally(sums, peaks, jnp.max(parts.unsettled)), change, stiffness.size, period)


compiled_measure = compiled(measure)


class Change(NamedTuple):
    """The last change of the desired stiffness; known before the run.

    Attributes
    ----------
    at
        The control period from which on the new value is wished for; 0 if the wish never changes.
    before, after
        The wish right before, and at the end of the run [N*m/rad].
    ends
        Whether there is a change, and a time after it without one (a sine changes to the very end).
    """

    at: Array
    before: Array
    after: Array
    ends: Array


def last_change(desired: ArrayLike) -> Change:
    """The last change of a wish of shape (periods,)."""
    desired = jnp.asarray(desired)
    changed = jnp.concatenate([jnp.zeros(1, bool), desired[1:] != desired[:-1]])
    index = jnp.max(jnp.where(changed, jnp.arange(desired.size), 0))
    ends = (index > 0) & (index < desired.size - 1)
    return Change(index, desired[jnp.maximum(index - 1, 0)], desired[-1], ends)


class Sums(NamedTuple):
    """What is summed over the control periods: errors, their squares, how often something was so, and air."""

    angle: Array
    stiffness: Array
    stiffness_bias: Array
    estimate: Array
    saturated: Array
    slack: Array
    outside_domain: Array
    overloaded: Array
    air: Array


class Peaks(NamedTuple):
    """What the largest value is looked for of."""

    angle: Array
    stiffness: Array
    coupling: Array
    excursion: Array
    force: Array


class Tally(NamedTuple):
    """All that the metrics need of a run; of one control period, of some, or of all."""

    sums: Sums
    peaks: Peaks
    unsettled: Array  # the last period in which the stiffness was outside its band; -1 if it never was

    @classmethod
    def nothing(cls, like: Array) -> Tally:
        """Of no period at all; floats are of the type of `like`."""
        zero = jnp.zeros_like(like)
        return cls(Sums(*[zero] * len(Sums._fields)), Peaks(*[zero] * len(Peaks._fields)), jnp.asarray(-1))

    def with_next(self, after: Tally) -> Tally:
        """Of both."""
        return Tally(
            Sums(*(a + b for a, b in zip(self.sums, after.sums, strict=True))),
            Peaks(*(_larger(a, b) for a, b in zip(self.peaks, after.peaks, strict=True))),
            jnp.maximum(self.unsettled, after.unsettled),
        )


def tally(
    moved: Trajectory,
    index: ArrayLike,
    change: Change,
    stiffness_at_change: ArrayLike,
    air_before: Sequence[ArrayLike],
    settling_part: ArrayLike,
) -> Tally:
    """What single control periods add to the metrics; elementwise, for scalars and for shape (periods,)."""
    angle_error = jnp.asarray(moved.angle) - moved.desired_angle
    stiffness_error = jnp.asarray(moved.stiffness) - moved.desired_stiffness
    estimate_error = jnp.asarray(moved.stiffness_estimate) - moved.stiffness
    since = jnp.asarray(index) >= change.at
    settled = jnp.abs(stiffness_error) <= _band(change, stiffness_at_change, settling_part)
    moved_by_change = jnp.abs(jnp.asarray(moved.angle) - moved.undisturbed_angle)
    kind = stiffness_error.dtype

    taken_in = [jnp.maximum(now - then, 0.0) for now, then in zip((moved.air1, moved.air2), air_before, strict=True)]

    def count(flag: Array) -> Array:
        return jnp.asarray(flag).astype(kind)

    return Tally(
        Sums(
            angle=jnp.square(angle_error),
            stiffness=jnp.square(stiffness_error),
            stiffness_bias=stiffness_error,
            estimate=jnp.square(estimate_error),
            saturated=count(moved.saturated),
            slack=count(moved.slack),
            outside_domain=count(moved.outside_domain),
            overloaded=count(moved.overloaded),
            air=taken_in[0] + taken_in[1],
        ),
        Peaks(
            angle=jnp.abs(angle_error),
            stiffness=jnp.abs(stiffness_error),
            coupling=jnp.where(since, moved_by_change, 0.0),
            excursion=jnp.asarray(moved.excursion),
            force=_larger(moved.force1, moved.force2),
        ),
        jnp.where(since & ~settled, index, -1),
    )


def metrics_of(total: Tally, change: Change, periods: int, period: ArrayLike) -> Metrics:
    """The metrics from the tally of a whole run of so many control periods [s]."""
    sums, peaks = total.sums, total.peaks
    unsettled = jnp.maximum(total.unsettled, change.at - 1)
    about_mean = sums.stiffness / periods - jnp.square(sums.stiffness_bias / periods)
    in_band = periods - 1 - unsettled  # how many periods at the end
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
    )


def rms(error: ArrayLike) -> Array:
    """The root of the mean square; its derivative at no error at all is 0."""
    return _root(jnp.mean(jnp.square(jnp.asarray(error))))


def settling_band(moved: Trajectory, part: float) -> Array:
    """Half the width of the band into which the stiffness has to settle [N*m/rad]: a part of the change asked for."""
    change = last_change(moved.desired_stiffness)
    return _band(change, jnp.asarray(moved.stiffness)[change.at], part)


def _band(change: Change, stiffness_at_change: ArrayLike, part: ArrayLike) -> Array:
    asked = jnp.abs(change.after - stiffness_at_change)
    return jnp.maximum(part * asked, _BAND_FLOOR * jnp.abs(change.after))


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
