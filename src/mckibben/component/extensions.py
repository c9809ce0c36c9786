"""User-defined classes of Python files and modules."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from mckibben.errors import Problem, ScenarioError

_FILE = "mckibben_extension_"
_loaded: dict[str, None] = {}


def load_extension(named: str | os.PathLike[str]) -> ModuleType:
    """Run a Python file, or import a module by its name, so that files can name its classes; return the module.

    A file is run as a module of its own, also if another of that name is imported. It is run, never read from within a
    configuration file, so that reading a file does not execute code.

    Raises
    ------
    ScenarioError
        If there is none, or it cannot be run.
    """
    source = os.fspath(named)
    is_module = all(word.isidentifier() for word in source.split(".")) and not Path(source).is_file()
    try:
        module = importlib.import_module(source) if is_module else _run_file(source)
    except ScenarioError:
        raise
    except Exception as error:
        missing = isinstance(error, ModuleNotFoundError) and f"{source}.".startswith(f"{error.name}.")
        remedy = "install it, add its folder to PYTHONPATH, or name a file that ends in .py" if missing else ""
        text = f"cannot be {'imported' if is_module else 'run'}: {type(error).__name__}: {error}"
        raise ScenarioError(source, [Problem(text, remedy=remedy)]) from error
    _loaded[source if is_module else str(Path(source).absolute())] = None
    return module


def _run_file(source: str) -> ModuleType:
    name = f"{_FILE}{Path(source).stem}"
    spec = importlib.util.spec_from_file_location(name, source)
    if spec is None or spec.loader is None:
        raise ScenarioError(source, [Problem("is not a Python file", remedy="name a file that ends in .py")])
    sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(sys.modules[name])
    except BaseException:
        del sys.modules[name]
        raise
    return sys.modules[name]


def loaded_extensions() -> tuple[str, ...]:
    """Return the modules and absolute paths that were loaded, in order, for `load_missing` in another process."""
    return tuple(_loaded)


def load_missing(extensions: Sequence[str]) -> None:
    """Load the extensions of another process that this one lacks."""
    for extension in extensions:
        if extension not in _loaded:
            load_extension(extension)


def is_foreign(module: str) -> bool:
    """Whether a module is of a package or file that a reader may lack; a script or notebook has no name."""
    return module.partition(".")[0] not in ("mckibben", "__main__")


def module_origin(module: str) -> str:
    """Return the name of a module; that of a file named as extension is its stem.

    >>> module_origin("mckibben_extension_valves"), module_origin("mckibben.actuator")
    ('valves', 'mckibben.actuator')
    """
    return module.removeprefix(_FILE)
