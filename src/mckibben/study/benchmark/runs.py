"""Runs of a benchmark, drawn once for all controllers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.control import Constant, Multisine, Reference, Signal, Sine, Step, Sum
from mckibben.errors import ParameterError
from mckibben.plant import JointPlant
from mckibben.study.benchmark.suite import Suite, start_of
from mckibben.study.parameters import batched, sample, with_values
from mckibben.study.scenario import Scenario

Column = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of a suite.

    Attributes
    ----------
    suite
        The suite.
    joint, reference_name
        Names of the joint and the reference of each run.
    conditions
        Values [SI] of varied plant parameters by name, one a run.
    reference_values
        Values [SI] of varied parameters by name, for each reference, one for each of its runs in order.
    plant, reference
        Batches with arrays of shape (runs,) where runs differ, as for `simulate_many`.
    """

    suite: Suite
    joint: Sequence[str]
    reference_name: Sequence[str]
    conditions: dict[str, Column]
    reference_values: dict[str, dict[str, Column]]
    plant: JointPlant
    reference: Reference

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(self.joint)

    def scenario(self, controller: str, run: int, values: dict[str, float] | None = None) -> Scenario:
        """Scenario of one run, numbered from 0, with a controller of tuned values [SI]."""
        reference = self.reference_name[run]
        place = [row for row, name in enumerate(self.reference_name) if name == reference].index(run)
        numbers = {name: column[run].item() for name, column in self.conditions.items()}
        numbers |= {name: column[place].item() for name, column in self.reference_values[reference].items()}
        numbers |= values or {}
        scenario = self.suite.scenario(controller, reference, self.joint[run])
        if numbers:
            scenario = with_values(scenario, numbers)
        return scenario.model_copy(update={"start": start_of(scenario.signals)})


def draw(suite: Suite, count: int, seed: int) -> Runs:
    """Draw runs.

    Joints and references come in their shares, in random order; parameters are scrambled Sobol points of their ranges.
    Where the suite has sensors, each run has its own noise seed.

    Raises
    ------
    ParameterError
        If the conditions of a run make no valid scenario, or joints differ in more than numbers.
    """
    shares = {name: share for name, (share, _) in suite.joints.items()}
    order = np.random.default_rng(seed).spawn(2)
    joint = _dealt(shares, count, order[0])
    names = _dealt({name: each.share for name, each in suite.references.items()}, count, order[1])
    conditions = dict(sample(suite.conditions_over(), samples=count, seed=seed)) if suite.conditions else {}
    if suite.sensors is not None and "sensors.seed" not in conditions:
        conditions["sensors.seed"] = np.arange(count, dtype=np.int64) + (1000 * seed) % 2**30
    first = next(iter(suite.controllers))
    plants, references, values = [], [], {}
    for name in dict.fromkeys(joint):
        rows = _rows(joint, name)
        scenario = suite.scenario(first, names[rows[0]], name)
        taken = {key: column[rows] for key, column in conditions.items()}
        plants.append((rows, (batched(scenario, taken) if taken else scenario).plant()))
    most = max(_sines(suite, name) for name in suite.references)
    for number, name in enumerate(suite.references):
        rows = _rows(names, name)
        if rows.size == 0:
            values[name] = {}
            continue
        table = _reference_values(suite, name, rows.size, seed + 7919 * (number + 1))
        values[name] = table
        scenario = suite.scenario(first, name)
        found = (batched(scenario, table) if table else scenario).reference()
        references.append(
            (rows, Reference(_as_step_and_sines(found.angle, most), _as_step_and_sines(found.stiffness, most)))
        )
    return Runs(
        suite,
        joint,
        names,
        conditions,
        values,
        _merged(plants, count, "joints"),
        _merged(references, count, "references"),
    )


def _dealt(shares: dict[str, int], count: int, order: np.random.Generator) -> list[str]:
    """Names in their shares, in random order."""
    names = [name for name, share in shares.items() for _ in range(share)]
    dealt = [names[i % len(names)] for i in range(count)]
    return [dealt[i] for i in order.permutation(count)]


def _rows(names: Sequence[str], name: str) -> NDArray[np.int64]:
    return np.array([row for row, each in enumerate(names) if each == name], dtype=np.int64)


def _reference_values(suite: Suite, name: str, count: int, seed: int) -> dict[str, Column]:
    """Values of a reference's varied parameters, with sine amplitudes of the angle within the suite's acceleration."""
    varied = suite.reference_over(name)
    table = dict(sample(varied, samples=count, seed=seed)) if varied else {}
    sine, most = suite.references[name].reference.angle.sine, suite.max_angular_acceleration
    if sine is None or most is None:
        return table
    amplitude = table.get("reference.angle.amplitude", np.full(count, sine.amplitude))
    frequency = table.get("reference.angle.frequency", np.full(count, sine.frequency))
    largest = most / np.maximum((2 * np.pi * frequency) ** 2, 1e-12)
    return {**table, "reference.angle.amplitude": np.clip(amplitude, -largest, largest)}


def _sines(suite: Suite, name: str) -> int:
    signals = suite.references[name].reference
    several = [each.multisine for each in (signals.angle, signals.stiffness) if each.multisine is not None]
    return max([1, *(len(each.amplitudes) for each in several)])


def _as_step_and_sines(signal: Signal, sines: int) -> Sum:
    """A step and so many sines, so that all references share one compiled program."""
    nothing = (0.0,) * sines

    def form(before: Any, after: Any, at: Any, amplitudes: Any, frequencies: Any, phases: Any) -> Sum:
        a, f, p = (tuple(each) + (0.0,) * (sines - len(each)) for each in (amplitudes, frequencies, phases))
        return Sum((Step(before, after, at), Multisine(a, f, p)))

    match signal:
        case Constant():
            return form(signal.value, signal.value, 0.0, nothing, nothing, nothing)
        case Step():
            return form(signal.before, signal.after, signal.at, nothing, nothing, nothing)
        case Sine():
            offset = signal.offset
            return form(offset, offset, 0.0, (signal.amplitude,), (signal.frequency,), (signal.phase,))
        case Multisine():
            offset, phases = signal.offset, signal.phases or (0.0,) * len(signal.amplitudes)
            return form(offset, offset, 0.0, signal.amplitudes, signal.frequencies, phases)
    raise ParameterError(
        f"a reference signal of the kind {type(signal).__name__}", remedy="give a constant, step, sine or multisine"
    )


def _merged(parts: list[tuple[NDArray[np.int64], Any]], count: int, what: str) -> Any:
    """One tree of all runs from trees of some runs each."""
    trees = [tree for _, tree in parts]
    structures = {jax.tree.structure(tree) for tree in trees}
    if len(structures) > 1:
        remedy = "give all the same specimens, kinds of law and parts"
        raise ParameterError(f"the {what} of the suite differ in more than numbers", remedy=remedy)

    def merged(*leaves: Any) -> Any:
        if not eqx.is_array_like(leaves[0]):
            return leaves[0]
        found = [np.asarray(leaf) for leaf in leaves]
        if all(each.ndim == 0 and each == found[0] for each in found):
            return leaves[0]
        whole = np.empty(count, np.result_type(*found))
        for (rows, _), values in zip(parts, found, strict=True):
            whole[rows] = values
        return whole

    return jax.tree.map(merged, *trees)
