"""C99 writer: a header with structures, and a source file without memory allocation or recursion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mckibben.codegen.languages import c_language
from mckibben.codegen.precision import wide_inputs, wide_values
from mckibben.codegen.source_module import Function, Member, SourceModule, element, identifier, is_scalar
from mckibben.codegen.writer import Writer, inputs_of

_PARAMETERS = "may be changed; call prepare afterwards"
_STATE = "from one step to the next"
_PREPARED = "computed from the parameters"


class Sources(NamedTuple):
    """Text of the header and of the source file."""

    header: str
    source: str


def comment_text(text: str) -> str:
    """Text that neither ends a comment of C, nor opens one in it, nor continues it on the next line."""
    spaced = re.sub(r"\*(?=/)|/(?=\*)|\?(?=\?/)", r"\g<0> ", text)
    return re.sub(r"\\(?=\s*$)", r"\\.", spaced, flags=re.MULTILINE)


def write_c(
    module: SourceModule,
    comment: str = "",
    *,
    single: bool = False,
    wide: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> Sources:
    """Write a module as C99: a header with its structures, and a source without memory allocation or recursion.

    Parameters
    ----------
    comment
        Text at the beginning of both files.
    single
        Whether numbers are `float`, except values that depend on the arguments `wide` alone, which are `double`.
    wide
        Names of such arguments.
    units
        Units of the members by structure and path, such as ``setpoint.angle``, for comments in the header.
    """
    return _Writing(module, comment, single, wide, units or {}).sources()


class _Writing:
    """Text of one module."""

    def __init__(
        self, module: SourceModule, comment: str, single: bool, wide: Sequence[str], units: Mapping[str, str]
    ) -> None:
        self._module = module
        self._name = module.name
        lines = [f" * {line}".rstrip() for line in comment_text(comment).splitlines()]
        self._comment = "\n".join(["/*", *lines, " */\n"])
        self._language = c_language("float" if single else "double")
        self._units = units
        self._wide = wide_inputs(module, wide) if single else frozenset[str]()
        known = wide_values(module, self._wide)
        self._writer = Writer(module.scopes, self._language, module.results(), known, c_language("double"))

    def sources(self) -> Sources:
        """Header and source."""
        functions = [self._defaults(), self._prepare(), *map(self._function, self._module.functions)]
        helpers = sorted(self._writer.helpers)
        source = [
            f'{self._comment}#include "{self._name}.h"\n\n#include <math.h>\n#include <string.h>\n',
            *helpers,
            *functions,
        ]
        return Sources(self._header(), "\n".join(source))

    def _header(self) -> str:
        name, module = self._name, self._module
        structures = [self._structure("parameters", module.members, _PARAMETERS)]
        counts = {kind: count for kind, count in self._prepared.items() if count}
        if counts:
            members = [f"    {self._language.types[kind]} {kind.value}[{count}];" for kind, count in counts.items()]
            structures.append("\n".join([f"/* {_PREPARED} */", "typedef struct {", *members, f"}} {name}_prepared;\n"]))
        if module.state:
            structures.append(self._structure("state", module.state, _STATE))
        inside = ["parameters", *(["prepared"] if counts else []), *(["state"] if module.state else [])]
        lines = [f"    {name}_{part} {part};" for part in inside]
        structures.append("\n".join(["typedef struct {", *lines, f"}} {name};\n"]))
        structures += [self._structure(structure, members) for structure, members in module.structures().items()]
        return "\n".join(
            [
                f"{self._comment}#ifndef {name.upper()}_H\n#define {name.upper()}_H\n",
                "#include <stdbool.h>\n#include <stdint.h>\n",
                '#ifdef __cplusplus\nextern "C" {\n#endif\n',
                *structures,
                f"/* set the default parameters, and prepare */\nvoid {name}_defaults({name} *self);\n",
                f"/* call after changing parameters */\nvoid {name}_prepare({name} *self);\n",
                *(f"/* {function.text} */\n{self._signature(function)};\n" for function in module.functions),
                "#ifdef __cplusplus\n}\n#endif\n\n#endif\n",
            ]
        )

    def _structure(self, name: str, members: Sequence[Member], text: str = "") -> str:
        lines = [f"/* {text} */"] if text else []
        lines.append("typedef struct {")
        for member in members:
            unit = self._units.get(f"{name}.{member.path}", "")
            size = f"[{member.size}]" if member.shape else ""
            comment = f" /* {comment_text(unit)} */" if unit else ""
            lines.append(f"    {self._type(name, member)} {member.name}{size};{comment}")
        return "\n".join([*lines, f"}} {self._name}_{name};\n"])

    def _type(self, structure: str, member: Member) -> str:
        return "double" if element(structure, member, 0) in self._wide else self._language.types[member.kind]

    def _defaults(self) -> str:
        lines = [
            f"    self->{element('parameters', member, place)} = {self._language.literal(value.item(), member.kind)};"
            for member in self._module.members
            for place, value in enumerate(member.value.flat)
        ]
        name = self._name
        return "\n".join([f"void {name}_defaults({name} *self)", "{", *lines, f"    {name}_prepare(self);", "}\n"])

    def _prepare(self) -> str:
        """Function that computes the values that depend on parameters alone."""
        lines, self._prepared = self._writer.prepared(
            self._module.graph.root,
            lambda value: f"self->{value.data}",
            lambda kind, place: f"self->prepared.{kind.value}[{place}]",
        )
        lines = lines or ["    (void)self;"]
        return "\n".join([f"void {self._name}_prepare({self._name} *self)", "{", *lines, "}\n"])

    def _signature(self, function: Function) -> str:
        arguments = [f"{self._name} *self" if "state" in function.results else f"const {self._name} *self"]
        returned, inputs = "void", function.arguments.items()
        arguments += [self._argument(name, members, is_input=True) for name, members in inputs if name != "state"]
        if function.returned is not None:
            returned = self._language.types[function.results[function.returned][0].kind]
        else:
            results = function.results.items()
            arguments += [self._argument(name, members, is_input=False) for name, members in results if name != "state"]
        return f"{returned} {self._name}_{function.name}({', '.join(arguments)})"

    def _argument(self, name: str, members: Sequence[Member], *, is_input: bool) -> str:
        if is_scalar(members):
            return f"{self._language.types[members[0].kind]} {'' if is_input else '*'}{name}"
        return f"{'const ' if is_input else ''}{self._name}_{name} *{name}"

    def _place(self, structure: str, members: Sequence[Member], name: str, *, is_input: bool) -> str:
        """Location of an element of an argument or a result."""
        if structure == "state":
            return f"self->{name}"
        if is_scalar(members):
            return structure if is_input else f"*{structure}"
        return name.replace(".", "->", 1)

    def _function(self, function: Function) -> str:
        lines, used = [], set()
        for value in inputs_of(function.scope):
            if self._writer.is_needed(value):
                structure = value.data.split(".", 1)[0]
                used.add(structure)
                place = self._place(structure, function.arguments[structure], value.data, is_input=True)
                name = identifier(value.data)
                self._writer.name(value, name)
                if name != place:
                    lines.append(f"    {self._writer.constant(value)} {name} = {place};")
        lines += self._writer.scope(function.scope)
        for result, members in function.results.items():
            names = [element(result, member, number) for member in members for number in range(member.size)]
            for name, value in zip(names, function.values[result], strict=True):
                place = self._place(result, members, name, is_input=False)
                text = self._writer.text(value)
                lines.append(f"    return {text};" if result == function.returned else f"    {place} = {text};")
        unused = [name for name in function.arguments if name != "state" and name not in used]
        if not any("self->" in line for line in lines):
            unused.append("self")
        return "\n".join([self._signature(function), "{", *(f"    (void){name};" for name in unused), *lines, "}\n"])
