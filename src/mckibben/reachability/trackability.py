"""Can a reference be followed: standing, with the inertia of its motion, and at the speed of the valve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.control import Reference
from mckibben.errors import RangeError
from mckibben.joint.attainable import is_affine
from mckibben.plant import JointPlant
from mckibben.reachability.bands import Bands, Range, bands_along
from mckibben.reachability.motion import Motion, Values, kinks, motion_of, near, rounded
from mckibben.simulation.problem import sampling_times
from mckibben.units import deg

MOST_ROUNDING = 0.25
"""s: the longest time over which a jump or corner is rounded off before it counts as out of reach."""

_FINEST = 4e-3  # s
_RUNGS = 13  # of the search for it: a longer one may do worse, where samples move fast
_MANY = 20  # corners: then they are samples of something smooth
_MOST_SCANNED = 400  # moments, for joints whose bands have to be scanned


@dataclass(frozen=True)
class Following:
    """A reference held against what a plant can follow.

    Attributes
    ----------
    motion
        The reference, its jumps and corners rounded off.
    bands
        The stiffness that can be held along it.
    sharp
        Where its jumps and corners are [s].
    rounded_enough
        Whether their rounding is enough for what lies within its reach.
    deviation
        How far the rounding moves the angle [rad] away from the jumps at most.
    """

    motion: Motion
    bands: Bands
    sharp: Values
    rounded_enough: bool
    deviation: float

    @property
    def failing(self) -> NDArray[np.bool_]:
        """The moments at which the reference cannot be followed, shape (moments,)."""
        return ~(self.bands.driven.missing(self.motion.stiffness) == 0)

    @property
    def reachable(self) -> bool:
        """Whether all of it can be followed."""
        return not self.failing.any()

    def describe(self) -> str:
        """Whether, and if not when, why and by how much, in plain words."""
        static, inertial, driven = (
            band.missing(self.motion.stiffness) for band in (self.bands.static, self.bands.inertial, self.bands.driven)
        )
        sentences = []
        still = ~(static == 0) & ~(inertial == 0)
        if still.any():
            sentences.append(f"even standing still, {_lost(self.motion, self.bands.static, static, still)}")
        moved = (static == 0) & ~(inertial == 0)
        if moved.any():
            most = float(np.abs(self.bands.torque[moved]).max())
            lost = _lost(self.motion, self.bands.inertial, inertial, moved)
            sentences.append(f"with the torque of the motion, up to {most:.3g} N*m of the muscles, {lost}")
        slow = (inertial == 0) & ~(driven == 0)
        if slow.any():
            sentences.append(f"at the speed of the valve {_lost(self.motion, self.bands.driven, driven, slow)}")
        if not sentences:
            carried = ~(static == 0)
            standing = "standing, " if not carried.any() else ""
            sentences.append(
                f"the reference is within reach throughout: {standing}with its inertia, and at the speed of the valve"
            )
            if carried.any():
                sentences.append(
                    f"for {carried.mean():.0%} of the run only the torque of the motion brings it there: standing "
                    "still, the same could not be held"
                )
        return "; ".join(sentences) + self._rounding()

    def _rounding(self) -> str:
        if not self.sharp.size:
            return ""
        over = f"{self.motion.rounding * 1e3:.3g} ms"
        moved = f" (by {self.deviation / deg:.2g} deg at most)" if self.deviation > 0.005 * deg else ""
        many = f"a jump or corner at {self.sharp[0]:.3g} s" if self.sharp.size == 1 else f"{self.sharp.size} corners"
        many = "its samples" if self.sharp.size > _MANY else many
        if self.rounded_enough:
            return f"; {many} rounded off over {over}{moved}"
        return f"; {many} out of reach even if rounded off over {over}"


def _lost(motion: Motion, band: Range, missing: Values, where: NDArray[np.bool_]) -> str:
    """What is missing at some moments, and when."""
    times, sentences = motion.times, []
    gone, short = where & np.isnan(missing), where & (missing > 0)
    if gone.any():
        first = int(np.flatnonzero(gone)[0])
        sentences.append(
            f"no pressures within limits will do {_when(times, gone)}, first at {times[first]:.3g} s "
            f"({motion.angle[first] / deg:.3g} deg)"
        )
    if short.any():
        worst = int(np.argmax(np.where(short, missing, 0.0)))
        sentences.append(
            f"the stiffness is out of reach {_when(times, short)}, by up to {missing[worst]:.3g} N*m/rad at "
            f"{times[worst]:.3g} s (wanted {motion.stiffness[worst]:.4g}, attainable {band.lowest[worst]:.4g}.."
            f"{band.highest[worst]:.4g} N*m/rad at {motion.angle[worst] / deg:.3g} deg)"
        )
    return " and ".join(sentences)


def _when(times: Values, where: NDArray[np.bool_]) -> str:
    at = np.flatnonzero(where)
    part = f"{where.mean():.0%}" if where.mean() >= 0.005 else "under 1%"
    return f"for {part} of the run, between {times[at[0]]:.3g} s and {times[at[-1]]:.3g} s"


def follow(
    plant: JointPlant,
    reference: Reference,
    *,
    duration: float = 10.0,
    control_period: float = 1e-3,
    rounding: float | None = None,
) -> Following:
    """Hold a reference against what a plant can follow, from the joint, the load and the valve alone.

    Three bands of stiffness along the reference: of the joint standing at the angle, as `check_reference` has it; with
    the torque that the motion takes (inertia and damping of the load; no friction); and with commands that make the
    valves follow, within the pressures that they let through. The last decides: the torque of a motion may bring
    within reach what cannot be held standing. Not looked at are the way from rest to the reference at the start, and
    what a controller needs to correct errors.

    Parameters
    ----------
    plant
        Joint, load and valve.
    reference
        The wish.
    duration, control_period
        The moments to look at [s]; some 400 of them where springs or bent laws make each one dear.
    rounding
        The time [s] over which jumps (of steps) and corners (of samples) are rounded off. Unless given, the least with
        which they can be followed, up to a quarter of a second.

    Raises
    ------
    SimulationError
        If the times make no sense together.
    RangeError
        If the rounding is no positive time.

    Examples
    --------
    >>> from mckibben import FirstOrderValve, Sine, catalog
    >>> from mckibben.units import deg
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> found = follow(printed, Reference(Sine(20 * deg, 0.5), 72.5), duration=2.0, control_period=0.01)
    >>> found.reachable
    False
    >>> print(found.describe())
    even standing still, no pressures within limits will do for 65% of the run, ...
    """
    return Looking.at(plant, duration, control_period).follow(reference, rounding)


@dataclass(frozen=True)
class Looking:
    """A plant and the moments at which references are held against it: what many trials share.

    Attributes
    ----------
    plant
        Joint, load and valve.
    times
        All moments [s].
    kept
        The indices of those at which the bands are worked out.
    """

    plant: JointPlant
    times: Values
    kept: NDArray[np.int_]

    @classmethod
    def at(cls, plant: JointPlant, duration: float, control_period: float) -> Looking:
        """The moments of a run."""
        times = sampling_times(duration, control_period)
        most = times.size if is_affine(plant.joint) else min(times.size, _MOST_SCANNED)
        return cls(plant, times, np.unique(np.linspace(0, times.size - 1, most).round().astype(int)))

    @property
    def period(self) -> float:
        """The time between two moments [s]."""
        return float(self.times[1]) if self.times.size > 1 else 1.0

    def slower(self, speed: float) -> Looking:
        """As many moments of a run that takes longer."""
        return self if speed == 1 else Looking(self.plant, self.times / speed, self.kept)

    def motion(self, reference: Reference, rounding: float) -> Motion:
        """A reference at the moments that are kept."""
        whole = motion_of(reference, self.times, rounding=rounding)
        series = {name: value[self.kept] for name, value in vars(whole).items() if name != "rounding"}
        return Motion(**series, rounding=rounding)

    def bands(self, motion: Motion) -> Bands:
        """What can be held along it."""
        return bands_along(self.plant, motion)

    def sharp(self, reference: Reference) -> Values:
        """Where a reference has jumps and corners [s]."""
        return np.union1d(*(kinks(signal, self.times) for signal in (reference.angle, reference.stiffness)))

    def rounding_for(self, reference: Reference) -> tuple[float, bool]:
        """The least rounding [s] with which jumps and corners can be followed, to a part in 20; and whether it does."""
        sharp = self.sharp(reference)
        if not sharp.size:
            return _FINEST, True

        def followed(rounding: float) -> bool:
            motion = self.motion(reference, rounding)
            short = self.bands(motion).driven.missing(motion.stiffness)
            return not np.any(near(motion.times, sharp, rounding / 2 + self.period) & ~(short == 0))

        apart = float(self.times[-1]) / max(self.kept.size - 1, 1)
        finest = min(max(_FINEST, 4 * apart), MOST_ROUNDING)  # what is rounded off has to be looked at a few times
        ladder = np.geomspace(finest, MOST_ROUNDING, _RUNGS)
        rung = next((k for k, rounding in enumerate(ladder) if followed(float(rounding))), None)
        if rung is None:
            return MOST_ROUNDING, False
        low, high = float(ladder[max(rung - 1, 0)]), float(ladder[rung])
        while high > 1.05 * low:
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if followed(middle) else (middle, high)
        return high, True

    def follow(self, reference: Reference, rounding: float | None = None) -> Following:
        """See `follow`."""
        if rounding is not None and not 0 < rounding < np.inf:
            raise RangeError(
                f"the rounding is {rounding:g} s", value=rounding, lower=0.0, unit="s", remedy="give a positive time"
            )
        chosen, enough = self.rounding_for(reference) if rounding is None else (rounding, True)
        motion = self.motion(reference, chosen)
        bands = self.bands(motion)
        sharp = self.sharp(reference)
        angle = np.asarray(reference.angle(motion.times), float)
        plain = ~near(motion.times, kinks_of_jumps(reference, self.times), chosen)
        moved = np.abs(rounded(reference.angle, self.times, chosen)[self.kept] - angle) if sharp.size else 0 * angle
        deviation = float(np.max(moved, where=plain, initial=0.0))
        return Following(motion, bands, sharp, enough, deviation)

    def standing(self, angle: Values) -> Motion:
        """No motion at angles."""
        still = np.zeros_like(angle)
        return Motion(self.times[self.kept], angle, still, still, still, still, still, _FINEST)


def kinks_of_jumps(reference: Reference, times: Values) -> Values:
    """Where the angle jumps [s]: there a rounding moves it far, and that is its purpose."""
    from mckibben.control import Step

    return kinks(reference.angle, times) if isinstance(reference.angle, Step) else np.empty(0)
