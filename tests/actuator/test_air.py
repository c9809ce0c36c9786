"""Air behind regulators, tubes and unequal valves, with and without a temperature: against SciPy and closed forms."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import AirState, AirVolume
from mckibben.actuator.base import Point
from mckibben.errors import RangeError
from mckibben.muscle.air import mass_flow, pressure_behind
from mckibben.numerics.calculus import rk4
from mckibben.numerics.compiled import jit, numeric
from mckibben.units import bar, cm, ms
from tests.air import ATMOSPHERE, KAPPA, ROOM, follow

C, THIN, SUPPLY, LAG, BAND = 0.1e-8, 0.08e-8, 8 * bar, 20 * ms, 0.5 * bar
HYSTERESIS, WALL, HOLLOW, PERIOD = 0.2 * bar, 0.5, 6 * cm**3, 1 * ms
VOLUME, GROWTH = 23.8e-6, 7e-6  # of the muscle [m^3], [m^3/s]
PLAIN = mk.PressureRegulator(C, SUPPLY, time_constant=LAG, band=BAND)
WARM = dataclasses.replace(PLAIN, leak=0.002e-8, wall_conductance=WALL)
ASYMMETRIC = dataclasses.replace(
    PLAIN, exhaust_conductance=1.5 * C, leak=0.002e-8, dead_volume=1 * cm**3, hysteresis=HYSTERESIS
)
TUBE = mk.Tube(ASYMMETRIC, volume=HOLLOW, conductance=THIN, critical_ratio=0.25)
OTHER = mk.Tube(
    dataclasses.replace(PLAIN, conductance=0.6 * C, time_constant=1.5 * LAG), volume=HOLLOW, conductance=1.5 * THIN
)
STORE = 100 * cm**3, 0.05e-8
PAIR = mk.UnequalValves(
    mk.Tube(PLAIN, volume=HOLLOW, conductance=THIN), OTHER, reservoir_volume=STORE[0], line_conductance=STORE[1]
)
SPOOL = mk.FlowValve(
    C, SUPPLY, exhaust_conductance=1.5 * C, dead_zone=0.05, reservoir_volume=STORE[0], line_conductance=STORE[1]
)
LAGGING = mk.UnequalValves(mk.FirstOrderValve(20 * ms), mk.FirstOrderValve(30 * ms, supply=4 * bar))
STILL = AirVolume(jnp.asarray(VOLUME), jnp.zeros(()))
advance = jit(lambda plant, state, commands, time: plant.advance(state, commands, time, 200))


def integrated(actuator, start, commands, steps, step, growth=GROWTH, states=None):
    """Pressures [Pa] and state of the air after steps [s] of Runge and Kutta."""

    def move(number, carry):
        def rate(carry, t):
            volumes = [AirVolume(share * VOLUME + growth * t, jnp.asarray(growth)) for share in (1.0, 0.75)]
            return actuator.rates(*carry, commands, lambda: volumes[: len(commands)])

        return rk4(rate, carry, step, tuple(((number + part) * step,) for part in (0.0, 0.5, 1.0)))

    pressures = tuple(map(jnp.asarray, start))
    begin = pressures, actuator.init_states(pressures) if states is None else states
    return jax.jit(lambda: jax.lax.fori_loop(0, steps, move, begin))()


@pytest.mark.parametrize(
    ("actuator", "commands"),
    [
        (TUBE, (1.0 * bar,)),
        (TUBE, (2.56 * bar,)),
        (TUBE, (4.0 * bar,)),
        *(
            pytest.param(actuator, (command,), marks=pytest.mark.slow)
            for actuator in (
                WARM,
                dataclasses.replace(PLAIN, wall_conductance=0.0),
                dataclasses.replace(TUBE, valve=WARM),
            )
            for command in (1.0 * bar, 5.0 * bar)
        ),
        (SPOOL, (4.0 * bar,)),
        (SPOOL, (1.5 * bar,)),
        pytest.param(PAIR, (5 * bar, 6 * bar), marks=pytest.mark.slow),
    ],
)
def test_muscles_fill_and_vent_as_an_independent_solver_says(actuator, commands):
    start, parts = [2.5 * bar, 1.5 * bar][: len(commands)], [actuator.for_muscle(i) for i in range(len(commands))]
    volumes = [VOLUME, 0.75 * VOLUME][: len(commands)]
    reservoir = STORE if actuator.reservoir else None
    pressures, air = integrated(actuator, start, commands, 5000, 1e-5)
    muscles, temperatures, held, tubes, store = (
        one[..., -1] for one in follow(parts, start, commands, [0.05], volumes, GROWTH, reservoir)
    )
    np.testing.assert_allclose(pressures, muscles, rtol=1e-8)
    if air.temperatures:
        np.testing.assert_allclose(air.temperatures, temperatures, rtol=1e-8)
        assert abs(temperatures[0] - ROOM) > 5
    if isinstance(parts[0], mk.Tube):
        np.testing.assert_allclose([one.pressure for one in air.valves], tubes, rtol=1e-8)
        np.testing.assert_allclose([one.valve for one in air.valves], held, rtol=1e-8)
    if reservoir:
        assert float(air.reservoir) == pytest.approx(store, rel=1e-8)
    if actuator is PAIR:
        assert store < SUPPLY - 0.4 * bar  # it sagged
        told = PAIR.telemetry(air, commands, pressures)
        assert set(told) == {"opening1", "outlet1", "opening2", "outlet2", "reservoir"}
        assert float(told["outlet2"]) == float(air.valves[1].pressure)


def shut(wall, **parts):
    return mk.FlowValve(1e-30, SUPPLY, wall_conductance=wall, **parts)


def test_adiabatic_air_is_compressed_as_p_v_to_the_kappa_and_air_at_a_good_wall_as_isothermal_air():
    for wall, index, growth, tolerance in ((0.0, KAPPA, -1e-4, 1e-9), (500.0, 1.0, -1e-5, 1e-4)):
        (pressure,), _ = integrated(shut(wall), (3 * bar,), (0.0,), 2000, 2.5e-5, growth=growth)
        ratio = VOLUME / (VOLUME + growth * 0.05)
        assert float(pressure + ATMOSPHERE) == pytest.approx((3 * bar + ATMOSPHERE) * ratio**index, rel=tolerance)


@pytest.mark.slow
def test_behind_shut_valves_the_mass_of_the_air_is_constant_and_no_air_is_consumed(knee, load):
    joint = dataclasses.replace(knee, tendon=mk.SeriesSpring(stiffness=2e4, preload=0.0, travel=0.03))
    plant = numeric(mk.JointPlant(joint, load, shut(WALL, dead_volume=3 * cm**3)))
    start = plant.init_state(0.1, (3e5, 4e5))._replace(velocity=jnp.asarray(0.5))
    moved = advance(plant, start, (0.0, 0.0), 0.1)
    masses = []
    for state in (start, moved):
        air = zip(state.pressures, plant.air_volumes(state), state.air.temperatures, strict=True)
        masses.append(
            [float((pressure + ATMOSPHERE) * room.volume / temperature) for pressure, room, temperature in air]
        )
    assert masses[1] == pytest.approx(masses[0], rel=1e-8)
    assert abs(float(moved.air.temperatures[0]) - ROOM) > 0.5


@pytest.mark.parametrize("wall", [0.0, 0.5, 50.0])
def test_the_bound_on_the_rates_of_warm_air_holds_and_is_near(wall):
    valve = mk.PressureRegulator(0.4e-8, SUPPLY, time_constant=50 * ms, band=0.1 * bar, wall_conductance=wall)

    def rates(x, command):
        (rate,), moved = valve.air_rate((x[0],), AirState((x[1],), (), (x[2],)), (command,), (STILL,))
        return jnp.stack([rate, moved.valves[0], moved.temperatures[0]])

    errors = BAND * np.array([-1.5, -0.9, -0.1, -0.01, 0.01, 0.1, 0.9, 1.5])
    pressure, error, temperature = np.meshgrid(
        [20.0, 1e5, 4e5, SUPPLY - 20, SUPPLY + 20], errors, [210.0, ROOM, 400.0], indexing="ij"
    )
    points = np.stack([pressure, pressure + error, temperature], axis=-1).reshape(-1, 3)
    jacobians = jax.jit(jax.vmap(jax.jacfwd(rates)))(points, (pressure + error).ravel())
    fastest = np.abs(np.linalg.eigvals(np.asarray(jacobians))).max()
    assert fastest < valve.fastest_rate_in(VOLUME) < 3 * fastest


def test_the_flow_needed_for_a_rate_covers_isothermal_and_adiabatic_air():
    """With air at the temperature of the wall, the command for a rate of the pressure gives at least that rate."""
    valve = dataclasses.replace(WARM, leak=None)
    for rate, growth in ((4 * bar, 3e-6), (-4 * bar, -3e-6), (4 * bar, -1e-4)):
        pressure, room = jnp.asarray(2.5 * bar), AirVolume(jnp.asarray(VOLUME), jnp.asarray(growth))
        flows = [
            float(dataclasses.replace(PLAIN, polytropic_index=index).needed_flow(pressure, rate, room))
            for index in (1.0, KAPPA)
        ]
        assert abs(float(valve.needed_flow(pressure, rate, room))) == max(map(abs, flows))


def test_a_command_that_rose_and_one_that_fell_to_a_value_differ_by_the_hysteresis():
    """Both slower than the lag; without the tube, in steady state."""
    valve, held = dataclasses.replace(ASYMMETRIC, leak=None), {}
    for begin in (1 * bar, 5 * bar):
        z = jnp.asarray(begin)
        for _ in range(400):
            z = valve.follow(z, 3 * bar, 1 * ms)
        held[begin] = float(z)
    assert held[5 * bar] - held[1 * bar] == pytest.approx(HYSTERESIS, rel=1e-6)
    assert float(valve.rate(jnp.asarray(2.95 * bar), 3 * bar, 0.0)) == 0.0


@pytest.mark.parametrize("critical", [0.1, 0.3, 0.5, 0.7])
def test_the_pressure_behind_a_restriction_is_that_of_its_flow(critical):
    pressure = 3e5
    beyond = np.array([0.9, 1.5, 2.5, 2.95, 2.9995, 3.0, 3.0005, 3.05, 4.0, 9.0, 20.0]) * 1e5
    flows = mass_flow(1e-8, critical, beyond, pressure)
    found = pressure_behind(1e-8, critical, pressure, flows)
    np.testing.assert_allclose(found, np.maximum(beyond, critical * pressure), rtol=1e-7)  # below it flow is choked


@pytest.mark.parametrize("command", [1.0 * bar, 2.7 * bar, 5.0 * bar])
@pytest.mark.parametrize(
    "model",
    [
        TUBE,
        pytest.param(PLAIN, marks=pytest.mark.slow),
        pytest.param(dataclasses.replace(PLAIN, leak=0.1 * C, dead_zone=0.1 * bar), marks=pytest.mark.slow),
    ],
    ids=["tube", "regulator", "leaking"],
)
def test_a_model_predicts_in_steps_of_a_control_period(model, command):
    """Venting and filling, choked and not, with a muscle that grows; a leak of a tube is not in its model."""
    start, number = 2.5 * bar, np.arange(41)
    pressure, state = jnp.asarray(start), model.init_model(jnp.asarray(start))
    muscles, _, held, tubes, _ = follow([model], [start], [command], number * PERIOD, [VOLUME], GROWTH)
    for k in range(40):
        air = AirVolume(jnp.asarray(VOLUME + GROWTH * (k + 0.5) * PERIOD), jnp.asarray(GROWTH))
        pressure, state = model.predict(Point(pressure, state, air), command, PERIOD)
        assert float(pressure) == pytest.approx(muscles[0, k + 1], abs=0.02 * abs(command - start))
        if model is TUBE:
            assert float(state.pressure) == pytest.approx(tubes[0, k + 1], abs=0.05 * abs(command - start))
        else:
            assert float(state) == pytest.approx(held[0, k + 1], rel=1e-6)


@pytest.mark.parametrize("width", [1, 3, 30])
def test_the_pressure_follows_a_target_with_the_lag_behind_narrow_and_wide_tubes(lag_of, width):
    model = mk.Tube(PLAIN, volume=HOLLOW, conductance=width * THIN)
    assert lag_of(model, VOLUME, 12 * ms, PERIOD) == pytest.approx(12 * ms, rel=0.05)


def test_valve_and_tube_in_series_have_one_conductance():
    """1 / C^2 is the sum of both: what a tube attains is what a valve of C / sqrt(2) does, with one dead volume."""
    tube = mk.Tube(PLAIN, volume=HOLLOW, conductance=C, critical_ratio=0.3)
    alone = dataclasses.replace(PLAIN, conductance=C / math.sqrt(2))
    pressure, whole = jnp.asarray(2.5 * bar), AirVolume(STILL.volume + HOLLOW, jnp.zeros(()))
    found, expected = (
        valve.attainable(Point(pressure, valve.init_model(pressure), air), (0.0, 6 * bar), PERIOD)(pressure)
        for valve, air in ((tube, STILL), (alone, whole))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_each_muscle_has_its_own_response_and_limit(knee, load):
    plant = mk.JointPlant(knee, load, LAGGING)
    state = plant.init_state(0.0, (2 * bar, 2 * bar))
    (first, second), _ = LAGGING.all_after(state.pressures, state.air, (3 * bar, 3 * bar), 10 * ms)
    assert float(first) == pytest.approx(3 * bar - bar * math.exp(-0.5), rel=1e-12)
    assert float(second) == pytest.approx(3 * bar - bar * math.exp(-1 / 3), rel=1e-12)
    assert [float(one) for one in plant.clip_commands((5 * bar, 5 * bar))] == [5 * bar, 4 * bar]
    rated = plant.supplied_joint
    assert (float(rated.muscle1.domain.pressure_max), float(rated.muscle2.domain.pressure_max)) == (6 * bar, 4 * bar)
    assert float(LAGGING.lag) == pytest.approx(25 * ms)
    commands = plant.commands_for(state, (bar, bar))
    assert [float(one) for one in commands] == [pytest.approx(2.02 * bar), pytest.approx(2.03 * bar)]


FLOW = mk.FlowValve(1e-9, SUPPLY)
DIRECT, STORED = (
    mk.FlowValve(1e-9, SUPPLY, direct=True),
    mk.FlowValve(1e-9, SUPPLY, reservoir_volume=1e-3, line_conductance=1e-9),
)
RESERVOIR = {"reservoir_volume": 1e-3, "line_conductance": 1e-9}


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: dataclasses.replace(TUBE, volume=0.0), "volume"),
        (lambda: dataclasses.replace(TUBE, conductance=-1e-9), "conductance"),
        (lambda: dataclasses.replace(TUBE, valve=DIRECT), "valve"),
        (lambda: dataclasses.replace(TUBE, valve=TUBE), "valve"),
        (lambda: mk.UnequalValves(FLOW, mk.FirstOrderValve(20 * ms)), "muscle2"),
        (lambda: mk.UnequalValves(FLOW, mk.IdealValve()), "muscle2"),
        (lambda: mk.UnequalValves(FLOW, DIRECT), "muscle2"),
        (lambda: mk.UnequalValves(FLOW, PAIR), "muscle2"),
        (lambda: mk.UnequalValves(STORED, FLOW), "muscle1"),
        (lambda: mk.UnequalValves(FLOW, FLOW, reservoir_volume=1e-3), "line_conductance"),
        (lambda: mk.UnequalValves(mk.FirstOrderValve(0.1), mk.FirstOrderValve(0.1), **RESERVOIR), "reservoir_volume"),
        (lambda: mk.robot.RobotPlant(mk.robot.read_robot("lei-leg-planar"), LAGGING), "valve"),
    ],
)
def test_what_no_actuator_can_be_is_refused(make, field):
    with pytest.raises(RangeError) as caught:
        make()
    assert caught.value.field == field
