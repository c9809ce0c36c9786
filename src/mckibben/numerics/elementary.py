"""`exp`, `sin` and `cos` as polynomials on the CPU, in 32 and 64 bits.

Compared with XLA's own in jaxlib 0.10.2: `exp` takes 17 instead of 25 ns in a chain of scalars and 0.73 instead of
1.04 ns in 512-bit vectors (an episode is 16 % faster), sine and cosine together 2.3 instead of 15.5 ns.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, ArrayLike, Float, PyTree

Number: TypeAlias = float | Array
"""A float, an array or a tracer."""

Term = TypeVar("Term", float, Array)


def floating(x: ArrayLike) -> Float[Array, "..."]:
    """Array of floats in its given precision; integers get the default precision.

    >>> floating(3).dtype.name, floating(jnp.float32(3)).dtype.name
    ('float64', 'float32')
    """
    x = jnp.asarray(x)
    return x if jnp.issubdtype(x.dtype, jnp.floating) else x.astype(jnp.result_type(float))


class _Constants(NamedTuple):
    """Constants of the range reductions and polynomials in one precision."""

    integer: DTypeLike
    mantissa_bits: int
    integer_magic: float  # added to an integral float, it leaves the integer in the low bits of the mantissa
    lowest_exp: float  # below it exp is 0 (subnormal results are flushed)
    highest_exp: float  # above it exp overflows
    ln2: tuple[float, float]  # leading bits, rest
    half_pi: tuple[float, float]  # leading bits, rest
    exp: tuple[float, ...]
    sin: tuple[float, ...]
    cos: tuple[float, ...]


DOUBLE = _Constants(
    integer=jnp.int64,
    mantissa_bits=52,
    integer_magic=6755399441055744.0,  # 1.5 * 2^52
    lowest_exp=-708.0,
    highest_exp=709.782712893384,
    ln2=(6.93147180369123816490e-01, 1.90821492927058770002e-10),
    half_pi=(1.57079632673412561417, 6.07710050650619224932e-11),
    exp=(
        0.5,
        0.1666666666666667,
        0.04166666666666667,
        0.008333333333326112,
        0.001388888888888373,
        0.0001984126987490126,
        2.4801587325605324e-05,
        2.7557255297969643e-06,
        2.755727357010214e-07,
        2.5105259538448494e-08,
        2.0914717341716378e-09,
    ),
    sin=(
        -1.66666666666666324348e-01,
        8.33333333332248946124e-03,
        -1.98412698298579493134e-04,
        2.75573137070700676789e-06,
        -2.50507602534068634195e-08,
        1.58969099521155010221e-10,
    ),
    cos=(
        4.16666666666666019037e-02,
        -1.38888888888741095749e-03,
        2.48015872894767294178e-05,
        -2.75573143513906633035e-07,
        2.08757232129817482790e-09,
        -1.13596475577881948265e-11,
    ),
)

_F32 = _Constants(
    integer=jnp.int32,
    mantissa_bits=23,
    integer_magic=12582912.0,  # 1.5 * 2^23
    lowest_exp=-86.9,
    highest_exp=88.72283,
    ln2=(0.693359375, -2.12194440e-4),
    half_pi=(1.5703125, 4.838267948966e-4),
    exp=(
        0.5000000013498178,
        0.16666666681659179,
        0.04166646460202654,
        0.008333310889582076,
        0.0013933685862617174,
        0.00019891030654370327,
    ),
    sin=(-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4),
    cos=(4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5),
)


def exp(x: ArrayLike) -> Float[Array, "..."]:
    """Exponential, elementwise, to a few units in the last place of 32 or 64 bits.

    With n the integer nearest to x / ln 2, exp x = 2^n exp(x - n ln 2), the latter by a polynomial. Subnormal results
    are 0. Derivatives of any order exist. Raises `TypeError` for other precisions.

    Examples
    --------
    >>> round(float(exp(1.0)), 12), float(exp(-800.0))
    (2.718281828459, 0.0)
    """
    return _exp(floating(x))


def sin(x: ArrayLike) -> Float[Array, "..."]:
    """Sine, elementwise; see `sincos`."""
    return _sincos(floating(x))[0]


def cos(x: ArrayLike) -> Float[Array, "..."]:
    """Cosine, elementwise; see `sincos`."""
    return _sincos(floating(x))[1]


def sincos(x: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Sine and cosine, at the cost of one, absolute error below 3e-16 for angles of a few hundred radians.

    The angle [rad] is reduced to [-pi/4, pi/4] by multiples of pi/2 in two parts (Cody and Waite); the polynomials are
    those of fdlibm in 64 bits and of Cephes (S. L. Moshier) in 32.

    Examples
    --------
    >>> sine, cosine = sincos(math.pi / 6)
    >>> round(float(sine), 12), round(float(cosine) ** 2, 12)
    (0.5, 0.75)
    """
    return _sincos(floating(x))


@jax.custom_jvp
def _exp_rule(x: Array) -> Array:
    return _exp_polynomial(x) if _on_cpu() else jnp.exp(x)


@_exp_rule.defjvp
def _exp_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    value = _exp(primals[0])
    return value, value * tangents[0]


@jax.custom_jvp
def _sincos_rule(x: Array) -> tuple[Array, Array]:
    return _sincos_polynomial(x) if _on_cpu() else (jnp.sin(x), jnp.cos(x))


@_sincos_rule.defjvp
def _sincos_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    sine, cosine = _sincos(primals[0])
    return (sine, cosine), (cosine * tangents[0], -sine * tangents[0])


def _on_cpu() -> bool:
    """Evaluated at tracing; `lax.platform_dependent` would trace both branches."""
    return jax.default_backend() == "cpu"


# Outside of compiled code each is compiled as one piece; inside they are inlined.
_exp = jax.jit(_exp_rule, inline=True)
_sincos = jax.jit(_sincos_rule, inline=True)


def _exp_polynomial(x: Array) -> Array:
    """Exponential by a polynomial of the remainder, whose exponent is increased by n."""
    k = _constants(x)
    n, bits = _rounded(x * math.log2(math.e), k)
    r = (x - n * k.ln2[0]) - n * k.ln2[1]
    value = 1 + (r + r * r * polynomial(r, k.exp))
    # times 2^n; at the highest n, 2^n is not a normal number, but `value` is below 1 there
    value = lax.bitcast_convert_type(_bits(value, k) + (bits << k.mantissa_bits), x.dtype)
    value = jnp.where(x < k.lowest_exp, 0.0, value)
    return jnp.where(x > k.highest_exp, jnp.inf, value)


def _sincos_polynomial(x: Array) -> tuple[Array, Array]:
    """Sine and cosine by polynomials of the reduced angle, exchanged and negated according to the quadrant."""
    k = _constants(x)
    n, quadrant = _rounded(x * (2 / math.pi), k)
    r = (x - n * k.half_pi[0]) - n * k.half_pi[1]
    z = r * r
    sine = r + r * z * polynomial(z, k.sin)
    cosine = 1 - (z / 2 - z * z * polynomial(z, k.cos))
    swap = (quadrant & 1) != 0
    sine, cosine = jnp.where(swap, cosine, sine), jnp.where(swap, sine, cosine)
    return (jnp.where((quadrant & 2) != 0, -sine, sine), jnp.where(((quadrant + 1) & 2) != 0, -cosine, cosine))


def _rounded(x: Array, k: _Constants) -> tuple[Array, Array]:
    """The nearest integer as a float, and the integer in the low bits of another."""
    # Conversions to integers do not vectorise everywhere. `reduce_precision` changes nothing, but keeps XLA from
    # cancelling the two constants.
    shifted = lax.reduce_precision(x + k.integer_magic, jnp.finfo(x.dtype).nexp, k.mantissa_bits)
    return shifted - k.integer_magic, _bits(shifted, k)


def _bits(x: Array, k: _Constants) -> Array:
    """Bits of numbers as integers."""
    return lax.bitcast_convert_type(x, k.integer)


def polynomial(x: Term, coefficients: tuple[float, ...]) -> Term:
    """Constant term first, by Estrin's scheme: short chains, so that a single simulation gains as well.

    Examples
    --------
    >>> polynomial(2.0, (1.0, 3.0, 5.0))  # 1 + 3 x + 5 x^2
    27.0
    """
    terms: list[PyTree] = list(coefficients)
    power = x
    while len(terms) > 1:
        paired = [low + high * power for low, high in zip(terms[::2], terms[1::2], strict=False)]
        terms = paired + terms[2 * len(paired) :]
        power = power * power
    return terms[0]


def _constants(x: Array) -> _Constants:
    """Constants for the precision of an array."""
    if x.dtype == jnp.float64:
        return DOUBLE
    if x.dtype == jnp.float32:
        return _F32
    raise TypeError(f"fast elementary functions take float32 and float64, not {x.dtype}")
