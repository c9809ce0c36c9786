"""mckibben: pneumatic artificial muscles, from the test rig to a controlled joint.

Importing has two documented effects, see `mckibben.numerics.runtime`: JAX computes with 64-bit numbers (and its loops
run fast on the CPU), and compiled programs are kept in the user's cache folder. The public names are in `__init__.pyi`;
each is loaded when it is first used, so that the import itself is quick.
"""

from importlib import import_module

import lazy_loader

import mckibben.methods  # noqa: F401, binds methods that need higher packages
from mckibben.numerics import runtime as _runtime
from mckibben.version import __version__ as __version__

_PACKAGES = "muscle", "control", "joint", "actuator", "plant", "dataset", "identification", "simulation", "reachability"

_runtime.configure()

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    try:
        return _load(name)
    except AttributeError:
        from mckibben.errors import closest

        methods = ("simulate", "envelope", "tune", "compare", "export")
        packages = (f"{__name__}.{package}" for package in _PACKAGES if name[:1].isupper())
        if home := next((package for package in packages if hasattr(import_module(package), name)), ""):
            text = f"mckibben has no {name!r}; write: from {home} import {name}"
            raise AttributeError(text, name=name) from None
        meant = f"scenario.{name}()" if name in methods else closest(name, __all__)
        remedy = f"did you mean {meant}?" if meant else "dir(mckibben) lists the names"
        raise AttributeError(f"mckibben has no {name!r}; {remedy}", name=name) from None
