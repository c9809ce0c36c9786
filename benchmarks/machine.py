"""What the benchmark ran on: times mean nothing without it, ratios little."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import subprocess
from contextlib import suppress
from pathlib import Path

PACKAGES = "mckibben jax jaxlib equinox numpy scipy xarray h5netcdf casadi mujoco lmfit".split()


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def sentence() -> str:
    """Return processor, cores, compiler and versions of all that is compared, in a line or two."""
    model, compiler, versions = platform.machine(), "no C compiler", [f"Python {platform.python_version()}"]
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
        vectors = "AVX-512" if "avx512f" in fields.get("flags", "") else "no AVX-512"
        model = f"{fields.get('model name', model)} ({vectors})"
    with suppress(OSError, IndexError):
        compiler = subprocess.run(["cc", "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    for name in PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            versions.append(f"{name} {importlib.metadata.version(name)}")
    today, load = datetime.datetime.now(datetime.UTC).date(), os.getloadavg()[0]
    return f"{model}, {cores()} cores; {', '.join(versions)}; {compiler}; {today}, load {load:.1f} at the start"
