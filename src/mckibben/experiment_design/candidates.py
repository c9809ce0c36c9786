"""Design region and candidate set."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError
from mckibben.experiment_design.information import Floats, Indices
from mckibben.experiment_design.prior import DIRECTION_SIGN, PriorData
from mckibben.identification.least_squares import design_matrix
from mckibben.muscle import Domain, ForceLaw, Specimen, forces
from mckibben.units import mm, percent

REPEATS = 2
"""Most repetitions of a point, each on a separate pass."""


@dataclass(frozen=True)
class DesignRegion:
    """States that the rig can set and the muscle permits."""

    domain: Domain
    contraction_step: float  # resolution of the rig [-]; states are whole multiples
    pressure_step: float  # [Pa]
    force_min: float  # of a measurable state [N]
    force_max: float


@dataclass(frozen=True, eq=False)
class StateGrid:
    """Grid of states with a mask of the measurable ones."""

    contractions: Floats = field(repr=False)  # [-], ascending
    pressures: Floats = field(repr=False)  # [Pa], ascending
    force: Floats = field(repr=False)  # (pressures, contractions), by the law [N]
    allowed: NDArray[np.bool_] = field(repr=False)  # taut, not overloaded and in the domain of the law

    @classmethod
    def of(cls, law: ForceLaw, region: DesignRegion, *, most: int = 40_000) -> StateGrid:
        """Return the grid of a region.

        Raises
        ------
        RangeError
            If no state can be measured, or there are more states than `most`.
        """
        domain = region.domain
        contractions = _grid_axis(domain.contraction_min, domain.contraction_max, region.contraction_step)
        pressures = _grid_axis(domain.pressure_min, domain.pressure_max, region.pressure_step)
        if len(contractions) * len(pressures) > most:
            message = f"{len(pressures)} pressures x {len(contractions)} contractions are too many candidates"
            remedy = "choose coarser steps or narrower limits"
            raise RangeError(message, value=len(contractions) * len(pressures), upper=most, remedy=remedy)
        grid = contractions[None, :], pressures[:, None]
        force = forces(law, *grid)
        valid = np.asarray(type(law).formula_domain.contains(*grid))
        with np.errstate(invalid="ignore"):
            allowed = np.isfinite(force) & valid & (force > region.force_min) & (force <= region.force_max)
        if not allowed.any():
            raise RangeError(
                f"no state within {domain} has a force above {region.force_min:.3g} and up to {region.force_max:.4g} N",
                remedy="widen the limits, or choose finer steps",
            )
        return cls(contractions, pressures, force, allowed)

    @property
    def places(self) -> Indices:
        """Rows and columns of the allowed states, shape (states, 2)."""
        return np.argwhere(self.allowed)


def _grid_axis(low: object, high: object, step: float) -> Floats:
    """Whole multiples of a step from low to high."""
    first, last = math.ceil(float(low) / step - 1e-6), math.floor(float(high) / step + 1e-6)  # type: ignore[arg-type]
    return np.asarray(np.round(np.arange(first, last + 1) * step, 12), np.float64)


def design_region(
    prior: PriorData,
    limits: Domain | None,
    specimen: Specimen | None,
    contraction_step: float | None,
    pressure_step: float,
) -> tuple[DesignRegion, list[str]]:
    """Return the design region, and notes on it.

    States are within the limits, the range of the specimen and the range of the data, in this order; forces from three
    standard deviations above the slack force to 95 % of the rated force, or to the highest force of the data. Other
    arguments as for `mckibben.experiment_design.plan`.

    Raises
    ------
    RangeError
        If a step is not positive.
    """
    data, attrs = prior.measured, prior.measured.table.attrs
    notes: list[str] = []
    if specimen is None and attrs["specimen"] in catalog.names("specimens"):
        specimen = catalog.specimen(attrs["specimen"])
    measured = (data.contraction, data.levels)
    box = Domain(*(end(values) for values in measured for end in (np.min, np.max)))
    if specimen is not None and specimen.rated_force is not None:
        highest = 0.95 * float(specimen.force_limit)
    else:
        highest = float(data.force.max())
        notes.append("the rated force of the muscle is unknown: the plan stays within the forces of the data")
    rated = Domain() if specimen is None else specimen.domain
    domain = (rated if limits is None else limits.intersection(rated)).filled(box)
    length = attrs.get("initial_length") or (float(specimen.initial_length) if specimen else None)
    default = 1 * mm / length if length else 0.5 * percent
    lowest = float(attrs["slack_force"]) + 3 * prior.noise.point
    step = default if contraction_step is None else contraction_step
    check_positive("plan", contraction_step=step, pressure_step=pressure_step)
    return DesignRegion(domain, step, pressure_step, lowest, highest), notes


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """Every allowed state in every direction and repeat, in this order; the last varies fastest."""

    states: StateGrid
    directions: tuple[str, ...]  # ("",) if not distinguished
    rows: Floats = field(repr=False)  # design matrix, (candidates, unknowns)
    strokes: Indices = field(repr=False)  # (candidates,), one per pressure, direction and repeat

    @classmethod
    def of(cls, prior: PriorData, states: StateGrid) -> CandidateSet:
        """All candidates of a grid."""
        levels, columns = states.places.T
        directions = tuple(DIRECTION_SIGN) if prior.friction else ("",)
        names = [p.name for p in type(prior.law).parameters()]
        rows = design_matrix(prior.law, names, states.contractions[columns], states.pressures[levels])
        count = len(directions) * REPEATS
        rows = np.repeat(rows, count, axis=0)
        if prior.friction:
            signs = np.tile(np.repeat(list(DIRECTION_SIGN.values()), REPEATS), len(levels))
            rows = np.concatenate([rows, signs[:, None]], axis=1)
        strokes = np.repeat(levels * count, count) + np.tile(np.arange(count), len(levels))
        return cls(states, directions, rows, np.unique(strokes, return_inverse=True)[1].reshape(-1))

    def points(self, chosen: list[int]) -> list[tuple[float, float, str, int, float]]:
        """Pressure, contraction, direction, repeat and expected force; repeats numbered in order of appearance."""
        passes: dict[tuple[int, int], list[int]] = {}
        points = []
        for candidate in chosen:
            place, remainder = divmod(candidate, len(self.directions) * REPEATS)
            direction, repeat = divmod(remainder, REPEATS)
            row, column = self.states.places[place]
            seen = passes.setdefault((int(row), direction), [])
            if repeat not in seen:
                seen.append(repeat)
            state = float(self.states.pressures[row]), float(self.states.contractions[column])
            force = float(self.states.force[row, column])
            points.append((*state, self.directions[direction], seen.index(repeat), force))
        return points
