"""Static feasibility of a reference: whether the joint can hold its stiffness at its angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.control.base import Reference
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.simulation.problem import sampled
from mckibben.units import deg

_ROUNDING = 1e-6  # N*m/rad


@dataclass(frozen=True, repr=False)
class Feasibility:
    """A reference compared with the attainable stiffness at each control period.

    Attributes
    ----------
    times
        Shape (periods,) [s].
    desired_angle, desired_stiffness
        The setpoints [rad], [N*m/rad].
    lowest, highest
        The attainable stiffness at the desired angle while the muscles balance gravity [N*m/rad]; NaN where no
        pressures within limits hold the angle.
    """

    times: NDArray[np.float64]
    desired_angle: NDArray[np.float64]
    desired_stiffness: NDArray[np.float64]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]

    @property
    def shortfall(self) -> NDArray[np.float64]:
        """Distance of the desired stiffness from the attainable range [N*m/rad]; NaN where the angle cannot be held."""
        missing = np.maximum(self.lowest - self.desired_stiffness, self.desired_stiffness - self.highest)
        return np.where(missing > _ROUNDING, missing, np.where(np.isnan(missing), np.nan, 0.0))

    @property
    def feasible(self) -> bool:
        """Whether all of the reference can be held statically."""
        return bool(np.all(self.shortfall == 0))

    def __repr__(self) -> str:
        return f"<Feasibility: {self.describe()}>"

    def describe(self) -> str:
        """When and by how much the reference is not feasible."""
        if self.feasible:
            return "the reference is statically feasible throughout"
        missing = self.shortfall
        sentences = []
        unheld = np.isnan(missing)
        if unheld.any():
            first = np.flatnonzero(unheld)[0]
            sentences.append(
                f"no pressures within limits hold the desired angle {_when(self.times, unheld)}, "
                f"first at {self.times[first]:.3g} s ({self.desired_angle[first] / deg:.3g} deg)"
            )
        short = np.nan_to_num(missing) > 0
        if short.any():
            worst = int(np.nanargmax(missing))
            sentences.append(
                f"the desired stiffness is not attainable {_when(self.times, short)}, by up to "
                f"{missing[worst]:.3g} N*m/rad at {self.times[worst]:.3g} s (wanted "
                f"{self.desired_stiffness[worst]:.4g}, attainable "
                f"{self.lowest[worst]:.4g}..{self.highest[worst]:.4g} N*m/rad at "
                f"{self.desired_angle[worst] / deg:.3g} deg)"
            )
        return "; ".join(sentences)


def check_reference(
    plant: JointPlant, reference: Reference, *, duration: float = 10.0, control_period: float = 1e-3
) -> Feasibility:
    """Compare a reference with the attainable stiffness of a plant's joint, statically, at every control period.

    Parameters
    ----------
    plant
        Joint and load.
    reference
        The desired angle and stiffness.
    duration, control_period
        Of the run [s].

    Raises
    ------
    SimulationError
        If the times do not fit together.
    """
    times, setpoints = sampled(reference, duration, control_period)
    lowest, highest = _band(plant, setpoints.angle)
    return Feasibility(*(np.asarray(x, float) for x in (times, setpoints.angle, setpoints.stiffness, lowest, highest)))


def attainable_band(plant: JointPlant, angle: Array) -> tuple[Array, Array]:
    """Lowest and highest stiffness [N*m/rad] at which the joint holds angles [rad] against gravity."""
    return plant.joint.attainable_stiffness(angle, -plant.load.gravity_torque(angle))


_band = compiled(attainable_band)


def _when(times: NDArray[np.float64], mask: NDArray[np.bool_]) -> str:
    where = np.flatnonzero(mask)
    return f"for {mask.mean():.0%} of the run, between {times[where[0]]:.3g} s and {times[where[-1]]:.3g} s"
