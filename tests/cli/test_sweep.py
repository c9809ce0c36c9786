"""mckibben sweep, as people type it; and what is left when it is interrupted or killed."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mckibben.scenario import Scenario, list_parameters
from mckibben.simulation.metrics import METRICS
from mckibben.storage.journal import HEADER, JournalReader
from mckibben.study.sweep import SweepResult

HOLDING = """
import signal, time
from pathlib import Path
from mckibben.study.sweep.sweep import SweepStore

keep, kept, interrupted = SweepStore.keep, [], []

def slowly(store, block, columns):  # the third block is kept; then nothing goes on but an interruption
    keep(store, block, columns)
    kept.append(block)
    if len(kept) >= 3:
        Path("holding").touch()
        while not interrupted:  # no lock, which the handler could wait for in the same thread
            time.sleep(0.01)
        time.sleep(0.3)

def interrupt(*_):
    interrupted.append(True)
    raise KeyboardInterrupt

SweepStore.keep = slowly
signal.signal(signal.SIGINT, interrupt)
from mckibben.cli import main
main()
"""
MASS = ("--over", "load.mass2=0.2 kg..1.0 kg")


@pytest.fixture
def scenario(tmp_path, shortened) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_sweep_from_beginning_to_end(cli, scenario, tmp_path, each_progress):
    asked = (*MASS, "--over", "start.stiffness=12 N*m/rad, 30 N*m/rad", "--samples", "40", "--seed", "1")
    found = cli("sweep", "s.yaml", *asked, "--out", "kept")
    assert found.code == 0
    kept = tmp_path / "kept"
    assert {path.name for path in kept.iterdir()} == {
        *("sweep.journal", "sweep.nc", "results.json", "sweep.png", "sweep.svg")
    }
    swept = SweepResult.from_netcdf(kept / "sweep.nc")
    assert (swept.count, swept.table.attrs["source"]) == (40, "s.yaml")
    assert swept.failed.sum() == 20
    numbers = json.loads((kept / "results.json").read_text(encoding="utf-8"))
    assert numbers["outcomes"] == {"completed": 20, "no_start": 20}
    assert set(numbers["metrics"]) == set(METRICS)
    assert re.search(r"20 +50\.0% +completed", found.out)
    assert re.search(r"20 +50\.0% +not run: no pressures", found.out)
    for name, (metric, unit, size) in METRICS.items():
        values = swept.table[metric].to_numpy()[~swept.failed] / size
        if np.isfinite(values).any():
            median = f"{np.nanmedian(values):.4g}"
            assert numbers["metrics"][name]["median"] == pytest.approx(np.nanmedian(values), rel=1e-12)
            assert re.search(rf"{metric.replace('_', ' ')} +{re.escape(unit)} +{re.escape(median)} ", found.out), name
    assert re.search(r"start\.stiffness +failed +\+1\.00", found.out)
    assert "all references are statically feasible" in found.out
    assert found.out.rstrip().endswith("wrote sweep.nc, results.json, sweep.png and sweep.svg to kept")
    assert "40 of 40 runs" in found.err

    again = cli("sweep", "s.yaml", "--resume", "--out", "kept")
    assert again.code == 0
    assert again.out.startswith("the sweep in kept is already complete")
    assert again.out.splitlines()[1:] == found.out.splitlines()
    assert again.err == ""
    as_json = cli("sweep", "s.yaml", "--resume", "--out", "kept", "--json")
    assert (as_json.code, json.loads(as_json.out)) == (0, numbers)
    before = (kept / "sweep.nc").read_bytes()
    refused = cli("sweep", "s.yaml", *asked, "--out", "kept")
    assert (refused.code, refused.out) == (2, "")
    assert "a sweep already exists; continue it with --resume" in refused.err
    refused = cli("sweep", "s.yaml", "--resume", "--seed", "2", "--out", "kept")
    assert refused.code == 2
    assert "seed: the sweep was started with 1, not 2" in refused.err
    assert (kept / "sweep.nc").read_bytes() == before


@pytest.mark.slow
def test_json_alone_goes_to_standard_output_and_nothing_is_shown_on_the_way(cli, scenario):
    asked = ("--over", "load.mass2=0.4 kg, 0.6 kg", "--design", "grid", "--metrics", "angle_rmse,force_max_N")
    found = cli("sweep", "s.yaml", *asked, "--precision", "32", "--out", "kept", "--json")
    assert found.code == 0
    numbers = json.loads(found.out)
    assert set(numbers["metrics"]) == {"angle_rmse_deg", "force_max_N"}
    assert (numbers["runs"], numbers["metrics"]["angle_rmse_deg"]["runs"]) == (2, 2)
    assert found.err == "wrote sweep.nc, results.json, sweep.png and sweep.svg to kept\n"


def test_the_list_of_what_can_be_varied(cli, scenario):
    found = cli("sweep", "s.yaml", "--list")
    assert (found.code, found.err) == (0, "")
    known = list_parameters(Scenario.read(scenario))
    for address in known:
        nominal = "-" if address.nominal is None else re.escape(address.show(address.nominal))
        assert re.search(rf"{re.escape(address.name)} +{nominal} +.*{re.escape(address.shown)}", found.out), address
    listed = json.loads(cli("sweep", "s.yaml", "--list", "--json").out)
    assert [each["name"] for each in listed] == [address.name for address in known]
    assert next(each for each in listed if each["name"] == "joint.geometry.joint_length") == {
        "name": "joint.geometry.joint_length",
        "nominal": "370 mm",
        "range": "above 0 to 10000 mm",
        "unit": "mm",
        "nominal_SI": 0.37,
        "unit_SI": "m",
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["s.yaml", *MASS], "--out DIR"),
        (["s.yaml", "--out", "x"], "nothing is varied; give a parameter"),
        (["s.yaml", "--out", "x", "--over", "load.mas2=1..2 kg"], "did you mean 'load.mass2'?"),
        (["s.yaml", "--out", "x", "--over", "load.mass2=2..1 kg"], "the range is empty: 2 kg is not below 1 kg"),
        (["s.yaml", "--out", "x", "--over", "load.mass2=1..2..3 kg"], "give a range (0.2 kg..1.0 kg), values (1 kg"),
        (
            ["s.yaml", "--out", "x", *MASS, "--over", "load.mass2=1..2 kg"],
            "'load.mass2=0.2 kg..1.0 kg' and 'load.mass2=1..2 kg' are about the same parameter; keep one of them",
        ),
        (["s.yaml", "--out", "x", "--over", "load.mass2=1..2 N"], "use a unit such as kg"),
        (["s.yaml", "--out", "x", "--over", "load.mass2=1..2"], "has no unit; write it like '2 kg'"),
        (["s.yaml", "--out", "x", *MASS, "--samples", "0"], "samples is 0; choose a whole number"),
        (
            ["s.yaml", "--out", "x", *MASS, "--known", "load.mass2"],
            "does not take load.mass2 from the plant; leave it out",
        ),
        (["s.yaml", "--out", "x", *MASS, "--design", "girdle"], "choose sobol, random or grid"),
        (["s.yaml", "--out", "x", *MASS, "--design", "grid", "--samples", "3"], "leave the number of samples out"),
        (["s.yaml", "--out", "x", *MASS, "--metrics", "angel_rmse"], "did you mean 'angle_rmse'?"),
        (["s.yaml", "--out", "x", *MASS, "--precision", "16"], "choose 64 or 32"),
        (["s.yaml", "--out", "x", *MASS, "--dask", "localhost"], "give local, or an address like tcp://host:8786"),
        (["s.yaml", "--out", "x", "--resume"], "there is no sweep to continue (sweep.journal)"),
        (["s.yaml", "--out", "s.yaml", *MASS], "it is a file; give a folder"),
        (["s.yaml", "--out", "/proc/x", *MASS], "/proc/x: 1 problem\n  it cannot be made"),
        (["nowhere.yaml", "--out", "x", *MASS], "nowhere.yaml: 1 problem"),
        (["nowhere.yaml", "--list"], "nowhere.yaml: 1 problem"),
    ],
)
def test_mistakes(cli, scenario, tmp_path, arguments, said):
    found = cli("sweep", *arguments)
    assert (found.code, found.out) == (2, "")
    assert found.err.startswith("error: ")
    assert said in found.err
    assert "Traceback" not in found.err
    assert [path.name for path in tmp_path.iterdir()] == ["s.yaml"], "a folder is in the way of the next try"


def test_ctrl_c_in_the_middle_says_how_to_go_on(cli, scenario, monkeypatch):
    import mckibben.study.sweep as package

    def interrupted(*_, **__):
        raise package.InterruptedSweep("512 of 1024 runs are kept in kept; continue with --resume")

    monkeypatch.setattr(package, "sweep", interrupted)
    found = cli("sweep", "s.yaml", *MASS, "--out", "kept")
    assert (found.code, found.out) == (130, "")
    assert found.err == "interrupted: 512 of 1024 runs are kept in kept; continue with --resume\n"


@pytest.mark.slow
def test_an_interrupted_and_then_killed_sweep_ends_with_the_same_bytes(cli, scenario, tmp_path):
    asked = (*MASS, "--samples", "512", "--metrics", "angle_rmse")
    path = tmp_path / "kept" / "sweep.journal"

    def stopped(sent: signal.Signals, *arguments: str) -> tuple[int, str, int]:
        """Run until three more blocks are there, then send a signal: exit code, what was said, blocks."""
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDING, "sweep", "s.yaml", *arguments, "--out", "kept"],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        while process.poll() is None and not (tmp_path / "holding").exists():
            time.sleep(0.01)
        process.send_signal(sent)
        _, said = process.communicate(timeout=100)
        (tmp_path / "holding").unlink()
        return process.returncode, said, sum(record.kind != HEADER for record in JournalReader(path))

    code, said, first = stopped(signal.SIGINT, *asked)
    assert code == 130, said
    assert f"interrupted: {32 * first} of 512 runs are kept in kept; continue with --resume" in said
    assert "Traceback" not in said
    assert 3 <= first < 12
    code, said, second = stopped(signal.SIGKILL, "--resume")
    assert code == -signal.SIGKILL, said
    assert first + 3 <= second < 16
    assert not (tmp_path / "kept" / "sweep.nc").exists()
    assert cli("sweep", "s.yaml", "--resume", "--out", "kept").code == 0
    assert cli("sweep", "s.yaml", *asked, "--out", "undisturbed").code == 0
    tables = [(tmp_path / name / "sweep.nc").read_bytes() for name in ("kept", "undisturbed")]
    assert tables[0] == tables[1]


@pytest.mark.parametrize("name", ["results.json", "sweep.svg", "sweep.nc"])
def test_files_that_others_put_there_stay(cli, scenario, tmp_path, name):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / name).write_text("mine", encoding="utf-8")
    found = cli("sweep", "s.yaml", *MASS, "--out", "kept")
    assert (found.code, found.out) == (2, "")
    assert f"{name}: it already exists; choose another folder, or move the existing file" in found.err
    assert [(path.name, path.read_text(encoding="utf-8")) for path in (tmp_path / "kept").iterdir()] == [(name, "mine")]
