"""A calibration that follows in service what ages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.calibration.equations import OF_MUSCLE, RATE, CalibrationProblem, Recorded, is_spring, names_of
from mckibben.calibration.fitting import Floats, LocalMinimum, variance_of_samples
from mckibben.calibration.models import Moved
from mckibben.result import Column, Listing, TableColumns
from mckibben.units import HINGE, JointType


class Service(NamedTuple):
    """Stiffness of joints, and forces of muscles, by blocks of a recording in service.

    Attributes
    ----------
    times
        End of each block [s], shape (blocks,).
    stiffness, deviation
        Mean isobaric stiffness along each block, and its standard deviation [N*m/rad], shape (blocks, joints).
    calibrated, unobserved
        The mean by the calibration, and the deviation if nothing had been measured since, likewise.
    forces, force_deviations
        Forces of the muscles, but of no spring, relative to the model, see `JointCalibration`, shape (blocks, muscles).
    names
        Names of joints, and of these muscles.
    joint_type
        How the joints move; of a slide, stiffness is in N/m.
    """

    times: Floats
    stiffness: Floats
    deviation: Floats
    calibrated: Floats
    unobserved: Floats
    forces: Floats
    force_deviations: Floats
    names: tuple[tuple[str, ...], tuple[str, ...]]
    joint_type: JointType = HINGE

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the recording tells more of the stiffness than what is known without it."""
        return 2 * self.deviation**2 < self.unobserved**2

    def verdict(self) -> str:
        """Stiffness and forces at the end, with 95 % intervals."""
        texts, size, unit = [], self.joint_type.size("N*m/rad"), self.joint_type.shown("N*m/rad")
        for i, joint in enumerate(self.names[0]):
            columns = self.stiffness, self.deviation, self.calibrated
            value, deviation, before = (column[-1, i] / size for column in columns)
            text = f"{value:.3g} +- {1.96 * deviation:.2g} {unit}, {before:.3g} as calibrated"
            texts.append(f"{joint}{text if self.known[-1, i] else f'not known ({text}): move it for 20 s'}")
        for name, force, deviation in zip(self.names[1], self.forces[-1], self.force_deviations[-1], strict=True):
            texts.append(f"{name}.force {force:.3g} +- {1.96 * deviation:.2g}")
        return f"in service at {self.times[-1]:.3g} s: {', '.join(texts)}"

    def listing(self) -> Listing:
        """Table over time."""
        columns: TableColumns = {"time": (Column("s", digits=3), self.times)}
        stiffness, deviation = (Column("N*m/rad", digits=digits) for digits in (3, 2))
        for i, joint in enumerate(self.names[0]):
            columns[f"{joint}stiffness"] = stiffness, self.stiffness[:, i]
            columns[f"{joint}deviation"] = deviation, self.deviation[:, i]
            columns[f"{joint}as calibrated"] = stiffness, self.calibrated[:, i]
            columns[f"{joint}known"] = Column(), self.known[:, i].tolist()
        for i, name in enumerate(self.names[1]):
            columns[f"{name}.force"] = Column(digits=3), self.forces[:, i]
            columns[f"{name}.force deviation"] = Column(digits=2), self.force_deviations[:, i]
        return Listing("in service", columns)


def ageing(problem: CalibrationProblem, *, strength: float = 0.1, others: float = 0.5) -> Floats:
    """Return the covariance of what changes after a calibration, in prior deviations.

    Each muscle's force as a whole by a factor of a `strength`, and friction, creep and damping, by `others` of their
    prior deviations; arms, zeros, masses and shapes of the laws stay.
    """
    covariance = np.zeros((problem.size, problem.size))
    damping = OF_MUSCLE * len(problem.scales) + np.array(
        [i for i, name in enumerate(names_of(problem.model)) if name.endswith("damping")]
    )
    covariance[damping, damping] = others**2
    for i, muscle in enumerate(problem.model.muscles):
        if is_spring(muscle):
            continue
        weaker, muscle_block = strength * problem.as_correction(i), i * OF_MUSCLE + np.arange(OF_MUSCLE)
        law, memory = np.split(muscle_block, [weaker.size])
        covariance[np.ix_(law, law)] = np.outer(weaker, weaker)
        covariance[memory, memory] = others**2
    return covariance


def followed_muscles(model: Moved) -> tuple[str, ...]:
    """Names of the muscles that are no springs."""
    return tuple(name for name, muscle in zip(model.muscle_names, model.muscles, strict=True) if not is_spring(muscle))


def blocks_of(recorded: Recorded, duration: float, edge: int) -> Iterator[tuple[slice, Recorded]]:
    """Yield samples of blocks of a duration [s], and the blocks with the edges of the filter on either side."""
    samples, length = recorded.samples, round(duration * RATE)
    for begin in range(recorded.begin + edge, len(samples.angle) - length - edge + 1, length):
        around = slice(begin - edge, begin + length + edge)
        part = type(samples)(*(column[around] for column in samples))
        yield slice(begin, begin + length), Recorded(part, recorded.weight, 0)


class Recursion:
    """Gaussian estimate of all parameters, block by block, of which measurements since the calibration are forgotten.

    The calibration, widened by what ages, is not. The rule of the calibration holds for the samples that are
    remembered: all count as as many independent ones as the parameters that they determine.
    """

    def __init__(self, calibrated: LocalMinimum, aged: Floats, least: Floats, keep: float) -> None:
        self.calibrated, self.least, self.keep = calibrated, least, keep
        self.precision: Floats = np.linalg.inv(calibrated.covariance + aged).astype(np.float64)
        self.estimate = LocalMinimum(calibrated.z, calibrated.covariance + aged)
        size = len(calibrated.z)
        self.information, self.pull = np.zeros((least.size, size, size)), np.zeros((least.size, size))
        self.squares, self.samples = np.zeros(least.size), 0.0

    def update(self, errors: Floats, slopes: Floats) -> LocalMinimum:
        """Estimate after a block of filtered errors, shape (samples, groups), linearised at the estimate before.

        The error of the model is that of the estimates before each block in it.
        """
        keep, targets = self.keep, slopes @ self.estimate.z - errors
        self.information = keep * self.information + np.einsum("sgi,sgj->gij", slopes, slopes)
        self.pull = keep * self.pull + np.einsum("sgi,sg->gi", slopes, targets)
        self.squares = keep * self.squares + np.square(errors).sum(axis=0)
        self.samples = keep * self.samples + len(errors)
        square = np.maximum(self.squares / self.samples, self.least**2)
        variance = variance_of_samples(self.information, self.samples, square, square, self.precision)
        covariance = np.linalg.inv(self.precision + (self.information / variance[:, None, None]).sum(axis=0))
        pulled = self.precision @ self.calibrated.z + (self.pull / variance[:, None]).sum(axis=0)
        self.estimate = LocalMinimum(covariance @ pulled, covariance.astype(np.float64))
        return self.estimate
