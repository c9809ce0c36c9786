"""What an identification of creep found: the arm, how sure it is, and what it adds to each measured point."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.fit import DatasetSummary
from mckibben.identification.relaxation import Arm, Courses, Moves
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.units import percent, show


@dataclass(frozen=True, eq=False)
class CreepFit:
    """Creep seen in the samples of plateaus, or that there is none to be seen; `identify_creep` makes it.

    Attributes
    ----------
    creep
        One arm; `NoCreep` where the data show none.
    significance
        How many standard errors the force drifts back within a plateau, against the direction of the move before it;
        creep is seen from 3 on. Negative: it goes on in that direction.
    rate, rate_error
        How fast it does so on average, and the standard error of that [N/s].
    standard_errors
        Of ``stiffness`` [N/m] and ``time_constant`` [s]; NaN where the data do not determine them. They allow for
        noise that is correlated within a plateau.
    correlation
        Of the two errors; NaN where they are.
    between
        The interval of 95 % of the time constant by its profile [s]; 0 or infinity where the data set no end.
    strength
        The arm's stiffness per that of the muscle itself, the median over the moves [-].
    relaxing
        Shape (points,), in the order of the dataset: the force in the arm at the first sample [N].
    mean
        Shape (points,): its mean over the samples, which is what creep has added to a plateau mean [N].
    common_rate
        A drift within plateaus that is the same in both directions, as of a sensor [N/s].
    interval
        Between two samples [s].
    points_used
        How many plateaus the fit rests on.
    warnings
        Sentences: what a reader should know before trusting the numbers.
    dataset
        Which data.
    """

    creep: MaxwellCreep | NoCreep
    significance: float
    rate: float
    rate_error: float
    standard_errors: dict[str, float]
    correlation: float
    between: tuple[float, float]
    strength: float
    relaxing: NDArray[np.float64] = field(repr=False)
    mean: NDArray[np.float64] = field(repr=False)
    common_rate: float
    interval: float
    points_used: int
    warnings: tuple[str, ...]
    dataset: DatasetSummary

    @property
    def seen(self) -> bool:
        """Whether the data show creep."""
        return isinstance(self.creep, MaxwellCreep)

    def course(self, times: ArrayLike) -> NDArray[np.float64]:
        """The force of creep [N] at each point, so many seconds after its first sample; shape (points, times)."""
        times = np.asarray(times, np.float64)
        if isinstance(self.creep, NoCreep):
            return np.zeros((len(self.relaxing), len(times)))
        return self.relaxing[:, None] * np.exp(-times / self.creep.time_constant)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """The plateau means of the dataset that this was identified from, without creep.

        Raises
        ------
        IdentificationError
            If it has another number of points.
        """
        means = dataset.plateau_means()
        if len(means) != len(self.mean):
            raise IdentificationError(
                f"{means!r} is not the dataset that the creep was identified from", remedy="give the same, whole"
            )
        return IsobaricDataset(means.table.assign(force=("point", means.force - self.mean)))

    def report(self) -> str:
        """The fit as text."""
        head = f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} plateaus used"
        drift = (
            f"within a plateau the force goes back by {self.rate:.3g} N/s (standard error {self.rate_error:.2g}), "
            f"{self.significance:.1f} standard errors"
        )
        lines = [head, drift]
        if isinstance(self.creep, MaxwellCreep):
            creep, errors = self.creep, self.standard_errors
            lines += [
                "",
                f"{'':13}  {'estimate':>8}  {'error':>7}",
                f"{'stiffness':13}  {creep.stiffness / 1e3:>8.4g}  {errors['stiffness'] / 1e3:>7.2g}  N/mm, "
                f"{self.strength / percent:.2g} % of the muscle's own",
                f"{'time constant':13}  {creep.time_constant:>8.4g}  {errors['time_constant']:>7.2g}  s, "
                f"95 %: {self.between[0]:.3g} to {self.between[1]:.3g} s",
                f"largest at a first sample: {show(float(np.abs(self.relaxing).max(initial=0.0)), 'N', 3)}",
            ]
        else:
            lines.append("no creep seen")
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


_SEEN = 3.0  # standard errors
_FEWEST = 3  # samples that have a course
_PLATEAUS = 10  # on each side
_PART = 0.25  # of the force: where more than that relaxes, the arm may have slipped
_ROUNDS = 2
_WIDE = 2.5  # from one end of the interval of a time constant to the other: a wider one says that it is not determined
_QUICK, _SLOW = 0.1, 3.0  # time constants looked for: from so much of the wait on, up to so much of the longest way
_REGULATOR = 0.2  # of the force's drift: what more of it the pressure's explains is said


def identify_creep(dataset: IsobaricDataset, *, interval: float, dwell: float, speed: float) -> CreepFit:
    r"""Look for creep in the samples of plateaus: a Maxwell arm beside a law that need not be known.

    Whether there is any, the mean slopes of the force within plateaus tell, after stretching against after shortening:
    creep goes back, friction and law stand still, a sensor drifts the same way after both. Where there is, the arm is
    drawn along the whole course of the test, and its two numbers are those for which the samples of a plateau, less
    their mean, differ least from

    .. math:: x_j e^{-t/\tau} + v t, \qquad x_j = e^{-t_\mathrm{dwell}/\tau} k\, g_j(\tau)

    with a rate v in common. The stretch :math:`g_j` that the arm still holds after the move to a plateau follows from
    all moves before it at that pressure, before which it is taken for relaxed; so a time constant beyond the time
    at a plateau is known as well, if a stroke takes long enough. A slack muscle holds none.

    Parameters
    ----------
    dataset
        With raw samples of the force, directions and the initial length; the nominal pressure where measured ones
        scatter. Its rows are in the order of the test, or it has times, those of the first samples.
    interval
        Between two samples [s].
    dwell
        From the end of a move to the first sample [s].
    speed
        Of the moves [m/s].

    Raises
    ------
    IdentificationError
        If there are no samples, or too few plateaus, or one direction alone, or times that do not suit the speed.
    RangeError
        If one of the numbers makes no sense.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import MaxwellCreep, Muscle
    >>> from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
    >>> from mckibben.units import bar
    >>> law = catalog.law("lei-mas-10-180n")
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law, creep=MaxwellCreep(1000.0, 8.0))
    >>> test = IsobaricProtocol(pressures=[3 * bar, 5 * bar], repeats=2, samples=100, acquisition=5.0)
    >>> data = SimulatedIsobaricTest(muscle, force_noise=0.05).run(test, seed=1)
    >>> found = identify_creep(data, interval=0.05, dwell=test.dwell, speed=test.speed)
    >>> round(found.creep.stiffness, -2), round(found.creep.time_constant, 0)
    (1000.0, 8.0)
    """
    for name, value, unit in (("interval", interval, "s"), ("dwell", dwell, "s"), ("speed", speed, "m/s")):
        if not (math.isfinite(value) and (value > 0 or (name == "dwell" and value == 0))):
            raise RangeError(f"{name} is {value:g} {unit}", value=value, unit=unit, remedy="give a positive number")
    force = _samples(dataset)
    means = dataset.plateau_means()
    moves = Moves.of(means, dwell, speed, interval * force.shape[1])
    arm = Arm(Courses.of(force, interval), moves)
    taut = ~means.slack & (means.force > 0)
    rate, error, common = _drift(arm.courses.slopes, moves, taut)
    warnings = _pressure_warning(dataset, interval, moves, taut, rate, means)
    found = CreepFit(
        creep=NoCreep(),
        significance=rate / error,
        rate=rate,
        rate_error=error,
        standard_errors={"stiffness": math.nan, "time_constant": math.nan},
        correlation=math.nan,
        between=(math.nan, math.nan),
        strength=0.0,
        relaxing=np.zeros(len(means)),
        mean=np.zeros(len(means)),
        common_rate=common,
        interval=interval,
        points_used=int(taut.sum()),
        warnings=tuple(warnings),
        dataset=_summary(means, taut),
    )
    span = dwell + arm.courses.duration
    if found.significance < _SEEN:
        return dataclasses.replace(found, warnings=(*warnings, *_unseen(arm, taut, found, span, dwell)))

    ends = max(0.01, _QUICK * dwell, 3 * interval), max(_SLOW * moves.longest, 10 * span)
    used, tau = taut, arm.time_constant(taut, *ends)
    for _ in range(_ROUNDS):  # without the points at which so much relaxes that the arm may have slipped
        held = np.abs(arm.numbers(tau, used)[0] * moves.held(tau))
        within = taut & (held < _PART * means.force)
        if within.sum() < taut.sum() / 2:  # then the arm is a guess, as where its time constant is not determined
            break
        _check_sides(moves, within)
        used = within
        tau = arm.time_constant(used, *ends)
    stiffness, common = arm.numbers(tau, used)
    if not stiffness > 0:
        raise IdentificationError(
            "the force drifts as with creep, but not along the course of the test",
            remedy="look at dwell, speed and the order of the rows",
        )
    errors, correlation, excess = arm.uncertainty(tau, used)
    between = arm.between(tau, used, *ends, excess)
    if not between[1] < _WIDE * between[0]:
        warnings.append(_undetermined(between, stiffness / tau, span, dwell))
        errors, correlation = dict.fromkeys(errors, math.nan), math.nan
    bound = np.maximum(means.force, 0.0) / 2
    relaxing = np.where(taut, np.clip(stiffness * moves.held(tau), -bound, bound), 0.0)
    return dataclasses.replace(
        found,
        creep=MaxwellCreep(stiffness, tau),
        standard_errors=errors,
        correlation=correlation,
        between=between,
        strength=stiffness / moves.stiffness(means, used),
        relaxing=relaxing,
        mean=relaxing * np.exp(-arm.courses.times / tau).mean(),
        common_rate=common,
        points_used=int(used.sum()),
        warnings=tuple(warnings),
        dataset=_summary(means, used),
    )


def _samples(dataset: IsobaricDataset) -> NDArray:
    if "force_samples" not in dataset.table or dataset.table.sizes["sample"] < _FEWEST:
        raise IdentificationError(
            "the dataset has no raw samples of the force: plateau means do not show what moves within a plateau",
            remedy=f"keep at least {_FEWEST} samples a plateau (NetCDF keeps them, CSV does not)",
        )
    return dataset.table["force_samples"].to_numpy()


def _check_sides(moves: Moves, used: NDArray[np.bool_]) -> None:
    for side, word in ((1, "stretching"), (-1, "shortening")):
        count = int(np.count_nonzero(used & (moves.sides == side)))
        if count < _PLATEAUS:
            raise IdentificationError(
                f"{count} taut plateaus follow a move by {word}",
                value=count,
                lower=_PLATEAUS,
                remedy=f"measure at least {_PLATEAUS} in each direction",
            )


def _drift(slopes: NDArray[np.float64], moves: Moves, used: NDArray[np.bool_]) -> tuple[float, float, float]:
    """How fast the force goes back after a move, the standard error of that, and what is the same in both [N/s]."""
    _check_sides(moves, used)
    up, down = (slopes[used & (moves.sides == side)] for side in (1, -1))
    rate = float(down.mean() - up.mean()) / 2
    error = math.sqrt(up.var(ddof=1) / len(up) + down.var(ddof=1) / len(down)) / 2
    return rate, max(error, 1e-300), float(down.mean() + up.mean()) / 2


def _unseen(arm: Arm, used: NDArray[np.bool_], found: CreepFit, span: float, dwell: float) -> list[str]:
    """What to say where there is no creep to be seen."""
    bound = arm.numbers(span, used)[0] + _SEEN * arm.stiffness_error(span, used)
    onwards = (
        f"the force goes on in the direction of the move ({-found.rate:.2g} N/s): no relaxation does that; look at the "
        "pressure regulator, and at when samples begin"
    )
    hidden = (
        f"an arm of {span:.3g} s would show from {bound / 1e3:.2g} N/mm on; quicker ones are over before the first "
        f"sample ({dwell:g} s), slower ones hardly move within {arm.courses.duration:.3g} s"
    )
    return [onwards, hidden] if found.significance < -_SEEN else [hidden]


def _undetermined(between: tuple[float, float], ratio: float, span: float, dwell: float) -> str:
    """What to say of a time constant that the data leave open."""
    low, high = between
    if high == math.inf:
        return (
            f"the time constant is not determined: anything from {low:.3g} s on would do, a plateau of {span:.3g} s is "
            f"too short to tell; what is known is stiffness per time constant, {ratio / 1e3:.3g} N/mm/s"
        )
    if low == 0:
        return (
            f"the time constant is not determined: anything up to {high:.3g} s would do, the wait of {dwell:g} s "
            "before the first sample is too long to tell; sample sooner"
        )
    return (
        f"the time constant is not determined: anything from {low:.3g} to {high:.3g} s would do; sample for longer "
        f"than {span - dwell:.3g} s, sooner after a move, or more plateaus"
    )


def _pressure_warning(
    dataset: IsobaricDataset,
    interval: float,
    moves: Moves,
    used: NDArray[np.bool_],
    rate: float,
    means: IsobaricDataset,
) -> list[str]:
    """What to say where the pressure drifts within plateaus as well, after one direction other than after the other."""
    if "pressure_samples" not in dataset.table:
        return ["without samples of the pressure, a regulator that follows slowly cannot be told from creep"]
    slopes = Courses.of(dataset.table["pressure_samples"].to_numpy(), interval).slopes
    back, error, _ = _drift(slopes, moves, used)
    pressed = used & (means.pressure > 0)
    equivalent = back * float(np.median(means.force[pressed] / means.pressure[pressed])) if pressed.any() else 0.0
    if abs(back) < _SEEN * error or abs(equivalent) < _REGULATOR * abs(rate):
        return []
    return [
        f"the pressure drifts too, by {back:.3g} Pa/s against the direction of the move, which is worth some "
        f"{equivalent:.2g} N/s of the {rate:.2g} N/s: that part is the regulator's, not creep"
    ]


def _summary(means: IsobaricDataset, used: NDArray[np.bool_]) -> DatasetSummary:
    attributes = means.table.attrs
    pressures = tuple(means.select(used).pressures.tolist())
    return DatasetSummary(str(attributes["specimen"]), str(attributes["source"]), pressures)
