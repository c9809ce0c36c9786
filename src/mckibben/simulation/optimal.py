"""Commands optimised off line for the true plant, which show how small the errors of a run can be."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Reference, Setpoint
from mckibben.control.ddp import box_qp
from mckibben.errors import SimulationError
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import JointPlant, PerfectSensors, PlantState
from mckibben.simulation.problem import sample_reference, sampling_times
from mckibben.units import bar, deg

_STEPS = 0.5 ** np.arange(12)  # of the line search
_LEAST, _MOST = 1e-10, 1e6  # damping of changes of the commands [1/bar^2]
_SMALL = 1e-3  # relative decrease of the cost; after so small a one three times in a row the search ends
_PATIENCE = 3


class OptimalCommands(NamedTuple):
    """Commands of a run, and the errors with them."""

    commands: NDArray[np.float64]  # shape (periods, 2): pressures [Pa], or openings of valves with `direct` commands
    cost: float  # mean of the squared errors of angle and stiffness over their scales
    angle_rmse: float  # [rad]
    stiffness_rmse: float  # [N*m/rad]
    iterations: int  # improvements found
    converged: bool  # whether the search ended because the cost hardly fell any more


class _Run(NamedTuple):
    """A run of the plant; leaves have the shape (periods, ...)."""

    states: Array
    commands: Array  # in bar, or openings
    errors: Array  # of angle and stiffness, over their scales
    cost: Array


class _Problem(NamedTuple):
    """Plant and reference of a run; errors are over the scales."""

    plant: JointPlant
    initial: PlantState
    setpoints: Setpoint
    period: Array
    scales: Array
    substeps: int

    @property
    def unit(self) -> float:
        return 1.0 if self.plant.valve.direct else bar

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest commands."""
        lower, upper = (jnp.stack(self.plant.clip_commands((end, end))) / self.unit for end in (-jnp.inf, jnp.inf))
        return lower, upper

    def errors(self, state: Array, setpoint: Setpoint) -> Array:
        held = self._restored(state)
        stiffness = self.plant.joint.torque_and_stiffness(held.angle, held.pressures)[1]
        return jnp.stack([held.angle - setpoint.angle, stiffness - setpoint.stiffness]) / self.scales

    def advance(self, state: Array, commands: Array) -> Array:
        held, _ = self.plant.sample(self._restored(state), self.period)
        sent = commands[0] * self.unit, commands[1] * self.unit
        return ravel_pytree(self.plant.follow(held, sent, self.period, self.substeps))[0]

    def _restored(self, state: Array) -> PlantState:
        return ravel_pytree(self.initial)[1](state)


def optimal_commands(
    plant: JointPlant,
    reference: Reference,
    initial: PlantState,
    commands: ArrayLike,
    *,
    angle_scale: float = 0.02 * deg,
    stiffness_scale: float = 0.5,
    duration: float,
    control_period: float = 1e-3,
    substeps: int = 4,
    iterations: int = 100,
) -> OptimalCommands:
    """Return the commands of both valves that minimise the errors of a run of a known plant.

    They are found off line with everything known: the plant, its disturbance torques and the whole reference. The
    commands arrive late and within limits, as those of a controller do; there is no noise. As the problem is not
    convex, the optimum is a local one, from the given commands; it is never worse than these. It is therefore no proof
    of what is impossible, but a controller with these errors would need to know the future.

    Each iteration linearises the sampled plant at every control period (automatic differentiation), solves the
    linear-quadratic problem with limits of the commands backwards, and follows its feedback law on the plant: iterative
    LQR, the Gauss-Newton method for the whole sequence.

    Raises `SimulationError` if the times do not fit together, the commands do not fit the duration, or the run with
    them diverges.

    Parameters
    ----------
    plant, reference, initial
        The plant with its initial state, and the reference.
    commands
        Start of the search, shape (periods, 2), such as the commands of a controller.
    angle_scale, stiffness_scale
        Errors [rad], [N*m/rad] that cost the same. By default the angle has priority.
    duration, control_period, substeps
        As for `simulate`.
    iterations
        Most iterations.

    References
    ----------
    W. Li and E. Todorov, Iterative linear quadratic regulator design for nonlinear biological movement systems,
    ICINCO 2004; Y. Tassa, N. Mansard and E. Todorov, Control-limited differential dynamic programming, ICRA 2014.
    """
    plant = dataclasses.replace(plant, sensors=PerfectSensors()).with_period(control_period)
    times = sampling_times(duration, control_period)
    begun = np.asarray(commands, float)
    if begun.shape != (times.size, 2):
        message = f"commands of shape {begun.shape} for {times.size} control periods"
        remedy = f"give an array of shape ({times.size}, 2)"
        raise SimulationError(message, field="commands", value=begun.shape, remedy=remedy)
    plant, initial = numeric((plant, plant.complete_state(initial)))
    problem = _Problem(
        plant,
        initial,
        sample_reference(reference, times),
        jnp.asarray(control_period),
        jnp.array([angle_scale, stiffness_scale]),
        substeps,
    )
    best = _first(problem, jnp.asarray(begun) / problem.unit)
    if not np.isfinite(best.cost):
        raise SimulationError("the run diverges with the given commands", field="commands", remedy="start from others")
    damping, flat, found = float(best.cost), 0, 0  # a change by 1 bar costs as much as the errors
    while found < iterations and flat < _PATIENCE:
        improved, damping = _improved(problem, best, damping)
        if improved is None:
            break
        flat = flat + 1 if improved.cost > (1 - _SMALL) * best.cost else 0
        best, found = improved, found + 1
    angle_rmse, stiffness_rmse = np.sqrt(np.mean(np.asarray(best.errors) ** 2, axis=0)) * np.asarray(problem.scales)
    return OptimalCommands(
        np.asarray(best.commands) * problem.unit,
        float(best.cost),
        float(angle_rmse),
        float(stiffness_rmse),
        found,
        found < iterations,
    )


def _improved(problem: _Problem, last: _Run, damping: float) -> tuple[_Run | None, float]:
    """Run after one iteration, None if no damping gives a better one, and the damping of the next."""
    linear = _linearised(problem, last)
    while damping <= _MOST:
        steps, gains = _backward(problem, linear, last, jnp.asarray(damping))
        tried = _followed(problem, last, steps, gains)
        costs = np.where(np.isfinite(tried.cost), tried.cost, np.inf)
        at = int(costs.argmin())
        if costs[at] < last.cost:
            follows = max(damping / 5, _LEAST) if at == 0 else damping * (2 if at > 2 else 1)
            return jax.tree.map(lambda leaf, at=at: leaf[at], tried), follows
        damping *= 10
    return None, damping


def _run(problem: _Problem, law: Callable[[Any, Array], Array], rows: Any) -> _Run:
    """Run under a law that gives the commands from a row of `rows` and the state."""

    def step(state: Array, at: tuple[Setpoint, Any]) -> tuple[Array, tuple[Array, Array, Array]]:
        setpoint, row = at
        commands = jnp.clip(law(row, state), *problem.limits)
        return problem.advance(state, commands), (state, commands, problem.errors(state, setpoint))

    start = ravel_pytree(problem.initial)[0]
    states, commands, errors = lax.scan(step, start, (problem.setpoints, rows))[1]
    return _Run(states, commands, errors, jnp.mean(jnp.sum(errors**2, axis=1)))


@jit_arrays
def _first(problem: _Problem, commands: Array) -> _Run:
    """Run with given commands."""
    with batched_program():
        return _run(problem, lambda row, state: row, commands)


@jit_arrays
def _followed(problem: _Problem, last: _Run, steps: Array, gains: Array) -> _Run:
    """Runs with parts of the steps, shape (parts, ...), and feedback of the distance from the last run."""

    def one(part: Array) -> _Run:
        def law(row: Any, state: Array) -> Array:
            nominal, command, step, gain = row
            moved = jnp.where(state == nominal, 0.0, state - nominal)  # a phase may be infinite
            return command + part * step + gain @ moved

        return _run(problem, law, (last.states, last.commands, steps, gains))

    with batched_program():
        return jax.vmap(one)(jnp.asarray(_STEPS))


class _Linear(NamedTuple):
    """Next state and errors over the state and commands at each control period."""

    a: Array
    b: Array
    c: Array


@jit_arrays
def _linearised(problem: _Problem, run: _Run) -> _Linear:
    def one(at: tuple[Setpoint, Array, Array]) -> _Linear:
        setpoint, state, commands = at
        a, b = jax.jacfwd(problem.advance, (0, 1))(state, commands)
        return _Linear(a, b, jax.jacfwd(problem.errors)(state, setpoint))

    with batched_program():
        return lax.map(one, (problem.setpoints, run.states, run.commands), batch_size=8)


@jit_arrays
def _backward(problem: _Problem, linear: _Linear, run: _Run, damping: Array) -> tuple[Array, Array]:
    """Steps of the commands and gains over the state at each control period, from the last to the first."""
    lower, upper = problem.limits

    def stage(value: tuple[Array, Array], at: tuple[_Linear, Array, Array]) -> tuple[Any, tuple[Array, Array]]:
        (a, b, c), errors, commands = at
        gradient, hessian = value
        ahead = hessian @ a
        q_x, q_u = c.T @ errors + a.T @ gradient, b.T @ gradient
        q_xx, q_ux = c.T @ c + a.T @ ahead, b.T @ ahead
        q_uu = b.T @ hessian @ b + damping * jnp.eye(2)
        rows = tuple(map(tuple, q_uu))
        (one, other), free = box_qp(rows, tuple(q_u), tuple(lower - commands), tuple(upper - commands))
        step, moves = jnp.stack([one, other]), jnp.stack(free)
        inside = jnp.where(jnp.outer(moves, moves), q_uu, jnp.eye(2))
        gain = -jnp.linalg.solve(inside, jnp.where(moves[:, None], q_ux, 0.0))
        gradient = q_x + gain.T @ (q_uu @ step + q_u) + q_ux.T @ step
        hessian = q_xx + gain.T @ q_uu @ gain + gain.T @ q_ux + q_ux.T @ gain
        return (gradient, (hessian + hessian.T) / 2), (step, gain)

    size = linear.a.shape[-1]
    nothing = jnp.zeros(size), jnp.zeros((size, size))  # to come after the last period
    return lax.scan(stage, nothing, (linear, run.errors, run.commands), reverse=True)[1]
