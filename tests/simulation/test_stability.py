"""Margins of the linearised loop, against runs of the loop itself."""

import dataclasses
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

import mckibben as mk
from mckibben.actuator import FirstOrderValve, SwitchingValves, UnequalValves
from mckibben.control import ExtendedStateObserver, PressureObserver
from mckibben.plant import SampledSensors
from mckibben.result import Severity
from mckibben.scenario import with_values
from mckibben.simulation import Outcome, disk_margins, margins
from mckibben.simulation.stability import LinearLoop, _crossings, _disk_margins, _frequencies, _margins_of
from mckibben.units import bar, deg, ms

REFERENCE = mk.Reference(angle=mk.Constant(3 * deg), stiffness=15.0)
KICKED = mk.Reference(angle=mk.Step(2.5 * deg, 3 * deg, 0.1), stiffness=15.0)
SETTINGS = {"duration": 0.2, "points": 2}


@pytest.fixture(scope="module")
def loop(knee, load):
    valve = FirstOrderValve(20 * ms)
    parts = {"observer": ExtendedStateObserver(180.0, damping=2.0), "pressure_observer": PressureObserver(180.0)}
    control = mk.DecouplingControl(knee, load, mk.PolePlacement(60.0, damping=2.5), valve=valve, **parts)
    return mk.JointPlant(knee, load, valve), control


@pytest.fixture(scope="module")
def found(loop):
    plant, control = loop
    return margins(plant, control, REFERENCE, plant.equilibrium(3 * deg, stiffness=15.0), **SETTINGS)


@pytest.mark.slow
def test_a_good_loop_is_stable_with_margins(found):
    assert found.time.shape == found.gain.shape == (2,)
    assert (found.radius < 1).all() and (found.disk > 0.3).all()
    assert found.sensitivity.shape == (2, found.frequency.size) and found.loci.shape == (2, found.frequency.size, 2)
    # a disk of alpha contains these gains and phases
    assert (found.gain > (2 + found.disk) / (2 - found.disk)).all()
    assert (found.phase > 2 * np.arctan(found.disk / 2)).all()


@pytest.mark.parametrize(("share", "outcome"), [(0.8, Outcome.COMPLETED), (1.3, Outcome.LIMIT_CYCLE)])
@pytest.mark.slow
def test_the_delay_margin_is_where_runs_become_unstable(loop, found, share, outcome):
    plant, control = loop
    late = dataclasses.replace(plant, command_delay=share * found.delay.min())
    result = mk.simulate(late, control, KICKED, duration=1.5)
    assert (result.outcome is Outcome.LIMIT_CYCLE) == (outcome is Outcome.LIMIT_CYCLE)


@pytest.mark.slow
def test_a_run_that_ends_in_a_limit_cycle_is_not_stable(loop, found):
    """Its points lie along the oscillation, where the commands are at their limits."""
    plant, control = loop
    late = dataclasses.replace(plant, command_delay=np.array([2.0, 0.0]) * found.delay.min())
    settings = {**SETTINGS, "duration": 1.5}
    start = plant.equilibrium(2.5 * deg, stiffness=15.0)
    oscillating = margins(
        dataclasses.replace(plant, command_delay=late.command_delay[0]), control, KICKED, start, **settings
    )
    assert oscillating.oscillation > 0.5 * deg and not oscillating.stable and found.stable
    assert "limit cycle" in oscillating.verdict()
    unstable, stable = disk_margins(late, control, KICKED, start, **{**settings, "points": 2})
    assert unstable <= 0 < stable


@pytest.mark.slow
def test_delays_of_readings_and_commands_take_from_the_delay_margin(loop, found):
    plant, control = loop
    late = dataclasses.replace(plant, sensors=SampledSensors(delay=0.5), command_delay=1.5 * ms)
    again = margins(late, control, REFERENCE, plant.equilibrium(3 * deg, stiffness=15.0), **SETTINGS)
    assert again.delay.min() == pytest.approx(found.delay.min() - 2 * ms, abs=0.05 * ms)


@pytest.mark.slow
def test_switching_valves_have_the_margins_of_their_mean_flow(loop):
    """At each point, also where no period of the modulation begins: further delays of 9 ms are stable, of 20 ms not."""
    plant, control = loop
    one = SwitchingValves(0.055e-8, 7 * bar, period=10 * ms, opening_delay=1 * ms, dead_volume=3e-6)
    pair = dataclasses.replace(plant, valve=UnequalValves(one, one))
    control = dataclasses.replace(
        control,
        feedback=mk.PolePlacement(30.0, damping=2.5),
        observer=ExtendedStateObserver(120.0, damping=2.0),
        pressure_observer=PressureObserver(60.0),
        valve=one,
    )
    found = margins(pair, control, REFERENCE, pair.equilibrium(3 * deg, stiffness=15.0), **SETTINGS)
    assert (found.disk > 0.3).all() and (found.disk < 1).all()
    assert (9 * ms < found.delay).all() and (found.delay < 20 * ms).all()
    for late, stable in ((9 * ms, True), (20 * ms, False)):
        result = mk.simulate(dataclasses.replace(pair, command_delay=late), control, KICKED, duration=1.5, substeps=6)
        assert (result.outcome is not Outcome.LIMIT_CYCLE) == stable


def margins_of(loop, period=1e-3, muscles=()):
    """The columns of `Margins` of one linear loop."""
    columns = _margins_of(LinearLoop(*(leaf[None] for leaf in loop)), period, muscles)
    return SimpleNamespace(**{name: column[0] for name, column in columns.items()})


def test_margins_of_two_integrators_with_a_late_command_are_the_closed_forms():
    """L = k / (z (z - 1)) for each command: |L| = 1 where 2 sin(w/2) = k, with a phase of -(pi + 3 w)/2."""
    gains, period = (0.2, 0.3), 1e-3
    zero = np.zeros((2, 2))
    a = np.block([[np.eye(2), np.eye(2)], [-np.diag(gains), zero]])
    loop = LinearLoop(a, np.concatenate([zero, np.eye(2)]), np.concatenate([-np.diag(gains), zero], axis=1))
    found = margins_of(loop, period)
    turn = np.exp(2j * np.pi * _frequencies(period) * period)[:, None]
    open_loop = np.array(gains) / (turn * (turn - 1))
    crossover = 2 * np.arcsin(np.array(gains) / 2)
    phases = np.pi / 2 - 1.5 * crossover
    np.testing.assert_allclose(np.sort_complex(found.loci), np.sort_complex(open_loop), rtol=1e-9)
    np.testing.assert_allclose(found.sensitivity, np.abs(1 / (1 + open_loop)).max(axis=1), rtol=1e-9)
    assert found.radius == pytest.approx(max(np.abs(np.roots([1, -1, k])).max() for k in gains))
    assert found.gain == pytest.approx(1 / max(gains), rel=0.01)
    assert found.phase == pytest.approx(phases.min(), rel=5e-5)
    assert found.delay == pytest.approx((phases / crossover).min() * period, rel=5e-5)
    assert found.disk == pytest.approx(1 / np.abs(1 / (1 + open_loop) - 0.5).max(), rel=1e-4)


def test_margins_are_those_at_the_crossover_and_not_where_the_gain_is_flat():
    """A locus with a gain of 1.5 that falls below 1 late, where its phase has moved away from -180 degrees."""
    angles, period = np.linspace(1e-9, np.pi, 1500), 1e-3
    ahead = angles + 0.2 * np.sin(angles)
    locus, crossover = 1.5 * np.exp(-0.7 * angles**4) * np.exp(-1j * (np.pi - ahead)), (np.log(1.5) / 0.7) ** 0.25
    loci = np.stack([locus, -0.1 * locus], axis=1)[None]
    (gain,), (phase,), (delay,) = _crossings(-loci / (1 + loci), angles, period)
    assert gain == np.inf
    assert phase == pytest.approx(crossover + 0.2 * np.sin(crossover), rel=1e-4)
    assert delay == pytest.approx((1 + 0.2 * np.sin(crossover) / crossover) * period, rel=1e-4)


def test_margins_take_no_call_for_each_frequency():
    """A point costs its Schur decomposition alone, of two commands at 800 frequencies."""

    def calls(points: int) -> int:
        events: list[str] = []
        turn = np.array([[0.9, 0.3], [0.0, 0.7]]) * np.linspace(0.8, 0.99, points)[:, None, None]
        loops = LinearLoop(turn, *2 * [np.broadcast_to(0.1 * np.eye(2), turn.shape)])
        _margins_of(loops, 1e-3)
        sys.setprofile(lambda _, event, __: events.append(event))
        _margins_of(loops, 1e-3)
        sys.setprofile(None)
        return len(events)

    assert calls(40) - calls(10) < 30 * 200


@pytest.mark.slow
def test_the_verdict_says_where_the_loop_is_open(found):
    assert not list(found.remarks())
    opened = margins_of(LinearLoop(0.9 * np.eye(2), np.zeros((2, 2)), np.ones((2, 2)))).disk
    assert opened == pytest.approx(2.0)
    both = dataclasses.replace(found, disk=np.array([0.4, opened]))
    assert both.verdict().startswith("stable at all 2 points")
    assert "at 1 of the points the loop is open" in both.to_text(width=200)


def test_a_loop_that_is_open_to_rounding_has_an_infinite_gain_margin():
    a, b, c = np.array([[0.9, 0.1], [0.0, 0.9]]), np.diag([0.0, 1e-13]), np.array([[0.0, 0.0], [-1.0, 0.0]])
    assert margins_of(LinearLoop(a, b, c)).gain == np.inf
    assert margins_of(LinearLoop(a, 1e13 * b, c)).gain < 10


def test_an_unstable_loop_has_no_margins():
    found = margins_of(LinearLoop(1.1 * np.eye(2), np.eye(2), -0.1 * np.eye(2)))
    assert found.radius == pytest.approx(1.1)
    assert (found.gain, found.phase, found.delay, found.disk) == (0.0, 0.0, 0.0, 0.0)
    assert np.isfinite(found.sensitivity).all()
    alone = LinearLoop(*(np.stack([leaf]) for leaf in (1.1 * np.eye(2), np.eye(2), -0.1 * np.eye(2))))
    assert _disk_margins(alone, 1e-3) == pytest.approx([-0.1])  # 1 minus the radius, also where no loop is stable
    counter = np.diag([1.0, 0.5, 0.4])
    assert margins_of(LinearLoop(counter, np.eye(3)[:, 1:], -0.1 * np.eye(3)[1:])).radius == pytest.approx(0.5)


def norm_exceeds(loop, size):
    """Whether S - 1/2 exceeds a size at some frequency: unit eigenvalues of a symplectic pencil."""
    (a, b, c), count = loop, len(loop.a)
    scale = 1 / (size**2 - 0.25)
    forward, zero, one = a + scale / 2 * b @ c, np.zeros_like(a), np.eye(count)
    left = np.block([[forward, zero], [-(1 + scale / 4) * c.T @ c, one]])
    right = np.block([[one, -scale * b @ b.T], [zero, forward.T]])
    return bool((np.abs(np.abs(scipy.linalg.eigvals(left, right)) - 1) < 1e-8).any())


@pytest.mark.parametrize("seed", range(6))
def test_the_disk_margin_is_the_inverse_of_the_largest_response_however_narrow_its_peak(seed):
    rng = np.random.default_rng(seed)
    radii, turns = 1 - 10 ** rng.uniform(-4, -0.5, 5), np.exp(rng.uniform(np.log(1e-2), np.log(3), 5))
    turned = [
        r * np.array([[np.cos(v), -np.sin(v)], [np.sin(v), np.cos(v)]]) for r, v in zip(radii, turns, strict=True)
    ]
    mixing = rng.normal(size=(10, 10))
    a = np.linalg.solve(mixing, scipy.linalg.block_diag(*turned) @ mixing)
    loop = LinearLoop(a, rng.normal(size=(10, 2)), 1e-3 * rng.normal(size=(2, 10)))
    found = 1 / margins_of(loop).disk
    assert norm_exceeds(loop, 0.999 * found) and not norm_exceeds(loop, 1.001 * found)


def random_loop(seed):
    """A stable loop of one or two commands, with narrow resonances and slow, fast and alternating real poles."""
    rng, count = np.random.default_rng(seed), 1 + seed % 2
    radii, turns = 1 - 10 ** rng.uniform(-4, -0.3, 3), np.exp(rng.uniform(np.log(1e-2), np.log(3), 3))
    turned = [
        r * np.array([[np.cos(v), -np.sin(v)], [np.sin(v), np.cos(v)]]) for r, v in zip(radii, turns, strict=True)
    ]
    a = scipy.linalg.block_diag(*turned, *rng.choice([0.999999, 0.99, 0.5, -0.5, -0.95], 2))
    mixing = rng.normal(size=a.shape)
    c = 10 ** rng.uniform(-4, -0.5) * rng.normal(size=(count, len(a)))
    return LinearLoop(np.linalg.solve(mixing, a @ mixing), rng.normal(size=(len(a), count)), c)


def least_unstable_factor(loop):
    """Least of many factors of all commands at which the loop is unstable."""
    factors = 1 + np.geomspace(1e-7, 1e4, 2500)
    radii = np.abs(np.linalg.eigvals(loop.a + (factors - 1)[:, None, None] * (loop.b @ loop.c))).max(axis=1)
    return factors[radii >= 1][0] if (radii >= 1).any() else np.inf


def largest_pole_with_delay(loop, periods):
    """Largest modulus of the poles of a loop whose commands arrive some periods later."""
    (a, b, c), count = loop, len(loop.b.T)
    sent = np.eye(periods * count, k=-count)
    late = np.block([[a - b @ c, np.zeros((len(a), periods * count))], [np.zeros((periods * count, len(a))), sent]])
    late[: len(a), -count:], late[len(a) : len(a) + count, : len(a)] = b, c
    return np.abs(np.linalg.eigvals(late)).max()


@pytest.mark.parametrize("seed", range(24))
def test_margins_are_those_by_brute_force_and_of_the_disk(seed):
    loop, period = random_loop(seed), 1e-3
    found = margins_of(loop, period, ("muscle",) * len(loop.c))
    expected = least_unstable_factor(loop)
    assert found.gain == pytest.approx(expected, rel=0.02) or min(found.gain, expected) > 5e3
    assert found.gain - 1 >= 0.98 * (expected - 1) or expected > 5e3
    assert found.gain >= (2 + found.disk) / (2 - found.disk)
    assert found.phase >= 2 * np.arctan(found.disk / 2) * (1 - 1e-3)
    unstable = [late for late in (1, 2, 3, 4) if largest_pole_with_delay(loop, late) >= 1]
    assert not unstable or found.delay <= unstable[0] * period * 1.001


@pytest.mark.parametrize(("gain", "margin"), [(0.5, 2.0), (0.95, 1 / 0.95)])
def test_the_gain_margin_of_a_locus_that_ends_on_the_real_axis(gain, margin):
    """L = k / z ends at -k; a locus of positive feedback begins there."""
    late = LinearLoop(np.array([[-gain]]), np.array([[-gain]]), np.eye(1))
    positive = LinearLoop(np.array([[0.5]]), np.eye(1), np.array([[0.5 / (margin - 1)]]))
    for loop in (late, positive):
        found = margins_of(loop, muscles=("muscle",))
        assert found.gain == pytest.approx(margin, rel=1e-6)
        assert (2 + found.disk) / (2 - found.disk) == pytest.approx(margin, rel=1e-3)


@pytest.mark.parametrize(("direction", "loop"), [((1, 1), "stiffness"), ((1, -1), "angle")])
def test_the_loop_of_a_peak_is_that_of_its_commands(direction, loop):
    """A resonance at 10 Hz that common or opposite pressures excite."""
    turn, push = 2 * np.pi * 10e-3, np.array([direction]) / np.sqrt(2)
    a = 0.999 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    found = margins_of(LinearLoop(a, np.array([[1e-2], [0]]) @ push, push.T @ np.array([[1, 0]])))
    assert (found.peak, found.loop) == (pytest.approx(10, rel=0.01), loop)


@pytest.mark.slow
def test_a_margin_below_the_floor_is_a_severe_remark(found):
    low = dataclasses.replace(found, disk=np.where(found.time == found.time[1], 0.15, found.disk))
    (remark,) = [remark for remark in low.remarks() if remark.field == "disk_margin"]
    assert remark.severity is Severity.SEVERE and not low.ok and low.limit() in remark.text
    assert all(remark.field != "disk_margin" for remark in found.remarks())


def test_units_of_the_states_do_not_matter():
    rng = np.random.default_rng(5)
    a = rng.normal(size=(12, 12))
    loop = LinearLoop(0.9 * a / np.abs(np.linalg.eigvals(a)).max(), rng.normal(size=(12, 2)), rng.normal(size=(2, 12)))
    unit = 10.0 ** rng.integers(-8, 8, 12)
    scaled = LinearLoop(loop.a * unit[:, None] / unit, loop.b * unit[:, None], loop.c / unit)
    found, expected = margins_of(scaled), margins_of(loop)
    assert found.sensitivity == pytest.approx(expected.sensitivity, rel=1e-9)
    assert np.sort(np.abs(found.loci)) == pytest.approx(np.sort(np.abs(expected.loci)), rel=1e-9)


@pytest.mark.slow
def test_the_least_disk_margins_of_a_batch_are_those_of_single_runs_and_zero_beyond_the_delay_margin(loop, found):
    plant, control = loop
    delays = np.array([0.0, 0.5, 0.95, 1.1]) * found.delay.min()
    late = dataclasses.replace(plant, command_delay=delays)
    batch = disk_margins(late, control, REFERENCE, duration=0.2, points=2)
    one = dataclasses.replace(plant, command_delay=float(delays[1]))
    alone = margins(one, control, REFERENCE, plant.equilibrium(3 * deg, stiffness=15.0), **SETTINGS)
    assert batch[:2] == pytest.approx([found.disk.min(), alone.disk.min()], rel=0.02)
    assert batch[0] > batch[1] > batch[2] > 0.0 > batch[3] > -0.1  # the last linear loop is unstable


PERIOD = 1e-3
POLES, OBSERVED, PRESSURE, LAG = 60.0, 160.0, 100.0, 0.02
CONTROLLER = f"""controller:
  class: decoupling
  feedback: {{bandwidth: {POLES} rad/s}}
  observer: {{bandwidth: {OBSERVED} rad/s}}
  pressure_observer: {{bandwidth: {PRESSURE} rad/s}}
reference:
  angle: {{class: step, before: 0 deg, after: 0.2 deg, at: 50 ms}}
  stiffness: 13 N*m/rad
start: {{angle: 0 deg, stiffness: 13 N*m/rad}}
duration: 3 s
control_period: 1 ms
"""


def largest_pole(slower, stiffness, damping):
    """Spectral radius of the loop by hand with valves that many times slower than modelled; per inertia."""
    first, second, third = (float(gain) for gain in ExtendedStateObserver(OBSERVED).gains(PERIOD))
    model, trust = 1 - np.exp(-PERIOD / LAG), 1 - np.exp(-PRESSURE * PERIOD)
    lead = (1 - np.exp(-3 * POLES * PERIOD)) / model

    def period(angle, velocity, torque, angle_, velocity_, disturbance, known, torque_, command):
        torque_ += model * (command - torque_)
        torque_ += trust * (torque - torque_)
        now = torque_ - stiffness * angle - damping * velocity_
        acceleration = (known + now) / 2 + disturbance
        angle_ += PERIOD * (velocity_ + PERIOD / 2 * acceleration)
        innovation = angle - angle_
        angle_ += first * innovation
        velocity_ += PERIOD * acceleration + second * innovation
        disturbance += third * innovation
        ahead = angle_ + velocity_ * PERIOD / (1 - np.exp(-3 * POLES * PERIOD))
        wanted = -POLES * velocity_ - POLES**2 / 3 * angle - disturbance + stiffness * ahead + damping * velocity_
        command = torque_ + lead * (wanted - torque_)
        for _ in range(100):
            step = PERIOD / 100
            velocity += step * (torque - stiffness * angle - damping * velocity)
            angle += step * velocity
            torque = command + (torque - command) * np.exp(-step / (slower * LAG))
        return angle, velocity, torque, angle_, velocity_, disturbance, now, torque_, command

    return np.abs(np.linalg.eigvals(np.array([period(*unit) for unit in np.eye(9)]).T)).max()


@pytest.mark.slow
@pytest.mark.parametrize("slower", [1.0, 2.0, 4.0])
def test_the_largest_pole_with_an_unmodelled_lag_is_that_of_the_loop_written_by_hand(slower):
    text = Path("examples/pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
    scenario = mk.Scenario.parse(text.split("controller:\n")[0] + CONTROLLER)
    plant = scenario.plant()
    state, inertia = plant.equilibrium(0.0, stiffness=13.0), float(plant.load.total_inertia)
    joint = float(plant.stiffness(0.0, state.pressures)) / inertia, float(plant.load.damping) / inertia
    late = with_values(scenario, {"valve.time_constant": slower * LAG}, model_follows=())
    assert late.margins(1).radius[0] == pytest.approx(largest_pole(slower, *joint), abs=1e-6)
