"""Runs of a benchmark, drawn once for all controllers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.control import Reference, Samples, Sine
from mckibben.control.base import Setpoint
from mckibben.numerics.batching import lanes_of
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario, batched, with_values
from mckibben.simulation.problem import check_frequencies, sample_reference, sampled_reference, sampling_times
from mckibben.study.compare.suite import Suite, start_of
from mckibben.study.parameters import sample

Column = NDArray


@dataclass(frozen=True, eq=False)
class Group:
    """Runs whose plants differ only in numbers and can be batched."""

    rows: NDArray[np.int64]  # indices of these runs, shape (count,)
    joint: Sequence[str]  # names, of each run
    reference_name: Sequence[str]
    plant: JointPlant  # with arrays of shape (count, ...) where runs differ, as for `simulate_many`
    reference: Reference  # sampled

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(self.joint)


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of a suite."""

    suite: Suite
    joint: Sequence[str]  # names, of each run
    reference_name: Sequence[str]
    conditions: dict[str, Column]  # values [SI] of varied plant parameters by name, one per run
    reference_values: dict[str, dict[str, Column]]  # likewise, for each reference, one per run in order
    groups: tuple[Group, ...]  # plants and references

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(self.joint)

    def conditions_of(self, joint: str, rows: NDArray[np.int64]) -> dict[str, Column]:
        """Values [SI] of a plant's varied parameters in some of its runs."""
        return {name: column[rows] for name, column in self.conditions.items() if self.suite.has(joint, name)}

    def delayed(self, delay: float) -> Runs:
        """Return the same runs with a further delay [s] of the commands."""

        def late(plant: JointPlant) -> JointPlant:
            own = 0.0 if plant.command_delay is None else plant.command_delay
            return replace(plant, command_delay=own + delay)

        return replace(self, groups=tuple(replace(group, plant=late(group.plant)) for group in self.groups))

    def scenario(self, controller: str, run: int, values: dict[str, float] | None = None) -> Scenario:
        """Scenario of one run, numbered from 0, with a controller of tuned values [SI]."""
        reference, joint = self.reference_name[run], self.joint[run]
        place = [row for row, name in enumerate(self.reference_name) if name == reference].index(run)
        numbers = {name: column[0].item() for name, column in self.conditions_of(joint, np.array([run])).items()}
        numbers |= {name: column[place].item() for name, column in self.reference_values[reference].items()}
        numbers |= values or {}
        scenario = self.suite.scenario(controller, reference, joint)
        if numbers:
            scenario = with_values(scenario, numbers)
        return scenario.model_copy(update={"start": start_of(scenario.signals)})


def draw(suite: Suite, count: int, seed: int) -> Runs:
    """Draw runs.

    Joints and references occur in their shares, in random order; parameters are scrambled Sobol points of their ranges.
    If the suite has sensors, each run has its own noise seed.

    Raises `ParameterError` if the conditions of a run do not give a valid scenario; `SimulationError` if a frequency of
    a reference is at or above half the control rate, or a plant needs more substeps.
    """
    shares = {name: plant.share for name, plant in suite.plants.items()}
    order = np.random.default_rng(seed).spawn(2)
    joint = _dealt(shares, count, order[0])
    names = _dealt({name: case.share for name, case in suite.references.items()}, count, order[1])
    conditions = dict(sample(suite.conditions_over(), samples=count, seed=seed)) if suite.conditions else {}
    if suite.has_noise and "sensors.seed" not in conditions:
        conditions["sensors.seed"] = np.arange(count, dtype=np.int64) + (1000 * seed) % 2**30
    values, setpoints = _references(suite, names, seed)
    runs = Runs(suite, joint, names, conditions, values, ())
    return replace(runs, groups=_groups(runs, setpoints))


def _references(suite: Suite, names: Sequence[str], seed: int) -> tuple[dict[str, dict[str, Column]], Column]:
    """Values of the varied parameters by reference, and the setpoints of shape (2, runs, periods)."""
    times = sampling_times(suite.duration, suite.control_period)
    values: dict[str, dict[str, Column]] = {}
    setpoints = np.empty((2, len(names), times.size))
    for number, name in enumerate(suite.references):
        rows = _rows(names, name)
        values[name] = {}
        if rows.size:
            values[name] = table = _reference_values(suite, name, rows.size, seed + 7919 * (number + 1))
            scenario = suite.scenario(next(iter(suite.controllers)), name)
            reference = (batched(scenario, table) if table else scenario).reference()
            check_frequencies(reference, suite.control_period)
            setpoints[:, rows] = _sampled(reference, times)
    return values, setpoints


def _sampled(reference: Reference, times: NDArray[np.float64]) -> Column:
    """Setpoints of one reference or a batch of them, shape (2, 1 or runs, periods)."""
    count, varying = lanes_of(reference)
    lanes, shared = eqx.partition(numeric(reference), varying)
    if count is None:
        return np.stack(sampled_reference(reference, times))[:, None]
    return np.stack(_sampled_lanes(lanes, shared, times))


@jit
def _sampled_lanes(lanes: Reference, shared: Reference, times: NDArray[np.float64]) -> Setpoint:
    return jax.vmap(lambda lane: sample_reference(eqx.combine(lane, shared), times))(lanes)


def _groups(runs: Runs, setpoints: Column) -> tuple[Group, ...]:
    """Runs by the structure of their plants."""
    suite, times = runs.suite, sampling_times(runs.suite.duration, runs.suite.control_period)
    parts: dict[Any, list[tuple[NDArray[np.int64], JointPlant]]] = {}
    for name in dict.fromkeys(runs.joint):
        rows = _rows(runs.joint, name)
        scenario = suite.example(joint=name)
        if suite.substeps is not None:
            scenario.plant().check_substeps(setpoints[0], setpoints[1], suite.control_period, suite.substeps)
        taken = runs.conditions_of(name, rows)
        plant = (batched(scenario, taken) if taken else scenario).plant()
        parts.setdefault(jax.tree.structure(plant), []).append((rows, plant))
    groups = []
    for several in parts.values():
        rows = np.sort(np.concatenate([rows for rows, _ in several]))
        within = [(np.searchsorted(rows, own), plant) for own, plant in several]
        joint, names = ([column[int(row)] for row in rows] for column in (runs.joint, runs.reference_name))
        reference = Reference(*(Samples(times, values[rows]) for values in setpoints))
        groups.append(Group(rows, joint, names, merged(within, rows.size), reference))
    return tuple(groups)


def _dealt(shares: dict[str, int], count: int, order: np.random.Generator) -> list[str]:
    """Names in their shares, in random order."""
    names = [name for name, share in shares.items() for _ in range(share)]
    dealt = [names[i % len(names)] for i in range(count)]
    return [dealt[i] for i in order.permutation(count)]


def _rows(names: Sequence[str], name: str) -> NDArray[np.int64]:
    return np.array([row for row, other in enumerate(names) if other == name], dtype=np.int64)


def _reference_values(suite: Suite, name: str, count: int, seed: int) -> dict[str, Column]:
    """Values of a reference's varied parameters, with sine amplitudes of the angle within the suite's acceleration."""
    varied = suite.reference_over(name)
    table = dict(sample(varied, samples=count, seed=seed)) if varied else {}
    sine = suite.references[name].reference.angle
    limits = (suite.max_angular_velocity, 1), (suite.max_angular_acceleration, 2)
    if not isinstance(sine, Sine) or limits == ((None, 1), (None, 2)):
        return table
    amplitude = table.get("reference.angle.amplitude", np.full(count, sine.amplitude))
    frequency = table.get("reference.angle.frequency", np.full(count, sine.frequency))
    largest = np.min(
        [most / np.maximum((2 * np.pi * frequency) ** order, 1e-12) for most, order in limits if most is not None],
        axis=0,
    )
    return {**table, "reference.angle.amplitude": np.clip(amplitude, -largest, largest)}


def merged(parts: list[tuple[NDArray[np.int64], Any]], count: int) -> Any:
    """One tree of all runs, merged from trees of equal structure with some runs each."""

    def join(*leaves: Any) -> Any:
        if not eqx.is_array_like(leaves[0]):
            return leaves[0]
        values = [np.asarray(leaf) for leaf in leaves]
        if all(value.ndim == 0 and value == values[0] for value in values):
            return leaves[0]
        whole = np.empty(count, np.result_type(*values))
        for (rows, _), part in zip(parts, values, strict=True):
            whole[rows] = part
        return whole

    return jax.tree.map(join, *(tree for _, tree in parts))
