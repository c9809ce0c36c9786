"""A study of its own class: rows in, records out, for any number of threads, blocks and interruptions."""

import numpy as np
import pytest

from mckibben.errors import FileError, SimulationError
from mckibben.scenario import Scenario
from mckibben.study.scenarios import ScenarioStudy
from mckibben.study.study import InterruptedStudy, Study


class Draws(Study):
    """Squares of draws; counts what it computes."""

    unit = "draws"

    def __init__(self, count=100, seed=3, block=7, fail_at=None):
        self.count, self.seed, self.block, self.fail_at, self.computed = count, seed, block, fail_at, 0

    def about(self):
        return {"format": "draws", "count": self.count, "seed": self.seed, "block": self.block}

    def rows(self):
        return {"x": np.random.default_rng(self.seed).normal(size=self.count)}

    def block_size(self):
        return self.block

    def compute(self, rows):
        if self.fail_at is not None and self.computed >= self.fail_at:
            raise KeyboardInterrupt
        self.computed += len(rows["x"])
        return {"square": rows["x"] ** 2, "sign": np.sign(rows["x"]).astype(np.int8)}


@pytest.mark.parametrize("block", [1, 7, 100, 1000])
@pytest.mark.parametrize("workers", [1, 3])
def test_records_are_those_of_the_rows(block, workers):
    records = Draws(block=block).run(workers=workers)
    np.testing.assert_array_equal(records.columns["square"], Draws().rows()["x"] ** 2)
    assert records.columns["sign"].dtype == np.int8 and records.computed == 100


def test_an_interrupted_study_goes_on(tmp_path):
    with pytest.raises(InterruptedStudy, match="of 100 draws are kept; continue with --resume"):
        Draws(fail_at=21).run(tmp_path, workers=1)
    study, steps = Draws(), []
    records = study.run(tmp_path, resume=True, progress=lambda *step: steps.append(step))
    assert study.computed == records.computed < 100
    assert steps[0][0] == f"{100 - records.computed} of 100 draws" and steps[0][1] == pytest.approx(
        1 - records.computed / 100
    )
    np.testing.assert_array_equal(records.columns["square"], Draws().run().columns["square"])
    assert Draws().run(tmp_path, resume=True).computed == 0


def test_records_of_another_length_or_of_another_version_are_refused(tmp_path):
    class Short(Draws):
        def compute(self, rows):
            return {"square": rows["x"][:1] ** 2}

    class Renamed(Draws):
        def compute(self, rows):
            return {"root": np.abs(rows["x"]) ** 0.5}

    with pytest.raises(SimulationError, match="'square' of shape"):
        Short().run()
    with pytest.raises(InterruptedStudy):
        Draws(fail_at=21).run(tmp_path, workers=1)
    with pytest.raises(SimulationError, match="kept"):
        Renamed().run(tmp_path, resume=True)


class Gravity(ScenarioStudy):
    """Stiffness of gravity [N*m/rad] at 0 deg."""

    def compute(self, rows):
        return {"gravity": np.asarray(self.scenarios(rows).plant().load.gravity_stiffness(0.0))}


def test_a_study_over_parameters_is_one_method_and_continues_with_its_own_options(tmp_path):
    scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    records = Gravity.carry_out(scenario, ["load.mass2=0.2 kg..0.8 kg"], samples=9, seed=3, out=tmp_path)
    line = np.polyfit(records.rows["load.mass2"], records.columns["gravity"], 1)
    assert records.computed == 9 and np.ptp(records.columns["gravity"]) > 0
    assert np.polyval(line, 0.5) == pytest.approx(float(scenario.load.gravity_stiffness(0.0)))
    again = Gravity.carry_out(scenario, out=tmp_path, resume=True)
    assert again.computed == 0
    np.testing.assert_array_equal(again.rows["load.mass2"], records.rows["load.mass2"])
    with pytest.raises(FileError, match="samples: the study was started with 9, not 8"):
        Gravity.carry_out(scenario, samples=8, out=tmp_path, resume=True)
