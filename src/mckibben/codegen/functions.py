"""C functions for single-run programs: calls to the C library save all registers and take longer.

Sine and cosine are the polynomials of `numerics.elementary`; `exp` uses a table, a shorter chain of operations.
"""

from __future__ import annotations

import decimal
import functools
import math
from collections.abc import Sequence
from dataclasses import replace

from mckibben.codegen.languages import c_language
from mckibben.codegen.writer import Language
from mckibben.numerics import elementary

_POINTS = 128  # of the table: powers of two to multiples of 1 / _POINTS


def native_language() -> Language:
    """C with the functions of `definitions`."""
    language = c_language()
    own = {"exp": "exp_of", "sin": "sin_of", "cos": "cos_of", "tanh": "tanh_of"}
    return replace(language, functions={**language.functions, **own})


@functools.cache
def definitions() -> str:
    """Functions that `native_language` calls."""
    k = elementary.DOUBLE
    return f"""
static const double POWERS[{_POINTS}][2] = {{{", ".join(f"{{{high!r}, {low!r}}}" for high, low in _powers())}}};

static __attribute__((noinline, const)) double exp_of(double x)
{{
    const double shifted = x * {_POINTS * math.log2(math.e)!r} + {k.integer_magic!r}, n = shifted - {k.integer_magic!r};
    const double r = (x - n * {k.ln2[0] / _POINTS!r}) - n * {k.ln2[1] / _POINTS!r};
    int64_t whole, bits;
    memcpy(&whole, &shifted, sizeof whole);
    const double *power = POWERS[whole & {_POINTS - 1}];
    const double rest = (power[1] + r) + r * r * {_estrin("r", [1 / math.factorial(n) for n in range(2, 6)])};
    double y = power[0] + power[0] * rest;
    memcpy(&bits, &y, sizeof bits);
    bits += (whole >> {int(math.log2(_POINTS))}) << {k.mantissa_bits};
    memcpy(&y, &bits, sizeof y);
    return x < {k.lowest_exp!r} ? 0.0 : x > {k.highest_exp!r} ? INFINITY : y;
}}

static __attribute__((noinline, const)) double tanh_of(double x)
{{
    const double y = exp_of(-2 * fabs(x));
    return copysign((1 - y) / (1 + y), x);
}}

static __attribute__((noinline, const)) double _Complex sincos_of(double x)
{{
    const double shifted = x * {2 / math.pi!r} + {k.integer_magic!r}, n = shifted - {k.integer_magic!r};
    const double r = (x - n * {k.half_pi[0]!r}) - n * {k.half_pi[1]!r}, z = r * r;
    const double sine = r + r * z * {_estrin("z", k.sin)};
    const double cosine = 1 - (z / 2 - z * z * {_estrin("z", k.cos)});
    int64_t quadrant;
    memcpy(&quadrant, &shifted, sizeof quadrant);
    if ((quadrant & 3) == 0) return __builtin_complex(sine, cosine);
    const double a = quadrant & 1 ? cosine : sine, b = quadrant & 1 ? sine : cosine;
    return __builtin_complex(quadrant & 2 ? -a : a, (quadrant + 1) & 2 ? -b : b);
}}

static inline double sin_of(double x) {{ return __real__ sincos_of(x); }}
static inline double cos_of(double x) {{ return __imag__ sincos_of(x); }}
"""


def _powers() -> list[tuple[float, float]]:
    """Powers of two, and their relative rounding errors."""
    with decimal.localcontext(prec=40):
        exact = [decimal.Decimal(2) ** (decimal.Decimal(n) / _POINTS) for n in range(_POINTS)]
        return [(float(one), float(one / decimal.Decimal(float(one)) - 1)) for one in exact]


def _estrin(x: str, coefficients: Sequence[float]) -> str:
    """Polynomial, constant term first, evaluated as by `elementary.polynomial`."""
    terms, power = [repr(one) for one in coefficients], x
    while len(terms) > 1:
        paired = [f"({low} + {high} * {power})" for low, high in zip(terms[::2], terms[1::2], strict=False)]
        terms, power = paired + terms[2 * len(paired) :], f"({power} * {power})"
    return terms[0]
