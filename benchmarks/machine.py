"""What the benchmark ran on: times mean nothing without it, ratios little."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

PACKAGES = ("mckibben", "jax", "jaxlib", "equinox", "numpy", "scipy", "xarray", "h5netcdf")
COMPARED = ("casadi", "mujoco", "control", "lmfit")


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def describe() -> dict[str, object]:
    """The machine, and the versions of all that is compared; None for what is not installed."""
    model, flags = _processor()
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "processor": model,
        "avx512": "avx512f" in flags,
        "cores": cores(),
        "load_at_start": os.getloadavg()[0],
        "system": platform.platform(),
        "python": platform.python_version(),
        "compiler": _compiler(),
        "packages": {name: _version(name) for name in PACKAGES + COMPARED},
    }


def sentence(machine: dict) -> str:
    """The same in a line or two."""
    versions = ", ".join(f"{name} {version}" for name, version in machine["packages"].items() if version)
    vectors = "AVX-512" if machine["avx512"] else "no AVX-512"
    return (
        f"{machine['processor']} ({vectors}), {machine['cores']} cores; Python {machine['python']}, {versions}; "
        f"{machine['compiler']}; {machine['date']}, load {machine['load_at_start']:.1f} at the start"
    )


def _processor() -> tuple[str, set[str]]:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine(), set()
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    return fields.get("model name", platform.machine()), set(fields.get("flags", "").split())


def _compiler() -> str:
    try:
        return subprocess.run(["cc", "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    except (OSError, IndexError):
        return "no C compiler"


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
