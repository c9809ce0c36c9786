"""Settings of JAX before it starts: 64-bit numbers, fast loops on the CPU; and the cache of compiled programs.

JAX is imported only on first use, so that `import mckibben` and `mckibben --help` stay quick.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import platform
import sys
from collections.abc import Mapping
from pathlib import Path

_LOOP_OPTION = "xla_cpu_small_while_loop_byte_threshold"
_PROGRAMS = "MCKIBBEN_PROGRAMS_DIR"
_EXTRA_OPTIONS = "--xla_backend_extra_options="
_CPUINFO = Path("/proc/cpuinfo")
_CONSTANT = {
    *("vendor_id", "cpu family", "model", "model name", "stepping", "flags"),  # x86
    *("CPU implementer", "CPU architecture", "CPU variant", "CPU part", "CPU revision", "Features"),  # ARM
}


def configure() -> None:
    """Set JAX to 64 bits and to compile CPU loops as a whole; in the environment, for child processes too.

    Compiled programs are kept in the user's cache folder, unless the variable MCKIBBEN_PROGRAMS_DIR is set and empty.
    """
    use_program_cache()
    os.environ["JAX_ENABLE_X64"] = "1"
    # On the CPU, JAX before 0.12 dispatches every fusion of a loop's body separately: an episode takes 4 to 20 times as
    # long.
    major, minor = importlib.metadata.version("jax").split(".")[:2]
    if (int(major), int(minor)) < (0, 12):
        os.environ["XLA_FLAGS"] = with_loop_option(os.environ.get("XLA_FLAGS", ""))
    if "jax" in sys.modules:
        import jax

        jax.config.update("jax_enable_x64", True)


def with_loop_option(flags: str) -> str:
    """The user's XLA flags plus ours; the user's value of the option takes precedence.

    >>> with_loop_option("--xla_dump_to=x")
    '--xla_dump_to=x --xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000'
    """
    if _LOOP_OPTION in flags:
        return flags
    option = f"{_LOOP_OPTION}=1000000000"
    if _EXTRA_OPTIONS in flags:
        return flags.replace(_EXTRA_OPTIONS, f"{_EXTRA_OPTIONS}{option},", 1)
    return f"{flags} {_EXTRA_OPTIONS}{option}".strip()


def use_program_cache() -> None:
    """Store compiled programs in the user's cache folder, for the next process."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # no home directory: no cache
        return
    fingerprint = processor()
    if fingerprint is not None:
        os.environ.setdefault(_PROGRAMS, str(Path(base) / "mckibben" / f"programs-{fingerprint}"))


def programs_folder() -> Path | None:
    """Folder of the program cache; None if not requested, or if the instruction set is unknown (outside Linux)."""
    folder = os.environ.get(_PROGRAMS)
    return Path(folder) if folder and processor() is not None else None


def xla_programs_folder() -> Path | None:
    """`programs_folder` for XLA programs; None if JAX has a persistent cache, whose programs cannot be stored again."""
    return None if os.environ.get("JAX_COMPILATION_CACHE_DIR") else programs_folder()


@functools.cache
def processor() -> str | None:
    """Digest of the processor model, for which programs are compiled; None if unknown."""
    about = _cpuinfo()
    if not _instructions(about):
        return None
    described = [platform.machine(), *(f"{name}={value}" for name, value in sorted(about.items()))]
    return hashlib.sha256("\n".join(described).encode()).hexdigest()[:8]


def _instructions(about: Mapping[str, str]) -> frozenset[str]:
    """Instruction set extensions: ``flags`` on x86, ``Features`` on ARM.

    >>> sorted(_instructions({"flags": "sse2 avx2"}))
    ['avx2', 'sse2']
    """
    return frozenset(about.get("flags", about.get("Features", "")).split())


@functools.cache
def _cpuinfo() -> dict[str, str]:
    """Constant entries of the first processor in /proc/cpuinfo."""
    about = {}
    try:
        with _CPUINFO.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                name, colon, value = (word.strip() for word in line.partition(":"))
                if not colon and about:
                    break  # the next processor
                if name in _CONSTANT:
                    about[name] = value
    except OSError:
        return {}
    return about


@functools.cache
def batch_options() -> dict[str, int]:
    """Compiler options for batches: by default, XLA's CPU backend uses half of a 512-bit vector unit."""
    import jax

    if jax.default_backend() != "cpu":
        return {}
    return {"xla_cpu_prefer_vector_width": 512} if "avx512f" in _instructions(_cpuinfo()) else {}
