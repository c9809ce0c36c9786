"""Valves with air, against closed forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import FlowValve, PressureRegulator, SwitchingValves
from mckibben.actuator.base import AirState, AirVolume
from mckibben.muscle.air import ATMOSPHERE, DENSITY, LAMINAR, mass_flow
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import JointPlant

C = 0.4e-8  # m^3/(s*Pa): 0.4 dm^3/(s*bar)
RESERVOIR = {"reservoir_volume": 1e-3, "line_conductance": 0.2e-8}
VALVES = {
    "flow": FlowValve(C, 7e5, exhaust_conductance=0.6e-8, dead_volume=3e-6, dead_zone=0.05, **RESERVOIR),
    "regulator": PressureRegulator(C, 7e5, time_constant=0.02),
}
advance = jit(lambda plant, state, commands, time: plant.advance(state, commands, time, 100))


@pytest.mark.slow
def test_flow_chokes_at_the_critical_ratio_and_is_linear_at_small_differences():
    assert float(mass_flow(C, 0.3, 7e5, 1e5)) == float(mass_flow(C, 0.3, 7e5, 0.3 * 7e5)) == C * DENSITY * 7e5
    assert float(mass_flow(C, 0.3, 7e5, 0.65 * 7e5)) == pytest.approx(C * DENSITY * 7e5 * math.sqrt(0.75))
    assert float(mass_flow(C, 0.3, 5e5, 7e5)) == -float(mass_flow(C, 0.3, 7e5, 5e5))
    slopes = jax.vmap(jax.grad(lambda p: mass_flow(C, 0.3, 7e5, p)))(7e5 * jnp.array([LAMINAR + 1e-4, 1.0, 1.0005]))
    assert float(slopes[1]) == pytest.approx(float(slopes[0]), rel=1e-9)  # no kink where the flow turns round
    assert float(slopes[2]) == pytest.approx(float(slopes[0]), rel=1e-2)


@pytest.fixture(scope="module")
def plants(knee, load):
    return {name: numeric(JointPlant(knee, load, valve)) for name, valve in VALVES.items()}


def braid_volume(contraction):
    alpha, ratio = math.radians(25), 1 - contraction
    return math.pi * 0.01**2 * 0.18 / 4 * ratio * (1 - math.cos(alpha) ** 2 * ratio**2) / math.sin(alpha) ** 2


def test_with_shut_valves_the_air_is_compressed_as_p_v_to_the_n_and_is_as_stiff_as_the_joint_says(
    plants, paper_precontracted, knee
):
    """At commands that are the pressures the dead zone keeps the valves shut."""
    start = plants["flow"].init_state(0.1, (3e5, 4e5))._replace(velocity=jnp.asarray(0.5))
    moved = advance(plants["flow"], start, (3e5, 4e5), 0.002)
    pressures = [[float(p) for p in state.pressures] for state in (start, moved)]
    volumes = [
        [braid_volume(c) + 3e-6 for c in paper_precontracted.contractions(float(state.angle))]
        for state in (start, moved)
    ]
    for i in range(2):
        expected = (pressures[0][i] + ATMOSPHERE) * (volumes[0][i] / volumes[1][i]) ** 1.2 - ATMOSPHERE
        assert pressures[1][i] == pytest.approx(expected, rel=1e-9) != pytest.approx(pressures[0][i], rel=1e-4)
    torques = [
        paper_precontracted.torque(float(state.angle), held)
        for state, held in zip((start, moved), pressures, strict=True)
    ]
    closed = jit(lambda joint, p: joint.closed_valve_stiffness(0.1, p, polytropic_index=1.2, dead_volume=3e-6))
    stiffness = (torques[0] - torques[1]) / float(moved.angle - start.angle)
    assert stiffness == pytest.approx(float(closed(knee, (3e5, 4e5))), rel=5e-3)


@pytest.mark.parametrize("steps", [4, 30])
@pytest.mark.parametrize("error", [0.3e5, -0.05e5, 2e5, -3e5])
def test_a_pulse_is_open_for_its_width_less_the_delay_in_steps_of_any_length(error, steps):
    """The delay is a tenth of the period, of which nine tenths are compensated."""
    valve = SwitchingValves(C, 7e5, period=0.01, opening_delay=0.001, compensation=0.9)
    state, step, share = valve.init(jnp.asarray(3e5)), 0.01 / steps, 0.0
    for k in range(2 * steps):
        command = 3e5 + error if k % steps == 0 else 0.0  # it is looked at when a period begins
        state = valve.before_step(state, command, 3e5, step)
        share += float(valve.opening(state, command, 3e5)) / (2 * steps)
    part = 0.91 * abs(error) / 1e5 + 0.09 - 0.1
    expected = math.copysign(1.0 if abs(error) > 1e5 else part, error)
    assert share == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_commands_lead_the_pressure_by_what_the_loop_needs_and_none_does_beyond_the_open_valve(plants):
    plant = plants["regulator"]
    state = plant.init_state(0.1, (3e5, 4e5))
    rates = (20e5, -10e5)
    commands = plant.commands_for(state, rates)
    lagging = state._replace(
        air=state.air._replace(valves=tuple(c - 0.02 * r for c, r in zip(commands, rates, strict=True)))
    )
    found, _ = plant.valve.air_rate(state.pressures, lagging.air, commands, plant.air_volumes(state))
    assert [float(rate) for rate in found] == pytest.approx(rates, rel=1e-9)
    assert [float(c) for c in plant.commands_for(state, (1e9, -1e9))] == [math.inf, -math.inf]
    beyond = plant.init_state(0.1, (7.5e5, 4e5))  # above the supply
    assert not math.isfinite(plant.commands_for(beyond, (0.0, 0.0))[0])
    assert float(plant.clip_commands((7.5e5, 0.0))[0]) == 7e5


STIFF = {
    "loop of a regulator": PressureRegulator(C, 7e5, time_constant=0.05, band=0.1e5),
    "lag of a regulator": PressureRegulator(C, 7e5, time_constant=0.002, band=5e5, exhaust_conductance=0.6e-8),
    "loop of a spool": FlowValve(C, 7e5, band=0.1e5, spool_lag=0.002, dead_volume=3e-6),
    "spool": FlowValve(C, 7e5, band=5e5, spool_lag=0.001, direct=True),
    "reservoir": PressureRegulator(C, 7e5, time_constant=0.05, reservoir_volume=2e-6, line_conductance=2e-8),
}


@pytest.mark.parametrize("name", STIFF)
def test_the_bound_on_the_rates_of_the_air_holds_and_is_near(name):
    valve, volume = STIFF[name], 2e-5
    room = AirVolume(jnp.asarray(volume + valve.dead_volume), jnp.asarray(0.0))
    has_reservoir = valve.reservoir_volume is not None

    def rates(x, command):
        (rate,), moved = valve.air_rate((x[0],), AirState((x[1],), x[2] if has_reservoir else ()), (command,), (room,))
        return jnp.stack([rate, moved.valves[0], moved.reservoir if has_reservoir else 0.0 * x[2]])

    errors = float(valve.band) * np.array([-1.5, -0.9, -0.1, 0.1, 0.9, 1.5])
    pressure, error, inlet = np.meshgrid([20.0, 1e5, 4e5, 7e5 - 20], errors, [6.1e5, 7e5 - 20], indexing="ij")
    state = pressure + error if isinstance(valve, PressureRegulator) else np.clip(error / valve.band, -1, 1)
    points = np.stack([pressure, state, inlet], axis=-1).reshape(-1, 3)
    command = np.clip(error / valve.band, -1, 1) if valve.direct else pressure + error
    jacobians = jax.jit(jax.vmap(jax.jacfwd(rates)))(points, command.ravel())
    fastest = np.abs(np.linalg.eigvals(np.asarray(jacobians))).max()
    assert fastest < valve.fastest_rate_in(volume) < 2.5 * fastest


def test_the_time_constant_is_the_mean_of_filling_and_venting_by_a_small_error():
    valve = PressureRegulator(C, 7e5, time_constant=0.02, exhaust_conductance=0.6e-8, dead_volume=3e-6, band=0.4e5)
    volume, pressure, error = 2e-5, 3e5, 10.0
    room = (AirVolume(jnp.asarray(volume + valve.dead_volume), jnp.asarray(0.0)),)
    rates = [
        float(valve.air_rate((pressure,), AirState((pressure + one,)), (pressure,), room)[0][0]) / one
        for one in (error, -error)
    ]
    assert min(rates) > 0
    wanted = 0.02 + (1 / rates[0] + 1 / rates[1]) / 2
    assert float(valve.time_constant_at(pressure, volume)) == pytest.approx(wanted, rel=1e-6)
