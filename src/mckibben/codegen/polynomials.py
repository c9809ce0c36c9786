"""Functions that the libraries of C lack, or lack for vectors, by polynomials."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp

from mckibben.numerics import elementary

_NEAR = (2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087, -0.00125372503, -0.00417768164,
         0.246640727, 1.50140941)  # fmt: skip
_FAR = (-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773, -0.0076224613, 0.00943887047,
        1.00167406, 2.83297682)  # fmt: skip


def tanh(x: Any) -> Any:
    """Hyperbolic tangent, right to an absolute 2e-16."""
    power = elementary.exp(-2 * jnp.abs(x))
    return jnp.sign(x) * ((1 - power) / (1 + power))


def erf_inv(x: Any) -> Any:
    """Inverse error function (Giles 2012, single precision), right to 3e-7."""
    w = -jnp.log1p(-x * x)
    near, far = w - 2.5, jnp.sqrt(w) - 3.0
    p, q = (functools.reduce(lambda sum_, c: sum_ * y + c, cs) for y, cs in ((near, _NEAR), (far, _FAR)))
    return jnp.where(w < 5.0, p, q) * x
