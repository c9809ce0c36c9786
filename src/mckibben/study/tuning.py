"""Tune the gains of two PID loops by their errors, with a margin: many candidates at once, compiled together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.control import PID, PositionStiffnessControl, Reference, Setpoint
from mckibben.errors import RangeError
from mckibben.numerics.compiled import compiled_batch, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation import episode, rms, sampled

_LOST = 1e6  # the cost of a run that did not stay finite


class Cost(NamedTuple):
    """What a set of gains costs: RMS errors of angle and stiffness, each by its scale, summed over references.

    Errors alone would drive the gains to the brink of instability. So the cost is the larger of that of the gains as
    they are, and of all of them multiplied by the margin.

    Attributes
    ----------
    angle_scale, stiffness_scale
        The errors [rad], [N*m/rad] that cost 1.
    gain_margin
        The factor by which the gains may rise without harm; at 1 there is no margin.
    """

    angle_scale: float
    stiffness_scale: float
    gain_margin: float = 1.5


@dataclass(frozen=True)
class Tuned:
    """The outcome of a tuning.

    Attributes
    ----------
    position, stiffness
        The loops with the gains that were found.
    cost, cost_before
        Their cost, and that of the gains it started from.
    evaluated
        How many sets of gains were tried.
    at_bound
        The names of gains that lie within 1 % (in logarithm) of the range that was searched.
    """

    position: PID
    stiffness: PID
    cost: float
    cost_before: float
    evaluated: int
    at_bound: tuple[str, ...]


def tune_pid(
    plant: JointPlant,
    controller: PositionStiffnessControl,
    references: Sequence[Reference],
    cost: Cost,
    *,
    initial: PlantState,
    duration: float = 10.0,
    control_period: float = 1e-3,
    substeps: int = 4,
    decades: float = 2.0,
    generations: int = 30,
    population: int = 32,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Tuned:
    """Search the non-zero gains of both loops, in logarithm, by differential evolution.

    Parameters
    ----------
    plant, controller
        What is moved, and a controller with two `PID` loops: the search starts from its gains and keeps their signs.
    references
        The wishes to be good at, all at once.
    cost
        See `Cost`.
    initial
        The plant's state at the start of every run.
    duration, control_period, substeps
        As for `simulate`.
    decades
        How far the search goes from the gains it starts from, in powers of ten either way.
    generations, population
        Of the search; their product is roughly the number of candidates.
    seed
        Of the search.
    progress
        Called with the part that is done, 0 to 1.

    References
    ----------
    R. Storn and K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359; the implementation is
    `scipy.optimize.differential_evolution`.
    """
    from scipy.optimize import differential_evolution  # 0.3 s at import

    loops = position, stiffness = _pid_loops(controller)
    gains = np.array([getattr(loop, name) for loop in loops for name in _GAINS])
    searched = np.flatnonzero(gains)
    if searched.size == 0:
        raise RangeError("all gains are zero", remedy="start the search from gains above (or below) zero")
    start = np.log10(np.abs(gains[searched]))

    sampled_wishes = [sampled(reference, duration, control_period)[1] for reference in references]
    wishes = jax.tree.map(lambda *each: jnp.stack(each), *sampled_wishes)
    plant, controller, initial, period, scales = numeric((plant, controller, initial, control_period, cost))

    def costs(columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """The cost of each column of logarithms."""
        candidates = np.tile(gains, (columns.shape[1], 1))
        candidates[:, searched] = np.sign(gains[searched]) * 10**columns.T
        padding = -len(candidates) % population  # one shape, one compilation
        padded = np.concatenate([candidates, np.tile(gains, (padding, 1))])
        nonlocal evaluated
        evaluated += len(candidates)
        return np.asarray(_costs(plant, controller, wishes, initial, period, scales, jnp.asarray(padded), substeps))[
            : len(candidates)
        ]

    done = evaluated = 0

    def report(*_: object) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(min(done / generations, 1.0))

    found = differential_evolution(
        costs,
        [(x - decades, x + decades) for x in start],
        x0=start,
        init=_initial_population(start, decades, population, seed),  # type: ignore[arg-type]  # an array is allowed
        maxiter=generations,
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
        rng=seed,
        callback=report,
    )
    best = gains.copy()
    best[searched] = np.sign(gains[searched]) * 10**found.x
    names = [f"{loop}.{name}" for loop in ("position", "stiffness") for name in _GAINS]
    near_bound = np.abs(found.x - start) > 0.99 * decades
    return Tuned(
        position=_with_gains(position, best[:3].tolist()),
        stiffness=_with_gains(stiffness, best[3:].tolist()),
        cost=float(found.fun),
        cost_before=float(costs(start[:, None])[0]),
        evaluated=evaluated,
        at_bound=tuple(names[i] for i in searched[near_bound]),
    )


_GAINS = ("kp", "ki", "kd")


def _with_gains(loop: PID, gains: Sequence[float] | NDArray[np.float64] | Array) -> PID:
    return eqx.tree_at(lambda pid: (pid.kp, pid.ki, pid.kd), loop, tuple(gains))


def _initial_population(start: NDArray, decades: float, population: int, seed: int) -> NDArray[np.float64]:
    spread = np.random.default_rng(seed).uniform(-decades, decades, (population, start.size))
    return start + spread


@compiled_batch
def _costs(
    plant: JointPlant,
    controller: PositionStiffnessControl,
    wishes: Setpoint,
    initial: PlantState,
    period: Array,
    scales: Cost,
    candidates: Array,
    substeps: int,
) -> Array:
    """The cost of each of many candidates, shape (many, 6), over wishes of shape (references, periods)."""
    position, stiffness = _pid_loops(controller)

    def errors(gains: Array, wish: Setpoint) -> Array:
        loops = (_with_gains(position, gains[:3]), _with_gains(stiffness, gains[3:]))
        candidate = eqx.tree_at(lambda c: (c.position, c.stiffness), controller, loops)
        _, record = episode(plant, candidate, wish, initial, period, substeps)
        angle_error = record.state.angle - wish.angle
        stiffness_error = plant.joint.stiffness(record.state.angle, record.state.pressures) - wish.stiffness
        return rms(angle_error) / scales.angle_scale + rms(stiffness_error) / scales.stiffness_scale

    # One flat axis of lanes, every candidate with every wish: nested axes would vectorise along the short one.
    both = jnp.concatenate([candidates, candidates * scales.gain_margin])
    references, many = wishes.angle.shape[0], both.shape[0]
    lanes = jax.tree.map(lambda wish: jnp.repeat(wish, many, axis=0), wishes)
    cost = jax.vmap(errors)(jnp.tile(both, (references, 1)), lanes)
    total = jnp.max(jnp.sum(cost.reshape(references, 2, -1), axis=0), axis=0)
    return jnp.where(jnp.isfinite(total), total, _LOST)


def _pid_loops(controller: PositionStiffnessControl) -> tuple[PID, PID]:
    position, stiffness = controller.position, controller.stiffness
    if not (isinstance(position, PID) and isinstance(stiffness, PID)):
        raise TypeError("tune_pid takes a controller whose two loops are PID")
    return position, stiffness
