"""Stiffness over amplitude and rate of a scenario whose air has a temperature."""

import re
from pathlib import Path

import numpy as np
import pytest

from mckibben.muscle.air import ATMOSPHERE, effective_index
from mckibben.report.joint import stiffness
from mckibben.scenario import Scenario
from mckibben.study.stiffness import CLOSED, stiffness_tests
from mckibben.units import deg

WARM = Path(__file__).parents[2] / "examples" / "stiffness" / "warm.yaml"


@pytest.mark.slow
def test_closed_valves_have_a_storage_and_a_loss_part_that_depend_on_the_rate():
    """The simulated tests against the linearised air, in motion in which friction is a spring."""
    held = "controller: {class: open_loop, pressure1: 4.5 bar, pressure2: 4.5 bar}\n"
    text = re.sub(r"controller:.*?(?=reference:)", held, WARM.read_text(encoding="utf-8"), flags=re.DOTALL)
    result = stiffness_tests(Scenario.parse(text), np.array([0.01, 0.02]) * deg, np.array([0.25, 10.0]))
    (found,), scenario = result.motions.values(), result.scenario
    simulated, valve = found.tests[CLOSED], scenario.valve
    rates = simulated.frequency
    joint, held = scenario.joint, (found.angle, found.pressures)
    indices = [
        effective_index(valve.wall_conductance, p + ATMOSPHERE, m.specimen.volume(e) + valve.dead_volume, rates)
        for m, e, p in zip(joint.muscles, joint.contractions(*held), found.pressures, strict=True)
    ]
    air = {"polytropic_index": tuple(indices), "dead_volume": valve.dead_volume}
    closed = np.asarray(joint.closed_valve_stiffness(*held, **air))
    friction = found.secant[0] - found.isobaric
    np.testing.assert_allclose(simulated.stiffness[:, 0], closed.real + friction, rtol=2e-4)
    np.testing.assert_allclose(simulated.loss[:, 0], closed.imag, atol=0.005)
    assert closed.imag[0] > 1.0 > closed.imag[1] > 0.0 and closed.real[1] > closed.real[0] + 2
    assert "held at" in result.verdict() and result.to_text()
    drawn = stiffness(result).axes[0].lines
    assert any(np.array_equal(line.get_ydata(), found.closed_secant) for line in drawn)
