"""Identification of valves, against pressures that SciPy computes from the flow equations written anew."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy.integrate import odeint

from mckibben import catalog
from mckibben.actuator import FirstOrderValve, FlowValve, PressureRegulator, Tube, UnequalValves
from mckibben.calibration import JointPrior, JointRecording, ValveExperiment, calibrate_valves
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import return_spring
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.result import Severity
from mckibben.scenario import Scenario
from mckibben.units import bar, cm, deg, kPa, ms
from tests.air import ATMOSPHERE, GAS, ROOM, flow

pytestmark = pytest.mark.usefixtures("optimized")  # programs run hundreds of times
PERIOD, NOISE, OFFSET = 8 * ms, 1 * kPa, (0.6 * kPa, -0.9 * kPa)
ENERGY = GAS * ROOM
DATA_SHEET = PressureRegulator(
    0.05 * L_PER_S_BAR, 7 * bar, time_constant=15 * ms, band=0.5 * bar, dead_volume=4 * cm**3
)
TRUE = dataclasses.replace(
    DATA_SHEET,
    conductance=0.036 * L_PER_S_BAR,
    exhaust_conductance=0.028 * L_PER_S_BAR,
    supply=6.2 * bar,
    time_constant=24 * ms,
    band=0.35 * bar,
    leak=2e-4 * L_PER_S_BAR,
    dead_zone=0.04 * bar,
)
DELAY = 3 * PERIOD


def commands(seconds, seed=0):
    """Steps of both pressures every 0.6 s, shape (samples, 2)."""
    count = round(seconds / PERIOD)
    levels = np.random.default_rng(seed).uniform(1.0, 5.5, (count, 2)) * bar
    return levels[(np.arange(count) * PERIOD / 0.6).astype(int)]


def sampled(rate, first, sent):
    """Samples of an integration during which each command acts for a period, `DELAY` later."""
    late, state, found = round(DELAY / PERIOD), np.asarray(first), []
    for k in range(sent.size):
        found.append(state)
        command = sent[max(k - late, 0)]
        state = odeint(rate, state, (0, PERIOD), args=(command,), rtol=1e-8, atol=1e-2, tfirst=True)[-1]
    return np.array(found)


def regulated(sent, volume):
    """Pressures [Pa] of a regulator at a constant volume [m^3]."""

    def rate(_, y, command):
        pressure, lagged = y[0] + ATMOSPHERE, y[1]
        error = lagged - y[0]
        error = math.copysign(max(abs(error) - TRUE.dead_zone, 0.0), error)
        opening = min(max(error / TRUE.band, -1.0), 1.0)
        if opening > 0:
            mass = opening * flow(TRUE.conductance, TRUE.supply + ATMOSPHERE, pressure)
        else:
            mass = opening * flow(TRUE.exhaust_conductance, pressure, ATMOSPHERE)
        mass -= flow(TRUE.leak, pressure, ATMOSPHERE)
        return [1.2 / volume * ENERGY * mass, (command - lagged) / TRUE.time_constant]

    return sampled(rate, [sent[0], sent[0]], sent)[:, 0]


def tubed(sent, volume):
    """Pressures [Pa] of a constant volume [m^3] behind a tube of 6 cm^3 and 0.03 L/(s*bar)."""

    def rate(_, y, command):
        muscle, tube, lagged = y[0] + ATMOSPHERE, y[1] + ATMOSPHERE, y[2]
        opening = min(max((lagged - y[1]) / DATA_SHEET.band, -1.0), 1.0)
        inlet = 7 * bar + ATMOSPHERE if opening > 0 else ATMOSPHERE
        valve = flow(abs(opening) * DATA_SHEET.conductance, inlet, tube)
        through = flow(0.03 * L_PER_S_BAR, tube, muscle)
        changes = 1.2 / volume * ENERGY * through, 1.2 / (6 * cm**3) * ENERGY * (valve - through)
        return [*changes, (command - lagged) / DATA_SHEET.time_constant]

    return sampled(rate, [sent[0]] * 3, sent)[:, 0]


def warmed(sent, volume, wall=0.1):
    """Pressures [Pa] of a regulator at a constant volume [m^3], whose air exchanges heat with a wall [W/K]."""

    def rate(_, y, command):
        pressure, temperature, lagged = y[0] + ATMOSPHERE, y[1], y[2]
        opening = min(max((lagged - y[0]) / TRUE.band, -1.0), 1.0) * TRUE.conductance
        inflow = flow(max(opening, 0.0), TRUE.supply + ATMOSPHERE, pressure)
        outflow = -flow(max(-opening, 0.0), ATMOSPHERE, pressure, temperature=temperature)
        energy = GAS * (inflow * ROOM - outflow * temperature)
        slope = (1.4 * energy + 0.4 * wall * (ROOM - temperature)) / volume
        mass = pressure * volume / (GAS * temperature)
        warming = temperature * (slope / pressure - (inflow - outflow) / mass)
        return [slope, warming, (command - lagged) / TRUE.time_constant]

    return sampled(rate, [sent[0], ROOM, sent[0]], sent)[:, 0]


def recording(sent, pressures, seed=1):
    noise = NOISE * np.random.default_rng(seed).standard_normal(sent.shape)
    return JointRecording(np.arange(len(sent)) * PERIOD, np.zeros(len(sent)), pressures + noise + OFFSET, commands=sent)


@pytest.fixture(scope="module")
def regulators():
    """The valves of the knee at rest at angle 0."""
    joint, sent = catalog.joint("knee-table-2"), commands(8.0)
    contractions = [float(one) for one in joint.contractions(0.0, (0.0, 0.0))]
    muscles = (joint.muscle1, joint.muscle2)
    volumes = [
        float(one.specimen.volume(contraction)) + TRUE.dead_volume
        for one, contraction in zip(muscles, contractions, strict=True)
    ]
    true = [regulated(sent[:, i], volumes[i]) for i in (0, 1)]
    one = recording(sent, np.stack(true, axis=1))
    return calibrate_valves(joint, DATA_SHEET, [one], delay=10 * ms), one, np.stack(true, axis=1)


def remarked(found):
    """Quantities of the remarks that matter."""
    return {remark.field for remark in found.remarks() if remark.severity is not Severity.NOTE}


@pytest.mark.slow
def test_a_regulator_is_found_within_the_intervals(regulators):
    found = regulators[0]
    for name, value in {**{one: getattr(TRUE, one) for one in NAMES}, "delay": DELAY, "pressure_zero": None}.items():
        for number in (1, 2):
            one = found.quantities[f"valve{number}.{name}"]
            true = OFFSET[number - 1] if value is None else value
            assert abs(one.value - true) < 3 * one.deviation
            assert one.determined
    assert found.residual == pytest.approx(NOISE, rel=0.05)
    assert found.noise == pytest.approx(NOISE, rel=0.05)
    assert remarked(found) == set()  # none differs or is far from the data sheet
    assert not found.quantities["valve1.dead_volume"].determined


NAMES = ("conductance", "exhaust_conductance", "band", "time_constant", "dead_zone", "leak")


@pytest.mark.slow
def test_it_simulates_the_pressures_without_their_noise(regulators):
    found, one, true = regulators
    after = round(1 / PERIOD)
    assert np.abs(found.simulate(one) - true - OFFSET)[after:].max() < 2 * NOISE


@functools.cache
def first_order(lags, seconds=8.0):
    sent = commands(seconds)
    rates = [lambda _, y, command, lag=lag: (command - y) / lag for lag in lags]
    true = [sampled(rate, sent[:1, i], sent[:, i])[:, 0] for i, rate in enumerate(rates)]
    return recording(sent, np.stack(true, axis=1))


@pytest.mark.slow
def test_unequal_valves_are_told_apart():
    one = first_order((40 * ms, 55 * ms))
    found = calibrate_valves(catalog.joint("knee-table-2"), FirstOrderValve(0.1), [one])
    for valve, delay, lag in zip(found.valves, found.delays, (40 * ms, 55 * ms), strict=True):
        assert valve.time_constant == pytest.approx(lag, rel=0.02)
        assert delay == pytest.approx(DELAY, rel=0.02)
    assert found.valve == UnequalValves(*found.valves)
    assert found.differing == ("time_constant",)
    assert "time_constant" in remarked(found)
    again = calibrate_valves(catalog.joint("knee-table-2"), found.valve, [one], delay=found.delay)
    for valve, lag in zip(again.valves, (40 * ms, 55 * ms), strict=True):
        assert valve.time_constant == pytest.approx(lag, rel=0.02)
    assert isinstance(again.valve, UnequalValves)
    alike = calibrate_valves(catalog.joint("knee-table-2"), FirstOrderValve(0.1), [first_order((40 * ms, 40 * ms))])
    assert alike.valve.time_constant == pytest.approx(40 * ms, rel=0.02) and alike.differing == ()
    assert list(alike.remarks()) == []


@pytest.mark.slow
def test_a_valve_far_from_its_first_model_is_named():
    found = calibrate_valves(catalog.joint("knee-table-2"), FirstOrderValve(4 * ms), [first_order((40 * ms, 40 * ms))])
    texts = {remark.field: remark.text for remark in found.remarks()}
    for name in ("valve1.time_constant", "valve2.time_constant"):
        assert f"{math.log(10) / 0.7:.1f} prior standard deviations" in texts[name]


@pytest.mark.slow
def test_commands_are_narrowed_by_the_limits_of_the_joint_alone():
    scenario = Scenario.read("examples/calibration/valves.yaml")

    def span(strength):
        parts = ValveExperiment(-10 * deg, 10 * deg, 5.0, strength=strength).scenarios(scenario)
        steps = parts["steps"].controller.pressure1
        return steps.high - steps.low

    whole = span(0.1)
    with pytest.warns(McKibbenWarning, match="range"):  # a stronger muscle holds the joint at 5 to 10 deg
        assert 0.3 * whole < span(0.3) < whole


def with_one_muscle(dead_volume):
    """The knee with a spring in place of its second muscle, of which no valve is identified, and the air's volume."""
    joint = catalog.joint("knee-table-2")
    joint = AntagonisticJoint(joint.geometry, joint.muscle1, return_spring(4e3, 0.13))
    contraction = float(joint.contractions(0.0, (0.0, 0.0))[0])
    return (
        joint,
        float(joint.muscle1.specimen.volume(contraction)) + dead_volume,
        commands(5.6)[:, :1].repeat(2, axis=1),
    )


@pytest.mark.slow
def test_a_tube_is_identified_with_its_valve():
    """Of the equations written anew: the conductance of the tube, and the volume at the valve's outlet."""
    joint, volume, sent = with_one_muscle(0.0)
    one = tubed(sent[:, 0], volume)
    model = Tube(dataclasses.replace(DATA_SHEET, dead_volume=0.0), volume=10 * cm**3, conductance=0.1 * L_PER_S_BAR)
    prior = JointPrior(volume=0.01, zero=1e-3, arm_scale=1e-3)
    found = calibrate_valves(joint, model, [recording(sent, np.stack([one, one], axis=1))], prior, delay=DELAY)
    thin, own = found.quantities["valve1.conductance"], found.quantities["valve1.valve.conductance"]
    assert abs(thin.value - 0.03 * L_PER_S_BAR) < 3 * thin.deviation and thin.determined
    assert abs(own.value - 0.05 * L_PER_S_BAR) < 3 * own.deviation and own.determined
    assert isinstance(found.valve, Tube) and found.residual == pytest.approx(NOISE, rel=0.05)


@pytest.mark.slow
def test_the_wall_of_a_muscle_is_identified_with_its_valve():
    """From a first model with twice the conductance for heat."""
    joint, volume, sent = with_one_muscle(DATA_SHEET.dead_volume)
    pressures = warmed(sent[:, 0], volume)
    model = dataclasses.replace(DATA_SHEET, wall_conductance=0.2)
    found = calibrate_valves(joint, model, [recording(sent, np.stack([pressures, pressures], axis=1))])
    wall = found.quantities["valve1.wall_conductance"]
    assert wall.determined
    assert abs(wall.value - 0.1) < 3 * wall.deviation
    assert found.residual < 1.2 * NOISE


@pytest.mark.slow
def test_a_spring_in_place_of_a_muscle_has_no_valve_and_pressures_that_do_not_follow_are_remarked():
    """The valve of the other muscle is fitted to the pressures of its own, or of the other command."""
    knee, one = catalog.joint("knee-table-2"), first_order((40 * ms, 55 * ms))
    joint = AntagonisticJoint(knee.geometry, return_spring(4e3, 0.13), knee.muscle2)
    for swapped in (False, True):
        sent = one.commands[:, ::-1] if swapped else one.commands
        found = calibrate_valves(joint, FirstOrderValve(0.1), [dataclasses.replace(one, commands=sent)])
        assert found.muscles == (1,)
        assert {name.partition(".")[0] for name in found.quantities} == {"valve2"}
        assert ("residual" in remarked(found)) == swapped


@pytest.mark.parametrize(
    "change",
    [
        {"commands": None},
        {"commands": np.full((1000, 2), 3e5)},
        {"time": np.arange(1000) * 0.02},
        {"time": np.cumsum(np.where(np.arange(1000) == 800, 0.1, PERIOD))},
        None,
    ],
    ids=["no commands", "constant", "sparse", "gap", "no recording"],
)
def test_recordings_that_cannot_identify_a_valve_are_refused(change):
    recordings = [] if change is None else [dataclasses.replace(first_order((40 * ms, 55 * ms)), **change)]
    with pytest.raises(IdentificationError):
        calibrate_valves(catalog.joint("knee-table-2"), FirstOrderValve(0.1), recordings)


@pytest.mark.parametrize(
    "valve", [FlowValve(5e-9, 7e5, direct=True), FlowValve(5e-9, 7e5, reservoir_volume=1e-3, line_conductance=5e-9)]
)
def test_valves_that_cannot_be_identified_are_refused(valve):
    with pytest.raises(IdentificationError):
        calibrate_valves(catalog.joint("knee-table-2"), valve, [first_order((40 * ms, 55 * ms))])
