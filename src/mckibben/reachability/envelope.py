"""The envelope of a scenario: what its joint can hold, whether its reference can be followed, and what is nearest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mckibben.reachability.bands import Holdable, holdable
from mckibben.reachability.nearest import Offer, check_margin, offers
from mckibben.reachability.trackability import Following, Looking
from mckibben.study.scenario import Scenario
from mckibben.units import bar, deg

HEADERS = ("angle", "torque held", "torque", "stiffness", "p1, p2 at lowest", "p1, p2 at highest")


@dataclass(frozen=True)
class Envelope:
    """What is known of a scenario before it is run.

    Attributes
    ----------
    scenario
        Which.
    holds
        What its joint can hold standing, over the angle.
    following
        Its reference against that, standing and moving.
    offers
        The nearest references that can be followed; none if the wish can be, or nothing can be held at all.
    """

    scenario: Scenario
    holds: Holdable
    following: Following
    offers: tuple[Offer, ...]

    def verdict(self) -> str:
        """Whether the reference can be followed, in plain words."""
        if not self.holds.first <= self.holds.last:
            return "the joint cannot hold its load at any angle; choose another connector length or a lighter load"
        return self.following.describe()

    def rows(self) -> list[tuple[str, ...]]:
        """What can be held at about a dozen angles, as text for `HEADERS`."""
        holds = self.holds
        return [
            (
                f"{holds.angles[i] / deg:g} deg",
                f"{_small(float(holds.torque[i])):.3g} N*m",
                f"{holds.torques.lowest[i]:.3g}..{holds.torques.highest[i]:.3g} N*m",
                f"{holds.stiffness.lowest[i]:.4g}..{holds.stiffness.highest[i]:.4g} N*m/rad",
                _pressures(holds.pressures_lowest[:, i]),
                _pressures(holds.pressures_highest[:, i]),
            )
            for i in holds.rows()
        ]

    def records(self) -> dict[str, Any]:
        """All of it as plain data; angles in deg, pressures in bar, all else in SI."""
        holds, following = self.holds, self.following
        motion, bands = following.motion, following.bands
        driven = bands.driven.missing(motion.stiffness)
        return {
            "scenario": self.scenario.name,
            "reachable": following.reachable,
            "verdict": self.verdict(),
            "holdable_deg": [holds.first / deg, holds.last / deg],
            "rounding_s": motion.rounding if following.sharp.size else 0.0,
            "torque_of_motion_Nm": [float(bands.torque.min()), float(bands.torque.max())],
            "unreachable_part": float(following.failing.mean()),
            "shortfall_max": float(np.nanmax(driven)) if not np.isnan(driven).all() else math.nan,
            "table": [
                {
                    "angle_deg": float(holds.angles[i] / deg),
                    "torque_held_Nm": float(holds.torque[i]),
                    "torque_Nm": [float(edge[i]) for edge in holds.torques],
                    "stiffness": [float(edge[i]) for edge in holds.stiffness],
                    "pressures_at_lowest_bar": (holds.pressures_lowest[:, i] / bar).tolist(),
                    "pressures_at_highest_bar": (holds.pressures_highest[:, i] / bar).tolist(),
                }
                for i in holds.rows()
            ],
            "offers": [
                {
                    "kept": offer.kept.name.lower(),
                    "described": offer.describe(),
                    "amplitude": offer.amplitude,
                    "speed": offer.speed,
                    "shift_deg": offer.shift / deg,
                    "step_spread_s": offer.spread,
                    "stiffness_change": offer.stiffness_change,
                    "angle_deg": [offer.following.motion.angle.min() / deg, offer.following.motion.angle.max() / deg],
                    "stiffness": [offer.following.motion.stiffness.min(), offer.following.motion.stiffness.max()],
                }
                for offer in self.offers
            ],
        }


def envelope(scenario: Scenario, *, margin: float = 0.05, rounding: float | None = None) -> Envelope:
    """What a scenario's joint can hold, whether its reference can be followed, and the nearest that can.

    Parameters
    ----------
    scenario
        Its joint, load, valve, reference and times; the controller does not matter.
    margin
        Of the nearest references, see `nearest_references`.
    rounding
        Of jumps and corners [s], see `follow`.

    Raises
    ------
    RangeError
        If the margin or the rounding make no sense.

    Examples
    --------
    >>> found = envelope(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    >>> found.following.reachable, found.offers
    (True, ())
    >>> print(found.verdict())
    the reference is within reach throughout: standing, with its inertia, and at the speed of the valve; a jump or
    corner at 5 s rounded off over 16.6 ms
    """
    check_margin(margin)
    plant, reference = scenario.plant(), scenario.reference()
    looking = Looking.at(plant, scenario.duration, scenario.control_period)
    following = looking.follow(reference, rounding)
    holds = holdable(plant, about=float(np.mean(following.motion.angle)))
    held = holds.first <= holds.last
    found = offers(looking, reference, following, margin) if held and not following.reachable else ()
    return Envelope(scenario, holds, following, found)


def _pressures(pair: np.ndarray) -> str:
    return ", ".join(f"{_small(float(p) / bar):.3g}" for p in pair) + " bar"


def _small(value: float) -> float:
    """Without what is left of rounding, nor a negative zero."""
    return round(value, 6) + 0.0
