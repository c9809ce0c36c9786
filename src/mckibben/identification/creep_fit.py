"""What an identification of creep found: the arm, how sure it is, and what it adds to each measured point."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.fit import DatasetSummary
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
