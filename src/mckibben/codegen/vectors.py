"""Writer of batched programs: C with the vector extensions of gcc and clang.

Values equal in all lanes are 64-bit scalars; the others are vectors of `W` numbers, or of masks if boolean. Their names
end with a mark, so that `interleaved` can write each statement for several vectors.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from mckibben.codegen.graph import Kind, Scope, StoredArray, Value
from mckibben.codegen.languages import c_language
from mckibben.codegen.writer import ATOM, PREFIX, Text, Writer

_VECTORS = {Kind.REAL: "V", Kind.INTEGER: "I", Kind.BOOLEAN: "I"}
_BROADCAST = {Kind.REAL: "real", Kind.INTEGER: "integer", Kind.BOOLEAN: "mask"}
_SUFFIX = {Kind.REAL: "", Kind.INTEGER: "_integer", Kind.BOOLEAN: "_mask"}  # of functions that load and store vectors
_FUNCTIONS = {"max": "v_maximum", "min": "v_minimum", "abs": "v_absolute", "round": "v_rint", "rem": "v_fmod"}
_PATTERNS = {
    ("and", Kind.BOOLEAN): "({0} & {1})",
    ("or", Kind.BOOLEAN): "({0} | {1})",
    ("xor", Kind.BOOLEAN): "({0} ^ {1})",
    ("eq", Kind.BOOLEAN): "(~({0} ^ {1}))",
    ("ne", Kind.BOOLEAN): "(({0} ^ {1}))",
    ("not", Kind.BOOLEAN): "(~{0})",
    ("max", Kind.INTEGER): "pick_integer({0} > {1}, {0}, {1})",
    ("min", Kind.INTEGER): "pick_integer({0} < {1}, {0}, {1})",
    ("rem", Kind.INTEGER): "({0} % {1})",
    ("abs", Kind.INTEGER): "pick_integer({0} < 0, -{0}, {0})",
    ("sign", Kind.INTEGER): "(({0} < 0) - ({0} > 0))",
    ("bits", Kind.REAL): "((I){0})",
}
"""Operations on vectors by their name and the kind of their first argument; the others are operators or functions."""
_MARK, _ANY = "@", re.compile(r"any\(\{(.+?)\}\)")
_OF_64_BITS = {("from_bits", Kind.INTEGER): "((V){0})"}
_OF_32_BITS = {
    ("from_bits_32", Kind.INTEGER): "((V){0})",
    ("shift_word", Kind.INTEGER): "((I)((U){0} >> (U){1}))",
}


def interleaved(lines: Sequence[str], count: int) -> list[str]:
    """Statements of several vectors in turns: a processor computes one while it waits for a result of another.

    >>> interleaved(["if (any({m@})) {", "t1@ = x1@ * 2.0;"], 2)[2:]
    ['if (any(m_0 | m_1)) {', 't1_0 = x1_0 * 2.0;', 't1_1 = x1_1 * 2.0;']
    """
    suffixes = [f"_{number}" for number in range(count)]
    lines = [*(f"const int64_t b_{number} = b + {number} * W;" for number in range(count)), *lines]
    joined = [_ANY.sub(lambda m: f"any({' | '.join(m[1].replace(_MARK, end) for end in suffixes)})", x) for x in lines]
    return [line.replace(_MARK, end) for line in joined for end in (suffixes if _MARK in line else suffixes[:1])]


class VectorWriter(Writer):
    """Writes the scopes of a batched program.

    Parameters
    ----------
    single
        Whether vectors have 32 bits; scalars, equal in all lanes, have 64 in any case.
    """

    def __init__(self, scopes: Sequence[Scope], results: Sequence[Value | StoredArray], *, single: bool) -> None:
        super().__init__(scopes, c_language(), results)
        self._single = single
        self._patterns = _PATTERNS | (_OF_32_BITS if single else _OF_64_BITS)

    def new_name(self, letter: str, uniform: bool = True) -> str:
        return super().new_name(letter) + ("" if uniform else _MARK)

    def constant(self, value: Value) -> str:
        return f"const {self.variable(value.kind, value.uniform)}"

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
        return f"({'float' if argument.kind is Kind.REAL else 'int32_t'})({text[0]})", PREFIX

    def _vector(self, value: Value) -> str:
        """Text of a value as a vector."""
        text, strength = self._text(value)
        if value.uniform:
            return f"{_BROADCAST[value.kind]}({text})"
        return text if strength >= ATOM else f"({text})"

    def loaded(self, value: Value) -> str:
        return super().loaded(value) if value.uniform else f"load{_SUFFIX[value.kind]}(&{value.data}[b{_MARK}])"

    def store(self, array: StoredArray, place: str, value: Value) -> str:
        """Text of an assignment; results of runs lie next to each other in memory."""
        name = self._arrays[id(array)]
        if name.startswith("out"):
            return f"store{_SUFFIX[value.kind]}(&{name}[({place}) * lanes + b{_MARK}], {self._vector(value)})"
        return f"{name}[{place}] = {self._vector(value)}"

    def element(self, array: StoredArray, place: str) -> str:
        """Text of an element of an array; arguments and results of runs are loaded as vectors."""
        name = self._arrays[id(array)]
        if not array.uniform and (array.name or name.startswith("out")):
            return f"load{_SUFFIX[array.kind]}(&{name}[({place}) * lanes + b{_MARK}])"
        return f"{name}[{place}]"

    def _array(self, array: StoredArray, texts: Sequence[str] | None, indent: str) -> list[str]:
        """Declaration of an array of vectors, with its elements."""
        if array.uniform:
            return super()._array(array, texts, indent)
        name = self._arrays[id(array)] = self.new_name("a", array.uniform)
        elements = array.elements if array.loop is None else ()
        return [
            f"{indent}{_VECTORS[array.kind]} {name}[{array.size}];",
            *(f"{indent}{name}[{place}] = {self._vector(value)};" for place, value in enumerate(elements)),
        ]

    def _operation(self, value: Value) -> Text:
        if value.operation == "any":
            return f"any({{{self._vector(value.arguments[0])}}})", ATOM
        text = None if value.uniform else self._of_vectors(value)
        return super()._operation(value) if text is None else (text, ATOM)

    def _of_vectors(self, value: Value) -> str | None:
        """Text of an operation on vectors; None for one with an operator of C."""
        name, arguments = value.operation, value.arguments
        if name == "select":
            condition, yes, no = arguments
            if condition.uniform:
                return f"({self.text(condition)} ? {self._vector(yes)} : {self._vector(no)})"
            pick = "pick" if value.kind is Kind.REAL else "pick_integer"
            return f"{pick}({self.text(condition)}, {self._vector(yes)}, {self._vector(no)})"
        # the second argument is tested for NaN: once, if all lanes share it
        vectors = [self._vector(x) for x in sorted(arguments, key=lambda x: x.uniform and name in ("max", "min"))]
        if name in ("real", "integer", "boolean"):
            return self._conversion(vectors[0], arguments[0].kind, value.kind)
        if (pattern := self._patterns.get((name, arguments[0].kind))) is not None:
            return pattern.format(*vectors)
        if name in self.language.functions:
            return f"{_FUNCTIONS.get(name, f'v_{self.language.functions[name]}')}({', '.join(vectors)})"
        return None

    @staticmethod
    def _conversion(text: str, source: Kind, target: Kind) -> str:
        """Text of a vector of one kind as one of another; a mask has all bits set where it is true."""
        if target is Kind.BOOLEAN:
            return f"({text} != 0)"
        if source is Kind.BOOLEAN:
            return f"((V)((I)real(1) & {text}))" if target is Kind.REAL else f"({text} & 1)"
        return f"__builtin_convertvector({text}, {_VECTORS[target]})"
