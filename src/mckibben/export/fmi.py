"""FMUs of FMI 2.0: description, sources, binary and archive of a program.

An FMU of equal content is an equal file. Its binary is for 64-bit Linux; other platforms compile the sources, which it
contains.
"""

from __future__ import annotations

import hashlib
import importlib.util
import io
import platform
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from mckibben.codegen.c import comment_text, write_c
from mckibben.codegen.graph import Kind
from mckibben.codegen.languages import c_language
from mckibben.codegen.native import build_library
from mckibben.codegen.source_module import Function, SourceModule, is_scalar
from mckibben.errors import CompilerError, ExportError
from mckibben.export.functional_unit import FunctionalUnit, ScalarVariable, variables_of
from mckibben.export.model_description import NOMINAL, model_description
from mckibben.export.targets import filled
from mckibben.version import __version__

_PLATFORM = "linux64"  # folder of the binary
_DATE = (1980, 1, 1, 0, 0, 0)  # of the files in the archive, so that equal FMUs are identical files


def fmu(unit: FunctionalUnit, scenario: str) -> tuple[bytes, list[str]]:
    """Content of an FMU with the text of its scenario, and the omitted parts.

    Raises `ExportError` without FMPy, which has the headers of the standard, and for a start value that is not finite.
    Without a C compiler the binary is omitted.
    """
    name = unit.module.name
    variables, fixed = variables_of(unit)
    comment = f"{unit.title}\nWritten by mckibben {__version__}; the scenario is in resources/scenario.yaml."
    program = write_c(unit.module, comment, units=dict(unit.units))
    sources = _headers() | {"fmu.c": _sources(unit, variables)}
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
    """Zip file of contents by path, with a fixed date."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path, content in contents.items():
            entry = zipfile.ZipInfo(path, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            file.writestr(entry, content)
    return archive.getvalue()


def _sources(unit: FunctionalUnit, variables: Sequence[ScalarVariable]) -> str:
    """Text of fmu.c, except the identifier."""
    module, literal = unit.module, c_language().literal
    states = [number for number, variable in enumerate(variables) if variable.kind in "sc"]
    rates = {number: states[v.rate_of] for number, v in enumerate(variables) if v.rate_of is not None}
    values = {
        "name": module.name,
        "title": comment_text(" ".join(unit.title.split())),
        "variables": variables,
        "literal": lambda number: literal(number, Kind.REAL),
        "nominal": NOMINAL,
        "rates": rates,
        "model_exchange": int(unit.model_exchange),
        "sampled": int(unit.sampled),
        "longest": float(unit.longest),
        "structures": list(module.structures()),
        "starts": [member.name for member in module.structures().get("start", [])],
        "calls": {function.name: _call(module, function) for function in module.functions},
    }
    return filled("fmu.c", values)


def _call(module: SourceModule, function: Function) -> str:
    """Call of a function with the structures of an instance."""
    structures = function.inputs | function.outputs
    texts = [name if is_scalar(members) else f"&self->{name}" for name, members in structures.items()]
    arguments = ["&self->model", *texts]
    return f"{module.name}_{function.name}({', '.join(arguments)})"


def _binary(texts: Mapping[str, str], sources: Sequence[str]) -> tuple[bytes, str]:
    """Shared library for Linux, or the reason why there is none.

    Products and sums are not fused, so that results are those of the simulation.
    """
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        return b"", f"binary: this is not {_PLATFORM}; most programs compile the sources themselves"
    try:
        return build_library(texts, ["-std=c99", "-O2", "-ffp-contract=off", "-I.", *sources, "-lm"]), ""
    except CompilerError as error:
        return b"", f"binary: {error.message}; most programs compile the sources themselves"
