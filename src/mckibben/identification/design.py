"""The design matrix of a law: how its force changes with each of its parameters, by forward differentiation.

No law writes out its basis. For the parameters in which the force is linear the derivative *is* the exact
design matrix, at any value of them; for the others it is the Jacobian of a non-linear fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

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
    contraction = np.asarray(contraction, np.float64)
    pressure = np.asarray(pressure, np.float64)
    if not names:
        return np.empty((len(contraction), 0))
    values = np.array([float(getattr(law, name)) for name in names])
    return np.asarray(_columns_of(law, values, contraction, pressure, names=tuple(names))).T


@partial(jax.jit, static_argnames="names")
def _columns_of(law: ForceLaw, values: Array, contraction: Array, pressure: Array, *, names: tuple[str, ...]) -> Array:
    return _force_and_columns(lambda given: dataclasses.replace(law, **given), names, values, contraction, pressure)[1]


@partial(jax.jit, static_argnames="law_type")
def design_and_residuals(
    law_type: type[ForceLaw],
    values: ArrayLike,
    contraction: ArrayLike,
    pressure: ArrayLike,
    force: ArrayLike,
    weights: ArrayLike,
) -> Array:
    """The columns of the design matrix of all parameters, and under them measured minus given force [N], all weighted.

    Parameters
    ----------
    law_type, values
        A kind of law and its parameters in SI, shape (parameters,), linear ones first.
    contraction, pressure, force, weights
        Shape (n,): [-], [Pa], [N], [-].

    Returns
    -------
    array
        Shape (parameters + 1, n).
    """
    names = tuple(p.name for p in law_type.parameters())
    modelled, columns = _force_and_columns(lambda given: law_type(**given), names, values, contraction, pressure)
    return jnp.concatenate([columns, (jnp.asarray(force) - modelled)[None]]) * jnp.asarray(weights)


def _force_and_columns(
    law: Callable[[dict[str, Any]], ForceLaw], names: tuple[str, ...], values: Any, contraction: Any, pressure: Any
) -> tuple[Array, Array]:
    def force(values: Array) -> Array:
        return law(dict(zip(names, values, strict=True))).force(contraction, pressure)

    def column(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(force, (values,), (direction,))

    return jax.vmap(column, out_axes=(None, 0))(jnp.eye(len(names)))
