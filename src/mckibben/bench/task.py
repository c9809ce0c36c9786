"""Tasks of the benchmark: training data that a submission sees, and test data that only the score sees."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import IdentificationError, ParameterError

Floats = NDArray[np.float64]
Predict = Callable[[Floats], ArrayLike]
"""Outputs, shape (samples,), from the inputs of one block, shape (samples, inputs), in SI units."""

_FORCE = (("contraction", "1"), ("pressure", "Pa")), ("force", "N")
KINDS: dict[str, tuple[tuple[tuple[str, str], ...], tuple[str, str]]] = {
    "map": _FORCE,
    "hysteresis": _FORCE,
    "isometric": _FORCE,
    "transfer": ((*_FORCE[0], ("specimen", "1")), _FORCE[1]),
    "joint": ((("command1", "Pa"), ("command2", "Pa")), ("angle", "rad")),
}
"""Inputs and output of each kind of task, with units; specimens are numbers, and the last block has the new one."""

_FEWEST_BLOCKS = 3  # of an interval
_RESAMPLED = 2000  # sets of blocks
_COVERAGE = 95.0  # percent
_DIGITS = 9  # of the inputs in a digest


class DataBlock(NamedTuple):
    """One block of a data set, or one recording: its name, inputs (samples, inputs) and outputs (samples,), in SI."""

    name: str
    inputs: Floats
    output: Floats

    @classmethod
    def of(cls, name: str, inputs: ArrayLike, output: ArrayLike) -> Self:
        """Return a block with read-only copies; raises a `ParameterError` if shapes or numbers are wrong."""
        given, wanted = np.array(inputs, float), np.array(output, float)
        if given.ndim != 2 or wanted.shape != given.shape[:1] or not wanted.size:
            message = f"the block {name!r} has inputs of shape {given.shape} and outputs of shape {wanted.shape}"
            remedy = "give inputs of shape (samples, inputs) and outputs of shape (samples,)"
            raise ParameterError(message, field=name, remedy=remedy)
        if not (np.isfinite(given).all() and np.isfinite(wanted).all()):
            raise ParameterError(f"the block {name!r} has values that are not finite", field=name, remedy="remove them")
        given.flags.writeable = wanted.flags.writeable = False
        return cls(name, given, wanted)


@dataclass(frozen=True)
class Training:
    """Data for a submission: training blocks and facts about the setup, in SI units.

    Attributes
    ----------
    name, kind
        Name of the task, and one of "map", "hysteresis", "isometric", "joint", "transfer".
    blocks
        Blocks of measured inputs and outputs.
    period
        Time between the samples of a block [s]; None if their order has no meaning.
    facts
        Numbers about the setup that a laboratory knows, such as "initial_length" [m].
    """

    name: str
    kind: str
    blocks: tuple[DataBlock, ...] = field(repr=False)
    period: float | None = None
    facts: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ParameterError(
                f"{self.kind!r} is not a kind of task", value=self.kind, remedy=f"use one of {', '.join(KINDS)}"
            )
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))

    def fact(self, name: str) -> float:
        """Return a fact; raises an `IdentificationError` if it is not given."""
        if name not in self.facts:
            raise IdentificationError(f"the task has no fact {name}", field=name, remedy="add it to the facts")
        return self.facts[name]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns of the inputs."""
        return tuple(name for name, _ in KINDS[self.kind][0])

    @property
    def stacked(self) -> tuple[Floats, Floats]:
        """Inputs and outputs of all blocks, shapes (samples, inputs) and (samples,)."""
        return np.concatenate([one.inputs for one in self.blocks]), np.concatenate([one.output for one in self.blocks])


class ScoreInterval(NamedTuple):
    """A value, and the ends of its 95 % bootstrap interval; NaN for fewer than three test blocks."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class TaskScore:
    """Errors of one submission in one task.

    Attributes
    ----------
    squares
        Mean square error of each test block.
    sizes
        Number of samples of each test block.
    scale
        Standard deviation of the measured outputs of all test blocks.
    blocks
        Names of the test blocks.
    """

    squares: Floats
    sizes: NDArray[np.int64]
    scale: float
    blocks: tuple[str, ...]

    @property
    def nrmse(self) -> ScoreInterval:
        """Root mean square error relative to `scale`; the interval resamples test blocks."""
        return self._interval(lambda chosen: np.sqrt(self._mean(chosen)) / self.scale)

    def relative_to(self, other: TaskScore) -> ScoreInterval:
        """RMSE relative to that of another submission; the interval resamples test blocks, the same for both."""

        def ratio(chosen: NDArray[np.int64]) -> Floats:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.sqrt(self._mean(chosen) / other._mean(chosen))

        return self._interval(ratio)

    def by_block(self) -> dict[str, float]:
        """RMSE of each test block, relative to the scale of all."""
        return dict(zip(self.blocks, (np.sqrt(self.squares) / self.scale).tolist(), strict=True))

    def _mean(self, chosen: NDArray[np.int64]) -> Floats:
        weights = self.sizes[chosen]
        return (weights * self.squares[chosen]).sum(axis=-1) / weights.sum(axis=-1)

    def _interval(self, statistic: Callable[[NDArray[np.int64]], Floats]) -> ScoreInterval:
        count = len(self.sizes)
        if count < _FEWEST_BLOCKS:
            return ScoreInterval(float(statistic(np.arange(count))), np.nan, np.nan)
        chosen = np.random.default_rng(0).integers(count, size=(_RESAMPLED, count))
        rest = (100 - _COVERAGE) / 2
        lower, upper = np.percentile(statistic(chosen), (rest, 100 - rest))
        return ScoreInterval(float(statistic(np.arange(count))), float(lower), float(upper))


@dataclass(frozen=True)
class Task:
    """Training data, test blocks, and the source of both.

    A submission gets `training`, and at the test the inputs of one block at a time: it never gets a measured output.
    """

    training: Training
    tests: tuple[DataBlock, ...] = field(repr=False)
    source: str = ""

    def __post_init__(self) -> None:
        width = len(self.training.inputs)
        for what, blocks in (("training", self.training.blocks), ("test", self.tests)):
            if not blocks:
                raise ParameterError(f"{self.name} has no {what} block", remedy="give at least one")
            if wrong := [one.name for one in blocks if one.inputs.shape[1] != width]:
                raise ParameterError(
                    f"{self.name}: the {what} block {wrong[0]!r} does not have {width} inputs",
                    remedy=f"give {', '.join(self.training.inputs)}",
                )

        names = [one.name for one in self.tests]
        if len(set(names)) < len(names):
            raise ParameterError(f"{self.name}: two test blocks have one name", remedy="rename one")
        if np.ptp(np.concatenate([one.output for one in self.tests])) == 0:
            raise ParameterError(f"{self.name}: all outputs of the test are equal", remedy="add other test blocks")

    @property
    def name(self) -> str:
        """Name of the task."""
        return self.training.name

    def score(self, predictions: Mapping[str, Floats]) -> TaskScore:
        """Return the errors of predicted outputs, by name of the test block."""
        squares = [float(np.mean((predictions[one.name] - one.output) ** 2)) for one in self.tests]
        scale = float(np.concatenate([one.output for one in self.tests]).std())
        sizes = np.array([one.output.size for one in self.tests])
        return TaskScore(np.array(squares), sizes, scale, tuple(one.name for one in self.tests))

    def digest(self) -> str:
        """Return a checksum of the task: names and inputs of all blocks to 9 digits, norms of outputs to 5."""
        content = hashlib.sha256()
        for part, blocks in (("train", self.training.blocks), ("test", self.tests)):
            for one in blocks:
                content.update(f"{part} {one.name} {one.inputs.shape}\n".encode())
                content.update(" ".join(f"{value:.{_DIGITS}g}" for value in one.inputs.ravel().tolist()).encode())
                # single outputs may round to other digits on another machine; the second norm depends on their order
                norms = np.linalg.norm(one.output), np.linalg.norm(np.cumsum(one.output))
                content.update(" ".join(f"{value:.5g}" for value in norms).encode())
        return content.hexdigest()[:16]
