"""mckibben compare, as people type it."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.scenario import Scenario
from mckibben.storage.store import STUDY
from mckibben.study.compare import CompareResult, Suite
from mckibben.study.tune import read_trials

TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
DECOUPLING = TEXT[TEXT.index("  decoupling:\n") : TEXT.index("  as it is:")]
KP = "controller.position.kp"

pytestmark = pytest.mark.usefixtures("simulating_nothing")


@pytest.fixture
def written(tmp_path):
    """Writes a suite file."""

    def write(*pairs, name="suite.yaml"):
        text = TEXT
        for old, new in pairs:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (tmp_path / name).write_text(text, encoding="utf-8")
        return Suite.parse(text)

    return write


@pytest.fixture
def undrawn(monkeypatch):
    """No figures: they take longer than all else."""
    monkeypatch.setattr("mckibben.study.compare.CompareResult.figures", ())


def results(folder):
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_comparison_from_beginning_to_end(cli, written, tmp_path, monkeypatch):
    made, write = [], CompareResult.write
    monkeypatch.setattr(CompareResult, "write", lambda contest, out: made.append(contest) or write(contest, out))
    suite = written((DECOUPLING, ""))
    found = cli("compare", "suite.yaml", "--out", "kept")
    assert found.code == 0, found.err
    kept = tmp_path / "kept"
    assert {path.name for path in kept.iterdir()} == {
        *("results.json", "runs.nc", "suite.yaml", STUDY, "controllers"),
        *(f"comparison_{name}.{end}" for name in ("errors", "front") for end in ("png", "svg")),
    }
    assert Suite.read(kept / "suite.yaml") == suite
    (contest,) = made
    assert results(kept)["verdict"] == contest.verdict() and " ".join(found.out.split()).startswith(contest.verdict())
    for name in contest.tuned:
        scenario = Scenario.read(kept / "controllers" / f"{name.lower().replace(' ', '-')}.yaml")
        expected = contest.tuned[name].get(KP)
        assert scenario.control().position.kp == (expected or 2e5)
        assert scenario.start.angle == pytest.approx(np.deg2rad(5.0)), "at the first angle of its reference"
    equal, tuned = results(kept)["tables"]
    assert tuned["columns"]["cost_tuned"]["values"][0] == contest.training_cost["PID 3"][0]
    assert "controller.position.kp" in tuned["columns"]["parameters"]["values"][0]
    columns = {name: column["values"] for name, column in results(kept)["columns"].items()}
    assert columns["controller"] == contest.order
    assert equal["title"].startswith("With no more air than the tuned PID 3")
    assert equal["columns"]["controller"]["values"] == ["PID 3"], "the other is not tuned"
    assert f"{(~contest.started).sum()} runs were infeasible" in found.out
    scenario = Scenario.read(kept / "controllers" / "pid-3-at-equal-air.yaml")
    assert scenario.control().position.kp == contest.at_air.tuned["PID 3"][KP]
    with xr.open_dataset(kept / "runs.nc") as runs:
        assert runs.sizes == {"controller": 2, "run": 16}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.slow
def test_a_quick_look_as_json(cli, written, tmp_path):
    written(
        (DECOUPLING, ""), ("generations: 2", "generations: 20"), ("evaluation: {runs: 16", "evaluation: {runs: 4096")
    )
    looked = cli("compare", "suite.yaml", "--out", "kept", "--json", "--quick")
    assert looked.code == 0
    numbers = json.loads(looked.out)
    assert numbers == results(tmp_path / "kept")
    assert "on 128 runs" in numbers["verdict"] and looked.err.startswith("wrote results.json")
    kept = Suite.read(tmp_path / "kept" / "suite.yaml")
    assert (kept.evaluation.runs, kept.tuning.generations, kept.tuning.starts) == (128, 2, 1)
    assert 16 <= len(read_trials(tmp_path / "kept" / STUDY, "PID 3")) <= 18


def test_a_scenario_has_a_suite_of_its_own(cli, tmp_path, monkeypatch):
    monkeypatch.setattr("mckibben.study.compare.compare", lambda suite, **_: pytest.fail(",".join(suite.controllers)))
    scenario = str(Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml")
    with pytest.raises(BaseException, match="scenario,"):
        cli("compare", scenario, "--out", "kept")
    suite = Suite.read(tmp_path / "kept" / "suite.yaml")
    assert suite.controllers.keys() == {"scenario", "PID with feedforward", "decoupling"}
