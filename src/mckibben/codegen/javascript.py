"""JavaScript writer: a script without imports and exports that defines one object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mckibben.codegen.graph import Kind, Value
from mckibben.codegen.languages import JAVASCRIPT
from mckibben.codegen.random_bits import MASK
from mckibben.codegen.source_module import Function, Member, SourceModule, element_names, is_scalar
from mckibben.codegen.templates import filled
from mckibben.codegen.writer import ATOM, Text, Writer
from mckibben.errors import ExportError


def write_js(module: SourceModule, comment: str = "") -> str:
    """Write a module as JavaScript, for pages (also from files) and for Node.

    The object has ``defaults()``, which returns ``self`` with ``parameters`` and ``state``, ``prepare(self)``, to be
    called after changing a parameter, and the functions, which take ``self`` and their arguments. A function updates
    the state and returns its other results as an object, or as a number if there is only one. Raises `ExportError` for
    operations on 64-bit integers.

    Examples
    --------
    >>> import numpy as np
    >>> spring = SourceModule("spring", {"stiffness": np.array(40.0)})
    >>> spring.add("force", "force [N]", lambda p, x: {"force": -p["stiffness"] * x}, {"x": np.array(0.0)})
    >>> print(write_js(spring).splitlines()[-6].strip())
    return t1;
    """
    writer = _Writer(module.scopes, JAVASCRIPT, module.results())
    structures = {"parameters": module.members, "state": module.state}
    values = {
        "comment": comment.splitlines(),
        "name": module.name,
        "structures": [f"{name}: {_object(members, _literals(members))}" for name, members in structures.items()],
        "prepare": writer.prepared(module.graph.root, "self.{}".format, "self.prepared.{}[{}]")[0],
        "functions": [_function(function, writer) for function in module.functions],
        "helpers": sorted(writer.helpers),
    }
    return filled("module.js", values)


_BITS = {"and": "&", "or": "|", "xor": "^"}


class _Writer(Writer):
    """Writes integers, which JavaScript has as real numbers: their divisions, and the bits of words of 32."""

    def _expression(self, value: Value) -> Text:
        name, arguments = value.operation, value.arguments
        if value.kind is Kind.INTEGER and name in _BITS:
            if not _is_word(value) or any(argument.operation == "mul" for argument in arguments):  # beyond 2^53
                raise _needs_64_bits(name)
            first, second = map(self._atom, arguments)
            return f"({first} {_BITS[name]} {second}) >>> 0", 0  # from numbers modulo 2^32, whose result has a sign
        if name.startswith("shift_"):
            shift = f"{'*' if name == 'shift_left' else '/'} 2 ** {self._atom(arguments[1])}"
            text = f"{self._atom(arguments[0])} {shift}"
            return (f"({text})" if name == "shift_left" else f"Math.floor({text})"), ATOM
        if name in ("bits", "from_bits"):
            raise _needs_64_bits(name)
        text, strength = super()._expression(value)
        if name == "div" and value.kind is Kind.INTEGER:
            return f"Math.trunc({text})", ATOM
        return text, strength

    def _atom(self, value: Value) -> str:
        text, strength = self._text(value)
        return text if strength >= ATOM else f"({text})"


def _is_word(value: Value) -> bool:
    """Whether an integer is known to be between 0 and the largest word of 32 bits."""
    if value.operation == "constant":
        return 0 <= value.data <= MASK
    if value.operation == "and" and any(argument.operation == "constant" for argument in value.arguments):
        return any(argument.operation == "constant" and _is_word(argument) for argument in value.arguments)
    if value.operation in ("shift_word", "shift_right"):
        return _is_word(value.arguments[0])
    return value.operation in _BITS and all(map(_is_word, value.arguments))


def _needs_64_bits(name: str) -> ExportError:
    return ExportError(f"the operation {name} on integers needs 64 bits", field=name, remedy="write it in C")


def _literals(members: Sequence[Member]) -> list[str]:
    """Texts of the values of members."""
    return [JAVASCRIPT.literal(x.item(), member.kind) for member in members for x in member.value.flat]


def _object(members: Sequence[Member], texts: Sequence[str]) -> str:
    """Object of members, from the texts of their elements."""
    remaining = iter(texts)
    numbers = [(member, ", ".join([next(remaining) for _ in range(member.size)])) for member in members]
    items = [f"{member.name}: [{text}]" if member.shape else f"{member.name}: {text}" for member, text in numbers]
    return f"{{{', '.join(items)}}}"


def _function(function: Function, writer: Writer) -> Mapping[str, object]:
    """Description, name, arguments and statements of a function."""
    lines = writer.function(function.scope, lambda name: f"self.{name}" if name.startswith("state.") else name)
    returned: dict[str, str] = {}
    for result, members in function.results.items():
        texts = [writer.text(value) for value in function.values[result]]
        if result == "state":
            places = element_names("state", members)
            lines += [f"    self.{place} = {text};" for place, text in zip(places, texts, strict=True)]
        else:
            returned[result] = texts[0] if is_scalar(members) else _object(members, texts)
    if function.returned is not None:
        lines.append(f"    return {returned[function.returned]};")
    elif returned:
        lines.append(f"    return {{{', '.join(f'{name}: {text}' for name, text in returned.items())}}};")
    arguments = ", ".join(["self", *function.inputs])
    return {"function": function, "name": function.name, "arguments": arguments, "lines": lines}
