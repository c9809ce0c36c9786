"""The simulation problem as one tree of named leaves, and its sampling times."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction, compiled
from mckibben.codegen.native import over_periods
from mckibben.component.base import Component
from mckibben.component.checks import whole_periods
from mckibben.control.base import DiscreteTimeSystem, Reference, Setpoint
from mckibben.control.reference import Signal
from mckibben.control.robot_control import check_pairs
from mckibben.errors import ParameterError, SimulationError, described
from mckibben.mechanism.base import joints_in, over_joints
from mckibben.numerics.batching import lanes_of, named_leaves, with_leaves
from mckibben.numerics.compiled import jit, numeric
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant, Mechanism, Plant, PlantState
from mckibben.simulation.metrics import last_change


class AtRest(NamedTuple):
    """A start at rest: angle [rad], stiffness [N*m/rad] (NaN: mid co-contraction); numbers, or arrays over runs."""

    angle: ArrayLike
    stiffness: ArrayLike = math.nan

    def state(self, plant: JointPlant, setpoints: Setpoint) -> tuple[PlantState, Array]:
        """Return the state of a plant, and whether it exists, before the first of setpoints, of shape (periods,)."""
        angle = jnp.where(jnp.isnan(self.angle), setpoints.angle[0], self.angle)
        return plant.find_equilibrium(angle, jnp.asarray(self.stiffness))


class SimulationProblem(NamedTuple):
    """All parts of a run; leaves are numbers, or arrays over runs.

    The reference is that of an unnamed joint, those of named joints by their names, or None for a controller that
    follows none.
    """

    plant: Plant
    controller: DiscreteTimeSystem
    reference: PyTree
    initial: PyTree  # `PlantState`, `AtRest` or `RobotStart`

    @classmethod
    def of(cls, plant: PyTree, controller: PyTree, reference: PyTree, initial: PyTree) -> SimulationProblem:
        """The problem, by default with a start at rest at the first desired angle.

        Raises `SimulationError` if there is not a reference of each joint.
        """
        call = "write simulate(plant, controller, reference), or scenario.simulate()"
        if controller is None:
            raise SimulationError("a plant, a controller and a reference are needed", field="controller", remedy=call)
        if not isinstance(plant, Plant) or not isinstance(controller, DiscreteTimeSystem):
            raise TypeError("plant and controller")  # `checked_call` says what is there instead
        names = plant.mechanism.joint_names
        if names:
            check_pairs(plant.mechanism.robot, controller)  # type: ignore[attr-defined]
        if controller.follows_reference:
            known = reference if isinstance(reference, Mapping) else {}
            if (names and {*known} != {*names}) or not (names or isinstance(reference, Reference)):
                text = f"a reference of each joint is needed: {', '.join(names)}" if names else "a reference is needed"
                raise SimulationError(text, field="reference", remedy=call)
        if not names and isinstance(reference, Reference):
            plant.mechanism.joint.check_setpoint(reference.stiffness)  # type: ignore[attr-defined]
        if initial is None and names:
            remedy = "give initial=RobotStart(angles, pressures), or use scenario.simulate()"
            raise SimulationError("a start is needed", field="initial", remedy=remedy)
        followed = reference if controller.follows_reference else None
        return cls(plant, controller, followed, AtRest(math.nan) if initial is None else initial)

    def setpoints(self, times: ArrayLike) -> PyTree:
        """The setpoints at times [s], traced, of their shape."""
        return in_order(self.plant, sample_reference(self.reference, times))

    def start(self, setpoints: PyTree) -> tuple[PlantState, Array]:
        """The initial state for setpoints of shape (periods,), and whether it exists."""
        if isinstance(self.initial, PlantState):
            return self.plant.complete_state(jax.tree.map(floating, self.initial)), jnp.asarray(True)
        state, exists = self.initial.state(self.plant, setpoints)
        return state, jnp.asarray(exists)


def in_order(plant: Plant, setpoints: PyTree) -> PyTree:
    """Return setpoints, those of named joints as a tuple in the order of the joints."""
    return tuple(map(setpoints.get, plant.mechanism.joint_names)) if isinstance(setpoints, dict) else setpoints


def resolved_at(plant: Plant, setpoints: PyTree, start: PlantState) -> tuple[PyTree, PyTree]:
    """Return the angles [rad] and the stiffness [N*m/rad] near which integration steps are resolved."""
    if isinstance(setpoints, Setpoint):
        alone = np.all(np.isnan(setpoints.stiffness))  # a muscle without a setpoint of the stiffness
        own = plant.mechanism.stiffness(start.position, start.pressures)[0] if alone else setpoints.stiffness
        return setpoints.angle, own
    return tuple(float(angle) for angle in joints_in(start.angle)), None


Problem = TypeVar("Problem", bound=tuple)
"""A named tuple with all parts of a run, the plant first."""


def split_problem(
    problem: Problem, over: Mapping[str, ArrayLike], control_period: float
) -> tuple[Problem | None, Problem, int | None]:
    """Return a problem as its leaves that vary over runs (None for one run), all others, and the number of runs.

    Parameters
    ----------
    problem
        All parts of a run; its controller and valves are prepared for the control period.
    over
        Arrays of shape (runs,), or numbers, at leaves by their dotted names.
    control_period
        Control period [s].

    Raises
    ------
    ParameterError
        If a leaf does not exist, or arrays differ in length.
    SimulationError
        If a number is NaN, or a frequency of the reference is at or above half the control rate.
    """
    whole: Any = problem
    if over:  # else each object has checked its values when it was made
        whole = type(whole)(**with_leaves(whole._asdict(), over))
    _check_numbers(whole)
    check_frequencies(whole.reference, control_period)
    plant, controller = whole.plant, whole.controller  # called unbound: equinox takes 0.1 ms to bind a method
    plant = type(plant).with_period(plant, control_period)
    whole = whole._replace(plant=plant, controller=type(controller).with_period(controller, control_period))
    count, varying = lanes_of(whole)
    plant = numeric(whole.plant)
    controller = _sharing(whole.controller, whole.plant.mechanism, plant.mechanism)
    whole = numeric(whole._replace(plant=None, controller=None))._replace(plant=plant, controller=controller)
    return (None, whole, None) if count is None else (*eqx.partition(whole, varying), count)


def _sharing(controller: PyTree, mechanism: Mechanism, numbers: Mechanism) -> PyTree:
    """`numeric` controller, in which models that equal parts of the mechanism are these as `numeric`, of `numbers`.

    Programs then compute once what both need, such as the stiffness at the measured angle.
    """
    parts = list(zip(mechanism.parts, numbers.parts, strict=True))
    found: dict[int, Component] = {}

    def is_part(node: object) -> bool:
        for part, number in parts:
            if type(node) is type(part) and _equal(node, part):
                found[id(node)] = number
                return True
        return False

    return jax.tree.map(lambda node: found.get(id(node)) or numeric(node), controller, is_leaf=is_part)


def _equal(one: PyTree, other: PyTree) -> bool:
    """Whether trees are equal; floats, the common case, are compared by Python, which takes a tenth of the time."""
    (leaves, structure), (others, other_structure) = jax.tree.flatten(one), jax.tree.flatten(other)
    if structure != other_structure:
        return False
    pairs = zip(leaves, others, strict=True)
    return all(a == b if type(a) is type(b) is float else eqx.tree_equal(a, b) for a, b in pairs)


def split_runs(
    problem: Problem, over: Mapping[str, ArrayLike], control_period: float, alone: str
) -> tuple[Problem, Problem, int]:
    """`split_problem` of many runs; raises `ParameterError` if they are the same, with the function for one."""
    lanes, shared, count = split_problem(problem, over, control_period)
    if lanes is None or count is None:
        remedy = f"give a NumPy array in place of a number, or use `{alone}` for one run"
        raise ParameterError("all runs are the same", remedy=remedy)
    return lanes, shared, count


def single_run(problem: Problem, control_period: float, many: str) -> Problem:
    """`split_problem` of one run; raises `ParameterError` if a number varies, with the function for many runs."""
    lanes, single, _ = split_problem(problem, {}, control_period)
    if lanes is not None:
        varying, remedy = ", ".join(named_leaves(cast(Any, lanes)._asdict())), f"use `{many}` for many runs"
        raise ParameterError(f"{varying}: an array in place of a number", remedy=remedy)
    return single


def _check_numbers(problem: Any) -> None:
    """Raise if a number is NaN, other than in a start at rest, where it stands for the default."""
    trees = {name: tree for name, tree in problem._asdict().items() if not isinstance(tree, AtRest)}
    if any(_has_nan(leaf) for leaf in jax.tree.leaves(trees)):
        name, leaf = next((name, leaf) for name, leaf in named_leaves(trees).items() if _has_nan(leaf))
        raise SimulationError(f"{name} is not a number", field=name, value=leaf, remedy="give a finite number")


def _has_nan(leaf: object) -> bool:
    if isinstance(leaf, float):
        return math.isnan(leaf)
    known = isinstance(leaf, np.ndarray | jax.Array) and not isinstance(leaf, jax.core.Tracer)
    return known and bool(np.isnan(np.asarray(leaf, float)).any())


def check_frequencies(reference: Reference | None, control_period: float, owner: str = "reference") -> None:
    """Raise `SimulationError` if a frequency [Hz] of a signal is at or above half the control rate."""
    highest = 0.5 / control_period
    for name, leaf in named_leaves({owner: reference}).items():
        if name.split(".")[-1] == "frequency" or "frequencies" in name.split("."):
            value = float(np.max(np.asarray(leaf, float)))
            if value >= highest * (1 - 1e-9):
                message = f"{name} is {value:g} Hz, at or above half the control rate of {1 / control_period:g} Hz"
                remedy = f"give less than {highest:g} Hz, or a shorter control period"
                raise SimulationError(message, field=name, value=value, upper=highest, unit="Hz", remedy=remedy)


def check_names(what: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Raise unless `names` is a list of known names."""
    for name in [names] if isinstance(names, str) else names:
        if name not in known or isinstance(names, str):
            raise SimulationError(
                f"{name!r} is not a {what}" if name not in known else f"{name!r} is a text, not a list",
                value=name,
                remedy=f"give a list of {', '.join(known)}",
            )


def float_type(precision: int) -> np.dtype:
    """Float type of a precision in bits; `SimulationError` for any but 32 and 64."""
    if precision not in (32, 64):
        raise SimulationError(f"precision {precision!r}", field="precision", value=precision, remedy="give 32 or 64")
    return np.dtype(f"float{precision}")


def sample_reference(reference: PyTree, times: ArrayLike) -> PyTree:
    """Return the setpoints of a reference, or of each one by name, at times [s], of their shape, in rad and N*m/rad.

    Without a reference these are the times. Setpoints are strongly typed: weakly typed ones would compile everything
    anew. Raises `SimulationError` for a signal that is a function of NumPy, which cannot be compiled.
    """
    if reference is None:
        return jnp.asarray(times, float)
    if isinstance(reference, Mapping):
        return {name: sample_reference(own, times) for name, own in reference.items()}
    try:
        return Setpoint(*(jnp.asarray(setpoint, float) for setpoint in reference(times)))
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        raise SimulationError(
            "a signal of the reference is a function that cannot be compiled",
            remedy="write it with jax.numpy in place of numpy, and with jnp.where in place of if",
        ) from error


_each_sample = compiled(sample_reference)
_all_samples = jit(sample_reference)


def sampled_reference(reference: PyTree, times: NDArray[np.float64]) -> PyTree:
    """Setpoints at times [s] as of `sample_reference`, computed by a compiled program."""
    if reference is None:
        return times
    if isinstance(reference, Mapping):
        return {name: sampled_reference(own, times) for name, own in reference.items()}
    if _is_pointwise(reference):
        return _each_sample(reference, times)
    return jax.tree.map(np.asarray, _all_samples(reference, times))  # another function may be one of all times


def sampled_runs(lanes: PyTree, shared: PyTree, times: NDArray[np.float64]) -> PyTree:
    """Setpoints of many runs at times [s], shape (periods, runs), or (periods,) if no number of theirs varies.

    The references are parts that vary, with the runs along the last axis, and parts that do not.
    """
    if isinstance(shared, Mapping) and jax.tree.leaves(lanes):
        setpoints = {name: sampled_runs(lanes[name], own, times) for name, own in shared.items()}
        leaves = jax.tree.leaves(setpoints)
        whole = np.broadcast_shapes(*[leaf.shape if leaf.ndim > 1 else (*leaf.shape, 1) for leaf in leaves])
        return jax.tree.map(lambda leaf: np.broadcast_to(leaf if leaf.ndim > 1 else leaf[:, None], whole), setpoints)
    if not jax.tree.leaves(lanes):
        return sampled_reference(shared, times)
    if _is_pointwise(eqx.combine(lanes, shared)):
        setpoints, _ = _sampled_run("auto", (shared, over_periods(times)), lanes)
    else:
        setpoints = _sampled_all(lanes, shared, times)
    return jax.tree.map(np.asarray, setpoints)


def _is_pointwise(reference: Reference) -> bool:
    return all(isinstance(signal, Signal) for signal in (reference.angle, reference.stiffness))


@BatchFunction
def _sampled_run(shared: tuple[Reference, Array], lane: Reference) -> Setpoint:
    reference = eqx.combine(lane, shared[0])
    return jax.lax.map(lambda time: sample_reference(reference, time), shared[1])


@jit
def _sampled_all(lanes: Reference, shared: Reference, times: ArrayLike) -> Setpoint:
    return jax.vmap(lambda lane: sample_reference(eqx.combine(lane, shared), times), -1, -1)(lanes)


def starts_of(
    lanes: SimulationProblem | None, shared: SimulationProblem, setpoints: PyTree, *, engine: str = "auto"
) -> tuple[PlantState, Array]:
    """Return the initial states of runs, and whether they exist, with the runs along the last axis.

    Parameters
    ----------
    lanes, shared
        Parts of the runs that vary, with the runs along the last axis, or None for one run, and parts that do not.
    setpoints
        Shape (periods,), or (periods, runs).
    """
    first = jax.tree.map(lambda values: np.asarray(values)[:1], setpoints)
    unused: Any = {"controller": None, "reference": None}  # others compile nothing new
    varies, shared = vary(first), shared._replace(**unused)
    if lanes is None:
        return _start(engine, (shared, first))[0]
    counted = np.zeros(jax.tree.leaves(lanes)[0].shape[-1])  # the starts may be the same
    parts = lanes._replace(**unused), first if varies else None, counted
    return _start("native" if engine == "cuda" else engine, (shared, None if varies else first), parts)[0]


@BatchFunction
def _start(shared: PyTree, lane: PyTree) -> tuple[PlantState, Array]:
    (problem, setpoints), (own, varied, _) = shared, (None, None, None) if lane is None else lane
    run = problem if own is None else eqx.combine(own, problem)
    return run.start(setpoints if varied is None else varied)


def vary(setpoints: PyTree) -> bool:
    """Whether setpoints differ between runs."""
    return jax.tree.leaves(setpoints)[0].ndim > 1


def sampled(reference: Reference, duration: float, period: float) -> tuple[NDArray[np.float64], Setpoint]:
    """Start times [s] of the control periods in a duration, and the setpoints; `SimulationError` if they do not fit."""
    times = sampling_times(duration, period)
    return times, sampled_reference(reference, times)


def sampling_times(duration: float, period: float) -> NDArray[np.float64]:
    """Return the start times [s] of the control periods in a duration, shape (periods,).

    Raises `SimulationError` if duration or period [s] is not positive, or one is not a multiple of the other.

    >>> sampling_times(0.003, 1e-3).tolist()
    [0.0, 0.001, 0.002]
    """
    for name, value in (("duration", duration), ("control_period", period)):
        number = isinstance(value, Real) and not isinstance(value, bool)
        if not (number and math.isfinite(value) and value > 0):
            text = f"the {name.replace('_', ' ')} is {f'{value:g} s' if number else described(value)}"
            remedy = "give a positive time" if number else "give a number of seconds, such as 2.0"
            raise SimulationError(text, field=name, value=value, lower=0.0, unit="s", remedy=remedy)
    periods = whole_periods(duration, period)
    if periods is None:
        message = f"a duration of {duration:.12g} s is not a multiple of the control period of {period:.12g} s"
        remedy = f"{max(round(duration / period), 1) * period:.12g} s would be"
        raise SimulationError(message, value=duration, unit="s", remedy=remedy)
    return np.arange(periods, dtype=float) * period


def without_last_change(setpoints: PyTree) -> PyTree:
    """The setpoints without the last step of stiffness of each joint; None if there is none, or none ends with one."""

    def unchanged(own: Setpoint) -> Setpoint:
        stiffness = np.asarray(own.stiffness)
        change = last_change(stiffness, np)
        constant = np.where(np.arange(stiffness.size) >= change.at, change.before, stiffness)
        return own._replace(stiffness=constant) if change.ends else own  # type: ignore[arg-type]

    constant = over_joints(unchanged, setpoints)
    return None if all(map(operator.is_, joints_in(constant), joints_in(setpoints))) else constant
