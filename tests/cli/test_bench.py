"""mckibben bench: tables, files, folders, and mistakes."""

import csv
import json
import re
from pathlib import Path

import pytest

from mckibben.bench import task_named

MEAN = """
import numpy as np

def fit(training):
    mean = training.stacked[1].mean()
    return lambda inputs: np.full(len(inputs), mean)
"""
TASK = """
name: rig
task: joint
train: [known.csv]
test: [asked.csv]
period: 10 ms
source: our rig, 2026
licence: CC0
"""


@pytest.fixture
def submission(tmp_path):
    (tmp_path / "mine.py").write_text(MEAN, encoding="utf-8")
    return str(tmp_path / "mine.py")


def test_the_command_writes_the_table(cli, submission, tmp_path):
    out = tmp_path / "out"
    done = cli("bench", submission, "--tasks", "map-four-lengths", "--baselines", "eq2", "--out", str(out))
    assert done.code == 0, done.err
    rows = list(csv.DictReader((out / "scores.csv").open()))
    assert [row["method"] for row in rows] == ["mine", "eq2"]
    assert float(rows[0]["relative"]) > 1 == float(rows[1]["relative"])
    numbers = json.loads((out / "results.json").read_text())
    assert numbers["tasks"]["map-four-lengths"]["digest"] == task_named("map-four-lengths").digest()
    blocks = list(csv.DictReader((out / "blocks.csv").open()))
    assert {row["block"] for row in blocks} == {one.name for one in task_named("map-four-lengths").tests}


def test_the_command_refuses_mistakes(cli, tmp_path):
    assert cli("bench", "--tasks", "none").code == 2
    assert cli("bench", "--baselines", "none-such").code == 2
    (tmp_path / "wrong.py").write_text("fit = 1", encoding="utf-8")
    refused = cli("bench", "wrong.py", "--tasks", "map-four-lengths", "--baselines", "none")
    assert refused.code == 2 and "wrong.py" in refused.err


def test_tasks_are_listed(cli):
    shown = cli("bench", "--list", "--tasks", "map-wall")
    assert shown.code == 0
    assert task_named("map-wall").digest() in shown.out


def test_a_folder_takes_the_place_of_the_tasks(cli, submission, tmp_path):
    for name in ("known", "asked"):
        (tmp_path / f"{name}.csv").write_text("command1_bar,command2_bar,angle_deg\n1,2,3\n2,1,-3\n", encoding="utf-8")
    (tmp_path / "task.yaml").write_text(TASK, encoding="utf-8")
    done = cli("bench", submission, "--data", ".", "--baselines", "none", "--json")
    shown = json.loads(done.out)
    assert list(shown["tasks"]) == ["rig"]
    assert shown["entries"][0]["nrmse"]["value"] == pytest.approx(1.0)


def test_the_submission_of_the_documentation_runs(cli, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "bench.md").read_text(encoding="utf-8")
    (tmp_path / "affine.py").write_text(re.search(r"```py\n(.*?)```", page, re.DOTALL)[1], encoding="utf-8")
    done = cli("bench", "affine.py", "--tasks", "map-wall", "--baselines", "none", "--json")
    assert 0 < json.loads(done.out)["entries"][0]["nrmse"]["value"] < 2
