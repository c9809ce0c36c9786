"""modelDescription.xml of an FMU (FMI 2.0).

Units are given by their exponents of the base units of SI, with a display unit (deg, bar, mm, ms) where there is one.
"""

from __future__ import annotations

from collections.abc import Sequence

from mckibben.export.functional_unit import FunctionalUnit, ScalarVariable, description
from mckibben.export.targets import filled
from mckibben.units import deg, dimensions

NOMINAL = {"Pa": 1e5, "N": 100.0}
"""Nominal values by unit; others are 1."""
_BASES = ("m", "kg", "s", "rad", "K")
_SHOWN = {"rad": ("deg", 1 / deg), "rad/s": ("deg/s", 1 / deg), "Pa": ("bar", 1e-5), "m": ("mm", 1e3), "s": ("ms", 1e3)}
_ATTRIBUTES = {  # causality, variability and initial of each kind
    "p": ("parameter", "tunable", "exact"),
    "s": ("output", "continuous", "exact"),
    "c": ("local", "continuous", "calculated"),
    "i": ("input", "continuous", None),
    "o": ("output", "continuous", "calculated"),
    "t": ("independent", "continuous", None),
}


def model_description(
    unit: FunctionalUnit, variables: Sequence[ScalarVariable], token: str, sources: Sequence[str]
) -> str:
    """Text of modelDescription.xml; indices there count from 1."""
    completes = any(function.name == "project" for function in unit.module.functions)
    interfaces = {"CoSimulation": {"canHandleVariableCommunicationStepSize": str(not unit.sampled).lower()}}
    if unit.model_exchange:
        exchange = {"ModelExchange": {"completedIntegratorStepNotNeeded": str(not completes).lower()}}
        interfaces = exchange | interfaces
    units = dict.fromkeys(variable.unit for variable in variables if variable.unit)
    powers = {unit: zip(_BASES, dimensions(unit), strict=True) for unit in units}
    states = [number for number, variable in enumerate(variables, 1) if variable.kind in "sc"]
    values = {
        "name": unit.module.name,
        "title": unit.title,
        "token": token,
        "interfaces": interfaces,
        "sources": sources,
        "units": {unit: {base: power for base, power in powers[unit] if power} for unit in units},
        "shown": _SHOWN,
        "step": float(unit.longest),
        "variables": [_attributes(unit, number, variable, states) for number, variable in enumerate(variables)],
        "structure": _structure(variables),
    }
    return filled("modelDescription.xml", values)


def _structure(variables: Sequence[ScalarVariable]) -> dict[str, list[int]]:
    """Outputs, derivatives and initial unknowns."""
    kinds = [(variable.kind, variable.rate_of is not None) for variable in variables]
    return {
        "Outputs": [n for n, (kind, rate) in enumerate(kinds, 1) if kind == "s" or (kind == "o" and not rate)],
        "Derivatives": [n for n, (_, rate) in enumerate(kinds, 1) if rate],
        "InitialUnknowns": [n for n, (kind, _) in enumerate(kinds, 1) if kind in "co"],
    }


def _attributes(
    unit: FunctionalUnit, reference: int, variable: ScalarVariable, states: Sequence[int]
) -> tuple[dict[str, object], dict[str, object]]:
    """Attributes of a scalar variable, and of its real number; None for those that it does not have.

    Parameters
    ----------
    reference
        Value reference: index among all variables.
    states
        Indices of the states, counted from 1, for the attribute ``derivative``.
    """
    causality, variability, initial = _ATTRIBUTES[variable.kind]
    scalar: dict[str, object] = {
        "name": variable.name,
        "description": None if variable.kind == "p" else description(variable.name, unit.joints, unit.muscles) or None,
        "valueReference": reference,
        "causality": causality if variable.rate_of is None else "local",
        "variability": variability,
        "initial": initial,
    }
    real: dict[str, object] = {
        "unit": variable.unit or None,
        "displayUnit": _SHOWN.get(variable.unit, (None,))[0],
        "nominal": NOMINAL.get(variable.unit),
        "start": None if variable.start is None else float(variable.start),
        "derivative": None if variable.rate_of is None else states[variable.rate_of],
    }
    return scalar, real
