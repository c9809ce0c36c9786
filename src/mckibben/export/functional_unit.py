"""Program of an FMU, and its variables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
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
    units
        Units of the variables by structure and path, such as ``state.angle``.
    joints, muscles
        Names of joints and muscles, by which variables are described.
    """

    module: SourceModule
    title: str
    longest: float
    units: Mapping[str, str]
    sampled: bool = False
    model_exchange: bool = False
    joints: Sequence[str] = ()
    muscles: Sequence[str] = ()


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
    for name, place, path, start in _elements(module, "inputs", results.arguments["inputs"]):
        yield ScalarVariable(name, place, "i", unit.units.get(f"inputs.{path}", ""), start)
    rates = functions["differentiate"].results["rates"] if "differentiate" in functions else []
    moving = {member.path for member in rates}
    starts = {member.path: member.value.item() for member in functions["init"].arguments.get("start", [])}
    states: list[str] = []
    for name, place, path, _ in _elements(module, "model.state", module.state):
        if path in starts or path in moving:
            states.append(name)
            kind = "s" if path in starts else "c"
            yield ScalarVariable(name, place, kind, unit.units.get(f"state.{path}", ""), starts.get(path))
    for name, place, path, _ in _elements(module, "rates", rates):
        rate = per_second(unit.units.get(f"state.{path}", ""))
        yield ScalarVariable(f"der({name})", place, "o", rate, None, states.index(name))
    for name, place, path, _ in _elements(module, "results", results.results["results"]):
        yield ScalarVariable(name, place, "o", unit.units.get(f"results.{path}", ""))
    for member in module.members:
        symbol, short = unit.units.get(f"parameters.{member.path}", ""), member.path.removeprefix(module.prefix)
        for number, value in enumerate(member.value.flat):
            place = f"model.{element('parameters', member, number)}"
            yield ScalarVariable(_named(short, number if member.shape else None), place, "p", symbol, value.item())
    yield ScalarVariable("time", "time", "t")


_OF_MUSCLES = re.compile(r"(?:\b(?:pressure|temperature|command|tension)(\d+)$|\bmuscles\[(\d+)\])")
_OF_JOINTS = re.compile(
    r"\b(?:angles|velocities|torques|stiffness|friction|(?:stiffness|disturbance)_estimate|torque)\[(\d+)\]"
)


def description(name: str, joints: Sequence[str], muscles: Sequence[str]) -> str:
    """Joint or muscle that a variable belongs to, by its name; empty for others.

    Examples
    --------
    >>> joints, muscles = ("hip", "knee"), ("hip1", "hip2", "knee1", "knee2")
    >>> [description(name, joints, muscles) for name in ("measurement.pressure3", "angles[2]", "time")]
    ['muscle knee1', 'joint knee', '']
    """
    for kind, names, pattern in (("muscle", muscles, _OF_MUSCLES), ("joint", joints, _OF_JOINTS)):
        if names and (match := pattern.search(name.removeprefix("der(").removesuffix(")"))):
            return f"{kind} {names[int(next(filter(None, match.groups()))) - 1]}"
    return ""


def per_second(unit: str) -> str:
    """Unit of a rate.

    >>> per_second("rad"), per_second("rad/s"), per_second("")
    ('rad/s', 'rad/s^2', '')
    """
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s" if unit else ""


def _elements(module: SourceModule, structure: str, members: Sequence[Member]) -> Iterator[tuple[str, str, str, float]]:
    """Name, place, path and value of each number in a structure."""
    for member in members:
        for number, value in enumerate(member.value.flat):
            place = element(structure, member, number)
            yield _named(_short(member.path), number if member.shape else None), place, member.path, value.item()


def _short(path: str) -> str:
    """Path of a quantity of muscles or joints without what holds it; muscles count from 1, as their commands.

    Examples
    --------
    >>> [_short(path) for path in ("measurement.pressures.0", "air.temperatures.1", "position.angles.0", "position")]
    ['measurement.pressure1', 'temperature2', 'angles.0', 'angle']
    """
    path = re.sub(r"^(air\.(?=temperatures)|position\.)", "", re.sub("^position$", "angle", path))
    path = re.sub(r"^velocity\.angles\.", "velocities.", re.sub(r"^torque\.", "torques.", path))
    return re.sub(r"(pressure|temperature)s\.(\d+)$", lambda match: f"{match[1]}{int(match[2]) + 1}", path)


def _named(path: str, number: int | None) -> str:
    """Structured name from a path, counted from 1.

    Examples
    --------
    >>> _named("muscles.0.creep", 1)
    'muscles[1].creep[2]'
    """
    text = path if number is None else f"{path}.{number}"
    return re.sub(r"\.(\d+)", lambda match: f"[{int(match[1]) + 1}]", text)
