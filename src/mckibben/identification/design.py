"""The design matrix of a law: how its force changes with each of its parameters, by forward differentiation.

No law writes out its basis. For the parameters in which the force is linear the derivative *is* the exact
design matrix, at any value of them; for the others it is the Jacobian of a non-linear fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from mckibben.muscle import ForceLaw


def design_matrix(
    law: ForceLaw, names: Sequence[str], contraction: ArrayLike, pressure: ArrayLike
) -> NDArray[np.float64]:
    """The derivative of the force with respect to named parameters.

    Parameters
    ----------
    law
        A law with values for all parameters; the linear ones may have any.
    names
        Parameters of the law, in the order of the columns.
    contraction, pressure
        Shape (n,): [-], [Pa].

    Returns
    -------
    ndarray
        Shape (n, len(names)): [N] per SI unit of the parameter.

    Examples
    --------
    Eq. 2 at 10 % and 2 bar, with a decay of 0.1 per percent: 1, p, eps, exp(-mu eps).

    >>> from mckibben.muscle import ExponentialLaw
    >>> law = ExponentialLaw(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, decay=10.0)
    >>> design_matrix(law, ["a1", "a2", "b1", "c1"], [0.1], [2e5]).round(4)
    array([[1.000e+00, 2.000e+05, 1.000e-01, 3.679e-01]])
    """
    return force_and_design(law, names, contraction, pressure)[1]


def force_and_design(
    law: ForceLaw, names: Sequence[str], contraction: ArrayLike, pressure: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The force [N], shape (n,), and its design matrix, from one pass; arguments as for `design_matrix`."""
    contraction = np.asarray(contraction, np.float64)
    pressure = np.asarray(pressure, np.float64)
    if not names:
        return np.asarray(law.force(contraction, pressure)), np.empty((len(contraction), 0))
    values = np.array([float(getattr(law, name)) for name in names])
    force, columns = _force_and_columns(law, values, contraction, pressure, names=tuple(names))
    return np.asarray(force), np.asarray(columns).T


@partial(jax.jit, static_argnames="names")
def _force_and_columns(
    law: ForceLaw, values: Array, contraction: Array, pressure: Array, *, names: tuple[str, ...]
) -> tuple[Array, Array]:
    def force(values: Array) -> Array:
        parameters = dict(zip(names, values, strict=True))
        return dataclasses.replace(law, **parameters).force(contraction, pressure)

    def column(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(force, (values,), (direction,))

    return jax.vmap(column, out_axes=(None, 0))(jnp.eye(len(names)))
