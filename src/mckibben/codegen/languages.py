"""Definitions of C99 and JavaScript for the writer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from mckibben.codegen.graph import Kind
from mckibben.codegen.writer import Language

_SAME = ("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
         "sqrt", "floor", "ceil", "cbrt", "pow")  # fmt: skip


def literals(nan: str, infinity: str, *, single: bool = False, suffix: str = "") -> Callable[[float, Kind], str]:
    """Text of a number of a kind; those of 32 bits have nine digits, and no subnormal ones.

    Parameters
    ----------
    nan, infinity
        Names of these numbers in the language.
    single, suffix
        Whether real numbers have 32 bits, and what follows their digits.

    Examples
    --------
    >>> text = literals("NAN", "INFINITY", single=True, suffix="f")
    >>> text(0.1, Kind.REAL), text(-1e39, Kind.REAL), text(1e-40, Kind.REAL), text(True, Kind.BOOLEAN)
    ('0.1f', '-INFINITY', '0.0f', 'true')
    """
    limits = np.finfo(np.float32 if single else float)
    largest, smallest = float(limits.max), float(limits.tiny)

    def literal(number: float, kind: Kind) -> str:
        if kind is not Kind.REAL:
            return str(number) if kind is Kind.INTEGER else "true" if number else "false"
        if math.isnan(number):
            return nan
        if abs(number) > largest:
            return infinity if number > 0 else f"-{infinity}"
        if single:
            number = float(f"{number:.9g}") if abs(number) >= smallest else 0.0
        return f"{number!r}{suffix}"

    return literal


def c_language(real: str = "double") -> Language:
    """C99 with `double` or `float`.

    >>> c_language("float").functions["exp"], c_language().literal(0.1, Kind.REAL)
    ('expf', '0.1')
    """
    suffix = "" if real == "double" else "f"
    types = {Kind.REAL: real, Kind.INTEGER: "int64_t", Kind.BOOLEAN: "bool"}

    def conversion(text: str, source: Kind, target: Kind) -> str:
        if target is Kind.BOOLEAN:
            return f"{text} != 0"
        return f"({types[target]}){text}"

    def array(name: str, kind: Kind, size: int, elements: Sequence[str] | None, constant: bool) -> str:
        if elements is None:
            return f"{types[kind]} {name}[{size}];"
        return f"{'static ' if constant else ''}const {types[kind]} {name}[{size}] = {{{', '.join(elements)}}};"

    def function(name: str, arguments: str, result: str) -> str:
        typed = ", ".join(f"{real} {argument}" for argument in arguments.split(", "))
        return f"static {real} {name}{suffix}({typed})\n{{\n    return {result};\n}}\n"

    return Language(
        types=types,
        constants={kind: f"const {name}" for kind, name in types.items()},
        functions={
            **{name: name + suffix for name in _SAME},
            "abs": "fabs" + suffix,
            "round": "rint" + suffix,
            "rem": "fmod" + suffix,
            "is_finite": "isfinite",
            "bits": "bits",
            "from_bits": "from_bits",
            "from_bits_32": "from_bits_32",
            "single": "single",
            **{
                name: f"{helper}{suffix}" for name, helper in (("max", "maximum"), ("min", "minimum"), ("sign", "sign"))
            },
        },
        helpers={
            "bits": (
                "static int64_t bits(double x)\n{\n    int64_t i;\n    memcpy(&i, &x, sizeof i);\n    return i;\n}\n"
            ),
            "from_bits": (
                "static double from_bits(int64_t i)\n{\n    double x;\n    memcpy(&x, &i, sizeof x);\n"
                "    return x;\n}\n"
            ),
            "from_bits_32": (
                "static double from_bits_32(int64_t i)\n{\n    const uint32_t word = (uint32_t)i;\n    float x;\n"
                "    memcpy(&x, &word, sizeof x);\n    return x;\n}\n"
            ),
            "single": "static double single(double x)\n{\n    return (float)x;\n}\n",
            # NaN if either is NaN, unlike fmax; the order lets compilers use their instruction for `x > y ? x : y`
            f"maximum{suffix}": function("maximum", "x, y", "x != x ? x : x > y ? x : y"),
            f"minimum{suffix}": function("minimum", "x, y", "x != x ? x : x < y ? x : y"),
            f"sign{suffix}": function("sign", "x", f"({real})((x > 0) - (x < 0))"),
        },
        literal=literals("NAN", "INFINITY", single=bool(suffix), suffix=suffix),
        conversion=conversion,
        array=array,
    )


def _js_conversion(text: str, source: Kind, target: Kind) -> str:
    """Text of a number of another kind in JavaScript, whose numbers are all real."""
    if target is Kind.BOOLEAN:
        return f"{text} !== 0"
    if source is Kind.BOOLEAN:
        return f"Number({text})"
    return f"Math.trunc({text})" if target is Kind.INTEGER else f"+{text}"


def _js_array(name: str, kind: Kind, size: int, elements: Sequence[str] | None, constant: bool) -> str:
    """Declaration of an array in JavaScript."""
    content = f"new Array({size})" if elements is None else f"[{', '.join(elements)}]"
    return f"const {name} = {content};"


JAVASCRIPT = Language(
    types=dict.fromkeys(Kind, "let"),
    constants=dict.fromkeys(Kind, "const"),
    functions={
        **{name: f"Math.{name}" for name in (*_SAME, "abs", "sign", "max", "min")},
        "round": "rint",
        "rem": "rem",
        "is_finite": "Number.isFinite",
        "single": "Math.fround",
        "from_bits_32": "from_bits_32",
    },
    helpers={
        "from_bits_32": (
            "const view = new DataView(new ArrayBuffer(4));\nfunction from_bits_32(word) {\n"
            "    view.setUint32(0, word);\n    return view.getFloat32(0);\n}\n"
        ),
        "rint": (
            "function rint(x) {\n    const r = Math.round(x);\n"
            "    return Math.abs(x % 1) === 0.5 && r % 2 !== 0 ? r - 1 : r;\n}\n"
        ),
        "rem": "function rem(x, y) {\n    return x % y;\n}\n",
    },
    literal=literals("NaN", "Infinity"),
    conversion=_js_conversion,
    array=_js_array,
)
