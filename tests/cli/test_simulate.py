"""mckibben simulate: our examples, mistakes, warnings, and what is kept."""

import errno
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from mckibben import report
from mckibben.component.columns import labels_of
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import Metrics, SimulationResult
from mckibben.simulation.metrics import METRICS
from mckibben.units import deg

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted(p.stem for p in (ROOT / "examples").glob("*.yaml"))


@pytest.mark.slow
def test_an_example_in_full(cli):
    found = cli("simulate", str(ROOT / "examples" / "pre-contracted-step-pid.yaml"), "--json")
    assert (found.code, found.err) == (0, "")
    numbers = json.loads(found.out)
    assert (numbers["result"], numbers["ok"], numbers["verdict"]) == ("SimulationResult", True, "completed")
    assert [remark["field"] for remark in numbers["remarks"]] == ["accuracy"]
    values = {name: scalar["value"] for name, scalar in numbers["scalars"].items()}
    assert set(values) == set(Metrics._fields)
    assert 0.5 * deg < values["angle_rmse"] < 3 * deg
    assert 0 < values["stiffness_settling"] < 0.5
    assert values["estimate_rmse"] < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_runs_and_its_numbers_are_those_of_the_run(cli, tmp_path, shortened, name):
    (tmp_path / "short.yaml").write_text(shortened(name), encoding="utf-8")
    found = cli("simulate", "short.yaml")
    determined = name == "linear-axis"  # by the place: no stiffness can be asked for
    assert (found.code, found.err) == (0, "")
    assert ("the desired stiffness is not attainable" in " ".join(found.out.split())) == determined
    result = run_scenario(Scenario.read(tmp_path / "short.yaml"))
    for metric, value in result.metrics.items():
        _, unit, factor = next(m for m in METRICS.values() if m[0] == metric)
        shown = "-" if value != value else f"{value / factor:.4g}"
        title = labels_of(Metrics)[metric].title
        assert re.search(rf"{re.escape(title)} +{re.escape(shown)} +{re.escape(unit)}", found.out), metric
    assert found.out.startswith(result.verdict()) and not result.poor_tracking


@pytest.mark.slow
def test_animate_writes_the_run_and_mistakes_come_before_it(cli, tmp_path, shortened):
    (tmp_path / "short.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    found = cli("simulate", "short.yaml", "--animate", "run.gif", "--json")
    assert (found.code, json.loads(found.out)["ok"]) == (0, True)
    assert (tmp_path / "run.gif").read_bytes()[:6] == b"GIF89a"
    for name, part in (("run.gif", "already"), ("run.mp4", ".webp"), ("missing/run.gif", "")):
        refused = cli("simulate", "short.yaml", "--animate", name)
        assert (refused.code, refused.out) == ((2, "") if part else (0, refused.out)), name
        assert part in refused.err
    assert cli("simulate", "short.yaml", "--animate", "run.gif", "--force").code == 0


@pytest.mark.parametrize("option", [[], ["--json"]])
@pytest.mark.slow
def test_out_keeps_a_run_that_can_be_had_again(cli, tmp_path, shortened, option):
    (tmp_path / "short.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    found = cli("simulate", "short.yaml", "--out", "kept", *option)
    assert found.code == 0
    kept = tmp_path / "kept"
    assert {"result.nc", "results.json", "scenario.yaml", "tracking.png"} <= {p.name for p in kept.iterdir()}
    numbers = json.loads((kept / "results.json").read_text(encoding="utf-8"))
    if option:
        assert json.loads(found.out) == numbers
    assert Scenario.read(kept / "scenario.yaml") == Scenario.read(tmp_path / "short.yaml")
    result = SimulationResult.from_netcdf(kept / "result.nc")
    again = run_scenario(Scenario.read(kept / "scenario.yaml"))
    assert again.to_dataset().drop_attrs().identical(result.to_dataset().drop_attrs())
    assert result.metrics["stiffness_rmse"] == numbers["scalars"]["stiffness_rmse"]["value"]


def test_three_mistakes_are_three_errors_with_their_lines(cli, tmp_path, shortened):
    text = shortened("pre-contracted-step-pid")
    for old, new in (
        ("connector_length: 208 mm", "connector_length: 208 N"),
        ("kd: 0 bar*s/(N*m/rad)", "kd: 0"),
        ("control_period: 1 ms", "control_period: 3 ms"),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "bad.yaml").write_text(text, encoding="utf-8")
    found = cli("simulate", "bad.yaml")
    assert (found.code, found.out) == (2, "")
    first, *lines = found.err.splitlines()
    assert first == "error: bad.yaml: 3 problems"
    assert len(lines) == 3
    numbered = text.splitlines()
    for line, mistake, field in zip(
        lines, ("208 N", "kd: 0}", "3 ms"), ("connector_length", "kd", "control_period"), strict=True
    ):
        number = next(i for i, row in enumerate(numbered, start=1) if mistake in row)
        assert line.startswith(f"  line {number}, ")
        assert field in line


def test_the_mistakes_of_the_documentation_give_its_words(cli, tmp_path):
    text = (ROOT / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
    text = text.replace("kd: 0.4 bar*s/rad", "kd: 0").replace("duration: 10 s", "duration: 10.0005 s")
    (tmp_path / "bad.yaml").write_text(text, encoding="utf-8")
    found = cli("simulate", "bad.yaml")
    flat = lambda words: " ".join(re.sub(r"line \d+", "line", words).split())  # noqa: E731
    assert flat(found.err) in flat((ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8"))


@pytest.fixture
def kept(cli, tmp_path, shortened):
    """Folder of a run that was kept."""
    (tmp_path / "short.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    assert cli("simulate", "short.yaml", "--out", "kept").code == 0
    return tmp_path / "kept"


@pytest.mark.slow
def test_results_are_replaced_by_force_alone_and_links_are_not_followed(cli, kept, tmp_path):
    before = {path.name: path.read_bytes() for path in kept.iterdir()}
    found = cli("simulate", "short.yaml", "--out", "kept")
    assert found.code == 2
    assert "1 problem" in found.err and "results.json" in found.err and "--force" in found.err
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before
    precious = tmp_path / "precious"
    for name in before:
        (kept / name).unlink()
        (kept / name).symlink_to(precious)
    precious.write_text("mine")
    assert cli("simulate", "short.yaml", "--out", "kept").code == 2
    assert cli("simulate", "short.yaml", "--out", "kept", "--force").code == 0
    assert precious.read_text() == "mine"
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before


@pytest.mark.slow
def test_a_full_disk_says_what_is_kept_and_a_vanished_folder_that_nothing_is(cli, kept, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def vanished(*_, **__):
        shutil.rmtree(kept)
        os.open(kept / "tracking.png", os.O_CREAT)

    monkeypatch.setattr(report, "save", full)
    found = cli("simulate", "short.yaml", "--out", "kept", "--force")
    assert found.code == 2
    assert "No space left on device; kept are result.nc, " in found.err and "make room" in found.err
    monkeypatch.setattr(report, "save", vanished)
    found = cli("simulate", "short.yaml", "--out", "kept", "--force")
    assert found.code == 2
    assert "the folder has disappeared" in found.err
