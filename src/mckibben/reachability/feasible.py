"""Nearest feasible references for a reference that is not trackable."""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mckibben.control import Constant, Reference, Samples, Signal, Step
from mckibben.errors import RangeError
from mckibben.plant import JointPlant
from mckibben.reachability.static import AttainableRange, static_envelope
from mckibben.reachability.trackability import StiffnessBands, Trackability, TrackabilityChecker, bands_along
from mckibben.reachability.trajectory import Values, breakpoints, centre_of, scaled, slowed, smoothed, smoothed_values
from mckibben.units import deg

_STIFFNESS_SMOOTHING = (0.02, 0.05, 0.1, 0.2, 0.4)  # s, of a clipped stiffness; the narrowest trackable one is used
_MARGINS = (0.1, 0.2, 0.35)  # of the band, tried if a smaller one exceeds the rate limit of the valves
_MIN_SPEED = 0.02
_ANGLE_TOLERANCE = 1e-9  # rad
_BISECTIONS = 10  # to three digits


class Preserved(enum.Enum):
    """Property of the reference preserved as far as possible; the value names the properties that are changed."""

    ANGLE = "stiffness first, then amplitude"
    AMPLITUDE = "stiffness and speed"
    STIFFNESS = "amplitude only"


@dataclass(frozen=True)
class FeasibleReference:
    """A trackable reference close to one that is not."""

    preserved: Preserved
    reference: Reference  # angle of the same kind of signal (samples for a step); stiffness unchanged or as samples
    trackability: Trackability  # the check that it passed, with the margin
    times: Values  # of the samples [s]
    amplitude: float  # factor on the amplitude, 0 to 1
    speed: float  # factor on the speed, 0 to 1
    shift: float  # of the centre of the angle [rad]
    stiffness_change: float  # largest, away from jumps of the stiffness [N*m/rad]
    step_smoothing: float = 0.0  # time over which a step of the angle is smoothed [s]

    def __repr__(self) -> str:
        return f"<FeasibleReference: {self.describe()}>"

    def describe(self) -> str:
        """Changes to the reference, in words."""
        trajectory = self.trackability.trajectory
        changes = []
        if self.shift:
            changes.append(f"centre of the angle shifted by {self.shift / deg:+.3g} deg")
        if self.step_smoothing:
            changes.append(f"step of the angle smoothed over {self.step_smoothing * 1e3:.3g} ms")
        if self.amplitude < 1:
            angles = f"{trajectory.angle.min() / deg:.3g}..{trajectory.angle.max() / deg:.3g} deg"
            changes.append(f"amplitude x {self.amplitude:.3g} ({angles})")
        if self.speed < 1:
            changes.append(f"speed x {self.speed:.3g}")
        if self.stiffness_change > 0:
            low, high = trajectory.stiffness.min(), trajectory.stiffness.max()
            changes.append(
                f"stiffness {low:.4g}..{high:.4g} N*m/rad, changed by up to {self.stiffness_change:.3g} N*m/rad"
            )
        else:
            jumps = self.trackability.breakpoints.size
            changes.append(
                "stiffness unchanged" + (f", smoothed over {trajectory.smoothing * 1e3:.3g} ms" if jumps else "")
            )
        return ", ".join(changes)


def nearest_references(
    plant: JointPlant,
    reference: Reference,
    *,
    duration: float = 10.0,
    control_period: float = 1e-3,
    margin: float = 0.05,
    smoothing: float | None = None,
) -> tuple[FeasibleReference, ...]:
    """Find the feasible references nearest to a reference; none if it is already trackable.

    There are up to three, without duplicates:

    - `Preserved.ANGLE`: shape and speed of the angle, at the largest amplitude for which some stiffness is attainable
      throughout; the stiffness is clipped to the attainable band (and to the static one, if possible) minus the margin.
    - `Preserved.AMPLITUDE`, if the angle is statically feasible: the whole amplitude at the highest feasible speed,
      with the stiffness clipped likewise.
    - `Preserved.STIFFNESS`: the stiffness, at the largest feasible amplitude.

    All stay within the static range of angles minus the margin. If even the centre of the angle is not static, it is
    shifted by the least amount that makes the whole amplitude static, if possible. A step of the angle is smoothed and
    returned as samples. Factors are found by bisection, assuming that a smaller or slower motion is easier to track;
    each result passes the full check.

    Raises `RangeError` if the margin is not within [0, 0.5); `SimulationError` if the control period does not divide
    the duration.

    Other arguments are those of `check_trackability`; `margin` is the fraction of the stiffness band, and of half the
    range of angles, kept free at either end for the controller; the rate-limited band keeps half of it.

    Examples
    --------
    >>> from mckibben import FirstOrderValve, Sine, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> desired = Reference(angle=Sine(20 * deg, 0.5), stiffness=72.5)
    >>> for found in nearest_references(printed, desired, duration=2.0, control_period=0.01):
    ...     print(found.preserved.name, round(found.reference.angle.amplitude / deg, 1))
    ANGLE 9.8
    STIFFNESS 2.4
    """
    check_margin(margin)
    checker = TrackabilityChecker.of(plant, duration, control_period)
    checked = checker.check(reference, smoothing)
    return () if checked.trackable else find_nearest(checker, reference, checked, margin)


def check_margin(margin: float) -> None:
    """Raise unless 0 <= margin < 0.5."""
    if not 0 <= margin < 0.5:
        remedy = "give a fraction of the band below 0.5"
        raise RangeError(f"the margin is {margin:g}", value=margin, lower=0.0, upper=0.5, remedy=remedy)


def find_nearest(
    checker: TrackabilityChecker, reference: Reference, checked: Trackability, margin: float
) -> tuple[FeasibleReference, ...]:
    """Nearest feasible references for a checked reference that is not trackable."""
    search = _Search(checker, reference, checked.trajectory.smoothing, margin)
    found = [search.largest_amplitude(Preserved.ANGLE)]
    unscaled = found[0] is not None and found[0].amplitude == 1
    if not unscaled and not isinstance(reference.angle, Constant) and search.is_static():
        found.append(search.highest_speed())
    found.append(search.largest_amplitude(Preserved.STIFFNESS))
    distinct: list[FeasibleReference] = []
    for one in found:
        if one is not None and not any(_is_same(one, other) for other in distinct):
            distinct.append(one)
    return tuple(distinct)


def _is_same(one: FeasibleReference, other: FeasibleReference) -> bool:
    same = (one.amplitude, one.speed) == (other.amplitude, other.speed)
    return same and abs(one.stiffness_change - other.stiffness_change) < 1e-6


class _Search:
    """Search over amplitude and speed of one reference."""

    def __init__(self, checker: TrackabilityChecker, reference: Reference, smoothing: float, margin: float) -> None:
        self.checker, self.reference, self.margin, self.smoothing = checker, reference, margin, smoothing
        only_step = isinstance(reference.angle, Step) and not breakpoints(reference.stiffness, checker.times).size
        self._width = _STIFFNESS_SMOOTHING[0] if only_step else smoothing  # a step of the angle is smoothed in _angle
        self.about = centre_of(reference.angle, checker.times)
        envelope = static_envelope(checker.plant, about=self.about)
        reserve = margin * (envelope.angle_max - envelope.angle_min) / 2
        self.angle_min, self.angle_max = envelope.angle_min + reserve, envelope.angle_max - reserve
        self.centre = self._nearest_centre()
        self.shift = self.centre - self.about

    def _nearest_centre(self) -> float:
        """The nearest static centre of the angle."""
        if math.isnan(self.angle_min) or self.angle_min <= self.about <= self.angle_max:
            return self.about
        angle = np.asarray(self.reference.angle(self.checker.times), float) - self.about
        low, high = self.angle_min - angle.min(), self.angle_max - angle.max()  # the whole amplitude is static between
        return float(np.clip(self.about, low, high)) if low <= high else (self.angle_min + self.angle_max) / 2

    def largest_amplitude(self, preserved: Preserved) -> FeasibleReference | None:
        """Feasible reference of the largest amplitude."""
        return _bisect(lambda factor: self._try(preserved, factor, 1.0), 0.0)

    def highest_speed(self) -> FeasibleReference | None:
        """Feasible reference of the whole amplitude and the highest speed."""
        return _bisect(lambda factor: self._try(Preserved.AMPLITUDE, 1.0, factor), _MIN_SPEED)

    def is_static(self) -> bool:
        """Whether the whole amplitude is statically feasible."""
        checker = self.checker
        angle = np.asarray(self._angle(checker, 1.0, 1.0)(checker.times), float)[checker.checked]
        static = bands_along(checker.plant, checker.static_trajectory(angle)).static
        return not np.isnan(static.lowest).any()

    def _angle(self, checker: TrackabilityChecker, amplitude: float, speed: float) -> Signal:
        signal = scaled(self.reference.angle, amplitude, self.about, self.centre, self.checker.times)
        if isinstance(signal, Step):
            return Samples(checker.times, smoothed(signal, checker.times, self.smoothing / speed))
        return slowed(signal, speed)

    def _try(self, preserved: Preserved, amplitude: float, speed: float) -> FeasibleReference | None:
        """The feasible reference at an amplitude and speed; None if there is none."""
        checker = self.checker.slowed(speed)
        angle = self._angle(checker, amplitude, speed)
        step_smoothing = self.smoothing / speed if isinstance(self.reference.angle, Step) else 0.0
        stiffness = self.reference.stiffness
        stiffness = slowed(stiffness, speed) if isinstance(stiffness, Samples) else stiffness
        unchanged = Reference(angle, stiffness)
        angles = np.asarray(angle(checker.times), float)
        beyond = max(self.angle_min - angles.min(), angles.max() - self.angle_max)
        if not beyond <= _ANGLE_TOLERANCE:
            return None

        def made(reference: Reference, checked: Trackability, change: float) -> FeasibleReference:
            times = checker.times
            return FeasibleReference(
                preserved, reference, checked, times, amplitude, speed, self.shift, change, step_smoothing
            )

        checked = self._checked(checker, unchanged)
        if checked is not None:
            return made(unchanged, checked, 0.0)
        if preserved is Preserved.STIFFNESS:
            return None
        trajectory = checker.trajectory(unchanged, self._width)
        band = _static_and_dynamic(bands_along(checker.plant, trajectory))
        if np.isnan(band.lowest).any():
            return None
        desired = smoothed(stiffness, checker.times, self._width)
        for margin, width in itertools.product(sorted({self.margin, *_MARGINS}), _STIFFNESS_SMOOTHING):
            # at all sample times, not only the checked ones: moving averages need even spacing
            low, high = (np.interp(checker.times, trajectory.times, bound) for bound in band.shrunk(margin))
            values = smoothed_values(np.clip(desired, low, high), checker.period, width)
            reference = Reference(angle, Samples(checker.times, values))
            checked = self._checked(checker, reference) if margin >= self.margin else None
            if checked is not None:
                return made(reference, checked, _stiffness_change(checked, trajectory.stiffness, stiffness))
        return None

    def _checked(self, checker: TrackabilityChecker, reference: Reference) -> Trackability | None:
        """The check of a reference if it is trackable with half of the margin; else None."""
        trajectory = checker.trajectory(reference, self._width)
        bands = bands_along(checker.plant, trajectory)
        if np.all(bands.rate_limited.shrunk(self.margin / 2).violation(trajectory.stiffness) == 0):
            return Trackability(trajectory, bands, checker.breakpoints(reference), True, 0.0)
        return None


def _stiffness_change(checked: Trackability, smooth: Values, desired: Signal) -> float:
    """Largest change of the stiffness from the desired one or its smoothed form, whichever is closer."""
    new = checked.trajectory.stiffness
    unsmoothed = np.asarray(desired(checked.trajectory.times), float)
    return float(np.minimum(np.abs(new - smooth), np.abs(new - unsmoothed)).max())


def _static_and_dynamic(bands: StiffnessBands) -> AttainableRange:
    """Intersection of the static and the dynamic band; the dynamic band if the intersection is empty at any sample."""
    static, dynamic = bands.static, bands.dynamic
    low, high = np.maximum(static.lowest, dynamic.lowest), np.minimum(static.highest, dynamic.highest)
    return AttainableRange(low, high) if np.all(low < high) else dynamic


def _bisect(trial: Callable[[float], FeasibleReference | None], least: float) -> FeasibleReference | None:
    """Result for the largest factor in [least, 1] that has a result, to three digits."""
    best = trial(1.0)
    if best is not None:
        return best
    best = trial(least)
    if best is None:
        return None
    low, high = least, 1.0
    for _ in range(_BISECTIONS):
        middle = round((low + high) / 2, 3)
        if middle in (low, high):
            break
        found = trial(middle)
        low, high, best = (low, middle, best) if found is None else (middle, high, found)
    return best
