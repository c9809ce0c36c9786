"""Adapter to IdentiBench: tasks as its benchmarks, and submissions as its models.

D. O. M. Weber, IdentiBench (Apache-2.0), https://github.com/daniel-om-weber/identibench. Its package is optional: it is
imported by these functions only.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mckibben import __version__
from mckibben.bench.baselines import Fit
from mckibben.bench.task import DataBlock, Floats, Task, Training
from mckibben.bench.tasks import task_named
from mckibben.errors import ParameterError

_PREFIX = "mckibben-"


def identibench_spec(name: str) -> Any:
    """Return a task as an `identibench.BenchmarkSpec`, with inputs u0, u1, ... and output y0 in SI units.

    Its files are made in IdentiBench's data folder on first use; the last training block is also the validation data.
    The score is the mean of the RMSE of the test blocks, in SI units.

    Raises
    ------
    ParameterError
        If there is no such task, or IdentiBench is not installed.
    """
    package, task = _package(), task_named(name)
    data = package.Dataset(
        f"{_PREFIX}{name}", prepare=functools.partial(_write, name), version=f"{__version__} {task.digest()}"
    )
    return package.BenchmarkSpec(
        name=f"{_PREFIX}{name}",
        u_cols=[f"u{i}" for i in range(len(task.training.inputs))],
        y_cols=["y0"],
        train=[(data, "train/*.hdf5")],
        valid=[(data, f"train/{_file(len(task.training.blocks) - 1)}")],
        test_sets={"test": [(data, "test/*.hdf5")]},
        task=package.Simulation(metric=package.metrics.rmse),
    )


def identibench_model(fit: Fit, name: str) -> Callable[[Any], Callable[..., Floats]]:
    """Return a submission's `fit` as a `build_model` of IdentiBench, for the benchmark of a task."""
    task = task_named(name)

    def build_model(context: Any) -> Callable[..., Floats]:
        blocks = tuple(
            DataBlock.of(one.name, given.u, given.y[:, 0])
            for one, given in zip(task.training.blocks, context.get_train_sequences(), strict=True)
        )
        training = Training(name, task.training.kind, blocks, task.training.period, task.training.facts)
        predict = fit(training)
        if predict is None:
            raise ParameterError(f"the submission does not apply to the task {name!r}", value=name)
        return lambda u, y_init, attrs: np.asarray(predict(np.asarray(u, float)), float).reshape(-1, 1)

    return build_model


def _package() -> Any:
    try:
        import identibench  # of users who compare there
    except ImportError:
        raise ParameterError(
            "IdentiBench is not installed", field="identibench", remedy="run: pip install identibench"
        ) from None
    return identibench


def _write(name: str, folder: Path, force: bool) -> None:
    """Write the files of a task; called by IdentiBench in a process of its own."""
    task: Task = task_named(name)
    for part, blocks in (("train", task.training.blocks), ("test", task.tests)):
        (folder / part).mkdir(parents=True)
        for number, one in enumerate(blocks):
            _write_block(folder / part / _file(number), one, task.training.period)


def _write_block(path: Path, block: DataBlock, period: float | None) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for i, column in enumerate(block.inputs.T):
            file[f"u{i}"] = column
        file["y0"] = block.output
        file.attrs["name"] = block.name
        if period is not None:
            file.attrs["fs"] = 1 / period


def _file(number: int) -> str:
    """Name of the file of a block; the number keeps the order."""
    return f"{number:02d}.hdf5"
