"""Parts of a sweep, computed apart and merged, are the undivided sweep."""

import errno
import json
import os
import shutil

import numpy as np
import pytest

from mckibben.errors import FileError, ParameterError
from mckibben.scenario import Scenario
from mckibben.study.parameters import parse_sweeps, sample
from mckibben.study.parameters.sampling import MAX_TOTAL
from mckibben.study.sweep import SweepResult, merge, summary, sweep
from mckibben.study.sweep.plan import SweepOptions, SweepPlan
from mckibben.study.sweep.sweep import TABLE

OVER = ("load.mass2=0.2 kg..1.0 kg", "controller.position.kp=0.5..10 bar/rad log")
SOME = {"samples": 88, "seed": 1, "block": 16, "metrics": ["angle_rmse"]}
PARTS = 3


@pytest.fixture(scope="module")
def scenario():
    return Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.1})


@pytest.fixture(scope="module")
def kept(scenario, tmp_path_factory):
    """A folder with the undivided sweep and its parts."""
    folder = tmp_path_factory.mktemp("parts")
    sweep(scenario, OVER, out=folder / "whole", **SOME)
    for number in range(1, PARTS + 1):
        sweep(scenario, OVER, out=folder / f"{number}", part=f"{number}/{PARTS}", **SOME)
    return folder


def parts_of(folder, *numbers):
    return [folder / f"{number}" for number in numbers]


@pytest.mark.slow
@pytest.mark.parametrize("order", [(1, 2, 3), (3, 1, 2)])
def test_merged_parts_are_the_undivided_sweep_byte_for_byte(kept, tmp_path, order):
    merged = merge(parts_of(kept, *order), tmp_path / "merged")
    assert (tmp_path / "merged" / TABLE).read_bytes() == (kept / "whole" / TABLE).read_bytes()
    whole = SweepResult.from_netcdf(kept / "whole" / TABLE)
    assert summary(merged) == summary(whole)
    assert merged.table.load().identical(whole.table)


@pytest.mark.slow
def test_a_part_is_rows_of_the_undivided_sweep(kept):
    whole, first = SweepResult.from_netcdf(kept / "whole" / TABLE), 0
    for folder in parts_of(kept, 1, 2, 3):
        part = SweepResult.from_netcdf(folder / TABLE)
        assert part.first == first
        for name, column in part.table.items():
            np.testing.assert_array_equal(column, whole.table[name][first : first + part.count])
        assert part.scenario(first) == whole.scenario(first)
        worst = summary(part)["metrics"]["angle_rmse_deg"]["worst_run"]
        angles = whole.table["angle_rmse"].to_numpy()
        assert worst == first + np.argmax(angles[first : first + part.count])
        first += part.count
    assert first == 88
    with pytest.raises(ParameterError):
        part.scenario(0)


def test_an_interrupted_part_goes_on_as_that_part(kept, scenario, tmp_path):
    shutil.copytree(kept / "2", tmp_path / "2")
    (tmp_path / "2" / TABLE).unlink()
    swept = sweep(scenario, out=tmp_path / "2", resume=True)
    assert (tmp_path / "2" / TABLE).read_bytes() == (kept / "2" / TABLE).read_bytes() and swept.first == 32
    with pytest.raises(FileError) as caught:
        sweep(scenario, out=tmp_path / "2", resume=True, part="3/3")
    assert "part" in [problem.field for problem in caught.value.problems]


@pytest.mark.parametrize(("numbers", "value"), [((1, 3), [2]), ((2,), [1, 3]), ((1, 2, 3, 2), 2), ((1, 1), 1)])
def test_missing_and_repeated_parts_are_named(kept, tmp_path, numbers, value):
    with pytest.raises(FileError) as caught:
        merge(parts_of(kept, *numbers), tmp_path / "merged")
    (problem,) = caught.value.problems
    assert (problem.field, problem.value) == ("part", value)
    assert not (tmp_path / "merged").exists()


def test_parts_of_another_sweep_or_division_are_named(kept, scenario, tmp_path):
    sweep(scenario, OVER, out=tmp_path / "seed", part="2/3", **SOME | {"seed": 2})
    sweep(scenario, OVER, out=tmp_path / "halves", part="2/2", **SOME)
    for folder, field in (("seed", "seed"), ("halves", "part")):
        with pytest.raises(FileError) as caught:
            merge([*parts_of(kept, 1), tmp_path / folder, *parts_of(kept, 3)], tmp_path / "merged")
        assert caught.value.source == str(tmp_path / folder)
        assert field in [problem.field for problem in caught.value.problems]


def test_unfinished_and_damaged_parts_are_named(kept, tmp_path):
    shutil.copytree(kept / "2", tmp_path / "2")
    path = tmp_path / "2" / TABLE
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    folders = [kept / "1", tmp_path / "2", kept / "3"]
    with pytest.raises(FileError) as caught:
        merge(folders, tmp_path / "merged")
    assert caught.value.source == str(path)
    path.unlink()
    with pytest.raises(FileError) as caught:
        merge(folders, tmp_path / "merged")
    assert caught.value.source == str(tmp_path / "2")
    assert not (tmp_path / "merged").exists()


def test_a_table_is_not_overwritten_and_a_full_disk_leaves_none(kept, tmp_path, monkeypatch):
    (tmp_path / TABLE).write_bytes(b"mine")
    with pytest.raises(FileError):
        merge(parts_of(kept, 1, 2, 3), tmp_path)
    assert (tmp_path / TABLE).read_bytes() == b"mine"

    def full(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("mckibben.study.sweep.merging.append_seal", full)
    with pytest.raises(FileError):
        merge(parts_of(kept, 1, 2, 3), tmp_path / "merged")
    assert not list((tmp_path / "merged").iterdir())


@pytest.mark.parametrize("part", ["", "1", "0/3", "4/3", "1/0", "a/b", "1/7"])
def test_what_is_no_part_is_refused(scenario, tmp_path, part):
    with pytest.raises(ParameterError) as caught:
        sweep(scenario, OVER, out=tmp_path / "out", part=part, **SOME)
    assert caught.value.field == "part" and caught.value.remedy and not (tmp_path / "out").exists()


@pytest.mark.parametrize("method", ["sobol", "random", "grid"])
def test_rows_of_a_design_are_computed_alone(scenario, method):
    swept = parse_sweeps([f"{text} in 9" for text in OVER] if method == "grid" else OVER, scenario)
    whole = sample(swept, method, 81, 5)
    for start, stop in ((0, 81), (0, 7), (7, 64), (64, 81)):
        part = sample(swept, method, 81, 5, slice(start, stop))
        for name, column in whole.items():
            np.testing.assert_array_equal(part[name], column[start:stop])


@pytest.mark.slow
def test_the_limit_is_that_of_a_part(scenario):
    many = SweepOptions(OVER, samples=10**9, metrics=["angle_rmse"])
    plan = SweepPlan.of(scenario, many, part=(1000, 1000))
    assert plan.first + plan.rows == 10**9 and plan.rows < 10**7
    assert json.loads(json.dumps(plan.manifest))["samples"] == 10**9
    with pytest.raises(ParameterError):
        SweepPlan.of(scenario, many, part=(1, 10))
    with pytest.raises(ParameterError) as caught:
        SweepPlan.of(scenario, many._replace(samples=MAX_TOTAL + 1), part=(1, 1000))
    assert caught.value.upper == MAX_TOTAL
