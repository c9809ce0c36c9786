"""What a run cannot resolve is refused before it: fast references, stiff plants, numbers that are none."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import mckibben as mk
from mckibben.errors import SimulationError
from mckibben.plant import NoDisturbance, TorquePulses
from mckibben.plant.base import HERMITE_LIMIT, STABILITY_LIMIT, Motion
from mckibben.simulation import Outcome
from mckibben.units import deg, mm

KNEE, LOAD = mk.catalog.joint("knee-table-2"), mk.catalog.load("knee-table-2")
PLANT = mk.JointPlant(KNEE, LOAD, mk.FirstOrderValve(0.02))
CONTROL = mk.PositionStiffnessControl(mk.PID(2e5, 60e5, 0.4e5), mk.PID(-1.5e5, -100e5, 0.0), model=KNEE)
REFERENCE = mk.Reference(angle=0.0, stiffness=72.5)


@pytest.mark.parametrize("frequency", [500.0, 1000.0])
def test_a_sine_at_or_above_half_the_control_rate_is_refused(frequency):
    reference = mk.Reference(angle=mk.Sine(0.03, frequency), stiffness=72.5)
    with pytest.raises(SimulationError) as caught:
        mk.simulate(PLANT, CONTROL, reference, duration=0.1)
    assert (caught.value.field, caught.value.value, caught.value.upper) == (
        "reference.angle.frequency",
        frequency,
        500.0,
    )


def test_a_frequency_that_varies_over_runs_is_checked_in_each():
    with pytest.raises(SimulationError) as caught:
        mk.simulate_many(
            PLANT, CONTROL, mk.Reference(angle=mk.Sine(0.03, np.array([1.0, 600.0])), stiffness=72.5), duration=0.1
        )
    assert caught.value.value == 600.0


def heavily_damped(damping):
    return dataclasses.replace(PLANT, load=dataclasses.replace(LOAD, damping=damping))


def test_a_plant_too_stiff_for_its_substeps_is_refused_with_the_number_that_would_do():
    with pytest.raises(SimulationError) as caught:
        mk.simulate(heavily_damped(1000.0), CONTROL, REFERENCE, duration=0.05, substeps=4)
    assert (caught.value.field, caught.value.value) == ("substeps", 4)
    result = mk.simulate(heavily_damped(1000.0), CONTROL, REFERENCE, duration=0.05, substeps=int(caught.value.lower))
    assert result.outcome is not Outcome.DIVERGED


SLIP, CREEP = mk.MaxwellSlip(7.5, 0.5 * mm, viscous=200.0), mk.MaxwellCreep(3000.0, 0.3, arms=2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "friction"),
    [
        ({}, None),
        ({}, mk.JointFriction(30.0, 0.05 * deg)),
        ({"friction": SLIP, "creep": CREEP}, mk.JointFriction(0.3, 0.05 * deg)),
        ({"creep": mk.MaxwellCreep(1.0, 0.01)}, None),  # the fastest mode is its relaxation
    ],
)
def test_the_fastest_mode_is_that_of_the_linearised_plant(parts, friction):
    """Eigenvalues of the derivative of the equation of motion, at a state without stress, where gravity is stiffest."""
    muscle, angle, pressures = dataclasses.replace(KNEE.muscle1, **parts), 0.1, (2e5, 3e5)
    joint = dataclasses.replace(KNEE, muscle1=muscle, muscle2=muscle)
    load = dataclasses.replace(LOAD, damping=0.05, hanging_angle=angle)
    plant = mk.JointPlant(joint, load, mk.IdealValve(), friction=friction)
    state = plant.init_state(angle, pressures)
    flat, restored = ravel_pytree(Motion.of(state))

    def rate(motion):
        return ravel_pytree(plant.rate(restored(motion).applied_to(state, state.pressures)))[0]

    modes = np.linalg.eigvals(np.asarray(jax.jit(jax.jacfwd(rate))(flat)))
    found = plant.fastest_rates([angle], [float(joint.stiffness(angle, pressures))])
    assert found["the motion"] == pytest.approx(np.abs(modes).max(), rel=2e-3)


def test_the_limit_is_that_of_the_method():
    for limit, disturbance in ((STABILITY_LIMIT, TorquePulses(0.0)), (HERMITE_LIMIT, NoDisturbance())):
        damping = limit / 0.25e-3 * float(LOAD.total_inertia)
        below, above = (
            dataclasses.replace(heavily_damped(part * damping), disturbance=disturbance) for part in (0.99, 1.01)
        )
        assert [plant.needed_substeps([0.0], [72.5], 1e-3) for plant in (below, above)] == [4, 5]
        with pytest.raises(SimulationError) as caught:
            above.check_substeps([0.0], [72.5], 1e-3, 4)
        assert caught.value.lower == 5


SINE = mk.Reference(mk.Sine(0.1, 1.0), 72.5)


@pytest.mark.parametrize(
    ("field", "plant", "control", "reference"),
    [
        ("load.gravity", eqx.tree_at(lambda plant: plant.load.gravity, PLANT, np.nan), None, None),
        ("controller.position.kp", None, eqx.tree_at(lambda control: control.position.kp, CONTROL, np.nan), None),
        ("reference.stiffness.value", None, None, eqx.tree_at(lambda one: one.stiffness.value, SINE, np.nan)),
        ("reference.angle.amplitude", None, None, eqx.tree_at(lambda one: one.angle.amplitude, SINE, np.nan)),
    ],
)
def test_a_number_that_is_none_is_named(field, plant, control, reference):
    with pytest.raises(SimulationError) as caught:
        mk.simulate(plant or PLANT, control or CONTROL, reference or REFERENCE, duration=0.1)
    assert caught.value.field == field
