"""Sweeps in Python: the numbers are those of single runs, whoever computes them; their statistics and figure."""

import json
import re
import signal
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
import scipy.stats
import xarray as xr

from mckibben.codegen.native import compiler
from mckibben.errors import FileError, ParameterError, SimulationError
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import Metrics, Outcome
from mckibben.simulation.metrics import METRICS, USUAL_METRICS
from mckibben.simulation.outcome import OUTCOMES
from mckibben.simulation.software import software
from mckibben.storage.files import to_json
from mckibben.storage.store import STUDY, open_store, read_store
from mckibben.study.sweep import Sweep, SweepResult, sweep
from mckibben.units import deg

sweep_module = sys.modules[Sweep.__module__]
EXAMPLE = Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml"
OVER = ("load.mass2=0.2 kg..1.0 kg", "reference.stiffness.after=15..22 N*m/rad", "controller.position.kp=+-50 %")
SOME = {"samples": 72, "seed": 1}


@pytest.fixture(scope="module")
def scenario():
    text = EXAMPLE.read_text(encoding="utf-8")
    return Scenario.parse(text.replace("duration: 10 s", "duration: 100 ms").replace("at: 5 s", "at: 50 ms"))


@pytest.fixture(scope="module")
def kept(scenario, tmp_path_factory):
    """An undisturbed sweep, and its folder."""
    folder = tmp_path_factory.mktemp("sweep")
    return sweep(scenario, OVER, out=folder, **SOME), folder


def begun(folder: Path) -> dict:
    """Settings of the sweep in a folder."""
    with read_store(folder / STUDY) as store:
        return store.about()


@pytest.mark.slow
def test_the_numbers_are_those_of_single_runs(kept, scenario):
    swept, _ = kept
    assert (swept.count, swept.computed, swept.metrics) == (72, 72, USUAL_METRICS)
    assert swept.inputs == ("load.mass2", "reference.stiffness.after", "controller.position.kp")
    for run in (0, 17, 71):
        row = swept.table.isel(run=run)
        result = run_scenario(swept.scenario(run).model_copy(update={"substeps": int(row["substeps"])}))
        for name in USUAL_METRICS:
            value = result.metrics[name]
            np.testing.assert_allclose(row[name], value, rtol=1e-9, atol=1e-12, err_msg=name)
        assert swept.outcomes[run] is result.outcome


@pytest.mark.slow
def test_the_table_says_what_made_it(kept, scenario, tmp_path):
    swept, folder = kept
    swept.write(tmp_path)
    with xr.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as again:
        mass, gain = again["load.mass2"], again["controller.position.kp"].attrs
        assert mass.dims == ("run",) and again.sizes == {"run": 72}
        assert (mass.attrs["units"], mass.attrs["shown_units"]) == ("kg", "kg")
        assert (gain["units"], gain["shown_units"]) == ("Pa/rad", "bar/rad")
        assert again["angle_rmse"].attrs["units"] == "rad"
        assert again["outcome"].attrs["flag_meanings"].split() == [outcome.name for outcome in Outcome]
        manifest = json.loads(again.attrs["manifest"])
        assert Scenario.parse(again.attrs["scenario"], folder=folder) == scenario
    assert manifest == begun(folder)
    assert (manifest["design"], manifest["samples"], manifest["seed"]) == ("sobol", 72, 1)


@pytest.mark.slow
def test_the_controllers_model_follows_the_plant_where_asked_alone(scenario, tmp_path):
    varied, few = ["joint.geometry.connector_length=0.207 m, 0.208 m"], {"design": "grid", "metrics": ["angle_rmse"]}
    fixed = sweep(scenario, varied, **few)
    known = sweep(scenario, varied, out=tmp_path, model_follows="all", **few)
    for swept, believed in ((fixed, 0.208), (known, 0.207)):
        run = swept.scenario(0)
        assert run.plant().joint.geometry.connector_length == pytest.approx(0.207)
        assert run.control().model.geometry.connector_length == pytest.approx(believed)
        measured = run_scenario(run).metrics["angle_rmse"]
        assert float(swept.table["angle_rmse"][0]) == pytest.approx(measured, rel=1e-9)
    assert float(fixed.table["angle_rmse"][0]) != float(known.table["angle_rmse"][0])
    assert sweep(scenario, out=tmp_path, resume=True).computed == 0  # what is known is taken from the manifest
    with pytest.raises(FileError, match=r"model_follows: the study was started with joint\.geometry\.connector_length"):
        sweep(scenario, out=tmp_path, resume=True, model_follows=())


@pytest.mark.slow
def test_other_software_is_not_mixed_in(kept, scenario, monkeypatch):
    study = Sweep.of(scenario, OVER, **SOME)
    monkeypatch.setattr(sweep_module, "software", lambda engine: software(engine) | {"mckibben": "9.9"})
    with pytest.raises(FileError, match=r"mckibben: the study was started with .*, not 9.9"):
        sweep(scenario, out=kept[1], resume=True)
    with pytest.raises(SimulationError, match=r"a worker has mckibben 9\.9.*same environment"):
        study.compute({})


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
@pytest.mark.parametrize(
    ("change", "fields", "words"),
    [
        ({"mckibben.codegen.engine.compiler": lambda: None}, {"software engine", "software compiler"}, "not xla"),
        ({"mckibben.simulation.software.compiler_version": lambda _: "other 1.0"}, {"software compiler"}, "other 1.0"),
        ({"MCKIBBEN_CFLAGS": "-O1"}, {"software compiler"}, "-O1"),
    ],
)
def test_a_sweep_is_not_continued_by_another_engine_or_compiler(kept, scenario, monkeypatch, change, fields, words):
    _, folder = kept
    assert begun(folder)["software"]["engine"] == "native"
    assert sweep(scenario, out=folder, resume=True).computed == 0
    with pytest.raises(FileError):
        sweep(scenario, out=folder, resume=True, engine="xla")
    for name, value in change.items():
        monkeypatch.setattr(name, value) if callable(value) else monkeypatch.setenv(name, value)
    with pytest.raises(FileError) as caught:
        sweep(scenario, out=folder, resume=True)
    problems = {problem.field: problem.message for problem in caught.value.problems}
    assert problems.keys() == fields and words in " ".join(problems.values())


def test_a_draw_that_cannot_run_is_refused_before_anything_is_written(scenario, tmp_path):
    with pytest.raises(SimulationError) as refused:
        sweep(scenario, ["reference.angle.frequency=0.5..600 Hz"], out=tmp_path / "out", samples=16)
    assert refused.value.upper == 500 and not (tmp_path / "out").exists()


def test_there_must_be_a_sweep_to_continue(scenario, tmp_path):
    with pytest.raises(ParameterError, match="give its folder"):
        sweep(scenario, OVER, resume=True)
    with open_store(tmp_path / STUDY) as store:
        store.job({"format": "another"})
    with pytest.raises(FileError, match="a study of another kind"):
        sweep(scenario, OVER, out=tmp_path, resume=True)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"over": None}, "nothing is varied; give a parameter"),
        ({"over": ["joint.geometry.connector_length=200..390 mm"]}, r"row \d+: with joint.geometry.connector_length"),
        ({"samples": 0}, "samples is 0"),
        ({"design": "gird"}, "choose sobol, random or grid"),
        ({"design": "grid", "samples": 5}, "leave the number of samples out"),
        ({"dask": "here"}, "give an address like tcp"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_written(scenario, tmp_path, asked, said):
    with pytest.raises(ParameterError, match=said):
        sweep(scenario, asked.pop("over", OVER), out=tmp_path, **asked)
    assert not list(tmp_path.iterdir())


def test_without_dask_it_says_what_to_install(scenario, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ParameterError, match=r"pip install 'mckibben\[sweep\]'"):
        sweep(scenario, OVER, dask="tcp://127.0.0.1:1")


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes_though_a_worker_is_killed(scenario, tmp_path):
    killed = []

    def kill(step: str, done: float) -> None:
        children = [] if killed or not done else psutil.Process().children(recursive=True)
        for child in children:
            if "--multiprocessing-fork" in child.cmdline() or "spawn_main" in " ".join(child.cmdline()):
                child.send_signal(signal.SIGKILL)
                killed.append(child.pid)
                return

    distributed = pytest.importorskip("distributed")
    asked = {**SOME, "metrics": ["angle_rmse"]}
    here = sweep(scenario, OVER, **asked)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(**options) as cluster:
        address = cluster.scheduler_address
        there = sweep(scenario, OVER, out=tmp_path, dask=address, progress=kill, **asked)
    assert killed
    assert there.table.identical(here.table)


# Statistics and figure, of tables that are made up --------------------------------------------------------------------

INPUTS = {
    "load.mass2": ("kg", "kg", "load.mass2=0.2 kg..1 kg"),
    "controller.position.kp": ("Pa/rad", "bar/rad", "controller.position.kp=1 bar/rad..100 bar/rad log"),
    "reference.stiffness.after": ("N*m/rad", "N*m/rad", "reference.stiffness.after=15 N*m/rad, 17 N*m/rad"),
    "start.angle": ("rad", "deg", "start.angle=-5 deg..5 deg"),
    "valve.time_constant": ("s", "ms", "valve.time_constant=1 ms..9 ms"),
}


def made_up(count=400, lost=0.1, inputs=5, metrics=Metrics._fields):
    """A sweep in which mass makes the angle's error, and the gain that of the stiffness."""
    random = np.random.default_rng(0)
    mass, gain = random.uniform(0.2, 1.0, count), 1e5 * 10 ** random.uniform(0, 2, count)
    after, angle = random.choice([15.0, 17.0], count), random.uniform(-5, 5, count) * deg
    columns = (mass, gain, after, angle, random.uniform(1e-3, 9e-3, count))
    codes = np.where(random.random(count) < lost, OUTCOMES.index(Outcome.DIVERGED), 0).astype(np.int8)
    codes[random.random(count) < lost / 3] = OUTCOMES.index(Outcome.NO_START)
    answers = {name: random.random(count) for name in metrics}
    made = {"angle_rmse": mass**3 * deg, "stiffness_rmse": 1e7 / gain + 0.01 * random.random(count)}
    answers |= {name: values for name, values in made.items() if name in metrics}
    for name, values in answers.items():
        values[(codes != 0) | ((name == "stiffness_settling") & (random.random(count) < 0.3))] = np.nan
    table = {}
    for (name, (unit, shown, text)), values in list(zip(INPUTS.items(), columns, strict=True))[:inputs]:
        table[name] = "run", values, {"units": unit, "shown_units": shown, "over": text, "role": "input"}
    table |= {name: ("run", values) for name, values in (answers | {"outcome": codes}).items()}
    steps = {"substeps": 2, "error_estimate": 1e-9, "chaotic": np.int8(0)}
    table |= {name: ("run", np.full(count, value)) for name, value in steps.items()}
    return SweepResult(xr.Dataset(table, attrs={"title": "made up"}), Scenario.read(EXAMPLE))


def tables(swept):
    return {listing.title.split(",")[0]: listing for listing in swept.listings()}


@pytest.mark.slow
def test_the_statistics_are_those_of_numpy():
    swept = made_up()
    codes = swept["outcome"]
    outcomes = tables(swept)["Outcomes"].columns
    assert list(outcomes["runs"][1]) == [np.sum(codes == code) for code in sorted(set(codes))]
    rows = {row[0]: row for row in swept.statistics()}
    assert len(rows) == len(METRICS)
    for metric, unit, scale in METRICS.values():
        values = swept[metric] / scale
        _, shown, median, low, high, worst, run, count = rows[metric.replace("_", " ")]
        assert shown == unit
        assert (median, low, high) == pytest.approx(np.nanpercentile(values, (50, 5, 95)))
        assert (worst, run, count) == (np.nanmax(values), np.nanargmax(values), np.isfinite(values).sum())
    assert json.loads(to_json(swept.to_dict()))["verdict"] == swept.verdict()


def test_numbers_of_failed_runs_count_for_nothing():
    swept = made_up()
    lively = swept.table.copy()
    for name in Metrics._fields:
        lively[name] = ("run", np.where(swept.failed, 1e9, swept[name]))
    assert SweepResult(lively, swept.nominal).to_dict() == swept.to_dict()


def test_what_matters_comes_first():
    """With mean ranks for ties, as SciPy has them."""
    swept = made_up()
    ranks, good = swept.correlations(), ~swept.failed
    assert ranks.shape == (5, 1 + 3)
    for name in INPUTS:
        expected = scipy.stats.spearmanr(swept[name][good], swept["angle_rmse"][good]).statistic
        assert ranks.loc[name, "angle_rmse"] == pytest.approx(expected, abs=1e-12)
    assert ranks.loc["load.mass2", "angle_rmse"] == pytest.approx(1)
    assert ranks.loc["controller.position.kp", "stiffness_rmse"] == pytest.approx(-1, abs=1e-3)
    rows = tables(swept)["Rank correlations"].columns
    sizes = [abs(rank) for rank in rows["Spearman"][1]]
    assert sizes == sorted(sizes, reverse=True) and len(sizes) == 10


@pytest.mark.parametrize("count", [1, 2, 40])
def test_all_runs_failed(count):
    swept = made_up(count, lost=1.1)
    assert swept.statistics() == [] and swept.main_metrics == ()
    assert sum(tables(swept)["Outcomes"].columns["runs"][1]) == count
    assert f"{count} of them failed" in swept.verdict()
    swept.to_text(), to_json(swept.to_dict())


@pytest.mark.slow
def test_a_robot_is_swept_with_the_metrics_of_each_joint(tmp_path):
    """They are those of the single runs, also of a study that is continued."""
    text = (EXAMPLE.parent / "robot" / "lei-leg-control.yaml").read_text(encoding="utf-8")
    text = re.sub(r"  (side|muscles):\n(    .*\n)+|  friction.*\n", "", text).replace("lei-leg", "lei-leg-planar")
    leg = RobotScenario.parse(text).replace(duration=0.2)
    over = ["robot.bodies.1.mass=0.4 kg..0.6 kg", "controller.minimum_tension=5..8 N"]
    swept = sweep(leg, over, samples=3, out=tmp_path / "leg")
    assert swept.metrics[:2] == ("angle_rmse.hip", "angle_rmse.knee")
    for run in range(3):
        alone = swept.scenario(run).run_once().metrics
        for number, joint in enumerate(leg.joint_names):
            for name in ("angle_rmse", "stiffness_rmse"):
                assert swept[f"{name}.{joint}"][run] == pytest.approx(alone[name][number], rel=1e-6)
        assert swept["air"][run] == pytest.approx(alone["air"], rel=1e-6)
    again = sweep(leg, out=tmp_path / "leg", resume=True)
    assert again.computed == 0 and again.table.identical(swept.table)
    assert swept.plot().axes
