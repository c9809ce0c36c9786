"""How well a run went, in a handful of numbers; pure functions of trajectories, differentiable where they can be."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.numerics.compiled import compiled
from mckibben.simulation.trajectory import Trajectory

_WINDOW = 1.0  # s before and after a change of stiffness, for the coupling
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
        By how much the largest angle error in the second after the last change of the desired stiffness exceeds that in
        the second before it [rad]; NaN if the desired stiffness never changes, or never stops changing.
    estimate_rmse
        Root mean square error of the controller's estimate of the stiffness [N*m/rad].
    time_saturated, time_slack, time_outside_domain
        For how long a command was at a pressure limit, a muscle slack, a muscle outside its domain [s].
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


def measure(moved: Trajectory, period: ArrayLike, *, settling_band: float = 0.1) -> Metrics:
    """The metrics of a trajectory.

    Parameters
    ----------
    moved
        The trajectory.
    period
        Its control period [s].
    settling_band
        Half the width of the settling band, as a part of the change of stiffness that was asked for.
    """
    angle_error = jnp.asarray(moved.angle) - moved.desired_angle
    stiffness_error = jnp.asarray(moved.stiffness) - moved.desired_stiffness
    estimate_error = jnp.asarray(moved.stiffness_estimate) - moved.stiffness
    change = last_change(moved.desired_stiffness)
    return Metrics(
        angle_rmse=rms(angle_error),
        angle_max=jnp.max(jnp.abs(angle_error)),
        stiffness_rmse=rms(stiffness_error),
        stiffness_max=jnp.max(jnp.abs(stiffness_error)),
        stiffness_settling=_settling(moved, stiffness_error, change, period, settling_band),
        coupling=_coupling(angle_error, change, period),
        estimate_rmse=rms(estimate_error),
        time_saturated=jnp.sum(moved.saturated) * period,
        time_slack=jnp.sum(moved.slack) * period,
        time_outside_domain=jnp.sum(moved.outside_domain) * period,
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


def _settling(moved: Trajectory, error: Array, change: Array, period: ArrayLike, part: float) -> Array:
    wanted = jnp.asarray(moved.desired_stiffness)[-1]
    asked = jnp.abs(wanted - jnp.asarray(moved.stiffness)[change])
    band = jnp.maximum(part * asked, _BAND_FLOOR * jnp.abs(wanted))
    index = jnp.arange(error.size)
    outside = (index >= change) & ~(jnp.abs(error) <= band)
    last = jnp.max(jnp.where(outside, index, change - 1))
    never = (last >= error.size - 1) | _still_changing(change, error)
    return jnp.where(never, jnp.nan, (last + 1 - change) * period)


def _coupling(error: Array, change: Array, period: ArrayLike) -> Array:
    index = jnp.arange(error.size)
    width = _WINDOW / period
    size = jnp.abs(error)
    after = jnp.max(jnp.where((index >= change) & (index < change + width), size, 0.0))
    before = jnp.max(jnp.where((index < change) & (index >= change - width), size, 0.0))
    return jnp.where((change > 0) & ~_still_changing(change, error), after - before, jnp.nan)


def _still_changing(change: Array, error: Array) -> Array:
    """Whether the wish changes to the very end, as a sine does."""
    return (change > 0) & (change == error.size - 1)
