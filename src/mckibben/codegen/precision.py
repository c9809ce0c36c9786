"""Mixed precision: values of a single-precision program that stay `double`, as they depend on some arguments alone.

Derivatives of a sampled reference, for example, are differences of nearly equal numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from mckibben.codegen.graph import Kind, Scope, Value
from mckibben.codegen.source_module import SourceModule, element_names


def wide_values(module: SourceModule, inputs: Collection[str]) -> set[int]:
    """Identities of the values that depend only on some inputs and on parameters.

    Parameters
    ----------
    inputs
        Names of the inputs, such as ``setpoint.angle``.
    """
    root = module.graph.root
    wide, narrow = set[int](), set[int]()
    for function in module.functions:
        for value in _statements(function.scope):
            if value.operation == "input":
                (wide if value.data in inputs else narrow).add(id(value))
            elif value.operation == "element":
                narrow.add(id(value))
            else:
                others = [other for other in value.arguments if other.scope is not root]
                if any(id(other) in narrow or other.operation in ("carried", "index") for other in others):
                    narrow.add(id(value))
                elif any(id(other) in wide for other in others):
                    wide.add(id(value))
    return wide


def wide_inputs(module: SourceModule, arguments: Collection[str]) -> frozenset[str]:
    """Names of inputs that are members of some arguments, or of the state and depend on those alone.

    A member of the state is dropped from the candidates if a function gives it a value that depends on anything else,
    until none is dropped.
    """
    inputs = {
        element_name
        for function in module.functions
        for name, members in function.arguments.items()
        if name in (*arguments, "state")
        for element_name in element_names(name, [member for member in members if member.kind is Kind.REAL])
    }
    while True:
        wide = wide_values(module, inputs)
        lost = {name for name, value in _states(module) if name in inputs and id(value) not in wide}
        if not lost:
            return frozenset(inputs)
        inputs -= lost


def _states(module: SourceModule) -> Iterator[tuple[str, Value]]:
    """State inputs, and their values after each function that takes them as arguments."""
    for function in module.functions:
        if "state" in function.arguments and "state" in function.results:
            names = element_names("state", function.results["state"])
            yield from zip(names, function.values["state"], strict=True)


def _statements(scope: Scope) -> Iterator[Value]:
    """Values of a scope."""
    return (statement for statement in scope.statements if isinstance(statement, Value))
