"""How two manifests differ, in words."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, NamedTuple

import jax
import numpy as np

from mckibben.errors import ParameterError, Problem
from mckibben.simulation import Metrics
from mckibben.simulation.batch import CHUNK, ON_ACCELERATOR, VECTOR
from mckibben.study.parameters import (
    Distribution,
    Known,
    SweptParameter,
    Table,
    batched,
    known_names,
    parse_sweeps,
    sample,
    sweep_parameters,
)
from mckibben.study.reporting import METRICS
from mckibben.study.scenario import Scenario
from mckibben.study.sweep.blocks import BatchTask, software

_SAME = "give the same again, or choose another folder"
_LEFT_OUT = "leave it out to take what the sweep was begun with, or choose another folder"


def differences(begun: Mapping[str, Any], now: Mapping[str, Any]) -> list[Problem]:
    """What a sweep was begun with that it is not to go on with; where the scenario came from does not count.

    >>> for problem in differences({"seed": 1, "design": "sobol"}, {"seed": 2, "design": "sobol"}):
    ...     print(problem.field, problem.message, sep=": ")
    seed: the sweep was begun with 1, not 2
    """
    found = list(_found(begun, now))
    # The values follow from the rest: they are news only where the rest is the same.
    return found if found else list(_consequences(begun, now))


def _found(begun: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Problem]:
    for name, value in now.items():
        before = begun.get(name)
        if name in ("source", "values", "model") or before == value:
            continue
        if name == "scenario":
            yield _first_line(str(before), value)
        elif name == "over":
            for one, other in zip_longest(before if isinstance(before, list) else [], value):
                if one != other:
                    yield Problem(_begun_over(one, other), field="over", remedy=_LEFT_OUT)
        elif name == "software":
            before = before if isinstance(before, Mapping) else {}
            for part, version in value.items():
                if before.get(part) != version:
                    remedy = "go on where it was begun, or begin anew in another folder"
                    yield Problem(_begun(before.get(part), version), field=part, remedy=remedy)
        else:
            yield Problem(_begun(_said(before), _said(value)), field=name, remedy=_LEFT_OUT)


def _consequences(begun: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Problem]:
    remedy = "begin anew in another folder"
    if begun.get("values") != now.get("values"):
        yield Problem(
            "the same design gives other values here: another SciPy or processor", field="over", remedy=remedy
        )
    if begun.get("model") != now.get("model"):
        yield Problem("a file that it names has changed since, or the catalog", field="scenario", remedy=remedy)


def _first_line(before: str, now: str) -> Problem:
    for old, new in zip_longest(before.splitlines(), now.splitlines()):
        if old != new:
            told = [None if line is None else repr(line.strip()) for line in (old, new)]
            return Problem(_begun_over(*told), field="scenario", remedy=_SAME)
    return Problem("it is another", field="scenario", remedy=_SAME)


def _begun_over(before: str | None, now: str | None) -> str:
    """The same where one of them may not be there at all."""
    if before is None:
        return f"the sweep was begun without {now}"
    return f"the sweep was begun with {before} too" if now is None else _begun(before, now)


def _begun(before: object, now: object) -> str:
    return f"the sweep was begun with {before}, not {now}"


def _said(value: object) -> object:
    return ", ".join(map(str, value)) if isinstance(value, list) else value


MANIFEST = "manifest.json"
FORMAT = 2
_SAMPLES = 1024
_PIECES = 16  # a small sweep is cut into so many blocks at least, as long as they fill a vector
_MOST_FILES = 256
_MOST_CHUNKS = 64  # in a block: so that little is lost with one


Said = Sequence[str | SweptParameter] | Mapping[str, Distribution]
"""What is varied over what: texts as `parse_sweep` takes them, or made in Python."""


class SweepOptions(NamedTuple):
    """What a caller wants of a sweep; None is left out."""

    over: Said | None = None
    design: str | None = None
    samples: int | None = None
    seed: int | None = None
    metrics: Sequence[str] | None = None
    precision: int | None = None
    block: int | None = None
    known: Known | None = None

    def filled(self, begun: Mapping[str, Any]) -> SweepOptions:
        """With what a manifest says where something is left out."""
        kind = begun["design"] if self.design is None else self.design
        own = self._replace(samples=self.samples if kind != "grid" or self.samples is not None else None)
        said = {name: begun[name] for name in self._fields if name != "samples"}
        if kind != "grid":
            said["samples"] = begun["samples"]
        return SweepOptions(**{**said, **{name: value for name, value in own._asdict().items() if value is not None}})


@dataclass(frozen=True, eq=False)
class Plan:
    """A sweep before it is run.

    Attributes
    ----------
    job
        What all blocks share.
    over
        What is varied.
    table
        The values [SI], a row a run.
    block
        Rows that are kept in one file.
    manifest
        All that determines the numbers, as JSON has it.
    """

    job: BatchTask
    over: tuple[SweptParameter, ...]
    table: Table
    block: int
    manifest: dict[str, Any]

    @classmethod
    def of(cls, scenario: Scenario, asked: SweepOptions, *, folder: str = ".", source: str = "") -> Plan:
        """Make the table, and check all of it.

        Parameters
        ----------
        scenario, asked
            What is wanted.
        folder
            To which paths in the manifest's scenario are relative.
        source
            Where the scenario came from, in words.

        Raises
        ------
        ParameterError
            If what is asked makes no sense, or a row makes no valid scenario.
        """
        kind = "sobol" if asked.design is None else asked.design
        if kind == "grid" and asked.samples is not None:
            raise ParameterError(
                "a grid has as many runs as its points make",
                value=asked.samples,
                remedy="leave the number of samples out, or choose another design",
            )
        varied = _overs(asked.over, scenario)
        known = known_names(scenario, asked.known or (), [each.name for each in varied])
        samples = _SAMPLES if asked.samples is None else asked.samples
        seed = 0 if asked.seed is None or kind == "grid" else asked.seed
        table = sample(varied, kind, samples, seed)  # type: ignore[arg-type]  # it says itself what kinds there are
        batched(scenario, table)  # a combination that is not allowed is found before the work
        rows = len(next(iter(table.values())))
        metrics, precision = metrics_named(asked.metrics), _precision(asked.precision)
        together, block = _sizes(rows, asked.block)
        job = BatchTask(scenario, metrics, precision, together, software(), known)
        manifest = {
            "format": FORMAT,
            "scenario": scenario.dumps(folder=folder),
            "source": source,
            "over": [each.text for each in varied],
            "known": list(known),
            "design": kind,
            "samples": rows,
            "seed": seed,
            "metrics": list(metrics),
            "precision": precision,
            "block": block,
            "lanes": together,
            "software": job.software,
            "values": _digest_of_table(table),
            "model": _digest_of_model(scenario, table, known),
        }
        return cls(job, varied, table, block, manifest)

    @property
    def rows(self) -> int:
        """The number of runs."""
        return len(next(iter(self.table.values())))

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return -(-self.rows // self.block)

    @property
    def identity(self) -> str:
        """A digest of the manifest, which every block carries; where the scenario came from is not in it."""
        said = {name: value for name, value in self.manifest.items() if name != "source"}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()

    def span(self, block: int) -> slice:
        """The rows of a block."""
        return slice(block * self.block, min((block + 1) * self.block, self.rows))

    def part(self, block: int) -> Table:
        """The values of a block."""
        return {name: column[self.span(block)] for name, column in self.table.items()}


def metrics_named(names: Iterable[str] | None) -> tuple[str, ...]:
    """The metrics of some names, those of `Metrics` or those that are shown; all for None.

    Raises
    ------
    ParameterError
        If there is no such metric, or no name.
    """
    if names is None:
        return Metrics._fields
    if isinstance(names, str):
        names = names.split(",")
    found = []
    for name in names:
        metric = METRICS[name][0] if name in METRICS else name
        if metric not in Metrics._fields:
            raise ParameterError(f"there is no metric {name!r}", value=name, remedy=_suggestion(name))
        found.append(metric)
    if not found:
        raise ParameterError("no metric is asked for", remedy=f"choose some of {', '.join(Metrics._fields)}")
    return tuple(name for name in Metrics._fields if name in found)


def _suggestion(name: str) -> str:
    import difflib

    close = difflib.get_close_matches(name[:100], Metrics._fields, 1)
    return f"did you mean {close[0]!r}?" if close else f"choose some of {', '.join(Metrics._fields)}"


def _overs(said: Said | None, scenario: Scenario) -> tuple[SweptParameter, ...]:
    if isinstance(said, str):
        said = [said]
    if isinstance(said, Mapping) and said:
        return sweep_parameters(scenario, said)
    if not said:
        raise ParameterError("nothing is varied", remedy="say what, like --over 'load.mass2=0.2 kg..1.0 kg'")
    read = iter(parse_sweeps([one for one in said if isinstance(one, str)], scenario))
    return tuple(next(read) if isinstance(one, str) else one for one in said)  # type: ignore[misc]


def _precision(bits: int | None) -> int:
    if bits not in (None, 32, 64) or isinstance(bits, bool):
        raise ParameterError(f"a precision of {bits!r} bits", value=bits, remedy="choose 64 or 32")
    return 64 if bits is None else bits


def _sizes(rows: int, block: int | None) -> tuple[int, int]:
    """Runs computed together, and runs in a block; they depend on the number of runs alone (and the platform)."""
    cpu = jax.default_backend() == "cpu"
    pieces, most = (_PIECES, CHUNK) if cpu else (1, ON_ACCELERATOR)
    pieces = max(pieces, -(-rows // most))  # all of one size, so that the last one is hardly filled up
    together = _whole_vectors(-(-rows // pieces))
    if block is None:
        return together, together * min(max(rows // (together * _MOST_FILES), 1), _MOST_CHUNKS if cpu else 4)
    if isinstance(block, bool) or not isinstance(block, int) or block < 1:
        raise ParameterError(f"a block of {block!r} runs", value=block, remedy="give a whole number from 1 up")
    return min(together, _whole_vectors(block)), block


def _whole_vectors(rows: int) -> int:
    return -(-rows // VECTOR) * VECTOR


def _digest_of_table(table: Table) -> str:
    digest = hashlib.sha256()
    for name, column in table.items():
        digest.update(f"{name} {column.dtype.str} ".encode())
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()


def _digest_of_model(scenario: Scenario, table: Table, known: Known) -> str:
    """Of all numbers of the first run: files that the scenario names, and the catalog, are in it."""
    first = batched(scenario, {name: column[:1] for name, column in table.items()}, known=known)
    leaves = jax.tree_util.tree_leaves_with_path((first.plant(), first.control(), first.reference()))
    digest = hashlib.sha256()
    for path, leaf in leaves:
        digest.update(jax.tree_util.keystr(path).encode())
        digest.update(np.asarray(leaf).tobytes() if np.asarray(leaf).dtype != object else repr(leaf).encode())
    return digest.hexdigest()
