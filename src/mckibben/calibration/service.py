"""A calibration that follows in service what ages."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.calibration.equations import (
    OF_MUSCLE,
    RATE,
    CalibrationProblem,
    Recorded,
    is_spring,
    names_of,
    samples_of,
)
from mckibben.calibration.estimation import (
    EDGE,
    JointCalibration,
    Posterior,
    filtered_rows,
    least_errors,
    models_of,
    quantities_of,
    stiffness_of,
)
from mckibben.calibration.fitting import Floats, LocalMinimum, variance_of_samples
from mckibben.calibration.models import Moved
from mckibben.calibration.recordings import JointRecording
from mckibben.errors import IdentificationError, RangeError
from mckibben.numerics.batching import recheck
from mckibben.result import Column, Listing, TableColumns
from mckibben.scenario import StudiedScenario
from mckibben.storage.files import atomic_write
from mckibben.units import HINGE, JointType

_HEAD = """\
# The stiffness in service: mckibben rig control SCENARIO.yaml --service FILE. With `follow: false` the controller keeps
# its model, and the estimate is only told.
"""


class Service(NamedTuple):
    """Stiffness of joints, and forces of muscles, by blocks of a run in service.

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
    followed
        Whether the model follows the estimate after each block, shape (blocks,).
    reasons
        Why it does not, or "".
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
    followed: NDArray[np.bool_]
    reasons: tuple[str, ...]
    names: tuple[tuple[str, ...], tuple[str, ...]]
    joint_type: JointType = HINGE

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the measurements tell more of the stiffness than what is known without them."""
        return is_known(self.deviation, self.unobserved)

    def verdict(self) -> str:
        """Stiffness and forces at the end, with 95 % intervals."""
        if not self.times.size:
            return "in service: too short for an estimate"
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
        columns["followed"] = Column(), self.followed.tolist()
        columns["because"] = Column(), list(self.reasons)
        for i, name in enumerate(self.names[1]):
            columns[f"{name}.force"] = Column(digits=3), self.forces[:, i]
            columns[f"{name}.force deviation"] = Column(digits=2), self.force_deviations[:, i]
        return Listing("in service", columns)


def is_known(deviation: Floats, unobserved: Floats) -> NDArray[np.bool_]:
    """Whether a deviation is that of less than half of the variance without measurements."""
    return 2 * deviation**2 < unobserved**2


class Follower:
    """Recursive estimate of a calibrated model, fed with samples of a run as they come.

    Parameters
    ----------
    posterior
        The calibration.
    block, forgetting
        Time between two estimates [s], and time constant with which measurements are forgotten [s].
    limit
        Most change of a muscle's force since the calibration that the model follows, relative.
    memory
        Duration of the samples from which friction and creep along the path follow [s].

    Attributes
    ----------
    z
        Parameters of the model that a controller should have: those of the last block that tells the stiffness.
    """

    def __init__(
        self,
        posterior: Posterior,
        *,
        block: float = 2.0,
        forgetting: float = 15.0,
        limit: float = 0.25,
        memory: float = 40.0,
    ) -> None:
        self._posterior, self._block, self._limit, self._memory = posterior, block, limit, memory
        problem = posterior.problem
        keep = math.exp(-block / forgetting)
        self._recursion = Recursion(posterior.minimum, ageing(problem), len(problem.model.joint_names), keep)
        self._unobserved, self.z = self._recursion.estimate, posterior.minimum.z
        self.names = problem.model.joint_names, followed_muscles(problem.model)
        self._calibrated = self._forces(posterior.minimum)[0]
        self._samples: tuple[Floats, Floats, Floats] | None = None
        self._rows: list[PyTree] = []
        self._margin = EDGE / RATE + 0.05  # s that the filters need after a block
        self._done = 0.0

    def add(self, time: Floats, angle: Floats, pressures: Floats) -> bool:
        """Take samples, as of a recording without a weight, and return whether they end a block."""
        if self._samples is None:
            self._samples, self._done = (time, angle, pressures), float(time[0])
        else:
            pairs = zip(self._samples, (time, angle, pressures), strict=True)
            before, after, both = (np.concatenate(pair) for pair in pairs)
            self._samples = before, after, both
        blocks = len(self._rows)
        while self._samples[0][-1] >= (end := self._done + self._block + self._margin):
            recent = (self._samples[0] > end - self._memory) & (self._samples[0] <= end)
            self._estimate(*(column[recent] for column in self._samples))
        kept = self._samples[0] > self._samples[0][-1] - self._memory - self._block
        first, second, third = (column[kept] for column in self._samples)
        self._samples = first, second, third
        return len(self._rows) > blocks

    def _estimate(self, time: Floats, angle: Floats, pressures: Floats) -> None:
        """Estimate by the block that begins where the last one ended."""
        problem, begin, block = self._posterior.problem, self._done, self._block
        estimate, reason, self._done = self._recursion.estimate, "", begin + block
        groups = len(self.names[0])
        errors, slopes, least = np.zeros((0, groups)), np.zeros((0, groups, problem.size)), np.zeros(groups)
        try:
            recorded = samples_of(problem.model, JointRecording(time, angle, pressures, tube=self._posterior.tube))
            first = round((begin - float(time[0])) * RATE) - EDGE
            if first < recorded.begin:
                raise IdentificationError("the joint has not moved enough yet")
            around = slice(first, first + round(block * RATE) + 2 * EDGE)
            samples = type(recorded.samples)(*(column[around] for column in recorded.samples))
            part = [Recorded(samples, recorded.weight, 0)]
            errors, slopes = filtered_rows(problem, estimate.z, part)
            least = least_errors(problem, part)
        except IdentificationError as error:
            reason = error.message
        estimate = self._recursion.update(errors, slopes, least)
        inside = (time > begin) & (time <= self._done)
        apart = max(inside.sum() // 10, 1)
        at = angle[inside][::apart].T, tuple(pressures[inside][::apart].T)
        means, joints = [], len(self.names[0])
        for value, deviation in (stiffness_of(problem, each, *at) for each in (estimate, self._unobserved)):
            means.append(value.reshape(-1, joints).mean(axis=0))
            means.append(np.sqrt(np.mean(deviation.reshape(-1, joints) ** 2, axis=0)))
        forces, deviations = self._forces(estimate)
        reason = reason or self._refused(estimate, forces, is_known(means[1], means[3]))
        if not reason:
            self.z = estimate.z
        self._rows.append((self._done, *means, forces, deviations, not reason, reason))

    def _refused(self, estimate: LocalMinimum, forces: Floats, known: NDArray[np.bool_]) -> str:
        """Why the model does not follow an estimate, or ""."""
        if not known.all():
            return "the motion tells too little"
        if np.any(np.abs(forces / self._calibrated - 1) > self._limit):
            return f"a muscle's force changed by more than {self._limit:.0%}"
        try:
            recheck(model_at(self._posterior.problem, estimate.z))
        except RangeError as error:
            return error.message
        return ""

    def _forces(self, estimate: LocalMinimum) -> tuple[Floats, Floats]:
        """Forces of the muscles relative to the model before the calibration, and their deviations."""
        quantities = quantities_of(self._posterior.problem, estimate)
        forces = [quantities[f"{name}.force"] for name in self.names[1]]
        return np.array([force.value for force in forces]), np.array([force.deviation for force in forces])

    def result(self) -> Service:
        """Return all blocks."""
        joints, muscles, rows = len(self.names[0]), len(self.names[1]), self._rows
        widths = 1, joints, joints, joints, joints, muscles, muscles
        times, *numbers = (np.reshape([row[i] for row in rows], (-1, width)) for i, width in enumerate(widths))
        stiffness, deviation, calibrated, unobserved, forces, deviations = numbers
        return Service(
            times[:, 0],
            stiffness,
            deviation,
            calibrated,
            unobserved,
            forces,
            deviations,
            followed=np.array([row[-2] for row in rows], bool),
            reasons=tuple(row[-1] for row in rows),
            names=self.names,
            joint_type=self._posterior.problem.model.joint_type,
        )


def follow(fit: JointCalibration, recording: JointRecording, **settings: float) -> Service:
    """Return the stiffness along a recording in service, while strengths, friction, creep and damping may change.

    Settings are those of `Follower`.
    """
    follower = Follower(fit.posterior, **settings)
    follower.add(recording.time, recording.angle, recording.pressures)
    return follower.result()


def model_at(problem: CalibrationProblem, z: Floats) -> Moved:
    """The model at parameters, as numbers."""
    return jax.tree.map(np.ndarray.item, models_of(problem, z[:, None]))


def write_posterior(scenario: StudiedScenario, posterior: Posterior, path: Path) -> None:
    """Write a calibration, with the scenario before it, for runs in service."""
    problem, minimum = posterior.problem, posterior.minimum
    text = {
        "scenario": scenario.dumps(folder=path.parent),
        "scales": [list(scales) for scales in problem.scales],
        "muscles": problem.muscles,
        "others": list(problem.others),
        "z": minimum.z.tolist(),
        "covariance": minimum.covariance.tolist(),
        "tube": posterior.tube,
    }
    with atomic_write(path, overwrite=True) as file:
        file.write_text(json.dumps(text), encoding="utf-8")


def write_settings(path: Path) -> None:
    """Write the settings of the estimate next to it."""
    with atomic_write(path, overwrite=True) as file:
        text = "estimate: estimate.json\nfollow: true\nlimit: 25 %\nblock: 2 s\nforgetting: 15 s\n"
        file.write_text(_HEAD + text, encoding="utf-8")


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


class Recursion:
    """Gaussian estimate of all parameters, block by block, of which measurements since the calibration are forgotten.

    The calibration, widened by what ages, is not. The rule of the calibration holds for the samples that are
    remembered: all count as as many independent ones as the parameters that they determine.
    """

    def __init__(self, calibrated: LocalMinimum, aged: Floats, groups: int, keep: float) -> None:
        self.calibrated, self.keep = calibrated, keep
        self.precision: Floats = np.linalg.inv(calibrated.covariance + aged).astype(np.float64)
        self.estimate = LocalMinimum(calibrated.z, calibrated.covariance + aged)
        size = len(calibrated.z)
        self.information, self.pull = np.zeros((groups, size, size)), np.zeros((groups, size))
        self.squares, self.least, self.samples = np.zeros(groups), np.zeros(groups), 0.0

    def update(self, errors: Floats, slopes: Floats, least: Floats) -> LocalMinimum:
        """Estimate after a block of filtered errors, shape (samples, groups), linearised at the estimate before.

        The error of the model is that of the estimates before each block in it, and at least `least` [N*m].
        """
        keep, targets = self.keep, slopes @ self.estimate.z - errors
        if not self.samples + len(errors):
            return self.estimate
        self.information = keep * self.information + np.einsum("sgi,sgj->gij", slopes, slopes)
        self.pull = keep * self.pull + np.einsum("sgi,sg->gi", slopes, targets)
        if len(errors):  # the number of samples fades only as others come, so that at rest the information fades
            self.squares = keep * self.squares + np.square(errors).sum(axis=0)
            self.least = keep * self.least + len(errors) * least**2
            self.samples = keep * self.samples + len(errors)
        square = np.maximum(self.squares, self.least) / self.samples
        variance = variance_of_samples(self.information, self.samples, square, square, self.precision)
        covariance = np.linalg.inv(self.precision + (self.information / variance[:, None, None]).sum(axis=0))
        pulled = self.precision @ self.calibrated.z + (self.pull / variance[:, None]).sum(axis=0)
        self.estimate = LocalMinimum(covariance @ pulled, covariance.astype(np.float64))
        return self.estimate
