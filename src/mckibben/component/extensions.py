"""Classes of others: Python files, modules, and installed packages with an entry point in `mckibben.components`."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType

from mckibben.errors import McKibbenError, Problem, ScenarioError

GROUP = "mckibben.components"
"""Group of the entry points whose modules define components."""


def load_extension(named: str | os.PathLike[str]) -> ModuleType:
    """Run a Python file, or import a module by its name, so that files can name its classes; return the module.

    Raises
    ------
    ScenarioError
        If there is none, or it cannot be run.
    """
    source = os.fspath(named)
    try:
        if all(part.isidentifier() for part in source.split(".")) and not Path(source).exists():
            return importlib.import_module(source)
        name = f"mckibben_extension_{Path(source).stem}"
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
    except McKibbenError:
        raise
    except Exception as error:
        raise ScenarioError(source, [Problem(f"cannot be run: {type(error).__name__}: {error}")]) from error


@functools.cache
def load_installed() -> bool:
    """Import the modules that installed packages register; return whether there are any."""
    found = metadata.entry_points(group=GROUP)
    for one in found:
        try:
            importlib.import_module(one.value)
        except Exception as error:
            package = one.dist.name if one.dist else one.name
            text = f"the package {package} cannot be imported: {type(error).__name__}: {error}"
            raise McKibbenError(text, value=one.value, remedy="repair or uninstall it") from error
    return bool(found)


@functools.cache
def installed_package(module: str) -> str:
    """Return the installed package of a module; empty for a file, and for this package itself."""
    package = module.partition(".")[0]
    return package if package != "mckibben" and package in metadata.packages_distributions() else ""
