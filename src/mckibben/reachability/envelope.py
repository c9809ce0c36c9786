"""Reachability of a scenario: static envelope, feasibility of its reference, and what would be feasible."""

from __future__ import annotations

import bisect
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import checked_call
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import unattainable
from mckibben.muscle import Muscle
from mckibben.reachability.static import StaticEnvelope, Values, static_envelope
from mckibben.result import Column, Listing, Remark, Result, column
from mckibben.scenario import Scenario
from mckibben.simulation import Feasibility, check_reference
from mckibben.simulation.feasibility import distance_from, static_band
from mckibben.units import bar, deg

_ENDS = "lowest", "highest"
_NONE = "no smaller motion about the same centre, and no constant stiffness along it, is feasible either"


class Envelope(Result):
    """Reachability of a scenario: static envelope, feasibility of its reference, and what would be feasible.

    Attributes
    ----------
    static, reference
        Static envelope of the joint, and its reference compared with it at each control period.
    amplitude
        Largest factor on the amplitude of the angle about its centre, to 0.001, with which the reference is feasible;
        NaN if there is none.
    stiffness
        Constant stiffness [N*m/rad] that is feasible along the reference, lowest and highest; None if there is none.
    """

    suggestions: ClassVar[Mapping[str, str]] = {
        **{name: f"static.{name}" for name in ("small_motion", "torque_range", "angles")},
        **{name: f"reference.{name}" for name in ("feasible", "shortfall")},
    }

    scenario: Scenario
    static: StaticEnvelope
    reference: Feasibility
    amplitude: float = column("1", "feasible factor on the amplitude", digits=3)
    stiffness: tuple[float, float] | None

    figures = ("envelope",)

    def verdict(self) -> str:
        """Verdict on the reference, in words."""
        if not self.static.exists:
            plant, angle = self.scenario.plant(), float(self.reference.desired_angle[0])
            why = unattainable(plant.supplied_joint, angle, -float(plant.load.gravity_torque(angle)))
            return f"the joint cannot hold its load at any angle; at {angle / deg:.4g} deg, {why}"
        return self.reference.verdict()

    def remarks(self) -> list[Remark]:
        """Feasible changes, active limits at both ends of the attainable stiffness with remedies, and the joint's."""
        static, plant = self.static, self.scenario.plant()
        remarks = self.scenario.joint.remarks
        if not static.exists:
            return remarks
        if not self.reference.feasible:
            nearest = ["with a constant stiffness of {:.4g}..{:.4g} N*m/rad".format(*self.stiffness or (0.0, 0.0))]
            nearest = nearest * bool(self.stiffness)
            nearest += [f"at {self.amplitude:.3g} of its amplitude"] * (self.amplitude > 0)
            text = f"the reference would be feasible {', or '.join(nearest)}" if nearest else _NONE
            remarks.append(Remark.warning("reference", text))
        ends = [end[:, static.inside] for end in (static.pressures_at_lowest, static.pressures_at_highest)]
        limits = active_limits(plant.supplied_joint, plant.muscles, static.angles[static.inside], ends)
        return remarks + [Remark.note("stiffness", text) for text in limits]

    def listings(self) -> list[Listing]:
        """Feasible factor, and the static envelope at no more than 11 angles."""
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
        unit = Column("Pa", shown="bar", digits=3)
        for end, pressures in zip(_ENDS, (static.pressures_at_lowest, static.pressures_at_highest), strict=True):
            columns |= {f"p{i + 1} at {end}": (unit, np.round(pressures[i, at]) + 0.0) for i in (0, 1)}
        return [*super().listings(), Listing("static envelope", columns)]


_MEASURED = "measured pressure"
_EXTRAPOLATE = (
    "to apply the law at all pressures of its specimen, give `extrapolate: true` of the muscle; if the specimen has no "
    "rated pressure, give it, too, such as `specimen: {domain: {pressure_max: 8 bar}}`"
)


def _bounds(
    supplied: Muscle, muscle: Muscle, pressure: Values, tension: Values, *, near: float = 1.0
) -> dict[str, NDArray[np.bool_]]:
    """Masks of the active limits of a muscle at pressures and tensions `near` them [Pa], [N], by name."""
    law, rated = muscle.law.domain, muscle.domain
    low, high, top = float(rated.pressure_min), float(supplied.domain.pressure_max), float(rated.pressure_max)
    least = f"the lowest {_MEASURED}" if low == law.pressure_min and low > 0 else "venting"
    most = f"the highest {_MEASURED}" if top == law.pressure_max else "the rated pressure"
    most = "the supply" if high < top else most
    return {
        f"{least} ({low / bar:.3g} bar)": pressure <= low + near,
        f"{most} ({high / bar:.3g} bar)": pressure >= high - near,
        f"the rated force ({muscle.specimen.force_limit:.4g} N)": tension >= muscle.specimen.force_limit - near,
        "a muscle that becomes slack": (tension <= near) & (pressure > low + near),
    }


def active_limits(
    joint: AntagonisticJoint, muscles: Sequence[Muscle], angles: Values, ends: Sequence[NDArray[np.float64]]
) -> list[str]:
    """Return the active limits at both ends of the attainable stiffness over angles, and a remedy, as text.

    The joint has the muscles with domains within the supply; the ends are pressures at the lowest and at the highest
    stiffness, shape (2, angles) each [Pa].
    """
    texts = []
    for name, pressures in zip(_ENDS, ends, strict=True):
        tensions = joint.tensions(angles, (pressures[0], pressures[1]))
        counts: Counter[str] = Counter()
        for row in zip((joint.muscle1, joint.muscle2), muscles, pressures, map(np.asarray, tensions), strict=True):
            counts += Counter({reason: int(active.sum()) for reason, active in _bounds(*row).items()})
        reasons = [reason for reason, _ in counts.most_common()]
        texts += [f"{name} stiffness: limited by {' or '.join(reasons)}"] if reasons else []
    return [*texts, _EXTRAPOLATE] if _MEASURED in " ".join(texts) else texts


@checked_call
def envelope(scenario: Scenario) -> Envelope:
    """Compute the static envelope of a scenario's joint, and whether its reference, or a change of it, is feasible.

    Feasible is what the joint can hold at rest: `simulate` shows what inertia, valves and a controller make of it.
    Raises `RangeError` if the controller has a `stiffness_amplitude`.

    Parameters
    ----------
    scenario
        Joint, load, supply of the valve, reference and times; the controller is ignored.

    Examples
    --------
    >>> found = envelope(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    >>> found.reference.feasible, found.amplitude
    (True, 1.0)
    >>> print(found.verdict())
    the reference is statically feasible throughout
    """
    if scenario.controller.stiffness_amplitude is not None:
        raise RangeError(
            "the envelope uses the isobaric stiffness, but the controller uses the stiffness of a motion",
            field="controller.stiffness_amplitude",
            value=scenario.controller.stiffness_amplitude,
            unit="rad",
            remedy="leave stiffness_amplitude out, and give the reference of the stiffness without friction",
        )
    plant, times = scenario.plant(), {"duration": scenario.duration, "control_period": scenario.control_period}
    checked = check_reference(plant, scenario.reference(), **times)
    angle, desired = checked.desired_angle, checked.desired_stiffness
    centre, low, high = (angle.min() + angle.max()) / 2, np.max(checked.lowest), np.min(checked.highest)

    def feasible(factor: float) -> bool:
        lowest, highest = static_band(plant, centre + factor * (angle - centre), None)
        band = np.asarray(lowest)[: angle.size], np.asarray(highest)[: angle.size]
        return bool(np.all(distance_from(*band, desired) == 0))

    return Envelope(
        scenario,
        static_envelope(plant, about=float(np.mean(angle))),
        checked,
        1.0 if checked.feasible else _largest(feasible),
        (float(low), float(high)) if low <= high else None,
    )


def _largest(trial: Callable[[float], bool]) -> float:
    """Largest factor up to 1, to 0.001, that passes, if smaller ones do; NaN if even 0.001 does not."""
    if not trial(0.001):
        return math.nan
    return bisect.bisect_left(range(1, 1000), True, lo=1, key=lambda part: not trial(part / 1000)) / 1000
