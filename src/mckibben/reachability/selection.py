"""Sizing of a joint from a requirement: muscles, lengths, valves and air supply."""

from __future__ import annotations

import csv
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.actuator import IdealValve
from mckibben.component.calls import checked_call
from mckibben.config.document import plain, read_document, to_text
from mckibben.control import Constant, DecouplingControl, PolePlacement, Ramp, Reference, Samples, Signal, Sine
from mckibben.errors import ParameterError, UnreachableError
from mckibben.joint import AntagonisticJoint, PairedPaths, Pulley
from mckibben.muscle import Muscle, PressureAffineLaw
from mckibben.numerics.compiled import jit
from mckibben.plant import JointPlant
from mckibben.reachability.air_supply import AirSupply, air_supply
from mckibben.reachability.margins import CONSTRAINTS, attained_stiffness, constraint_margins, friction_torque
from mckibben.reachability.requirement import SHORTEST, Make, Requirement, catalog_makes, read_make
from mckibben.result import Column, Listing, Remark, Result, TableColumns, table
from mckibben.scenario import Scenario, Start
from mckibben.simulation import SimulationResult
from mckibben.simulation.problem import sampled_reference
from mckibben.storage.files import atomic_write
from mckibben.units import deg, mm, show

Floats = NDArray[np.float64]

_HEADROOM = 0.9  # of the supply: air flows into a muscle only below it
_TENSION = 5.0  # N: least tension of both muscles
_NARROWEST = 5 * mm  # radius of a pulley, and step of the lengths of muscles
_ANGLES = 41  # of the motion
_CYCLES = 3  # of a run


class Candidate(NamedTuple):
    """A joint that meets a requirement.

    Torque and stiffness are attainable throughout the motion, with the lowest, nominal and highest forces within the
    uncertainty of the muscles; of a stiffness range, the first end is the higher one if no stiffness is.
    """

    name: str  # of the muscles
    uncertainty: float  # of the forces, relative
    lengths: dict[str, float]  # chosen [m]
    plant: JointPlant  # with the valve of the air supply
    limiting: str  # constraint that leaves the least margin
    torque: tuple[float, ...]  # either way, in excess of gravity and of the muscles' friction [N*m]
    stiffness: tuple[tuple[float, float], ...]  # lowest and highest [N*m/rad]
    supply: AirSupply


class Check(NamedTuple):
    """A requirement, as text, the value in a run, and whether it is met."""

    requirement: str
    value: str
    met: bool


class Selection(Result):
    """Result of `size`.

    Attributes
    ----------
    candidates
        In the order of their air per cycle.
    rejected
        Makes that do not meet the requirement, with the reason.
    checks
        Comparison of a run with the requirement, by `simulated`.
    """

    requirement: Requirement
    candidates: tuple[Candidate, ...]
    rejected: tuple[tuple[str, str], ...]
    checks: tuple[Check, ...] = ()

    figures = ("selection",)
    files = ("scenario.yaml", "parts.csv")

    @property
    def best(self) -> Candidate:
        """The candidate with the least air per cycle."""
        return self.candidates[0]

    def verdict(self) -> str:
        """The best joint, and the requirement."""
        return f"{self.best.name}, {_lengths_text(self.best.lengths)}, for {self.requirement}"

    def remarks(self) -> list[Remark]:
        """Requirements that a run does not meet, rejected makes with the reason, and remarks on the best joint."""
        missed = (check for check in self.checks if not check.met)
        return [
            *(Remark.severe("requirement", f"not met: {check.requirement}: {check.value}") for check in missed),
            *(Remark.warning("muscles", f"rejected: {name}: {reason}") for name, reason in self.rejected),
            *self.best.plant.joint.remarks,
        ]

    @table("candidates")
    def choices(self) -> TableColumns:
        """Candidates with the intervals of their forces."""
        torque, stiffness = Column("N*m", digits=3), Column("N*m/rad", digits=3)
        rows = self.candidates
        return {
            "muscle": (Column(), [row.name for row in rows]),
            "lengths": (Column(), [_lengths_text(row.lengths) for row in rows]),
            "least torque": (torque, [row.torque[0] for row in rows]),
            "torque beyond gravity": (torque, [row.torque[1] for row in rows]),
            "highest torque": (torque, [row.torque[2] for row in rows]),
            "lowest stiffness": (stiffness, [row.stiffness[1][0] for row in rows]),
            "highest stiffness": (stiffness, [row.stiffness[1][1] for row in rows]),
            "valve": (Column(), [row.supply.valve_name for row in rows]),
            "air per cycle": (Column("m^3", shown="L", digits=3), [row.supply.air for row in rows]),
            "limited by": (Column(), [row.limiting for row in rows]),
        }

    @table()
    def best_parts(self) -> list[Listing]:
        """Parts of the best candidate."""
        return [Listing.of(f"parts of {self.best.name}", ("number", "part", "size"), self.parts())]

    @table("simulated with these parts")
    def simulated_checks(self) -> TableColumns:
        """Checks of the best candidate's run."""
        rows = zip(*self.checks, strict=True)
        return {name: (Column(), list(values)) for name, values in zip(Check._fields, rows, strict=False)}

    def write(self, folder: Path) -> None:
        """Write the scenario and the bill of materials."""
        self.scenario().to_yaml(folder / "scenario.yaml")
        with (
            atomic_write(folder / "parts.csv", overwrite=True) as file,
            file.open("w", encoding="utf-8", newline="") as text,
        ):
            csv.writer(text).writerows([("number", "part", "size"), *self.parts()])

    def parts(self, candidate: Candidate | None = None) -> list[tuple[str, str, str]]:
        """Bill of materials of a candidate, by default the best: number, part, size."""
        chosen = candidate or self.best
        joint, supply = chosen.plant.joint, chosen.supply
        sizes = []
        for muscle in (joint.muscle1, joint.muscle2):
            specimen = muscle.specimen
            diameter = "" if specimen.initial_diameter is None else f"{float(specimen.initial_diameter) / mm:.4g} mm x "
            sizes.append(f"{specimen.name}, {diameter}{float(specimen.initial_length) / mm:.4g} mm")
        return [
            ("2", "muscle", " and ".join(dict.fromkeys(sizes))),
            ("1", "joint", _lengths_text(chosen.lengths)),
            ("2", "proportional valve", f"{supply.valve_name}, needed C {supply.needed * 1e8:.3g} L/(s*bar)"),
            ("2", "tube", f"inner diameter at least {supply.tube / mm:.2g} mm"),
            ("1", "reservoir", f"{supply.reservoir * 1e3:.2g} L"),
            ("1", "compressor", f"{supply.compressor * 60e3:.3g} L/min (ANR), {show(self.requirement.supply, 'bar')}"),
        ]

    def scenario(self, candidate: Candidate | None = None, *, control_period: float = 1e-3) -> Scenario:
        """A scenario of three cycles with a candidate, by default the best; a stiffness range is passed through."""
        chosen, need = candidate or self.best, self.requirement
        reference = _reference(need, chosen.plant)
        scenario = Scenario(
            name=f"sized: {chosen.name}, {_lengths_text(chosen.lengths)}"[:200],
            joint=chosen.plant.joint,
            load=chosen.plant.load,
            valve=chosen.supply.valve,
            controller=DecouplingControl(chosen.plant.joint, chosen.plant.load, PolePlacement()),  # type: ignore[call-arg]
            reference=reference,
            start=Start(angle=need.angles[0], stiffness=float(reference.stiffness(0.0))),
            duration=max(round(_CYCLES * need.cycle / control_period), 1) * control_period,
            control_period=control_period,
        )
        text = plain(read_document(scenario.dumps()).data)
        text["controller"] = {"class": "decoupling", "feedback": {}}  # its model is the plant's
        text["valve"] = {"from": chosen.supply.valve_name, "supply": show(need.supply, "bar")}
        return Scenario.parse(to_text(text))

    def simulated(self) -> Selection:
        """Return the selection with the checks of a run of the best joint's scenario."""
        return dataclasses.replace(self, checks=tuple(self.verify(self.scenario().simulate())))

    def verify(
        self, result: SimulationResult, *, angle_error: float = 0.02, stiffness_error: float = 0.05
    ) -> list[Check]:
        """Compare outcome, angle and stiffness of a run with the requirement, within relative errors."""
        need, angle = self.requirement, np.asarray(result["angle"])
        error = np.abs(angle - np.asarray(result["desired_angle"])).max()
        checks = [
            Check("run", result.outcome.value, not result.outcome.failed),
            Check(
                f"{need.angles[0] / deg:g}..{need.angles[1] / deg:g} deg in {need.cycle:g} s",
                f"{angle.min() / deg:.4g}..{angle.max() / deg:.4g} deg, error at most {error / deg:.2g} deg",
                bool(error <= angle_error * 2 * need.amplitude),
            ),
        ]
        if need.stiffness:
            stiffness, desired = np.asarray(result["stiffness"]), np.asarray(result["desired_stiffness"])
            met = float(np.abs(stiffness / desired - 1).max()) <= stiffness_error
            asked = f"stiffness {need.stiffness[0]:.4g}..{need.stiffness[1]:.4g} N*m/rad"
            checks.append(Check(asked, f"{stiffness.min():.4g}..{stiffness.max():.4g} N*m/rad", met))
        return checks


@checked_call
def size(requirement: Requirement, makes: Sequence[Make] | None = None) -> Selection:
    """Size a joint with two antagonistic muscles on pulleys for a requirement: lengths, valves and air supply.

    For each make of muscles, the shortest muscle is sought whose joint meets the requirement with its forces at both
    ends of their uncertainty, over a grid of lengths, radii and contractions. The pressure is at most 90 % of the
    supply, and both muscles remain taut.

    Parameters
    ----------
    requirement
        Load, motion, stiffness and supply.
    makes
        Makes to choose from. Default: the files of the requirement and `catalog_makes`.

    Raises
    ------
    ParameterError
        If there are no makes, or a law is not affine in pressure.
    UnreachableError
        If no make meets the requirement, with the limit of each and the lengths that come closest.

    Examples
    --------
    >>> found = size(Requirement.read("examples/sizing/pulleys.yaml"))
    >>> found.best.name, round(found.best.lengths["radius"] / mm, 1)
    ('Festo 20 mm', 29.5)
    """
    if makes is None:
        files = [read_make(path, requirement.spread) for path in requirement.muscles]
        makes = (*files, *(catalog_makes() if requirement.catalog else ()))
    if not makes:
        raise ParameterError("there are no muscles to choose from", remedy="give a make, or leave them to the catalog")
    candidates, rejected = [], []
    for make in makes:
        try:
            candidates.append(_candidate_of_make(make, requirement))
        except UnreachableError as error:
            rejected.append((make.name, str(error)))
    if not candidates:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected)
        remedy = "allow a longer cycle, a smaller range of angles, less load, another stiffness or longer muscles"
        raise UnreachableError(f"no muscle meets the requirement: {reasons}", remedy=remedy)
    return Selection(
        requirement, tuple(sorted(candidates, key=lambda candidate: candidate.supply.air)), tuple(rejected)
    )


def _template(joint: AntagonisticJoint, need: Requirement, strength: float = 1.0) -> JointPlant:
    """The plant of a joint whose forces are multiplied by a strength, within the usable supply."""
    muscles = []
    for muscle in (joint.muscle1, joint.muscle2):
        if not isinstance(muscle.law, PressureAffineLaw):
            message = f"the law of {muscle.specimen.name}, {type(muscle.law).__name__}, is not affine in pressure"
            raise ParameterError(message, remedy="fit one that is, such as the exponential law")
        if (lowest := float(muscle.domain.pressure_min)) >= _HEADROOM * need.supply:
            used = show(_HEADROOM * need.supply, "bar", 3)
            raise UnreachableError(f"its law begins at {show(lowest, 'bar', 3)}, and {used} of the supply are used")
        highest = min(float(muscle.specimen.domain.pressure_max), _HEADROOM * need.supply)
        domain = dataclasses.replace(muscle.specimen.domain, pressure_max=highest)
        specimen = dataclasses.replace(muscle.specimen, domain=domain)
        total = strength * float(muscle.strength or 1.0)
        muscles.append(dataclasses.replace(muscle, specimen=specimen, strength=total))
    usable = dataclasses.replace(joint, muscle1=muscles[0], muscle2=muscles[1])
    return JointPlant(usable, need.load, IdealValve())


def _margins(plants: Sequence[JointPlant], lengths: dict[str, Any], need: Requirement) -> Floats:
    """Least margins of `CONSTRAINTS` over the motion and the plants, shape (candidates, constraints)."""
    angles = np.linspace(need.angles[0], need.angles[1], _ANGLES)
    motion = angles, np.asarray(need.stiffness or (1e6, -1e6)), need.reserve, need.speed  # any joint attains these
    margins = [np.asarray(_margins_of(plant, lengths, *motion)) for plant in plants]
    return np.nan_to_num(functools.reduce(np.minimum, margins), nan=-np.inf)


def _with_lengths(plant: JointPlant, lengths: Mapping[str, Any]) -> JointPlant:
    """The plant with other lengths [m] of muscles, whose volume scales with it, and pulleys; they may be traced."""
    paths, muscles, length = [], [], lengths["muscle_length"]
    for number, muscle in enumerate((plant.joint.muscle1, plant.joint.muscle2), 1):
        specimen = muscle.specimen
        scale = length / specimen.initial_length
        terms = specimen.volume_terms and tuple(term * scale for term in specimen.volume_terms)
        longer = dataclasses.replace(specimen, initial_length=length, volume_terms=terms)
        muscles.append(dataclasses.replace(muscle, specimen=longer))
        paths.append(Pulley(lengths["radius"], lengths[f"path{number}.rest_length"]))
    return dataclasses.replace(plant, joint=AntagonisticJoint(PairedPaths(*paths), *muscles))


@jit
def _margins_of(
    plant: JointPlant, lengths: Any, angles: ArrayLike, stiffness: Any, reserve: ArrayLike, speed: ArrayLike
) -> Array:
    """Least margins over torques and angles, shape (candidates, constraints); friction adds to the reserve."""

    def margins(lengths: dict[str, Array]) -> Array:
        sized = _with_lengths(plant, lengths)
        opposed, both = friction_torque(sized, angles, speed, _TENSION)
        needed = reserve + jnp.where(stiffness[0] <= stiffness[1], both, opposed)
        return constraint_margins(sized, angles, stiffness, needed, _TENSION).min(axis=(1, 2))

    return jax.vmap(margins)(lengths)


def _candidate_of_make(make: Make, need: Requirement) -> Candidate:
    """The joint on pulleys with the shortest muscles of a make that meets the requirement."""
    if make.shortest > need.longest:
        raise UnreachableError(f"the shortest of these muscles, {make.shortest / mm:g} mm, is longer than allowed")
    if need.widest < _NARROWEST:
        raise UnreachableError(f"the narrowest pulley, {_NARROWEST / mm:g} mm, is wider than allowed")
    grid = _pulley_grid(make, need)
    unnamed = _on_pulleys(dataclasses.replace(make.muscle, specimen=make.unnamed))  # makes share compiled programs
    plants = [_template(unnamed, need, 1 + sign * make.uncertainty) for sign in (-1, 1)]
    margins, lengths = _margins(plants, grid, need), grid["muscle_length"]
    margins[(lengths < make.shortest - 1e-9) | (grid["radius"] > need.widest + 1e-9)] = -np.inf
    least = margins.min(axis=1)
    feasible = (least >= 0) & (lengths <= need.longest + 1e-9)
    if not feasible.any():
        raise _unreached(margins, grid)
    at = int(np.argmax(np.where(feasible & (lengths == lengths[feasible].min()), least, -np.inf)))
    return _candidate(make, _row(grid, at), margins[at], need)


def _row(lengths: dict[str, Floats], at: int) -> dict[str, float]:
    """Lengths of one candidate."""
    return {name: float(column[at]) for name, column in lengths.items()}


def _unreached(margins: Floats, lengths: dict[str, Floats]) -> UnreachableError:
    """The error that names the constraints broken by the closest candidate."""
    at = int(np.argmax(margins.min(axis=1)))
    broken = [name for name, margin in zip(CONSTRAINTS, margins[at], strict=True) if margin < 0]
    remedy = "allow other lengths, a smaller range of angles or less load"
    best = _lengths_text(_row(lengths, at))
    return UnreachableError(f"limited by {' and '.join(broken)} (at best, with {best})", remedy=remedy)


def _on_pulleys(muscle: Muscle) -> AntagonisticJoint:
    path = Pulley(0.03, 0.9 * float(muscle.specimen.initial_length))
    return AntagonisticJoint(PairedPaths(path, path), muscle, muscle)


def _pulley_grid(
    make: Make, need: Requirement, *, lengths: int = 80, radii: int = 24, contractions: int = 12
) -> dict[str, Floats]:
    """Lengths of muscles, pulleys and paths at angle 0 [m] over a grid, each of shape (candidates,)."""
    domain = make.muscle.domain
    low, high = float(domain.contraction_min), float(domain.contraction_max)
    axes = (
        _rounded(np.geomspace(SHORTEST, max(need.longest, SHORTEST), lengths), _NARROWEST),
        _rounded(np.geomspace(_NARROWEST, max(need.widest, _NARROWEST), radii), mm / 2),
        np.linspace(0.0, 1.0, contractions),
    )
    length, radius, part = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    half = radius * need.amplitude / length
    path = np.round(length * (1 - (low + half + part * (high - low - 2 * half))) / (mm / 2)) * (mm / 2)
    turned = radius * need.middle
    return {
        "muscle_length": length,
        "radius": radius,
        "path1.rest_length": path - turned,
        "path2.rest_length": path + turned,
    }


def _rounded(lengths: Floats, step: float) -> Floats:
    """Different multiples of a step next to lengths, ascending."""
    return np.unique(np.round(lengths / step) * step)


def _candidate(make: Make, lengths: dict[str, float], margins: Floats, need: Requirement) -> Candidate:
    """Torque, stiffness and air supply of a joint with chosen lengths."""
    angles, joint = np.linspace(need.angles[0], need.angles[1], _ANGLES), _on_pulleys(make.muscle)
    plants = [_with_lengths(_template(joint, need, 1 + part * make.uncertainty), lengths) for part in (-1, 0, 1)]
    stiffness, torque = [], []
    for plant in plants:
        opposed, both = (float(part) for part in friction_torque(plant, angles, need.speed, _TENSION))
        low, high = attained_stiffness(plant, angles, need.reserve + (both if need.stiffness else opposed), _TENSION)
        stiffness.append((float(np.max(low)), float(np.min(high))))
        low, high = plant.joint.attainable_torque(angles, minimum_tension=_TENSION)
        gravity = -plant.load.gravity_torque(angles)
        torque.append(float(np.minimum(high - gravity, gravity - low).min()) - opposed)
    times, motion = _motion(need)
    held = sampled_reference(_reference(need, plants[1]), times).stiffness
    supply = air_supply(plants[1], times, motion, np.asarray(held), need.cycle, need.supply, need.tube)
    plant = dataclasses.replace(plants[1], valve=supply.valve)
    limiting = CONSTRAINTS[int(np.argmin(margins))]
    return Candidate(make.name, make.uncertainty, lengths, plant, limiting, tuple(torque), tuple(stiffness), supply)


def _motion(need: Requirement) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], ...]]:
    """Times [s]; angle [rad], velocity and acceleration of the sine of `_reference`."""
    times, rate = np.linspace(0.0, _CYCLES * need.cycle, _CYCLES * 32 + 1), 2 * math.pi / need.cycle
    swing, quarter = need.amplitude * np.cos(rate * times), need.amplitude * np.sin(rate * times)
    return times, (need.middle - swing, rate * quarter, rate**2 * swing)


def _reference(need: Requirement, plant: JointPlant) -> Reference:
    """A sine from one end at rest; the stiffness passes its range in the second cycle, or is mid attainable range."""
    angle = Sine(need.amplitude, 1 / need.cycle, offset=need.middle, phase=-math.pi / 2)
    if need.stiffness:
        low, high = need.stiffness
        held: Signal = Constant(low) if low == high else Ramp(low, high, start=need.cycle, duration=need.cycle)
        return Reference(angle=angle, stiffness=held)
    times, motion = _motion(need)
    torque = plant.load.required_torque(*motion)
    low, high = plant.joint.attainable_stiffness(motion[0], torque, minimum_tension=_TENSION)
    middle = [float(f"{value:.4g}") for value in (np.asarray(low) + np.asarray(high)) / 2]
    return Reference(angle=angle, stiffness=Samples(tuple(times.tolist()), tuple(middle)))


def _lengths_text(lengths: dict[str, float]) -> str:
    return ", ".join(f"{name} {value / mm:.4g} mm" for name, value in lengths.items())
