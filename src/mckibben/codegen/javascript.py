"""JavaScript writer: a script without imports and exports that defines one object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mckibben.codegen.graph import Kind, Value
from mckibben.codegen.languages import JAVASCRIPT
from mckibben.codegen.source_module import Function, Member, SourceModule, element_names, is_scalar
from mckibben.codegen.templates import filled
from mckibben.codegen.writer import Text, Writer
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


_BITS = {"and", "or", "xor", "shift_left", "shift_right", "shift_word", "bits", "from_bits", "from_bits_32", "single"}


class _Writer(Writer):
    """Writes integer divisions, for which JavaScript has no operator; it has no 64-bit integers either."""

    def _expression(self, value: Value) -> Text:
        if value.operation in _BITS and value.kind is not Kind.BOOLEAN:
            name = value.operation
            raise ExportError(f"{name} needs 64-bit integers", field=name, remedy="write it in C")
        text, strength = super()._expression(value)
        if value.operation == "div" and value.kind is Kind.INTEGER:
            return f"Math.trunc({text})", strength + 10
        return text, strength


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
