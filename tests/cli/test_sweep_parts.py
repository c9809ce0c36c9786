"""mckibben sweep --part and mckibben merge, as people type them."""

import json
import shutil

import pytest

from mckibben.scenario import Scenario
from mckibben.study.sweep import SweepResult, summary, sweep

OVER = "load.mass2=0.2 kg..1.0 kg"
ASKED = ("s.yaml", "--over", OVER, "--samples", "48", "--metrics", "angle_rmse")


@pytest.fixture(scope="module")
def kept(tmp_path_factory, shortened):
    """A scenario, the undivided sweep of it, the halves of this one, and a half of another."""
    folder = tmp_path_factory.mktemp("parts")
    (folder / "s.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    scenario = Scenario.read(folder / "s.yaml")
    for name, part, seed in (("whole", None, 0), ("1", "1/2", 0), ("2", "2/2", 0), ("other", "2/2", 1)):
        asked = {"samples": 48, "metrics": ["angle_rmse"], "source": "s.yaml"}
        sweep(scenario, [OVER], out=folder / name, part=part, seed=seed, **asked)
    return folder


@pytest.fixture
def here(kept, tmp_path, cli):
    """The working folder of the command, with all of them."""
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.slow
def test_parts_and_their_merging_from_beginning_to_end(cli, here):
    assert cli("sweep", *ASKED, "--out", "undivided").code == 0
    for part in ("1", "2"):
        assert cli("sweep", *ASKED, "--part", f"{part}/2", "--out", f"half-{part}").code == 0
    assert cli("merge", "half-2", "half-1", "--out", "merged").code == 0
    for name in ("sweep.nc", "results.json"):
        assert (here / "merged" / name).read_bytes() == (here / "undivided" / name).read_bytes()


@pytest.mark.slow
def test_a_part_goes_on_as_that_part(cli, here):
    (here / "2" / "sweep.nc").unlink()
    assert cli("sweep", "s.yaml", "--resume", "--part", "1/2", "--out", "2").code == 2
    assert not (here / "2" / "sweep.nc").exists()
    assert cli("sweep", "s.yaml", "--resume", "--out", "2").code == 0
    assert SweepResult.from_netcdf(here / "2" / "sweep.nc").first == 16


@pytest.mark.slow
def test_merged_parts_are_the_undivided_sweep(cli, here):
    found = cli("merge", "1", "2", "--out", "merged", "--json")
    whole = SweepResult.from_netcdf(here / "whole" / "sweep.nc")
    assert (found.code, json.loads(found.out)) == (0, summary(whole))
    assert {path.name for path in (here / "merged").iterdir()} == {"sweep.nc", "results.json"}
    assert (here / "merged" / "sweep.nc").read_bytes() == (here / "whole" / "sweep.nc").read_bytes()
    assert "48 runs" in cli("merge", "2", "1", "--out", "shown").out


def test_a_merge_that_was_killed_before_its_statistics_goes_on(cli, here):
    assert cli("merge", "1", "2", "--out", "merged").code == 0
    table, statistics = here / "merged" / "sweep.nc", here / "merged" / "results.json"
    before, expected = table.stat(), statistics.read_bytes()
    statistics.unlink()
    assert cli("merge", "1", "2", "--out", "merged").code == 0
    assert statistics.read_bytes() == expected
    assert table.stat().st_mtime_ns == before.st_mtime_ns


@pytest.mark.parametrize(
    ("given", "source", "field"),
    [
        (["1", "--out", "merged"], "1", "part"),
        (["1", "2", "1", "--out", "merged"], "1", "part"),
        (["1", "other", "--out", "merged"], "other", "seed"),
        (["1", "whole", "--out", "merged"], "whole", "part"),
        (["1", "unfinished", "--out", "merged"], "unfinished", "sweep.nc"),
        (["1", "2", "--out", "other"], "other", "sweep.nc"),
        (["1", "2", "--out", "mine"], "mine", "results.json"),
        (["1", "2"], "", "--out DIR"),
    ],
)
def test_what_cannot_be_merged(cli, here, given, source, field):
    (here / "mine").mkdir()
    (here / "mine" / "results.json").write_text("mine", encoding="utf-8")
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    found = cli("merge", *given)
    assert (found.code, found.out) == (2, "")
    assert found.err.startswith(f"error: {source}") and field in found.err and ";" in found.err
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("part", ["3/2", "0/2", "1/0", "0/0", "x", "1/9", "-1/2"])
def test_what_is_no_part_is_refused_with_a_remedy(cli, here, part):
    found = cli("sweep", *ASKED, f"--part={part}", "--out", "new")
    assert (found.code, found.out) == (2, "")
    assert found.err.startswith("error: ") and ";" in found.err
    assert not (here / "new").exists()
