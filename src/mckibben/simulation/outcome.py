"""Outcome of a run, simulated or measured: what judges it, by few physical facts.

It follows its reference if the RMS errors of angle and stiffness are below half of the RMS motion asked; it wears the
valves if they travel much further than the reference needs; and it has to be in time, within limits and without a limit
cycle. All of these are monotone: a run with larger errors, or whose commands move more, is never judged better.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.mechanism.base import joints_in
from mckibben.simulation.accuracy import Positions, Runs
from mckibben.units import JointType, bar, deg

Mask = NDArray[np.bool_]

SWUNG_OVER_AT = 90 * deg
"""Angle error of a hinge beyond which a run has diverged; of other joints times their scale."""
LEFT_REFERENCE_AT = 5 * deg
"""RMS angle error at the end of a run beyond which it has diverged, unless the reference moves by more; and in all of
it beyond which a joint does not hold a constant angle."""
FOLLOWED = 0.5
"""RMS error of a run that follows, at most, relative to the RMS of the motion asked: a sine half as large as asked, or
later by 29 deg of phase."""
STROKE = 6 * bar
"""Stroke of a valve, from the vent to a usual supply."""
LATE = 0.01
"""Share of missed deadlines beyond which a run is late: one period of delay more than once in a hundred."""
LEAST_MOTION = 0.2 * deg, 0.02
"""Range of angle, and of stiffness relative to it, below which a reference is constant."""


class Outcome(enum.Enum):
    """Outcome of a run; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a command at a pressure limit part of the time"
    LEFT_DOMAIN = "a muscle left its domain or its rating: the law is extrapolated there"
    NOT_FOLLOWED = "does not follow"
    LATE = "too late"
    CHATTER = "chatters: commands wear the valves"
    LIMIT_CYCLE = "in a limit cycle: the angle oscillates faster than its reference"
    LEFT_REFERENCE = (
        "diverged: over the last tenth of the run the RMS angle error exceeded 5 deg and the range of the reference"
    )
    SWUNG_OVER = "diverged: the angle error exceeded 90 deg"
    DIVERGED = "diverged: the state is not finite"
    NO_START = "not run: no pressures within limits hold the joint at the start"

    @property
    def ok(self) -> bool:
        """Whether the run follows its reference, in time, within limits and without wear of the valves."""
        return self in (Outcome.COMPLETED, Outcome.SATURATED)

    def sentence(self, joint_type: JointType) -> str:
        """Return the outcome of a run of a joint in words."""
        return joint_type.words(self.value).replace(" deg", f" {joint_type.shown('deg')}")

    @property
    def diverged(self) -> bool:
        """Whether the run left its reference for good.

        Its state is not finite, its angle error exceeded 90 deg, or over the last tenth of the run the RMS angle error
        exceeds 5 deg and the span of the reference, highest minus lowest angle: a joint that stands still within that
        span cannot reach this error, however slow its controller. Of a slide these are 90 mm and 5 mm.
        """
        return self in (Outcome.SWUNG_OVER, Outcome.DIVERGED, Outcome.LEFT_REFERENCE)

    @property
    def failed(self) -> bool:
        """Whether the run has no usable end: diverged, or not started."""
        return self.diverged or self is Outcome.NO_START

    @property
    def oscillates(self) -> bool:
        """Whether the run is in a limit cycle of the angle, or wears the valves."""
        return self in (Outcome.LIMIT_CYCLE, Outcome.CHATTER)

    @property
    def usable(self) -> bool:
        """Whether the run neither failed nor oscillates."""
        return not self.failed and not self.oscillates


def near_reference(
    setpoints: PyTree, rows: Callable[[PyTree, Runs], NDArray[np.float64]], scale: float
) -> Callable[[Positions, Runs], Mask]:
    """Return a function of positions and indices of runs: mask of the times and runs that have not swung over.

    `rows` gives values of setpoints along times and these runs; the scale is that of the `JointType`.
    """

    def near(positions: Positions, which: Runs) -> Mask:
        follows = [] if hasattr(setpoints, "dtype") else joints_in(setpoints)
        masks = [
            np.abs(x - rows(own.angle, which)) <= SWUNG_OVER_AT * scale
            for x, own in zip(positions, follows, strict=False)
        ]
        return np.all(masks, axis=0) if masks else np.ones(positions.shape[1:], bool)

    return near


OUTCOMES = tuple(Outcome)
"""In the order of the codes of `outcomes`, from the best to the worst."""


class Demand(NamedTuple):
    """Demand of a reference on a joint and its valves; each of shape () or (runs,), or (joints, ...) of a robot."""

    span: NDArray[np.float64]  # highest minus lowest angle [rad]
    angle: NDArray[np.float64]  # largest RMS error of the angle that follows [rad]
    stiffness: NDArray[np.float64]  # largest RMS error of the stiffness that follows [N*m/rad]
    travel: NDArray[np.float64]  # largest travel of a command that it needs [Pa/s]
    at_rest: NDArray[np.float64]  # of this, what a constant reference needs, too [Pa/s]

    @classmethod
    def of(cls, angle: ArrayLike, stiffness: ArrayLike, duration: float, scale: float = 1.0) -> Demand:
        """Return the demand of angles [rad] and stiffness [N*m/rad], with the time [s] along the first axis.

        The scale is that of the `JointType`. NaN is asked of the stiffness of one muscle, which is not judged. Of a
        constant stiffness half of it may be missed, of a constant angle 5 deg. A muscle needs at most the strokes
        of the reference that moves more often: a command within its range that depends on several has no more. Each of
        them, and the start, may take two: there and back, for the kick of a step or the second harmonic. One more per
        second is for friction and disturbances: a valve that opens and closes every two seconds.

        Examples
        --------
        A sine of 10 deg and 1 Hz at 14 N*m/rad: two strokes and the start, and seven of the valve.

        >>> wave = 10 * deg * np.sin(2 * np.pi * np.arange(1000) / 1000)
        >>> demand = Demand.of(wave, np.full(1000, 14.0), 1.0)
        >>> print(f"{demand.angle / deg:.3g} deg, {demand.stiffness:.3g} N*m/rad, {demand.travel / bar:.3g} bar/s")
        3.54 deg, 7 N*m/rad, 42 bar/s
        """
        angle, stiffness = np.asarray(angle), np.asarray(stiffness)
        level, (held, relative) = np.mean(np.abs(stiffness), axis=0), LEAST_MOTION
        span, angle_rms, angle_strokes = _motion(angle, held * scale)
        _, stiffness_rms, stiffness_strokes = _motion(stiffness, relative * level)
        strokes = 2 * np.maximum(angle_strokes, stiffness_strokes)
        at_rest = np.broadcast_to(STROKE * (2 + duration) / duration, np.shape(strokes))
        return cls(
            span,
            np.where(angle_rms > 0, FOLLOWED * angle_rms, LEFT_REFERENCE_AT * scale),
            FOLLOWED * np.where(stiffness_rms > 0, stiffness_rms, level),
            STROKE * strokes / duration + at_rest,
            at_rest,
        )

    def travel_needed(self, *, by_joint: bool) -> NDArray[np.float64]:
        """Largest travel [Pa/s] of a command that the joints need: a muscle may move for one after the other."""
        if not by_joint:
            return self.travel
        return np.sum(self.travel - self.at_rest, axis=0) + self.at_rest[0]


def _motion(values: NDArray, least: ArrayLike) -> tuple[NDArray[np.float64], ...]:
    """Range, RMS, and strokes (travel over range) of a motion along the first axis; 0 if constant within `least`.

    The RMS is that about the mean, or of a sine of the same range if that is larger: a run may be a part of a period.
    """
    span = np.ptp(values, axis=0)
    moves, travel = span > least, np.abs(np.diff(values, axis=0)).sum(axis=0)
    rms = np.maximum(np.std(values, axis=0), span / np.sqrt(8))
    return span, np.where(moves, rms, 0.0), np.where(moves, travel / np.where(moves, span, 1.0), 0.0)


def outcomes(
    metrics: Mapping[str, ArrayLike],
    demand: Demand | None = None,
    *,
    angle_at_end: ArrayLike = 0.0,
    started: ArrayLike = True,
    missed: float = 0.0,
    by_joint: bool = False,
    scale: float = 1.0,
) -> NDArray[np.int8]:
    """Return the index of each run's outcome in `OUTCOMES`: the worst that applies.

    All arguments broadcast against each other.

    Parameters
    ----------
    metrics
        Fields of `Metrics` by name: ``angle_max`` [rad], not finite for a run that is not, and, where known, the RMS
        errors, the travel of commands, times outside the domain, above the rating and with saturated commands [s], and
        amplitudes of limit cycles.
    demand
        Demand of the reference; None for a run without one.
    angle_at_end
        RMS error of the angle over the last tenth of the run [rad].
    started
        Whether the run could start.
    missed
        Share of missed deadlines.
    by_joint
        Whether the numbers of angles and stiffness have the joints along their first axis.
    scale
        That of the `JointType`.

    Examples
    --------
    >>> code = outcomes({"angle_max": [0.01, 2.0], "time_saturated": 0.1})
    >>> [OUTCOMES[index].name for index in code]
    ['SATURATED', 'SWUNG_OVER']
    """
    angle_max = np.asarray(metrics["angle_max"])

    def metric(name: str) -> NDArray[np.float64]:
        return np.asarray(metrics.get(name, 0.0))

    def in_any(of_joints: Mask) -> Mask:
        return np.any(of_joints, axis=0) if by_joint else of_joints

    conditions = {
        Outcome.NO_START: ~np.asarray(started, bool),
        Outcome.DIVERGED: in_any(~np.isfinite(angle_max)),
        Outcome.SWUNG_OVER: in_any(angle_max > SWUNG_OVER_AT * scale),
        Outcome.LIMIT_CYCLE: in_any(metric("oscillation_amplitude") > 0),
        Outcome.LATE: np.asarray(missed > LATE),
        Outcome.LEFT_DOMAIN: (metric("time_outside_domain") > 0) | (metric("time_overloaded") > 0),
        Outcome.SATURATED: metric("time_saturated") > 0,
    }
    if demand is not None:
        needed = demand.travel_needed(by_joint=by_joint)
        conditions |= {
            Outcome.LEFT_REFERENCE: in_any(
                np.asarray(angle_at_end) > np.maximum(demand.span, LEFT_REFERENCE_AT * scale)
            ),
            Outcome.CHATTER: metric("command_travel") > needed,
            Outcome.NOT_FOLLOWED: in_any(metric("angle_rmse") > demand.angle)
            | in_any(metric("stiffness_rmse") > demand.stiffness),
        }
    worst_first = [outcome for outcome in reversed(OUTCOMES) if outcome in conditions]
    masks = np.broadcast_arrays(*(conditions[outcome] for outcome in worst_first))
    codes = [OUTCOMES.index(outcome) for outcome in worst_first]
    return np.select(masks, codes, OUTCOMES.index(Outcome.COMPLETED)).astype(np.int8)
