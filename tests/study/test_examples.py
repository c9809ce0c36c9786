"""Our own examples cause no warnings: mckibben's warnings are errors in tests, also of all pages; fits list theirs."""

import runpy
from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben import read_dataset
from mckibben.control import Measurement
from mckibben.identification import fit_law
from mckibben.muscle import ExponentialLaw
from mckibben.scenario import Scenario, run_scenario

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALLER = {  # numbers of scripts that take long
    "plot_02_laws": {"mk.rank(data)": "mk.rank(data, [mk.ExponentialLaw, mk.ChouLaw])"},
    "plot_12_batch": {"duration=4.0": "duration=0.4"},
    "plot_17_landing": {"drop: [20 mm, 50 mm]": "drop: [50 mm]", "draws: 32": "draws: 20"},
}


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_scenario_starts_at_rest_and_runs_without_a_warning(path):
    scenario = Scenario.read(path)
    plant = scenario.plant()
    initial, setpoint = scenario.initial(plant), scenario.reference()(0.0)
    assert abs(float(plant.rate(initial).velocity)) < 1e-6 and float(setpoint.angle) == float(initial.angle)
    if True not in plant.joint.springs:  # else the angle determines it
        assert float(plant.joint.stiffness(initial.angle, initial.pressures)) == pytest.approx(scenario.start.stiffness)
    state = scenario.control().with_period(scenario.control_period).init(Measurement(initial.angle, initial.pressures))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
    result = run_scenario(scenario)
    assert result.ok != (path.stem == "as-printed-constant-pid")  # the paper's PID errs by 57 % of its sine


@pytest.mark.slow
def test_a_dataset_has_only_the_warning_of_its_friction():
    fit = fit_law(ExponentialLaw, read_dataset(EXAMPLES / "rig.csv"))
    assert [warning for warning in fit.warnings if "friction" not in warning] == []


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted((EXAMPLES / "gallery").glob("*.py")), ids=lambda path: path.stem)
def test_the_gallery_runs_without_a_warning(script, monkeypatch, tmp_path):
    text = script.read_text(encoding="utf-8")
    for old, new in SMALLER.get(script.stem, {}).items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / script.name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(script.parent)
    assert any(name.startswith("figure") for name in runpy.run_path(str(tmp_path / script.name)))
