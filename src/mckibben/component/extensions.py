"""Classes of one's own: from files and modules named on the command line, and from installed packages.

A package registers its components by an entry point of the group `mckibben.components`, whose value is a module. These
modules are imported when a name is not known otherwise. A configuration file never imports code.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, entry_points, packages_distributions, version
from pathlib import Path

from mckibben.errors import Problem, ScenarioError

GROUP = "mckibben.components"
_PREFIX = "mckibben_extension_"
_loaded: dict[str, None] = {}


def load_extension(name: str | os.PathLike[str]) -> None:
    """Run a Python file or import a module, so that configuration files can name the classes that it defines."""
    source = os.fspath(name)
    is_module = all(part.isidentifier() for part in source.split(".")) and not source.endswith(".py")
    load = importlib.import_module if is_module else _run_file
    try:
        load(source)
    except ScenarioError:
        raise
    except Exception as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name in (source, source.partition(".")[0])
        remedy = "install it, add its folder to PYTHONPATH, or name a file that ends in .py" if missing else ""
        message = f"cannot be {'imported' if is_module else 'run'}: {type(error).__name__}: {error}"
        raise ScenarioError(source, [Problem(message, remedy=remedy)]) from error
    _loaded[source if is_module else str(Path(source).absolute())] = None


def _run_file(source: str) -> None:
    name = f"{_PREFIX}{Path(source).stem}"
    spec = importlib.util.spec_from_file_location(name, source)
    if spec is None or spec.loader is None:
        raise ScenarioError(source, [Problem("is no Python file", remedy="name a file that ends in .py, or a module")])
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise


def loader_for_workers() -> Callable[[], None] | None:
    """A function that loads the extensions of this process in another one; None if there are none."""
    return functools.partial(_load_missing, tuple(_loaded)) if _loaded else None


def _load_missing(names: tuple[str, ...]) -> None:
    for name in names:
        if name not in _loaded:
            load_extension(name)


@functools.cache
def load_installed() -> tuple[Problem, ...]:
    """Import the modules that installed packages register; a problem for each that fails."""
    problems = []
    for point in entry_points(group=GROUP):
        try:
            point.load()
        except Exception as error:
            package = point.dist.name if point.dist else point.value
            message = f"the package {package} cannot be imported: {type(error).__name__}: {error}"
            problems.append(Problem(message, remedy=f"repair or uninstall {package}"))
    return tuple(problems)


def module_of(kind: type) -> str:
    """The module of a class; that of a file named on the command line is the file's name without ``.py``."""
    return kind.__module__.removeprefix(_PREFIX)


def origin_of(kind: type) -> str:
    """Name of a class in files: plain for one of mckibben, ``package:Class`` or ``module:Class`` for another."""
    module, name = module_of(kind), kind.__name__
    package = module.partition(".")[0]
    if package == "mckibben":
        return name
    return f"{package if getattr(sys.modules.get(package), name, None) is kind else module}:{name}"


def version_of(kind: type) -> str | None:
    """Name and version of the installed package that defines a class; None if there is none."""
    package = kind.__module__.partition(".")[0]
    for distribution in packages_distributions().get(package, ()):
        try:
            return f"{distribution} {version(distribution)}"
        except PackageNotFoundError:
            continue
    return None
