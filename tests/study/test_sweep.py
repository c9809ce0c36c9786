"""Sweeps in Python: the numbers are those of single runs, whoever computes them, however often they are interrupted."""

import json
import signal
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
import xarray as xr

from mckibben.codegen.native import compiler
from mckibben.errors import FileError, ParameterError, SimulationError
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import Outcome
from mckibben.simulation.metrics import USUAL_METRICS
from mckibben.simulation.software import software
from mckibben.storage.store import STUDY, open_store, read_store
from mckibben.study.sweep import Sweep, sweep
from mckibben.study.sweep.sweep import _sizes

sweep_module = sys.modules[Sweep.__module__]
ROOT = Path(__file__).parents[2]
OVER = ("load.mass2=0.2 kg..1.0 kg", "reference.stiffness.after=15..22 N*m/rad", "controller.position.kp=+-50 %")
SOME = {"samples": 72, "seed": 1}


@pytest.fixture(scope="module")
def scenario():
    text = (ROOT / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
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
        ({"mckibben.simulation.engine.compiler": lambda: None}, {"software engine", "software compiler"}, "not xla"),
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


def test_a_cluster_that_does_not_answer(scenario, monkeypatch, tmp_path):
    distributed = pytest.importorskip("distributed")

    def failing(*_, **__):
        raise OSError("Timed out trying to connect")

    monkeypatch.setattr(distributed, "Client", failing)
    with pytest.raises(SimulationError, match=r"no answer of the cluster tcp://.* \(Timed out") as caught:
        sweep(scenario, OVER, dask="tcp://127.0.0.1:1", out=tmp_path)
    assert "--resume" in caught.value.remedy


def test_the_program_depends_on_nothing_but_the_number_of_runs(monkeypatch):
    assert _sizes(72) == (16, 16)
    assert _sizes(20_000) == (256, 256)
    lanes, block = _sizes(1_000_000)
    assert (lanes, block % lanes) == (256, 0)
    assert block <= 64 * 256
    assert _sizes(20_000, "cuda") == (10_000, 10_000)
    monkeypatch.setattr(sweep_module.jax, "default_backend", lambda: "gpu")
    assert _sizes(20_000) == (10_000, 10_000)


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
