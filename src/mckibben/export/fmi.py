"""FMUs of FMI 2.0: description, sources, binary and archive of a program."""

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
from mckibben.export.model_description import NOMINAL, model_description

_PLATFORM = "linux64"  # folder of the binary
_DATE = (1980, 1, 1, 0, 0, 0)  # of the files in the archive, so that equal FMUs are identical files
_LONGEST = 300.0  # s, of a compilation


def fmu(unit: FunctionalUnit, scenario: str) -> tuple[bytes, list[str]]:
    """Content of an FMU with the text of its scenario, and the omitted parts.

    Raises `ExportError` without FMPy, which has the headers of the standard, and for a start value that is not finite.
    """
    name = unit.module.name
    variables, fixed = variables_of(unit)
    comment = f"{unit.title}\nWritten by mckibben {mckibben.__version__}; the scenario is in resources/scenario.yaml."
    program = write_c(unit.module, comment, units=dict(unit.units))
    template = Template((files("mckibben.export") / "templates" / "fmu.c").read_text(encoding="utf-8"))
    sources = _headers() | {"fmu.c": template.safe_substitute(_values(unit, variables))}
    sources |= {f"{name}.h": program.header, f"{name}.c": program.source}
    digest = hashlib.sha256("".join([scenario, *sources.values()]).encode()).hexdigest()
    token = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    sources["fmu.c"] = sources["fmu.c"].replace("$guid", token)
    compiled = [f"{name}.c", "fmu.c"]
    binary, missing = _binary(sources, compiled)
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": model_description(unit, variables, token, compiled),
        **{f"sources/{path}": text for path, text in sources.items()},
        "resources/scenario.yaml": scenario,
    }
    if binary:
        contents[f"binaries/{_PLATFORM}/{name}.so"] = binary
    left_out = [missing] if missing else []
    if fixed:
        left_out.append(f"{name}: parameters that are not finite and cannot be changed: {', '.join(fixed)}")
    return _archive(contents), left_out


def _headers() -> dict[str, str]:
    """Headers of the standard, with their licence, from FMPy; raises `ExportError` without it."""
    package = importlib.util.find_spec("fmpy")  # not imported: only its files are needed
    if package is None or not package.origin:
        remedy = "install it: pip install 'mckibben[fmu]'"
        raise ExportError("FMPy, which has the headers of FMI, is not installed", field="fmpy", remedy=remedy)
    headers = sorted((Path(package.origin).parent / "c-code").glob("fmi2*.h"))
    return {header.name: header.read_text(encoding="utf-8") for header in headers}


def _archive(contents: Mapping[str, str | bytes]) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path, content in contents.items():
            entry = zipfile.ZipInfo(path, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            file.writestr(entry, content)
    return archive.getvalue()


def _values(unit: FunctionalUnit, variables: Sequence[ScalarVariable]) -> dict[str, str]:
    """Values of the placeholders in the template of the sources, except the identifier."""
    module, literal = unit.module, c_language().literal
    states = [number for number, variable in enumerate(variables) if variable.kind in "sc"]
    rates = {number: variable.rate_of for number, variable in enumerate(variables) if variable.rate_of is not None}
    table = [
        f"    {{offsetof(fmu_content, {variable.place}), '{variable.kind}', "
        f"{literal(variable.start or 0.0, Kind.REAL)}, {NOMINAL.get(variable.unit, 1.0)!r}}},"
        for variable in variables
    ]
    return {
        "state_references": ", ".join(str(states[place]) for place in rates.values()) or "0",
        "rate_references": ", ".join(map(str, rates)) or "0",
        "name": module.name,
        "title": comment_text(" ".join(unit.title.split())),
        "variables": str(len(variables)),
        "states": str(len(rates)),
        "model_exchange": str(int(unit.model_exchange)),
        "sampled": str(int(unit.sampled)),
        "longest": repr(float(unit.longest)),
        "structures": "\n".join(f"    {module.name}_{structure} {structure};" for structure in module.structures()),
        "table": "\n".join(table),
        "calls": "\n".join(_calls(module)),
    }


_CALLS = {
    "fmu_initialize(fmu_content *self)": ("init",),
    "fmu_results(fmu_content *self)": ("evaluate", "differentiate"),
    "fmu_advance(fmu_content *self, double duration)": ("advance",),
    "fmu_project(fmu_content *self)": ("project",),
}
"""Functions of the template, and the functions of the program that each calls."""


def _calls(module: SourceModule) -> list[str]:
    """Definitions of the functions of the template."""
    functions = {function.name: function for function in module.functions}
    start = [member.name for member in module.structures().get("start", [])]
    texts = []
    for signature, names in _CALLS.items():
        lines = [f"self->start.{name} = self->model.state.{name};" for name in start if "init" in names]
        lines += [_call(module, functions[name]) for name in names if name in functions]
        arguments = [name for name in ("self", "duration") if name in signature]
        unused = [f"(void){name};" for name in arguments if not any(name in line for line in lines)]
        texts.append("\n".join([f"static void {signature}", "{", *(f"    {x}" for x in unused + lines), "}\n"]))
    return texts


def _call(module: SourceModule, function: Function) -> str:
    """Call of a function with the structures of an instance."""
    structures = [(name, members) for name, members in function.arguments.items() if name != "state"]
    structures += [(name, members) for name, members in function.results.items() if name != "state"]
    arguments = ["&self->model", *(name if is_scalar(members) else f"&self->{name}" for name, members in structures)]
    return f"{module.name}_{function.name}({', '.join(arguments)});"


def _binary(texts: Mapping[str, str], sources: Sequence[str]) -> tuple[bytes, str]:
    """Shared library for Linux, or the reason why there is none."""
    compiler = compiler_words()
    if (platform.system(), platform.machine()) != ("Linux", "x86_64") or not shutil.which(compiler[0]):
        return b"", f"binary: no C compiler for {_PLATFORM} found; most programs compile the sources themselves"
    with tempfile.TemporaryDirectory() as folder:
        for path, text in texts.items():
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
