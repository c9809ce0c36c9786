"""Compiled programs kept whole between processes.

JAX's own compile cache spares a new process the compiler, but not the tracing and lowering before it: a third of a
second of a command that takes one. Here a finished program is written to a file and taken up again, under a key of all
that made it: function, structure, shapes and types of the arguments, our source files, the versions, and XLA's flags.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.core
import numpy as np

from mckibben.files import whole
from mckibben.numerics.many import traced_for
from mckibben.numerics.runtime import programs_folder

_MOST = 200
"""Files in the folder; the oldest go."""


_ARRAYS = (jax.Array, np.ndarray, np.generic)


class _Array:
    """Stands for an array among arguments that are not."""

    def __repr__(self) -> str:
        return "array"


_ARRAY = _Array()


class KeptProgram:
    """A function of arrays as programs, one for each structure of its arguments.

    Arrays are traced, everything else is static (and hashable), as with `equinox.filter_jit`; the answers are arrays.

    Parameters
    ----------
    function
        Pure.
    options
        Of the compiler.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any] | None = None) -> None:
        self._function, self._options = function, options
        self._traced: dict[Any, Callable[..., Any]] = {}
        self._programs: dict[Any, Callable[..., Any]] = {}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        leaves, structure = jax.tree.flatten((args, kwargs))
        arrays = [leaf for leaf in leaves if isinstance(leaf, _ARRAYS)]
        fixed = tuple(_ARRAY if isinstance(leaf, _ARRAYS) else leaf for leaf in leaves)
        # What is traced for many runs is another program, even of the same arguments.
        key = (structure, fixed, tuple(map(type, fixed)), traced_for())
        traced = self._traced.get(key)
        if traced is None:
            function = functools.partial(self._called, structure, fixed)
            traced = self._traced[key] = jax.jit(function, compiler_options=self._options)
        folder = programs_folder()
        inside = any(isinstance(leaf, jax.core.Tracer) for leaf in arrays) if folder else True
        if folder is None or inside or jax.default_backend() != "cpu":
            return traced(*arrays)
        kinds = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in arrays)
        program = self._programs.get((key, kinds))
        if program is None:
            program = self._programs[key, kinds] = self._taken_up(folder, (key, kinds), traced, arrays)
        return program(*arrays)

    def _called(self, structure: Any, fixed: tuple[Any, ...], *arrays: Any) -> Any:
        """The function, on arguments put together again."""
        rest = iter(arrays)
        leaves = [next(rest) if leaf is _ARRAY else leaf for leaf in fixed]
        args, kwargs = jax.tree.unflatten(structure, leaves)
        return self._function(*args, **kwargs)

    def _taken_up(self, folder: Path, key: Any, traced: Any, leaves: list[Any]) -> Callable[..., Any]:
        """The program from its file, or made and written to it."""
        from jax.experimental.serialize_executable import deserialize_and_load, serialize

        named = f"{self._function.__module__}.{self._function.__qualname__}"
        text = repr((named, key, self._options))
        if " at 0x" in text:  # something without a lasting name
            return traced
        path = folder / f"{hashlib.sha256((text + _surroundings()).encode()).hexdigest()[:40]}.program"
        taken = jax.tree.structure((tuple(leaves), {}))
        try:
            payload, skeleton = pickle.loads(path.read_bytes())
            return deserialize_and_load(payload, taken, jax.tree.structure(skeleton))
        except Exception:  # missing, damaged, or of a JAX that cannot read it: then it is made
            program = traced.lower(*leaves).compile()
        try:
            payload, _, given = serialize(program)
            jax.block_until_ready(deserialize_and_load(payload, taken, given)(*leaves))  # does it run again?
            folder.mkdir(parents=True, exist_ok=True)
            with whole(path) as part:
                part.write_bytes(pickle.dumps((payload, jax.tree.unflatten(given, [0] * given.num_leaves))))
            _thin_out(folder)
        except Exception:  # a program that cannot be kept still runs; nor does a full disk matter to it
            pass
        return program


@functools.cache
def _surroundings() -> str:
    """All that a program depends on beside its function and arguments."""
    import mckibben

    root = Path(mckibben.__file__).parent
    files = sorted(
        (str(path.relative_to(root)), path.stat().st_size, path.stat().st_mtime_ns) for path in root.rglob("*.py")
    )
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "equinox", "numpy")]
    return repr((files, versions, sys.version, os.environ.get("XLA_FLAGS"), jax.config.jax_enable_x64))  # type: ignore


def _thin_out(folder: Path) -> None:
    files = sorted(folder.glob("*.program"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[_MOST:]:
        path.unlink(missing_ok=True)
