"""FMUs of FMI 2.0 and 3.0: description, sources, binary and archive of a program."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import platform
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

import mckibben
from mckibben.codegen.c import comment_text, write_c
from mckibben.codegen.graph import Kind
from mckibben.codegen.languages import c_language
from mckibben.codegen.native import compiler_words
from mckibben.codegen.source_module import Function, SourceModule, is_scalar
from mckibben.errors import ExportError
from mckibben.export.functional_unit import FunctionalUnit, ScalarVariable, variables_of
from mckibben.export.model_description import NOMINAL, build_description, model_description

_PLATFORM = {2: "linux64", 3: "x86_64-linux"}  # folder of the binary
_DATE = (1980, 1, 1, 0, 0, 0)  # date of the files in the archive, so that equal FMUs are identical files
_LONGEST = 300.0  # s, of a compilation


def fmu(unit: FunctionalUnit, scenario: str, version: int = 2) -> tuple[bytes, list[str]]:
    """Content of an FMU for a version of FMI, and the omitted parts."""
    name = unit.module.name
    variables, fixed = variables_of(unit)
    comment = f"{unit.title}\nWritten by mckibben {mckibben.__version__}; the scenario is in resources/scenario.yaml."
    program = write_c(unit.module, comment, units=dict(unit.units))
    values = _values(unit, variables)
    templates = files("mckibben.export") / "templates"
    given = _headers(version)
    for one in (f"fmu-fmi{version}.c", "fmu-instance.h"):
        given[one] = Template((templates / one).read_text(encoding="utf-8")).safe_substitute(values)
    given |= {f"{name}.h": program.header, f"{name}.c": program.source}
    digest = hashlib.sha256("".join([scenario, *given.values()]).encode()).hexdigest()
    token = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    given["fmu-instance.h"] = given["fmu-instance.h"].replace("$guid", token)
    sources = [f"{name}.c", f"fmu-fmi{version}.c"]
    binary, missing = _binary(given, sources, version)
    if version == 3:
        given["buildDescription.xml"] = build_description(name, sources)
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": model_description(unit, variables, token, sources, version),
        **{f"sources/{one}": text for one, text in given.items()},
        "resources/scenario.yaml": scenario,
    }
    if binary:
        contents[f"binaries/{_PLATFORM[version]}/{name}.so"] = binary
    left_out = [missing] if missing else []
    if fixed:
        left_out.append(f"{name}: parameters that are not finite and cannot be changed: {', '.join(fixed)}")
    return _archive(contents), left_out


def _headers(version: int) -> dict[str, str]:
    """Headers of the standard, with their licence, from FMPy; raises `ExportError` without it."""
    found = importlib.util.find_spec("fmpy")  # not imported: only its files are needed
    if found is None or not found.origin:
        remedy = "install it: pip install 'mckibben[fmu]'"
        raise ExportError("FMPy, which has the headers of FMI, is not installed", field="fmpy", remedy=remedy)
    headers = sorted((Path(found.origin).parent / "c-code").glob(f"fmi{version}*.h"))
    return {one.name: one.read_text(encoding="utf-8") for one in headers}


def _archive(contents: Mapping[str, str | bytes]) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path, content in contents.items():
            entry = zipfile.ZipInfo(path, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            file.writestr(entry, content)
    return archive.getvalue()


def _values(unit: FunctionalUnit, variables: Sequence[ScalarVariable]) -> dict[str, object]:
    """Values of the placeholders in the templates of the sources, except the token."""
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
        "fmu_initialize(fmu_content *self)": ("init",),
        "fmu_results(fmu_content *self)": ("evaluate", "differentiate"),
        "fmu_advance(fmu_content *self, double duration)": ("advance",),
        "fmu_project(fmu_content *self)": ("project",),
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
        f"    {{offsetof(fmu_content, {one.place}), '{one.kind}', {start}, {NOMINAL.get(one.unit, 1.0)!r}}},"
        for one, start in zip(variables, starts, strict=True)
    ]
    return {
        "state_references": ", ".join(map(str, states)) or "0",
        "rate_references": ", ".join(map(str, rates)) or "0",
        "name": module.name,
        "title": comment_text(" ".join(unit.title.split())),
        "variables": len(variables),
        "states": len(states),
        "model_exchange": int(unit.model_exchange),
        "sampled": int(unit.sampled),
        "longest": repr(float(unit.longest)),
        "structures": "\n".join(structures),
        "table": "\n".join(table),
        "calls": "\n".join(text),
    }


def _call(module: SourceModule, function: Function) -> str:
    """Call of a function with the structures of an instance."""
    given = [(name, one) for name, one in function.arguments.items() if name != "state"]
    given += [(name, one) for name, one in function.results.items() if name != "state"]
    arguments = ["&self->model", *(name if is_scalar(one) else f"&self->{name}" for name, one in given)]
    return f"{module.name}_{function.name}({', '.join(arguments)});"


def _binary(given: Mapping[str, str], sources: Sequence[str], version: int) -> tuple[bytes, str]:
    """Shared library for Linux, or the reason why there is none."""
    compiler = compiler_words()
    if (platform.system(), platform.machine()) != ("Linux", "x86_64") or not shutil.which(compiler[0]):
        where = _PLATFORM[version]
        return b"", f"binary: no C compiler for {where} found; most programs compile the sources themselves"
    with tempfile.TemporaryDirectory() as folder:
        for path, text in given.items():
            (Path(folder) / path).write_text(text, encoding="utf-8")
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-I."]
        command = [*compiler, *flags, *sources, "-o", "binary.so", "-lm"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_LONGEST, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return b"", f"binary: {error}"
        if done.returncode:
            return b"", f"binary: {' '.join(compiler)} failed: {done.stderr.strip()[:200]}"
        return (Path(folder) / "binary.so").read_bytes(), ""
