"""The figure of loops shows what was measured and what was modelled, pressure by pressure."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.identification.friction import identify_hysteresis
from mckibben.muscle import ExponentialLaw, Muscle
from mckibben.report.identification import loops
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar, mm, percent

LAW = catalog.law("lei-mas-10-180n")


@pytest.fixture(scope="module")
def drawn():
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), LAW)
    protocol = IsobaricProtocol(pressures=np.arange(0, 8) * 0.75 * bar, step=3 * mm, repeats=1, samples=20)
    data = SimulatedIsobaricTest(muscle, force_drift=2.0).run(protocol, seed=1)
    found = identify_hysteresis(ExponentialLaw, data)
    return data, found, loops(data, found)


@pytest.mark.slow
def test_a_panel_for_each_of_up_to_six_pressures(drawn):
    _, _, figure = drawn
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert len(titles) == 7 and "force" in titles[0]
    assert "0 bar" in titles[1] and "5.25 bar" in titles[6]
    assert all("RMSE" in title for title in titles[1:])


@pytest.mark.slow
def test_points_are_the_measured_ones_without_law_and_drift(drawn):
    data, found, figure = drawn
    axes = figure.axes[6]
    here = np.isclose(data.levels, 5.25 * bar) & (found.tension > 0)
    loading = here & (data.table["direction"].to_numpy() == "loading")
    points = axes.lines[0]
    np.testing.assert_allclose(points.get_xdata(), data.contraction[loading] / percent)
    np.testing.assert_allclose(points.get_ydata(), (data.force - found.tension - found.offset)[loading], atol=1e-9)
    model = next(line for line in axes.lines[2:] if len(line.get_xdata()) == here.sum())
    np.testing.assert_allclose(np.sort(model.get_ydata()), np.sort(found.friction_force[here]))
    low, high = axes.get_ylim()
    assert low < -10 and high > 10


@pytest.mark.slow
def test_another_dataset_is_refused(drawn):
    data, found, _ = drawn
    with pytest.raises(RangeError, match="the dataset has 3"):
        loops(data.select(np.arange(len(data)) < 3), found)
