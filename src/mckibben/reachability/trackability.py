"""Trackability of a reference: statically, dynamically and within the rate limit of the valves."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.control import Reference
from mckibben.errors import RangeError
from mckibben.joint.attainable import cocontraction_segment, is_affine, leaves_domain
from mckibben.numerics.calculus import evenly_spaced
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.reachability.static import SEGMENT_MARGIN, AttainableRange, scan_points
from mckibben.reachability.trajectory import (
    ReferenceTrajectory,
    Values,
    breakpoints,
    is_near,
    reference_trajectory,
)
from mckibben.result import Result
from mckibben.simulation.engine import BatchFunction
from mckibben.simulation.feasibility import shortcomings, static_bands
from mckibben.simulation.problem import sampling_times

MAX_SMOOTHING = 0.25
"""s: widest smoothing of a jump or corner before it counts as not trackable."""


class StiffnessBands(NamedTuple):
    """Attainable stiffness [N*m/rad] along a reference trajectory, and the muscle torque of the motion [N*m].

    `static` is at rest at each angle, `dynamic` includes the torque of the motion, and `rate_limited` also requires
    commands within the valves' rate limit.
    """

    torque: Values
    static: AttainableRange
    dynamic: AttainableRange
    rate_limited: AttainableRange


def bands_along(plant: JointPlant, trajectory: ReferenceTrajectory) -> StiffnessBands:
    """Attainable stiffness at each sample, without muscle friction; see `check_trackability`."""
    motion = trajectory.angle, trajectory.velocity, trajectory.acceleration, trajectory.jerk, trajectory.stiffness_rate
    points, shape = scan_points(_is_affine(plant))[:, None], np.shape(trajectory.angle)
    lanes = [np.broadcast_to(column, (points.size, *shape)).ravel() for column in (*motion, points)]
    shared = numeric((plant, None, 0.0))
    (low, high), _ = static_bands("auto", shared, trajectory.angle)
    states, _ = _states("auto", shared[0], tuple(lanes))
    torque, feasible, stiffness, *commands = (np.reshape(column, (points.size, *shape)) for column in states)
    stiffness = np.where(feasible, stiffness, np.nan)
    joint = plant.supplied_joint
    domains = [muscle.specimen.domain for muscle in (joint.muscle1, joint.muscle2)]
    limits = [(float(domain.pressure_min), float(domain.pressure_max)) for domain in domains]
    return StiffnessBands(
        torque[0], AttainableRange(low, high), _range_of(stiffness), _within_limits(stiffness, commands, limits)
    )


def _is_affine(plant: JointPlant) -> bool:
    """Whether stiffness and commands are affine in tension; they are not with a limited rate or flow."""
    return plant.valve.is_linear and is_affine(plant.joint)


def _state(plant: JointPlant, lane: tuple[Array, ...]) -> tuple[Array, ...]:
    """Torque, feasibility, stiffness and commands of a sample, at a position along its segment of tensions."""
    joint, load = plant.supplied_joint, plant.load
    angle, velocity, acceleration, jerk, stiffness_rate, point = lane
    torque, torque_rate = jax.jvp(load.required_torque, (angle, velocity, acceleration), (velocity, acceleration, jerk))
    segment = cocontraction_segment(joint, angle, torque, None, 0.0)
    tension = segment.first + (segment.last - segment.first) * point

    def state(angle: Array, torque: Array, tension1: Array) -> tuple[Array, Array, Array]:
        paths, arms = joint.geometry.paths_and_arms(angle)
        tension2 = (torque + tension1 * arms[0]) / arms[1]
        pressures = (
            joint.tendon.pressure_for(joint.muscle1, paths[0], tension1),
            joint.tendon.pressure_for(joint.muscle2, paths[1], tension2),
        )
        return *pressures, joint.stiffness(angle, pressures)

    at, zero = (angle, torque, tension), jnp.zeros_like(tension)
    values, by_motion = jax.jvp(state, at, (velocity, torque_rate, zero))
    _, by_tension = jax.jvp(state, at, (zero, zero, jnp.ones_like(tension)))
    tension_rate = (stiffness_rate - by_motion[2]) / by_tension[2]
    rates = by_motion[0] + by_tension[0] * tension_rate, by_motion[1] + by_tension[1] * tension_rate
    commands = plant.commands_for(PlantState(angle, velocity, (values[0], values[1])), rates)
    return torque, segment.feasible, values[2], *commands


_states = BatchFunction(_state)


def _within_limits(
    stiffness: Values, commands: list[Values], limits: list[tuple[float, float]], *, tolerance: float = 1e-3
) -> AttainableRange:
    """Range of stiffness over the states with commands within limits, linear between neighbouring scan points.

    A command that is the same at both points may exceed a limit by the tolerance [Pa].
    """
    start, end = np.zeros(stiffness[1:].shape), np.ones(stiffness[1:].shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        for command, (low, high) in zip(commands, limits, strict=True):
            first, rise = command[:-1], np.diff(command, axis=0)
            for bound, sign in ((low, 1.0), (high, -1.0)):  # sign (first + rise x - bound) >= 0
                here, slope = sign * (first - bound), sign * rise
                level = slope == 0
                crossing = -here / np.where(level, 1.0, slope)
                start = np.where(~level & (slope > 0), np.fmax(start, crossing), start)
                end = np.where(~level & (slope < 0), np.fmin(end, crossing), end)
                out = (level & (here < -tolerance)) | ~np.isfinite(here) | ~np.isfinite(slope)
                start = np.where(out, np.inf, start)
        feasible = start <= end + SEGMENT_MARGIN * 10
        ends = [np.where(feasible, stiffness[:-1] + np.diff(stiffness, axis=0) * x, np.nan) for x in (start, end)]
    return _range_of(np.concatenate(ends))


def _range_of(values: Values) -> AttainableRange:
    """Minimum and maximum over the first axis, NaN ignored."""
    return AttainableRange(np.asarray(np.fmin.reduce(values), float), -np.asarray(np.fmin.reduce(-values), float))


class Trackability(Result):
    """Result of the trackability check of a reference.

    Attributes
    ----------
    trajectory, bands
        The reference with jumps and corners smoothed, and the stiffness attainable along it.
    breakpoints
        Times of jumps and corners [s].
    smoothing_sufficient
        Whether they are trackable when smoothed.
    cause
        The muscle that leaves its domain at the first angle that cannot be held, if one does.
    """

    trajectory: ReferenceTrajectory
    bands: StiffnessBands
    breakpoints: Values
    smoothing_sufficient: bool
    cause: str = ""

    @property
    def violated(self) -> NDArray[np.bool_]:
        """Mask of the samples that are not trackable, shape (samples,)."""
        return ~(self.bands.rate_limited.violation(self.trajectory.stiffness) == 0)

    @property
    def trackable(self) -> bool:
        """Whether all samples are trackable."""
        return not self.violated.any()

    def verdict(self) -> str:
        """Whether, and if not when and by how much, the reference leaves each band."""
        desired, bands = self.trajectory.stiffness, self.bands
        static, dynamic, limited = (~(band.violation(desired) == 0) for band in bands[1:])
        torque = f"with the torque of the motion, up to {np.abs(bands.torque).max():.3g} N*m"
        stages = (
            ("not even statically trackable", bands.static, static & dynamic),
            (torque, bands.dynamic, ~static & dynamic),
            ("at the rate limit of the valves", bands.rate_limited, ~dynamic & limited),
        )
        sentences = [f"{stage}: {self._violations(band, where)}" for stage, band, where in stages if where.any()]
        sentences += [self.cause] if self.cause and (static & dynamic).any() else []
        if not sentences:
            part = "" if static.any() else "statically, "
            sentences.append(f"trackable throughout: {part}dynamically and within the rate limit of the valves")
            sentences += [f"for {static.mean():.0%} of the run dynamically only, not statically"] * bool(static.any())
        return "; ".join(sentences + self._smoothing())

    def _smoothing(self) -> list[str]:
        count, width = self.breakpoints.size, f"{self.trajectory.smoothing * 1e3:.3g} ms"
        text = "smoothed over" if self.smoothing_sufficient else "not trackable even when smoothed over"
        corners = f"jump or corner at {self.breakpoints[0]:.3g} s" if count == 1 else f"{count} corners"
        return [f"{corners} {text} {width}"] if count else []

    def _violations(self, band: AttainableRange, where: NDArray[np.bool_]) -> str:
        """Violations of a band at some samples, with their times and sizes."""
        reference, missing = self.trajectory, np.where(where, band.violation(self.trajectory.stiffness), 0.0)
        run = reference.times, reference.angle, reference.stiffness, band.lowest, band.highest
        failure = f"{'the joint cannot' if self.cause else 'no pressures within limits'} give the torque"
        return " and ".join(shortcomings(*run, missing, failure))


def check_trackability(
    plant: JointPlant,
    reference: Reference,
    *,
    duration: float = 10.0,
    control_period: float = 1e-3,
    smoothing: float | None = None,
) -> Trackability:
    """Check whether a plant can track a reference with any controller.

    The desired stiffness is compared with three bands: static, as in `check_reference`; dynamic, with the torque of the
    motion (inertia and damping of the load, no friction); and rate-limited, with commands within the valves' rate
    limit. The last one is decisive: a stiffness may be attainable in motion but not statically. The transient from rest
    to the reference and the margin that a controller needs are not considered.

    Raises `SimulationError` if the control period does not divide the duration; `RangeError` if the smoothing is not
    positive.

    Parameters
    ----------
    plant
        Joint, load and valve.
    reference
        Desired angle and stiffness.
    duration, control_period
        Times of the run [s]. If springs, laws not affine in pressure, or valves with a limited rate or flow require a
        scan, at most 400 samples are checked.
    smoothing
        Width [s] over which jumps and corners are smoothed. Default: the narrowest trackable width, up to 0.25 s.

    Examples
    --------
    >>> from mckibben import FirstOrderValve, Sine, catalog
    >>> from mckibben.units import deg
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> found = check_trackability(printed, Reference(Sine(20 * deg, 0.5), 72.5), duration=2.0, control_period=0.01)
    >>> found.trackable
    False
    >>> print(found.verdict())
    not even statically trackable: the joint cannot give the torque for 65% of the run, ...
    >>> print(found.cause)
    at 10.72 deg, contraction -3.1 % is outside -3..25 % of MAS-10-180N-AA-MC-O (muscle 1); give the joint a longer ...
    """
    if smoothing is not None and not 0 < smoothing < np.inf:
        remedy = "give a positive time"
        raise RangeError(f"the smoothing is {smoothing:g} s", value=smoothing, lower=0.0, unit="s", remedy=remedy)
    times = sampling_times(duration, control_period)
    most = times.size if _is_affine(plant) else min(times.size, 400)
    checked = evenly_spaced(times.size, most)
    corners = np.union1d(*(breakpoints(signal, times) for signal in (reference.angle, reference.stiffness)))

    def smoothed_over(width: float) -> tuple[ReferenceTrajectory, StiffnessBands]:
        """The reference trajectory at the checked samples, and the bands along it."""
        whole = reference_trajectory(reference, times, smoothing=width)
        series = {name: value[checked] for name, value in vars(whole).items() if name != "smoothing"}
        trajectory = ReferenceTrajectory(**series, smoothing=width)
        return trajectory, bands_along(plant, trajectory)

    def is_trackable(width: float) -> bool:
        """Whether the reference is trackable next to its corners."""
        trajectory, bands = smoothed_over(width)
        missed = ~(bands.rate_limited.violation(trajectory.stiffness) == 0)
        return not np.any(missed & is_near(trajectory.times, corners, width / 2 + control_period))

    width, sufficient = (smoothing, True) if smoothing is not None else (4e-3, True)
    if smoothing is None and corners.size:
        spacing = float(times[-1]) / max(checked.size - 1, 1)
        width, sufficient = _narrowest(is_trackable, min(max(4e-3, 4 * spacing), MAX_SMOOTHING))
    trajectory, bands = smoothed_over(width)
    unheld = np.isnan(bands.static.lowest) & np.isnan(bands.dynamic.lowest)
    cause = leaves_domain(plant.supplied_joint, trajectory.angle, unheld)
    return Trackability(trajectory, bands, corners, sufficient, cause)


def _narrowest(is_trackable: Callable[[float], bool], least: float) -> tuple[float, bool]:
    """The narrowest trackable width [s] from the least to `MAX_SMOOTHING`, within 5 %, and whether there is one.

    A wider kernel may do worse where samples move fast: the widths of a geometric series are tried in turn.
    """
    trials = np.geomspace(least, MAX_SMOOTHING, 13).tolist()
    index = next((k for k, width in enumerate(trials) if is_trackable(width)), None)
    if index is None:
        return MAX_SMOOTHING, False
    low, high = trials[max(index - 1, 0)], trials[index]
    while high > 1.05 * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if is_trackable(middle) else (middle, high)
    return high, True
