"""Reachability of a scenario: static envelope, feasibility of its reference, and what would be feasible."""

from __future__ import annotations

import bisect
import functools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import checked_call
from mckibben.errors import McKibbenError, ParameterError, RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import leaves_domain
from mckibben.muscle import Muscle
from mckibben.notebook import Progress, silent
from mckibben.numerics.calculus import evenly_spaced
from mckibben.plant.joint_plant import rated_for
from mckibben.reachability.static import (
    StaticEnvelope,
    Values,
    angles_within,
    coupled_envelope,
    pair_envelope,
    static_envelope,
)
from mckibben.result import Column, Listing, Remark, Result, TableColumns, column, table
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import Feasibility, check_reference
from mckibben.simulation.feasibility import distance_from, static_band
from mckibben.simulation.problem import sampled
from mckibben.statics.attainable import held_statics
from mckibben.statics.posture import HeldPostures, check_affine, holding_torques
from mckibben.statics.pressures import held_joint_stiffness
from mckibben.statics.reference import POSTURES
from mckibben.units import JointType, bar

_ENDS = "lowest", "highest"
_NONE = "no smaller motion about the same centre, and no constant stiffness along it, is feasible either"


class JointReach(NamedTuple):
    """Reachability of a joint, the others at rest in the middle of their references."""

    static: StaticEnvelope
    reference: Feasibility | None  # None without a reference
    limits: list[str]  # active ones at both ends of the attainable stiffness, as text
    angle: float  # in that posture [rad]

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """Constant stiffness [N*m/rad] that is feasible along the reference, lowest and highest; None if none is."""
        if self.reference is None:
            return None
        low, high = float(np.max(self.reference.lowest)), float(np.min(self.reference.highest))
        return (low, high) if low <= high else None

    @property
    def feasible(self) -> bool:
        """Whether the reference, if there is one, is feasible."""
        return self.static.exists and (self.reference is None or self.reference.feasible)

    def verdict(self) -> str:
        """Verdict on the reference, in words."""
        if not self.static.exists:
            return f"the joint cannot hold its load at any angle; {self.static.obstacle}"
        return "" if self.reference is None else self.reference.verdict()

    def nearest(self, amplitude: float) -> str:
        """Feasible changes of the reference: a constant stiffness, or a factor on the amplitude."""
        constant = self.stiffness and self.static.joint_type.span(self.stiffness, "N*m/rad")
        changes = [f"with a constant stiffness of {constant}"] * bool(constant)
        changes += [f"at {amplitude:.3g} of its amplitude"] * (amplitude > 0)
        return f"the reference would be feasible {', or '.join(changes)}" if changes else _NONE

    def listing(self, title: str, *, detail: bool) -> Listing:
        """The static envelope at no more than 11 angles."""
        static, at = self.static, self.static.table_rows()
        torque, stiffness = Column("N*m", digits=3), Column("N*m/rad")
        bands = {"torque": (torque, static.torque_range), "stiffness": (stiffness, static.stiffness)}
        if static.small_motion is not None:
            bands["small-motion stiffness"] = (stiffness, static.small_motion)
        columns: TableColumns = {
            "angle": (Column("rad", shown="deg"), static.angles[at]),
            "gravity torque": (torque, static.torque[at] + 0.0),
        }
        pressure, ends = Column("Pa", shown="bar", digits=3), (static.pressures_at_lowest, static.pressures_at_highest)
        if static.one_muscle:
            columns["stiffness"] = stiffness, bands.pop("stiffness")[1].lowest[at]
            columns["pressure"] = pressure, np.round(ends[0].max(axis=0)[at]) + 0.0
            ends = ()
        for name, (unit, band) in bands.items():
            columns |= {f"{end} {name}": (unit, edge[at]) for end, edge in zip(_ENDS, band, strict=True)}
        for end, pressures in zip(_ENDS, ends, strict=False):
            columns |= {f"p{i} at {end}": (pressure, np.round(row[at]) + 0.0) for i, row in enumerate(pressures, 1)}
        for end, names in zip(_ENDS, static.limits, strict=True):
            columns |= {f"{end} limited by": (Column(), np.array(names)[at])} if names else {}
        columns = {static.joint_type.words(name): column for name, column in columns.items()}
        return Listing(title, columns, detail)


class Envelope(Result):
    """Reachability of a scenario: static envelope, feasibility of its reference, and what would be feasible.

    Attributes
    ----------
    joints
        By the name of the joint; that of a scenario of one joint is empty, and `static`, `reference` and `stiffness`
        are those of its only one.
    amplitude
        Largest factor on the amplitude of the angles about their centres, to 0.001, with which the reference is
        feasible; NaN if there is none.
    together
        Whether all joints attain their stiffness at the same time, where each attains it alone.
    """

    suggestions: ClassVar[Mapping[str, str]] = {
        **{name: f"static.{name}" for name in ("small_motion", "torque_range", "angles")},
        **{name: f"reference.{name}" for name in ("feasible", "shortfall")},
    }

    scenario: Scenario | RobotScenario
    joints: dict[str, JointReach]
    amplitude: float = column("1", "feasible factor on the amplitude", digits=3, default=math.nan)
    together: bool = True

    figures = ("envelope",)

    @property
    def joint_type(self) -> JointType:
        return self.scenario.joint_type

    @property
    def only(self) -> JointReach:
        """The joint of a scenario of one; `ParameterError` for a robot."""
        if "" not in self.joints:
            remedy = f"name one, such as joints[{next(iter(self.joints))!r}]"
            raise ParameterError("the envelope of a robot has one of each joint", remedy=remedy)
        return self.joints[""]

    @property
    def static(self) -> StaticEnvelope:
        """Static envelope of the joint of a scenario of one."""
        return self.only.static

    @property
    def reference(self) -> Feasibility:
        """Feasibility of the reference of the joint of a scenario of one, at each control period."""
        reference = self.only.reference
        assert reference is not None
        return reference

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """Constant stiffness [N*m/rad] that is feasible along the reference of the joint of a scenario of one."""
        return self.only.stiffness

    def verdict(self) -> str:
        """Verdict on the reference, in words."""
        if "" in self.joints:
            return self.only.verdict()
        failed = [f"{name}: {reach.verdict()}" for name, reach in self.joints.items() if not reach.feasible]
        if failed:
            return "; ".join(failed)
        if not self.together:
            return "each joint attains its stiffness, but not all of them together"
        if all(reach.reference is None for reach in self.joints.values()):
            return "each joint can be held; the file has no reference"
        return "the references of all joints are statically feasible throughout"

    def remarks(self) -> Iterator[Remark]:
        """Feasible changes, active limits at both ends of the attainable stiffness with remedies, and the joint's."""
        yield from self.scenario.model_remarks
        for name, reach in self.joints.items():
            prefix = f"{name}: " * bool(name)
            if reach.static.exists and reach.reference is not None and not reach.reference.feasible:
                yield Remark.warning("reference", prefix + reach.nearest(self.amplitude))
        texts = [
            (f"{name}: " * bool(name and text != _EXTRAPOLATE)) + text
            for name, reach in self.joints.items()
            for text in reach.limits
            if reach.static.exists
        ]
        yield from (Remark.note("stiffness", text) for text in dict.fromkeys(texts))

    def declared(self) -> TableColumns:
        """Feasible factor, and of a robot what each joint attains in the posture of its static envelope."""
        declared = super().declared()
        if "" in self.joints:
            return declared
        reaches = list(self.joints.values())
        angle, torque, stiffness = Column("rad", "", "deg"), Column("N*m", digits=3), Column("N*m/rad")
        at = [reach.static.place_of(reach.angle) for reach in reaches]
        columns: TableColumns = {
            "joint": (Column(), list(self.joints)),
            "angle": (angle, np.array([reach.angle for reach in reaches])),
            "least_angle": (angle, np.array([reach.static.angle_min for reach in reaches])),
            "greatest_angle": (angle, np.array([reach.static.angle_max for reach in reaches])),
        }
        for name, unit in (("torque_range", torque), ("stiffness", stiffness)):
            for end in _ENDS:
                rows = zip(reaches, at, strict=True)
                values = [getattr(getattr(reach.static, name), end)[place] for reach, place in rows]
                columns[f"{end}_{name.removesuffix('_range')}"] = unit, np.array(values)
        if math.isnan(self.amplitude):
            del declared["amplitude"]
        if any(reach.reference for reach in reaches):
            constant = [reach.stiffness or (math.nan, math.nan) for reach in reaches]
            for end, values in zip(_ENDS, zip(*constant, strict=True), strict=True):
                title = f"{end} constant stiffness along the reference"
                columns[f"{end}_constant"] = Column("N*m/rad", title), np.array(values)
            columns["feasible"] = Column(), [reach.feasible for reach in reaches]
        return declared | columns

    @table()
    def statics(self) -> list[Listing]:
        """The static envelope of each joint."""
        return [
            reach.listing(f"static envelope{' of ' * bool(name)}{name}", detail=bool(name))
            for name, reach in self.joints.items()
        ]


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
def envelope(scenario: Scenario | RobotScenario, *, progress: Progress | None = None) -> Envelope:
    """Compute the static envelope of each joint, and whether its reference, or a change of it, is feasible.

    Feasible is what the joints can hold at rest, the base held: `simulate` shows what inertia, valves and a controller
    make of it. In closed form for pairs of muscles, each over one joint; by linear programs at 25 times, and at angles
    within the stops, where muscles pass over several joints.

    Parameters
    ----------
    scenario
        Joints, load, supply of the valve, reference and times; the controller is ignored.
    progress
        Called with the name of a joint and the completed fraction, 0 to 1.

    Raises
    ------
    RangeError
        If the controller has a `stiffness_amplitude`, or the stiffness of coupled joints is not affine in the
        pressures.

    Examples
    --------
    >>> found = envelope(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    >>> found.reference.feasible, found.amplitude
    (True, 1.0)
    >>> print(found.verdict())
    the reference is statically feasible throughout
    """
    if isinstance(scenario, RobotScenario):
        return _of_a_robot(scenario, progress or silent)
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
    centre = (angle.min() + angle.max()) / 2

    def feasible(factor: float) -> bool:
        lowest, highest = static_band(plant, centre + factor * (angle - centre), None)
        band = np.asarray(lowest)[: angle.size], np.asarray(highest)[: angle.size]
        return bool(np.all(distance_from(*band, desired) == 0))

    static = static_envelope(plant, about=float(np.mean(angle)))
    limits = _limits_of_pair(plant.supplied_joint, plant.muscles, static)
    reach = JointReach(static, checked, limits, float(np.mean(angle)))
    return Envelope(scenario, {"": reach}, 1.0 if checked.feasible else _largest(feasible))


def _limits_of_pair(joint: AntagonisticJoint, muscles: Sequence[Muscle], static: StaticEnvelope) -> list[str]:
    if any(joint.springs):  # the load determines the stiffness of one muscle
        return []
    ends = [end[:, static.inside] for end in (static.pressures_at_lowest, static.pressures_at_highest)]
    return active_limits(joint, muscles, static.angles[static.inside], ends)


class _Band(NamedTuple):
    """Attainable stiffness [N*m/rad] of joints along their references, shape (joints, times), and why there is none."""

    lowest: Values
    highest: Values
    causes: list[str]
    together: bool  # whether the desired stiffness of all joints is attained at once


class _Joints(NamedTuple):
    """Joints of a robot that can move, in a posture [rad], with their pairs of muscles if these are disjoint."""

    scenario: RobotScenario
    free: list[int]
    posture: list[float]
    pairs: dict[int, AntagonisticJoint]

    def torque_at(self, index: int, angles: Values) -> Values:
        """Torque [N*m] of a joint against gravity over its angle [rad]."""
        rows = np.tile(self.posture, (angles.size, 1))
        rows[:, index] = angles
        return holding_torques(self.scenario.robot, rows)[:, index]

    def static(self, index: int) -> tuple[StaticEnvelope, list[str]]:
        """Static envelope of a joint, and the active limits of its stiffness."""
        robot = self.scenario.robot
        if not self.pairs:
            static = coupled_envelope(robot, index, self.posture, self.scenario.supply)
            return static, static.limit_texts
        joint, pair = robot.joints[index], self.pairs[index]
        angles = angles_within(float(joint.lower), float(joint.upper))
        torque_at = functools.partial(self.torque_at, index)
        static = pair_envelope(pair, torque_at, about=self.posture[index], angles=angles)
        return static, _limits_of_pair(pair, robot.pair(index).muscles, static)

    def band(self, angles: Values, stiffness: Values) -> _Band:
        """Attainable stiffness along angles [rad], for a desired one [N*m/rad], shape (joints, times)."""
        if self.pairs:
            return _band_of_pairs(self.scenario, self.pairs, angles)
        return _band_of_coupled(self.scenario, angles, stiffness)


def _of_a_robot(scenario: RobotScenario, progress: Progress) -> Envelope:
    robot = scenario.robot
    free = [index for index, joint in enumerate(robot.joints) if joint.locked is None]
    posture, desired = list(robot.posture_angles(scenario.start.angles)), _desired(scenario)
    if desired is not None:
        posture = desired.angles.mean(axis=1).tolist()
    if not robot.has_disjoint_pairs:
        check_affine(robot)
    pairs = {index: _supplied(robot.pair(index), scenario.supply) for index in free * robot.has_disjoint_pairs}
    joints = _Joints(scenario, free, posture, pairs)
    statics = {}
    for number, index in enumerate(free):
        progress(robot.joint_names[index], (number + 1) / (len(free) + 2))
        statics[index] = joints.static(index)
    names = robot.joint_names
    if desired is None:
        reaches = {names[i]: JointReach(static, None, texts, posture[i]) for i, (static, texts) in statics.items()}
        return Envelope(scenario, reaches)
    progress("reference", (len(free) + 1) / (len(free) + 2))
    times, angles, stiffness = desired
    along, reaches = joints.band(angles, stiffness), {}
    for index, (static, texts) in statics.items():
        rows = angles[index], stiffness[index], along.lowest[index], along.highest[index]
        checked = Feasibility(times, *rows, cause=along.causes[index])
        reaches[names[index]] = JointReach(static, checked, texts, posture[index])
    centre = (angles.min(axis=1, keepdims=True) + angles.max(axis=1, keepdims=True)) / 2

    def feasible(factor: float) -> bool:
        found = joints.band(centre + factor * (angles - centre), stiffness)
        short = distance_from(found.lowest[free], found.highest[free], stiffness[free])
        return found.together and bool(np.all(short == 0))

    ok = along.together and all(reach.reference.feasible for reach in reaches.values() if reach.reference)
    return Envelope(scenario, reaches, 1.0 if ok else _largest(feasible), along.together)


class _Desired(NamedTuple):
    """Times [s], and desired angles [rad] and stiffness [N*m/rad] of all joints, shape (joints, times)."""

    times: Values
    angles: Values
    stiffness: Values


def _desired(scenario: RobotScenario) -> _Desired | None:
    """References at all control periods, or at those that linear programs check; None if the file has none."""
    references = scenario.references()
    if not references:
        return None
    duration, period = scenario.run_duration, scenario.control_period
    parts = [sampled(references[name], duration, period) for name in scenario.joint_names]
    times = parts[0][0]
    some = np.arange(times.size) if scenario.robot.has_disjoint_pairs else evenly_spaced(times.size, POSTURES)
    angles, stiffness = (
        np.stack([np.asarray(getattr(setpoints, field))[some] for _, setpoints in parts])
        for field in ("angle", "stiffness")
    )
    return _Desired(times[some], angles, stiffness)


def _supplied(joint: AntagonisticJoint, supply: float) -> AntagonisticJoint:
    """The joint with its muscles rated for a supply [Pa], where that is below their own rating."""
    rated = [float(muscle.specimen.domain.pressure_max) for muscle in joint.muscles]
    return joint if supply >= max(rated) else rated_for(joint, tuple(min(limit, supply) for limit in rated))


def _band_of_pairs(scenario: RobotScenario, pairs: dict[int, AntagonisticJoint], angles: Values) -> _Band:
    torques = holding_torques(scenario.robot, angles.T).T
    lowest, highest = np.full(angles.shape, np.nan), np.full(angles.shape, np.nan)
    causes = [""] * len(angles)
    for index, pair in pairs.items():
        band = pair.attainable_stiffness(angles[index], torques[index])
        lowest[index], highest[index] = map(np.asarray, band)
        unheld = np.isnan(lowest[index])
        causes[index] = leaves_domain(pair, angles[index], unheld) if unheld.any() else ""
    return _Band(lowest, highest, causes, True)


def _band_of_coupled(scenario: RobotScenario, angles: Values, stiffness: Values) -> _Band:
    robot = scenario.robot
    lowest, highest = np.full(angles.shape, np.nan), np.full(angles.shape, np.nan)
    cause, together = "", True
    postures = HeldPostures.of(robot, angles.T, holding_torques(robot, angles.T), scenario.supply, 0.0)
    for time in range(angles.shape[1]):
        try:
            held = postures.posture(time)
        except McKibbenError as error:
            cause = cause or str(error)
            continue
        ranges = held_statics(held)
        for name, found in ranges.items():
            lowest[robot.index(name), time], highest[robot.index(name), time] = found.stiffness
        alone = distance_from(lowest[:, time], highest[:, time], stiffness[:, time])
        if np.all(np.nan_to_num(alone) == 0):
            together = together and held_joint_stiffness(held, stiffness[:, time].tolist()).exact
    return _Band(lowest, highest, [cause] * len(angles), together)


def _largest(trial: Callable[[float], bool]) -> float:
    """Largest factor up to 1, to 0.001, that passes, if smaller ones do; NaN if even 0.001 does not."""
    if not trial(0.001):
        return math.nan
    return bisect.bisect_left(range(1, 1000), True, lo=1, key=lambda part: not trial(part / 1000)) / 1000
