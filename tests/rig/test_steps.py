"""Steps and whole tests, and what they add up to before anything moves."""

import importlib
import math
from dataclasses import replace

import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.muscle import Muscle
from mckibben.rig import IsobaricProtocol
from mckibben.rig import steps as plan
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.dry_run import dry_run
from mckibben.rig.protocol import IsometricProtocol, IsotonicProtocol, steps_text
from mckibben.rig.simulated import FORCE_SENSOR, PRESSURE_SENSOR, VALVE
from mckibben.units import bar, mm, percent

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
LIMITS = RigLimits(pressure=6.5 * bar, force=630.0, stretch=8 * mm, shorten=50 * mm)
BENCH = Bench(of=MUSCLE, limits=LIMITS)


@pytest.mark.parametrize(
    ("make", "field", "message"),
    [
        (lambda: plan.Move(to=10.0), "to", "10 % is 0.1"),
        (lambda: plan.Move(to=0.1, speed=0.0), "speed", "0 m/s"),
        (lambda: plan.Dwell(duration=math.nan), "duration", "nan s"),
        (lambda: plan.Pressurise(pressure=math.inf), "pressure", "inf Pa"),
        (lambda: plan.Acquire(samples=0), "samples", "is 0"),
        (lambda: plan.Acquire(samples=10.5), "samples", "is 10.5"),
        (lambda: plan.Acquire(direction="up"), "direction", "'loading'"),
        (lambda: plan.Walk(to=0.1, step=1), "step", "1 mm is 0.001 m"),
        (lambda: plan.Repeat(times=2, steps=()), "steps", "at least one"),
        (lambda: plan.HoldForce(force=-1.0), "force", "-1 N"),
        (lambda: IsometricProtocol(pressures=[1e5, 1e5]), "pressures", "twice"),
        (lambda: IsotonicProtocol(forces=[]), "forces", "give at least one"),
    ],
)
def test_a_step_without_a_meaning_is_refused(make, field, message):
    with pytest.raises(RangeError) as refused:
        make()
    assert refused.value.field == field and message in str(refused.value)


def test_the_papers_test_adds_up():
    protocol = IsobaricProtocol(contraction_min=0.0, contraction_max=24.5 * percent, slack_steps=44)
    found = dry_run(protocol.steps_for(MUSCLE), BENCH)
    assert found.problems == []
    assert (found.plateaus, found.samples) == (5850, 5_850_000)
    # 13 times: 130 times 44 steps of 10 s and 45 points of 1 s, 5 s of waiting, and what setting a pressure takes
    least = 13 * 10 * (44 * 10 + 45) + 13 * 5
    assert least < found.duration < least + 13 * (250 + 60)
    assert found.travel > 13 * 10 * 44 * mm
    assert found.force == pytest.approx(584.7, abs=0.1)
    assert not found.estimated


def test_a_test_and_its_plan_have_the_same_plateaus():
    protocol = IsobaricProtocol()
    assert dry_run(protocol.steps_for(MUSCLE), BENCH).plateaus == len(protocol.plateaus(MUSCLE).time)


def test_without_a_law_the_whole_stroke_is_the_upper_bound():
    bench = replace(BENCH, of=MUSCLE.specimen)
    protocol = IsobaricProtocol(pressures=[6 * bar], repeats=2)
    found = dry_run(protocol.steps_for(bench.of), bench)
    assert found.estimated and found.problems == []
    assert found.plateaus == 4 * 51
    assert "force: 598.5 N" in steps_text(protocol.steps_for(bench.of))


@pytest.mark.parametrize("protocol", [IsometricProtocol(), IsotonicProtocol()])
def test_the_other_tests_suit_the_papers_muscle(protocol):
    found = dry_run(protocol.steps_for(MUSCLE), BENCH)
    assert found.problems == []
    assert found.force < 630 and found.plateaus > 50


def test_every_limit_is_held_against_the_steps():
    steps = (
        plan.Move(to=26 * percent, speed=6 * mm),
        plan.Pressurise(pressure=7 * bar),
        plan.Move(to=-3 * percent),
        plan.Walk(to=0.0, step=1.001 * mm, acquire=plan.Acquire(samples=700)),
    )
    found = dry_run(steps, BENCH).problems
    assert sorted(problem.field for problem in found) == [
        "[0].move.speed",
        "[0].move.to",
        "[1].pressurise.pressure",  # of the law's domain, and of the limits
        "[1].pressurise.pressure",
        "[2].move",  # 982 N
        "[3].walk.acquire.samples",
    ]
    assert all(problem.remedy for problem in found)


def test_a_way_longer_than_the_travel_is_refused():
    short = replace(BENCH, limits=replace(LIMITS, shorten=20 * mm, stretch=2 * mm))
    found = dry_run((plan.Walk(to=20 * percent), plan.Move(to=-2 * percent)), short).problems
    assert [problem.field for problem in found] == ["[0].walk.to", "[1].move.to"]
    assert "limits.shorten" in found[0].remedy and "limits.stretch" in found[1].remedy


def test_limits_beyond_muscle_and_sensors_are_refused():
    small = FORCE_SENSOR.channel._replace(low=-500.0, high=500.0), PRESSURE_SENSOR.channel, VALVE
    wide = replace(BENCH, limits=replace(LIMITS, force=700.0, pressure=12 * bar))
    found = dry_run([plan.Dwell(duration=1.0)], wide, small).problems
    assert [problem.field for problem in found] == ["limits.force", "limits.pressure", "rig.force", "rig.pressure"]
    assert "700 N is above 630 N" in found[0].message and "700 N is outside -500..500 N" in found[2].message


def test_a_force_that_cannot_be_held_is_refused():
    (problem,) = dry_run([plan.Pressurise(pressure=1 * bar), plan.HoldForce(force=500.0)], BENCH).problems
    assert problem.field == "[1].hold_force" and problem.remedy


def test_the_cycle_has_to_fit_into_the_patience():
    (problem,) = dry_run([plan.Dwell(duration=1.0)], replace(BENCH, cycle=0.6), patience=1.0).problems
    assert problem.field == "recording.cycle" and problem.remedy


@pytest.mark.parametrize(
    ("steps", "place"),
    [
        ([plan.Move(to=1 * percent), plan.Move(to=0.1, speed=1e-33)], "[1].move"),
        ([plan.Move(to=0.1, speed=1e-320)], "[0].move"),
        (
            [plan.Repeat(times=10_000, steps=(plan.Move(to=0.1, speed=1e-6), plan.Move(to=0.0)))],
            "[0].repeat.steps[1].move",
        ),
    ],
)
def test_a_test_that_would_take_years_is_refused(steps, place):
    problems = dry_run(steps, BENCH).problems
    (problem,) = [one for one in problems if "year" in one.message]
    assert problem.field == place
    assert problem.remedy


def test_more_steps_or_points_than_a_test_may_have_are_refused_before_they_are_done(monkeypatch):
    monkeypatch.setattr(importlib.import_module("mckibben.rig.dry_run"), "MOST_POINTS", 3_000)
    steps = (plan.Vent(),)
    for _ in range(8):
        steps = (plan.Repeat(times=10_000, steps=steps),)
    (problem,) = dry_run((plan.Vent(), *steps), BENCH).problems
    assert problem.field.startswith("[1].repeat.steps[0]") and "3000" in problem.message
    back = plan.Repeat(times=100, steps=(plan.Walk(to=None, step=0.025 * mm),))  # leads back only every other time
    (problem,) = dry_run([plan.Move(to=0.1), plan.Walk(to=0.12, step=0.025 * mm), back], BENCH).problems
    assert problem.field == "[2].repeat.steps[0].walk"


def test_a_walk_back_returns_to_where_the_one_before_began():
    found = dry_run((plan.Move(to=2 * percent), plan.Walk(to=10 * percent), plan.Walk(to=None), plan.Vent()), BENCH)
    assert found.plateaus == 2 * 15
    assert found.travel == pytest.approx(3.6 * mm + 2 * 14 * mm)
