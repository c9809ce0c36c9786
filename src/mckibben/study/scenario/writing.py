"""Plain data as YAML that people like to read: short mappings on one line, long ones indented."""

from __future__ import annotations

import json
import re
from typing import Any

_WIDTH = 100
_PLAIN = re.compile(r"[A-Za-z0-9_./+-](?:[A-Za-z0-9_./*^()+ -]*[A-Za-z0-9_./*^()+-])?")
_PLAIN_IN_BLOCK = re.compile(rf"{_PLAIN.pattern}(?:,(?: ?{_PLAIN.pattern})?)*")
_MEANS_ANOTHER = re.compile(r"(?i)-|---|\.\.\.|true|false|yes|no|on|off|null")


def to_text(data: dict[str, Any]) -> str:
    """YAML text of mappings, lists and scalars; what is None is left out.

    >>> print(to_text({"duration": "10 s", "start": {"angle": "5 deg", "stiffness": None}}), end="")
    duration: 10 s
    start: {angle: 5 deg}
    """
    return "".join(f"{line}\n" for line in _block(data, 0))


def _block(data: dict[str, Any], indent: int) -> list[str]:
    lines = []
    pad = "  " * indent
    for key, value in data.items():
        if value is None:
            continue
        one_line = f"{pad}{key}: {_flow(value) if isinstance(value, dict | list) else _scalar(value)}"
        if not isinstance(value, dict) or (len(one_line) <= _WIDTH and (indent > 0 or not _is_nested(value))):
            lines.append(one_line)
        else:
            lines += [f"{pad}{key}:", *_block(value, indent + 1)]
    return lines


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items() if item is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    return _scalar(value, flow=True)


def _scalar(value: Any, *, flow: bool = False) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if not isinstance(value, str):
        return str(value)
    plain = (_PLAIN if flow else _PLAIN_IN_BLOCK).fullmatch(value)
    if plain and not _MEANS_ANOTHER.fullmatch(value) and not value.startswith("- "):
        return value
    return json.dumps(value, ensure_ascii=not value.isprintable())


def _is_nested(value: dict[str, Any]) -> bool:
    return any(isinstance(item, dict) for item in value.values())
