"""Leaving the rating is never silent: how long, and how far."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben import catalog
from mckibben.actuator import IdealValve
from mckibben.control import Setpoint
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation import Outcome, SimulationResult, measure, trajectory
from mckibben.simulation.loop import Record
from mckibben.units import bar, deg


@pytest.fixture(scope="module")
def moved():
    """Four periods at hand-made states of the knee as printed: two fine, one overloaded, one stretched beyond 3 %."""
    plant = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    angle = jnp.asarray([0.0, 0.0, -9.0, -12.0]) * deg
    pressure1, pressure2 = jnp.full(4, 1 * bar), jnp.asarray([1.0, 2.0, 6.0, 1.0]) * bar
    zeros = jnp.zeros(4)
    record = Record(
        PlantState(angle, zeros, (pressure1, pressure2)),
        (pressure1, pressure2),
        jnp.zeros(4, bool),
        {"stiffness_estimate": zeros},
    )
    return jax.jit(trajectory)(plant, Setpoint(angle, zeros + 70), record, record.state.angle)


def test_an_overload_is_where_the_tension_is_above_630_n(moved):
    assert moved.overloaded.tolist() == [False, False, True, False]
    assert float(moved.force[1][2]) > 630
    assert moved.outside_domain.tolist() == [False, False, False, True]


def test_the_excursion_is_how_far_the_contraction_is_outside(moved):
    stretch = float(moved.contraction[1][3])
    assert stretch < -0.03
    np.testing.assert_allclose(moved.excursion, [0, 0, 0, -0.03 - stretch], atol=1e-15)


@pytest.mark.slow
def test_metrics_and_outcome_say_so(moved):
    found = measure(moved, 0.5)
    assert float(found.time_overloaded) == 0.5
    assert float(found.force_max) == float(moved.force[1].max())
    band = (np.zeros(4), np.zeros(4))
    result = SimulationResult.of(moved, 0.5, band=band, telemetry={})
    assert result.outcome is Outcome.LEFT_DOMAIN
    assert f"above the rated force (up to {float(found.force_max):.4g} N) for 0.5 s, first at 1 s" in result.verdict()
    assert "outside the domain (contraction by up to" in result.verdict()
