"""Fixed-step integration of a state held in a pytree of scalars."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.numerics.many import rolled

State = TypeVar("State")


def rk4(
    rate: Callable[..., State], state: State, step: ArrayLike, inputs: tuple[tuple[Any, ...], ...] = ((), (), ())
) -> State:
    """One step of the classical fourth-order Runge-Kutta method.

    In a program for many runs side by side (`mckibben.numerics.many`) its stages are a loop; results differ by
    rounding.

    Parameters
    ----------
    rate
        The state's derivative with respect to time; same structure as the state.
    state
        Any pytree. Leave it a tuple of scalars: stacking it into a vector is slower on every device.
    step
        The length of the step [s].
    inputs
        What `rate` takes beside the state, at the beginning, the middle and the end of the step.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> float(rk4(lambda x: -x, jnp.asarray(1.0), 0.1))  # exp(-0.1) = 0.904837418...
    0.9048375
    """

    def moved(slope: State, length: ArrayLike) -> State:
        return jax.tree.map(lambda x, dx: x + length * dx, state, slope)

    if rolled():
        kind = jnp.result_type(step)
        places, weights = (jnp.asarray(row, kind) for row in ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)))

        def next_stage(i: Array, carry: tuple[State, State]) -> tuple[State, State]:
            slope, total = carry
            here = jax.tree.map(lambda b, m, e: jnp.where(i == 0, b, jnp.where(i == 3, e, m)), *inputs)
            slope = rate(moved(slope, places[i] * step), *here)
            return slope, jax.tree.map(lambda t, dx: t + weights[i] * step * dx, total, slope)

        return lax.fori_loop(0, 4, next_stage, (jax.tree.map(jnp.zeros_like, state), state))[1]

    # The barrier keeps XLA from computing parts of one stage's derivative again inside the next stage's fusion.
    def stage(at: State, given: tuple[Any, ...]) -> State:
        return lax.optimization_barrier(rate(at, *given))

    beginning, middle, end = inputs
    k1 = stage(state, beginning)
    k2 = stage(moved(k1, step / 2), middle)
    k3 = stage(moved(k2, step / 2), middle)
    k4 = stage(moved(k3, step), end)
    return jax.tree.map(lambda x, a, b, c, d: x + step / 6 * (a + 2 * (b + c) + d), state, k1, k2, k3, k4)
