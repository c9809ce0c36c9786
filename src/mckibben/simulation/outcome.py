"""Outcome of a simulated run."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.mechanism.base import joints_in
from mckibben.simulation.accuracy import Positions, Runs
from mckibben.units import JointType, deg

Mask = NDArray[np.bool_]

SWUNG_OVER_AT = 90 * deg
"""Angle error of a hinge beyond which a run has diverged; of other joints times their scale."""
LEFT_REFERENCE_AT = 5 * deg
"""RMS angle error at the end of a run beyond which it has diverged, unless the reference moves by more; likewise."""


class Outcome(enum.Enum):
    """Outcome of a run; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a command at a pressure limit part of the time"
    LEFT_DOMAIN = "completed, but a muscle left its domain or its rating: the law is extrapolated there"
    SWUNG_OVER = "diverged: the angle error exceeded 90 deg"
    DIVERGED = "diverged: the state is not finite"
    NO_START = "not run: no pressures within limits hold the joint at the start"
    LEFT_REFERENCE = (
        "diverged: over the last tenth of the run the RMS angle error exceeded 5 deg and the range of the reference"
    )
    LIMIT_CYCLE = "completed, in a limit cycle: the angle oscillates faster than its reference"
    CHATTER = "completed, but it chatters: stiffness or a command oscillates faster than the reference"

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
        """Whether the run is in a limit cycle of the angle, of the stiffness or of a command."""
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
"""In the order of the codes of `outcomes`."""


def outcomes(
    metrics: Mapping[str, ArrayLike],
    *,
    angle_at_end: ArrayLike = 0.0,
    span: ArrayLike = 0.0,
    started: ArrayLike = True,
    by_joint: bool = False,
    scale: float = 1.0,
) -> NDArray[np.int8]:
    """Return the index of each run's outcome in `OUTCOMES`: the worst that applies.

    All arguments broadcast against each other.

    Parameters
    ----------
    metrics
        Fields of `Metrics` by name: ``angle_max`` [rad], not finite for a run that is not, and, where known, times
        outside the domain, above the rating and with saturated commands [s], and amplitudes of oscillations.
    angle_at_end, span
        RMS error of the angle over the last tenth of the run, and range of the reference [rad].
    started
        Whether the run could start.
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

    def positive(*names: str) -> Mask:
        return np.any(np.broadcast_arrays(*(np.asarray(metrics.get(name, 0.0)) > 0 for name in names)), axis=0)

    def in_any(of_joints: Mask) -> Mask:
        return np.any(of_joints, axis=0) if by_joint else of_joints

    worst_first = [
        (~np.asarray(started, bool), Outcome.NO_START),
        (in_any(~np.isfinite(angle_max)), Outcome.DIVERGED),
        (in_any(angle_max > SWUNG_OVER_AT * scale), Outcome.SWUNG_OVER),
        (in_any(np.asarray(angle_at_end) > np.maximum(span, LEFT_REFERENCE_AT * scale)), Outcome.LEFT_REFERENCE),
        (in_any(positive("oscillation_amplitude")), Outcome.LIMIT_CYCLE),
        (in_any(positive("stiffness_oscillation")) | positive("command_oscillation"), Outcome.CHATTER),
        (positive("time_outside_domain", "time_overloaded"), Outcome.LEFT_DOMAIN),
        (positive("time_saturated"), Outcome.SATURATED),
    ]
    conditions = np.broadcast_arrays(*(condition for condition, _ in worst_first))
    codes = [OUTCOMES.index(outcome) for _, outcome in worst_first]
    return np.select(conditions, codes, OUTCOMES.index(Outcome.COMPLETED)).astype(np.int8)
