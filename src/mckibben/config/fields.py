"""Field types of configuration files: quantities with unit and range, integers, choices, text and paths."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, GetCoreSchemaHandler, PlainSerializer, SerializationInfo, ValidationInfo
from pydantic_core import core_schema

from mckibben.config.model import fail_validation
from mckibben.errors import quoted, suggest
from mckibben.units import NUMBER


def read_number(value: object) -> float:
    """Read a finite number, whose unit is given elsewhere.

    >>> read_number("12.5")
    12.5
    """
    number = float(value) if isinstance(value, str) and NUMBER.fullmatch(value.strip()) else value
    if not isinstance(number, int | float) or isinstance(number, bool):
        fail_validation(f"{quoted(value)} is not a number", "write it like 12.5", value=value)
    if not math.isfinite(number):
        fail_validation(f"{quoted(value)} is not finite", "give a finite number", value=number)
    return float(number)


def read_flag(value: object) -> bool:
    """Read ``true`` or ``false``; other words, such as ``yes``, are a mistake."""
    if not isinstance(value, bool) and value not in ("true", "false"):
        fail_validation(f"{quoted(value)} is neither true nor false", "write true or false")
    return value is True or value == "true"


@dataclass(frozen=True)
class OneOf:
    """Marks one of a few words."""

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: object) -> str:
        """Return the word; a mistake with the closest one, or all, if it is another."""
        if value not in self.words:
            fail_validation(f"{quoted(value)} is none of {', '.join(self.words)}", suggest(str(value), self.words))
        return value


def read_path(value: object, info: ValidationInfo, ending: str) -> Path:
    """Return the absolute path of a file that exists; text is relative to the folder of the configuration file.

    Parameters
    ----------
    info
        Its context has the `folder`, and may be `confined` to it, as for texts of the page.
    ending
        Ending of the example in the remedy.
    """
    folder = (info.context or {}).get("folder") or Path()
    if not isinstance(value, str | Path) or not str(value):
        fail_validation(f"{quoted(value)} is not a path", f"name a file, such as 'some{ending}'")
    path = Path(os.path.abspath(folder / value))  # noqa: PTH100 (resolve() would follow links)
    if (info.context or {}).get("confined") and path.parent != folder.absolute():
        fail_validation(f"{quoted(str(value))} is in another folder", "leave it out, or run it on the command line")
    try:
        exists = path.is_file()
    except (OSError, ValueError):
        exists = False
    if not exists:
        where = folder.absolute()
        fail_validation(
            f"there is no file {quoted(str(value))}", f"paths are relative to the file that names them, here {where}"
        )
    return path


def write_path(path: Path, info: SerializationInfo) -> str:
    """Write a path relative to the folder of the configuration file."""
    return relative_path(path, (info.context or {}).get("folder") or Path())


def relative_path(path: Path, folder: Path) -> str:
    """Return a path relative to a folder; absolute only on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.as_posix()


def read_title(value: object) -> str:
    """Read one line of 1 to 200 printable characters, without spaces around it."""
    if not isinstance(value, str) or not value.strip():
        fail_validation(f"{quoted(value)} is not a name", "name it in a few words")
    if len(value.strip()) > 200 or not value.strip().isprintable():
        fail_validation(f"{quoted(value)} is not one line of at most 200 characters", "shorten it")
    return value.strip()


Title = Annotated[str, BeforeValidator(read_title)]
Flag = Annotated[bool, BeforeValidator(read_flag)]
FilePath = Annotated[
    Path, BeforeValidator(lambda value, info: read_path(value, info, "")), PlainSerializer(write_path, when_used="json")
]
