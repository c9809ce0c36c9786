"""Polynomials for functions missing from C libraries, or missing in vectorised form."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from mckibben.numerics import elementary

_NEAR = (2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087, -0.00125372503, -0.00417768164,
         0.246640727, 1.50140941)  # fmt: skip
_FAR = (-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773, -0.0076224613, 0.00943887047,
        1.00167406, 2.83297682)  # fmt: skip


def tanh(x: Array) -> Any:
    """Hyperbolic tangent, absolute error below 2e-16."""
    power = elementary.exp(-2 * jnp.abs(x))
    value = (1 - power) / (1 + power)
    return jnp.where(x < 0, -value, value)


def log1p(x: Array) -> Any:
    """Natural logarithm of 1 + x, a positive normal number (fdlibm), relative error below 1e-16."""
    x = 1.0 + x
    bits = lax.bitcast_convert_type(x, jnp.int64)
    shifted = bits + _ABOVE_HALF_ROOT
    exponent = ((shifted >> 52) - 1023).astype(x.dtype)
    f = lax.bitcast_convert_type((shifted & _MANTISSA) + _HALF_ROOT, jnp.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    rest = s * (half + z * elementary.polynomial(z, _LOG)) + exponent * _LN2[1]
    return exponent * _LN2[0] - ((half - rest) - f)


_MANTISSA = 0x000FFFFFFFFFFFFF
_HALF_ROOT = 0x3FE6A09E00000000  # of 1/2
_ABOVE_HALF_ROOT = 0x3FF0000000000000 - _HALF_ROOT
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # leading bits, rest
_LOG = (6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
        1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01)  # fmt: skip


def erf_inv(x: Array) -> Any:
    """Inverse error function as in XLA's single precision (Giles 2012), accurate to 3e-7 except near 1."""
    w = -jnp.log1p(-x * x)
    near, far = w - 2.5, jnp.sqrt(w) - 3.0
    p, q = (functools.reduce(lambda sum_, c: sum_ * y + c, cs) for y, cs in ((near, _NEAR), (far, _FAR)))
    return jnp.where(w < 5.0, p, q) * x


def log1p_single(x: Array) -> Any:
    """Natural logarithm of 1 + x, a positive normal 32-bit number (Cephes), relative error below 1e-7."""
    x = 1 + x
    bits = lax.bitcast_convert_type(x, jnp.int32) + _ABOVE_HALF_ROOT_32
    exponent = ((bits >> 23) - 127).astype(x.dtype)
    f = lax.bitcast_convert_type((bits & 0x007FFFFF) + _HALF_ROOT_32, jnp.float32) - 1
    z = f * f
    rest = f * z * elementary.polynomial(f, _LOG_32) + exponent * -2.12194440e-4
    return f + (rest - z / 2) + exponent * 0.693359375


_HALF_ROOT_32 = 0x3F3504F3  # of 1/2
_ABOVE_HALF_ROOT_32 = 0x3F800000 - _HALF_ROOT_32
_LOG_32 = (3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1, 1.4249322787e-1, -1.2420140846e-1,
           1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2)  # fmt: skip
