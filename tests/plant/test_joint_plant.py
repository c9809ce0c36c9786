import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from mckibben.actuator import FirstOrderValve, FlowValve
from mckibben.control import Setpoint
from mckibben.errors import UnreachableError
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.units import bar

PERIODS = 2000


def rates(state):
    return [float(x) for x in jax.tree.leaves(state)]


@pytest.mark.parametrize("degrees", [-25, 0, 10, 25])
def test_at_rest_nothing_moves(plant, degrees):
    state = plant.equilibrium(math.radians(degrees))
    assert rates(plant.rate(state)) == pytest.approx([0, 0], abs=1e-9)
    assert float(state.angle) == pytest.approx(math.radians(degrees))
    assert all(0 <= float(p) <= 6e5 for p in state.pressures)
    assert all(float(t) > 0 for t in plant.joint.tensions(state.angle, state.pressures))


def test_at_rest_the_stiffness_is_the_one_asked_for_or_the_middle(plant):
    asked = plant.equilibrium(0.1, stiffness=14.0)
    assert float(plant.joint.stiffness(0.1, asked.pressures)) == pytest.approx(14.0, abs=1e-8)
    low, high = plant.joint.attainable_stiffness(0.1, -plant.load.gravity_torque(0.1))
    middle = plant.equilibrium(0.1)
    assert float(plant.joint.stiffness(0.1, middle.pressures)) == pytest.approx(float(low + high) / 2, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("valve", [FirstOrderValve(0.02, supply=3.5 * bar), FlowValve(4e-9, 3.5 * bar)])
def test_a_low_supply_limits_commands_start_and_attainable_stiffness(plant, valve):
    low = JointPlant(plant.joint, plant.load, valve)
    np.testing.assert_allclose(low.clip_commands((5 * bar, 2 * bar)), (3.5 * bar, 2 * bar))
    np.testing.assert_allclose(plant.clip_commands((5 * bar, 2 * bar)), (5 * bar, 2 * bar))
    gravity = -plant.load.gravity_torque(0.1)
    lowest, highest = plant.joint.attainable_stiffness(0.1, gravity, pressure_limits=(0.0, 3.5 * bar))
    assert float(highest) < float(plant.joint.attainable_stiffness(0.1, gravity)[1])
    state = low.equilibrium(0.1)
    assert max(map(float, state.pressures)) < 3.5 * bar
    assert float(plant.joint.stiffness(0.1, state.pressures)) == pytest.approx(float(lowest + highest) / 2, rel=1e-6)
    with pytest.raises(UnreachableError) as caught:
        low.equilibrium(0.1, stiffness=float(highest) + 0.1)
    assert caught.value.upper == pytest.approx(float(highest), rel=1e-6)


def test_a_supply_that_does_not_hold_the_start_is_named(plant):
    with pytest.raises(UnreachableError, match="supply of the valves is too low"):
        JointPlant(plant.joint, plant.load, FirstOrderValve(0.02, supply=0.3 * bar)).equilibrium(0.1)


def test_the_rate_is_equation_6(plant, paper_precontracted):
    state = PlantState(*map(jnp.asarray, (0.2, -1.5)), tuple(map(jnp.asarray, (3.2e5, 4.1e5))))
    got = plant.rate(state)
    expected = paper_precontracted.acceleration(0.2, -1.5, (3.2e5, 4.1e5))
    assert float(got.position) == -1.5
    assert float(got.velocity) == pytest.approx(expected, rel=1e-11)


def test_its_stiffness_is_that_of_the_muscles_and_gravity(plant):
    pressures = (3e5, 4e5)
    added = float(plant.stiffness(0.1, pressures) - plant.joint.stiffness(0.1, pressures))
    assert added == pytest.approx(0.15 * 9.81 * np.cos(np.pi / 6 - 0.1), rel=1e-12)


@pytest.fixture(scope="module")
def swung(ideal_plant, playback, short_episode):
    """Two seconds at held pressures from 15 deg, 0.3 rad/s, for a damping."""
    held = Setpoint(jnp.full(PERIODS, 4e5), jnp.full(PERIODS, 3.6e5))
    start = numeric(PlantState(math.radians(15), 0.3, (4e5, 3.6e5)))

    def run(damping):
        import equinox as eqx

        loaded = eqx.tree_at(lambda p: p.load.damping, ideal_plant, jnp.asarray(damping))
        return short_episode(loaded, playback, held, start, jnp.asarray(1e-3), 4)[1].state

    return run


def energy(paper, state):
    """Kinetic energy, minus the work of the muscles' torque by quadrature, and the height of the masses."""
    angles, velocities = np.asarray(state.angle)[::100], np.asarray(state.velocity)[::100]
    work = [
        quad(lambda a: paper.torque(a, (4e5, 3.6e5)), 0, x, epsabs=1e-12, epsrel=1e-12, limit=200)[0] for x in angles
    ]
    return paper.inertia * velocities**2 / 2 - np.array(work) - paper.G * np.cos(np.pi / 6 - angles)


def test_energy_is_conserved_with_no_damping_and_constant_pressures(swung, paper_precontracted):
    state = swung(0.0)
    total = energy(paper_precontracted, state)
    kinetic = paper_precontracted.inertia * np.asarray(state.velocity) ** 2 / 2
    assert kinetic.max() > 0.05
    assert np.ptp(np.asarray(state.angle)) > 0.3  # it does swing
    assert np.ptp(total) < 1e-8 * kinetic.max()
