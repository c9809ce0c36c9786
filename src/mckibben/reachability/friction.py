"""Friction of both muscles of a joint along the motion of a requirement."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mckibben.muscle import Muscle, forces
from mckibben.muscle.muscle import half_widths
from mckibben.reachability.requirement import Requirement

_PARTS = 5  # contractions along the motion


def friction_force(
    muscle: Muscle,
    need: Requirement,
    candidates: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    minimum_tension: float,
    *,
    cocontracted: bool,
) -> NDArray[np.float64]:
    """Largest sum [N] of both muscles' friction, for lengths, radii and middle contractions of shape (candidates,).

    One muscle has its highest pressure and the other one its lowest, as for the largest torque; `cocontracted`: both
    have the pressure with more friction. The viscous part is that of the highest speed.
    """
    length, radius, contraction = candidates
    if not muscle.has_friction:
        return np.zeros_like(length)
    shift = radius * need.amplitude / length
    contractions = contraction + np.linspace(-1.0, 1.0, _PARTS)[:, None] * shift
    rate = radius * need.amplitude * 2 * math.pi / need.cycle

    def friction(pressure: float) -> NDArray[np.float64]:
        tension = np.maximum(forces(muscle, contractions, pressure), minimum_tension)
        sliding = half_widths(muscle.friction, tension, pressure)
        return sliding + np.asarray(muscle.friction.viscous_force(tension, rate))

    working, opposing = (friction(float(end)) for end in (muscle.domain.pressure_max, muscle.domain.pressure_min))
    if cocontracted:
        return 2 * np.maximum(working, opposing).max(axis=0)
    return (working + opposing[::-1]).max(axis=0)  # where one muscle is shorter, the other one is longer
