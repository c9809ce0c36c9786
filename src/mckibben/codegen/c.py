"""C99 writer: a header with structures, and a source file without memory allocation or recursion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mckibben.codegen.graph import Kind
from mckibben.codegen.languages import c_language
from mckibben.codegen.precision import wide_inputs, wide_values
from mckibben.codegen.source_module import Function, Member, SourceModule, element, element_names, is_scalar
from mckibben.codegen.templates import filled
from mckibben.codegen.writer import Writer


class Sources(NamedTuple):
    """Text of the header and of the source file."""

    header: str
    source: str


def comment_text(text: str) -> str:
    """Text that neither ends a comment of C, nor opens one in it, nor continues it on the next line.

    >>> comment_text("a */ b"), comment_text("of /* c")
    ('a * / b', 'of / * c')
    """
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

    Examples
    --------
    >>> import numpy as np
    >>> spring = SourceModule("spring", {"stiffness": np.array(40.0)})
    >>> spring.add("force", "force [N]", lambda p, x: {"force": -p["stiffness"] * x}, {"x": np.array(0.0)})
    >>> print(*write_c(spring).source.splitlines()[-5:], sep=chr(10))
    double spring_force(const spring *self, double x)
    {
        const double t1 = self->prepared.real[0] * x;
        return t1;
    }
    """
    wide_names = wide_inputs(module, wide) if single else frozenset[str]()
    language = c_language("float" if single else "double")
    writer = Writer(module.scopes, language, module.results(), wide_values(module, wide_names), c_language("double"))
    prepare, counts = writer.prepared(module.graph.root, "self->{}".format, "self->prepared.{}[{}]")
    members = module.members
    numbers = [language.literal(x.item(), member.kind) for member in members for x in member.value.flat]
    types = _Types(module.name, language.types, wide_names, units or {})
    lines = [f" * {line}".rstrip() for line in comment_text(comment).splitlines()]
    values = {
        "comment": "\n".join(["/*", *lines, " */"]),
        "name": module.name,
        "structures": _structures(module, types, dict(zip(Kind, counts, strict=True))),
        "defaults": list(zip(element_names("parameters", members), numbers, strict=True)),
        "prepare": prepare or ["    (void)self;"],
        "functions": [_function(function, writer, types) for function in module.functions],
        "helpers": sorted(writer.helpers),
    }
    return Sources(filled("module.h", values), filled("module.c", values))


class Structure(NamedTuple):
    """A structure in C: its name, a comment above it, and the declarations of its members."""

    name: str
    text: str
    lines: list[str]


class _Types(NamedTuple):
    """Types of a module's structures in C."""

    name: str  # of the module
    of: Mapping[Kind, str]
    wide: frozenset[str]  # inputs that are `double` in any case
    units: Mapping[str, str]

    def structure(self, name: str, members: Sequence[Member], text: str = "") -> Structure:
        """Structure with a line per member, and its unit as a comment."""
        lines = []
        for member in members:
            kind = "double" if element(name, member, 0) in self.wide else self.of[member.kind]
            size = f"[{member.size}]" if member.shape else ""
            unit = comment_text(self.units.get(f"{name}.{member.path}", ""))
            lines.append(f"{kind} {member.name}{size};" + f" /* {unit} */" * bool(unit))
        return Structure(f"{self.name}_{name}", text, lines)

    def signature(self, function: Function) -> str:
        """Declaration of a function: a single number is returned, other results are stored."""
        results = function.outputs
        returned = "void" if function.returned is None else self.of[results.pop(function.returned)[0].kind]
        texts = [f"{'' if 'state' in function.results else 'const '}{self.name} *self"]
        texts += [self.argument(name, members, is_input=True) for name, members in function.inputs.items()]
        texts += [self.argument(name, members, is_input=False) for name, members in results.items()]
        return f"{returned} {self.name}_{function.name}({', '.join(texts)})"

    def argument(self, name: str, members: Sequence[Member], *, is_input: bool) -> str:
        """Declaration of an argument: a number, or a pointer to a structure or a result."""
        if is_scalar(members):
            return f"{self.of[members[0].kind]} {'' if is_input else '*'}{name}"
        return f"{'const ' if is_input else ''}{self.name}_{name} *{name}"


def _structures(module: SourceModule, types: _Types, counts: Mapping[Kind, int]) -> list[Structure]:
    """All structures: parameters, what follows from them, the state, all of these, then arguments and results."""
    structures = {
        "parameters": types.structure("parameters", module.members, "may be changed; call prepare afterwards")
    }
    if any(counts.values()):
        lines = [f"{types.of[kind]} {kind.value}[{count}];" for kind, count in counts.items() if count]
        structures["prepared"] = Structure(f"{module.name}_prepared", "computed from the parameters", lines)
    if module.state:
        structures["state"] = types.structure("state", module.state, "from one step to the next")
    whole = Structure(module.name, "", [f"{module.name}_{member} {member};" for member in structures])
    return [*structures.values(), whole, *(types.structure(*structure) for structure in module.structures().items())]


def _function(function: Function, writer: Writer, types: _Types) -> dict[str, object]:
    """Description, signature and statements of a function."""
    used: set[str] = set()

    def place_of(name: str) -> str:
        used.add(structure := name.split(".", 1)[0])
        return f"self->{name}" if structure == "state" else name.replace(".", "->", 1)

    lines, last = writer.function(function.scope, place_of), list[str]()
    for result, members in function.results.items():
        for name, value in zip(element_names(result, members), function.values[result], strict=True):
            if result == function.returned:
                last = [f"    return {writer.text(value)};"]
            else:
                place = f"*{name}" if is_scalar(members) and result != "state" else place_of(name)
                lines.append(f"    {place} = {writer.text(value)};")
    lines += last
    unused = [name for name in function.inputs if name not in used and not function.guard]
    unused += ["self"] * (not any("self->" in line for line in lines))
    lines = [*(f"    (void){name};" for name in unused), *lines]
    return {"function": function, "signature": types.signature(function), "lines": lines}
