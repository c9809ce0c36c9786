"""The knee's half before any control: what it can hold, in both geometries."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.joint import AntagonisticJoint
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.study.paper.settings import SETTINGS, Setting, Wish, pid_scenario
from mckibben.units import deg


@dataclass(frozen=True)
class JointMap:
    """What a joint can hold over its angle.

    Attributes
    ----------
    angles
        Shape (angles,) [rad].
    lowest, highest
        Stiffness attainable while the muscles hold the load against gravity, shape (angles,) [N*m/rad]; NaN where they
        cannot.
    torques
        Shape (torques,) [N*m].
    lowest_at, highest_at
        Stiffness attainable at each torque of the muscles, shape (torques, angles) [N*m/rad].
    gravity_torque
        What the muscles have to give, shape (angles,) [N*m].
    holdable
        The range of angle around 0 that can be held without a gap [rad]; both NaN if 0 cannot.
    """

    angles: NDArray[np.float64]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    torques: NDArray[np.float64]
    lowest_at: NDArray[np.float64]
    highest_at: NDArray[np.float64]
    gravity_torque: NDArray[np.float64]
    holdable: tuple[float, float]

    def at(self, angle: float) -> tuple[float, float]:
        """The attainable stiffness [N*m/rad] at the tabulated angle nearest to one [rad]."""
        index = int(np.argmin(np.abs(self.angles - angle)))
        return float(self.lowest[index]), float(self.highest[index])


def run_joint(*, resolution: int = 241) -> dict[str, JointMap]:
    """The maps of both geometries, by setting key, with `resolution` angles (odd, so that 0 is one of them)."""
    return {setting.key: _map(setting, resolution) for setting in SETTINGS}


def _map(setting: Setting, resolution: int) -> JointMap:
    plant = plant_of(setting)
    angles = jnp.linspace(-40 * deg, 40 * deg, resolution)
    holding = -plant.load.gravity_torque(angles)
    torques = jnp.linspace(-8.0, 8.0, resolution)
    lowest, highest = _attainable(plant.joint, angles, holding)
    lowest_at, highest_at = _attainable(plant.joint, angles[None, :], torques[:, None])
    maps = (np.asarray(x) for x in (angles, lowest, highest, torques, lowest_at, highest_at, holding))
    return JointMap(*maps, holdable=_holdable(plant, np.asarray(angles), np.isnan(np.asarray(lowest))))


def _holdable(plant: JointPlant, angles: NDArray[np.float64], lost: NDArray[np.bool_]) -> tuple[float, float]:
    """From 0 outwards to the first angle that is lost on either side, and closer between it and the one before."""
    zero = int(np.argmin(np.abs(angles)))
    if lost[zero]:
        return float("nan"), float("nan")

    def edge(outwards: NDArray[np.float64], gone: NDArray[np.bool_]) -> float:
        if not gone.any():
            return float(outwards[-1])
        first = int(np.argmax(gone))
        between = jnp.linspace(outwards[first - 1], outwards[first], len(angles))  # as many: compiled once
        lowest, _ = _attainable(plant.joint, between, -plant.load.gravity_torque(between))
        return float(between[int(jnp.argmax(jnp.isnan(lowest))) - 1])

    return edge(angles[zero::-1], lost[zero::-1]), edge(angles[zero:], lost[zero:])


@compiled
def _attainable(joint: AntagonisticJoint, angle: Array, torque: Array) -> tuple[Array, Array]:
    return joint.attainable_stiffness(angle, torque)


def plant_of(setting: Setting) -> JointPlant:
    """The plant of a setting."""
    return pid_scenario(setting, Wish.CONSTANT).plant()
