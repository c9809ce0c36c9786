"""The paper's study as a whole: its numbers as JSON, its files, and that each run can be had again."""

import json

import numpy as np
import pytest

from mckibben import paper
from mckibben.dataset import IsobaricDataset
from mckibben.identification import Fit
from mckibben.paper import reproduction
from mckibben.paper.settings import SETTINGS, Wish
from mckibben.paper.tracking import BP, CONTROLLERS, PID, TUNED_BP, TUNED_PID
from mckibben.simulation import Result
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.running import run_scenario

NAMES = {
    f"{s.key.replace('_', '-')}-{w.value}-{c.lower().replace(',', '').replace(' ', '-')}"
    for s in SETTINGS
    for w in Wish
    for c in CONTROLLERS
}


@pytest.fixture(scope="module")
def results(reproduction):
    return reproduction.results()


@pytest.fixture(scope="module")
def folder(reproduction, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    reproduction.save(folder)
    return folder


def test_the_results_are_json_without_nan(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results


def test_the_results_have_every_number_of_the_report(results):
    assert set(results["identification"]) == {"virtual-rig", "dmsp-10-250-martens2017", "festo-tool-10mm"}
    for fit in results["identification"].values():
        for name in ("decay_per_percent", "rmse_N", "max_N", "leave_one_pressure_out_rmse_N"):
            assert fit[name] > 0
        assert set(fit["parameters"]) == {"a1", "a2", "b1", "b2", "c1", "c2", "decay"}
        assert all({"estimate", "standard_error", "unit"} <= set(p) for p in fit["parameters"].values())
    for law, by_pressure in results["validation"]["retest_rmse_N"].items():
        assert {"all", "loading", "2 bar", "3 bar", "4.5 bar", "6 bar", "6 bar, unloading"} <= set(by_pressure), law
    for setting in SETTINGS:
        low, high = results["joint"][setting.key]["attainable_stiffness_at_0_deg"]
        assert 0 < low < high
        for wish in Wish:
            runs = results["tracking"][setting.key][wish.value]
            assert set(runs) == set(CONTROLLERS)
            for run in runs.values():
                for name in ("angle_rmse_deg", "angle_max_deg", "stiffness_rmse"):
                    assert run[name] > 0
                assert run["stiffness_settling_s"] is None or run["stiffness_settling_s"] >= 0
    for claim in results["claims"]:
        assert set(claim) == {"claim", "source", "holds", "evidence", "of_paper"}


def test_the_numbers_of_a_run_are_those_of_its_trajectory(results, reproduction):
    """Worked out here, in degrees, from the table."""
    for setting in SETTINGS:
        for wish in Wish:
            table = reproduction.tracking.runs[setting.key, wish, PID].result
            shown = results["tracking"][setting.key][wish.value][PID]
            error = np.degrees(table["angle"] - table["desired_angle"])
            assert shown["angle_rmse_deg"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
            assert shown["angle_max_deg"] == pytest.approx(np.abs(error).max(), rel=1e-9)
            stiffness = table["stiffness"]
            off = stiffness - table["desired_stiffness"]
            assert shown["stiffness_rmse"] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
            start = 5000 if wish is Wish.STEP else 0
            band = 0.1 * abs(table["desired_stiffness"][-1] - stiffness[start])
            outside = np.flatnonzero(np.abs(off[start:]) > band)
            assert shown["stiffness_settling_s"] == pytest.approx((outside[-1] + 1) * 1e-3)


def test_saved_files_read_back(folder, results, reproduction):
    assert json.loads((folder / "results.json").read_text(encoding="utf-8")) == results
    for name, fit in reproduction.identification.fits.items():
        back = Fit.from_yaml(folder / "fits" / f"{name}.yaml")
        assert back.estimates == fit.estimates
        assert back.rmse == fit.rmse
    rig = reproduction.identification.rig
    for name, data in (("test", rig.test), ("retest", rig.retest)):
        back = IsobaricDataset.from_netcdf(folder / "data" / f"virtual-rig-{name}.nc")
        assert back.to_xarray().identical(data.to_xarray())
    assert {p.stem for p in (folder / "scenarios").iterdir()} == NAMES
    assert {p.stem for p in (folder / "trajectories").iterdir()} == NAMES
    assert not list(folder.rglob(".*.part"))


@pytest.mark.parametrize(
    "name",
    [
        f"as-printed-constant-{BP.lower()}",
        f"pre-contracted-step-{PID.lower()}",
        f"pre-contracted-constant-{TUNED_PID.lower().replace(' ', '-')}",
        f"as-printed-step-{TUNED_BP.lower().replace(' ', '-')}",
    ],
)
def test_a_scenario_run_alone_gives_its_trajectory_to_the_last_bit(folder, name):
    kept = Result.from_netcdf(folder / "trajectories" / f"{name}.nc")
    scenario = Scenario.read(folder / "scenarios" / f"{name}.yaml")
    again = run_scenario(scenario).result
    assert again.to_xarray().identical(kept.to_xarray().assign_attrs(scenario=again.scenario))
    assert Scenario.parse(kept.scenario) == scenario  # the trajectory carries what made it


def test_reproduce_puts_the_parts_together(monkeypatch, identification, joint_maps, tracking):
    asked = {}

    def part(name, answer):
        def run(**options):
            asked[name] = {k: v for k, v in options.items() if k != "progress"}
            if "progress" in options:
                options["progress"](0.5)
            return answer

        return run

    monkeypatch.setattr(reproduction, "run_identification", part("identification", identification))
    monkeypatch.setattr(reproduction, "run_joint", part("joint", joint_maps))
    monkeypatch.setattr(reproduction, "run_tracking", part("tracking", tracking))
    reported, generations = [], {}
    for quick, repeats, seeds in ((False, 5, 20), (True, 2, 5)):
        done = paper.reproduce(quick=quick, progress=lambda what, share: reported.append((share, what)))
        assert (done.identification, done.joint, done.tracking) == (identification, joint_maps, tracking)
        assert done.quick is quick
        assert len(done.claims) == 12
        assert asked["identification"] == {"repeats": repeats}
        assert asked["tracking"]["seeds"] == seeds
        generations[quick] = asked["tracking"]["generations"]
    assert 0 < generations[True] < generations[False]
    shares = [share for share, _ in reported]
    assert shares[: len(shares) // 2] == sorted(shares[: len(shares) // 2])
    assert all(0 <= share <= 1 for share in shares)
    assert all(what for _, what in reported)
    paper.reproduce(quick=True)  # and without anyone to report to


@pytest.mark.parametrize("as_json", [False, True])
def test_the_command_keeps_the_numbers_and_calls_the_report(monkeypatch, capsys, tmp_path, reproduction, as_json):
    import mckibben.report
    from mckibben.cli import app

    calls = []

    def write_report(done, out):
        assert (out / "results.json").exists()  # the numbers are safe before anything is drawn
        calls.append(done)
        return out / "report.html"

    monkeypatch.setattr(paper, "reproduce", lambda *, quick, progress: reproduction)
    monkeypatch.setattr(mckibben.report, "write_report", write_report)
    out = tmp_path / "deep" / "report"
    app(["reproduce", "--quick", "--out", str(out), *(["--json"] if as_json else [])], standalone_mode=False)
    printed = capsys.readouterr()
    assert calls == [reproduction]
    if as_json:
        assert json.loads(printed.out) == reproduction.results()
    else:
        assert printed.out.count("holds") + printed.out.count("does not") >= 12
        assert "results.json" in printed.out.replace("\n", "")
