"""Benchmark of muscle models: tasks with fixed splits, baselines, and submissions of one file (`mckibben bench`)."""

from mckibben.bench.baselines import BASELINES
from mckibben.bench.comparison import BenchEntry, BenchTable, compare_submissions
from mckibben.bench.folder import SetupFacts, TaskFile, read_task
from mckibben.bench.foreign import ForeignJoint, ForeignMuscle
from mckibben.bench.identibench import identibench_model, identibench_spec
from mckibben.bench.submission import read_submission
from mckibben.bench.task import KINDS, DataBlock, ScoreInterval, Task, TaskScore, Training
from mckibben.bench.tasks import TASKS, task_named

__all__ = [
    "BASELINES",
    "KINDS",
    "TASKS",
    "BenchEntry",
    "BenchTable",
    "DataBlock",
    "ForeignJoint",
    "ForeignMuscle",
    "ScoreInterval",
    "SetupFacts",
    "Task",
    "TaskFile",
    "TaskScore",
    "Training",
    "compare_submissions",
    "identibench_model",
    "identibench_spec",
    "read_submission",
    "read_task",
    "task_named",
]
