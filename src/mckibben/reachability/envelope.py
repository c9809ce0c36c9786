"""Reachability of a scenario: static envelope, trackability, nearest feasible references, and files of the results."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import checked_call
from mckibben.control import Constant, Multisine, Reference, SamplesFile, Signal, Sine, Step
from mckibben.errors import ParameterError, RangeError, UnreachableError, no_attribute
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import unattainable
from mckibben.muscle import Muscle
from mckibben.notebook import draw, html_table
from mckibben.reachability.feasible import FeasibleReference, check_margin, find_nearest
from mckibben.reachability.lengths import design_lengths
from mckibben.reachability.sizing import Design
from mckibben.reachability.static import StaticEnvelope, Values, static_envelope
from mckibben.reachability.trackability import Trackability, TrackabilityChecker
from mckibben.scenario import Scenario, Start, with_values
from mckibben.storage.files import atomic_write
from mckibben.units import bar, deg

_MEANT = {
    **{one: f"static.{one}" for one in ("stiffness", "small_motion", "torque_range", "angles", "pressures_at_lowest")},
    **{one: f"trackability.{one}" for one in ("trackable", "violated", "bands", "trajectory")},
}
"""Suggestions for unknown attributes of an envelope."""


@dataclass(frozen=True)
class Envelope:
    """Reachability of a scenario: static envelope of its joint, check of its reference and nearest feasible references.

    `nearest` is empty if the reference is trackable or no state is static.
    """

    scenario: Scenario
    static: StaticEnvelope
    trackability: Trackability
    nearest: tuple[FeasibleReference, ...]

    if not TYPE_CHECKING:  # an unknown attribute stays an error of the type checker

        def __getattr__(self, name: str) -> Any:
            raise no_attribute(self, name, _MEANT)

    def __repr__(self) -> str:
        return f"<Envelope of {self.scenario.name!r}: {self.verdict()}>"

    def _repr_html_(self) -> str:
        return html_table(self.scenario.name, self.headers, self.rows(), [self.verdict(), *self.remarks()])

    @property
    def headers(self) -> tuple[str, ...]:
        """Columns of `rows`."""
        small = ("small-motion stiffness",) if self.static.small_motion else ()
        ends = "p1, p2 at lowest", "p1, p2 at highest"
        return ("angle", "gravity torque", "torque range", "stiffness range", *small, *ends)

    def plot(self) -> Any:
        """Return a figure of attainable set and reference, see `mckibben.report.envelope`."""
        return draw("envelope", self)

    def verdict(self) -> str:
        """Verdict on the reference, in words."""
        if not self.static.exists:
            plant, angle = self.scenario.plant(), float(self.trackability.trajectory.angle[0])
            why = unattainable(plant.supplied_joint, angle, -float(plant.load.gravity_torque(angle)))
            return f"the joint cannot hold its load at any angle; at {angle / deg:.4g} deg, {why}"
        return self.trackability.describe()

    def rows(self) -> list[tuple[str, ...]]:
        """Static envelope at no more than 11 angles, as text."""
        static = self.static
        return [
            (
                f"{static.angles[i] / deg:g} deg",
                f"{_rounded(float(static.torque[i])):.3g} N*m",
                f"{static.torque_range.lowest[i]:.3g}..{static.torque_range.highest[i]:.3g} N*m",
                *(
                    f"{each.lowest[i]:.4g}..{each.highest[i]:.4g} N*m/rad"
                    for each in (static.stiffness, static.small_motion)
                    if each is not None
                ),
                _pressures(static.pressures_at_lowest[:, i]),
                _pressures(static.pressures_at_highest[:, i]),
            )
            for i in static.table_rows()
        ]

    def remarks(self) -> list[str]:
        """Return the limits of the attainable stiffness and remarks on the joint, as text."""
        return [*self._limits(), *self.scenario.joint.remarks] if self.static.exists else []

    def _limits(self) -> list[str]:
        """Active limits at both ends of the attainable stiffness, and remedies."""
        static, plant = self.static, self.scenario.plant()
        ends = (end[:, static.inside] for end in (static.pressures_at_lowest, static.pressures_at_highest))
        return active_limits(plant.supplied_joint, plant.muscles, static.angles[static.inside], tuple(ends))

    def records(self) -> dict[str, Any]:
        """The results as plain data; angles in deg, pressures in bar, all else in SI."""
        static, found = self.static, self.trackability
        trajectory, bands = found.trajectory, found.bands
        violation = bands.rate_limited.violation(trajectory.stiffness)
        small = static.small_motion
        return {
            "scenario": self.scenario.name,
            "trackable": found.trackable,
            "verdict": self.verdict(),
            "remarks": self.remarks(),
            "static_range_deg": [static.angle_min / deg, static.angle_max / deg],
            "smoothing_s": trajectory.smoothing if found.breakpoints.size else 0.0,
            "muscle_torque_Nm": [float(bands.torque.min()), float(bands.torque.max())],
            "violated_fraction": float(found.violated.mean()),
            "violation_max": float(np.nanmax(violation)) if not np.isnan(violation).all() else math.nan,
            "table": [
                {
                    "angle_deg": float(static.angles[i] / deg),
                    "gravity_torque_Nm": float(static.torque[i]),
                    "torque_range_Nm": [float(edge[i]) for edge in static.torque_range],
                    "stiffness": [float(edge[i]) for edge in static.stiffness],
                    **({"small_motion": [float(edge[i]) for edge in small]} if small else {}),
                    "pressures_at_lowest_bar": (static.pressures_at_lowest[:, i] / bar).tolist(),
                    "pressures_at_highest_bar": (static.pressures_at_highest[:, i] / bar).tolist(),
                }
                for i in static.table_rows()
            ],
            "nearest": [
                {
                    "preserved": near.preserved.name.lower(),
                    "described": near.describe(),
                    "amplitude": near.amplitude,
                    "speed": near.speed,
                    "shift_deg": near.shift / deg,
                    "step_smoothing_s": near.step_smoothing,
                    "stiffness_change": near.stiffness_change,
                    "angle_deg": [motion.angle.min() / deg, motion.angle.max() / deg],
                    "stiffness": [motion.stiffness.min(), motion.stiffness.max()],
                }
                for near in self.nearest
                for motion in [near.trackability.trajectory]
            ],
        }


_MEASURED = "measured pressure"
_AT_LIMIT = 1.0  # Pa, N


def _remedy(muscle: Muscle, *, highest: bool) -> str | None:
    """Remedy for a law that ends at the measured pressures; none at the lowest pressure of the specimen."""
    rated, law = muscle.specimen.domain, muscle.law.domain
    further = law.pressure_max < rated.pressure_max < math.inf if highest else rated.pressure_min < law.pressure_min
    if further:
        return (
            "to apply the law at all pressures of its specimen, from 0 bar to pressure_max, give "
            "Scenario.with_extrapolation() (command line: --extrapolate, or `extrapolate: true` of the muscle)"
        )
    if not highest:
        return None
    return (
        "to apply the law at higher pressures, give the muscle the rated pressure of its specimen, such as `specimen: "
        "{domain: {pressure_max: 8 bar}}`, and `extrapolate: true`"
    )


def _bounds(supplied: Muscle, muscle: Muscle, pressure: Values, tension: Values) -> dict[str, NDArray[np.bool_]]:
    """Masks of the active limits of a muscle at pressures [Pa] and tensions [N], by name."""
    law, rated = muscle.law.domain, muscle.domain
    low, high, top = float(rated.pressure_min), float(supplied.domain.pressure_max), float(rated.pressure_max)
    least = f"the lowest {_MEASURED}" if low == law.pressure_min and low > 0 else "venting"
    most = f"the highest {_MEASURED}" if top == law.pressure_max else "the rated pressure"
    most = "the supply" if high < top else most
    return {
        f"{least} ({low / bar:.3g} bar)": pressure <= low + _AT_LIMIT,
        f"{most} ({high / bar:.3g} bar)": pressure >= high - _AT_LIMIT,
        f"the rated force ({muscle.specimen.force_limit:.4g} N)": tension >= muscle.specimen.force_limit - _AT_LIMIT,
        "a muscle that becomes slack": (tension <= _AT_LIMIT) & (pressure > low + _AT_LIMIT),
    }


def active_limits(
    joint: AntagonisticJoint, muscles: Sequence[Muscle], angles: Values, ends: Sequence[NDArray[np.float64]]
) -> list[str]:
    """Return the active limits at both ends of the attainable stiffness over angles, and remedies, as text.

    The joint has the muscles with domains within the supply; the ends are pressures at the lowest and at the highest
    stiffness, shape (2, angles) each [Pa].
    """
    found, remedies = [], dict[str, None]()
    for end, here in zip(("lowest", "highest"), ends, strict=True):
        tensions = joint.tensions(angles, (here[0], here[1]))
        counts: Counter[str] = Counter()
        given = zip((joint.muscle1, joint.muscle2), muscles, here, tensions, strict=True)
        for supplied, muscle, pressure, tension in given:
            for reason, holds in _bounds(supplied, muscle, pressure, np.asarray(tension)).items():
                counts[reason] += int(holds.sum())
                remedy = _remedy(muscle, highest="highest" in reason)
                if _MEASURED in reason and holds.any() and remedy:
                    remedies[remedy] = None
        reasons = [reason for reason, count in counts.most_common() if count]
        found += [f"{end} stiffness: limited by {' or '.join(reasons)}"] if reasons else []
    return found + list(remedies)


@checked_call
def envelope(scenario: Scenario, *, margin: float = 0.05, smoothing: float | None = None) -> Envelope:
    """Compute static envelope, trackability and nearest feasible references of a scenario.

    Raises `RangeError` if the margin or the smoothing is out of range, or the controller has a `stiffness_amplitude`.

    Parameters
    ----------
    scenario
        Joint, load, valve, reference and times; the controller is ignored.
    margin
        See `nearest_references`.
    smoothing
        Smoothing of jumps and corners [s], see `check_trackability`.

    Examples
    --------
    >>> found = envelope(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    >>> found.trackability.trackable, found.nearest
    (True, ())
    >>> print(found.verdict())
    trackable throughout: statically, dynamically and within the rate limit of the valves; jump or corner at 5 s
    smoothed over 16.6 ms
    """
    check_margin(margin)
    if scenario.controller.stiffness_amplitude is not None:
        raise RangeError(
            "the envelope uses the isobaric stiffness, but the controller uses the stiffness of a motion",
            field="controller.stiffness_amplitude",
            value=scenario.controller.stiffness_amplitude,
            unit="rad",
            remedy="leave stiffness_amplitude out, and give the reference of the stiffness without friction",
        )
    plant, reference = scenario.plant(), scenario.reference()
    checker = TrackabilityChecker.of(plant, scenario.duration, scenario.control_period)
    checked = checker.check(reference, smoothing)
    static = static_envelope(plant, about=float(np.mean(checked.trajectory.angle)))
    searched = static.exists and not checked.trackable
    return Envelope(scenario, static, checked, find_nearest(checker, reference, checked, margin) if searched else ())


def save_reference(scenario: Scenario, found: FeasibleReference, folder: Path, name: str) -> list[str]:
    """Write a scenario with a feasible reference and its samples as a CSV file; return the file names.

    The run starts at rest at the first angle and stiffness; a slower reference takes longer.
    """
    table = folder / f"{name}.csv"
    signals = found.reference.angle, found.reference.stiffness
    sampled = any(map(_is_sampled, signals))
    if sampled:
        _write_samples(table, found)
    angle, stiffness = (
        SamplesFile(table, name) if _is_sampled(signal) else jax.tree.map(float, signal)
        for name, signal in zip(("angle", "stiffness"), signals, strict=True)
    )
    trajectory = found.trackability.trajectory
    periods = math.ceil(scenario.duration / found.speed / scenario.control_period - 1e-9)
    update = {
        "name": f"{scenario.name[:150]}, nearest, {found.preserved.name.lower()} preserved",
        "signals": Reference(angle, stiffness),
        "start": Start(angle=float(trajectory.angle[0]), stiffness=float(trajectory.stiffness[0])),
        "duration": scenario.duration if found.speed == 1 else periods * scenario.control_period,
    }
    changed = scenario.model_copy(update=update)
    if not _has_initial_state(changed):  # a reference that begins in motion may need a torque different from rest
        changed = changed.model_copy(update={"start": Start(angle=float(trajectory.angle[0]))})
    changed.to_yaml(folder / f"{name}.yaml")
    return [f"{name}.yaml", *([table.name] if sampled else [])]


def save_design(scenario: Scenario, found: Design, path: Path) -> bool:
    """Write a scenario with the lengths of a design; return False if a scenario cannot express one of them.

    The initial stiffness is dropped if it is no longer attainable.
    """
    known = design_lengths(found.plant)
    places = {place: value for name, value in found.lengths.items() for place in known[name]}
    try:
        changed = with_values(scenario, {".".join(("joint", *place)): value for place, value in places.items()})
    except ParameterError:
        return False
    if not _has_initial_state(changed):
        changed = changed.model_copy(update={"start": Start(angle=scenario.start.angle)})
    changed.to_yaml(path)
    return True


def _has_initial_state(scenario: Scenario) -> bool:
    try:
        scenario.initial(scenario.plant())
    except (UnreachableError, ValueError):
        return False
    return True


def _is_sampled(signal: Signal) -> bool:
    return not isinstance(signal, Constant | Sine | Multisine | Step)


def _write_samples(path: Path, found: FeasibleReference) -> None:
    columns = {"time_s": found.times}
    for title, signal, unit in (
        ("angle_deg", found.reference.angle, deg),
        ("stiffness_N*m/rad", found.reference.stiffness, 1.0),
    ):
        if _is_sampled(signal):
            columns[title] = np.asarray(signal(found.times), float) / unit
    with atomic_write(path, overwrite=True) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.9g}" for value in row] for row in zip(*columns.values(), strict=True))


def _pressures(pair: np.ndarray) -> str:
    return ", ".join(f"{_rounded(float(p) / bar):.3g}" for p in pair) + " bar"


def _rounded(value: float) -> float:
    """Six decimals, without a negative zero."""
    return round(value, 6) + 0.0
