"""Stiffness bands along a trajectory against the paper's equations in plain NumPy, and against a simulation."""

import equinox as eqx
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, FlowValve, IdealValve
from mckibben.control import Constant, Reference, Samples, Sine, Step
from mckibben.errors import RangeError, ReachabilityWarning, SimulationError
from mckibben.joint import AntagonisticJoint, SeriesSpring
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.numerics.compiled import jit
from mckibben.plant import JointPlant, PlantState
from mckibben.reachability import check_trackability, reference_trajectory, static_envelope
from mckibben.reachability.trackability import MAX_SMOOTHING, bands_along
from mckibben.simulation import check_reference, simulate
from mckibben.units import bar, deg

PERIOD = 0.01
TIMES = np.arange(200) * PERIOD


def on(plant: JointPlant, reference: Reference, **options):
    """All with as many moments: they share what is compiled."""
    return check_trackability(plant, reference, duration=2.0, control_period=PERIOD, **options)


@jit
def attainable(joint, angle, torque):
    return joint.attainable_stiffness(angle, torque)


class Tried:
    """The states of a motion by plain NumPy: pressures for torque and stiffness are those of a 2x2 system."""

    def __init__(self, paper, amplitude, frequency, lag):
        self.paper, self.a, self.w, self.lag = paper, amplitude, 2 * np.pi * frequency, lag

    def pressures(self, time, stiffness):
        angle = self.a * np.sin(self.w * time)
        acceleration = -(self.w**2) * angle
        velocity = self.a * self.w * np.cos(self.w * time)
        paper = self.paper
        torque = paper.inertia * acceleration + paper.damping * velocity - paper.G * np.sin(np.pi / 6 - angle)
        eps, arms = paper.contractions(angle), paper.eq5(angle)

        def at(p):
            pulls = [paper.eq3(e, q) * d for e, q, d in zip(eps, p, arms, strict=True)]
            return pulls[1] - pulls[0], paper.stiffness(angle, p)

        zero, one, two = at((0.0, 0.0)), at((1.0, 0.0)), at((0.0, 1.0))
        matrix = np.array([[one[k] - zero[k], two[k] - zero[k]] for k in (0, 1)])
        wanted = np.array([torque - zero[0], stiffness - zero[1]])
        pressures = np.linalg.solve(matrix, wanted)
        forces = [paper.eq3(e, p) for e, p in zip(eps, pressures, strict=True)]
        inside = all(-0.03 <= e <= 0.25 for e in eps)
        return pressures, inside and min(forces) >= 0 and max(forces) <= 630 and min(pressures) >= 0 and max(
            pressures
        ) <= 6e5

    def allowed(self, time, stiffness):
        """Whether it is attainable moving, and at the speed of the valve; the stiffness is kept."""
        pressures, held = self.pressures(time, stiffness)
        h = 1e-5
        rate = (self.pressures(time + h, stiffness)[0] - self.pressures(time - h, stiffness)[0]) / (2 * h)
        commands = pressures + self.lag * rate
        return held, held and min(commands) >= 0 and max(commands) <= 8e5


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude", "frequency", "lag"), [(10, 1.5, 1.0), (15, 4.0, 0.02), (15, 0.5, 1.0)])
def test_the_bands_are_those_of_trying_all_stiffnesses(knee, load, paper_precontracted, amplitude, frequency, lag):
    plant = JointPlant(knee, load, FirstOrderValve(lag))
    reference = Reference(Sine(amplitude * deg, frequency), 15.0)
    bands = bands_along(plant, reference_trajectory(reference, TIMES, smoothing=0.1))
    tried = Tried(paper_precontracted, amplitude * deg, frequency, lag)
    cut = 0
    for k in range(0, 200, 23):
        grid = np.arange(5.0, 30.0, 0.05)
        moving, driven = np.array([tried.allowed(TIMES[k], value) for value in grid]).T
        for band, allowed in ((bands.dynamic, moving), (bands.rate_limited, driven)):
            if allowed.any():
                assert band.lowest[k] == pytest.approx(grid[allowed].min(), abs=0.051)
                assert band.highest[k] == pytest.approx(grid[allowed].max(), abs=0.051)
            else:
                assert not band.highest[k] - band.lowest[k] > 0.05
        cut += driven.sum() < moving.sum()
    assert cut > 0 or lag < 0.1, "the valve has something to say here"


def test_at_rest_the_bands_are_those_of_the_static_check(plant):
    reference = Reference(Constant(12 * deg), 15.0)
    found, reach = on(plant, reference), check_reference(plant, reference, duration=2.0, control_period=PERIOD)
    for band in (found.bands.static, found.bands.dynamic, found.bands.rate_limited):
        np.testing.assert_allclose(band.lowest, reach.lowest, rtol=1e-6)
        np.testing.assert_allclose(band.highest, reach.highest, rtol=1e-6)
    assert found.trackable and reach.feasible


@pytest.mark.slow
def test_the_commands_of_the_criterion_make_the_plant_follow(knee, load, paper_precontracted, playback):
    lag, a, f = 0.05, 10 * deg, 2.0
    tried = Tried(paper_precontracted, a, f, lag)
    plant = JointPlant(knee, load, FirstOrderValve(lag))
    assert on(plant, Reference(Sine(a, f), 15.0)).trackable
    times = np.arange(501) * 1e-3

    def command(time):
        h = 1e-5
        at = [tried.pressures(time + s, 15.0)[0] for s in (-h, 0.0, h)]
        return at[1] + lag * (at[2] - at[0]) / (2 * h)

    commands = np.array([command(time + 5e-4) for time in times])  # held over a period: its middle counts
    signals = Samples(times, commands[:, 0]), Samples(times, commands[:, 1])
    reference = eqx.tree_at(lambda one: (one.angle, one.stiffness), Reference(0.0, 0.0), signals)
    start = PlantState(0.0, a * 2 * np.pi * f, tuple(tried.pressures(0.0, 15.0)[0]))
    with pytest.warns(ReachabilityWarning):  # the reference is pressures, not an angle and a stiffness
        run = simulate(plant, playback, reference, duration=0.5, initial=start)
    moved = run["angle"]
    np.testing.assert_allclose(moved, a * np.sin(2 * np.pi * f * run["time"]), atol=0.05 * deg)
    np.testing.assert_allclose(run["stiffness"], 15.0, atol=0.02)


def test_a_stiffness_that_changes_costs_the_valve_its_rate(knee, load):
    plant = JointPlant(knee, load, FirstOrderValve(0.1))
    slow = Reference(0.0, Sine(3.0, 0.5, 15.0))
    fast = Reference(0.0, Sine(3.0, 8.0, 15.0))
    assert on(plant, slow).trackable
    found = on(plant, fast)
    assert not found.trackable
    assert found.verdict().startswith("at the rate limit of the valves: the desired stiffness is not attainable for ")
    assert on(JointPlant(knee, load, FirstOrderValve(1e-3)), fast).trackable


def test_the_torque_of_the_motion_is_named_and_may_make_a_stiffness_attainable(plant):
    found, slower = (on(plant, Reference(Sine(20 * deg, frequency), 15.0)) for frequency in (6.0, 2.0))
    assert not found.trackable and "with the torque of the motion, up to " in found.verdict()
    peak = float(plant.load.total_inertia) * 20 * deg * (12 * np.pi) ** 2
    assert np.abs(found.bands.torque).max() == pytest.approx(peak, rel=0.15)
    assert slower.trackable and "dynamically only, not statically" in slower.verdict()


def test_jumps_are_smoothed_no_more_than_necessary(plant):
    found = on(plant, Reference(Step(0.0, 10 * deg, 1.0), 15.0))
    assert found.trackable and 0.05 < found.trajectory.smoothing < 0.2
    assert f"jump or corner at 1 s smoothed over {found.trajectory.smoothing * 1e3:.3g} ms" in found.verdict()
    assert not on(plant, Reference(Step(0.0, 10 * deg, 1.0), 15.0), smoothing=found.trajectory.smoothing / 2).trackable
    far = on(plant, Reference(Step(-30 * deg, 30 * deg, 1.0), 22.0))
    assert not far.trackable and not far.smoothing_sufficient
    assert far.trajectory.smoothing == MAX_SMOOTHING
    assert "jump or corner at 1 s not trackable even when smoothed over 250 ms" in far.verdict()


def test_samples_may_be_many(plant):
    dense = Samples(TIMES, np.asarray(Sine(10 * deg, 0.5)(TIMES)))
    found = on(plant, Reference(dense, 15.0))
    assert found.trackable and "; 197 corners smoothed over 40 ms" in found.verdict()


def test_static_envelope_over_the_angle(plant, paper_precontracted):
    found = static_envelope(plant)
    assert (found.angle_min / deg, found.angle_max / deg) == pytest.approx((-36.49, 38.57), abs=0.01)
    zero = int(np.argmin(np.abs(found.angles)))
    edges = [edge[zero] for edge in (*found.torque_range, *found.stiffness)]
    assert edges == pytest.approx([-7.28, 7.28, 9.96, 19.53], abs=0.01)
    rows = found.table_rows()
    assert len(rows) <= 11 and zero in rows
    for k in rows:
        for stiffness, pressures in (
            (found.stiffness.lowest[k], found.pressures_at_lowest[:, k]),
            (found.stiffness.highest[k], found.pressures_at_highest[:, k]),
        ):
            assert paper_precontracted.torque(found.angles[k], pressures) == pytest.approx(found.torque[k], abs=1e-5)
            assert paper_precontracted.stiffness(found.angles[k], pressures) == pytest.approx(stiffness, abs=1e-4)
            assert pressures.min() > -1e-3 and pressures.max() < 6 * bar + 1e-3
    assert found.map_stiffness.width.shape == found.map_torques.shape
    assert np.nanmin(found.map_stiffness.width) > -1e-9


@pytest.mark.slow
def test_a_joint_with_springs_is_scanned(as_printed, load):
    spring = SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    joint = AntagonisticJoint(as_printed.geometry, as_printed.muscle1, as_printed.muscle2, spring)
    plant = JointPlant(joint, load, IdealValve())
    found = check_trackability(plant, Reference(Sine(10 * deg, 0.5), 17.0), duration=2.0, control_period=0.05)
    assert found.trackable
    np.testing.assert_allclose(found.bands.rate_limited.lowest, found.bands.dynamic.lowest, atol=1e-9)
    for k in (3, 10, 27):
        angle, torque = float(found.trajectory.angle[k]), float(found.bands.torque[k])
        band = [float(x) for x in attainable(joint, angle, torque)]
        seen = found.bands.dynamic.lowest[k], found.bands.dynamic.highest[k]
        assert band[0] - 1e-6 <= seen[0] < band[0] + 0.05 and band[1] - 0.6 < seen[1] <= band[1] + 1e-6


def test_a_smoothing_is_a_positive_time_and_the_period_divides_the_duration(plant):
    for smoothing in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(RangeError, match="the smoothing is"):
            on(plant, Reference(0.0, 15.0), smoothing=smoothing)
    with pytest.raises(SimulationError):
        check_trackability(plant, Reference(0.0, 15.0), duration=1.0, control_period=0.3)


@pytest.mark.slow
def test_with_a_temperature_of_the_air_a_motion_must_suit_isothermal_and_adiabatic_air(as_printed, load):
    """The band with a limited flow is within both, and nearly the narrower one."""
    reference = Reference(Sine(5 * deg, 1.0), 72.8)
    bands = []
    for parts in ({"wall_conductance": 0.5}, {"polytropic_index": 1.0}, {"polytropic_index": 1.4}):
        valve = FlowValve(0.1 * L_PER_S_BAR, 7 * bar, **parts)
        bands.append(on(JointPlant(as_printed, load, valve), reference).bands.rate_limited)
    warm, slow, fast = (np.nan_to_num(one.highest - one.lowest, nan=0.0) for one in bands)
    assert (warm <= np.minimum(slow, fast) + 1e-6).all()
    assert np.minimum(slow, fast).sum() - warm.sum() < 0.05 * warm.sum()
    assert 0 < slow.sum() < 0.7 * fast.sum()


@pytest.mark.slow
@pytest.mark.parametrize("valve", [FlowValve(0.4 * L_PER_S_BAR, 7 * bar), FirstOrderValve(0.02, rate=5 * bar)])
def test_a_limited_flow_or_rate_leaves_slow_motion_trackable(as_printed, load, valve):
    bands = on(JointPlant(as_printed, load, valve), Reference(Sine(1 * deg, 0.5), 72.8)).bands
    assert np.nanmax(np.abs(bands.rate_limited.highest - bands.dynamic.highest)) < 0.1
    assert np.nanmax(np.abs(bands.rate_limited.lowest - bands.dynamic.lowest)) < 0.1
    assert not np.isnan(bands.rate_limited.lowest).any()


@pytest.mark.parametrize("valve", [FlowValve(0.4 * L_PER_S_BAR, 3 * bar), FirstOrderValve(0.02, supply=3 * bar)])
@pytest.mark.slow
def test_all_bands_and_the_envelope_end_at_the_supply(as_printed, load, valve):
    plant = JointPlant(as_printed, load, valve)
    bands, envelope = on(plant, Reference(0.0, 72.8)).bands, static_envelope(plant)
    at_rest = int(np.argmin(np.abs(envelope.angles)))
    for band in bands.static, bands.dynamic, bands.rate_limited:
        assert band.lowest[0] == pytest.approx(envelope.stiffness.lowest[at_rest], abs=0.01)
        assert band.highest[0] == pytest.approx(envelope.stiffness.highest[at_rest], abs=0.01)
    assert np.nanmax(envelope.pressures_at_lowest) == pytest.approx(3 * bar)
    assert (
        envelope.stiffness.lowest[at_rest]
        > static_envelope(JointPlant(as_printed, load, IdealValve())).stiffness.lowest[at_rest] + 1
    )
