"""How a run ended."""

from __future__ import annotations

import enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.units import deg

SWUNG_OVER_AT = 90 * deg
"""A joint this far from where it should be is lost."""


class Outcome(enum.Enum):
    """How a run ended; the worst that applies."""

    COMPLETED = "completed"
    SATURATED = "completed, with a pressure at its limit part of the time"
    LEFT_DOMAIN = "completed, but a muscle left its domain or its rating: what happened there is extrapolation"
    SWUNG_OVER = "lost: the joint swung more than 90 deg away from where it should be"
    DIVERGED = "diverged: the state is no longer finite"
    NO_START = "not run: no pressures within limits hold the joint at the start"

    @property
    def lost(self) -> bool:
        """Whether the run came to no end that is of use."""
        return self in (Outcome.SWUNG_OVER, Outcome.DIVERGED, Outcome.NO_START)


OUTCOMES = tuple(Outcome)
"""In the order of the codes that `outcomes` gives."""


def outcomes(
    *, angle_max: ArrayLike, left_domain: ArrayLike, saturated: ArrayLike, started: ArrayLike = True
) -> NDArray[np.int8]:
    """The place of each run's outcome in `OUTCOMES`.

    Parameters
    ----------
    angle_max
        The largest error of the angle [rad]; not finite where the run diverged.
    left_domain, saturated
        Whether a muscle left its domain or its rating, and whether a command was at a limit.
    started
        Whether there was a state to start from.
    """
    angle_max = np.asarray(angle_max)
    worst_first = [
        (~np.asarray(started, bool), Outcome.NO_START),
        (~np.isfinite(angle_max), Outcome.DIVERGED),
        (angle_max > SWUNG_OVER_AT, Outcome.SWUNG_OVER),
        (np.asarray(left_domain, bool), Outcome.LEFT_DOMAIN),
        (np.asarray(saturated, bool), Outcome.SATURATED),
    ]
    conditions = np.broadcast_arrays(*(condition for condition, _ in worst_first))
    codes = [OUTCOMES.index(outcome) for _, outcome in worst_first]
    return np.select(conditions, codes, OUTCOMES.index(Outcome.COMPLETED)).astype(np.int8)
