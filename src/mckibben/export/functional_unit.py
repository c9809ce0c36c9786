"""Program of an FMU, and its variables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from mckibben.codegen.source_module import Member, SourceModule, element
from mckibben.errors import ExportError


@dataclass(frozen=True)
class FunctionalUnit:
    """Program of an FMU, with functions `init`, `evaluate`, `advance` and possibly `differentiate` and `project`.

    Attributes
    ----------
    longest
        Longest step [s] of `advance`; a communication step is a whole number of them if `sampled`.
    start
        Start values by the path of a state or input.
    units
        Units of the variables by structure and path, such as ``state.angle``.
    names
        Names of states that replace their paths.
    """

    module: SourceModule
    title: str
    longest: float
    start: Mapping[str, float]
    units: Mapping[str, str]
    names: Mapping[str, str] = field(default_factory=dict)
    sampled: bool = False
    model_exchange: bool = False


class ScalarVariable(NamedTuple):
    """A scalar variable of an FMU; its index in the list of all is its value reference."""

    name: str
    place: str  # in the C structure
    kind: str  # p, s, c, i, o, t as in the template
    unit: str = ""
    start: float | None = None
    rate_of: int | None = None  # index among the states


def variables_of(unit: FunctionalUnit) -> tuple[list[ScalarVariable], list[str]]:
    """Variables of an FMU, and the names of non-finite parameters, which a description cannot contain."""
    variables, fixed = list[ScalarVariable](), list[str]()
    for variable in _variables(unit):
        if variable.start is None or math.isfinite(variable.start):
            variables.append(variable)
        elif variable.kind == "p":
            fixed.append(variable.name)
        else:
            name, remedy = variable.name, "give a finite number in the scenario"
            raise ExportError(f"the start of {name} is not finite", field=name, value=variable.start, remedy=remedy)
    return variables, fixed


def _variables(unit: FunctionalUnit) -> Iterator[ScalarVariable]:
    """Inputs, states with their rates, results, parameters, time."""
    module, functions = unit.module, {function.name: function for function in unit.module.functions}
    results = functions["evaluate"]
    for name, place, path in _elements(module, "inputs", results.arguments["inputs"]):
        yield ScalarVariable(name, place, "i", unit.units.get(f"inputs.{path}", ""), unit.start[path])
    rates = functions["differentiate"].results["rates"] if "differentiate" in functions else []
    paths = {member.path: name for member in rates for name in [unit.names.get(member.path, member.path)]}
    states = {}
    for name, place, path in _elements(module, "model.state", module.state):
        if path in unit.start or path in paths:
            states[path] = unit.names.get(path, name)
            kind = "s" if path in unit.start else "c"
            yield ScalarVariable(states[path], place, kind, unit.units.get(f"state.{path}", ""), unit.start.get(path))
    for _, place, path in _elements(module, "rates", rates):
        held = unit.units.get(f"state.{path}", "")
        yield ScalarVariable(f"der({states[path]})", place, "o", _per_second(held), None, list(states).index(path))
    for name, place, path in _elements(module, "results", results.results["results"]):
        yield ScalarVariable(name, place, "o", unit.units.get(f"results.{path}", ""))
    for member in module.members:
        symbol, short = unit.units.get(f"parameters.{member.path}", ""), member.path.removeprefix(module.prefix)
        for number, value in enumerate(member.value.flat):
            place = f"model.{element('parameters', member, number)}"
            yield ScalarVariable(_named(short, number if member.shape else None), place, "p", symbol, value.item())
    yield ScalarVariable("time", "time", "t")


def _per_second(unit: str) -> str:
    """Unit of a rate.

    >>> _per_second("rad"), _per_second("rad/s"), _per_second("")
    ('rad/s', 'rad/s^2', '')
    """
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s" if unit else ""


def _elements(module: SourceModule, structure: str, members: Sequence[Member]) -> Iterator[tuple[str, str, str]]:
    """Name, place and path of each number in a structure."""
    for member in members:
        for number in range(member.size):
            place = element(structure, member, number)
            yield _named(member.path, number if member.shape else None), place, member.path


def _named(path: str, number: int | None) -> str:
    """Structured name from a path, counted from 1.

    Examples
    --------
    >>> _named("muscles.0.creep", 1)
    'muscles[1].creep[2]'
    """
    text = path if number is None else f"{path}.{number}"
    return re.sub(r"\.(\d+)", lambda match: f"[{int(match[1]) + 1}]", text)
