"""Set JAX up before it starts: 64-bit numbers, fast loops on the CPU, and programs that are kept for the command line.

Nothing here imports JAX before it is used, so that `import mckibben` and `mckibben --help` stay quick.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import platform
import sys
from pathlib import Path

_LOOP_OPTION = "xla_cpu_small_while_loop_byte_threshold"
_PROGRAMS = "MCKIBBEN_PROGRAMS_DIR"
_EXTRA_OPTIONS = "--xla_backend_extra_options="


def configure() -> None:
    """Ask for 64-bit JAX, and for compiled loops that run as one piece on the CPU.

    JAX before 0.12 dispatches every fusion of a loop's body by itself on the CPU, which makes a simulated episode
    4 to 20 times slower; an XLA flag cures it. It is added to what the user has set in ``XLA_FLAGS``. All settings go
    through the environment (child processes inherit them), and through `jax.config` where JAX is imported already.
    """
    os.environ["JAX_ENABLE_X64"] = "1"
    if _dispatches_loop_bodies():
        os.environ["XLA_FLAGS"] = with_loop_option(os.environ.get("XLA_FLAGS", ""))
    if "jax" in sys.modules:
        import jax

        jax.config.update("jax_enable_x64", True)


def with_loop_option(flags: str) -> str:
    """The user's XLA flags plus ours; a choice of the user's about the same option is kept.

    >>> with_loop_option("--xla_dump_to=x")
    '--xla_dump_to=x --xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000'
    """
    if _LOOP_OPTION in flags:
        return flags
    option = f"{_LOOP_OPTION}=1000000000"
    if _EXTRA_OPTIONS in flags:
        return flags.replace(_EXTRA_OPTIONS, f"{_EXTRA_OPTIONS}{option},", 1)
    return f"{flags} {_EXTRA_OPTIONS}{option}".strip()


def keep_programs() -> None:
    """Keep finished programs in the user's cache folder, so that the next process need not make them again."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # no home: then nothing is kept
        return
    os.environ.setdefault(_PROGRAMS, str(Path(base) / "mckibben" / f"programs-{_processor()}"))


def programs_folder() -> Path | None:
    """Where finished programs are kept between processes; None unless `keep_programs` was called.

    None as well where JAX keeps a cache of its own: a program that it took from there cannot be kept again.
    """
    folder = os.environ.get(_PROGRAMS)
    return Path(folder) if folder and not os.environ.get("JAX_COMPILATION_CACHE_DIR") else None


def _processor() -> str:
    """A short name for what the processor can do: programs compiled for one do not run on every other."""
    return hashlib.sha256(" ".join([platform.machine(), *sorted(_cpu_flags())]).encode()).hexdigest()[:8]


@functools.cache
def _cpu_flags() -> frozenset[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return frozenset()
    return frozenset(next((line for line in lines if line.startswith("flags")), "").split())


@functools.cache
def batch_options() -> dict[str, int]:
    """Compiler options for batches: XLA's CPU backend uses half of a 512-bit vector unit unless told otherwise."""
    import jax

    if jax.default_backend() != "cpu":
        return {}
    return {"xla_cpu_prefer_vector_width": 512} if "avx512f" in _cpu_flags() else {}


def _dispatches_loop_bodies() -> bool:
    major, minor = importlib.metadata.version("jax").split(".")[:2]
    return (int(major), int(minor)) < (0, 12)
