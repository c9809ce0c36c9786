"""CasADi functions equal JAX for every law and geometry, and the plant of a scenario."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import mckibben as mk
from mckibben.errors import ExportError, ParameterError
from mckibben.export.casadi import casadi_function, casadi_plant
from mckibben.export.plant import plant_module, state_rate
from mckibben.muscle import MaxwellCreep, MaxwellSlip

casadi = pytest.importorskip("casadi", reason="the extra casadi is not installed")


def close(found, wanted, scale=None):
    """Equal to 1e-12 of the largest value."""
    scale = np.max(np.abs(wanted)) if scale is None else scale
    np.testing.assert_allclose(np.asarray(found, float).reshape(np.shape(wanted)), wanted, rtol=0, atol=1e-12 * scale)


@pytest.mark.slow
def test_every_law_and_geometry_gives_torque_stiffness_and_tensions(known):
    load = mk.PendulumLoad(mass=0.5, length=0.2)
    module = plant_module(mk.JointPlant(known.joint, load, mk.IdealValve())).module
    for name in ("torque", "stiffness", "tensions"):
        function = casadi_function(module, name)
        found = np.asarray(function(known.angles[None], known.pressures.T)).T
        close(found, getattr(known, name))
        assert name != "tensions" or found.min() >= 0


@eqx.filter_jit
def advanced(plant, state, commands):
    return plant.advance(state, commands, 1e-3, 4)


@pytest.fixture(scope="module")
def scenario():
    return mk.Scenario.read("examples/pre-contracted-step-pid.yaml")


def test_a_scenario_gives_the_rate_and_the_steps_of_its_plant(scenario, plant):
    made = casadi_plant(scenario, parameters=["load.mass2"])
    state = plant.init_state(0.1, (2e5, 3e5))._replace(velocity=np.array(1.5))
    commands = np.array(1e5), np.array(7e5)  # the second one above the rating
    assert made.state == ("angle", "velocity", "pressures_0", "pressures_1")
    assert made.left_out == ()
    given = [0.1, 1.5, 2e5, 3e5], [1e5, 7e5], 0.5
    close(made.functions["rate"](*given), np.array(jax.tree.leaves(jax.jit(state_rate)(plant, state, commands))))
    following = advanced(plant, state, plant.clip_commands(commands))
    close(made.functions["step"](*given), np.array(jax.tree.leaves(following)))
    heavier = eqx.tree_at(lambda one: one.load.mass2, plant, np.array(1.0))
    wanted = np.array(jax.tree.leaves(jax.jit(state_rate)(heavier, state, commands)))
    close(made.functions["rate"](*given[:2], 1.0), wanted)


def test_a_rate_is_differentiable(scenario):
    rate = casadi_plant(scenario).functions["rate"]
    x = casadi.SX.sym("x", 4)
    stiffness = casadi_plant(scenario).functions["stiffness"]
    slope = casadi.Function("slope", [x], [casadi.jacobian(rate(x, x[2:]), x)[1, 0]])
    load = scenario.plant().load
    wanted = -(float(stiffness(0.0, [3e5, 3e5])) + float(load.gravity_stiffness(0.0))) / float(load.total_inertia)
    assert float(slope([0, 0, 3e5, 3e5])) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.slow
def test_friction_and_creep_are_in_the_step_and_said_to_be_missing_in_the_rate(knee, load):
    slip, creep = MaxwellSlip(12.0, 5e-4, elements=2), MaxwellCreep(900.0, 0.5, pressure_share=0.1)
    muscle = mk.Muscle(knee.muscle1.specimen, knee.muscle1.law, slip, creep)
    joint = mk.AntagonisticJoint(knee.geometry, muscle, muscle)
    plant = mk.JointPlant(joint, load, mk.FirstOrderValve(time_constant=0.02))
    made = casadi_plant(plant, control_period=1e-3)
    assert "rate" not in made.functions
    assert "rate" in made.left_out[0]
    state = plant.init_state(0.1, (2e5, 3e5))._replace(velocity=np.array(1.5))
    following = advanced(plant, state, (1e5, 4e5))
    found = made.functions["step"](np.array(jax.tree.leaves(state)), [1e5, 4e5])
    close(found, np.array(jax.tree.leaves(following)))


@pytest.mark.parametrize("wall", [None, 0.3])
def test_air_of_flow_valves(knee, load, wall):
    valve = mk.FlowValve(conductance=1e-9, supply=7e5, wall_conductance=wall)
    plant = mk.JointPlant(knee, load, valve)
    made = casadi_plant(plant)
    state = plant.init_state(0.1, (2e5, 3e5))
    if wall:
        state = state._replace(air=state.air._replace(temperatures=(jnp.asarray(310.0), jnp.asarray(280.0))))
    found = made.functions["rate"](np.array(jax.tree.leaves(state)), [1e5, 4e5])
    close(found, np.array(jax.tree.leaves(eqx.filter_jit(state_rate)(plant, state, (1e5, 4e5)))))


def test_series_springs(knee, load):
    """An extended spring, and one at its preload; the slope is that of the implicit function."""
    spring = mk.SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    joint = mk.AntagonisticJoint(knee.geometry, knee.muscle1, knee.muscle2, spring)
    functions = casadi_plant(mk.JointPlant(joint, load, mk.IdealValve())).functions
    x = casadi.SX.sym("x")
    slope = casadi.Function("slope", [x], [casadi.jacobian(functions["torque"](x, [2e5, 3e5]), x)])
    for angle in (-0.2, 0.1, 0.3):
        close(functions["tensions"](angle, [2e5, 3e5]), np.stack(joint.tensions(angle, (2e5, 3e5))))
        stiffness = float(joint.stiffness(angle, (2e5, 3e5)))
        assert float(functions["stiffness"](angle, [2e5, 3e5])) == pytest.approx(stiffness, rel=1e-9)
        assert float(slope(angle)) == pytest.approx(-stiffness, rel=1e-9)


def test_what_cannot_be_written_is_refused(knee, load, scenario):
    class Settling(mk.KneeLoad):
        def gravity_torque(self, angle):
            halved = lax.while_loop(lambda x: jnp.abs(x) > 1e-3, lambda x: x / 2, jnp.asarray(angle))
            return super().gravity_torque(angle) + halved

    with pytest.raises(ExportError) as caught:
        casadi_plant(mk.JointPlant(knee, Settling(0.5, 0.5, 0.1, 0.2, 0.02, 0.015), mk.IdealValve()))
    assert caught.value.field == "while"
    assert caught.value.remedy
    with pytest.raises(ParameterError) as wrong:
        casadi_plant(scenario, parameters=["load.mass3"])
    assert wrong.value.value == "load.mass3"
