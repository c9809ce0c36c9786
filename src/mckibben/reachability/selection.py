"""Selection of muscles, pulleys, valves and air supply for a joint, from a requirement."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mckibben.component.calls import checked_call
from mckibben.config.document import plain, read_document, to_text
from mckibben.control import Constant, DecouplingControl, PolePlacement, Ramp, Reference, Samples, Signal, Sine
from mckibben.errors import ParameterError, UnreachableError
from mckibben.joint import AntagonisticJoint, PairedPaths, Pulley
from mckibben.muscle import Muscle, PressureAffineLaw
from mckibben.notebook import draw, html_table
from mckibben.numerics.compiled import jit
from mckibben.plant import IdealValve, JointPlant
from mckibben.reachability.air_supply import AirSupply, air_supply
from mckibben.reachability.requirement import (
    SHORTEST,
    Make,
    Requirement,
    catalog_makes,
    friction_force,
    with_length,
    with_supply,
)
from mckibben.reachability.sizing import CONSTRAINTS, attained_stiffness, constraint_margins
from mckibben.reachability.trajectory import reference_trajectory
from mckibben.scenario import Scenario, Start
from mckibben.simulation import SimulationResult
from mckibben.units import deg, mm, percent, show

_HEADROOM = 0.9  # of the supply: air flows into a muscle only below it
_TENSION = 5.0  # N: least tension of both muscles
_ANY = (1e6, -1e6)  # stiffness that every joint attains
_ANGLES = 13  # of the search
_RESULT_ANGLES = 61
_NARROWEST = 0.005  # m
_LENGTHS, _RADII, _CONTRACTIONS = 80, 24, 12  # of the search
_STEP = 5 * mm  # of lengths of muscles; radii have steps of 0.5 mm
_CYCLES, _PERIOD = 3, 1e-3
_SAMPLES, _KNOTS = 200, 32  # of a cycle, of the motion and of a stiffness that is not required
_ACTIVE = 0.05
_BISECTIONS = 7
_LEAST, _MOST = 0.02, 20.0  # factors within which the nearest requirement is sought
_REACHED, _HELD = 0.02, 0.05  # relative errors of angle and stiffness of a run that meets the requirement


class Candidate(NamedTuple):
    """A joint that meets a requirement.

    Torque and stiffness are attainable throughout the motion, with the lowest, nominal and highest forces within the
    uncertainty of the make; of a stiffness range, the first end is the higher one if no stiffness is.
    """

    make: Make  # of the muscles
    plant: JointPlant  # with the valve of the air supply
    length: float  # initial, of the muscles [m]
    radius: float  # of the pulleys [m]
    contraction: float  # in the middle of the motion [-]
    limiting: str  # requirement or limit that leaves the least margin
    torque: tuple[float, float, float]  # either way, in excess of gravity and of the muscles' friction [N*m]
    stiffness: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]  # lowest and highest [N*m/rad]
    supply: AirSupply

    def record(self) -> dict[str, Any]:
        """The candidate as plain data."""
        return {
            "make": self.make.name,
            "force_uncertainty": self.make.uncertainty,
            "muscle_length_mm": self.length / mm,
            "pulley_radius_mm": self.radius / mm,
            "middle_contraction_percent": self.contraction / percent,
            "limiting": self.limiting,
            "torque_Nm": list(self.torque),
            "stiffness": [list(one) for one in self.stiffness],
            "valve": self.supply.valve_name,
            "air_per_cycle_L": self.supply.air * 1e3,
            "reservoir_L": self.supply.reservoir * 1e3,
            "compressor_L_per_min": self.supply.compressor * 60e3,
            "tube_mm": self.supply.tube / mm,
        }


class Check(NamedTuple):
    """A requirement, as text, the value in a run, and whether it is met."""

    requirement: str
    found: str
    met: bool


@dataclass(frozen=True)
class Selection:
    """Result of `size`: candidates in the order of their air per cycle, and rejected makes with the reason."""

    requirement: Requirement
    candidates: tuple[Candidate, ...]
    rejected: tuple[tuple[str, str], ...]

    headers = (
        "muscle",
        "length",
        "pulley radius",
        "contraction",
        "torque beyond gravity",
        "stiffness",
        "valve",
        "air per cycle",
        "limited by",
    )

    @property
    def best(self) -> Candidate:
        """The candidate with the least air per cycle."""
        return self.candidates[0]

    def __repr__(self) -> str:
        return f"<Selection: {self.best.make.name}, {self.best.length / mm:g} mm; {self.requirement.describe()}>"

    def _repr_html_(self) -> str:
        return html_table(self.requirement.describe(), self.headers, self.rows(), self.remarks())

    def rows(self) -> list[tuple[str, ...]]:
        """The candidates as text; intervals are those of the forces."""
        return [
            (
                one.make.name,
                f"{one.length / mm:g} mm",
                f"{one.radius / mm:g} mm",
                f"{one.contraction / percent:.3g} %",
                f"{one.torque[1]:.3g} ({one.torque[0]:.3g}..{one.torque[2]:.3g}) N*m",
                _range(one.stiffness[1]),
                one.supply.valve_name,
                f"{one.supply.air * 1e3:.3g} L",
                one.limiting,
            )
            for one in self.candidates
        ]

    def remarks(self) -> list[str]:
        """Rejected makes with the reason, and remarks on the best joint."""
        return [*(f"rejected: {name}: {reason}" for name, reason in self.rejected), *self.best.plant.joint.remarks]

    def parts(self, candidate: Candidate | None = None) -> list[tuple[str, str, str]]:
        """Bill of materials of a candidate, by default the best: number, part, size."""
        one = candidate or self.best
        supply = one.supply
        diameter = one.make.muscle.specimen.initial_diameter
        size = f"{show(float(diameter), 'mm', 4)} x " if diameter is not None else ""
        path = one.length * (1 - one.contraction)
        strongest = max(float(np.max(tension)) for tension in _largest_tensions(one, self.requirement))
        return [
            ("2", "muscle", f"{one.make.name}, {size}{one.length / mm:g} mm, forces up to {strongest:.3g} N"),
            ("2", "pulley", f"radius {one.radius / mm:g} mm; muscle {path / mm:g} mm long in the middle of the motion"),
            ("2", "proportional valve", f"{supply.valve_name}, needed C {supply.needed * 1e8:.3g} L/(s*bar)"),
            ("2", "tube", f"inner diameter {supply.tube / mm:g} mm"),
            ("1", "reservoir", f"{supply.reservoir * 1e3:.2g} L"),
            ("1", "compressor", f"{supply.compressor * 60e3:.3g} L/min (ANR), {show(self.requirement.supply, 'bar')}"),
        ]

    def scenario(self, candidate: Candidate | None = None) -> Scenario:
        """A scenario of three cycles with a candidate, by default the best; a stiffness range is passed through."""
        one = candidate or self.best
        need = self.requirement
        reference = _reference(need, one.plant)
        scenario = Scenario(
            name=f"sized: {one.make.name}, {one.length / mm:g} mm",
            joint=one.plant.joint,
            load=one.plant.load,
            valve=one.supply.valve,
            controller=DecouplingControl(one.plant.joint, one.plant.load, PolePlacement()),  # type: ignore[call-arg]
            reference=reference,
            start=Start(angle=need.angles[0], stiffness=float(reference.stiffness(0.0))),
            duration=max(round(_CYCLES * need.cycle / _PERIOD), 1) * _PERIOD,
            control_period=_PERIOD,
        )
        text = plain(read_document(scenario.dumps()).data)
        text["controller"] = {"class": "decoupling", "feedback": {}}  # its model is the plant's
        text["valve"] = {"from": one.supply.valve_name, "supply": show(need.supply, "bar")}
        return Scenario.parse(to_text(text))

    def verify(self, result: SimulationResult) -> list[Check]:
        """Compare a run of the scenario with the requirement."""
        need, angle = self.requirement, np.asarray(result["angle"])
        error = np.abs(angle - np.asarray(result["desired_angle"])).max()
        checks = [
            Check("run", result.outcome.value, not result.outcome.failed),
            Check(
                f"{need.angles[0] / deg:g}..{need.angles[1] / deg:g} deg in {need.cycle:g} s",
                f"{angle.min() / deg:.4g}..{angle.max() / deg:.4g} deg, error at most {error / deg:.2g} deg",
                bool(error <= _REACHED * 2 * need.amplitude),
            ),
        ]
        if need.stiffness:
            stiffness, wanted = np.asarray(result["stiffness"]), np.asarray(result["desired_stiffness"])
            wrong = float(np.abs(stiffness / wanted - 1).max())
            checks.append(
                Check(
                    f"stiffness {need.stiffness_text()}",
                    f"{stiffness.min():.4g}..{stiffness.max():.4g} N*m/rad",
                    wrong <= _HELD,
                )
            )
        return checks

    def records(self) -> dict[str, Any]:
        """The result as plain data."""
        return {
            "requirement": self.requirement.describe(),
            "candidates": [one.record() for one in self.candidates],
            "rejected": dict(self.rejected),
            "parts": [list(part) for part in self.parts()],
        }

    def plot(self) -> Any:
        """Return a figure of the candidates, see `mckibben.report.selection`."""
        return draw("selection", self)


@checked_call
def size(requirement: Requirement, makes: Sequence[Make] | None = None, *, tube_length: float = 1.0) -> Selection:
    """Select muscles, pulleys, valves and air supply for a joint with two antagonistic muscles.

    For each make the shortest muscle is sought whose joint meets the requirement with its forces at both ends of their
    uncertainty, over a grid of lengths, radii and contractions, by the `constraint_margins` of `design`. The pressure
    is at most 90 % of the supply, and both muscles remain taut.

    Parameters
    ----------
    requirement
        Motion, stiffness, load and supply.
    makes
        Makes to choose from. Default: `catalog_makes`.
    tube_length
        Length [m] of the tubes between valves and muscles.

    Raises
    ------
    ParameterError
        If there are no makes, or a law is not affine in pressure.
    UnreachableError
        If no make meets the requirement, with the limit of each. `value` has the factors nearest to 1 on "load",
        "angles", "stiffness" or "cycle", each alone, with which one of them meets it.
    """
    makes = catalog_makes() if makes is None else tuple(makes)
    if not makes:
        raise ParameterError("there are no muscles to choose from", remedy="give a make, or leave them to the catalog")
    for make in makes:
        if not isinstance(make.muscle.law, PressureAffineLaw):
            raise ParameterError(
                f"the law of {make.name}, {type(make.muscle.law).__name__}, is not affine in pressure",
                remedy="fit one that is, such as the exponential law",
            )
    found, rejected = [], []
    for make in makes:
        try:
            found.append(_candidate(make, requirement, tube_length))
        except UnreachableError as error:
            rejected.append((make.name, str(error)))
    if not found:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected)
        factors, text = _nearest(makes, requirement, tube_length), f"no muscle meets the requirement: {reasons}"
        raise UnreachableError(text, value=factors, remedy=_remedy(requirement, factors))
    return Selection(requirement, tuple(sorted(found, key=lambda one: one.supply.air)), tuple(rejected))


class _Grid(NamedTuple):
    """Lengths and radii [m], and contractions [-] in the middle of the motion, each of shape (candidates,)."""

    length: Array
    radius: Array
    contraction: Array

    def lengths(self, middle: float) -> dict[str, Array]:
        """Design lengths of the pulleys, whose path at angle 0 follows from that in the middle of the motion [rad]."""
        path, turned = self.length * (1 - self.contraction), self.radius * middle
        return {
            "radius": self.radius,
            "muscle_length": self.length,
            "path1.rest_length": path - turned,
            "path2.rest_length": path + turned,
        }


def _grid(make: Make, need: Requirement) -> _Grid:
    domain = make.muscle.domain
    low, high = float(domain.contraction_min), float(domain.contraction_max)
    lengths = np.unique(np.round(np.geomspace(SHORTEST, max(need.longest, SHORTEST), _LENGTHS) / _STEP) * _STEP)
    radii = np.unique(np.round(np.geomspace(_NARROWEST, max(need.widest, _NARROWEST), _RADII) / mm * 2) / 2 * mm)
    parts = np.linspace(0.0, 1.0, _CONTRACTIONS)
    length, radius, part = (each.ravel() for each in np.meshgrid(lengths, radii, parts, indexing="ij"))
    half = radius * need.amplitude / length
    path = length * (1 - (low + half + part * (high - low - 2 * half)))
    contraction = 1 - np.round(path / mm * 2) / 2 * mm / length
    return _Grid(jnp.asarray(length), jnp.asarray(radius), jnp.asarray(contraction))


def _plant(muscle: Muscle, need: Requirement) -> JointPlant:
    limited = with_supply(muscle, _HEADROOM * need.supply)
    path = Pulley(0.03, 0.9 * float(muscle.specimen.initial_length))
    return JointPlant(AntagonisticJoint(PairedPaths(path, path), limited, limited), need.scaled().load, IdealValve())


@jit
def _margins(
    plant: JointPlant, lengths: dict[str, Array], angles: ArrayLike, stiffness: ArrayLike, reserve: Array
) -> Array:
    """Least margins of `CONSTRAINTS` over torques and angles, shape (candidates, constraints)."""

    def one(lengths: dict[str, Array], reserve: Array) -> Array:
        return constraint_margins(plant, lengths, angles, stiffness, reserve, _TENSION).min(axis=(1, 2))

    return jax.vmap(one)(lengths, reserve)


def _searched(make: Make, need: Requirement) -> tuple[_Grid, np.ndarray]:
    """The grid of a make, and its margins with the lowest and the highest forces, shape (candidates, constraints)."""
    grid, angles = _grid(make, need), np.linspace(*need.angles, _ANGLES)
    reserve = need.reserve + _friction_torque(make, need, grid, cocontracted=need.stiffness is not None)
    given = grid.lengths(need.middle), angles, np.asarray(need.stiffness or _ANY), jnp.asarray(reserve)
    both = [
        np.asarray(_margins(_plant(make.with_strength(1 + sign * make.uncertainty), need), *given)) for sign in (-1, 1)
    ]
    margins = np.nan_to_num(np.minimum(*both), nan=-np.inf)
    lengths, radii = np.asarray(grid.length), np.asarray(grid.radius)
    outside = (lengths < make.shortest - 1e-9) | (lengths > need.longest + 1e-9) | (radii > need.widest + 1e-9)
    margins[outside] = -np.inf
    return grid, margins


def _friction_torque(make: Make, need: Requirement, grid: _Grid, *, cocontracted: bool) -> np.ndarray:
    """Torque [N*m] of both muscles' friction with the highest forces, shape (candidates,)."""
    muscle = with_supply(make.with_strength(1 + make.uncertainty), _HEADROOM * need.supply)
    candidates = np.asarray(grid.length), np.asarray(grid.radius), np.asarray(grid.contraction)
    return friction_force(muscle, need, candidates, _TENSION, cocontracted=cocontracted) * candidates[1]


def _candidate(make: Make, need: Requirement, tube_length: float) -> Candidate:
    if make.shortest > need.longest:
        raise UnreachableError(f"the shortest of these muscles, {make.shortest / mm:g} mm, is longer than allowed")
    if need.widest < _NARROWEST:
        raise UnreachableError(f"the narrowest pulley, {_NARROWEST / mm:g} mm, is wider than allowed")
    if (lowest := float(make.muscle.domain.pressure_min)) >= _HEADROOM * need.supply:
        used = show(_HEADROOM * need.supply, "bar", 3)
        raise UnreachableError(f"its law begins at {show(lowest, 'bar', 3)}, and {used} of the supply are used")
    grid, margins = _searched(make, need)
    least = margins.min(axis=1)
    feasible = least >= 0
    if not feasible.any():
        at = int(np.argmax(least))
        best = f"with muscles of {float(grid.length[at]) / mm:g} mm"
        raise UnreachableError(f"{_described(margins[at])} (at best, {best})")
    lengths = np.asarray(grid.length)
    shortest = lengths[feasible].min()
    at = int(np.argmax(np.where(feasible & (lengths == shortest), least, -np.inf)))
    length, radius, contraction = (float(each[at]) for each in grid)
    plants = [
        _built(make.with_strength(1 + part * make.uncertainty), need, length, radius, contraction)
        for part in (-1, 0, 1)
    ]
    angles = np.linspace(*need.angles, _RESULT_ANGLES)
    chosen = _Grid(*(each[at : at + 1] for each in grid))
    held = float(_friction_torque(make, need, chosen, cocontracted=need.stiffness is not None)[0])
    most = float(_friction_torque(make, need, chosen, cocontracted=False)[0])
    stiffness = tuple(_common(attained_stiffness(one, angles, need.reserve + held, _TENSION)) for one in plants)
    torque = tuple(_available(one, angles) - most for one in plants)
    motion = reference_trajectory(
        _reference(need, plants[1]),
        np.linspace(0.0, _CYCLES * need.cycle, _CYCLES * _SAMPLES + 1),
        smoothing=need.cycle / 20,
    )
    supply = air_supply(plants[1], motion, need.cycle, need.supply, tube_length)
    plant = dataclasses.replace(_built(make.muscle, need, length, radius, contraction), valve=supply.valve)
    return Candidate(make, plant, length, radius, contraction, _limiting(margins[at]), torque, stiffness, supply)  # type: ignore[arg-type]


def _built(muscle: Muscle, need: Requirement, length: float, radius: float, contraction: float) -> JointPlant:
    limited = with_length(with_supply(muscle, _HEADROOM * need.supply), length)
    path, turned = length * (1 - contraction), radius * need.middle
    paths = PairedPaths(Pulley(radius, path - turned), Pulley(radius, path + turned))
    return JointPlant(AntagonisticJoint(paths, limited, limited), need.load, IdealValve())


def _common(band: tuple[Array, Array]) -> tuple[float, float]:
    """Stiffness that is attainable at all angles."""
    return float(np.max(band[0])), float(np.min(band[1]))


def _available(plant: JointPlant, angles: np.ndarray) -> float:
    """Torque [N*m] in either direction in excess of gravity, attainable at all angles."""
    low, high = plant.joint.attainable_torque(angles, minimum_tension=_TENSION)
    held = -plant.load.gravity_torque(angles)
    return float(np.minimum(high - held, held - low).min())


def _largest_tensions(one: Candidate, need: Requirement) -> tuple[Array, Array]:
    highest = float(one.plant.joint.muscle1.domain.pressure_max)
    angles = np.linspace(*need.angles, _ANGLES)
    return one.plant.joint.tensions(angles, (highest, highest))


def _reference(need: Requirement, plant: JointPlant) -> Reference:
    """A sine from one end at rest; the stiffness passes its range in the second cycle, or is mid attainable range."""
    angle = Sine(need.amplitude, 1 / need.cycle, offset=need.middle, phase=-math.pi / 2)
    if need.stiffness:
        low, high = need.stiffness
        held: Signal = Constant(low) if low == high else Ramp(low, high, start=need.cycle, duration=need.cycle)
        return Reference(angle=angle, stiffness=held)
    times = np.linspace(0.0, _CYCLES * need.cycle, _CYCLES * _KNOTS + 1)
    motion = reference_trajectory(Reference(angle=angle, stiffness=0.0), times, smoothing=0.0)
    torque = plant.load.required_torque(motion.angle, motion.velocity, motion.acceleration)
    low, high = plant.joint.attainable_stiffness(motion.angle, torque, minimum_tension=_TENSION)
    middle = [float(f"{value:.4g}") for value in (np.asarray(low) + np.asarray(high)) / 2]
    return Reference(angle=angle, stiffness=Samples(tuple(times.tolist()), tuple(middle)))


def _range(stiffness: tuple[float, float]) -> str:
    low, high = stiffness
    return f"{low:.3g}..{high:.3g} N*m/rad" if low <= high else "varies with the angle"


def _limiting(margins: np.ndarray) -> str:
    return CONSTRAINTS[int(np.argmin(margins))]


def _described(margins: np.ndarray) -> str:
    missed = min(-_ACTIVE, 0.5 * float(margins.min()))
    broken = [name for name, margin in zip(CONSTRAINTS, margins, strict=True) if margin < missed]
    return f"limited by {' and '.join(broken or [_limiting(margins)])}"


def _nearest(makes: Sequence[Make], need: Requirement, tube_length: float) -> dict[str, float]:
    """Factors nearest to 1 on load, range, stiffness or cycle, each alone, with which a make meets the requirement."""

    def meets(**factors: float) -> bool:
        changed = need.scaled(**factors)
        for make in makes:
            with suppress(UnreachableError):
                return bool(_candidate(make, changed, tube_length))
        return False

    def nearest(name: str, end: float) -> float:
        """By bisection of the logarithm between 1 and an end; NaN if the end is not met."""
        if not meets(**{name: end}):
            return math.nan
        within, beyond = math.log(end), 0.0
        for _ in range(_BISECTIONS):
            middle = (within + beyond) / 2
            within, beyond = (middle, beyond) if meets(**{name: math.exp(middle)}) else (within, middle)
        return math.exp(within)

    found = {name: nearest(name, _LEAST) for name in ("load", "angles")} | {"cycle": nearest("cycle", _MOST)}
    if need.stiffness:
        softer = nearest("stiffness", _LEAST)
        found["stiffness"] = softer if math.isfinite(softer) else nearest("stiffness", _MOST)
    return {name: factor for name, factor in found.items() if math.isfinite(factor)}


def _remedy(need: Requirement, factors: dict[str, float]) -> str:
    """The nearest possible requirements in words."""
    texts = []
    for name, factor in factors.items():
        changed = need.scaled(**{name: factor})
        first, last = (angle / deg for angle in changed.angles)
        texts.append(
            {
                "load": f"{factor / percent:.3g} % of load and torque",
                "angles": f"angles of {first:.3g}..{last:.3g} deg",
                "stiffness": f"a stiffness of {changed.stiffness_text()}",
                "cycle": f"a cycle of {changed.cycle:.3g} s",
            }[name]
        )
    return f"possible, each alone: {', or '.join(texts)}" if texts else "relax several requirements at once"
