"""Evaluation of a graph with the operations of a library, such as NumPy or CasADi."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from jaxtyping import PyTree

from mckibben.codegen.graph import Branch, ForLoop, Kind, Scope, StoredArray, Value, needed
from mckibben.codegen.source_module import Function, SourceModule, element_names
from mckibben.errors import ExportError

_OF_INTEGERS = {"and", "or", "xor", "not", "div"}  # operators that have another meaning there
Operations = Mapping[str, Callable[..., PyTree]]
"""Operations by name as in `codegen.graph.FOLDED`; truncating or bitwise integer operations end in ``_integer``."""


def evaluate(
    module: SourceModule, function: Function, operations: Operations, inputs: Mapping[str, object]
) -> dict[str, list[PyTree]]:
    """Results of a function, element by element, for inputs and parameters by their names in the graph.

    Parameters default to the module's values. Loops are unrolled, and both sides of a branch are computed. Raises
    `ExportError` for an operation that is missing, and for a loop that ends on a condition.

    Parameters
    ----------
    operations
        Functions of numbers or symbols by the name of their operation, and ``select``.
    inputs
        Values by the names of inputs, such as ``angle`` or ``pressures[0]``.

    Examples
    --------
    >>> import numpy as np
    >>> from mckibben.codegen.graph import FOLDED
    >>> module = SourceModule("spring", {"stiffness": np.array(40.0)})
    >>> module.add("force", "force [N]", lambda p, x: {"force": -p["stiffness"] * x}, {"x": np.array(0.0)})
    >>> evaluate(module, module.functions[0], FOLDED, {"x": 0.5})
    {'force': [-20.0]}
    >>> evaluate(module, module.functions[0], FOLDED, {"x": 0.5, "parameters.stiffness": 60.0})
    {'force': [-30.0]}
    """
    results = [value for values in function.values.values() for value in values]
    evaluation = _Evaluation(operations, _defaults(module) | dict(inputs), needed(results))
    evaluation.scope(module.graph.root)
    evaluation.scope(function.scope)
    return {name: [evaluation.value(value) for value in values] for name, values in function.values.items()}


def _defaults(module: SourceModule) -> dict[str, PyTree]:
    """Values of the parameters by the names of their inputs."""
    names = element_names("parameters", module.members)
    return dict(zip(names, [x.item() for member in module.members for x in member.value.flat], strict=True))


class _Evaluation:
    """Values of a graph computed so far."""

    def __init__(self, operations: Operations, inputs: Mapping[str, object], needed: set[int]) -> None:
        self._operations, self._inputs, self._needed = operations, inputs, needed
        self._known: dict[int, PyTree] = {}
        self._arrays: dict[int, list[PyTree]] = {}

    def value(self, value: Value) -> PyTree:
        """Value in the library."""
        if value.operation == "constant":
            return value.data
        return self._known[id(value.data if value.operation == "carried" else value)]

    def scope(self, scope: Scope) -> None:
        """Compute the statements of a scope."""
        for statement in scope.statements:
            if isinstance(statement, ForLoop):
                self._loop(statement)
            elif isinstance(statement, Branch):
                self._branch(statement)
            elif id(statement) not in self._needed:
                continue
            elif isinstance(statement, StoredArray):
                self._arrays[id(statement)] = [self.value(element) for element in statement.elements]
            else:
                self._known[id(statement)] = self._computed(statement)

    def _branch(self, branch: Branch) -> None:
        """Both blocks are computed, and one result is selected."""
        if id(branch) not in self._needed:
            return
        for scope in branch.scopes:
            self.scope(scope)
        for value in branch.chosen:
            if id(value) in self._needed:
                yes, no = (self.value(values[value.data[1]]) for values in branch.values)
                self._known[id(value)] = self._operations["select"](self.value(branch.condition), yes, no)

    def _computed(self, value: Value) -> PyTree:
        """Value of an input, an element or an operation."""
        arguments = [self.value(argument) for argument in value.arguments]
        if value.operation == "input":
            return self._inputs[value.data]
        if value.operation == "element":
            row = arguments[0] if arguments else 0
            return self._arrays[id(value.data.array)][row * value.data.stride + value.data.offset]
        name = value.operation
        if name in _OF_INTEGERS and value.kind is Kind.INTEGER:
            name = f"{name}_integer"
        if name not in self._operations:
            raise ExportError(
                f"the operation {name} is not available", field=name, remedy="use another option of this component"
            )
        return self._operations[name](*arguments)

    def _loop(self, loop: ForLoop) -> None:
        """All iterations of a loop, one after the other."""
        carried = [variable for variable in loop.carried if id(variable) in self._needed]
        arrays = [array for array in loop.arrays if id(array) in self._needed]
        if not carried and not arrays:
            return
        if loop.going is not None:
            remedy = "use another option of this component, or a fixed number of iterations"
            raise ExportError("a loop that ends on a condition cannot be unrolled", field="while", remedy=remedy)
        for variable in carried:
            self._known[id(variable)] = self.value(variable.initial)
        for array in arrays:
            self._arrays[id(array)] = [None] * array.size
        for index in range(loop.length):
            self._known[id(loop.index)] = index
            self.scope(loop.scope)
            row = loop.length - 1 - index if loop.row is not loop.index else index
            for array in arrays:
                size = len(array.elements)
                elements = [self.value(element) for element in array.elements]
                self._arrays[id(array)][row * size : (row + 1) * size] = elements
            following = [self.value(variable.following) for variable in carried]
            self._known.update(zip(map(id, carried), following, strict=True))


def find_function(functions: Sequence[Function], name: str) -> Function:
    """Function by name."""
    for function in functions:
        if function.name == name:
            return function
    names = ", ".join(function.name for function in functions)
    raise ExportError(f"there is no function {name!r}", field="function", value=name, remedy=f"choose {names}")
