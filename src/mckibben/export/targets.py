"""Formats of `mckibben export`, each a function from a scenario to files."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.codegen import templates
from mckibben.codegen.source_module import identifier
from mckibben.component.calls import checked_call
from mckibben.errors import ExportError, ParameterError, closest, quoted
from mckibben.export.hardware import Hardware
from mckibben.result import Column, Remark, Result
from mckibben.scenario import Scenario
from mckibben.simulation import Margins, margin_remarks
from mckibben.storage.files import atomic_write, check_free, make_folder, remove_files, write_json
from mckibben.units import ms
from mckibben.version import __version__

if TYPE_CHECKING:
    from mckibben.scenario.robot import RobotScenario


class Exported(Result):
    """Files of an export.

    Attributes
    ----------
    contents
        Text or bytes of each file by its path.
    left_out
        The parts of the scenario that the format cannot express.
    worst_case
        Operations of a step of a controller by kind, at most.
    margins
        Stability margins of the loop of a controller, if they were computed.
    format
        One of `TARGETS`.
    period
        Control period [s] of a program for a board; 0 for others.
    """

    contents: Mapping[str, str | bytes]
    left_out: tuple[str, ...] = ()
    worst_case: Mapping[str, int] | None = None
    margins: Margins | None = None
    period: float = 0.0
    format: str = ""

    @property
    def step_time(self) -> float:
        """Time [s] of the worst step of a controller on the processor of `PROCESSOR`, estimated."""
        return sum((self.worst_case or {}).values()) * _INSTRUCTIONS / _CLOCK

    def verdict(self) -> str:
        """Number of files."""
        return f"{len(self.contents)} file{'s' * (len(self.contents) > 1)}"

    def remarks(self) -> Iterator[Remark]:
        """Severe ones for low margins and steps longer than the period; a warning for each part that is left out."""
        if self.margins is not None:
            yield from margin_remarks(float(self.margins.disk.min()), f", {self.margins.limit()}")
        if self.period and self.step_time > self.period / 2:
            remark = Remark.severe if self.step_time > self.period else Remark.warning
            text = f"the worst step takes about {self.step_time / ms:.2g} ms on {PROCESSOR}; the control period is "
            remedy = "take a longer control_period or a faster processor, and measure the step there"
            yield remark("control_period", f"{text}{self.period / ms:.4g} ms", remedy)
        for part in self.left_out:
            yield Remark.warning("left_out", f"left out: {part}")

    def declared(self) -> dict[str, tuple[Column, object]]:
        """Files and their sizes, the worst case of a step, and the least margin."""
        sizes = [len(content.encode() if isinstance(content, str) else content) for content in self.contents.values()]
        numbers: dict[str, tuple[Column, object]] = {
            kind: (Column(title=f"{kind} of a step, at most"), count) for kind, count in (self.worst_case or {}).items()
        }
        if self.worst_case and self.period:
            numbers["step_time"] = Column("s", f"longest step on {PROCESSOR}", "ms"), self.step_time
        if self.margins is not None:
            numbers["disk_margin"] = Column("1", "least disk margin"), float(self.margins.disk.min())
        return numbers | {"file": (Column(), [*self.contents]), "bytes": (Column(), sizes)}

    def save(self, folder: str | os.PathLike[str], *, force: bool = False) -> list[str]:
        """Write the files to a folder; return their names; `FileError` if one exists and `force` is not set.

        With it, files that an earlier export in this format has written are removed. exports.json lists them by format.
        """
        folder, listed = make_folder(folder), dict[str, list[str]]()
        with contextlib.suppress(OSError, ValueError, TypeError):  # there is none, or it is another program's
            listed = {name: [*map(str, paths)] for name, paths in json.loads((folder / _LISTED).read_bytes()).items()}
        if not force:
            check_free(folder, self.contents, "choose another folder, or give overwrite=True (command line: --force)")
        before = {*listed.pop(self.format, ())} - {*self.contents}
        if force:
            remove_files(folder, before - {path for paths in listed.values() for path in paths})
            before = set()
        for path, content in self.contents.items():
            make_folder((folder / path).parent)
            with atomic_write(folder / path, overwrite=force) as temporary:
                temporary.write_bytes(content if isinstance(content, bytes) else content.encode())
        write_json(folder / _LISTED, listed | {self.format: [*self.contents, *sorted(before)]})
        return [*self.contents]


_LISTED = "exports.json"
PROCESSOR = "a Cortex-M7 at 600 MHz"
"""Processor of the estimated time of a step; see docs/deploy.md."""
_CLOCK, _INSTRUCTIONS = 600e6, 10  # of that processor [1/s], and of it for an operation

TARGETS = {
    "c": ("mckibben.export.controller_files:c_files", "controller"),
    "firmware": ("mckibben.export.firmware:firmware_files", "controller"),
    "js": ("mckibben.export.controller_files:js_files", "controller"),
    "page": ("mckibben.export.page:page_files", "page"),
    "fmu": ("mckibben.export.fmu:plant_fmu", "plant"),
    "fmu-controller": ("mckibben.export.fmu:controller_fmu", "controller"),
    "mjcf": ("mckibben.export.mjcf:mjcf_files", "joint"),
}
"""Function of each format, ``(scenario, name, folder) -> Exported``, and the default name."""
CONTROLLERS = "c", "firmware", "js", "fmu-controller"
"""Formats of a controller."""

_MEANT = {
    **dict.fromkeys(("arduino", "teensy", "esp32", "stm32", "board", "sketch"), "firmware"),
    **{"c99": "c", "javascript": "js", "simulink": "fmu", "fmi": "fmu", "mujoco": "mjcf"},
}


def check_target(target: str) -> None:
    """Raise `ParameterError` unless it is a format; the remedy names the one that is meant."""
    if target not in TARGETS:
        names = {**_MEANT, **{name: name for name in TARGETS}}
        meant = names.get(closest(target, [*names]))
        remedy = f"did you mean {meant}?" if meant else f"give {' or '.join(TARGETS)}"
        raise ParameterError(f"{quoted(target)} is not a format", field="to", value=target, remedy=remedy)


@checked_call
def export(
    scenario: Scenario | RobotScenario,
    target: str,
    out: str | os.PathLike[str],
    *,
    name: str = "",
    hardware: Hardware | None = None,
    over: Sequence[str] = (),
    margins: bool = False,
    overwrite: bool = False,
) -> Exported:
    """Write a scenario of a joint or a robot, or its controller, in another format into a folder.

    Raises `ExportError` for parts that cannot be exported, before any file is written; `FileError` if the files exist,
    unless they may be overwritten: other files of an earlier export in this format are then removed.

    Parameters
    ----------
    target
        One of `TARGETS`.
    name
        Name of the program or model, an identifier. Default: ``controller``, ``plant``, ``joint`` or ``robot``,
        according to the format.
    hardware
        Limits of the samples and, for the format ``c``, the size of numbers, for the format of a controller.
    over
        Sliders of a page, such as ``load.mass2=0.2..2 kg``; by default its reference and what is uncertain.
    margins
        Whether to compute the stability margins of the loop of a controller.
    """
    check_target(target)
    place, default = TARGETS[target]
    name = check_name(name or ("robot" if default == "joint" and scenario.joint_names else default))
    module, function = place.split(":")
    options = _options(hardware, target) | ({"over": over} if over else {})
    if over and target != "page":
        raise ExportError("only a page has sliders", field="over", value=target, remedy="leave it out, or write page")
    exported: Exported = getattr(import_module(module), function)(scenario, name, Path(out), **options)
    computed = scenario.margins() if margins and target in CONTROLLERS else None
    exported = replace(exported, margins=computed, format=target)
    exported.save(out, force=overwrite)
    return exported


def _options(hardware: Hardware | None, target: str) -> dict[str, object]:
    """Options of a format by a file of hardware; `ExportError` if they do not apply, or firmware has none."""
    if hardware is None:
        if target == "firmware":
            remedy = "name a file with the board and its parts (command line: --hardware FILE)"
            raise ExportError("the firmware needs its hardware", field="hardware", remedy=remedy)
        return {}
    if target not in CONTROLLERS or (hardware.single and target not in ("c", "firmware")):
        field, formats = ("single", ("c", "firmware")) if target in CONTROLLERS else ("hardware", CONTROLLERS)
        remedy = f"leave it out, or write {' or '.join(formats)}"
        raise ExportError(f"{field} does not apply to {target}", field=field, value=target, remedy=remedy)
    if target == "firmware":
        return {"hardware": hardware}
    return {"limits": hardware.limits, **({"single": True} if hardware.single else {})}


_RESERVED = frozenset(  # by the standard headers and by the replay program
    "main replay NAN INFINITY NULL acos asin atan atan2 ceil copysign cos cosh exp expm1 fabs floor fmax fmin fmod "
    "isfinite isinf isnan log log1p pow rint round signbit sin sinh sqrt tan tanh trunc".split()
)


def check_name(name: str) -> str:
    """Check the name of a program or model; `ParameterError` unless it is an unreserved C identifier."""
    if identifier(name) != name or name in _RESERVED:
        remedy = "give an identifier of C, such as knee"
        raise ParameterError(f"{quoted(name)} is not a valid program name", field="name", value=name, remedy=remedy)
    return name


def filled(template: str, values: Mapping[str, object]) -> str:
    """Text of a template of this package with these values, and the `version` of mckibben.

    Raises `jinja2.UndefinedError` for a value that is missing.
    """
    return templates.filled(template, {**values, "version": __version__}, "mckibben.export")
