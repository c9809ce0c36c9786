"""Plan of a sweep: options, table of values, and identifying manifest."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from mckibben.errors import ParameterError, Problem, quoted, suggest
from mckibben.scenario import Known, Scenario, batched, known_names
from mckibben.simulation import Metrics
from mckibben.simulation.engine import CHUNK, ON_ACCELERATOR, VECTOR
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.problem import check_frequencies
from mckibben.simulation.software import software
from mckibben.storage.journal import header_differences
from mckibben.study.parameters import Distribution, SweptParameter, Table, parse_sweeps, sample, sweep_parameters
from mckibben.study.parameters.sampling import count_rows
from mckibben.study.sweep.compute import BatchTask

FORMAT, VERSION = "mckibben sweep", 5
_SAMPLES = 1024
_MIN_BATCHES = 16  # of a sweep on a CPU, as long as they fill a vector
_MAX_BLOCKS = 256
_MAX_BATCHES = 64  # per block: an interruption loses one block per thread

Sweepable = Sequence[str | SweptParameter] | Mapping[str, Distribution]
"""Parameters and their distributions: texts for `parse_sweep`, or objects."""


def manifest_differences(begun: Mapping[str, Any], now: Mapping[str, Any]) -> list[Problem]:
    """Differences between the manifests of a sweep and of its continuation."""
    found = header_differences(
        begun,
        now,
        "the sweep",
        remedy="give the same, or leave it out to use the sweep's original value, or choose another folder",
        ignore=("source", "values", "model"),
    )
    if found:
        return found
    remedy = "start again in another folder"
    if begun.get("values") != now.get("values"):
        message = "the same design gives other values here: another version of SciPy or another processor"
        found.append(Problem(message, field="over", remedy=remedy))
    if begun.get("model") != now.get("model"):
        message = "a file that it names, or the catalog, has changed since"
        found.append(Problem(message, field="scenario", remedy=remedy))
    return found


class SweepOptions(NamedTuple):
    """Options of a sweep; None if left out."""

    over: Sweepable | None = None
    design: str | None = None
    samples: int | None = None
    seed: int | None = None
    metrics: Sequence[str] | None = None
    precision: int | None = None
    block: int | None = None
    known: Known | None = None

    def completed(self, begun: Mapping[str, Any]) -> SweepOptions:
        """Options, with missing ones taken from a manifest."""
        kind = begun["design"] if self.design is None else self.design
        values = {name: begun[name] for name in self._fields if name != "samples" or kind != "grid"}
        return SweepOptions(**values | {name: value for name, value in self._asdict().items() if value is not None})


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """A sweep before it runs."""

    task: BatchTask
    swept: tuple[SweptParameter, ...]
    table: Table  # one row per run
    block: int  # rows that are computed and stored together
    manifest: dict[str, Any]  # everything that determines the numbers of the whole sweep, as JSON
    part: tuple[int, int] = (1, 1)  # of so many parts, the number of this one from 1
    first: int = 0  # row of the whole sweep with which the table begins

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        options: SweepOptions,
        *,
        folder: str = ".",
        source: str = "",
        engine: str = "auto",
        part: tuple[int, int] = (1, 1),
    ) -> SweepPlan:
        """Make and check the table; `folder` is the base of the manifest's paths, `source` the scenario's origin."""
        method = "sobol" if options.design is None else options.design
        if method == "grid" and options.samples is not None:
            message = "the points of a grid determine the number of runs"
            remedy = "leave the number of samples out, or choose another design"
            raise ParameterError(message, value=options.samples, remedy=remedy)
        swept = _swept(options.over, scenario)
        known = known_names(scenario, options.known or (), [each.name for each in swept])
        samples = _SAMPLES if options.samples is None else options.samples
        seed = 0 if options.seed is None or method == "grid" else options.seed
        rows = count_rows(swept, method, samples)
        batch_size, block = _sizes(rows, options.block, engine)
        piece = _rows_of_part(part, rows, block)
        table = sample(swept, method, samples, seed, piece)  # type: ignore[arg-type]  # checks the method itself
        first = sample(swept, method, samples, seed, slice(0, 1))  # type: ignore[arg-type]
        many = batched(scenario, table)  # find invalid combinations before the computation
        check_frequencies(many.reference(), scenario.control_period)
        task = BatchTask(
            scenario, parse_metrics(options.metrics), _precision(options.precision), batch_size, software(engine), known
        )
        manifest = {
            "format": FORMAT,
            "version": VERSION,
            "scenario": scenario.dumps(folder=folder),
            "source": _plain(Path(source).name if Path(source).is_absolute() else source),
            "over": [each.text for each in swept],
            "known": list(known),
            "design": method,
            "samples": rows,
            "seed": seed,
            "metrics": list(task.metrics),
            "precision": task.precision,
            "block": block,
            "batch_size": batch_size,
            "software": task.software,
            "first": {name: column[0].item() for name, column in first.items()},
            "model": digest_of_model(scenario, first, known),
        }
        return cls(task, swept, table, block, manifest, part, piece.start)

    def with_engine(self, engine: str) -> SweepPlan:
        """The plan with all runs by an engine other than "auto"."""
        found = software(engine)
        task, manifest = replace(self.task, software=found), {**self.manifest, "software": found}
        return replace(self, task=task, manifest=manifest)

    @property
    def rows(self) -> int:
        """The number of runs of this part."""
        return len(next(iter(self.table.values())))

    @property
    def blocks(self) -> range:
        """Numbers of the blocks of this part."""
        return range(self.first // self.block, -(-(self.first + self.rows) // self.block))

    @property
    def header(self) -> dict[str, Any]:
        """The manifest, with the part and a digest of its values."""
        return {**self.manifest, "part": list(self.part), "values": _digest_of_table(self.table)}

    @property
    def identity(self) -> str:
        """Digest of the manifest without the origin of the scenario."""
        content = {name: value for name, value in self.manifest.items() if name != "source"}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def block_rows(self, block: int) -> slice:
        """Rows of a block in the table."""
        start = block * self.block - self.first
        return slice(start, min(start + self.block, self.rows))

    def block_table(self, block: int) -> Table:
        """Values of a block."""
        return {name: column[self.block_rows(block)] for name, column in self.table.items()}


def _plain(text: str) -> str:
    """Text that is valid UTF-8: the bytes of a path may not be."""
    return text.encode(errors="backslashreplace").decode()


def parse_metrics(names: Iterable[str] | None) -> tuple[str, ...]:
    """Metrics by their names in `Metrics` or in results; None for all."""
    if names is None:
        return Metrics._fields
    if isinstance(names, str):
        names = names.split(",")
    found = [METRICS[name][0] if name in METRICS else name for name in names]
    for name in found:
        if name not in Metrics._fields:
            raise ParameterError(f"there is no metric {name!r}", value=name, remedy=suggest(name, Metrics._fields))
    if not found:
        raise ParameterError("no metric is chosen", remedy=f"choose some of {', '.join(Metrics._fields)}")
    return tuple(name for name in Metrics._fields if name in found)


def _swept(over: Sweepable | None, scenario: Scenario) -> tuple[SweptParameter, ...]:
    if isinstance(over, str):
        over = [over]
    if isinstance(over, Mapping) and over:
        return sweep_parameters(scenario, over)
    if not over:
        raise ParameterError("nothing is varied", remedy="give a parameter, such as --over 'load.mass2=0.2 kg..1.0 kg'")
    parsed = iter(parse_sweeps([one for one in over if isinstance(one, str)], scenario))
    return tuple(next(parsed) if isinstance(one, str) else one for one in over)


def _precision(bits: int | None) -> int:
    if bits not in (None, 32, 64) or isinstance(bits, bool):
        raise ParameterError(f"a precision of {bits!r} bits", value=bits, remedy="choose 64 or 32")
    return 64 if bits is None else bits


def _sizes(rows: int, block: int | None, engine: str = "auto") -> tuple[int, int]:
    """Runs per batch, and runs per block; functions of the number of runs, the platform and CUDA alone."""
    cpu = jax.default_backend() == "cpu" and engine != "cuda"
    batches, largest = (_MIN_BATCHES, CHUNK) if cpu else (1, ON_ACCELERATOR)
    batches = max(batches, -(-rows // largest))  # of equal size, so that the last one needs little padding
    batch_size = _full_vectors(-(-rows // batches))
    if block is None:
        return batch_size, batch_size * min(max(rows // (batch_size * _MAX_BLOCKS), 1), _MAX_BATCHES if cpu else 4)
    if isinstance(block, bool) or not isinstance(block, int) or block < 1:
        raise ParameterError(f"a block of {block!r} runs", value=block, remedy="give a whole number, 1 or more")
    return min(batch_size, _full_vectors(block)), block


def _rows_of_part(part: tuple[int, int], rows: int, block: int) -> slice:
    """Rows of a part: whole blocks, so that they are computed as in the undivided sweep."""
    number, parts = part
    blocks = -(-rows // block)
    if not 1 <= number <= parts:
        message, remedy = f"there is no part {number} of {parts}", "count parts from 1, as in 3/8: the third of eight"
        raise ParameterError(message, field="part", value=number, lower=1, upper=parts, remedy=remedy)
    if parts > blocks:
        message = f"{rows} runs in blocks of {block} cannot be divided into {parts} parts"
        remedy = f"choose at most {blocks} parts"
        raise ParameterError(message, field="part", value=parts, upper=blocks, remedy=remedy)
    start, stop = ((number - 1) * blocks // parts * block, number * blocks // parts * block)
    return slice(start, min(stop, rows))


def parse_part(text: str) -> tuple[int, int]:
    """A part and the number of parts from text such as "3/8"; raises ParameterError for another text.

    >>> parse_part("3/8")
    (3, 8)
    """
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text.strip())
    if not found:
        raise ParameterError(f"{quoted(text)} is not a part", field="part", value=text, remedy="write it like 3/8")
    return int(found[1]), int(found[2])


def _full_vectors(rows: int) -> int:
    return -(-rows // VECTOR) * VECTOR


def _digest_of_table(table: Table) -> str:
    digest = hashlib.sha256()
    for name, column in table.items():
        digest.update(f"{name} {column.dtype.str} ".encode())
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()


def digest_of_model(scenario: Scenario, table: Table, known: Known) -> str:
    """Digest of all numbers of the first run, including the files and catalog entries that it names."""
    first = batched(scenario, {name: column[:1] for name, column in table.items()}, known=known)
    leaves = jax.tree_util.tree_leaves_with_path((first.plant(), first.control(), first.reference()))
    digest = hashlib.sha256()
    for path, leaf in leaves:
        digest.update(jax.tree_util.keystr(path).encode())
        digest.update(np.asarray(leaf).tobytes() if np.asarray(leaf).dtype != object else repr(leaf).encode())
    return digest.hexdigest()
