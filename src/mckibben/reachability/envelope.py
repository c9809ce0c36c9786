"""Reachability of a scenario: static envelope, trackability, nearest feasible references, and files of the results."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import checked_call
from mckibben.control import Constant, Multisine, Reference, SamplesFile, Signal, Sine, Step
from mckibben.errors import RangeError, UnreachableError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import unattainable
from mckibben.muscle import Muscle
from mckibben.reachability.feasible import FeasibleReference, Preserved, check_margin, find_nearest
from mckibben.reachability.static import StaticEnvelope, Values, static_envelope
from mckibben.reachability.trackability import Trackability, TrackabilityChecker
from mckibben.result import Column, Listing, Remark, Result
from mckibben.scenario import Scenario, Start
from mckibben.storage.files import atomic_write
from mckibben.units import bar, deg

_ENDS = "lowest", "highest"


class Envelope(Result):
    """Reachability of a scenario: static envelope of its joint, check of its reference and nearest feasible references.

    Attributes
    ----------
    static, trackability
        Static envelope of the joint, and the check of the reference.
    nearest
        Feasible references; empty if the reference is trackable or no state is static.
    """

    scenario: Scenario
    static: StaticEnvelope
    trackability: Trackability
    nearest: tuple[FeasibleReference, ...]

    figures = ("envelope",)
    files = tuple(f"nearest-{kind.name.lower()}.{end}" for kind in Preserved for end in ("yaml", "csv"))

    def verdict(self) -> str:
        """Verdict on the reference, in words."""
        if not self.static.exists:
            plant, angle = self.scenario.plant(), float(self.trackability.trajectory.angle[0])
            why = unattainable(plant.supplied_joint, angle, -float(plant.load.gravity_torque(angle)))
            return f"the joint cannot hold its load at any angle; at {angle / deg:.4g} deg, {why}"
        return self.trackability.verdict()

    def remarks(self) -> list[Remark]:
        """Active limits at both ends of the attainable stiffness with remedies, and remarks on the joint."""
        static, plant = self.static, self.scenario.plant()
        if not static.exists:
            return []
        ends = [end[:, static.inside] for end in (static.pressures_at_lowest, static.pressures_at_highest)]
        limits = active_limits(plant.supplied_joint, plant.muscles, static.angles[static.inside], ends)
        missing = not self.trackability.trackable and not self.nearest
        return [
            *(Remark.note("stiffness", text) for text in (*limits, *self.scenario.joint.remarks)),
            *(
                [Remark.warning("reference", "no smaller or slower motion about its centre is feasible either")]
                * missing
            ),
        ]

    def listings(self) -> list[Listing]:
        """Static envelope at no more than 11 angles, and the nearest feasible references."""
        static, at = self.static, self.static.table_rows()
        torque, stiffness = Column("N*m", digits=3), Column("N*m/rad")
        bands = {"torque": (torque, static.torque_range), "stiffness": (stiffness, static.stiffness)}
        if static.small_motion is not None:
            bands["small-motion stiffness"] = (stiffness, static.small_motion)
        columns: dict[str, tuple[Column, Any]] = {
            "angle": (Column("rad", shown="deg"), static.angles[at]),
            "gravity torque": (torque, static.torque[at] + 0.0),
        }
        for name, (unit, band) in bands.items():
            columns |= {f"{end} {name}": (unit, edge[at]) for end, edge in zip(_ENDS, band, strict=True)}
        for end, pressures in zip(_ENDS, (static.pressures_at_lowest, static.pressures_at_highest), strict=True):
            pair = {
                f"p{i + 1} at {end}": (Column("Pa", shown="bar", digits=3), np.round(pressures[i, at]) + 0.0)
                for i in (0, 1)
            }
            columns |= pair
        rows = [(near.preserved.name.lower(), near.describe(), near.amplitude, near.speed) for near in self.nearest]
        preserved, changes, amplitude, speed = zip(*rows, strict=True) if rows else ((), (), (), ())
        nearest = {
            "preserved": (Column(), preserved),
            "changes": (Column(), changes),
            "amplitude": (Column("1"), amplitude),
            "speed": (Column("1"), speed),
        }
        return [
            Listing("static envelope", columns),
            *([Listing("nearest feasible references", nearest)] if rows else []),
        ]

    def write(self, folder: Path) -> None:
        """Write each nearest reference as a scenario, with its samples."""
        for near in self.nearest:
            save_reference(self.scenario, near, folder, f"nearest-{near.preserved.name.lower()}")


_MEASURED = "measured pressure"
_AT_LIMIT = 1.0  # Pa, N


def _remedy(muscle: Muscle, *, highest: bool) -> str | None:
    """Remedy for a law that ends at the measured pressures; none at the lowest pressure of the specimen."""
    rated, law = muscle.specimen.domain, muscle.law.domain
    further = law.pressure_max < rated.pressure_max < math.inf if highest else rated.pressure_min < law.pressure_min
    if further:
        return "to apply the law at all pressures of its specimen, give `extrapolate: true` of the muscle"
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
    texts, remedies = [], dict[str, None]()
    for name, pressures in zip(_ENDS, ends, strict=True):
        tensions = joint.tensions(angles, (pressures[0], pressures[1]))
        counts: Counter[str] = Counter()
        rows = zip((joint.muscle1, joint.muscle2), muscles, pressures, tensions, strict=True)
        for supplied, muscle, pressure, tension in rows:
            for reason, active in _bounds(supplied, muscle, pressure, np.asarray(tension)).items():
                counts[reason] += int(active.sum())
                remedy = _remedy(muscle, highest="highest" in reason)
                if _MEASURED in reason and active.any() and remedy:
                    remedies[remedy] = None
        reasons = [reason for reason, count in counts.most_common() if count]
        texts += [f"{name} stiffness: limited by {' or '.join(reasons)}"] if reasons else []
    return texts + list(remedies)


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
