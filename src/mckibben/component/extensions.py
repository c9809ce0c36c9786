"""User-defined classes: Python files, modules, and installed packages with an entry point in `mckibben.components`."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from types import ModuleType

from mckibben.errors import Problem, ScenarioError

GROUP = "mckibben.components"
"""Group of the entry points whose modules define components."""

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
    is_module = all(part.isidentifier() for part in source.split(".")) and not Path(source).is_file()
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


@functools.cache
def load_installed() -> tuple[Problem, ...]:
    """Import the modules that installed packages register; return a problem for each that cannot be imported.

    A package names its module in its own configuration: ``[project.entry-points."mckibben.components"]``. The import
    takes place once, when a file names a class that is not known yet.
    """
    problems = []
    for entry in metadata.entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist else entry.name
            text = f"the package {package} cannot be imported: {type(error).__name__}: {error}"
            problems.append(Problem(text, remedy=f"repair or uninstall {package}"))
    return tuple(problems)


@functools.cache
def installed_package(module: str) -> str:
    """Return the installed package of a module; empty for a file, and for this package itself."""
    package = module.partition(".")[0]
    return package if package != "mckibben" and package in _distributions() else ""


def is_foreign(module: str) -> bool:
    """Whether a module is of a package or file that a reader may lack; a script or notebook has no name."""
    return module.partition(".")[0] not in ("mckibben", "__main__")


def package_version(module: str) -> str | None:
    """Return name and version of the distribution that a foreign module was installed by; None for a file."""
    package = installed_package(module)
    return " ".join((name := _distributions()[package][0], metadata.version(name))) if package else None


@functools.cache
def _distributions() -> dict[str, list[str]]:
    """Distributions by package; the search takes a while."""
    return dict(metadata.packages_distributions())


def module_origin(module: str) -> str:
    """Return the installed package of a foreign module, or its name; that of a file named as extension is its stem.

    >>> module_origin("mckibben_extension_valves"), module_origin("mckibben.actuator")
    ('valves', 'mckibben.actuator')
    """
    return installed_package(module) or module.removeprefix(_FILE)
