"""Functions of higher packages that methods of lower classes call, such as the figure of a result.

A lower class names the function; `mckibben.methods`, at the top, binds it and imports what it needs when it is called.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_BOUND: dict[str, Callable[..., Any]] = {}


def bind(function: Callable[..., Any]) -> Callable[..., Any]:
    """Bind a function of a higher package to its name."""
    _BOUND[function.__name__] = function
    return function


def call(name: str, *args: object, **options: object) -> Any:  # the type is that of a class above the caller
    """Call the function that is bound to a name."""
    return _BOUND[name](*args, **options)
