"""Many periods at once: the same record, the same stops, the same state afterwards."""

import dataclasses

import numpy as np
import pytest

from mckibben.realtime import SimulatedJoint
from mckibben.realtime.simulated import Sensing
from mckibben.units import bar, deg

from .conftest import LIMITS, PERIOD

TOGETHER = 60


def same(one, other):
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


@pytest.fixture(scope="module")
def both(knee):
    """Outcomes, records and joints of a run period by period, and of many periods together."""

    def run(limits=LIMITS, **changes):
        found = []
        for together in (1, TOGETHER):
            joint = knee.joint(vented=True, sensing=Sensing(), **changes)
            plan = knee.plan(200, raising=70, settling=90)
            outcome, kept = knee.run(joint, plan=plan, limits=limits, together=together)
            found.append((outcome, kept, joint))
        return found

    return run


@pytest.mark.slow
def test_the_record_is_the_same_to_the_last_bit(both):
    (outcome, kept, joint), (together, chunks, other) = both(seed=3)
    assert outcome == together and outcome.completed
    same(kept.columns, chunks.columns)
    assert kept.events == chunks.events
    assert max(len(one["time"]) for one in chunks.tables) == TOGETHER > max(len(one["time"]) for one in kept.tables)
    assert joint.truth == other.truth and joint.clock() == other.clock()


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [
        {"highest_angle": 2 * deg},
        {"pressure": 1 * bar},
        {"pressure_rate": 5 * bar},
        {"pressure_rate": 5 * bar, "window": 2 * TOGETHER * PERIOD},
        {"pressure_error": 0.02 * bar},
    ],
)
def test_it_stops_at_the_same_sample(both, limits):
    (outcome, kept, _), (together, chunks, _) = both(dataclasses.replace(LIMITS, **limits))
    assert outcome.kind == together.kind == "stopped"
    assert outcome.text == together.text
    same(kept.columns, chunks.columns)


@pytest.mark.slow
def test_progress_is_reported_once_for_all_of_them(knee):
    seen = []
    outcome, _ = knee.run(plan=knee.plan(4 * TOGETHER), together=TOGETHER, progress=seen.append)
    assert outcome.completed
    assert len(seen) < TOGETHER
    assert seen[-1].time == pytest.approx((4 * TOGETHER - 1) * PERIOD)


def test_only_an_undisturbed_joint_runs_ahead(stiff):
    assert stiff.joint().can_run_ahead
    assert not stiff.joint(paced=True).can_run_ahead
    delayed = dataclasses.replace(stiff.plant, command_delay=3e-3)
    assert not SimulatedJoint(delayed, period=PERIOD, program=stiff.moved).can_run_ahead
