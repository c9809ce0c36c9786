"""Fields that are no quantity: whole numbers, words, names of the catalog, paths."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import GetCoreSchemaHandler, SerializationInfo, ValidationInfo
from pydantic_core import core_schema

from mckibben.study.scenario.part import quoted, refuse, suggest

_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")


@dataclass(frozen=True)
class Whole:
    """Marks an integer within a range."""

    lower: int
    upper: int

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> int:
        """The number, checked."""
        if isinstance(value, str):
            if not _WHOLE.fullmatch(value.strip()):
                refuse(f"{quoted(value)} is not a whole number", f"choose one from {self.lower} to {self.upper}")
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not self.lower <= value <= self.upper:
            refuse(f"{quoted(value)} is outside {self.lower} to {self.upper}", "choose a whole number inside")
        return value


def read_flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool) and value not in ("true", "false"):
        refuse(f"{quoted(value)} is neither true nor false", "write true or false")
    return value is True or value == "true"


@dataclass(frozen=True)
class Choice:
    """Marks one of a few words."""

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> str:
        """The word, checked."""
        if value not in self.words:
            refuse(f"{quoted(value)} is none of {', '.join(self.words)}", suggest(str(value), self.words))
        return value


@dataclass(frozen=True)
class Entry:
    """Marks the name of a catalog entry of a kind."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any, others: Sequence[str] = ()) -> str:
        """The name, if the catalog has it or it is one of the others."""
        from mckibben import catalog

        known = [*catalog.names(self.kind), *others]
        if value not in known:
            what = {"geometries": "geometry"}.get(self.kind, self.kind.removesuffix("s"))
            refuse(f"the catalog has no {what} {quoted(value)}", suggest(str(value), known))
        return value


def read_path(value: Any, info: ValidationInfo, ending: str) -> Path:
    """The absolute path of a file that exists; text is relative to the scenario's folder."""
    folder = (info.context or {}).get("folder") or Path()
    if not isinstance(value, str | Path) or not str(value):
        refuse(f"{quoted(value)} is not a path", f"name a file, such as 'some{ending}'")
    path = Path(os.path.abspath(folder / value))  # noqa: PTH100 (resolve() would follow links)
    try:
        found = path.is_file()
    except (OSError, ValueError):
        found = False
    if not found:
        where = folder.absolute()
        refuse(f"there is no file {quoted(str(value))}", f"paths are relative to the scenario, here {where}")
    return path


def write_path(path: Path, info: SerializationInfo) -> str:
    """A path relative to the scenario's folder where it lies below it, else absolute."""
    folder = (info.context or {}).get("folder") or Path()
    folder = Path(os.path.abspath(folder))  # noqa: PTH100
    return (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()


def read_table(value: Any, info: ValidationInfo) -> Path:
    """The path of a CSV file."""
    return read_path(value, info, ".csv")


def read_law(value: Any, info: ValidationInfo) -> str | Path:
    """A law of the catalog, ``chou``, or the path of a fit."""
    if str(value).endswith((".yaml", ".yml")):
        return read_path(value, info, ".yaml")
    return Entry("laws").read(value, others=("chou",))


def write_law(value: str | Path, info: SerializationInfo) -> str:
    """What `read_law` reads."""
    return write_path(value, info) if isinstance(value, Path) else value


def read_title(value: Any) -> str:
    """One line of text."""
    if not isinstance(value, str) or not value.strip():
        refuse(f"{quoted(value)} is not a name", "name the scenario in a few words")
    if len(value.strip()) > 200 or not value.strip().isprintable():
        refuse(f"{quoted(value)} is not one line of at most 200 characters", "shorten it")
    return value.strip()
