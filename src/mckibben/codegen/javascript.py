"""JavaScript writer: a script without imports and exports that defines one object."""

from __future__ import annotations

from collections.abc import Sequence

from mckibben.codegen.graph import Kind, Value
from mckibben.codegen.languages import JAVASCRIPT
from mckibben.codegen.source_module import Function, Member, SourceModule, element, identifier, is_scalar
from mckibben.codegen.writer import Text, Writer, inputs_of
from mckibben.errors import ExportError


def write_js(module: SourceModule, comment: str = "") -> str:
    """Write a module as JavaScript, for pages (also from files) and for Node.

    The object has ``defaults()``, which returns ``self`` with ``parameters`` and ``state``, ``prepare(self)``, to be
    called after changing a parameter, and the functions, which take ``self`` and their arguments. A function updates
    the state and returns its other results as an object, or as a number if there is only one.
    """
    writer = _Writer(module.scopes, JAVASCRIPT, module.results())
    functions = [_defaults(module), _prepare(module, writer)]
    functions += [_function(function, writer) for function in module.functions]
    names = ["defaults", "prepare", *(function.name for function in module.functions)]
    lines = "\n".join([*sorted(writer.helpers), *functions]).splitlines()
    return "\n".join(
        [
            *(f"// {line}".rstrip() for line in comment.splitlines()),
            f"const {module.name} = (function () {{",
            '    "use strict";',
            *(f"    {line}".rstrip() for line in lines),
            f"    return {{{', '.join(names)}}};",
            "})();",
            f'if (typeof module !== "undefined") module.exports = {module.name};\n',
        ]
    )


_BITS = {"and", "or", "xor", "shift_left", "shift_right", "bits", "from_bits", "from_bits_32", "single"}


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


def _defaults(module: SourceModule) -> str:
    lines = [
        f"    {structure}: {{{', '.join(f'{member.name}: {_literal(member, zero=zero)}' for member in members)}}},"
        for structure, members, zero in (("parameters", module.members, False), ("state", module.state, True))
    ]
    return "\n".join(
        [
            "function defaults() {",
            "    const self = {",
            *(f"    {line}" for line in lines),
            f"        prepared: {{{', '.join(f'{kind.value}: []' for kind in Kind)}}},",
            "    };",
            "    prepare(self);",
            "    return self;",
            "}\n",
        ]
    )


def _literal(member: Member, *, zero: bool) -> str:
    """Numbers of a member; its state is set by a function."""
    numbers = [JAVASCRIPT.literal(0 if zero else number.item(), member.kind) for number in member.value.flat]
    numbers = ["false" if zero and member.kind is Kind.BOOLEAN else number for number in numbers]
    return f"[{', '.join(numbers)}]" if member.shape else numbers[0]


def _prepare(module: SourceModule, writer: Writer) -> str:
    """The function that computes what depends on parameters alone."""
    lines, _ = writer.prepared(
        module.graph.root,
        lambda value: f"self.{value.data}",
        lambda kind, place: f"self.prepared.{kind.value}[{place}]",
    )
    return "\n".join(["function prepare(self) {", *lines, "}\n"])


def _function(function: Function, writer: Writer) -> str:
    lines = []
    for value in inputs_of(function.scope):
        if writer.is_needed(value):
            structure, name = value.data.split(".", 1)[0], identifier(value.data)
            place = f"self.{value.data}" if structure == "state" else value.data
            writer.name(value, name)
            if name != place:
                lines.append(f"    const {name} = {place};")
    lines += writer.scope(function.scope)
    returned: dict[str, str] = {}
    for result, members in function.results.items():
        values = iter(function.values[result])
        texts = {member.name: [writer.text(next(values)) for _ in range(member.size)] for member in members}
        if result == "state":
            places = [element("state", member, number) for member in members for number in range(member.size)]
            values = [text for member in members for text in texts[member.name]]
            lines += [f"    self.{place} = {text};" for place, text in zip(places, values, strict=True)]
        elif is_scalar(members):
            returned[result] = texts[members[0].name][0]
        else:
            returned[result] = _object(members, texts)
    if function.returned is not None:
        lines.append(f"    return {returned[function.returned]};")
    elif returned:
        lines.append(f"    return {{{', '.join(f'{name}: {text}' for name, text in returned.items())}}};")
    arguments = ["self", *(name for name in function.arguments if name != "state")]
    return "\n".join([f"// {function.text}", f"function {function.name}({', '.join(arguments)}) {{", *lines, "}\n"])


def _object(members: Sequence[Member], texts: dict[str, list[str]]) -> str:
    values = {name: ", ".join(numbers) for name, numbers in texts.items()}
    items = (f"{x.name}: [{values[x.name]}]" if x.shape else f"{x.name}: {values[x.name]}" for x in members)
    return f"{{{', '.join(items)}}}"
