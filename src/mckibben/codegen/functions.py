"""C functions for programs of one run, in place of those of the C library.

Sine and cosine are the polynomials of `numerics.elementary`; `exp` uses a table, a shorter chain of operations.
"""

from __future__ import annotations

import decimal
import functools
import math
from collections.abc import Sequence
from dataclasses import replace

from mckibben.codegen.languages import c_language
from mckibben.codegen.templates import filled
from mckibben.codegen.writer import Language
from mckibben.numerics import elementary

_POINTS = 128  # of the table: powers of two to multiples of 1 / _POINTS


def native_language() -> Language:
    """C with the functions of `definitions`."""
    language = c_language()
    vectorised = {"exp": "exp_of", "sin": "sin_of", "cos": "cos_of", "tanh": "tanh_of"}
    return replace(language, functions={**language.functions, **vectorised})


@functools.cache
def definitions() -> str:
    """Functions that `native_language` calls: `exp`, `tanh`, `sin` and `cos`.

    `exp` is 2^(k/128) exp(r): the power from a table with its rounding error, the rest by a polynomial of degree 5.
    """
    k = elementary.DOUBLE
    numbers = {
        "points": _POINTS,
        "point_bits": int(math.log2(_POINTS)),
        "per_power": _POINTS * math.log2(math.e),
        "power_high": k.ln2[0] / _POINTS,
        "power_low": k.ln2[1] / _POINTS,
        "per_quadrant": 2 / math.pi,
        "quadrant_high": k.half_pi[0],
        "quadrant_low": k.half_pi[1],
        "magic": k.integer_magic,
        "mantissa_bits": k.mantissa_bits,
        "lowest_exp": k.lowest_exp,
        "highest_exp": k.highest_exp,
    }
    texts = {
        "powers": ", ".join(f"{{{high!r}, {low!r}}}" for high, low in _powers()),
        "exp": _estrin("r", [1 / math.factorial(n) for n in range(2, 6)]),
        "sin": _estrin("z", k.sin),
        "cos": _estrin("z", k.cos),
    }
    return filled("single.h", numbers | texts)


def _powers() -> list[tuple[float, float]]:
    """Powers of two, and their relative rounding errors."""
    with decimal.localcontext(prec=40):
        exact = [decimal.Decimal(2) ** (decimal.Decimal(n) / _POINTS) for n in range(_POINTS)]
        return [(float(power), float(power / decimal.Decimal(float(power)) - 1)) for power in exact]


def _estrin(x: str, coefficients: Sequence[float]) -> str:
    """Polynomial, constant term first, evaluated as by `elementary.polynomial`.

    >>> _estrin("x", [1.0, 2.0, 3.0])
    '((1.0 + 2.0 * x) + 3.0 * (x * x))'
    """
    terms, power = list(map(repr, coefficients)), x
    while len(terms) > 1:
        pairs = [f"({low} + {high} * {power})" for low, high in zip(terms[::2], terms[1::2], strict=False)]
        terms, power = pairs + terms[2 * len(pairs) :], f"({power} * {power})"
    return terms[0]
