"""What was tried is kept: a search that was cut off goes on, and nothing else is taken for it or overwritten."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from mckibben.errors import FileError, ParameterError
from mckibben.study.parameters import LogUniform, Uniform
from mckibben.study.scenario import Scenario
from mckibben.study.tune import Cost, Method, tune
from mckibben.study.tune.problem import TuningProblem
from mckibben.study.tune.tune import Trial, TuningHistory
from mckibben.units import deg

EXAMPLE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
TEXT = EXAMPLE
for old, new in (
    ("duration: 10 s", "duration: 100 ms"),
    ("control_period: 1 ms", "control_period: 2 ms"),
    ("{sine: {amplitude: 10 deg, frequency: 0.5 Hz}}", "2 deg"),
    ("{step: {before: 13 N*m/rad, after: 17 N*m/rad, at: 5 s}}", "15 N*m/rad"),
):
    assert old in TEXT
    TEXT = TEXT.replace(old, new)
STILL = Scenario.parse(TEXT)
RANGES = {"start.angle": Uniform(-5 * deg, 8 * deg), "start.stiffness": LogUniform(11.0, 20.0)}
COST = Cost.of({"angle_rmse": deg, "stiffness_rmse": 1.0})
ASKED = {"method": Method.CMA, "iterations": 4, "starts": 2, "population": 8, "seed": 3}
ABOUT = {"kind": "tuning", "seed": 3}
ONE = {"numbers": 1, "slopes": False}


def run(path, *, scenarios=STILL, ranges=RANGES, cost=COST, **changes):
    return tune(scenarios, ranges, cost, history=path, **ASKED | changes)


def cut(path, lines, *, torn=""):
    """Leave so many lines of a file, the first included, and part of another."""
    text = path.read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(text) > lines
    path.write_text("".join(text[:lines]) + (torn and text[lines][: len(text[lines]) // 2]), encoding="utf-8")


@pytest.fixture(scope="module", params=Method)
def method(request):
    return request.param


@pytest.fixture(scope="module")
def whole(method, tmp_path_factory):
    """A search from beginning to end, and its file."""
    path = tmp_path_factory.mktemp("whole") / "history.jsonl"
    return run(path, method=method), path


@pytest.mark.parametrize("torn", ["", "torn"])
@pytest.mark.parametrize("lines", [1, 5, 14])
def test_a_search_goes_on_wherever_it_was_cut_off(method, whole, tmp_path, lines, torn):
    undisturbed, complete = whole
    path = tmp_path / "history.jsonl"
    path.write_bytes(complete.read_bytes())
    cut(path, lines, torn=torn)
    assert run(path, method=method, resume=True) == undisturbed
    assert path.read_bytes() == complete.read_bytes()


def test_a_search_that_is_done_is_only_looked_up(method, whole, tmp_path, monkeypatch):
    undisturbed, complete = whole
    path = tmp_path / "history.jsonl"
    path.write_bytes(complete.read_bytes())
    monkeypatch.setattr(TuningHistory, "add", lambda *_: pytest.fail("something was tried again"))
    assert run(path, method=method, resume=True) == undisturbed
    assert path.read_bytes() == complete.read_bytes()


def test_more_iterations_go_further(method, whole, tmp_path):
    undisturbed, complete = whole
    path = tmp_path / "history.jsonl"
    path.write_bytes(complete.read_bytes())
    further = run(path, method=method, resume=True, iterations=7)
    assert path.read_bytes().startswith(complete.read_bytes())
    assert further.evaluated > undisturbed.evaluated
    assert further.cost <= undisturbed.cost
    assert further == run(None, method=method, iterations=7)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"seed": 4}, "a search with seed 3, not 4"),
        ({"method": Method.EVOLUTION}, "a search with method cma, not evolution"),
        ({"population": 9}, "a search with population 8, not 9"),
        ({"cost": Cost.of({"angle_rmse": deg})}, "a search with cost .*, not angle_rmse"),
        ({"cost": Cost(COST.terms, gain_margin=1.5)}, "a search with gain margin 1.0, not 1.5"),
        ({"cost": Cost(COST.terms, worst=True)}, "a search with worst False, not True"),
        (
            {"ranges": RANGES | {"start.stiffness": LogUniform(11.0, 20.000000001)}},
            r"with parameters .*, not .*20\.000000001",
        ),
        ({"scenarios": [STILL, STILL]}, "differs in scenarios or what they name"),
        ({"scenarios": Scenario.parse(TEXT.replace("2 deg", "3 deg"))}, "differs in scenarios or what they name"),
    ],
)
def test_another_search_is_refused_by_name_and_nothing_is_changed(tmp_path, changed, named):
    path = tmp_path / "history.jsonl"
    run(path, iterations=1)
    with path.open("a") as file:
        file.write('{"torn')
    before = path.read_bytes()
    with pytest.raises(FileError, match=f"(?s)history.jsonl.*{named}.*nothing was changed"):
        run(path, resume=True, **changed)
    assert path.read_bytes() == before


@pytest.fixture
def for_free(monkeypatch):
    """No runs, where they do not matter."""
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: np.sum(values**2, axis=1))


@pytest.mark.usefixtures("for_free")
def test_a_file_that_the_scenario_names_is_a_part_of_the_search(tmp_path):
    samples = tmp_path / "wish.csv"
    samples.write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    text = TEXT.replace("angle: 2 deg", "angle: {samples: {file: wish.csv}}")
    assert text != TEXT
    path = tmp_path / "history.jsonl"
    run(path, iterations=1, scenarios=Scenario.parse(text, folder=tmp_path))
    samples.write_text("time_s,angle_deg\n0,2\n1,3\n", encoding="utf-8")
    with pytest.raises(FileError, match="differs in scenarios or what they name"):
        run(path, iterations=1, scenarios=Scenario.parse(text, folder=tmp_path), resume=True)


@pytest.mark.usefixtures("for_free")
def test_it_does_not_matter_from_where_a_search_goes_on(tmp_path, monkeypatch):
    (tmp_path / "wish.csv").write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    scenario = Scenario.parse(TEXT.replace("angle: 2 deg", "angle: {samples: {file: wish.csv}}"), folder=tmp_path)
    monkeypatch.chdir(tmp_path)
    first = run(Path("history.jsonl"), iterations=1, scenarios=scenario)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert run(Path("../history.jsonl"), iterations=1, scenarios=scenario, resume=True) == first


def test_an_existing_history_is_not_overwritten_and_a_missing_one_not_gone_on_with(tmp_path):
    path = tmp_path / "history.jsonl"
    with pytest.raises(FileError, match="no search to go on with; start it without --resume"):
        TuningHistory(path, ABOUT, **ONE, resume=True)
    assert not path.exists()
    path.write_text("my own notes", encoding="utf-8")
    with pytest.raises(FileError, match="history of a search already"):
        TuningHistory(path, ABOUT, **ONE)
    assert path.read_text(encoding="utf-8") == "my own notes"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        b"my own notes\n",
        b"\xff\xfe\x00binary\n",
        b"[1, 2]\n",
        b"3\n",
        b"null\n",
        b'"kind"\n',
        b'{"kind": "sweep"}\n',
        b"{}\n",
    ],
)
def test_what_is_no_history_is_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "history.jsonl"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"no history of a search|it is a search with"):
        TuningHistory(path, ABOUT, **ONE, resume=True)
    assert path.read_bytes() == content


GOOD = '{"point": [0.5], "cost": 1.0, "gradient": null}'
SLOPED = '{"point": [0.5], "cost": 1.0, "gradient": [2.0]}'


@pytest.mark.parametrize("slopes", [False, True])
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('{"point": [0.5]}', "it has no point, cost and gradient"),
        ("[]", "it has no point, cost and gradient"),
        ("", "Expecting value"),
        ('{"point": [0.5], "co', "Unterminated string"),
        ('{"point": [0.5], "cost": null, "gradient": null}', "its cost is no number"),
        ('{"point": [0.5], "cost": NaN, "gradient": null}', "its cost is no number"),
        ('{"point": [0.5], "cost": Infinity, "gradient": null}', "its cost is no number"),
        ('{"point": [0.5], "cost": "1.0", "gradient": null}', "its cost is no number"),
        ('{"point": [0.5], "cost": true, "gradient": null}', "its cost is no number"),
        ('{"point": ["a"], "cost": 1.0, "gradient": null}', "its point is no list of numbers"),
        ('{"point": 0.5, "cost": 1.0, "gradient": null}', "its point is no list of numbers"),
        ('{"point": [], "cost": 1.0, "gradient": null}', "its point has 0 numbers, not 1"),
        ('{"point": [0.5, 0.5], "cost": 1.0, "gradient": null}', "its point has 2 numbers, not 1"),
        ('{"point": [1.5], "cost": 1.0, "gradient": null}', "its point is outside the ranges"),
        ('{"point": [NaN], "cost": 1.0, "gradient": null}', "its point is outside the ranges"),
        (None, "it has a gradient|its gradient is no list of numbers"),
        ('{"point": [0.5], "cost": 1.0, "gradient": 4}', "it has a gradient|its gradient is no list of numbers"),
        ('{"point": [0.5], "cost": 1.0, "gradient": [1, 2]}', "it has a gradient|its gradient has 2 numbers, not 1"),
    ],
)
def test_a_line_that_is_no_trial_of_this_search_is_named(tmp_path, line, said, slopes):
    path = tmp_path / "history.jsonl"
    good, other = (SLOPED, GOOD) if slopes else (GOOD, SLOPED)
    line = other if line is None else line
    content = "\n".join([json.dumps(ABOUT), good, line, good.replace("0.5", "0.6"), line, ""])
    path.write_text(content, encoding="utf-8")
    with pytest.raises(
        FileError, match=f"line 3: it is no trial of this search: ({said}).*; remove the line"
    ) as refused:
        TuningHistory(path, ABOUT, numbers=1, slopes=slopes, resume=True)
    assert [problem.line for problem in refused.value.problems] == [3, 5]
    assert path.read_text(encoding="utf-8") == content
    path.write_text(content.replace(f"\n{line}\n", "\n"), encoding="utf-8")
    assert len(TuningHistory(path, ABOUT, numbers=1, slopes=slopes, resume=True).trials) == 2


def test_a_search_that_another_process_goes_on_with_is_left_to_it(tmp_path):
    path = tmp_path / "deep" / "history.jsonl"
    with TuningHistory.kept(path, ABOUT, **ONE) as first:
        with (
            pytest.raises(
                FileError, match=rf"another process \(pid {os.getpid()} on .*\) is going on with this search"
            ),
            TuningHistory.kept(path, ABOUT, **ONE, resume=True),
        ):
            pytest.fail("two at once")
        first.add([Trial((0.5,), 1.0)])
    with TuningHistory.kept(path, ABOUT, **ONE, resume=True) as again:
        assert len(again.trials) == 1
    assert [file.name for file in path.parent.iterdir()] == ["history.jsonl"]


def test_trials_come_back_to_the_last_bit(tmp_path):
    path, rng = tmp_path / "history.jsonl", np.random.default_rng(0)
    trials = [Trial(tuple(rng.random(3).tolist()), float(c), tuple(rng.normal(size=3))) for c in rng.random(20)]
    trials.append(Trial((0.0, 1.0, 0.1 + 0.2), 1e6, (0.0, 1e-300, -1e300)))
    kept = TuningHistory(path, ABOUT, numbers=3, slopes=True)
    kept.add(trials[:7])
    kept.add(trials[5:])  # two of them again
    kept.add([])
    again = TuningHistory(path, ABOUT, numbers=3, slopes=True, resume=True)
    assert again.trials == kept.trials == trials
    assert len(path.read_text().splitlines()) == 1 + len(trials)
    assert again.find(np.array(trials[3].point)) == trials[3]
    assert again.find(np.array(trials[3].point) + 1e-16) in (None, trials[3])
    assert again.find(np.zeros(3)) is None
    assert again.best == min(trials, key=lambda trial: trial.cost)


def test_of_equal_costs_the_best_does_not_depend_on_who_came_first():
    one, other = Trial((0.1, 0.9), 1.0), Trial((0.2, 0.1), 1.0)
    for order in ([one, other], [other, one]):
        kept = TuningHistory(None, ABOUT, numbers=2, slopes=False)
        kept.add(order)
        assert kept.best == one


def test_a_line_is_on_disk_before_the_search_goes_on(tmp_path, monkeypatch):
    path, seen = tmp_path / "history.jsonl", []
    find = TuningHistory.find

    def looking(self, point):
        seen.append((len(path.read_text().splitlines()) - 1, len(self.trials)))
        return find(self, point)

    monkeypatch.setattr(TuningHistory, "find", looking)
    run(path, iterations=2)
    assert all(on_disk == known for on_disk, known in seen)
    assert json.loads(path.read_text().splitlines()[0])["kind"] == "tuning"


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"ranges": {"start.angle": RANGES["start.angle"]}}, "at least two numbers"),
        ({"population": 3}, "at least 4"),
        ({"method": Method.EVOLUTION, "population": 4}, "at least 5"),
        ({"method": Method.GRADIENT, "cost": Cost.of({"stiffness_settling": 1.0})}, "no gradient"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_a_search_that_cannot_begin_leaves_no_history_in_the_way(tmp_path, changed, named):
    with pytest.raises(ParameterError, match=named):
        run(tmp_path / "history.jsonl", **changed)
    assert list(tmp_path.iterdir()) == []
