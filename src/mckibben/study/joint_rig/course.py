"""What a joint rig is to do, what it tells meanwhile, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import McKibbenError
from mckibben.study.joint_rig.rows import Phase
from mckibben.study.joint_rig.wiring import Reading


@dataclass(frozen=True)
class Course:
    """What a joint rig is to do.

    Attributes
    ----------
    wishes
        Angle [rad] and stiffness [N*m/rad] at the start of each period of the run, shape (periods, 2).
    period
        The control period [s].
    raising
        Periods in which the pressures are brought to `pressures` along a straight line, without the controller.
    settling
        Periods in which the controller then holds the first wish, before the run begins.
    pressures
        [Pa].
    limited_to
        The commands of each muscle are cut off at these [Pa]: (lowest, highest), (lowest, highest).
    """

    wishes: NDArray[np.float64]
    period: float
    raising: int
    settling: int
    pressures: tuple[float, float]
    limited_to: tuple[tuple[float, float], tuple[float, float]]

    @property
    def periods(self) -> int:
        """Of all three parts."""
        return self.raising + self.settling + len(self.wishes)


class Shown(NamedTuple):
    """What a run tells while it is on: how far it is [s], the reading, the wished angle [rad], missed deadlines."""

    time: float
    of: float
    phase: Phase
    reading: Reading
    wish: float
    missed: int


@dataclass(frozen=True)
class Ending:
    """How a run ended.

    Attributes
    ----------
    kind
        "completed"; or "limit", "signal", "silent" ... in a word, for programs.
    text
        In words, for people.
    error
        What stopped it, if something did.
    vented_after
        How long after the vent both pressures were below 0.2 bar [s]; None if they were not seen to be.
    """

    kind: str
    text: str
    error: McKibbenError | None = None
    vented_after: float | None = None

    @property
    def completed(self) -> bool:
        """Whether the run went to its end."""
        return self.error is None
