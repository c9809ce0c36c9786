"""Values of fields, in Python and in the model of a file."""

from __future__ import annotations

import enum
from typing import Any, get_args

import numpy as np

from mckibben.component.base import field_hints


def member_of(kind: type, name: str, value: Any) -> Any:
    """Value of a field; the member of an enumeration that a file names."""
    hint = field_hints(kind)[name]
    choices = [hint, *get_args(hint)]
    members = next((one for one in choices if isinstance(one, type) and issubclass(one, enum.Enum)), None)
    return members[value.upper()] if members and isinstance(value, str) else value


def plain(value: Any) -> Any:
    """Value of a field as the model of its class has it: a word, a number or a tuple of numbers."""
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if hasattr(value, "ndim"):
        return tuple(np.asarray(value, float).tolist()) if value.ndim else value.item()
    return value


def same(value: Any, default: Any) -> bool:
    """Return whether a value is that of the default; arrays never are."""
    if value is default:
        return True
    if type(value) is not type(default) and not (isinstance(value, int | float) and isinstance(default, int | float)):
        return False
    try:
        return bool(value == default)
    except (ValueError, TypeError):  # arrays
        return False
