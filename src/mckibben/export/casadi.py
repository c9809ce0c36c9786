"""CasADi functions, for optimal control and estimation."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NamedTuple

from jaxtyping import Array, PyTree

from mckibben.codegen.source_module import SourceModule, element_names
from mckibben.errors import ExportError, ParameterError
from mckibben.export.controller import parts_of
from mckibben.export.evaluation import evaluate, find_function
from mckibben.export.plant import plant_unit
from mckibben.plant import Plant
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario


class CasadiPlant(NamedTuple):
    """CasADi functions of a plant by name, see `plant_unit`, in SI."""

    functions: dict[str, PyTree]
    state: tuple[str, ...]  # elements of the vector
    inputs: tuple[str, ...]
    left_out: tuple[str, ...]


def casadi_plant(
    scenario: Scenario | RobotScenario | Plant,
    *,
    substeps: int | None = None,
    parameters: Sequence[str] = (),
) -> CasadiPlant:
    """CasADi functions of a plant.

    Raises `ExportError` if CasADi is missing, a part of the plant cannot be expressed, or a robot's scenario has no
    controller; `ParameterError` if there is no such parameter.

    Parameters
    ----------
    scenario
        Scenario of a joint or a robot, or only a plant.
    substeps
        Integration steps of ``advance``. Default: those of a control period of the scenario; of a plant, 4.
    parameters
        Plant parameters that stay symbolic, in an additional argument, such as ``load.mass2``.

    Examples
    --------
    >>> import mckibben as mk
    >>> knee, load = mk.catalog.joint("knee-table-2"), mk.catalog.load("knee-table-2")
    >>> functions = casadi_plant(mk.JointPlant(knee, load, mk.FirstOrderValve(0.02))).functions
    >>> stiffness, tension1, tension2 = functions["evaluate"]([0.0, 0.0, 3e5, 3e5], [3e5, 3e5, 0.0]).elements()
    >>> round(stiffness, 2)  # as AntagonisticJoint.stiffness
    71.93
    """
    if isinstance(scenario, Scenario | RobotScenario):
        plant, _, start = parts_of(scenario)
        steps = substeps or scenario.needed_substeps()
    else:
        plant, steps, start = scenario, substeps or 4, scenario.unpressurised()
    unit = plant_unit(plant, start, "plant", 1.0, steps)
    names = [function.name for function in unit.module.functions]
    functions = {name: casadi_function(unit.module, name, parameters=parameters) for name in names}
    arguments = find_function(unit.module.functions, "advance").arguments
    state, inputs = (
        tuple(element.removeprefix(f"{name}.") for element in element_names(name, arguments[name]))
        for name in ("state", "inputs")
    )
    left_out = [] if plant.has_ideal_io else ["sensors and disturbance of the plant"]
    left_out += [] if plant.command_delay is None else ["delay of the commands"]
    if not unit.model_exchange:
        left_out.append("differentiate: the valves switch at integration steps; advance includes them")
    return CasadiPlant(functions, state, inputs, tuple(left_out))


def casadi_function(module: SourceModule, name: str, *, parameters: Sequence[str] = ()) -> Any:
    """A function of a module in CasADi, with a column vector per argument, the last one for symbolic parameters.

    Raises `ExportError` for an unknown function and for an operation without a counterpart; `ParameterError` for an
    unknown parameter.
    """
    casadi = _casadi()
    function = find_function(module.functions, name)
    symbols: dict[str, PyTree] = {}
    inputs: dict[str, PyTree] = {}
    names_by_argument = {argument: element_names(argument, members) for argument, members in function.arguments.items()}
    if parameters:
        symbolic = [parameters] if isinstance(parameters, str) else parameters
        names_by_argument["parameters"] = [_parameter(module, parameter) for parameter in symbolic]
    for argument, names in names_by_argument.items():
        symbols[argument] = casadi.SX.sym(argument, len(names))
        inputs.update({name: symbols[argument][place] for place, name in enumerate(names)})
    results = evaluate(module, function, _operations(casadi), inputs)
    columns = {result: casadi.vertcat(*map(casadi.SX, values)) for result, values in results.items()}
    labels = [f"{result}_after" if result in symbols else result for result in columns]
    return casadi.Function(name, list(symbols.values()), list(columns.values()), list(symbols), labels)


def _parameter(module: SourceModule, name: str) -> str:
    """Name of the input of a scalar parameter."""
    members = {member.path.removeprefix(module.prefix): member for member in module.members if not member.shape}
    if name not in members:
        remedy = f"choose from {', '.join(members)}"
        raise ParameterError(f"there is no parameter {name!r}", field="parameters", value=name, remedy=remedy)
    return element_names("parameters", [members[name]])[0]


def _casadi() -> ModuleType:
    """CasADi; raises `ExportError` without it."""
    try:
        import casadi
    except ImportError as error:
        remedy = "install it: pip install 'mckibben[casadi]'"
        raise ExportError("CasADi is not installed", field="casadi", remedy=remedy) from error
    return casadi


def _operations(ca: ModuleType) -> dict[str, Callable[..., PyTree]]:
    """Operations of graphs in CasADi."""
    same = ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh",
            "cosh", "tanh", "floor", "ceil", "sign")  # fmt: skip
    infix = ("add", "sub", "mul", "lt", "le", "gt", "ge", "eq", "ne", "neg")

    def nearest(x: Array) -> Array:
        """Half to even."""
        up = ca.floor(x + 0.5)
        return up - ca.if_else(ca.logic_and(up - x == 0.5, ca.fmod(up, 2) != 0), 1.0, 0.0)

    return {
        **{name: getattr(ca, name) for name in same},
        **{name: getattr(operator, name) for name in infix},
        "div": operator.truediv,
        "max": ca.fmax,
        "min": ca.fmin,
        "abs": ca.fabs,
        "pow": ca.power,
        "rem": ca.fmod,
        "and": ca.logic_and,
        "or": ca.logic_or,
        "xor": operator.ne,
        "not": ca.logic_not,
        "select": ca.if_else,
        "round": nearest,
        "cbrt": lambda x: ca.sign(x) * ca.power(ca.fabs(x), 1 / 3),
        "is_finite": lambda x: ca.fabs(x) < ca.inf,
        "real": lambda x: x,
        "integer": lambda x: ca.sign(x) * ca.floor(ca.fabs(x)),
        "boolean": lambda x: x != 0,
    }
