"""Submissions: one Python file with a function `fit`, run and checked."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import cast

import numpy as np

from mckibben.bench.baselines import Fit
from mckibben.bench.task import Floats, Task
from mckibben.errors import SubmissionError

_FIT = "define fit(training), which returns predict(inputs); see docs/bench.md"
_PREDICT = "return one finite number for each row of inputs"


def read_submission(path: str | os.PathLike[str]) -> Fit:
    """Run a Python file and return its function `fit`; raises a `SubmissionError`."""
    file = Path(path)
    spec = importlib.util.spec_from_file_location(f"mckibben_submission_{file.stem}", file)
    if file.suffix != ".py" or not file.is_file() or spec is None or spec.loader is None:
        what = "is not a Python file" if file.exists() else "does not exist"
        raise SubmissionError(f"{file} {what}", file=str(file), remedy="name a file that ends in .py")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses look their module up
    with _blamed(str(file), "", "correct it; it must run without arguments"):
        spec.loader.exec_module(module)
    fit = getattr(module, "fit", None)
    if not callable(fit):
        found = "has no function fit" if fit is None else f"defines fit as {type(fit).__name__}, not as a function"
        raise SubmissionError(f"{file} {found}", file=str(file), function="fit", remedy=_FIT)
    return cast(Fit, fit)


def predictions(fit: Fit, task: Task, file: str = "") -> dict[str, Floats] | None:
    """Return the predicted outputs by name of the test block; None if `fit` does not apply to the task.

    Raises
    ------
    SubmissionError
        If a function of the file fails, or returns something else.
    """
    with _blamed(file, "fit", f"correct it; it was called for the task {task.name!r}"):
        predict = fit(task.training)
    if predict is None:
        return None
    if not callable(predict):
        text = f"{file}: fit returned {type(predict).__name__} in the task {task.name!r}, not a function"
        raise SubmissionError(text, file=file, function="fit", remedy=_FIT)
    found = {}
    for block in task.tests:
        place = f"for the block {block.name!r} of the task {task.name!r}"
        with _blamed(file, "predict", f"correct it; it was called {place}"):
            output = predict(block.inputs.copy())
        found[block.name] = _checked(output, block.output.size, file, place)
    return found


def _checked(output: object, size: int, file: str, place: str) -> Floats:
    """The output as finite numbers, one for each row of the inputs."""
    try:
        values = np.asarray(output, float)
    except (TypeError, ValueError):
        wrong = f"{type(output).__name__} {place}, not numbers"
    else:
        count = int(np.count_nonzero(~np.isfinite(values)))
        if values.shape not in ((size,), (size, 1)):
            wrong = f"the shape {values.shape} instead of ({size},) {place}"
        elif count:
            wrong = f"{count} values that are not finite {place}"
        else:
            return values.reshape(size)
    raise SubmissionError(f"{file}: predict returned {wrong}", file=file, function="predict", remedy=_PREDICT)


@contextlib.contextmanager
def _blamed(file: str, function: str, remedy: str) -> Iterator[None]:
    """Raise a `SubmissionError` with the line of a file for any exception; without a file, the exception itself."""
    try:
        yield
    except (Exception, SystemExit) as error:
        if not file:
            raise
        line, of = _last_line(error.__traceback__, Path(file)), f"{function} " if function else ""
        text = f"{file}{f', line {line}' if line else ''}: {of}raised {type(error).__name__}: {error}"
        raise SubmissionError(text, file=file, function=function, remedy=remedy) from error


def _last_line(trace: TracebackType | None, file: Path) -> int | None:
    """Line of the innermost frame of an exception in a file."""
    lines = [one.lineno for one in traceback.extract_tb(trace) if Path(one.filename).resolve() == file.resolve()]
    return lines[-1] if lines else None
