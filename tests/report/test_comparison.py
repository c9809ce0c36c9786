"""The figures of a comparison: one colour a controller, and numbers of NumPy."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.report.comparison import comparison_errors, comparison_front
from mckibben.simulation import Batch, Metrics, Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.compare import CompareResult, Suite, draw
from mckibben.study.tune.trials import Trial
from mckibben.units import deg

pytestmark = pytest.mark.slow


TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
RUNS = 16


def made(lost=None):
    """Three controllers, the second better by a decade, the third with the lost runs."""
    suite = Suite.parse(TEXT)
    runs = draw(suite, RUNS, 1)
    rng = np.random.default_rng(2)
    flags = {"flag_values": np.arange(len(OUTCOMES)), "flag_meanings": " ".join(each.name for each in OUTCOMES)}
    batches = {}
    for name, scale in (("PID 3", 1.0), ("decoupling", 0.1), ("as it is", 0.5)):
        table = {metric: ("run", scale * rng.lognormal(size=RUNS)) for metric in Metrics._fields}
        codes = np.zeros(RUNS, int)
        if name == "as it is" and lost is not None:
            codes[list(lost)] = OUTCOMES.index(Outcome.SWUNG_OVER)
        batches[name] = Batch(xr.Dataset({**table, "outcome": ("run", codes, flags)}))
    tuned = {name: {each.name: each.parameter.nominal for each in suite.tuned_over(name)} for name in batches}
    costs = {"PID 3": (1.25, 20.5), "decoupling": (0.5, 0.6)}
    metrics = [{"air": air * 1e-3, "angle_rmse": 1 / air * deg, "stiffness_rmse": 0.6} for air in (10.0, 20.0, 40.0)]
    tried = {name: tuple(Trial((at["air"],), 1.0, metrics=at) for at in metrics) for name in ("PID 3", "decoupling")}
    at_bound = dict.fromkeys(batches, ())
    at_air = CompareResult(suite, runs, tuned, {}, {}, {name: batches[name] for name in tried})
    return CompareResult(suite, runs, tuned, costs, at_bound, batches, tried, at_air)


@pytest.fixture(scope="module")
def result():
    return made([3, 7])


def test_a_front_is_drawn_for_each_controller_that_was_tuned(result):
    (axes,) = comparison_front(result).axes
    assert [line.get_label() for line in axes.lines] == ["PID 3", "decoupling"]
    for line in axes.lines:
        np.testing.assert_allclose(line.get_xdata(), [10.0, 20.0, 40.0])
        np.testing.assert_allclose(line.get_ydata(), [0.1, 0.05, 0.025])


def test_a_controller_has_one_colour_in_all_figures(result):
    assert result.order != list(result.batches), "else there is nothing to see"
    lines = [line for figure in (comparison_errors(result), comparison_front(result)) for line in figure.axes[-1].lines]
    colours = [{line.get_color() for line in lines if line.get_label() == name} for name in result.batches]
    assert [len(colour) for colour in colours] == [1, 1, 1] and len(set.union(*colours)) == 3


def test_errors_are_distributions(result):
    """Of the controller that lost 2 of 16 runs the line ends at 14/16."""
    angle, stiffness = comparison_errors(result).axes
    for axes, metric, unit in ((angle, "angle_rmse", deg), (stiffness, "stiffness_rmse", 1.0)):
        lines = {line.get_label(): line for line in axes.lines}
        for name in result.batches:
            values, share = lines[name].get_data()
            finite = np.isfinite(values)
            expected = np.sort(result.metric(name, metric) / unit)
            expected = expected[np.isfinite(expected)]
            assert np.allclose(values[finite], [expected[0], *expected])
            assert np.allclose(share[finite], np.arange(expected.size + 1) / 16)
    assert lines["as it is"].get_ydata()[finite][-1] == 14 / 16
