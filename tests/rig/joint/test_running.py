"""The loop: the numbers of a simulation, its limits, late periods, the approach; and in real time."""

import dataclasses
import math

import numpy as np
import pytest

from mckibben.control.base import Setpoint
from mckibben.errors import RigError, StoppedError
from mckibben.numerics.compiled import numeric
from mckibben.rig import JointLimits, JointSession, Sensing, Timing
from mckibben.rig.control_loop import RunPlan, realtime_process_settings
from mckibben.rig.joint_record import Phase
from mckibben.rig.safety import JointMonitor
from mckibben.units import bar, deg, kPa, ms
from tests.rig.faults import host_delayed, samples_dropped

from .conftest import LIMITS, PERIOD, Kept, SteadyControl


@pytest.fixture(scope="module")
def simulated(knee, short_episode):
    """The same run as a simulation."""
    references = Setpoint(*(np.array(column) for column in knee.plan().references.T))
    plant, control, start, period = numeric((knee.plant, knee.scenario.control(), knee.start, PERIOD))
    return short_episode(plant, control, references, start, period, 4)[1]


@pytest.fixture(scope="module")
def ran(knee):
    return knee.run()


@pytest.mark.slow
def test_unpaced_and_measured_perfectly_it_is_the_simulation(ran, simulated):
    outcome, kept = ran
    columns = {name: values[kept.columns["phase"] == Phase.RUN] for name, values in kept.columns.items()}
    assert outcome.completed and outcome.vented_after < 0.1
    assert np.allclose(columns["angle"], simulated.state.angle, rtol=0, atol=1e-13)
    for name, pressure in zip(("pressure1", "pressure2"), simulated.state.pressures, strict=True):
        assert np.allclose(columns[name], pressure, rtol=1e-11)
    for name, command in zip(("command1", "command2"), simulated.commands, strict=True):
        assert np.allclose(columns[name], command, rtol=1e-11)
    for name, values in simulated.telemetry.items():
        assert np.allclose(columns[f"controller_{name}"], values, rtol=1e-10)


@pytest.mark.slow
def test_the_record_holds_each_sample_once(knee, ran):
    _, kept = ran
    columns = kept.columns
    assert np.array_equal(columns["sample"], np.arange(columns["sample"].size))
    assert [kind for kind, _ in kept.events] == ["opened", "completed", "vented"]


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"highest_angle": 0.5 * deg}, "the angle of 0.5"),
        ({"pressure": 2 * bar}, "the pressure 1 of 3 bar is beyond the limit of 2 bar"),
        ({"pressure_rate": 1e-3 * bar}, "rate of pressure 1"),
        ({"angle_rate": 1 * deg}, "rate of angle"),
    ],
)
def test_beyond_a_limit_it_stops(knee, limits, text):
    given = {"lowest_angle": -30 * deg, "highest_angle": 45 * deg, "pressure": 8.4 * bar} | limits
    joint = knee.joint()
    outcome, kept = knee.run(joint, limits=JointLimits(**given))
    assert outcome.kind == "stopped"
    assert text.replace("3 bar", f"{float(knee.start.pressures[0]) / bar:.4g} bar") in outcome.text
    assert kept.columns["sample"][-1] < 100 + 70


def test_rates_are_those_of_a_straight_line(stiff):
    limits = JointLimits(lowest_angle=-2, highest_angle=2, pressure=9 * bar, angle_rate=2.0)
    monitor = JointMonitor(stiff.joint(), limits, PERIOD)

    def check(i, angle):
        monitor.check_sample(i * PERIOD, [angle, 0.0, 0.0], None, None)

    for i in range(200):
        check(i, 1.99 * i * PERIOD)
    with pytest.raises(StoppedError, match="rate of angle"):
        for i in range(200, 300):
            check(i, 1.99 * 0.2 + 2.02 * (i - 200) * PERIOD)


def test_a_pressure_that_stays_off_its_command_stops_the_run(stiff):
    """By default, 2 bar filtered with 250 ms exceed 1 bar after 250 ms log 2."""
    monitor = JointMonitor(stiff.joint(), JointLimits(lowest_angle=-6, highest_angle=6, pressure=9 * bar), PERIOD)
    with pytest.raises(StoppedError) as caught:
        for i in range(1000):
            monitor.check_sample(i * PERIOD, [0.0, 3e5, 3e5], (3e5, 5e5) if i else None, None)
    assert caught.value.value == pytest.approx(3e5)
    assert i * PERIOD == pytest.approx(0.25 * math.log(2), abs=3 * PERIOD)


@pytest.mark.parametrize("command", [(math.nan, 3e5), (3e5, math.inf)])
def test_a_command_that_is_no_number_vents(stiff, command):
    outcome, _ = stiff._replace(control=SteadyControl(command)).run()
    assert outcome.kind == "stopped" and "the controller commands" in outcome.text


def test_commands_beyond_what_the_specimens_bear_are_cut_off(stiff):
    outcome, kept = stiff._replace(control=SteadyControl((3 * bar, 9 * bar))).run(plan=stiff.plan(20))
    assert outcome.completed
    assert kept.columns["command2"][:20].tolist() == [8 * bar] * 20
    assert kept.columns["limited"][:20].all()


def test_an_estimate_gets_all_samples_under_control_and_its_numbers_become_the_controllers(stiff):
    class Estimate:
        rows = np.zeros((0, 4))

        def add(self, samples):
            self.rows = np.concatenate([self.rows, samples])
            return np.array([7.0]) if len(self.rows) > 600 else None

    estimate, program = Estimate(), SteadyControl()
    plan = stiff.plan(1500, raising=20, settling=10)
    outcome, kept = stiff._replace(control=program).run(plan=plan, service=estimate)
    assert outcome.completed and program.numbers.tolist() == [7.0]
    columns = kept.columns
    controlled = np.isin(columns["phase"], [Phase.SETTLING, Phase.RUN])
    handed = np.stack([columns[name][controlled] for name in ("read_at", "angle", "pressure1", "pressure2")], axis=1)
    np.testing.assert_array_equal(estimate.rows[:, 1:], handed[: len(estimate.rows), 1:])
    assert len(estimate.rows) == 1500  # the last 10 are not a whole half of a second


def test_a_late_loop_takes_the_newest_sample_and_tells_how_long_it_took(stiff):
    told = []

    class Listening(SteadyControl):
        def step(self, state, inputs):
            told.append(inputs[5])
            return super().step(state, inputs)

    joint = stiff.joint(faults=[host_delayed(60 * PERIOD, 5.5 * PERIOD)])
    outcome, kept = stiff._replace(control=Listening()).run(joint, plan=stiff.plan(100))
    assert outcome.completed
    columns = kept.columns
    skipped = np.flatnonzero(np.isnan(columns["commanded_at"][:100]))
    assert skipped.tolist() == [61, 62, 63, 64]  # 60 came late itself
    assert max(told) == pytest.approx(5 * PERIOD) and len(told) == 96
    timing = Timing.of(columns, PERIOD)
    assert (timing.periods, timing.missed, timing.skipped, timing.dropped) == (100, 5, 4, 0)
    assert timing.lateness[-1] == pytest.approx(5.5 * PERIOD)


def test_dropped_samples_are_counted(stiff):
    joint = stiff.joint(faults=[samples_dropped(10 * PERIOD, 3)])
    outcome, kept = stiff.run(joint, plan=stiff.plan(40))
    timing = Timing.of(kept.columns, PERIOD)
    assert outcome.completed
    assert (timing.periods, timing.missed, timing.dropped) == (40, 4, 4)  # three, and the one that waited


def test_from_vented_the_pressures_rise_in_a_straight_line(stiff):
    plan = stiff.plan(20, raising=200, settling=30)
    outcome, kept = stiff.run(stiff.joint(vented=True), plan=plan)
    columns = kept.columns
    assert outcome.completed
    assert columns["pressure1"][0] == pytest.approx(0.0, abs=1.0)
    assert np.allclose(np.diff(columns["command1"][:200]), 3 * bar / 200)
    assert columns["command1"][199] == pytest.approx(3 * bar)
    assert np.isnan(columns["desired_angle"][:200]).all()
    assert np.array_equal(columns["phase"][:250], np.repeat([0, 1, 2], [200, 30, 20]))
    assert np.allclose(columns["desired_angle"][200:231], plan.references[0, 0])


def test_what_does_not_fit_is_refused_before_anything_moves(stiff, monkeypatch):
    with pytest.raises(RigError, match="control period is 2 ms"):
        stiff.run(plan=dataclasses.replace(stiff.plan(), period=2 * ms))
    with pytest.raises(RigError, match="watchdog of the rig expires"):
        stiff.run(stiff.joint(patience=2 * PERIOD))
    joint = stiff.joint()
    monkeypatch.setattr(type(joint), "inputs", joint.inputs[:2])
    with pytest.raises(RigError, match="a joint needs angle, pressure1, pressure2"):
        stiff.run(joint)


def test_sensors_have_the_noise_and_the_steps_that_they_are_said_to(stiff):
    settings = {"sensing": Sensing(angle_step=0.1 * deg, pressure_noise=4 * kPa), "seed": 3, "patience": 10.0}
    joint, again = stiff.joint(**settings), stiff.joint(**settings)
    joint.open()
    again.open()
    values = joint.read(4000).values
    pressure = values[:, 1]
    assert np.std(pressure) == pytest.approx(4 * kPa, rel=0.05)
    assert np.mean(pressure) == pytest.approx(3 * bar, abs=0.3 * kPa)
    assert len(set(values[:, 0])) == 1
    assert np.array_equal(again.read(4000).values, values)


def test_an_exception_in_the_record_of_an_exception_still_closes(stiff):
    class Broken(Kept):
        def event(self, kind, text="", **data):
            if kind == "failed":
                raise MemoryError
            super().event(kind, text, **data)

    def progress(shown):
        raise ZeroDivisionError

    joint = stiff.joint()
    with pytest.raises(MemoryError):
        stiff.run(joint, recorder=Broken(), progress=progress)
    assert not joint.is_open


def test_there_is_no_heartbeat_after_the_vent(stiff):
    """So that a rig whose vent does nothing vents by itself."""
    joint = stiff.joint(patience=60 * ms)
    joint.vent = lambda: None
    outcome, _ = stiff.run(joint)
    assert outcome.completed and 60 * ms < outcome.vented_after < 200 * ms


def test_in_real_time_it_takes_the_time_that_it_says(stiff):
    with realtime_process_settings():
        outcome, kept = stiff.run(stiff.joint(paced=True, patience=1.0), plan=stiff.plan(300), limits=_patient())
    columns = kept.columns
    assert outcome.completed
    run = columns["phase"] == Phase.RUN
    assert np.array_equal(columns["sample"], np.arange(columns["sample"].size))
    assert (columns["read_at"][run] >= columns["time"][run]).all()
    assert 0.299 <= columns["read_at"][run][-1] < 1.0
    timing = Timing.of(columns, PERIOD)
    assert timing.periods == 300 and timing.lateness[0] < 20e-3


def _patient():
    """RigLimits for a machine that others use."""
    return JointLimits(lowest_angle=-1.0, highest_angle=1.0, pressure=9 * bar, late=1.0, pressure_error=9 * bar)


class SlowBackend:
    """A line of 80 ms, of which only the status is asked."""

    physical, latency = True, 80 * ms

    def status(self):
        yield from ()


@pytest.mark.parametrize(
    ("changes", "problems", "lenient"),
    [({}, 1, False), ({"late": 0.1}, 0, False), ({"late": 1.0}, 0, True), ({"late": 0.1, "silence": 1.0}, 0, True)],
)
def test_the_status_names_a_slow_line_and_limits_that_hide_it(changes, problems, lenient):
    limits = dataclasses.replace(LIMITS, **changes)
    plan = RunPlan(np.zeros((1, 2)), 1e-3, 0, 0, (0.0, 0.0), ())
    session = JointSession(None, None, None, None, SlowBackend(), limits, plan, None, {})
    rows = list(session.status())
    assert sum(bool(row.problem) for row in rows) == problems
    assert bool(session.leniency) == lenient == any(row.name == "limits" for row in rows)
