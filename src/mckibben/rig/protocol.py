"""Isobaric protocol: pressures, stroke and plateaus of the paper's test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import Checked, field_problems
from mckibben.component.classes import Keyed
from mckibben.errors import Problem, RangeError, refuse_problems
from mckibben.muscle import Muscle, Specimen, forces
from mckibben.muscle.muscle import LEAST_PRESSURE
from mckibben.units import (
    Contraction,
    Duration,
    Percent,
    Quantity,
    Repeats,
    Samples,
    Speed,
    WaitTime,
    bar,
    mm,
    percent,
    s,
)

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset

ForceReserve = Annotated[float, Percent("1", "%", 0, 100, open_upper=True)]


class _SetPressureRange(Quantity):
    """Range without values in bar or kPa that were given as Pa."""

    def holds(self, number: Any) -> Any:
        return super().holds(number) & ((number <= 0) | (number >= LEAST_PRESSURE))

    @property
    def range(self) -> str:
        return f"{self.lower:g} to 0 bar, or {LEAST_PRESSURE / bar:g} to {self.upper:g} bar"


SetPressure = Annotated[float, _SetPressureRange("Pa", "bar", -1, 1e3)]


class Boundaries(NamedTuple):
    """Set pressures [Pa], and contractions [-] of the most stretched and the shortest plateau; shape (pressures,)."""

    pressure: NDArray[np.float64]
    contraction_min: NDArray[np.float64]
    contraction_max: NDArray[np.float64]


def boundaries(of: Muscle | Specimen, protocol: IsobaricProtocol) -> Boundaries:
    """Stroke at each pressure: "determining the boundary values" of the paper's procedure.

    The whole stroke; for a muscle with a law, limited at both ends:

    - Stretched end: no plateau at which the law's force exceeds the rated force minus the protocol's reserve (Eq. 3
      gives 895 N at -3 % and 6 bar; the rating is 630 N).
    - Slack end: `slack_steps` plateaus beyond the last taut one, which show the zero of the force sensor.

    Raises
    ------
    RangeError
        As the protocol's `check`; or if at a pressure the force is too high over the whole stroke.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.rig import IsobaricProtocol
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> limits = boundaries(muscle, IsobaricProtocol())
    >>> [round(float(end[-1]), 4) for end in (limits.contraction_min, limits.contraction_max)]  # at 6 bar
    [0.0033, 0.2478]
    """
    protocol.check(of)
    pressures = np.array(protocol.pressures)
    stroke = positions(of, protocol)
    if isinstance(of, Specimen):
        ends = (np.full(len(pressures), end) for end in (stroke[0], stroke[-1]))
        return Boundaries(pressures, *ends)
    force = forces(of, stroke, pressures[:, None])
    limit = float(of.specimen.force_limit) * (1 - protocol.force_reserve)
    first = _after_last(force > limit)
    last = np.minimum(np.maximum(_after_last(force > 0), first) + protocol.slack_steps, len(stroke)) - 1
    if len(over := pressures[first == len(stroke)]):
        raise RangeError(
            f"at {', '.join(f'{p / bar:g}' for p in over)} bar the force exceeds {limit:g} N over the whole stroke",
            value=float(over[0]),
            unit="Pa",
            remedy="leave the pressure out, or let the stroke reach a higher contraction",
        )
    return Boundaries(pressures, stroke[first], stroke[last])


def positions(of: Muscle | Specimen, protocol: IsobaricProtocol) -> NDArray[np.float64]:
    """Contraction [-] of the plateaus of the whole stroke, ascending."""
    first, last = protocol.stroke(of)
    step = protocol.step / float(specimen_of(of).initial_length)
    return first + step * np.arange(_plateaus_in(protocol.step, first, last, of), dtype=np.float64)


def _plateaus_in(step: float, first: float, last: float, of: Muscle | Specimen) -> int:
    return math.floor((last - first) / (step / float(specimen_of(of).initial_length)) + 1e-9) + 1


def specimen_of(of: Muscle | Specimen) -> Specimen:
    """Specimen of a muscle, or the specimen itself."""
    return of.specimen if isinstance(of, Muscle) else of


def _after_last(where: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Column after the last true one of each row; 0 if there is none."""
    count = where.shape[1]
    return np.where(where.any(axis=1), count - np.argmax(where[:, ::-1], axis=1), 0).astype(np.int64)


MOST_POINTS = 100_000
"""Largest number of points of a test with all its repeats, and of its steps: more are refused."""

StepTravel = Annotated[float, Quantity("m", "mm", 0, 100, open_lower=True)]  # more is one in millimetres
PAPER_PRESSURES = tuple(0.5 * level * bar for level in range(13))


class Plateaus(NamedTuple):
    """Plateaus of a test in order, one row each."""

    level: NDArray[np.int64]  # index of the pressure in the protocol
    repeat: NDArray[np.int64]  # from 0
    stretching: NDArray[np.bool_]  # whether the plateau belongs to the loading pass
    contraction: NDArray[np.float64]  # [-]
    travel: NDArray[np.float64]  # from the plateau before [m], positive = stretching; 0 on the first of a pass
    time: NDArray[np.float64]  # start of the acquisition [s] after the start of the test


class Protocol(Keyed, Checked):
    """A test."""


@dataclass(frozen=True, kw_only=True)
class IsobaricProtocol(Protocol):
    """Isobaric test: strokes at constant pressures.

    Defaults are the paper's ("Parameters identification") unless marked as ours.

    At each pressure, `repeats` times: an unloading pass (the muscle shortens from plateau to plateau), then a loading
    pass (it is stretched back). At a plateau the rig waits, then samples. The last plateau of a pass is the first of
    the next one, sampled twice without a move.

    Parameters
    ----------
    pressures
        Set pressures [Pa, gauge], all different, in the order of the test: 0, 0.5, ... 6 bar.
    contraction_min, contraction_max
        Ends of the stroke [-]; by default those of the muscle's range (-3 and 25 % for the paper's).
    step
        Travel between two plateaus [m]: 1 mm.
    speed
        Speed of a move [m/s]: 0.2 mm/s, so that a step takes 5 s.
    dwell
        Wait [s] between a move and the acquisition: 5 s. The paper's "after each 5 s delay" can also be read
        as the 5 s of the move itself: then 0.
    acquisition, samples
        Duration [s] and number of the samples of a plateau: 1000 in 1 s.
    repeats
        Number of repeats: 5.
    force_reserve
        Reserve as a share of the rated force [-], see `boundaries`: 5 % (ours), for hysteresis, offsets and noise.
    slack_steps
        Plateaus beyond the last taut one, see `boundaries`: 3 (ours).

    Raises
    ------
    RangeError
        If numbers are out of range; it lists all of them.

    Examples
    --------
    >>> IsobaricProtocol(step=-1 * mm, repeats=0)
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: isobaric protocol: 2 problems
      step: is -0.001 m, outside above 0 to 100 mm; choose a value inside
      repeats: is 0, outside 1 to 10000; choose a value inside
    """

    short_name = "isobaric"

    pressures: Sequence[SetPressure] = PAPER_PRESSURES
    contraction_min: Contraction | None = None
    contraction_max: Contraction | None = None
    step: StepTravel = 1 * mm
    speed: Speed = 0.2 * mm / s
    dwell: WaitTime = 5 * s
    acquisition: Duration = 1 * s
    samples: Samples = 1000
    repeats: Repeats = 5
    force_reserve: ForceReserve = 5 * percent
    slack_steps: Repeats = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "pressures", tuple(float(pressure) for pressure in self.pressures))
        problems = field_problems(self)
        if not self.pressures:
            problems.append(Problem("give at least one", field="pressures"))
        if len(set(self.pressures)) < len(self.pressures):
            problems.append(
                Problem("one is given twice", field="pressures", remedy="raise repeats to test it more often")
            )
        refuse_problems("isobaric protocol", problems)

    def stroke(self, of: Muscle | Specimen) -> tuple[float, float]:
        """First and last contraction [-] before the boundaries: as given, or the range of the muscle or specimen."""
        low, high = self.contraction_min, self.contraction_max
        return (
            float(of.domain.contraction_min) if low is None else low,
            float(of.domain.contraction_max) if high is None else high,
        )

    def check(self, of: Muscle | Specimen) -> None:
        """Raise `RangeError` with pressures outside the rating and ends of the stroke outside the range of a muscle."""
        name, domain = specimen_of(of).name, of.domain
        low, high = float(domain.pressure_min), float(domain.pressure_max)
        problems: list[Problem] = []
        if outside := [p for p in self.pressures if not low - 1e-3 <= p <= high + 1e-3]:
            problems.append(
                Problem(
                    f"{', '.join(f'{p / bar:g}' for p in outside)} bar outside "
                    f"{low / bar:g}..{high / bar:g} bar of {name}",
                    field="pressures",
                    remedy="leave out the values outside",
                )
            )
        first, last = self.stroke(of)
        for field, end in (("contraction_min", first), ("contraction_max", last)):
            if not math.isfinite(end):
                problems.append(Problem(f"{name} has no range", field=field, remedy="give the end of the stroke"))
            elif not bool(domain.contains_contraction(end)):
                problems.append(
                    Problem(
                        f"{end / percent:.1f} % is outside {float(domain.contraction_min) / percent:g}.."
                        f"{float(domain.contraction_max) / percent:g} % of {name}",
                        field=field,
                        remedy="give the end of the stroke inside, as a ratio, or leave it to the muscle",
                    )
                )
        count = 0 if problems else _plateaus_in(self.step, first, last, of)
        total = 2 * count * self.repeats * len(self.pressures)
        if total > MOST_POINTS:
            message = f"{self.step / mm:g} mm make {total} plateaus, and {MOST_POINTS} at most are allowed"
            problems.append(Problem(message, field="step", remedy="lengthen the step, or repeat less often"))
        if not problems and count < 2:
            problems.append(
                Problem(
                    f"a step of {self.step / mm:g} mm does not fit into the stroke "
                    f"{first / percent:.1f}..{last / percent:.1f} % of {name}",
                    field="step",
                    remedy="shorten the step or widen the stroke",
                )
            )
        refuse_problems(f"the isobaric protocol does not suit {name}", problems)

    def plateaus(self, of: Muscle | Specimen) -> Plateaus:
        """Plateaus in order, within the `boundaries`."""
        limits, stroke = boundaries(of, self), positions(of, self)
        passes: list[tuple[NDArray[np.float64], int, int, bool]] = []
        for level, (_, low, high) in enumerate(zip(*limits, strict=True)):
            there = stroke[(stroke >= low) & (stroke <= high)]
            for repeat in range(self.repeats):
                passes += [(there, level, repeat, False), (there[::-1], level, repeat, True)]
        counts = [len(one[0]) for one in passes]
        stretching = np.repeat([one[3] for one in passes], counts)
        travel = np.where(stretching, self.step, -self.step)
        travel[np.cumsum([0, *counts[:-1]])] = 0.0
        taken = np.abs(travel) / self.speed + self.dwell + self.acquisition
        return Plateaus(
            level=np.repeat([one[1] for one in passes], counts),
            repeat=np.repeat([one[2] for one in passes], counts),
            stretching=stretching,
            contraction=np.concatenate([one[0] for one in passes]),
            travel=travel,
            time=np.cumsum(taken) - self.acquisition,
        )


def away_from_turns(dataset: IsobaricDataset, *, travel: float = 2 * mm) -> IsobaricDataset:
    """Points of a dataset at least a travel [m] away from both ends of their stroke, in both directions.

    A law fitted to both directions lies between their frictions. Just after a reversal the friction still has its
    previous sign, which biases the fit; the points of the other direction are left out too, for balance.

    Raises
    ------
    RangeError
        If directions or the initial length are not known, or no point is left.
    """
    table = dataset.table
    if "direction" not in table or "initial_length" not in table.attrs:
        raise RangeError(
            "reversals are known only for a dataset with directions and an initial length",
            remedy="give both, or keep all points",
        )
    levels, contraction = dataset.levels, dataset.contraction
    repeats = table["repeat"].to_numpy() if "repeat" in table else np.zeros(len(dataset), int)
    margin = travel / table.attrs["initial_length"] - 1e-9
    keep = np.ones(len(dataset), bool)
    for level, repeat in {*zip(levels, repeats, strict=True)}:
        stroke = (levels == level) & (repeats == repeat)
        ends = contraction[stroke].min(), contraction[stroke].max()
        keep[stroke] = (contraction[stroke] - ends[0] >= margin) & (ends[1] - contraction[stroke] >= margin)
    if not keep.any():
        raise RangeError(
            f"no point lies {travel / mm:g} mm from both ends of its stroke, which excludes all points of one pressure",
            remedy="give a shorter travel, or the nominal pressures (set_pressure) where measured ones scatter",
        )
    return dataset.select(keep)
