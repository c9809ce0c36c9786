"""MATLAB files of versions 5 to 7, read by SciPy in a process of its own, as some damaged files crash it."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from typing import Any

import numpy as np

Value = np.ndarray | str | dict[str, "Value"] | list["Value"] | None


def read_variables(data: bytes, *, seconds: int = 10, memory: int = 7 * 10**8) -> dict[str, Value]:
    """Variables of a file by name.

    Numbers are arrays of float64 of the shape in MATLAB, a struct is a mapping of its fields, or a list of several,
    cells are a list. Anything else, such as a table, is None.

    Raises
    ------
    ValueError
        If the file is damaged, or takes more than so many seconds of processor time or bytes of memory.
    """
    command = [sys.executable, "-I", __file__, str(seconds), str(memory)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    answer = subprocess.run(command, input=data, capture_output=True, env=environment, check=False)
    if answer.returncode:
        said = answer.stderr.decode("utf-8", "replace").strip().splitlines()
        raise ValueError(said[-1] if said else "it is damaged, or takes too much time")
    stream = io.BytesIO(answer.stdout)
    tree = json.loads(np.load(stream, allow_pickle=False).tobytes())
    arrays = [np.load(stream, allow_pickle=False) for _ in range(tree["arrays"])]
    return {name: _restored(value, arrays) for name, value in tree["variables"].items()}


def _restored(value: Any, arrays: list[np.ndarray]) -> Value:
    if isinstance(value, int):
        return arrays[value]
    if isinstance(value, dict):
        return {name: _restored(field, arrays) for name, field in value.items()}
    return [_restored(cell, arrays) for cell in value] if isinstance(value, list) else value


def _plain(value: Any, arrays: list[np.ndarray]) -> Any:
    """Value as JSON, in which a number stands for an array."""
    if type(value) is not np.ndarray or value.dtype.kind not in "VOUbiuf":
        return None
    if value.dtype.names:
        structs = [{name: _plain(item[name], arrays) for name in value.dtype.names} for item in value.ravel("F")]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype.kind == "O":
        return [_plain(cell, arrays) for cell in value.ravel("F")]
    if value.dtype.kind == "U":
        return "".join(value.ravel()[:1].tolist())
    arrays.append(value.astype(np.float64))
    return len(arrays) - 1


def _main(seconds: int, memory: int) -> None:
    """Write the variables of the file on standard input to standard output, within limits."""
    import resource

    from scipy.io import loadmat

    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    arrays: list[np.ndarray] = []
    variables = {
        value.item(0)[0].decode() if name == "None" else name: _plain(value, arrays)
        for name, value in loadmat(io.BytesIO(sys.stdin.buffer.read())).items()
        if not name.startswith("__")
    }
    tree = json.dumps({"variables": variables, "arrays": len(arrays)}).encode()
    stream = io.BytesIO()
    for array in (np.frombuffer(tree, np.uint8), *arrays):
        np.save(stream, array)
    sys.stdout.buffer.write(stream.getbuffer())


if __name__ == "__main__":
    try:
        _main(*map(int, sys.argv[1:]))
    except Exception as error:  # SciPy raises nearly every kind
        sys.exit(f"{error or type(error).__name__}")
