"""Long blocks of statements as functions: a compiler's time grows with the square of the length of a block."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

_LINES = 200
"""Statements of a part; a block of up to twice as many stays whole."""
_NAME = re.compile(r"(?<![\w.])[a-z]\w*")
_CONSTANT = re.compile(r"( *)const (\w+) (\w+) = (.*);")
_DECLARED = re.compile(r" *(?:for \()?(?:static )?((?:const )?[a-zA-Z]\w* ?\*?)(?<= |\*)(\w+)(?:(\[\d+\])|;| = )")


class _Constant(NamedTuple):
    """A line that declares a constant."""

    indent: str
    kind: str
    name: str
    text: str


def in_parts(lines: Sequence[str]) -> tuple[list[str], list[str]]:
    """Functions of C for the parts of long blocks of constants, and the lines of a function that calls them.

    What a part computes for later lines is kept in memory, in an array for each type, whose places are used again.
    """
    constants = [match and _Constant(*match.groups()) for match in map(_CONSTANT.fullmatch, lines)]
    kinds = {"lanes": "int64_t"}  # of arguments, by name
    last: dict[str, int] = {}  # line of the last use
    for number, line in enumerate(lines):
        if match := _DECLARED.match(line):
            kinds[match[2]] = match[1].strip() + " *" * bool(match[3])
        last.update(dict.fromkeys(_NAME.findall(line), number))
    functions, calling, at = list[str](), list[str](), 0
    while at < len(lines):
        first, end = constants[at], at
        block = list[_Constant]()
        while first and end < len(lines) and (constant := constants[end]) and constant.indent == first.indent:
            block.append(constant)
            end += 1
        if first and len(block) > 2 * _LINES:
            parts = _Parts(f"part{len(functions)}_", kinds, last)
            calls = [parts.call(block[k : k + _LINES], min(at + k + _LINES, end)) for k in range(0, len(block), _LINES)]
            functions += parts.functions
            calling += [first.indent + line for line in (*parts.declared(), *calls, *parts.results(end))]
        else:
            end = max(end, at + 1)
            calling += lines[at:end]
        at = end
    return functions, calling


class _Parts:
    """Functions for the parts of one block."""

    def __init__(self, prefix: str, kinds: dict[str, str], last: dict[str, int]) -> None:
        self.functions: list[str] = []
        self._prefix, self._kinds, self._last = prefix, kinds, last
        self._places: dict[str, tuple[str, int]] = {}  # array and index of what is kept
        self._sizes: defaultdict[str, int] = defaultdict(int)
        self._free: defaultdict[str, list[int]] = defaultdict(list)
        self._count = 0

    def call(self, part: Sequence[_Constant], end: int) -> str:
        """Write the function of a part that ends before a line, and return its call."""
        names = {constant.name for constant in part}
        texts = (constant.text for constant in part)
        used = dict.fromkeys(name for text in texts for name in _NAME.findall(text) if name in self._kinds)
        passed = [name for name in used if name not in self._places and name not in names]
        before = [self._loaded(name) for name in used if name in self._places]
        for name in [name for name in self._places if self._last[name] < end]:
            array, index = self._places.pop(name)
            self._free[array].append(index)
        after = [self._stored(constant) for constant in part if self._last[constant.name] >= end]
        body = [*before, *(f"const {kind} {name} = {text};" for _, kind, name, text in part), *after]
        arrays = [f"{array.removeprefix(self._prefix)} *restrict {array}" for array in self._sizes]
        arguments = ", ".join([*(f"{self._kinds[name]} {name}" for name in passed), *arrays])
        name = f"{self._prefix}{self._count}"
        self._count += 1
        head = f"static __attribute__((noinline)) void {name}({arguments})"
        self.functions += [head, "{", *("    " + line for line in body), "}"]
        return f"{name}({', '.join([*passed, *self._sizes])});"

    def declared(self) -> list[str]:
        """Declarations of the arrays."""
        return [f"{array.removeprefix(self._prefix)} {array}[{size}];" for array, size in self._sizes.items()]

    def results(self, end: int) -> list[str]:
        """Declarations of what is used from a line on."""
        return [self._loaded(name) for name in self._places if self._last[name] >= end]

    def _loaded(self, name: str) -> str:
        array, index = self._places[name]
        return f"{self._kinds[name]} {name} = {array}[{index}];"

    def _stored(self, constant: _Constant) -> str:
        array = self._prefix + constant.kind
        free = self._free[array]
        if not free:
            free.append(self._sizes[array])
            self._sizes[array] += 1
        self._places[constant.name] = array, free[-1]
        return f"{array}[{free.pop()}] = {constant.name};"
