"""How well a run went, in a handful of numbers; pure functions of trajectories, differentiable where they can be."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.numerics.compiled import compiled
from mckibben.simulation.trajectory import Trajectory

SETTLING_PART = 0.1
"""Half the width of the settling band, as a part of the change of stiffness that was asked for."""
_BAND_FLOOR = 1e-3  # of the wish: a band narrower than this is no band


class Metrics(NamedTuple):
    """Each a scalar in SI; errors are those of the plant's true angle and stiffness against the wish.

    Attributes
    ----------
    angle_rmse, angle_max
        Root mean square and largest absolute error of the angle [rad].
    stiffness_rmse, stiffness_max
        The same of the stiffness [N*m/rad].
    stiffness_settling
        From the last change of the desired stiffness (or from the start, if it never changes) until the stiffness
        stays within the band [s]; NaN if it does not by the end of the run, or if the wish never stops changing. The
        band is a part of the change.
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
    """

    angle_rmse: Array
    angle_max: Array
    stiffness_rmse: Array
    stiffness_max: Array
    stiffness_settling: Array
    coupling: Array
    estimate_rmse: Array
    time_saturated: Array
    time_slack: Array
    time_outside_domain: Array
    time_overloaded: Array
    excursion_max: Array
    force_max: Array


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
    angle_error = jnp.asarray(moved.angle) - moved.desired_angle
    stiffness_error = jnp.asarray(moved.stiffness) - moved.desired_stiffness
    estimate_error = jnp.asarray(moved.stiffness_estimate) - moved.stiffness
    change = last_change(moved.desired_stiffness)
    return Metrics(
        angle_rmse=rms(angle_error),
        angle_max=_largest(jnp.abs(angle_error)),
        stiffness_rmse=rms(stiffness_error),
        stiffness_max=_largest(jnp.abs(stiffness_error)),
        stiffness_settling=_settling(moved, stiffness_error, change, period, settling_part),
        coupling=_coupling(moved, change),
        estimate_rmse=rms(estimate_error),
        time_saturated=jnp.sum(moved.saturated) * period,
        time_slack=jnp.sum(moved.slack) * period,
        time_outside_domain=jnp.sum(moved.outside_domain) * period,
        time_overloaded=jnp.sum(moved.overloaded) * period,
        excursion_max=_largest(moved.excursion),
        force_max=jnp.maximum(_largest(moved.force1), _largest(moved.force2)),
    )


compiled_measure = compiled(measure)


def rms(error: ArrayLike) -> Array:
    """The root of the mean square; its derivative at no error at all is 0."""
    mean = jnp.mean(jnp.square(jnp.asarray(error)))
    return jnp.where(mean > 0, jnp.sqrt(jnp.where(mean > 0, mean, 1.0)), mean)


def last_change(desired: ArrayLike) -> Array:
    """The index at which a wish last changed; 0 if it never did."""
    desired = jnp.asarray(desired)
    changed = jnp.concatenate([jnp.zeros(1, bool), desired[1:] != desired[:-1]])
    return jnp.max(jnp.where(changed, jnp.arange(desired.size), 0))


def settling_band(moved: Trajectory, part: float) -> Array:
    """Half the width of the band into which the stiffness has to settle [N*m/rad]: a part of the change asked for."""
    wanted = jnp.asarray(moved.desired_stiffness)[-1]
    asked = jnp.abs(wanted - jnp.asarray(moved.stiffness)[last_change(moved.desired_stiffness)])
    return jnp.maximum(part * asked, _BAND_FLOOR * jnp.abs(wanted))


def _settling(moved: Trajectory, error: Array, change: Array, period: ArrayLike, part: float) -> Array:
    index = jnp.arange(error.size)
    outside = (index >= change) & ~(jnp.abs(error) <= settling_band(moved, part))
    last = jnp.max(jnp.where(outside, index, change - 1))
    never = (last >= error.size - 1) | _still_changing(change, error)
    return jnp.where(never, jnp.nan, (last + 1 - change) * period)


def _largest(values: Array) -> Array:
    """The maximum, NaN if there is one: XLA's own maximum does not always pass it on."""
    return jnp.where(jnp.any(jnp.isnan(values)), jnp.nan, jnp.max(values))


def _coupling(moved: Trajectory, change: Array) -> Array:
    difference = jnp.abs(jnp.asarray(moved.angle) - moved.undisturbed_angle)
    after = jnp.arange(difference.size) >= change
    largest = _largest(jnp.where(after, difference, 0.0))
    return jnp.where((change > 0) & ~_still_changing(change, difference), largest, jnp.nan)


def _still_changing(change: Array, error: Array) -> Array:
    """Whether the wish changes to the very end, as a sine does."""
    return (change > 0) & (change == error.size - 1)
