"""The figure of creep shows what was measured and what was modelled, after each direction."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.identification.creep import identify_creep
from mckibben.muscle import MaxwellCreep, Muscle, NoCreep
from mckibben.report.identification import relaxation
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar

PROTOCOL = IsobaricProtocol(pressures=[3 * bar, 5 * bar], repeats=1, samples=40, acquisition=5.0)


def drawn(creep):
    law = catalog.law("lei-mas-10-180n")
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law, creep=creep)
    data = SimulatedIsobaricTest(muscle, force_noise=0.05).run(PROTOCOL, seed=1)
    found = identify_creep(data, interval=0.125, dwell=PROTOCOL.dwell, speed=PROTOCOL.speed)
    return data, found, relaxation(data, found)


def test_measured_and_modelled_go_back_on_each_side():
    data, found, figure = drawn(MaxwellCreep(1000.0, 8.0))
    left, right = figure.axes
    assert (
        right.get_legend().get_title().get_text()
        == f"{found.creep.stiffness / 1e3:.3g} N/mm, {found.creep.time_constant:.3g} s"
    )
    for axes in (left, right):
        curves = [line for line in axes.lines if len(line.get_xdata()) > 4]
        assert len(curves) == 4
        for points, model in zip(curves[::2], curves[1::2], strict=True):
            measured, modelled = np.asarray(points.get_ydata()), np.asarray(model.get_ydata())
            assert np.sqrt(np.mean((measured - modelled) ** 2)) < 0.25 * np.abs(modelled).max()
    up, down = left.lines[1].get_ydata(), left.lines[3].get_ydata()
    assert up[0] > 50 > -50 > up[-1] and down[0] < -50 < 50 < down[-1]  # mN
    slack = data.slack
    assert slack.any() and not found.initial_force[slack].any()
    with pytest.raises(RangeError, match="and no samples"):
        relaxation(data.plateau_means(), found)


def test_without_creep_it_says_so():
    figure = drawn(NoCreep())[2]
    assert figure.axes[1].get_legend().get_title().get_text() == "no creep detected"
    assert not np.any(figure.axes[0].lines[1].get_ydata())
