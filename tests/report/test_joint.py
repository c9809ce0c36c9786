"""The figure of an envelope shows its numbers."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mckibben.reachability import envelope
from mckibben.report.joint import envelope as draw
from mckibben.scenario import Scenario
from mckibben.units import deg

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def scenario():
    read = Scenario.read(EXAMPLES / "as-printed-constant-pid.yaml")
    angle = dataclasses.replace(read.signals.angle, amplitude=20 * deg, frequency=5.0)
    signals = dataclasses.replace(read.signals, angle=angle)
    return read.model_copy(update={"signals": signals, "duration": 0.2})


def drawn(axes, label):
    return next(line for line in axes.lines if line.get_label() == label)


@pytest.mark.slow
def test_the_reference_and_its_bands(scenario):
    found = envelope(scenario)
    figure = draw(found)
    torque, stiffness, over_time, angle = figure.axes[:4]
    reference = drawn(over_time, "reference")
    np.testing.assert_allclose(reference.get_xdata(), found.reference.times)
    np.testing.assert_allclose(drawn(angle, "reference").get_ydata(), found.reference.desired_angle / deg)
    held = drawn(torque, "torque that balances gravity").get_ydata()
    np.testing.assert_allclose(held, found.static.torque[found.static.inside])
    band = stiffness.collections[0].get_paths()[0].vertices
    assert (band[:, 0].min(), band[:, 0].max()) == pytest.approx((-10.25, 10.25), abs=0.2)
    assert band[:, 1].min() == pytest.approx(np.nanmin(found.static.stiffness.lowest), abs=0.01)
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert {"reference", "attainable, static"} <= set(labels)
