"""Runs by XLA, or by the C compiler of the machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np

from mckibben.codegen.native import NativeFunction, compiler
from mckibben.control.base import Controller, Setpoint
from mckibben.errors import ExportError, ParameterError, quoted
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import Record, compiled_episode, episode

R = TypeVar("R")

ENGINES = ("auto", "native", "xla")
"""Engines: programs emitted as C and compiled by the machine's compiler, XLA's, or the first where it can be used."""


def check_engine(engine: str, precision: Any = np.float64, *, many: bool = False) -> str:
    """The engine to be tried: "native" or "xla"; raises `ParameterError` for a wrong one, or one that is not there."""
    if engine not in ENGINES:
        raise ParameterError(
            f"{quoted(engine)} is no engine", field="engine", value=engine, remedy=f"give {', '.join(ENGINES)}"
        )
    if engine == "xla":
        return engine
    missing = ""
    if compiler() is None:
        missing = "there is no C compiler"
    elif np.dtype(precision) != np.float64 and not many:
        missing = "it has 32 bits for batches only"
    elif jax.default_backend() != "cpu":
        missing = "runs are computed on an accelerator"
    if missing and engine == "native":
        raise ParameterError(
            f"the engine 'native' cannot be used: {missing}", field="engine", value=engine, remedy="use 'auto' or 'xla'"
        )
    return "xla" if missing else "native"


def compute_with(
    engine: str, precision: Any, native: Callable[[], R], xla: Callable[[], R], *, many: bool = False
) -> tuple[R, str]:
    """Result and engine of a computation; "auto" takes XLA where the native one cannot be emitted."""
    if check_engine(engine, precision, many=many) == "native":
        try:
            return native(), "native"
        except ExportError:
            if engine == "native":
                raise
    return xla(), "xla"


def run_alone(
    engine: str,
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    start: PlantState,
    period: Any,
    substeps: int,
) -> tuple[Record, str]:
    """Record of one run, and the engine that computed it; `numeric` parts."""
    parts = plant, controller, setpoints, start, period, substeps
    precision = np.asarray(period).dtype
    return compute_with(engine, precision, lambda: native_episode(parts), lambda: compiled_episode(*parts)[1])


@NativeFunction
def native_episode(parts: Any, _: None) -> Record:
    """Record of one run."""
    return episode(*parts)[1]
