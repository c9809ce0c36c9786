"""Submissions of one file: run, compared, and refused with file, function and remedy."""

import sys

import numpy as np
import pytest

from mckibben.bench import TaskFile, compare_submissions, read_submission, read_task, task_named
from mckibben.bench.identibench import identibench_model, identibench_spec
from mckibben.bench.submission import predictions
from mckibben.errors import DatasetError, ParameterError, ScenarioError, SubmissionError

MEAN = """
import numpy as np

def fit(training):
    mean = training.stacked[1].mean()
    return lambda inputs: np.full(len(inputs), mean)
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="mine.py"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return write


@pytest.mark.parametrize(
    "text, function",
    [
        ("import no_such_module_here", ""),
        ("def fits(training): pass", "fit"),
        ("fit = 3", "fit"),
        ("def fit(training): return 1 / 0", "fit"),
        ("def fit(training): return 3", "fit"),
        ("def fit(training): return lambda inputs: 1 / 0", "predict"),
        ("def fit(training): return lambda inputs: inputs", "predict"),
        ("def fit(training): return lambda inputs: 0.0", "predict"),
        ("def fit(training): return lambda inputs: ['a'] * len(inputs)", "predict"),
        ("def fit(training): return lambda inputs: inputs[:, 0] * float('nan')", "predict"),
    ],
)
def test_a_wrong_submission_names_file_function_and_remedy(write, text, function):
    file = write(text)
    with pytest.raises(SubmissionError) as error:
        predictions(read_submission(file), task_named("map-four-lengths"), file)
    assert (error.value.file, error.value.function) == (file, function)
    assert error.value.remedy
    assert file in error.value.message


def test_an_exception_names_its_line(write, monkeypatch, tmp_path):
    file = write("def fit(training):\n    x = 1\n    return [][x]\n")
    monkeypatch.chdir(tmp_path)
    for path in (file, "mine.py"):
        with pytest.raises(SubmissionError) as error:
            predictions(read_submission(path), task_named("map-four-lengths"), path)
        assert "line 3" in error.value.message


@pytest.mark.parametrize("body", ["return 1 / 0", "raise SystemExit(0)", "return lambda inputs: inputs"])
def test_a_submission_that_fails_costs_no_other_result(write, body):
    bad, task = write(f"def fit(training):\n    {body}\n", "bad.py"), task_named("map-four-lengths")
    table = compare_submissions([task], [write(MEAN), bad], baselines=())
    assert table.failed
    assert [one.score is not None for one in table.entries] == [True, False]
    assert bad in table.entries[1].reason


def test_a_submission_may_define_dataclasses(write):
    model = "import dataclasses\n\n@dataclasses.dataclass\nclass Model:\n    mean: float\n"
    file = write("from __future__ import annotations\n" + model + MEAN)
    table = compare_submissions([task_named("map-four-lengths")], [file], baselines=())
    assert table.entries[0].score is not None


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SubmissionError) as error:
        read_submission(tmp_path / "none.py")
    assert error.value.file.endswith("none.py")


def test_two_methods_of_one_name_are_refused(write):
    alone = compare_submissions([task_named("map-four-lengths")], [write(MEAN, "eq2.py")], baselines=())
    assert len(alone.entries) == 1
    for files in ([write(MEAN, "eq2.py")], [write(MEAN), write(MEAN)]):
        with pytest.raises(ParameterError) as error:
            compare_submissions([task_named("map-four-lengths")], files)
        assert error.value.value in ("eq2", "mine")


def test_a_submission_that_does_not_apply_has_no_score(write):
    table = compare_submissions([task_named("map-four-lengths")], [write("def fit(training): return None")], ())
    assert table.entries[0].score is None


TASK = """
name: rig
task: map
train: [known.csv]
test: [asked.csv]
source: our rig, 2026
licence: CC0
facts: {initial_length: 180 mm}
"""


@pytest.fixture
def folder(tmp_path):
    task = task_named("map-wall")
    for name, one in (("known", task.training.blocks[0]), ("asked", task.tests[0])):
        rows = np.column_stack([one.inputs[:, 1] / 1e5, one.output, one.inputs[:, 0] * 100])
        np.savetxt(
            tmp_path / f"{name}.csv", rows, delimiter=",", header="pressure_bar,force_N,contraction_%", comments=""
        )
    (tmp_path / "task.yaml").write_text(TASK, encoding="utf-8")
    return tmp_path


def test_a_folder_is_a_task(folder):
    task, built_in = read_task(folder), task_named("map-wall")
    np.testing.assert_allclose(task.training.blocks[0].inputs, built_in.training.blocks[0].inputs)
    np.testing.assert_allclose(task.tests[0].output, built_in.tests[0].output, atol=1e-12)
    assert task.training.facts == {"initial_length": 0.18}
    assert TaskFile.read(folder / "task.yaml").licence == "CC0"


def test_a_baseline_names_the_fact_that_it_lacks(folder):
    text = TASK.replace("map", "joint").replace("facts: {initial_length: 180 mm}", "period: 10 ms")
    (folder / "task.yaml").write_text(text, encoding="utf-8")
    for name in ("known", "asked"):
        (folder / f"{name}.csv").write_text("command1_bar,command2_bar,angle_deg\n1,2,3\n2,1,4\n", encoding="utf-8")
    (entry,) = compare_submissions([read_task(folder)], baselines=("eq2",)).entries
    assert entry.score is None and "initial_length" in entry.reason
    with pytest.raises(ParameterError) as error:
        compare_submissions([read_task(folder)] * 2, baselines=())
    assert error.value.field == "name"


def test_mistakes_in_a_folder_are_named(folder):
    (folder / "asked.csv").write_text("pressure_N,force_N\n1,2\n", encoding="utf-8")
    with pytest.raises(DatasetError) as error:
        read_task(folder)
    assert [one.field for one in error.value.problems] == ["", "pressure_N"]
    (folder / "task.yaml").write_text(TASK.replace("map", "chart"), encoding="utf-8")
    with pytest.raises(ScenarioError) as error:
        read_task(folder)
    assert error.value.problems[0].field == "task"


@pytest.mark.slow
def test_identibench_scores_a_submission_as_we_do(tmp_path, write):
    package = pytest.importorskip("identibench")
    fit = read_submission(write(MEAN))
    with package.utils.data_root(tmp_path / "data"):
        spec = identibench_spec("map-wall")
        found = package.run_benchmark(spec, identibench_model(fit, "map-wall"))
    task = task_named("map-wall")
    mean = task.training.stacked[1].mean()
    expected = np.mean([np.sqrt(np.mean((one.output - mean) ** 2)) for one in task.tests])
    assert found["metric_score"] == pytest.approx(expected, rel=1e-5)  # its files are read in 32 bits


def test_without_identibench_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "identibench", None)
    with pytest.raises(ParameterError) as error:
        identibench_spec("map-wall")
    assert error.value.field == "identibench"


@pytest.mark.parametrize(
    ("old", "new"),
    [("task: map", "task: isometric"), ("licence: CC0", "licence: CC0\nperiod: 20 ms"), ("[asked.csv]", "[known.csv]")],
)
def test_a_task_needs_a_period_for_recordings_alone_and_other_data_for_its_test(folder, old, new):
    file = folder / "task.yaml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(ScenarioError):
        read_task(folder)


def test_one_test_block_gives_no_interval(folder):
    table = compare_submissions([read_task(folder)], baselines=["eq2"])
    assert np.isnan(table.entries[0].score.nrmse.lower)
    assert table.entries[0].score.nrmse.value > 0
    assert table.rows()[0][3] == "-"
