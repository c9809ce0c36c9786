"""Formats of `mckibben export`, each a function from a scenario to files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from mckibben.codegen.source_module import identifier
from mckibben.component.calls import checked_call
from mckibben.errors import ExportError, ParameterError, quoted
from mckibben.notebook import html_table
from mckibben.scenario import Scenario
from mckibben.storage.files import atomic_write, check_free, make_folder


class Exported(NamedTuple):
    """Contents of files by path, and the parts that the format cannot express."""

    files: Mapping[str, str | bytes]
    left_out: tuple[str, ...] = ()

    def __repr__(self) -> str:
        left_out = f"; left out: {', '.join(self.left_out)}" if self.left_out else ""
        return f"<Exported: {', '.join(self.files)}{left_out}>"

    def _repr_html_(self) -> str:
        texts = {name: one.encode() if isinstance(one, str) else one for name, one in self.files.items()}
        rows = [(name, f"{len(content):,}") for name, content in texts.items()]
        notes = [f"left out: {one}" for one in self.left_out]
        return html_table(f"{len(rows)} files", ("file", "bytes"), rows, notes)


_FMI = ("fmi",)
TARGETS = {
    "c": ("mckibben.export.controller_files:c_files", "controller as C99, for microcontrollers", ("single",)),
    "js": ("mckibben.export.controller_files:js_files", "controller as JavaScript, for pages", ()),
    "fmu": ("mckibben.export.fmu:plant_fmu", "joint with load and valves as an FMU (FMI 2.0 or 3.0)", _FMI),
    "fmu-controller": ("mckibben.export.fmu:controller_fmu", "controller as an FMU, for co-simulation", _FMI),
    "fmu-muscle": ("mckibben.export.fmu:muscle_fmu", "force of a muscle as an FMU", _FMI),
    "mjcf": ("mckibben.export.mjcf:mjcf_files", "joint and muscles for MuJoCo, with the C of a plugin", ()),
    "warp": ("mckibben.export.warp:warp_files", "joint and muscles for MuJoCo Warp, in Python", ()),
    "osim": ("mckibben.export.osim:osim_files", "joint and muscles for OpenSim, at constant pressures", ()),
}
"""Function of each format, ``(scenario, name, folder, **options) -> Exported``, its description and options."""
_NAMES = {"fmu": "plant", "fmu-muscle": "muscle"} | dict.fromkeys(("mjcf", "warp", "osim"), "joint")


@checked_call
def export(
    scenario: Scenario,
    target: str,
    out: str | os.PathLike[str],
    *,
    name: str = "",
    single: bool = False,
    fmi: float | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write a scenario, or its controller, in another format into a folder.

    Raises `ExportError` for parts that cannot be exported, before any file is written; `FileError` if the files exist,
    unless they may be overwritten.

    Parameters
    ----------
    target
        One of `TARGETS`.
    name
        Name of the program or model, an identifier. Default: ``controller``, ``plant``, ``joint`` or ``muscle``.
    single
        32-bit instead of 64-bit numbers, for the format ``c``.
    fmi
        FMI version of an FMU, 2 (default) or 3.
    """
    if target not in TARGETS:
        legs = ", or a leg" if target == "urdf" else ""
        message = f"{quoted(target)} is not a format{' of a joint' if legs else ''}"
        raise ParameterError(message, field="to", value=target, remedy=f"give {' or '.join(TARGETS)}{legs}")
    if fmi not in (None, 2, 3):
        raise ParameterError(f"FMI {fmi:g} cannot be written", field="fmi", value=fmi, remedy="give 2 or 3")
    options = {"single": single or None, "fmi": fmi and int(fmi)}
    options = {option: value for option, value in options.items() if value is not None}
    for option in options:
        if option not in TARGETS[target][2]:
            remedy = f"leave it out, or write {' or '.join(one for one in TARGETS if option in TARGETS[one][2])}"
            raise ExportError(
                f"{option} does not apply to {target}", field=option, value=options[option], remedy=remedy
            )
    name = check_name(name or _NAMES.get(target, "controller"))
    module, function = TARGETS[target][0].split(":")
    make: Callable[..., Exported] = getattr(import_module(module), function)
    made = make(scenario, name, Path(out), **options)
    write_exported(made, out, overwrite=overwrite)
    return made


_TAKEN = frozenset(  # names reserved by the standard headers and by the replay program
    "main replay NAN INFINITY NULL acos asin atan atan2 ceil copysign cos cosh exp expm1 fabs floor fmax fmin fmod "
    "isfinite isinf isnan log log1p pow rint round signbit sin sinh sqrt tan tanh trunc".split()
)


def check_name(name: str) -> str:
    """Check the name of a program or model; `ParameterError` unless it is an unreserved C identifier."""
    if identifier(name) != name or name in _TAKEN:
        remedy = "give an identifier of C, such as knee"
        raise ParameterError(f"{quoted(name)} is not a valid program name", field="name", value=name, remedy=remedy)
    return name


def write_exported(made: Exported, out: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the files of an export to a folder; `FileError` if they exist, unless they may be overwritten."""
    folder = Path(out)
    make_folder(folder)
    if not overwrite:
        check_free(folder, made.files, "choose another folder, or overwrite it (command line: --force)")
    for path, content in made.files.items():
        make_folder((folder / path).parent)
        with atomic_write(folder / path, overwrite=overwrite) as temporary:
            temporary.write_bytes(content if isinstance(content, bytes) else content.encode())
