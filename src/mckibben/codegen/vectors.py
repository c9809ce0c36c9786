"""Writer of batched programs: C with the vector extensions of gcc and clang.

Values equal in all lanes are 64-bit scalars; the others are vectors of `W` numbers, or of masks if boolean.
"""

from __future__ import annotations

from collections.abc import Sequence

from mckibben.codegen.graph import Kind, Scope, StoredArray, Value
from mckibben.codegen.languages import c_language
from mckibben.codegen.writer import Text, Writer

_VECTORS = {Kind.REAL: "V", Kind.INTEGER: "I", Kind.BOOLEAN: "I"}
_BROADCAST = {Kind.REAL: "real", Kind.INTEGER: "integer", Kind.BOOLEAN: "mask"}
_ATOM, _PREFIX = 8, 7
_SUFFIX = {Kind.REAL: "", Kind.INTEGER: "_integer", Kind.BOOLEAN: "_mask"}  # of functions that load and store vectors

HEADERS = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <string.h>\n"
_SCHEDULING = """#ifndef __clang__
#pragma GCC optimize("schedule-insns", "sched-pressure", "ira-region=one", "no-gcse", "no-tree-pre")
#endif
"""  # gcc options for long blocks: scheduling before register allocation, without passes that are slow to compile
_WIDTH = """\
#if defined(__AVX512F__)
enum { W = 64 / sizeof(REAL) };
#elif defined(__AVX2__)
enum { W = 32 / sizeof(REAL) };
#else
enum { W = 16 / sizeof(REAL) };
#endif
const int64_t width = W;
"""  # runs per vector, which is one register: with two, programs took 1.8 to 4 times as long, and far longer to compile
_PRELUDE = """
#define INLINE static inline __attribute__((always_inline, unused))
INLINE V real(double x) { return (REAL)x - (V){0}; }
INLINE I integer(int64_t x) { return (WHOLE)x - (I){0}; }
INLINE I mask(bool x) { return integer(-(int64_t)x); }
INLINE V pick(I c, V x, V y) { return (V)((c & (I)x) | (~c & (I)y)); }
INLINE I pick_integer(I c, I x, I y) { return (c & x) | (~c & y); }
INLINE V load(const double *x) { D r; memcpy(&r, x, sizeof r); return __builtin_convertvector(r, V); }
INLINE I load_integer(const int64_t *x) { L r; memcpy(&r, x, sizeof r); return __builtin_convertvector(r, I); }
INLINE I load_mask(const int64_t *x) { return load_integer(x) != 0; }
INLINE void store(double *to, V x) { D r = __builtin_convertvector(x, D); memcpy(to, &r, sizeof r); }
INLINE void store_integer(int64_t *to, I x) { L r = __builtin_convertvector(x, L); memcpy(to, &r, sizeof r); }
INLINE void store_mask(int64_t *to, I x) { store_integer(to, x & 1); }
INLINE V v_maximum(V x, V y) { return pick((x > y) | (x != x), x, y); }
INLINE V v_minimum(V x, V y) { return pick((x < y) | (x != x), x, y); }
INLINE V v_absolute(V x) { return (V)((I)x & (WHOLE)(UINT64_MAX >> (65 - 8 * sizeof(REAL)))); }
INLINE V v_sign(V x) { return pick(x > 0, real(1), pick(x < 0, real(-1), real(0))); }
INLINE I v_isfinite(V x) { return x - x == 0; }
#define EACH(name, f) INLINE V name(V x) { V r; for (int i = 0; i < W; ++i) r[i] = f(x[i]); return r; }
EACH(v_sqrt, ROOT) EACH(v_rint, NEAREST) EACH(v_floor, FLOOR) EACH(v_ceil, CEIL)
EACH(v_exp, exp) EACH(v_expm1, expm1) EACH(v_log, log) EACH(v_log1p, log1p) EACH(v_sin, sin) EACH(v_cos, cos)
EACH(v_tan, tan) EACH(v_asin, asin) EACH(v_acos, acos) EACH(v_atan, atan) EACH(v_sinh, sinh) EACH(v_cosh, cosh)
EACH(v_tanh, tanh) EACH(v_cbrt, cbrt)
#define PAIR(name, f) INLINE V name(V x, V y) { V r; for (int i = 0; i < W; ++i) r[i] = f(x[i], y[i]); return r; }
PAIR(v_pow, pow) PAIR(v_atan2, atan2) PAIR(v_fmod, fmod)
"""
_DOUBLE = """typedef float F __attribute__((vector_size(4 * W)));
typedef int32_t J __attribute__((vector_size(4 * W)));
INLINE V v_single(V x) { return __builtin_convertvector(__builtin_convertvector(x, F), V); }
INLINE V v_from_bits_32(I x) { return __builtin_convertvector((F)__builtin_convertvector(x, J), V); }
"""


def prelude(single: bool) -> str:
    """Definitions of vector types: `V` of W real numbers, `I` of integers, `D` and `L` of their 64-bit forms."""
    real, suffix, bits = ("float", "f", 32) if single else ("double", "", 64)
    names = {"ROOT": "sqrt", "NEAREST": "rint", "FLOOR": "floor", "CEIL": "ceil"}
    vectors = {"V": real, "I": f"int{bits}_t", "U": f"uint{bits}_t", "D": "double", "L": "int64_t"}
    lines = [
        f"{_SCHEDULING}{HEADERS}",
        f"#define REAL {real}\n#define WHOLE int{bits}_t\n{_WIDTH}",
        *(f"#define {name} __builtin_{function}{suffix}" for name, function in names.items()),
        *(f"typedef {kind} {name} __attribute__((vector_size(sizeof({kind}) * W)));" for name, kind in vectors.items()),
    ]
    return "\n".join(lines) + _PRELUDE + ("" if single else _DOUBLE)


_FUNCTIONS = {"max": "v_maximum", "min": "v_minimum", "abs": "v_absolute", "round": "v_rint", "rem": "v_fmod"}


class VectorWriter(Writer):
    """Writes the scopes of a batched program."""

    def __init__(self, scopes: Sequence[Scope], results: Sequence[Value | StoredArray], *, single: bool) -> None:
        super().__init__(scopes, c_language(), results)
        self._single = single

    def constant(self, value: Value) -> str:
        return f"const {self.language.types[value.kind] if value.uniform else _VECTORS[value.kind]}"

    def variable(self, kind: Kind, uniform: bool) -> str:
        return self.language.types[kind] if uniform else _VECTORS[kind]

    def converted(self, value: Value, uniform: bool) -> str:
        return self.text(value) if uniform else self._vector(value)

    def _argument(self, value: Value, argument: Value) -> Text:
        """Text of an argument; scalars get 32 bits if the other operand is a 32-bit vector."""
        text = super()._argument(value, argument)
        if not self._single or value.uniform or not argument.uniform:
            return text
        if argument.kind is Kind.REAL and argument.constant is not None:
            return self._literal(argument, c_language("float"))
        return f"({'float' if argument.kind is Kind.REAL else 'int32_t'})({text[0]})", _PREFIX

    def _vector(self, value: Value) -> str:
        """Text of a value as a vector."""
        text, strength = self._text(value)
        if value.uniform:
            return f"{_BROADCAST[value.kind]}({text})"
        return text if strength >= _ATOM else f"({text})"

    def loaded(self, value: Value) -> str:
        return super().loaded(value) if value.uniform else f"load{_SUFFIX[value.kind]}(&{value.data}[b])"

    def store(self, array: StoredArray, place: str, value: Value) -> str:
        name = self._arrays[id(array)]
        if name.startswith("out"):
            return f"store{_SUFFIX[value.kind]}(&{name}[({place}) * lanes + b], {self._vector(value)})"
        return f"{name}[{place}] = {self._vector(value)}"

    def element(self, array: StoredArray, place: str) -> str:
        name = self._arrays[id(array)]
        if not array.uniform and (array.name or name.startswith("out")):
            return f"load{_SUFFIX[array.kind]}(&{name}[({place}) * lanes + b])"
        return f"{name}[{place}]"

    def _array(self, array: StoredArray, texts: Sequence[str] | None, indent: str) -> list[str]:
        if array.uniform:
            return super()._array(array, texts, indent)
        name = self._arrays[id(array)] = self._new("a")
        lines = [f"{indent}{_VECTORS[array.kind]} {name}[{array.size}];"]
        return lines + [
            f"{indent}{name}[{n}] = {self._vector(one)};" for n, one in enumerate(array.elements) if array.loop is None
        ]

    def _operation(self, value: Value) -> Text:
        name, arguments = value.operation, value.arguments
        if value.uniform:
            return super()._operation(value)
        if name == "select":
            condition, yes, no = arguments
            if condition.uniform:
                return f"({self.text(condition)} ? {self._vector(yes)} : {self._vector(no)})", _ATOM
            pick = "pick" if value.kind is Kind.REAL else "pick_integer"
            return f"{pick}({self.text(condition)}, {self._vector(yes)}, {self._vector(no)})", _ATOM
        if value.kind is Kind.BOOLEAN and name in ("and", "or", "xor"):
            operator = {"and": "&", "or": "|", "xor": "^"}[name]
            return f"({self._vector(arguments[0])} {operator} {self._vector(arguments[1])})", _ATOM
        if name == "not":
            return f"(~{self._vector(arguments[0])})", _ATOM
        if value.kind is Kind.BOOLEAN and arguments[0].kind is Kind.BOOLEAN and name in ("eq", "ne"):
            return (
                f"({'~' if name == 'eq' else ''}({self._vector(arguments[0])} ^ {self._vector(arguments[1])}))",
                _ATOM,
            )
        if name in ("max", "min") and value.kind is Kind.INTEGER:
            x, y = map(self._vector, arguments)
            return f"pick_integer({x} {'>' if name == 'max' else '<'} {y}, {x}, {y})", _ATOM
        if name == "rem" and value.kind is Kind.INTEGER:
            return f"({self._vector(arguments[0])} % {self._vector(arguments[1])})", _ATOM
        if name in ("real", "integer", "boolean"):
            return self._conversion(self._vector(arguments[0]), arguments[0].kind, value.kind), _ATOM
        if name == "bits":
            return f"((I){self._vector(arguments[0])})", _ATOM
        if name == ("from_bits_32" if self._single else "from_bits"):
            return f"((V){self._vector(arguments[0])})", _ATOM
        if name == "shift_right" and self._single:  # for random bits and positive numbers
            return f"((I)((U){self._vector(arguments[0])} >> (U){self._vector(arguments[1])}))", _ATOM
        if name in self.language.functions:
            function = _FUNCTIONS.get(name, f"v_{self.language.functions[name]}")
            return f"{function}({', '.join(map(self._vector, arguments))})", _ATOM
        return super()._operation(value)

    @staticmethod
    def _conversion(text: str, source: Kind, target: Kind) -> str:
        if target is Kind.BOOLEAN:
            return f"({text} != 0)"
        if source is Kind.BOOLEAN:
            return f"((V)((I)real(1) & {text}))" if target is Kind.REAL else f"({text} & 1)"
        return f"__builtin_convertvector({text}, {_VECTORS[target]})"
