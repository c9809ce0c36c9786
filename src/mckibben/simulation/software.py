"""Software that determines the last bits of results: versions, platform, engine and compiler."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from importlib.metadata import version

import jax

from mckibben.codegen.cuda import device
from mckibben.codegen.engine import check_engine
from mckibben.codegen.native import compiler, compiler_version, compiler_words, own_flags
from mckibben.version import __version__


def software(engine: str = "auto") -> dict[str, str]:
    """Versions, platform, the engine of batches and its compiler: with the user's options, or with the CUDA device."""
    parts = {
        "mckibben": __version__,
        "jax": jax.__version__,
        "scipy": version("scipy"),
        "platform": jax.default_backend(),
        "engine": check_engine(engine, many=True),
    }
    if parts["engine"] == "native":
        parts["compiler"] = " ".join([compiler_version(compiler() or ""), *compiler_words()[1:], *own_flags()])
    if parts["engine"] == "cuda":
        parts |= {"compiler": device().compiler, "device": device().name}
    return parts


def engine_of_job(
    trial: Callable[[], Collection[str]], stored: Mapping[str, str] | None = None, engine: str = "auto"
) -> str:
    """Return the engine of all results of a stored job, as those of another would differ by rounding.

    Parameters
    ----------
    trial
        Function that computes some runs of a new job, and returns the engines that they used.
    stored
        Software of a job that is resumed (`software`); None for a new one.
    engine
        One of `ENGINES`; "auto" is that of the stored job, else XLA if the trial used it.
    """
    if engine == "auto" and stored is not None and stored.get("engine") in ("xla", "cuda"):
        engine = stored["engine"]
    chosen = check_engine(engine, many=True)
    if engine != "auto" or stored is not None:
        return chosen
    return "xla" if chosen == "xla" or "xla" in trial() else "native"
