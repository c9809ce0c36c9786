"""Greatest height of a planned jump, what limits it, and the height that the work of the muscles would allow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from mckibben.errors import McKibbenError
from mckibben.leg.jump_plan import JumpPlan, PostureLine, plan_jump
from mckibben.leg.plant import LegPlant
from mckibben.units import bar, mm

_RESOLUTION = 0.5 * mm
_POSTURES = 65  # of the line, over which the work is integrated


class JumpLimit(NamedTuple):
    """Limit of the height of a planned jump.

    Attributes
    ----------
    plan
        The highest plan found, within 0.5 mm.
    height
        Its rise of the centre of mass in flight [m].
    binding
        Why a plan that is 0.5 mm higher is refused; None if the search ended at the height that the work allows.
    stroke
        Rise of the centre of mass [m] from the squat to take-off.
    work
        Most work [J] of the muscles over this stroke, with each at the pressure at which it does most.
    work_height
        Rise in flight [m] for which this work is enough: an upper bound, without the rotation of the links and losses.
    """

    plan: JumpPlan
    height: float
    binding: McKibbenError | None
    stroke: float
    work: float
    work_height: float

    def record(self) -> dict[str, Any]:
        """Return the limit as plain data."""
        return {
            "height_mm": self.height / mm,
            "binding": None if self.binding is None else self.binding.message,
            "valve_error_bar": self.plan.valve_error / bar,
            "stroke_mm": self.stroke / mm,
            "work_J": self.work,
            "work_height_mm": self.work_height / mm,
        }

    def describe(self) -> str:
        """Return the limit as text."""
        one = self.record()
        binding = one["binding"] or "the work of the muscles is too little"
        return (
            f"highest plan: {one['height_mm']:.1f} mm in flight; above, {binding}\n"
            f"valves: pressures within {one['valve_error_bar']:.2g} bar of that plan, by their model\n"
            f"work: at most {one['work_J']:.2f} J over a stroke of {one['stroke_mm']:.1f} mm, enough for "
            f"{one['work_height_mm']:.1f} mm in flight"
        )


def limit_jump(
    plant: LegPlant,
    squat: Sequence[float],
    take_off: Sequence[float],
    *,
    height: float,
    landing_depth: float,
    stiffness: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    period: float = 0.25e-3,
) -> JumpLimit:
    """Find the greatest height of a planned jump by bisection, and what limits it.

    Parameters
    ----------
    height
        Rise in flight [m] of a plan that is possible; the other arguments and errors are those of `plan_jump`.
    """
    line = PostureLine(plant, tuple(map(float, squat)), tuple(map(float, take_off)))
    work = largest_work(plant, line)
    work_height = work / float(plant.leg.total_mass * plant.gravity) - line.stroke

    def planned(height: float) -> JumpPlan:
        return plan_jump(
            plant, squat, take_off, height=height, landing_depth=landing_depth, stiffness=stiffness, period=period
        )

    best, lower, upper, binding = planned(height), height, max(work_height, height + _RESOLUTION), None
    while upper - lower > _RESOLUTION:
        middle = (lower + upper) / 2
        try:
            best, lower = planned(middle), middle
        except McKibbenError as error:
            binding, upper = error, middle
    return JumpLimit(best, lower, binding, line.stroke, work, work_height)


def largest_work(plant: LegPlant, line: PostureLine) -> float:
    """Return the most work [J] of the muscles from the squat to take-off, each at its lowest or highest pressure."""
    leg, places = plant.leg, np.linspace(0.0, 1.0, _POSTURES)
    supply, power = float(getattr(plant.valve, "supply", None) or np.inf), np.zeros(_POSTURES)
    for one in leg.routed_muscles(tuple(line.angles(places).T)):
        shortening = -sum(np.asarray(slope) * line.change[joint] for joint, slope in one.slopes.items())
        domain = one.muscle.domain
        tensions = [
            np.asarray(one.tendon.tension(one.muscle, one.path, pressure))
            for pressure in (domain.pressure_min, min(float(domain.pressure_max), supply))
        ]
        power += np.maximum(*(tension * shortening for tension in tensions))
    return float(np.trapezoid(power, places))
