"""CasADi functions equal JAX for every law and geometry, and the plant of a scenario."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import mckibben as mk
from mckibben.errors import ExportError, ParameterError
from mckibben.export.casadi import casadi_plant
from mckibben.muscle import MaxwellCreep, MaxwellSlip
from mckibben.plant import IOState
from mckibben.robot import RobotScenario
from tests.robot.test_control import ONE, TORQUE

casadi = pytest.importorskip("casadi", reason="the extra casadi is not installed")
VALVE = mk.FirstOrderValve(time_constant=0.02)


def close(found, wanted, scale=None):
    """Equal to 1e-12 of the largest value."""
    scale = np.max(np.abs(wanted)) if scale is None else scale
    np.testing.assert_allclose(np.asarray(found, float).reshape(np.shape(wanted)), wanted, rtol=0, atol=1e-12 * scale)


@pytest.mark.slow
def test_every_law_and_geometry_gives_torque_stiffness_and_tensions(known):
    """At rest, under no gravity; the torque is that which accelerates the load."""
    load = mk.GeneralLoad(inertia=1.0, greatest_gravity_torque=0.0)
    functions = casadi_plant(mk.JointPlant(known.joint, load, VALVE)).functions
    states = np.vstack([known.angles, np.zeros_like(known.angles), known.pressures.T])
    inputs = np.vstack([known.pressures.T, np.zeros_like(known.angles)])
    stiffness, *tensions = np.asarray(functions["evaluate"](states, inputs))
    close(stiffness, known.stiffness)
    close(np.transpose(tensions), known.tensions)
    assert np.min(tensions) >= 0
    close(np.asarray(functions["differentiate"](states, inputs))[1], known.torque)


@eqx.filter_jit
def advanced(plant, state, commands):
    return plant.advance(state, commands, 1e-3, 4)


@eqx.filter_jit
def rates(plant, state, commands):
    """Rates of angle, velocity and pressures, and of the states of valves and air."""
    commands = plant.clip_commands(commands)
    pressures, air = plant.valve.rates(state.pressures, state.air, commands, lambda: plant.air_volumes(state))
    motion = plant.rate(state)
    return motion.position, motion.velocity, pressures, air


@pytest.fixture(scope="module")
def scenario():
    return mk.Scenario.read("examples/pre-contracted-step-pid.yaml")


@pytest.mark.slow
def test_a_scenario_gives_the_rate_and_the_steps_of_its_plant(scenario, plant):
    made = casadi_plant(scenario, substeps=4, parameters=["load.mass2"])
    state = plant.init_state(0.1, (2e5, 3e5))._replace(velocity=np.array(1.5))
    commands = np.array(1e5), np.array(9e5)  # the second one above the rating
    assert made.state == ("position", "velocity", "pressures_0", "pressures_1")
    assert made.inputs == ("command1", "command2", "torque")
    assert made.left_out == ()
    numbers = [0.1, 1.5, 2e5, 3e5], [*commands, 0.0]
    wanted = np.array(jax.tree.leaves(rates(plant, state, commands)))
    close(made.functions["differentiate"](*numbers, 0.5), wanted)
    following = advanced(plant, state, plant.clip_commands(commands))
    close(made.functions["advance"](*numbers, 1e-3, 0.5), np.array(jax.tree.leaves(following)))
    heavier = eqx.tree_at(lambda one: one.load.mass2, plant, np.array(1.0))
    close(made.functions["differentiate"](*numbers, 1.0), np.array(jax.tree.leaves(rates(heavier, state, commands))))
    pushed = state._replace(io=IOState(jnp.zeros(()), jnp.asarray(0.3), ()))
    wanted = np.array(jax.tree.leaves(rates(plant, pushed, commands)))
    close(made.functions["differentiate"](numbers[0], [*commands, 0.3], 0.5), wanted)


@pytest.mark.slow
def test_a_rate_is_differentiable(scenario):
    functions = casadi_plant(scenario).functions
    x, u = casadi.SX.sym("x", 4), [3e5, 3e5, 0.0]
    slope = casadi.Function("slope", [x], [casadi.jacobian(functions["differentiate"](x, u), x)[1, 0]])
    load = scenario.plant().load
    stiffness = float(functions["evaluate"]([0, 0, 3e5, 3e5], u)[0]) + float(load.gravity_stiffness(0.0))
    assert float(slope([0, 0, 3e5, 3e5])) == pytest.approx(-stiffness / float(load.total_inertia), rel=1e-12)


@pytest.mark.slow
def test_friction_and_creep_slip_after_a_step(knee, load):
    slip, creep = MaxwellSlip(12.0, 5e-4, elements=2), MaxwellCreep(900.0, 0.5, pressure_share=0.1)
    muscle = mk.Muscle(knee.muscle1.specimen, knee.muscle1.law, slip, creep)
    plant = mk.JointPlant(mk.AntagonisticJoint(knee.geometry, muscle, muscle), load, VALVE)
    made = casadi_plant(plant)
    assert "project" in made.functions
    state = plant.init_state(0.1, (2e5, 3e5))._replace(velocity=np.array(1.5))
    following = advanced(plant, state, (1e5, 4e5))
    found = made.functions["advance"](np.array(jax.tree.leaves(state)), [1e5, 4e5, 0.0], 1e-3)
    close(found, np.array(jax.tree.leaves(following)))


@pytest.mark.slow
@pytest.mark.parametrize("wall", [None, 0.3])
def test_air_of_flow_valves(knee, load, wall):
    plant = mk.JointPlant(knee, load, mk.FlowValve(conductance=1e-9, supply=7e5, wall_conductance=wall))
    state = plant.init_state(0.1, (2e5, 3e5))
    if wall:
        state = state._replace(air=state.air._replace(temperatures=(jnp.asarray(310.0), jnp.asarray(280.0))))
    found = casadi_plant(plant).functions["differentiate"](np.array(jax.tree.leaves(state)), [1e5, 4e5, 0.0])
    close(found, np.array(jax.tree.leaves(rates(plant, state, (1e5, 4e5)))))


def test_valves_that_switch_have_no_rate(knee, load):
    valve = mk.SwitchingValves(conductance=1e-9, supply=7e5, period=0.02)
    made = casadi_plant(mk.JointPlant(knee, load, valve), substeps=1)
    assert "differentiate" not in made.functions
    assert "differentiate" in made.left_out[0]


@pytest.mark.slow
def test_series_springs(knee, load):
    """An extended spring, and one at its preload; the slope is that of the implicit function."""
    spring = mk.SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    joint = mk.AntagonisticJoint(knee.geometry, knee.muscle1, knee.muscle2, spring)
    still = mk.GeneralLoad(inertia=1.0, greatest_gravity_torque=0.0)
    functions = casadi_plant(mk.JointPlant(joint, still, VALVE)).functions
    x, p = casadi.SX.sym("x"), [2e5, 3e5]
    torque = functions["differentiate"](casadi.vertcat(x, 0, *p), [*p, 0.0])[1]
    slope = casadi.Function("slope", [x], [casadi.jacobian(torque, x)])
    for angle in (-0.2, 0.1, 0.3):
        stiffness, *tensions = np.asarray(functions["evaluate"]([angle, 0.0, *p], [*p, 0.0])).ravel()
        close(tensions, np.stack(joint.tensions(angle, p)))
        assert stiffness == pytest.approx(float(joint.stiffness(angle, p)), rel=1e-9)
        assert float(slope(angle)) == pytest.approx(-stiffness, rel=1e-9)


@pytest.mark.parametrize("base", ["fixed", "vertical"])
@pytest.mark.slow
def test_a_robot(base):
    """Its state has the coordinates that move; others are those of its start."""
    text = ONE.replace("robot:", f"robot:\n  base: {base}\n  foot: {{body: shank}}") + TORQUE
    scenario = RobotScenario.parse(text)
    made, plant = casadi_plant(scenario, substeps=2, parameters=["robot.bodies.1.mass"]), scenario.plant()
    moving = ("z", "angles_0") if base == "vertical" else ("angles_0",)
    assert made.inputs == ("command1", "command2", "torque_0")
    assert made.state == (*(f"{part}_{name}" for part in ("position", "velocity") for name in moving), "pressures_0",
                          "pressures_1")  # fmt: skip
    assert len(made.left_out) == 2
    plant = plant.with_ideal_io()
    start = scenario.initial(plant)
    state = start._replace(velocity=start.velocity._replace(angles=(jnp.asarray(1.5),)))
    commands, torque = (1e5, 5e5), 0.3

    @jax.jit
    def expected(plant, state):
        pushed = state._replace(io=IOState(jnp.zeros(()), (jnp.asarray(torque),), ()))
        motion = plant.rate(pushed)
        pressures, _ = plant.valve.rates(state.pressures, state.air, commands, None)
        return (motion.position, motion.velocity, pressures), plant.advance(pushed, commands, 1e-3, 2)

    def numbers(posture, velocity, pressures):
        moved = [[*((at.z,) if base == "vertical" else ()), *at.angles] for at in (posture, velocity)]
        return np.array([*moved[0], *moved[1], *pressures], float)

    rate, after = expected(plant, state)
    arguments = numbers(*state[:3]), [*commands, torque]
    close(made.functions["differentiate"](*arguments, 0.5), numbers(*rate))
    close(made.functions["advance"](*arguments, 1e-3, 0.5), numbers(*after[:3]))
    stiffness = np.asarray(made.functions["evaluate"](*arguments, 0.5)).ravel()[1]
    close(stiffness, plant.robot.stiffness(state.angle, state.pressures)[0])
    heavier = np.asarray(made.functions["differentiate"](*arguments, 1.0)).ravel()
    assert np.max(np.abs(heavier - numbers(*rate))) > 0.1


@pytest.mark.slow
def test_a_plant_of_a_robot_alone():
    made = casadi_plant(RobotScenario.read("examples/robot/lei-leg-in-space.yaml").plant(), substeps=1)
    assert [name for name in made.state if name.startswith("position")]


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
