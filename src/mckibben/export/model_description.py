"""modelDescription.xml and buildDescription.xml of an FMU, of FMI 2.0 and 3.0."""

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
    unit: FunctionalUnit, variables: Sequence[ScalarVariable], token: str, sources: Sequence[str], version: int
) -> str:
    """Text of modelDescription.xml."""
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": unit.module.name,
            "guid" if version == 2 else "instantiationToken": token,
            "description": printable(unit.title),
            "generationTool": f"mckibben {mckibben.__version__}",
            "variableNamingConvention": "structured",
        },
    )
    if version == 2:
        root.set("numberOfEventIndicators", "0")
    _add_interfaces(root, unit, sources, version)
    _add_units(root, variables)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(float(unit.longest)))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, one in enumerate(variables):
        _add_variable(listed, reference, one, variables, version)
    _add_structure(ET.SubElement(root, "ModelStructure"), variables, version)
    return _text(root)


def build_description(name: str, sources: Sequence[str]) -> str:
    """Text of sources/buildDescription.xml, which FMI 3.0 uses instead of a list in modelDescription.xml."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    listed = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        ET.SubElement(listed, "SourceFile", name=source)
    return _text(root)


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, "unicode", xml_declaration=True).replace("encoding='us-ascii'", "encoding='UTF-8'") + "\n"


def _add_interfaces(root: ET.Element, unit: FunctionalUnit, sources: Sequence[str], version: int) -> None:
    """Interfaces for model exchange and co-simulation, with their capabilities."""
    state = "state" if version == 2 else "State"
    common = {"modelIdentifier": unit.module.name, f"canGetAndSetFMU{state}": "true", f"canSerializeFMU{state}": "true"}
    stepping = {"canHandleVariableCommunicationStepSize": str(not unit.sampled).lower()}
    completes = any(one.name == "project" for one in unit.module.functions)
    if version == 2:
        common["canNotUseMemoryManagementFunctions"] = "true"
        completing = {"completedIntegratorStepNotNeeded": str(not completes).lower()}
    else:
        completing = {"needsCompletedIntegratorStep": str(completes).lower()}
        stepping |= {"fixedInternalStepSize": repr(float(unit.longest))} if unit.sampled else {}
    for kind, attributes in (("ModelExchange", completing), ("CoSimulation", stepping)):
        if kind == "CoSimulation" or unit.model_exchange:
            interface = ET.SubElement(root, kind, common | attributes)
            if version == 2:
                listed = ET.SubElement(interface, "SourceFiles")
                for source in sources:
                    ET.SubElement(listed, "File", name=source)


def _add_units(root: ET.Element, variables: Sequence[ScalarVariable]) -> None:
    """Units of the variables in terms of SI, and display units."""
    units = dict.fromkeys(one.unit for one in variables if one.unit)
    if units:
        definitions = ET.SubElement(root, "UnitDefinitions")
        for one in units:
            definition = ET.SubElement(definitions, "Unit", name=one)
            powers = zip(_BASES, dimensions(one), strict=True)
            ET.SubElement(definition, "BaseUnit", {base: str(power) for base, power in powers if power})
            if one in _SHOWN:
                shown, factor = _SHOWN[one]
                ET.SubElement(definition, "DisplayUnit", name=shown, factor=repr(factor))


def _add_variable(
    parent: ET.Element, reference: int, one: ScalarVariable, variables: Sequence[ScalarVariable], version: int
) -> None:
    """A ScalarVariable with a Real (2.0), or a Float64 (3.0)."""
    causality, variability, initial = _ATTRIBUTES[one.kind]
    attributes = {
        "name": one.name,
        "valueReference": str(reference),
        "causality": causality,
        "variability": variability,
    }
    attributes |= {"initial": initial} if initial else {}
    real = {"unit": one.unit} if one.unit else {}
    if one.unit in _SHOWN:
        real["displayUnit"] = _SHOWN[one.unit][0]
    if one.unit in NOMINAL:
        real["nominal"] = repr(NOMINAL[one.unit])
    if one.start is not None:
        real["start"] = repr(float(one.start))
    if one.rate_of is not None:
        attributes["causality"] = "local"
        states = [number for number, other in enumerate(variables) if other.kind in "sc"]
        real["derivative"] = str(states[one.rate_of] + (version == 2))  # an index from 1, or a value reference
    if version == 2:
        ET.SubElement(ET.SubElement(parent, "ScalarVariable", attributes), "Real", real)
    else:
        ET.SubElement(parent, "Float64", attributes | real)


def _add_structure(parent: ET.Element, variables: Sequence[ScalarVariable], version: int) -> None:
    """Outputs, derivatives and initial unknowns."""
    numbered = list(enumerate(variables))
    outputs = [number for number, one in numbered if one.kind == "s" or (one.kind == "o" and one.rate_of is None)]
    rates = [number for number, one in numbered if one.rate_of is not None]
    computed = [number for number, one in numbered if one.kind in "co"]
    derivative = "Derivative" if version == 2 else "ContinuousStateDerivative"
    for name, references in (("Output", outputs), (derivative, rates), ("InitialUnknown", computed)):
        if version == 2 and references:
            part = ET.SubElement(parent, f"{name}s")
            for reference in references:
                ET.SubElement(part, "Unknown", index=str(reference + 1))
        elif version == 3:
            for reference in references:
                ET.SubElement(parent, name, valueReference=str(reference))
