"""The nearest feasible references."""

from __future__ import annotations

import csv
import dataclasses
import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.control import Constant, Multisine, Reference, Samples, Signal, Sine, Step
from mckibben.errors import RangeError, UnreachableError
from mckibben.plant import JointPlant
from mckibben.reachability.bands import Bands, Range, holdable
from mckibben.reachability.design import Design
from mckibben.reachability.motion import Values, centre_of, kinks, rounded, rounded_values, scaled, slowed
from mckibben.reachability.trackability import Following, Looking
from mckibben.storage.files import atomic_write
from mckibben.study.parameters import with_values
from mckibben.study.scenario import ReferenceSpec, Scenario, StartSpec
from mckibben.units import deg

_SMOOTHINGS = (0.02, 0.05, 0.1, 0.2, 0.4)  # s, over which a clipped stiffness is rounded off: the least that will do
_MARGINS = (0.1, 0.2, 0.35)  # the parts of the band to stay off its ends, if the least is too little for the valve
_SLOWEST = 0.02
_ROUNDING = 1e-9  # rad
_TRIALS = 10  # of a bisection: to a part in a thousand


class Kept(enum.Enum):
    """What an offer keeps of a wish as long as it can; the value says what is changed for it."""

    ANGLE = "the stiffness first, then the amplitude"
    AMPLITUDE = "the stiffness, and the speed"
    STIFFNESS = "the amplitude alone"


@dataclass(frozen=True)
class Offer:
    """A reference that can be followed, near to one that cannot.

    Attributes
    ----------
    kept
        What it keeps of the wish.
    reference
        Which; the angle of the same kind as the wish's, the stiffness as wished or as samples.
    following
        The evidence: it can be followed, with the margin.
    times
        All the moments of its run [s], which are more where it is slower.
    amplitude, speed
        What is left of them, 0 to 1.
    shift
        By how much the centre of the angle is moved [rad].
    stiffness_change
        The largest change of the desired stiffness [N*m/rad], away from its jumps.
    spread
        The time [s] over which a step of the angle is spread; 0 if it is none.
    """

    kept: Kept
    reference: Reference
    following: Following
    times: Values
    amplitude: float
    speed: float
    shift: float
    stiffness_change: float
    spread: float = 0.0

    def describe(self) -> str:
        """What is changed, in plain words."""
        motion = self.following.motion
        changes = []
        if self.shift:
            changes.append(f"the angle about a centre moved by {self.shift / deg:+.3g} deg")
        if self.spread:
            changes.append(f"the step of the angle spread over {self.spread * 1e3:.3g} ms")
        reaches = f"{motion.angle.min() / deg:.3g}..{motion.angle.max() / deg:.3g} deg"
        if self.amplitude < 1:
            changes.append(f"{self.amplitude:.3g} of the amplitude ({reaches})")
        if self.speed < 1:
            changes.append(f"{self.speed:.3g} of the speed")
        if self.stiffness_change > 0:
            low, high = motion.stiffness.min(), motion.stiffness.max()
            changes.append(
                f"a stiffness of {low:.4g}..{high:.4g} N*m/rad, by up to {self.stiffness_change:.3g} N*m/rad "
                "other than wished"
            )
        else:
            over = f", its jumps rounded off over {motion.rounding * 1e3:.3g} ms" if self.following.sharp.size else ""
            changes.append(f"the stiffness as wished{over}")
        return ", ".join(changes)


def nearest_references(
    plant: JointPlant,
    reference: Reference,
    *,
    duration: float = 10.0,
    control_period: float = 1e-3,
    margin: float = 0.05,
    rounding: float | None = None,
) -> tuple[Offer, ...]:
    """The nearest references that can be followed; none if the wish itself can be.

    Nearest has no one meaning, so there are up to three:

    - `Kept.ANGLE`: the shape and the speed of the angle stay, with the largest part of its amplitude at which a band of
      stiffness exists at every moment; the stiffness is clipped into that band (into what can be held standing as well,
      where that is possible throughout), less the margin at either end, and rounded off as little as the valve needs.
    - `Kept.AMPLITUDE`: where the angle could be held standing: the same amplitude at the largest part of its speed,
      the stiffness clipped in the same way.
    - `Kept.STIFFNESS`: the stiffness stays as wished, with the largest part of the amplitude at which that can be.

    All stay within the angles that can be held standing, less the margin, too. An offer that is the same as an earlier
    one is left out. Where not even the centre of the angle can be held, it is moved first, as little as lets the whole
    amplitude stand if that is possible. A step of the angle is offered rounded off, as samples. Parts are found by
    bisection, on the assumption that a smaller or slower motion is an easier one; each offer is checked as a wish is.

    Parameters
    ----------
    plant
        Joint, load and valve.
    reference
        The wish.
    duration, control_period, rounding
        As for `follow`.
    margin
        The part to stay off either end of the stiffness that can be held, and of the angles (of half their range), for
        a controller to work with. The valve is asked for half of it.

    Raises
    ------
    RangeError
        If the margin is not from 0 to below a half.
    SimulationError
        If the times make no sense together.

    Examples
    --------
    >>> from mckibben import FirstOrderValve, Sine, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> wish = Reference(angle=Sine(20 * deg, 0.5), stiffness=72.5)
    >>> for offer in nearest_references(printed, wish, duration=2.0, control_period=0.01):
    ...     print(offer.kept.name, round(offer.reference.angle.amplitude / deg, 1))
    ANGLE 9.8
    STIFFNESS 2.4
    """
    check_margin(margin)
    looking = Looking.at(plant, duration, control_period)
    wished = looking.follow(reference, rounding)
    return () if wished.reachable else offers(looking, reference, wished, margin)


def check_margin(margin: float) -> None:
    """Raise unless a margin leaves something of a band."""
    if not 0 <= margin < 0.5:
        raise RangeError(
            f"the margin is {margin:g}", value=margin, lower=0.0, upper=0.5, remedy="give a part of the band below 0.5"
        )


def offers(looking: Looking, reference: Reference, wished: Following, margin: float) -> tuple[Offer, ...]:
    """The offers to a wish that has been looked at, and cannot be followed."""
    search = _Search(looking, reference, wished.motion.rounding, margin)
    found = [search.smaller(Kept.ANGLE)]
    whole = found[0] is not None and found[0].amplitude == 1
    if not whole and not isinstance(reference.angle, Constant) and search.stands():
        found.append(search.slower())
    found.append(search.smaller(Kept.STIFFNESS))
    several: list[Offer] = []
    for offer in found:
        if offer is not None and not any(_alike(offer, other) for other in several):
            several.append(_least_rounded(looking, offer))
    return tuple(several)


def _least_rounded(looking: Looking, offer: Offer) -> Offer:
    """The offer with a stiffness that jumps as wished, rounded off no more than it takes."""
    if offer.stiffness_change > 0 or offer.spread > 0 or not offer.following.sharp.size:
        return offer
    found = looking.slower(offer.speed).follow(offer.reference)
    return dataclasses.replace(offer, following=found) if found.reachable else offer


def _alike(one: Offer, other: Offer) -> bool:
    same = (one.amplitude, one.speed) == (other.amplitude, other.speed)
    return same and abs(one.stiffness_change - other.stiffness_change) < 1e-6


class _Search:
    """Trials of one wish, smaller and slower."""

    def __init__(self, looking: Looking, wish: Reference, rounding: float, margin: float) -> None:
        self.looking, self.wish, self.margin, self.rounding = looking, wish, margin, rounding
        jumps = isinstance(wish.angle, Step) and not kinks(wish.stiffness, looking.times).size
        self._edges = _SMOOTHINGS[0] if jumps else rounding  # an angle that jumps is rounded off in the offer itself
        self.about = centre_of(wish.angle, looking.times)
        table = holdable(looking.plant, about=self.about)
        off = margin * (table.last - table.first) / 2
        self.first, self.last = table.first + off, table.last - off
        self.centre = self._centre()
        self.shift = self.centre - self.about

    def _centre(self) -> float:
        """The centre of the wish if it can be held, or else the nearest one that can."""
        if math.isnan(self.first) or self.first <= self.about <= self.last:
            return self.about
        angle = np.asarray(self.wish.angle(self.looking.times), float) - self.about
        low, high = self.first - angle.min(), self.last - angle.max()  # centres at which all of it stands
        return float(np.clip(self.about, low, high)) if low <= high else (self.first + self.last) / 2

    def smaller(self, kept: Kept) -> Offer | None:
        """The largest part of the amplitude with which the angle, or the stiffness, can be kept."""
        return _largest(lambda part: self._try(kept, part, 1.0), 0.0)

    def slower(self) -> Offer | None:
        """The largest part of the speed with which the amplitude can be kept."""
        return _largest(lambda part: self._try(Kept.AMPLITUDE, 1.0, part), _SLOWEST)

    def stands(self) -> bool:
        """Whether the whole amplitude can be held standing."""
        looking = self.looking
        angle = np.asarray(self._angle(looking, 1.0, 1.0)(looking.times), float)[looking.kept]
        return not np.isnan(looking.bands(looking.standing(angle)).static.lowest).any()

    def _angle(self, looking: Looking, amplitude: float, speed: float) -> Signal:
        signal = scaled(self.wish.angle, amplitude, self.about, self.centre, self.looking.times)
        if isinstance(signal, Step):  # what can be followed is the step rounded off
            return Samples(looking.times, rounded(signal, looking.times, self.rounding / speed))  # type: ignore[arg-type]
        return slowed(signal, speed)

    def _try(self, kept: Kept, amplitude: float, speed: float) -> Offer | None:
        """The offer with parts of amplitude and speed; None if that cannot be followed."""
        looking = self.looking.slower(speed)  # the whole way, however long it takes
        angle = self._angle(looking, amplitude, speed)
        spread = self.rounding / speed if isinstance(self.wish.angle, Step) else 0.0
        wanted = self.wish.stiffness
        wanted = slowed(wanted, speed) if isinstance(wanted, Samples) else wanted
        as_wished = Reference(angle, wanted)
        reached = np.asarray(angle(looking.times), float)
        if not (self.first - _ROUNDING <= reached.min() and reached.max() <= self.last + _ROUNDING):
            return None
        found = self._checked(looking, as_wished)
        if found is not None:
            return Offer(kept, as_wished, found, looking.times, amplitude, speed, self.shift, 0.0, spread)
        if kept is Kept.STIFFNESS:
            return None
        motion = looking.motion(as_wished, self._edges)
        band = _both(looking.bands(motion))
        if np.isnan(band.lowest).any():
            return None
        wish = rounded(wanted, looking.times, self._edges)
        for part in sorted({self.margin, *(m for m in _MARGINS if m > self.margin)}):
            # On all moments, not only on those that were looked at: moving averages need even ones.
            low, high = (np.interp(looking.times, motion.times, edge) for edge in band.within(part))
            for smoothing in _SMOOTHINGS:
                values = rounded_values(np.clip(wish, low, high), looking.period, smoothing)
                reference = Reference(angle, Samples(looking.times, values))  # type: ignore[arg-type]
                found = self._checked(looking, reference)
                if found is not None:
                    change = self._change(found, motion.stiffness, wanted)
                    return Offer(kept, reference, found, looking.times, amplitude, speed, self.shift, change, spread)
        return None

    def _change(self, found: Following, wished: Values, wanted: Signal) -> float:
        """By how much the stiffness is another: than the wish as it is, or as it is rounded off."""
        sharp = np.asarray(wanted(found.motion.times), float)
        new = found.motion.stiffness
        return float(np.minimum(np.abs(new - wished), np.abs(new - sharp)).max())

    def _checked(self, looking: Looking, reference: Reference) -> Following | None:
        """The evidence that a reference can be followed, half of the margin kept; None if it cannot."""
        motion = looking.motion(reference, self._edges)
        bands = looking.bands(motion)
        if np.all(bands.driven.within(self.margin / 2).missing(motion.stiffness) == 0):
            return Following(motion, bands, looking.sharp(reference), True, 0.0)
        return None


def _both(bands: Bands) -> Range:
    """What can be held moving and standing alike, where that is so at all moments; else moving."""
    static, inertial = bands.static, bands.inertial
    low, high = np.maximum(static.lowest, inertial.lowest), np.minimum(static.highest, inertial.highest)
    return Range(low, high) if np.all(low < high) else inertial


def _largest(trial: Callable[[float], Offer | None], least: float) -> Offer | None:
    """The offer with the largest part from `least` to 1 that has one, to three digits."""
    whole = trial(1.0)
    if whole is not None:
        return whole
    best = trial(least)
    if best is None:
        return None
    low, high = least, 1.0
    for _ in range(_TRIALS):
        middle = round((low + high) / 2, 3)
        if middle in (low, high):
            break
        found = trial(middle)
        low, high, best = (low, middle, best) if found is None else (middle, high, found)
    return best


PLACES = {
    "connector_length": "joint.connector_length",
    "joint_radius": "joint.geometry.joint_radius",
    "joint_length": "joint.geometry.joint_length",
}
"""Where a scenario has the lengths of a design; a muscle's length belongs to its specimen, which the catalog has."""


def keep_offer(scenario: Scenario, offer: Offer, folder: Path, name: str) -> list[str]:
    """Write an offer as a scenario, and its samples, where it has any, as a table beside it.

    The scenario starts at rest at the first angle and stiffness of the offer; a slower one takes longer.

    Returns
    -------
    names
        Of the files.
    """
    table = folder / f"{name}.csv"
    sampled = [_is_sampled(signal) for signal in (offer.reference.angle, offer.reference.stiffness)]
    if any(sampled):
        _write_samples(table, offer)
    angle, stiffness = (_written(signal, table) for signal in (offer.reference.angle, offer.reference.stiffness))
    motion = offer.following.motion
    periods = math.ceil(scenario.duration / offer.speed / scenario.control_period - 1e-9)
    update = {
        "name": f"{scenario.name[:150]}, nearest that keeps the {offer.kept.name.lower()}",
        "signals": ReferenceSpec.model_validate({"angle": angle, "stiffness": stiffness}),
        "start": StartSpec(angle=float(motion.angle[0]), stiffness=float(motion.stiffness[0])),
        "duration": scenario.duration if offer.speed == 1 else periods * scenario.control_period,
    }
    changed = scenario.model_copy(update=update)
    if not _can_start(changed):  # the reference may begin in motion, with a torque that rest does not have
        changed = changed.model_copy(update={"start": StartSpec(angle=float(motion.angle[0]))})
    changed.to_yaml(folder / f"{name}.yaml")
    return [f"{name}.yaml", *([table.name] if any(sampled) else [])]


def keep_design(scenario: Scenario, found: Design, path: Path) -> bool:
    """Write a scenario with the lengths of a design; False if it varies one that a scenario cannot hold.

    Its start keeps the angle, and the stiffness where that can be held.
    """
    if not set(found.lengths) <= set(PLACES):
        return False
    changed = with_values(scenario, {PLACES[name]: value for name, value in found.lengths.items()})
    if not _can_start(changed):
        changed = changed.model_copy(update={"start": StartSpec(angle=scenario.start.angle)})
    changed.to_yaml(path)
    return True


def _can_start(scenario: Scenario) -> bool:
    try:
        scenario.initial(scenario.plant())
    except (UnreachableError, ValueError):
        return False
    return True


def _is_sampled(signal: Signal) -> bool:
    return not isinstance(signal, Constant | Sine | Multisine | Step)


def _write_samples(path: Path, offer: Offer) -> None:
    times = offer.times
    columns = {"time_s": times}
    for title, signal, unit in (
        ("angle_deg", offer.reference.angle, deg),
        ("stiffness_N*m/rad", offer.reference.stiffness, 1.0),
    ):
        if _is_sampled(signal):
            columns[title] = np.asarray(signal(times), float) / unit
    with atomic_write(path, overwrite=True) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.9g}" for value in row] for row in zip(*columns.values(), strict=True))


def _written(signal: Signal, table: Path) -> dict[str, Any]:
    """A signal as the mapping of a scenario, in SI."""
    match signal:
        case Constant():
            return {"constant": float(signal.value)}
        case Step():
            return {"step": {name: float(getattr(signal, name)) for name in ("before", "after", "at")}}
        case Sine():
            names = ("amplitude", "frequency", "offset", "phase")
            return {"sine": {name: float(getattr(signal, name)) for name in names}}
        case Multisine():
            lists = {name: tuple(map(float, getattr(signal, name))) for name in ("amplitudes", "frequencies", "phases")}
            given = {name: values for name, values in lists.items() if values}
            return {"multisine": {**given, "offset": float(signal.offset)}}
    return {"samples": {"file": table}}
