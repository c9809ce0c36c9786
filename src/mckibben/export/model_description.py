"""modelDescription.xml of an FMU (FMI 2.0)."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import mckibben
from mckibben.errors import printable
from mckibben.export.functional_unit import FunctionalUnit, ScalarVariable
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
    """Text of modelDescription.xml."""
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": "2.0",
            "modelName": unit.module.name,
            "guid": token,
            "description": printable(unit.title),
            "generationTool": f"mckibben {mckibben.__version__}",
            "variableNamingConvention": "structured",
            "numberOfEventIndicators": "0",
        },
    )
    _add_interfaces(root, unit, sources)
    _add_units(root, variables)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(float(unit.longest)))
    parent = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        _add_variable(parent, reference, variable, variables)
    _add_structure(ET.SubElement(root, "ModelStructure"), variables)
    ET.indent(root)
    return ET.tostring(root, "unicode", xml_declaration=True).replace("encoding='us-ascii'", "encoding='UTF-8'") + "\n"


def _add_interfaces(root: ET.Element, unit: FunctionalUnit, sources: Sequence[str]) -> None:
    """Interfaces for model exchange and co-simulation, with their capabilities."""
    completes = any(function.name == "project" for function in unit.module.functions)
    capabilities = {
        "ModelExchange": {"completedIntegratorStepNotNeeded": str(not completes).lower()},
        "CoSimulation": {"canHandleVariableCommunicationStepSize": str(not unit.sampled).lower()},
    }
    common = {
        "modelIdentifier": unit.module.name,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "canNotUseMemoryManagementFunctions": "true",
    }
    for kind, attributes in capabilities.items():
        if kind == "CoSimulation" or unit.model_exchange:
            files = ET.SubElement(ET.SubElement(root, kind, common | attributes), "SourceFiles")
            for source in sources:
                ET.SubElement(files, "File", name=source)


def _add_units(root: ET.Element, variables: Sequence[ScalarVariable]) -> None:
    """Units of the variables in terms of SI, and display units."""
    units = dict.fromkeys(variable.unit for variable in variables if variable.unit)
    if units:
        definitions = ET.SubElement(root, "UnitDefinitions")
        for unit in units:
            definition = ET.SubElement(definitions, "Unit", name=unit)
            powers = zip(_BASES, dimensions(unit), strict=True)
            ET.SubElement(definition, "BaseUnit", {base: str(power) for base, power in powers if power})
            if unit in _SHOWN:
                shown, factor = _SHOWN[unit]
                ET.SubElement(definition, "DisplayUnit", name=shown, factor=repr(factor))


def _add_variable(
    parent: ET.Element, reference: int, variable: ScalarVariable, variables: Sequence[ScalarVariable]
) -> None:
    causality, variability, initial = _ATTRIBUTES[variable.kind]
    rate = variable.rate_of is not None
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "causality": "local" if rate else causality,
        "variability": variability,
        "initial": initial,
    }
    states = [number for number, other in enumerate(variables, 1) if other.kind in "sc"]
    real = {
        "unit": variable.unit or None,
        "displayUnit": _SHOWN.get(variable.unit, (None,))[0],
        "nominal": repr(NOMINAL[variable.unit]) if variable.unit in NOMINAL else None,
        "start": None if variable.start is None else repr(float(variable.start)),
        "derivative": None if variable.rate_of is None else str(states[variable.rate_of]),  # an index from 1
    }
    scalar = ET.SubElement(parent, "ScalarVariable", _present(attributes))
    ET.SubElement(scalar, "Real", _present(real))


def _present(attributes: dict[str, str | None]) -> dict[str, str]:
    """The attributes that are not None."""
    return {name: value for name, value in attributes.items() if value is not None}


def _add_structure(parent: ET.Element, variables: Sequence[ScalarVariable]) -> None:
    """Outputs, derivatives and initial unknowns, by their indices from 1."""
    indices = {
        "Outputs": [n for n, v in enumerate(variables, 1) if v.kind == "s" or (v.kind == "o" and v.rate_of is None)],
        "Derivatives": [n for n, v in enumerate(variables, 1) if v.rate_of is not None],
        "InitialUnknowns": [n for n, v in enumerate(variables, 1) if v.kind in "co"],
    }
    for name, numbers in indices.items():
        if numbers:
            part = ET.SubElement(parent, name)
            for number in numbers:
                ET.SubElement(part, "Unknown", index=str(number))
