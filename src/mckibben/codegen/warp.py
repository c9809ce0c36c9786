"""Writer for NVIDIA Warp: functions in Python that Warp compiles for the CPU or a GPU, in 32 bits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mckibben.codegen.graph import Kind, Value
from mckibben.codegen.languages import literals
from mckibben.codegen.source_module import Function, SourceModule, element_names, identifier
from mckibben.codegen.writer import ATOM, Language, Text, Writer, inputs_of
from mckibben.errors import ExportError

_TYPES = {Kind.REAL: "float", Kind.INTEGER: "int", Kind.BOOLEAN: "bool"}
_ZEROS = {"float": "0.0", "int": "0", "bool": "False"}
_SAME = ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "sqrt", "floor",
         "ceil", "cbrt", "pow", "abs", "max", "min")  # fmt: skip


def write_warp(module: SourceModule) -> str:
    """Write a module as functions of Warp.

    The functions take `model` (a struct of arrays with a row per world), `world`, and the elements of their arguments,
    and return the elements of their results. ``PARAMETERS`` has the values of the parameters by path, ``prepare`` is a
    kernel that computes what follows from them. Raises `ExportError` for operations on the bits of numbers.
    """
    writer = _Writer(module.scopes, WARP, module.results())
    needed = {value.data for value in inputs_of(module.graph.root) if writer.is_needed(value)}
    lines, places = [], {}
    for member in module.members:
        names = element_names("parameters", [member])
        if needed.intersection(names):
            values = [float(value) for value in member.value.flat]
            lines.append(f"    {member.path.removeprefix(module.prefix)!r}: ({len(places)}, {values!r}),")
            places |= {name: f"model.parameters[world, {len(places) + place}]" for place, name in enumerate(names)}
    stored, counts = writer.prepared(
        module.graph.root,
        places.get,
        "model.{}[world, {}]",
    )
    prepare = ["@wp.kernel", "def prepare(model: Model):", "    world = wp.tid()", *stored, ""]
    functions = [_function(function, writer) for function in module.functions]
    return "\n".join(
        [
            "# name: place of the first element, and the elements, of which each world has its own",
            "PARAMETERS = {",
            *lines,
            "}",
            f"PREPARED = {tuple(counts)!r}  # numbers, integers and booleans that follow from the parameters",
            "",
            "",
            *sorted(writer.helpers),
            *prepare,
            "",
            *functions,
        ]
    )


def _function(function: Function, writer: _Writer) -> str:
    """Text of a function of Warp, whose arguments and results are single numbers."""
    inputs = [
        (identifier(name), _TYPES[member.kind])
        for structure, members in function.arguments.items()
        for member in members
        for name in element_names(structure, [member])
    ]
    for value in inputs_of(function.scope):
        writer.name(value, identifier(value.data))
    lines = writer.scope(function.scope)
    values = [writer.text(value) for values in function.values.values() for value in values]
    arguments = ", ".join(["model: Model", "world: int", *(f"{name}: {kind}" for name, kind in inputs)])
    text = [f"# {function.text}", "@wp.func", f"def {function.name}({arguments}):"]
    return "\n".join([*text, *lines, f"    return {', '.join(values)}", "\n"])


class _Writer(Writer):
    """Writes Python, as far as Warp compiles it.

    Conditional expressions and logical operators are those of Warp; a variable that changes is declared by its type, as
    Warp would take it for a constant otherwise.
    """

    of_integers: Mapping[str, str] = {}  # Warp has functions
    end = ""
    branch_heads = "if {}:", "else:"  # pyrefly: ignore[bad-override]
    block_end = ()

    def declared(self, kind: str, name: str, text: str | None = None) -> str:
        if not kind:
            return f"{name} = {text}"
        return f"{name} = {kind}({_ZEROS[kind] if text is None else text})"  # a variable that changes, not an alias

    def loop_head(self, index: str, length: int, going: str | None) -> list[str]:
        return [f"for {index} in range({length}):"] if going is None else [f"{index} = int(0)", f"while {going}:"]

    def loop_end(self, index: str, going: str | None) -> Sequence[str]:
        return [] if going is None else [f"    {index} += 1"]

    def _operation(self, value: Value) -> Text:
        """Text of an operation; selections are calls of `wp.where`, logical operators are words."""
        name = value.operation
        if name in ("select", "not") or (name in ("and", "or") and value.kind is Kind.BOOLEAN):
            texts = [self._argument(value, argument)[0] for argument in value.arguments]
            if name == "select":
                return f"wp.where({', '.join(texts)})", ATOM
            return (f"(not ({texts[0]}))" if name == "not" else f"(({texts[0]}) {name} ({texts[1]}))"), ATOM
        if name not in WARP.functions and name in ("bits", "from_bits", "from_bits_32", "single"):
            raise ExportError(f"{name} needs 64-bit integers", field=name, remedy="export to C")
        return super()._operation(value)


def _conversion(text: str, source: Kind, target: Kind) -> str:
    """Text of a number of another kind."""
    if target is Kind.BOOLEAN:
        return f"{text} != {'0.0' if source is Kind.REAL else '0'}"
    return f"{_TYPES[target]}({text})"


def _array(name: str, kind: Kind, size: int, elements: Sequence[str] | None, constant: bool) -> str:
    """Declaration of a vector."""
    values = f"{', '.join(elements)}, " if elements else ""
    return f"{name} = wp.vector({values}length={size}, dtype={_TYPES[kind]})"


def _helper(name: str, arguments: str, *lines: str) -> str:
    """Text of a function that Warp lacks."""
    typed = ", ".join(f"{argument}: float" for argument in arguments.split(", "))
    return "\n".join(["@wp.func", f"def {name}({typed}):", *(f"    {line}" for line in lines), "\n"])


WARP = Language(
    types=_TYPES,
    constants=dict.fromkeys(Kind, ""),
    functions={
        **{name: f"wp.{name}" for name in _SAME},
        "round": "wp.rint",
        "rem": "wp.mod",
        "is_finite": "wp.isfinite",
        "sign": "sign",
        "expm1": "expm1",
        "log1p": "log1p",
    },
    helpers={
        "sign": _helper("sign", "x", "return wp.where(x > 0.0, 1.0, wp.where(x < 0.0, -1.0, 0.0))"),
        # W. Kahan: exact to rounding, as the error of exp and log cancels
        "expm1": _helper(
            "expm1", "x", "y = wp.exp(x)", "z = y - 1.0", "if z == -1.0 or not wp.isfinite(y):", "    return z",
            "return wp.where(z == 0.0, x, z * x / wp.log(y))",
        ),
        "log1p": _helper(
            "log1p", "x", "y = 1.0 + x", "z = y - 1.0", "return wp.where(z == 0.0, x, wp.log(y) * x / z)"
        ),
    },
    literal=literals("wp.nan", "wp.inf", booleans=("False", "True"), single=True),
    conversion=_conversion,
    array=_array,
)  # fmt: skip
