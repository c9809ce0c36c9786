"""Our own batches and gradients: the product's functions, and the bare loop under them.

The bare loop runs episodes that keep no record, only two numbers each: what the product's functions cost beyond it is
theirs. Everything here binds a problem; what it returns runs it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import DTypeLike, NDArray
from reference import PERIOD, REFERENCE, SUBSTEPS, Problem, gains_of, with_gains, with_mass

from mckibben.control import Controller, Setpoint
from mckibben.control.base import Measurement
from mckibben.numerics.compiled import compiled_batch, numeric
from mckibben.numerics.integrate import rk4
from mckibben.plant import JointPlant, PlantState

CHUNK = 256  # lanes at once: what a core's cache holds
METRICS = ("angle_rmse", "stiffness_rmse")
GAINS = tuple(f"controller.{loop}.{gain}" for loop in ("position", "stiffness") for gain in ("kp", "ki", "kd"))


def bare_metrics(
    plant: JointPlant,
    controller: Controller,
    wishes: Setpoint,
    start: PlantState,
    period: ArrayLike,
    *,
    checkpoint: bool = False,
) -> tuple[Array, Array]:
    """The RMS errors of angle and stiffness of an episode; `mckibben.simulation.loop.episode` without its record."""

    def control_period(carry: tuple[Any, ...], wish: Setpoint) -> tuple[tuple[Any, ...], None]:
        state, memory, angle_sum, stiffness_sum = carry
        memory, wanted = controller.step(memory, wish, Measurement(state.angle, state.pressures), period)
        commands = plant.limited(wanted)
        switched = plant.switched(state, commands)
        step = period / SUBSTEPS
        following = lax.fori_loop(0, SUBSTEPS, lambda _, x: rk4(lambda s: plant.rate(s, commands), x, step), switched)
        estimate = controller.telemetry(memory)["stiffness_estimate"]
        angle_sum = angle_sum + (wish.angle - state.angle) ** 2
        stiffness_sum = stiffness_sum + (wish.stiffness - estimate) ** 2
        return (following, memory, angle_sum, stiffness_sum), None

    memory = controller.init(Measurement(start.angle, start.pressures))
    zero = jnp.zeros_like(start.angle)
    body = jax.checkpoint(control_period) if checkpoint else control_period
    (_, _, angle_sum, stiffness_sum), _ = lax.scan(body, (start, memory, zero, zero), wishes)
    periods = len(wishes.angle)
    return jnp.sqrt(angle_sum / periods), jnp.sqrt(stiffness_sum / periods)


@compiled_batch
def _chunk(
    plant: JointPlant, controller: Controller, wishes: Setpoint, start: PlantState, period: Array, masses: Array
) -> tuple[Array, Array]:
    return jax.vmap(lambda mass: bare_metrics(with_mass(plant, mass), controller, wishes, start, period))(masses)


def bare_batch(
    problem: Problem, masses: NDArray[np.float64], dtype: DTypeLike, *, cores: int = 1, chunk: int = CHUNK
) -> Callable[[], NDArray[Any]]:
    """One episode for each external load [kg]: two RMS errors a lane, shape (lanes, 2).

    All cores: a thread each, since XLA lets go of the GIL while a compiled program runs.
    """
    bound = _cast(numeric((problem.plant, problem.pid, problem.wishes, problem.start, PERIOD)), dtype)
    chunks = [jnp.asarray(part, dtype) for part in np.split(masses, range(chunk, len(masses), chunk))]

    def one(part: Array) -> NDArray[Any]:
        return np.stack(jax.block_until_ready(_chunk(*bound, part)), axis=1)

    if cores == 1:
        return lambda: np.concatenate([one(part) for part in chunks])
    pool = ThreadPoolExecutor(cores)
    return lambda: np.concatenate(list(pool.map(one, chunks)))


def bare_gradient(problem: Problem, *, reverse: bool = False) -> Callable[[], NDArray[np.float64]]:
    """The derivative of the sum of both RMS errors with respect to six gains.

    Forward mode takes six tangents through the episode at once; reverse mode keeps one state a control period and works
    each period out again on its way back.
    """

    def cost(gains: Array, plant: JointPlant, controller: Any, wishes: Setpoint, start: PlantState, period: Array):
        controller = with_gains(controller, gains)
        return sum(bare_metrics(plant, controller, wishes, start, period, checkpoint=reverse))

    compiled = eqx.filter_jit(jax.grad(cost) if reverse else jax.jacfwd(cost))
    bound = numeric((problem.plant, problem.pid, problem.wishes, problem.start, PERIOD))
    gains = jnp.asarray(gains_of(problem.pid))
    return lambda: np.asarray(jax.block_until_ready(compiled(gains, *bound)))


def batch(
    problem: Problem, masses: NDArray[np.float64], dtype: DTypeLike, *, cores: int = 1, chunk: int | None = None
) -> Callable[[], NDArray[Any]]:
    """As `bare_batch`, by `simulate_many`."""
    from mckibben.simulation.batch import simulate_many

    def run() -> NDArray[Any]:
        found = simulate_many(
            problem.plant,
            problem.pid,
            REFERENCE,
            over={"plant.load.mass2": masses},
            initial=problem.start,
            duration=problem.periods * PERIOD,
            metrics=METRICS,
            precision=dtype,
            chunk=chunk,
            workers=cores,
        )
        return np.stack([found.metrics[name] for name in METRICS], axis=1)

    return run


def gradient(problem: Problem, *, reverse: bool = False) -> Callable[[], NDArray[np.float64]]:
    """As `bare_gradient`, by `differentiate`."""
    from mckibben.simulation.derivatives import Mode, differentiate

    mode = Mode.REVERSE if reverse else Mode.FORWARD

    def run() -> NDArray[np.float64]:
        found = differentiate(
            problem.plant,
            problem.pid,
            REFERENCE,
            GAINS,
            metrics=METRICS,
            duration=problem.periods * PERIOD,
            initial=problem.start,
            mode=mode,
        ).gradients
        return np.array([sum(float(found[metric][gain]) for metric in METRICS) for gain in GAINS])

    return run


def _cast(tree: Any, dtype: DTypeLike) -> Any:
    return jax.tree.map(lambda x: x.astype(dtype) if eqx.is_inexact_array(x) else x, tree)
