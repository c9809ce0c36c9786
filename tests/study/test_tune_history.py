"""What was tried is kept: a search that was cut off goes on, and nothing else is taken for it or overwritten."""

import os
from pathlib import Path

import numpy as np
import pytest

from mckibben.codegen.native import compiler
from mckibben.errors import FileError, McKibbenWarning, ParameterError, UnreachableError
from mckibben.scenario import Scenario, Start
from mckibben.storage.journal import JournalReader, read_header
from mckibben.study.parameters import LogUniform, Uniform
from mckibben.study.tune import Cost, Method, read_trials, tune
from mckibben.study.tune.objective import TuningProblem
from mckibben.study.tune.tune import Trial, TuningHistory
from mckibben.units import deg

EXAMPLE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
TEXT = EXAMPLE
for old, new in (
    ("duration: 10 s", "duration: 100 ms"),
    ("control_period: 1 ms", "control_period: 2 ms"),
    ("{class: sine, amplitude: 10 deg, frequency: 0.5 Hz}", "2 deg"),
    ("{class: step, before: 13 N*m/rad, after: 17 N*m/rad, at: 5 s}", "15 N*m/rad"),
):
    assert old in TEXT
    TEXT = TEXT.replace(old, new)
STILL = Scenario.parse(TEXT)
RANGES = {"start.angle": Uniform(-5 * deg, 8 * deg), "start.stiffness": LogUniform(11.0, 20.0)}
COST = Cost.of({"angle_rmse": deg, "stiffness_rmse": 1.0})
ASKED = {"method": Method.CMA, "iterations": 4, "starts": 2, "population": 8, "seed": 3}
ABOUT = {"kind": "tuning", "seed": 3}


def run(path, *, scenarios=STILL, ranges=RANGES, cost=COST, **changes):
    return tune(scenarios, ranges, cost, history=path, **ASKED | changes)


def cut(path, trials, *, torn=0):
    """Leave so many trials of a history, and some bytes of another."""
    reader = JournalReader(path)
    for _, _ in zip(range(trials + 2), reader, strict=False):  # the header appears twice
        end = reader.end
    assert end + torn < path.stat().st_size
    path.write_bytes(path.read_bytes()[: end + torn])


@pytest.fixture(scope="module", params=Method)
def method(request):
    return request.param


@pytest.fixture(scope="module")
def whole(method, tmp_path_factory):
    """A search from beginning to end, and its file."""
    path = tmp_path_factory.mktemp("whole") / "history.journal"
    return run(path, method=method), path


@pytest.mark.parametrize(("trials", "torn"), [(0, 0), (0, 20), (4, 0), (13, 50)])
@pytest.mark.slow
def test_a_search_goes_on_wherever_it_was_cut_off(method, whole, tmp_path, trials, torn):
    undisturbed, complete = whole
    path = tmp_path / "history.journal"
    path.write_bytes(complete.read_bytes())
    cut(path, trials, torn=torn)
    assert run(path, method=method, resume=True) == undisturbed
    assert path.read_bytes() == complete.read_bytes()


@pytest.mark.slow
def test_a_search_that_is_done_is_only_looked_up(method, whole, tmp_path, monkeypatch):
    undisturbed, complete = whole
    path = tmp_path / "history.journal"
    path.write_bytes(complete.read_bytes())
    monkeypatch.setattr(TuningHistory, "add", lambda *_: pytest.fail("something was tried again"))
    assert run(path, method=method, resume=True) == undisturbed
    assert path.read_bytes() == complete.read_bytes()


@pytest.mark.slow
def test_more_iterations_go_further(method, whole, tmp_path):
    undisturbed, complete = whole
    path = tmp_path / "history.journal"
    path.write_bytes(complete.read_bytes())
    further = run(path, method=method, resume=True, iterations=7)
    assert path.read_bytes().startswith(complete.read_bytes())
    assert further.evaluated > undisturbed.evaluated
    assert further.cost <= undisturbed.cost
    assert further == run(None, method=method, iterations=7)


@pytest.fixture
def for_free(monkeypatch):
    """No runs, where they do not matter."""
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: np.sum(values**2, axis=1))


@pytest.mark.parametrize(
    ("changed", "field", "said"),
    [
        ({"seed": 4}, "seed", "started with 3, not 4"),
        ({"method": Method.EVOLUTION}, "method", "started with cma, not evolution"),
        ({"population": 9}, "population", "started with 8, not 9"),
        ({"cost": Cost.of({"angle_rmse": deg})}, "cost", "not angle_rmse"),
        ({"cost": Cost(COST.terms, gain_margin=1.5)}, "gain_margin", "started with 1.0, not 1.5"),
        ({"cost": Cost(COST.terms, worst=True)}, "worst", "started with False, not True"),
        ({"ranges": RANGES | {"start.stiffness": LogUniform(11.0, 20.000000001)}}, "parameters", "20.000000001"),
        ({"scenarios": [STILL, STILL]}, "scenarios", "started without"),
        ({"scenarios": Scenario.parse(TEXT.replace("2 deg", "3 deg"))}, "scenarios", ""),
    ],
)
@pytest.mark.usefixtures("for_free")
def test_another_search_is_refused_by_name_and_nothing_is_changed(tmp_path, changed, field, said):
    path = tmp_path / "history.journal"
    run(path, iterations=1)
    with path.open("ab") as file:
        file.write(b"MCKCHUNKtorn")
    before = path.read_bytes()
    with pytest.raises(FileError) as refused:
        run(path, resume=True, **changed)
    assert any(problem.field == field and said in problem.message for problem in refused.value.problems)
    assert path.read_bytes() == before


@pytest.mark.usefixtures("for_free")
def test_a_file_that_the_scenario_names_is_a_part_of_the_search(tmp_path):
    samples = tmp_path / "reference.csv"
    samples.write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    text = TEXT.replace("angle: 2 deg", "angle: {class: samples_file, file: reference.csv}")
    assert text != TEXT
    path = tmp_path / "history.journal"
    run(path, iterations=1, scenarios=Scenario.parse(text, folder=tmp_path))
    samples.write_text("time_s,angle_deg\n0,2\n1,3\n", encoding="utf-8")
    with pytest.raises(FileError, match="models: the search was started with"):
        run(path, iterations=1, scenarios=Scenario.parse(text, folder=tmp_path), resume=True)


@pytest.mark.usefixtures("for_free")
def test_it_does_not_matter_from_where_a_search_goes_on(tmp_path, monkeypatch):
    (tmp_path / "reference.csv").write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    scenario = Scenario.parse(
        TEXT.replace("angle: 2 deg", "angle: {class: samples_file, file: reference.csv}"), folder=tmp_path
    )
    monkeypatch.chdir(tmp_path)
    first = run(Path("history.journal"), iterations=1, scenarios=scenario)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert run(Path("../history.journal"), iterations=1, scenarios=scenario, resume=True) == first


def test_an_existing_history_is_not_overwritten_and_a_missing_one_not_gone_on_with(tmp_path):
    path = tmp_path / "history.journal"
    with (
        pytest.raises(FileError, match="no search to continue; start it without --resume"),
        TuningHistory.open(path, ABOUT, resume=True),
    ):
        pytest.fail("there is none")
    assert not path.exists()
    path.write_text("my own notes", encoding="utf-8")
    with pytest.raises(FileError, match="search history already exists"), TuningHistory.open(path, ABOUT):
        pytest.fail("there is one")
    assert path.read_text(encoding="utf-8") == "my own notes"
    with pytest.raises(FileError, match="search history already exists"):  # before anything is compiled
        run(path)


def test_a_start_that_no_gains_can_mend_is_refused_before_the_search(tmp_path):
    path = tmp_path / "history.journal"
    gain = {"controller.position.kp": Uniform(1e5, 3e5)}
    with pytest.raises(UnreachableError):
        run(path, scenarios=STILL.replace(start=Start(stiffness=1e4)), ranges=gain)
    assert not path.exists()


@pytest.mark.parametrize("content", [b"", b"my own notes\n", b'{"kind": "tuning"}\n', b"MCKCHUNKI\2" + bytes(100)])
def test_what_is_no_history_is_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "history.journal"
    path.write_bytes(content)
    with pytest.raises(FileError) as caught, TuningHistory.open(path, {}, resume=True):
        pytest.fail("it is not a history")
    cut = content[:8] in (b"", b"MCKCHUNK")
    assert (caught.value.problems[0].field == "header") is cut
    assert path.read_bytes() == content


@pytest.mark.slow
def test_a_search_is_not_continued_by_another_engine(tmp_path, monkeypatch):
    path = tmp_path / "history.journal"
    run(path, iterations=1)
    kept = read_header(path, "mckibben tuning history", 3)["software"]
    assert kept["engine"] == ("xla" if compiler() is None else "native")
    before = path.read_bytes()
    monkeypatch.setattr("mckibben.simulation.engine.compiler", lambda: None)
    if kept["engine"] == "native":
        with pytest.raises(FileError) as caught:
            run(path, resume=True)
        (problem,) = [problem for problem in caught.value.problems if problem.field == "software engine"]
        assert "native" in problem.message and "xla" in problem.message
        assert path.read_bytes() == before
    by_xla = tmp_path / "xla.journal"
    first = run(by_xla, iterations=2)
    cut(by_xla, 9)
    monkeypatch.undo()
    assert run(by_xla, iterations=2, resume=True) == first  # by XLA too, though there is a compiler
    assert read_header(by_xla, "mckibben tuning history", 3)["software"]["engine"] == "xla"


@pytest.mark.slow
def test_a_search_on_cuda_has_the_same_trials(tmp_path, cuda_here):
    path = tmp_path / "history.journal"
    found, expected = (run(path, iterations=1, engine="cuda"), run(None, iterations=1, engine="native"))
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    assert read_header(path, "mckibben tuning history", 3)["software"]["engine"] == "cuda"
    with pytest.raises(ParameterError) as caught:
        run(None, method=Method.GRADIENT, engine="cuda")
    assert (caught.value.field, caught.value.value) == ("engine", "cuda")


@pytest.mark.usefixtures("for_free")
def test_a_damaged_trial_is_computed_again(tmp_path):
    path = tmp_path / "history.journal"
    undisturbed = run(path)
    content = bytearray(path.read_bytes())
    content[content.index(b'"cost"', len(content) // 2)] ^= 1
    path.write_bytes(content)
    assert len(read_trials(path)) == undisturbed.evaluated - 1
    with pytest.warns(McKibbenWarning, match="1 damaged trials will be recomputed"):
        again = run(path, resume=True)
    assert (again.values, again.cost, again.evaluated) == (
        undisturbed.values,
        undisturbed.cost,
        undisturbed.evaluated,
    )
    assert sorted(read_trials(path)) == sorted(undisturbed.trials)


def test_a_search_that_another_process_goes_on_with_is_left_to_it(tmp_path):
    path = tmp_path / "deep" / "history.journal"
    with TuningHistory.open(path, ABOUT) as first:
        with (
            pytest.raises(FileError, match=rf"another process \(pid {os.getpid()} on .*\) is continuing this search"),
            TuningHistory.open(path, ABOUT, resume=True),
        ):
            pytest.fail("two at once")
        first.add([Trial((0.5,), 1.0)])
    with TuningHistory.open(path, ABOUT, resume=True) as again:
        assert len(again.trials) == 1
    assert [file.name for file in path.parent.iterdir()] == ["history.journal"]


def test_trials_come_back_to_the_last_bit(tmp_path):
    path, rng = tmp_path / "history.journal", np.random.default_rng(0)
    trials = [Trial(tuple(rng.random(3).tolist()), float(c), tuple(rng.normal(size=3))) for c in rng.random(20)]
    trials.append(Trial((0.0, 1.0, 0.1 + 0.2), 1e6, (0.0, 1e-300, -1e300)))
    with TuningHistory.open(path, ABOUT) as kept:
        kept.add(trials[:7])
        kept.add(trials[5:])  # two of them again
        kept.add([])
        assert kept.trials == trials
    with TuningHistory.open(path, ABOUT, resume=True) as again:
        assert again.trials == trials == read_trials(path)
        assert again.find(np.array(trials[3].point)) == trials[3]
        assert again.find(np.array(trials[3].point) + 1e-16) in (None, trials[3])
        assert again.find(np.zeros(3)) is None
        assert again.best == min(trials, key=lambda trial: trial.cost)


def test_of_equal_costs_the_best_does_not_depend_on_who_came_first():
    one, other = Trial((0.1, 0.9), 1.0), Trial((0.2, 0.1), 1.0)
    for order in ([one, other], [other, one]):
        kept = TuningHistory()
        kept.add(order)
        assert kept.best == one


@pytest.mark.usefixtures("for_free")
def test_a_trial_is_on_disk_before_the_search_goes_on(tmp_path, monkeypatch):
    path, seen = tmp_path / "history.journal", []
    find = TuningHistory.find

    def looking(self, point):
        seen.append((len(read_trials(path)), len(self.trials)))
        return find(self, point)

    monkeypatch.setattr(TuningHistory, "find", looking)
    run(path, iterations=2)
    assert all(on_disk == known for on_disk, known in seen)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"ranges": {"start.angle": RANGES["start.angle"]}}, "at least two parameters"),
        ({"population": 3}, "at least 4"),
        ({"method": Method.EVOLUTION, "population": 4}, "at least 5"),
        ({"method": Method.GRADIENT, "cost": Cost.of({"stiffness_settling": 1.0})}, "no gradient"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_a_search_that_cannot_begin_leaves_no_history_in_the_way(tmp_path, changed, named):
    with pytest.raises(ParameterError, match=named):
        run(tmp_path / "history.journal", **changed)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("for_free")
def test_the_result_shows_itself_in_short():
    found = run(None)
    assert len(repr(found)) < 100 and f"{found.evaluated} trials" in repr(found)
    assert found._repr_html_().count("<tr>") == 1 + len(found.values)
