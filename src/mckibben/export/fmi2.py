"""FMUs of FMI 2.0: description, sources and archive of a program for model exchange and co-simulation."""

from __future__ import annotations

import hashlib
import io
import math
import os
import platform
import re
import shlex
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import mckibben
from mckibben.codegen.c import write_c
from mckibben.codegen.graph import Kind
from mckibben.codegen.languages import c_language
from mckibben.codegen.source_module import Function, SourceModule, element, is_scalar
from mckibben.units import deg, dimensions

_HEADERS = ("fmi2TypesPlatform.h", "fmi2FunctionTypes.h", "fmi2Functions.h")
_BASES = ("m", "kg", "s", "rad")
_SHOWN = {"rad": ("deg", 1 / deg), "rad/s": ("deg/s", 1 / deg), "Pa": ("bar", 1e-5), "m": ("mm", 1e3), "s": ("ms", 1e3)}
_NOMINAL = {"Pa": 1e5, "N": 100.0}
_DATE = (1980, 1, 1, 0, 0, 0)  # of the files in the archive, so that equal FMUs are equal files
_LONGEST = 300.0  # s, of a compilation


@dataclass(frozen=True)
class FunctionalUnit:
    """A program with what an FMU adds to it.

    Its functions are `init`, of `start` and `inputs`, members of `start` being those of the state; `evaluate`, of state
    and inputs, with `results`; `differentiate`, of the same, with the `rates` of members of the state; `advance`, of
    state, inputs and `duration` [s]; and `project`, after a step of an integrator. All but `evaluate` may be missing.
    """

    module: SourceModule
    title: str
    longest: float  # step [s] of `advance`
    start: Mapping[str, float]  # by the path of a state or input
    units: Mapping[str, str]  # of variables, by structure and path
    names: Mapping[str, str] = field(default_factory=dict)  # of states in place of their paths
    fixed: tuple[str, ...] = ()  # parameters that are none of the FMU
    sampled: bool = False  # whether a step is a whole number of periods `longest`
    model_exchange: bool = False


class _Variable(NamedTuple):
    """A number of an FMU."""

    name: str
    place: str  # in the C structure
    kind: str  # p, s, c, i, o as in the template
    unit: str
    start: float | None = None
    rate_of: int | None = None  # index of a state


def fmu(unit: FunctionalUnit, scenario: str) -> tuple[bytes, str]:
    """Content of an FMU, and why it has no binary, or nothing."""
    variables = list(_variables(unit))
    name = unit.module.name
    version = mckibben.__version__
    comment = f"{unit.title}\nWritten by mckibben {version}; the scenario is in resources/scenario.yaml."
    sources = write_c(unit.module, comment, units=dict(unit.units))
    wrapper = _wrapper(unit, variables)
    digest = hashlib.sha256("".join([scenario, *sources, wrapper]).encode()).hexdigest()
    guid = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": _description(unit, variables, guid),
        f"sources/{name}.h": sources.header,
        f"sources/{name}.c": sources.source,
        "sources/fmu.c": wrapper.replace("$guid", guid),
        **{f"sources/{one}": _template(one) for one in _HEADERS},
        "resources/scenario.yaml": scenario,
    }
    binary, missing = _binary(contents, name)
    if binary:
        contents[f"binaries/linux64/{name}.so"] = binary
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path, content in contents.items():
            entry = zipfile.ZipInfo(path, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            file.writestr(entry, content)
    return archive.getvalue(), missing


def _template(name: str) -> str:
    return (files("mckibben.export") / "templates" / "fmi2" / name).read_text(encoding="utf-8")


def _variables(unit: FunctionalUnit) -> Iterator[_Variable]:
    """Inputs, states with their rates, results, parameters."""
    module, functions = unit.module, {one.name: one for one in unit.module.functions}
    results = functions["evaluate"]
    for name, place, path in _elements(module, "inputs", results.arguments["inputs"]):
        yield _Variable(name, place, "i", unit.units.get(f"inputs.{path}", ""), unit.start[path])
    rates = functions["differentiate"].results["rates"] if "differentiate" in functions else []
    paths = {member.path: name for member in rates for name in [unit.names.get(member.path, member.path)]}
    states = {}
    for name, place, path in _elements(module, "model.state", module.state):
        if path in unit.start or path in paths:
            states[path] = unit.names.get(path, name)
            kind = "s" if path in unit.start else "c"
            yield _Variable(states[path], place, kind, unit.units.get(f"state.{path}", ""), unit.start.get(path))
    for _, place, path in _elements(module, "rates", rates):
        held = unit.units.get(f"state.{path}", "")
        yield _Variable(f"der({states[path]})", place, "o", _per_second(held), None, list(states).index(path))
    for name, place, path in _elements(module, "results", results.results["results"]):
        yield _Variable(name, place, "o", unit.units.get(f"results.{path}", ""))
    for member in module.members:
        if member.path not in unit.fixed:
            given = unit.units.get(f"parameters.{member.path}", "")
            for number, value in enumerate(member.value.flat):
                place = f"model.{element('parameters', member, number)}"
                short = member.path.removeprefix(module.prefix)
                yield _Variable(_named(short, number if member.shape else None), place, "p", given, value.item())


def _per_second(unit: str) -> str:
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s" if unit else ""


def _elements(module: SourceModule, structure: str, members: Any) -> Iterator[tuple[str, str, str]]:
    """Name, place and path of each number in a structure."""
    for member in members:
        for number in range(member.size):
            place = element(structure, member, number)
            yield _named(member.path, number if member.shape else None), place, member.path


def _named(path: str, number: int | None) -> str:
    """A structured name from a path, such as muscles[1].creep[1]."""
    text = path if number is None else f"{path}.{number}"
    return re.sub(r"\.(\d+)", lambda match: f"[{int(match[1]) + 1}]", text)


def _wrapper(unit: FunctionalUnit, variables: list[_Variable]) -> str:
    """Source of the functions of the standard, in which `$guid` is left."""
    module = unit.module
    functions = {one.name: one for one in module.functions}
    structures = [f"    {module.name}_{one} {one};" for one in module.structures()]
    states = [number for number, one in enumerate(variables) if one.kind in "sc"]
    rates = [number for number, one in enumerate(variables) if one.rate_of is not None]
    states = [states[variables[number].rate_of or 0] for number in rates]
    started = [
        f"self->start.{one.name} = self->model.state.{one.name};" for one in module.structures().get("start", [])
    ]
    calls = {
        "initialize(content *self)": ("init",),
        "results(content *self)": ("evaluate", "differentiate"),
        "advance(content *self, double duration)": ("advance",),
        "project(content *self)": ("project",),
    }
    text = []
    for signature, called in calls.items():
        lines = [_call(module, functions[one]) for one in called if one in functions]
        lines = started + lines if "init" in called else lines
        unused = [one for one in ("self", "duration") if one in signature and not any(one in line for line in lines)]
        body = [*(f"(void){one};" for one in unused), *lines]
        text.append("\n".join([f"static void {signature}", "{", *(f"    {line}" for line in body), "}\n"]))
    starts = [c_language().literal(one.start or 0.0, Kind.REAL) for one in variables]
    table = [
        f"    {{offsetof(content, {one.place}), '{one.kind}', {start}, {_NOMINAL.get(one.unit, 1.0)!r}}},"
        for one, start in zip(variables, starts, strict=True)
    ]
    references = {
        "state_references": ", ".join(map(str, states)) or "0",
        "rate_references": ", ".join(map(str, rates)) or "0",
    }
    return Template(_template("fmu.c")).safe_substitute(
        references,
        name=module.name,
        title=unit.title.replace("*/", "* /"),
        variables=len(variables),
        states=len(states),
        model_exchange=int(unit.model_exchange),
        sampled=int(unit.sampled),
        longest=repr(float(unit.longest)),
        structures="\n".join(structures),
        table="\n".join(table),
        calls="\n".join(text),
    )


def _call(module: SourceModule, function: Function) -> str:
    """A call of a function with the structures of an instance."""
    given = [(name, one) for name, one in function.arguments.items() if name != "state"]
    given += [(name, one) for name, one in function.results.items() if name != "state"]
    arguments = ["&self->model", *(name if is_scalar(one) else f"&self->{name}" for name, one in given)]
    return f"{module.name}_{function.name}({', '.join(arguments)});"


def _description(unit: FunctionalUnit, variables: list[_Variable], guid: str) -> str:
    """Text of modelDescription.xml."""
    name = unit.module.name
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=name,
        guid=guid,
        description=unit.title,
        generationTool=f"mckibben {mckibben.__version__}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    common = {
        "modelIdentifier": name,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
    }
    stepping = {"canHandleVariableCommunicationStepSize": str(not unit.sampled).lower()}
    steps = any(one.name == "project" for one in unit.module.functions)
    completing = {} if steps else {"completedIntegratorStepNotNeeded": "true"}
    for kind, attributes in (("ModelExchange", completing), ("CoSimulation", stepping)):
        if kind == "CoSimulation" or unit.model_exchange:
            sources = ET.SubElement(ET.SubElement(root, kind, common | attributes), "SourceFiles")
            for source in (f"{name}.c", "fmu.c"):
                ET.SubElement(sources, "File", name=source)
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
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(float(unit.longest)))
    listed = ET.SubElement(root, "ModelVariables")
    states = [number for number, one in enumerate(variables, 1) if one.kind in "sc"]
    for number, one in enumerate(variables):
        _add_variable(listed, number, one, states)
    _add_structure(ET.SubElement(root, "ModelStructure"), variables)
    ET.indent(root)
    return ET.tostring(root, "unicode", xml_declaration=True).replace("encoding='us-ascii'", "encoding='UTF-8'") + "\n"


def _add_variable(parent: ET.Element, reference: int, one: _Variable, states: list[int]) -> None:
    """A ScalarVariable of the description."""
    causality, variability, initial = {
        "p": ("parameter", "tunable", "exact"),
        "s": ("output", "continuous", "exact"),
        "c": ("local", "continuous", "calculated"),
        "i": ("input", "continuous", None),
        "o": ("output" if one.rate_of is None else "local", "continuous", "calculated"),
    }[one.kind]
    attributes = {"initial": initial} if initial else {}
    scalar = ET.SubElement(
        parent,
        "ScalarVariable",
        {
            "name": one.name,
            "valueReference": str(reference),
            "causality": causality,
            "variability": variability,
            **attributes,
        },
    )
    real = {"unit": one.unit} if one.unit else {}
    if one.unit in _SHOWN:
        real["displayUnit"] = _SHOWN[one.unit][0]
    if one.unit in _NOMINAL:
        real["nominal"] = repr(_NOMINAL[one.unit])
    if one.start is not None:
        real["start"] = repr(float(one.start)).upper() if math.isinf(one.start) else repr(float(one.start))
    if one.rate_of is not None:
        real["derivative"] = str(states[one.rate_of])
    ET.SubElement(scalar, "Real", real)


def _add_structure(parent: ET.Element, variables: list[_Variable]) -> None:
    """Outputs, derivatives, and what is computed in the beginning."""
    numbered = list(enumerate(variables, 1))
    outputs = [number for number, one in numbered if one.kind == "s" or (one.kind == "o" and one.rate_of is None)]
    rates = [number for number, one in numbered if one.rate_of is not None]
    computed = [number for number, one in numbered if one.kind in "co"]
    for name, indices in (("Outputs", outputs), ("Derivatives", rates), ("InitialUnknowns", computed)):
        if indices:
            part = ET.SubElement(parent, name)
            for index in indices:
                ET.SubElement(part, "Unknown", index=str(index))


def _binary(contents: Mapping[str, str | bytes], name: str) -> tuple[bytes, str]:
    """Shared library for Linux, or why there is none."""
    compiler = shlex.split(os.environ.get("CC", "")) or [shutil.which("cc") or ""]
    if (platform.system(), platform.machine()) != ("Linux", "x86_64") or not shutil.which(compiler[0]):
        return b"", "binary: there is no C compiler for linux64 here; most programs compile the sources themselves"
    with tempfile.TemporaryDirectory() as folder:
        for path, content in contents.items():
            if path.startswith("sources/") and isinstance(content, str):
                (Path(folder) / Path(path).name).write_text(content, encoding="utf-8")
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-I."]
        command = [*compiler, *flags, f"{name}.c", "fmu.c", "-o", "binary.so", "-lm"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_LONGEST, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return b"", f"binary: {error}"
        if done.returncode:
            return b"", f"binary: {' '.join(compiler)} failed: {done.stderr.strip()[:200]}"
        return (Path(folder) / "binary.so").read_bytes(), ""
