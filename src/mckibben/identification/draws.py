"""The forces of many laws of a kind at once: what draws of parameters mean for the force."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from mckibben.muscle import ForceLaw


def law_forces(
    law_type: type[ForceLaw], draws: ArrayLike, contraction: ArrayLike, pressure: ArrayLike
) -> NDArray[np.float64]:
    """The force of each of many laws.

    Parameters
    ----------
    law_type, draws
        A kind of law and parameters in SI, shape (draws, parameters), in its order.
    contraction, pressure
        Where [-], [Pa]; they broadcast.

    Returns
    -------
    ndarray
        Shape (draws, ...) [N].

    Examples
    --------
    >>> from mckibben.muscle import ExponentialLaw
    >>> rows = [[1.0, 0, 0, 0, 0, 0, 30.0], [0, 1e-3, 0, 0, 0, 0, 30.0]]
    >>> law_forces(ExponentialLaw, rows, [0.0, 0.1], 2e5)
    array([[  1.,   1.],
           [200., 200.]])
    """
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    return np.asarray(_forces(law_type, np.asarray(draws, np.float64), contraction, pressure))


@partial(jax.jit, static_argnames="law_type")
def _forces(law_type: type[ForceLaw], draws: Array, contraction: Array, pressure: Array) -> Array:
    names = [p.name for p in law_type.parameters()]

    def force(values: Array) -> Array:
        return law_type(**dict(zip(names, values, strict=True))).force(contraction, pressure)

    return jax.vmap(force)(draws)
