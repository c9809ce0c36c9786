"""A module of source code: functions of adjustable parameters and a state."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.codegen.graph import Graph, Kind, Scope, Value, count_operations
from mckibben.codegen.lowering import Lowering, kind_of

_RESERVED = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true "
    "false class delete export extends finally function import in instanceof let new null super this throw try typeof "
    "var with yield".split()
)

_SLOW = "div", "rem", "sqrt"
_CALLED = (
    *("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
    *("pow", "cbrt"),
)


class Member(NamedTuple):
    """A number or an array in a structure."""

    name: str
    kind: Kind
    shape: tuple[int, ...]
    value: NDArray  # in the example from which the module was made
    path: str  # in the tree, such as decoupling.poles.bandwidth

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape))


@dataclass(frozen=True)
class Function:
    """A function, with arguments and results as named structures; `state` may be both.

    Attributes
    ----------
    arguments, results
        Members of each structure, by its name.
    values
        Values of the results in the graph, by the name of their structure, element by element.
    text
        Description, a comment in the source.
    guard
        Functions of arguments of this one: one that is called first; or that, a check, and another function, of which
        none is called if the check gives 0, the last one in place of this if it gives 1, and the first one before this
        if it gives 2. C and JavaScript have it.
    """

    name: str
    arguments: dict[str, list[Member]]
    results: dict[str, list[Member]]
    scope: Scope
    values: dict[str, list[Value]]
    text: str
    guard: tuple[Function, ...] = ()

    @property
    def inputs(self) -> dict[str, list[Member]]:
        """Arguments other than the state."""
        return {name: members for name, members in self.arguments.items() if name != "state"}

    @property
    def outputs(self) -> dict[str, list[Member]]:
        """Results other than the state."""
        return {name: members for name, members in self.results.items() if name != "state"}

    @property
    def call(self) -> str:
        """Call without results."""
        return f"{self.name}({', '.join(['self', *self.inputs])})"

    @property
    def returned(self) -> str | None:
        """Name of the result other than the state, if it is a single scalar."""
        name, *others = *self.outputs, ""
        return name if others == [""] and is_scalar(self.outputs[name]) else None


@dataclass
class SourceModule:
    """Functions of a tree of parameters and of their own arguments.

    Leaves of the parameters and arguments are numbers or arrays. Values that depend on parameters alone are computed
    once, in a separate function `prepare`.

    Parameters
    ----------
    name
        Name of the program, an identifier.
    parameters
        Tree of the parameters with their values.
    prefix
        Beginning of the paths of parameters and state that their names omit, such as ``controller.``.

    Examples
    --------
    >>> module = SourceModule("joint", {"damping": np.array(0.2)})
    >>> module.add("torque", "torque [N*m]", lambda p, velocity: {"torque": -p["damping"] * velocity},
    ...            {"velocity": np.array(0.0)})
    >>> [function.name for function in module.functions], module.functions[0].returned
    (['torque'], 'torque')
    """

    name: str
    parameters: PyTree
    prefix: str = ""  # prefix of parameter paths, omitted from names
    functions: list[Function] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin the graph, with the parameters as inputs."""
        self.graph = Graph(reciprocals=True, library=True)
        self.members = members_of(self.parameters, self.prefix)
        """Members of the parameter structure."""
        self._lowering = Lowering(self.graph)
        self._inputs = self._arrays("parameters", self.members)

    def add(
        self,
        name: str,
        text: str,
        function: Callable[..., Mapping[str, PyTree]],
        arguments: Mapping[str, PyTree],
        guard: Sequence[str] = (),
    ) -> None:
        """Add a function of the parameters and of named trees, which returns named trees.

        Raises `ExportError`, which names the operation and its place in the source, for one that cannot be written.

        Parameters
        ----------
        name, text
            Name of the function in the program, an identifier, and its description there.
        function
            Called once with `parameters` and the arguments by name, whose leaves are arrays; returns trees by name.
            A result ``state`` updates the argument of that name.
        arguments
            Examples of the arguments by name: pytrees of numbers and arrays, whose shapes and types are those of the
            program.
        guard
            Names of functions: see `Function`.
        """
        scope = self.graph.scope = self.graph.root.inner()
        members_by_argument = {name: self._members(name, tree) for name, tree in arguments.items()}
        inputs = [*self._inputs]
        for argument, members in members_by_argument.items():
            inputs += self._arrays(argument, members)
        leaves, shape = self._lowering.function(
            lambda parameters, *trees: dict(function(parameters, **dict(zip(arguments, trees, strict=True)))),
            (self.parameters, *arguments.values()),
            inputs,
        )
        remaining = map(self._lowering.plain, leaves)
        members_by_result, values = {}, {}
        for result, tree in shape.items():
            zeros = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), tree)
            members_by_result[result] = self._members(result, zeros)
            values[result] = [value for _ in jax.tree.leaves(tree) for value in next(remaining).flat]
            if result == "state":
                members_by_result[result], values[result] = _changed(members_by_result[result], values[result])
        self.graph.scope = self.graph.root
        guards = tuple(next(other for other in self.functions if other.name == guarding) for guarding in guard)
        self.functions.append(Function(name, members_by_argument, members_by_result, scope, values, text, guards))

    def worst_case(self, name: str) -> dict[str, int]:
        """Operations of a call of a function and its guards, at most, by kind; see `count_operations`.

        >>> module, number = SourceModule("decay", {"rate": np.array(3.0)}), np.array(0.0)
        >>> def repeated(p, x):
        ...     return {"y": jax.lax.fori_loop(0, 5, lambda i, y: jax.numpy.exp(-y) / (p["rate"] + x), x)}
        >>> module.add("repeated", "five times", repeated, {"x": number})
        >>> module.worst_case("repeated")  # five negations, and a sum outside of the loop
        {'additions, products, comparisons': 6, 'divisions, roots': 5, 'functions of math.h': 5}
        """
        function = next(function for function in self.functions if function.name == name)
        counts = sum(map(count_operations, (piece.scope for piece in (function, *function.guard))), Counter[str]())
        slow, called = ({kind: counts[kind] for kind in kinds} for kinds in (_SLOW, _CALLED))
        other = counts.total() - sum(slow.values()) - sum(called.values())
        return {
            "additions, products, comparisons": other,
            "divisions, roots": sum(slow.values()),
            "functions of math.h": sum(called.values()),
        }

    def _members(self, name: str, tree: PyTree) -> list[Member]:
        """Members of an argument or a result; the state has the prefix of the parameters."""
        return members_of(tree, self.prefix if name == "state" else "")

    @property
    def state(self) -> list[Member]:
        """Members of the state, if a function has one; a function may return a part of it."""
        structures = (structure for function in self.functions for structure in (function.arguments, function.results))
        return max((structure["state"] for structure in structures if "state" in structure), key=len, default=[])

    @property
    def scopes(self) -> list[Scope]:
        """Scope of the parameters, and scopes of the functions."""
        return [self.graph.root, *(function.scope for function in self.functions)]

    def results(self) -> list[Value]:
        """Values of all results."""
        return [value for function in self.functions for values in function.values.values() for value in values]

    def structures(self) -> dict[str, list[Member]]:
        """Arguments and results of all functions by name, except the state and scalars."""
        structures: dict[str, list[Member]] = {}
        for function in self.functions:
            for name, members in (function.arguments | function.results).items():
                if name != "state" and not is_scalar(members):
                    structures.setdefault(name, members)
        return structures

    def _arrays(self, name: str, members: Sequence[Member]) -> list[NDArray]:
        """Inputs for the members of a structure, in the current scope."""
        arrays = []
        for member in members:
            array = np.empty(member.shape, object)
            for number, at in enumerate(np.ndindex(*member.shape)):
                array[at] = self.graph.input(element(name, member, number), member.kind)
            arrays.append(array)
        return arrays


def _changed(members: Sequence[Member], values: Sequence[Value]) -> tuple[list[Member], list[Value]]:
    """Members of the state that a function changes, and their values."""
    remaining, changed, results = iter(values), list[Member](), list[Value]()
    for member in members:
        elements = [next(remaining) for _ in range(member.size)]
        inputs = element_names("state", [member])
        if any((value.operation, value.data) != ("input", name) for value, name in zip(elements, inputs, strict=True)):
            changed.append(member)
            results += elements
    return changed, results


def is_scalar(members: Sequence[Member]) -> bool:
    """Whether the members are a single number instead of a structure."""
    return len(members) == 1 and not members[0].path and not members[0].shape


def element(structure: str, member: Member, number: int) -> str:
    """Name of an element of a structure's member, which is the name of its input."""
    if not member.path and structure != "state":
        return structure
    return f"{structure}.{member.name}" + (f"[{number}]" if member.shape else "")


def element_names(structure: str, members: Sequence[Member]) -> list[str]:
    """Names of the elements of all members of a structure, in the order of their values."""
    return [element(structure, member, number) for member in members for number in range(member.size)]


def members_of(tree: PyTree, prefix: str = "") -> list[Member]:
    """Members of a structure for the leaves of a tree, with names from their paths without a prefix.

    >>> [member.name for member in members_of({"controller": {"kp": 1.0, "poles": (2.0, 3.0)}}, "controller.")]
    ['kp', 'poles_0', 'poles_1']
    """
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    paths = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves]
    names: dict[str, str] = {}
    for path in paths:
        name = identifier(path.removeprefix(prefix)) or "value"
        while name in names.values():
            name += "_"
        names[path] = name
    return [
        Member(names[path], kind_of(np.asarray(leaf).dtype), np.shape(leaf), np.asarray(leaf), path)
        for path, (_, leaf) in zip(paths, leaves, strict=True)
    ]


def identifier(text: str) -> str:
    """An identifier of C and JavaScript from any text.

    >>> identifier("muscle1.law.a1"), identifier("double"), identifier("2 Hz")
    ('muscle1_law_a1', '_double', '_2_Hz')
    """
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    return f"_{name}" if name in _RESERVED or name[:1].isdigit() else name
