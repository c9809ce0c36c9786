"""mckibben tune, as people type it; and what is left when it is interrupted or killed."""

import itertools
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mckibben.scenario import Scenario
from mckibben.simulation.metrics import METRICS
from mckibben.study.tune import read_trials
from mckibben.study.tune.objective import TuningProblem

HOLDING = """
import os, signal, time
from pathlib import Path
fsync, written = os.fsync, []
def slowly(file):  # the second answer is on disk; then nothing goes on but an interruption
    fsync(file)
    if Path("kept/history.journal").exists():
        written.append(file)
    if len(written) >= 3:  # the folder of a new history, too
        Path("holding").touch()
        time.sleep(1000)
os.fsync = slowly
signal.signal(signal.SIGINT, signal.default_int_handler)  # the tests may run in the background, where it is ignored
from mckibben.cli import main
main()
"""
CHANGES = (
    ("duration: 10 s", "duration: 100 ms"),
    ("control_period: 1 ms", "control_period: 2 ms"),
    ("{class: sine, amplitude: 10 deg, frequency: 0.5 Hz}", "2 deg"),
    ("{class: step, before: 13 N*m/rad, after: 17 N*m/rad, at: 5 s}", "15 N*m/rad"),
)
START = ("--parameters", "start.angle=-5..8 deg", "--parameters", "start.stiffness=11..20 N*m/rad log")
COST = ("--cost", "angle_rmse/1 deg + stiffness_rmse/1 N*m/rad", "--margin", "1")
SMALL = (*START, *COST, "--population", "8", "--starts", "2", "--iterations", "3", "--out", "kept")


@pytest.fixture
def text() -> str:
    """The example, with nothing to do but to stay at 2 deg and 15 N*m/rad."""
    said = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
    for old, new in CHANGES:
        assert old in said
        said = said.replace(old, new)
    return said


@pytest.fixture
def scenario(tmp_path, text) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def mistaken(cli, tmp_path, scenario):
    """Call with a mistake: it is bad input, said in one error without a progress bar; what is said."""

    def call(*arguments: str) -> str:
        found = cli("tune", *arguments)
        assert (found.code, found.out) == (2, ""), found
        assert found.err.startswith("error: ")
        assert "Traceback" not in found.err
        assert [path.name for path in tmp_path.iterdir()] == ["s.yaml"], "something is in the way of the next try"
        return found.err

    return call


@pytest.mark.parametrize("method", ["cma", "gradient", "evolution"])
@pytest.mark.slow
def test_a_search_from_beginning_to_end(cli, scenario, tmp_path, text, method, each_progress):
    found = cli("tune", "s.yaml", *SMALL, "--method", method)
    assert found.code == 0
    kept = tmp_path / "kept"
    names = {"s-tuned.yaml", "history.journal", "results.json", "tuning.png", "tuning.svg"}
    assert {path.name for path in kept.iterdir()} == names
    assert all(name.removeprefix("tuning") in found.out for name in names)
    numbers = json.loads((kept / "results.json").read_text(encoding="utf-8"))
    assert numbers["cost"] <= numbers["cost_before"]
    tried = read_trials(kept / "history.journal")
    assert numbers["evaluated"] == len(tried)
    assert f": evaluating, lowest cost {min(trial.cost for trial in tried):.4g}" in found.err
    (run,) = numbers["runs"]
    assert set(run["before"]) == set(run["tuned"]) == set(METRICS)
    assert run["scenario"] == "pre-contracted knee, stiffness step, PID"
    tuned = run["tuned"]["angle_rmse_deg"] + run["tuned"]["stiffness_rmse"]
    assert numbers["cost"] == pytest.approx(tuned, rel=1e-6)
    assert f"cost {numbers['cost_before']:.4g} -> {numbers['cost']:.4g}" in found.out
    values = numbers["values"]
    assert list(values) == ["start.angle", "start.stiffness"]
    assert re.search(rf"start\.angle +0 deg +{re.escape(values['start.angle']['shown'])}\s", found.out)

    new = (kept / "s-tuned.yaml").read_text(encoding="utf-8")
    read = Scenario.parse(new)
    assert [read.start.angle, read.start.stiffness] == [each["si"] for each in values.values()]
    changed = [(a, b) for a, b in zip(text.splitlines(), new.splitlines(), strict=True) if a != b]
    assert len(changed) == 1, "its comments and order are kept"
    assert changed[0][1].startswith("start: {angle: ")
    again = cli("simulate", "kept/s-tuned.yaml", "--json")
    assert json.loads(again.out)["metrics"] == run["tuned"]
    alone = json.loads(cli("margins", "kept/s-tuned.yaml", "--json").out)["margins"]
    assert run["least_margins"]["tuned"] == {name: pytest.approx(min(values)) for name, values in alone.items()}
    assert all(run["least_margins"]["before"].values())


@pytest.mark.slow
def test_a_search_over_conditions_has_their_margin(cli, scenario, tmp_path):
    found = cli(
        *("tune", "s.yaml", "--parameters", "controller.position.kp=1..4 bar/rad", "--method", "evolution"),
        *("--conditions", "load.mass2=+-20 %", "--draws", "4", "--percentile", "75", "--population", "8"),
        *("--iterations", "1", "--out", "kept"),
    )
    assert found.code == 0, found.err
    assert "angle RMSE [deg] in the 4 conditions" in found.out
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    assert len(numbers["conditions"]["load.mass2"]) == 4
    (run,) = numbers["runs"]
    found = run["in_conditions"]
    assert 1 <= found["gain_margin"] <= 10
    assert (found["percentile"], found["diverged"], found["unstable"]) == (75, 0, 0)
    errors = found["angle_rmse_deg"]
    assert 0 < errors["median"] <= errors["percentile"] <= errors["worst"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--draws", "4"), "--conditions"),
        (("--percentile", "50"), "--conditions"),
        (("--conditions", "load.mass2=0.5 kg"), "does not vary"),
        (("--conditions", "load.mass2=+-20 %", "--percentile", "101"), "the percentile is 101"),
    ],
)
def test_conditions_that_mean_nothing_are_refused(cli, scenario, arguments, named):
    found = cli("tune", "s.yaml", "--parameters", "controller.position.kp=1..4 bar/rad", *arguments, "--out", "kept")
    assert (found.code, named in found.err) == (2, True), found.err


@pytest.mark.slow
def test_json_alone_on_standard_output(cli, scenario, tmp_path):
    found = cli("tune", "s.yaml", *SMALL, "--method", "cma", "--json")
    assert found.code == 0
    assert json.loads(found.out) == json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    assert re.fullmatch(r"wrote s-tuned.yaml, history.journal.* to kept\n", found.err)


@pytest.mark.slow
def test_files_that_scenarios_name_are_found_from_the_new_folder(cli, tmp_path, text, monkeypatch):
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: values[:, 1])  # what is found does not matter here
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "reference.csv").write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    far = text.replace("angle: 2 deg", "angle: {class: samples_file, file: reference.csv}")
    assert far != text
    (tmp_path / "a" / "s.yaml").write_text(far, encoding="utf-8")
    (tmp_path / "b" / "s.yaml").write_text(text, encoding="utf-8")
    found = cli("tune", "a/s.yaml", "b/s.yaml", *SMALL, "--method", "cma")
    assert found.code == 0, found.err
    kept = tmp_path / "kept"
    values = json.loads((kept / "results.json").read_text(encoding="utf-8"))["values"]
    tuned = [Scenario.read(kept / name) for name in ("s-tuned.yaml", "s-tuned-2.yaml")]
    before = [Scenario.read(tmp_path / name / "s.yaml") for name in "ab"]
    for new, old in zip(tuned, before, strict=True):
        assert new.model_copy(update={"start": old.start}) == old
        assert [new.start.angle, new.start.stiffness] == [each["si"] for each in values.values()]
    assert tuned[0].signals.angle.file == tmp_path / "a" / "reference.csv"
    assert "# The knee" in (kept / "s-tuned-2.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(("known", "believed"), [((), 208e-3), (("--known", "joint.geometry.connector_length"), None)])
@pytest.mark.slow
def test_a_tuned_plant_is_known_to_the_controller_if_asked_alone(cli, scenario, tmp_path, monkeypatch, known, believed):
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: values[:, 0])  # what is found does not matter here
    plant = ("--parameters", "joint.geometry.connector_length=206..208 mm", *COST, "--iterations", "1", "--out", "kept")
    found = cli("tune", "s.yaml", *plant, "--method", "evolution", *known)
    assert found.code == 0, found.err
    tuned = Scenario.read(tmp_path / "kept" / "s-tuned.yaml")
    assert 206e-3 <= tuned.joint.geometry.connector_length < 208e-3
    true = tuned.joint.geometry.connector_length
    assert tuned.controller.model.geometry.connector_length == pytest.approx(believed or true, rel=1e-12)


@pytest.mark.slow
def test_a_scenario_that_cannot_start_is_mended(cli, scenario, tmp_path, text):
    scenario.write_text(text.replace("stiffness: 12 N*m/rad", "stiffness: 99 N*m/rad"), encoding="utf-8")
    found = cli("tune", "s.yaml", *SMALL, "--method", "cma")
    assert found.code == 0, found.err
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    assert numbers["cost_before"] is None
    assert set(numbers["runs"][0]["before"].values()) == {None}
    assert set(numbers["runs"][0]["least_margins"]["before"].values()) == {None}
    assert numbers["runs"][0]["tuned"]["angle_rmse_deg"] < 10
    assert f"cost {numbers['cost']:.4g}" in found.out and "no cost before" in found.out
    assert "nan" not in found.out


@pytest.mark.slow
def test_a_number_at_an_end_of_its_range_is_named(cli, scenario):
    narrow = ("--parameters", "start.angle=-2..1 deg", *START[2:], *SMALL[4:])
    found = cli("tune", "s.yaml", *narrow, "--method", "cma", "--iterations", "12")
    assert "at a bound of the range: start.angle" in found.out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (SMALL[:-2], "--out DIR"),
        (
            ("--parameters", "controller.positon.kp"),
            "did you mean 'controller.position.kp'?",
        ),  # before the missing --out
        ((*SMALL, "--method", "newton"), "choose one of gradient, evolution, cma"),
        ((*SMALL, "--parameters", "load.mass9=1..2 kg"), "no parameter 'mass9'"),
        ((*SMALL, "--parameters", "load.mass2=2..1 kg"), "the range is empty"),
        ((*SMALL, "--parameters", "load.mass2=1..2 N"), "does not have the dimensions of"),
        ((*SMALL, "--parameters", "start.angle"), "zero, or not given: there is no range around it"),
        (
            (*SMALL, "--parameters", "start.angle=0..1 deg"),
            "'start.angle=-5..8 deg' and 'start.angle=0..1 deg' are about the same parameter",
        ),
        (
            (*SMALL, "--parameters", "controller.position.kp", "--parameters", "controller.position.kp"),
            "'controller.position.kp' and 'controller.position.kp' are about the same parameter; keep one of them",
        ),
        ((*SMALL, "--parameters", "load.mass2=10 %"), "give a range (0.2 kg..1.0 kg), values"),
        ((*SMALL, "--cost", "stiffness_settling", "--method", "gradient"), "has no gradient; use cma or evolution"),
        ((*SMALL, "--cost", "coupling", "--method", "cma"), "coupling is not defined"),
        ((*SMALL, "--cost", "angle_rmse/1 N"), "does not have the dimensions of"),
        ((*SMALL, "--margin", "0.5"), "the gain margin is 0.5"),
        ((*START[:2], *COST, "--out", "kept", "--method", "cma"), "at least two parameters"),
        ((*SMALL, "--method", "cma", "--population", "3"), "at least 4"),
        ((*SMALL, "--method", "evolution", "--population", "4"), "at least 5"),
        ((*SMALL, "--iterations", "0"), "iterations is 0"),
        ((*SMALL, "--seed", "-1"), "seed is -1"),
        ((*SMALL, "--resume"), "no search to continue; start it without --resume"),
        (("missing.yaml", *SMALL), "missing.yaml"),
    ],
)
def test_a_mistake_is_one_error(mistaken, arguments, named):
    assert named in mistaken("s.yaml", *arguments)


@pytest.mark.parametrize("name", ["s-tuned.yaml", "s-tuned-2.yaml", "results.json", "tuning.png"])
def test_files_that_others_put_there_stay(cli, scenario, tmp_path, name):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / name).write_text("mine", encoding="utf-8")
    found = cli("tune", "s.yaml", "s.yaml", *SMALL)
    assert (found.code, found.out) == (2, "")
    assert f"{name}: it already exists; choose another folder, or move the existing file" in found.err
    assert [(path.name, path.read_text(encoding="utf-8")) for path in (tmp_path / "kept").iterdir()] == [(name, "mine")]


@pytest.mark.slow
def test_a_search_in_the_way_is_not_overwritten(cli, scenario, tmp_path):
    asked = ("tune", "s.yaml", *SMALL, "--method", "cma")
    assert cli(*asked).code == 0
    before = {path: path.read_bytes() for path in (tmp_path / "kept").iterdir()}
    found = cli(*asked)
    assert (found.code, found.out) == (2, "")
    assert "search history already exists; continue it (--resume), or choose another folder" in found.err
    for change, named in (
        (("--seed", "1"), "started with 0, not 1"),
        (("--worst",), "worst: .* started with False, not True"),
        (("--margin", "2"), "gain_margin: .* started with 1.0, not 2.0"),
        (("--delay-margin", "2 ms"), r"delay_margin: .* started with 0.0, not 0.002"),
        (("--cost", "angle_rmse"), "cost: the search was started"),
        (("--parameters", "load.damping"), "parameters: the search was started"),
    ):
        found = cli(*asked, *change, "--resume")
        assert (found.code, found.out) == (2, "")
        assert re.search(named, found.err)
        assert "nothing was changed" in found.err
    assert {path: path.read_bytes() for path in (tmp_path / "kept").iterdir()} == before


@pytest.mark.slow
class TestCutOff:
    """The same search undisturbed, and cut off twice; then they are the same."""

    KEPT = ("s-tuned.yaml", "results.json", "history.journal")

    def cut_off(self, folder, sent, *arguments):
        """Send a signal when two more answers have been written: exit code, and what was said."""
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDING, *arguments],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        while process.poll() is None and not (folder / "holding").exists():
            time.sleep(0.01)
        process.send_signal(sent)
        said, wrong = process.communicate(timeout=100)
        assert said == "", wrong
        (folder / "holding").unlink()
        return process.returncode, wrong

    def test_killed_and_interrupted_it_ends_where_it_would_have(self, cli, scenario, tmp_path, text):
        asked = ("tune", "s.yaml", *SMALL, "--method", "cma", "--iterations", "6")
        folder = tmp_path / "cut"
        folder.mkdir()
        (folder / "s.yaml").write_text(text, encoding="utf-8")
        code, _ = self.cut_off(folder, signal.SIGKILL, *asked)
        assert code == -signal.SIGKILL
        left = [(folder / "kept" / "history.journal").read_bytes()]
        with (folder / "kept" / "history.journal").open("ab") as file:
            file.write(b"MCKCHUNK torn")
        code, wrong = self.cut_off(folder, signal.SIGINT, *asked, "--resume")
        assert code == 130
        assert "interrupted: the evaluated points are in kept/history.journal; continue with --resume" in wrong
        assert "Traceback" not in wrong
        left.append((folder / "kept" / "history.journal").read_bytes())

        assert cli(*asked).code == 0
        undisturbed = [(tmp_path / "kept" / name).read_bytes() for name in self.KEPT]
        (tmp_path / "kept").rename(tmp_path / "undisturbed")
        (folder / "kept").rename(tmp_path / "kept")
        assert cli(*asked, "--resume").code == 0
        assert [(tmp_path / "kept" / name).read_bytes() for name in self.KEPT] == undisturbed
        for earlier, later in itertools.pairwise([*left, undisturbed[-1]]):
            assert later.startswith(earlier)
            assert len(later) > len(earlier)

    def test_with_gradients_it_goes_on_from_the_start_of_its_history(self, cli, scenario, tmp_path):
        """What a killed search leaves is such a start, as the test above shows."""
        asked, kept = ("tune", "s.yaml", *SMALL, "--method", "gradient", "--iterations", "6"), tmp_path / "kept"
        assert cli(*asked).code == 0
        undisturbed = [(kept / name).read_bytes() for name in self.KEPT]
        for path in kept.iterdir():
            path.unlink()
        history = undisturbed[-1]
        (kept / "history.journal").write_bytes(history[: len(history) // 2])
        assert cli(*asked, "--resume").code == 0
        assert [(kept / name).read_bytes() for name in self.KEPT] == undisturbed
