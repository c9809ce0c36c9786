"""Where a joint hangs when there is no air in it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, ArrayLike

from mckibben.errors import SimulationError
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant

_FURTHEST = np.pi / 2  # rad
_POINTS = 721


def vented_angle(plant: JointPlant) -> float:
    """The angle [rad] where gravity and empty muscles balance, the one nearest to 0 if there are more.

    Friction and creep have no say in it: a joint may rest anywhere near.

    Raises
    ------
    SimulationError
        If there is none within 90 deg either way.

    Examples
    --------
    >>> from mckibben import FirstOrderValve, catalog
    >>> plant = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> round(vented_angle(plant) / np.pi * 180, 1)
    0.6
    """
    nearly = _zero(plant, -_FURTHEST, _FURTHEST)
    width = 2 * _FURTHEST / (_POINTS - 1)
    return _zero(plant, nearly - width, nearly + width)


def _zero(plant: JointPlant, low: float, high: float) -> float:
    """Where the torque falls through zero, or stays there."""
    angles = np.linspace(low, high, _POINTS)
    torque = np.asarray(_torque(plant, angles))
    stable = np.flatnonzero((torque[:-1] >= 0) & (torque[1:] <= 0))
    if not stable.size:
        raise SimulationError(
            "the joint has no place to rest within 90 deg when both muscles are vented",
            remedy="give it a load that hangs",
        )
    at = stable[np.argmin(np.abs(angles[stable]))]
    drop = float(torque[at] - torque[at + 1])
    part = float(torque[at]) / drop if drop > 0 else 0.0
    return float(angles[at] + part * (angles[at + 1] - angles[at]))


@compiled
def _torque(plant: JointPlant, angles: ArrayLike) -> Array:
    return plant.joint.torque(angles, (0.0, 0.0)) + plant.load.gravity_torque(angles)
