"""The probe before a run of hardware: it stops at low pressure if channels are swapped, dead or reversed."""

import dataclasses
import math

import numpy as np
import pytest

from mckibben.rig.joint_record import Phase
from mckibben.units import bar, deg
from tests.rig.faults import FaultyJoint, disconnected, supply_lost

from .conftest import StiffJoint

PROBING = 400  # periods


class Turning(StiffJoint):
    """Muscle 1 turns the joint by 10 deg/bar, muscle 2 turns it back."""

    def advance(self, state, commands, time):
        state = super().advance(state, commands, time)
        state[0] = 10 * deg * (state[2] - state[3]) / bar
        return state


class Miswired(FaultyJoint):
    """Its sensors and valves are connected in another order, and its sensors have other gains."""

    order, valves, gains = (0, 1, 2), (0, 1), (1.0, 1.0, 1.0)

    def read(self, count, *, timeout=1.0):
        block = super().read(count, timeout=timeout)
        return block._replace(values=block.values[:, self.order] * self.gains)

    def set_valves(self, pressures):
        super().set_valves([pressures[i] for i in self.valves])


def run(stiff, faults=(), highest=(8 * bar, 8 * bar), **wiring):
    turning = stiff._replace(moved=Turning())
    joint = turning.joint(vented=True, faults=faults)
    joint.__class__ = Miswired
    vars(joint).update(wiring)
    plan = dataclasses.replace(
        turning.plan(30, raising=100, reference=0.0),
        probing=PROBING,
        torques=(1.0, -1.0),
        command_limits=tuple((0.0, high) for high in highest),
    )
    return turning.run(joint, plan=plan)


def test_a_joint_in_order_is_probed_at_low_pressure_and_then_run(stiff):
    outcome, kept = run(stiff)
    assert outcome.completed, outcome.text
    probed = kept.columns["phase"] == Phase.PROBING
    assert probed.sum() == PROBING * 5 / 4 and np.array_equal(kept.columns["sample"], np.arange(len(probed)))
    for name in ("pressure1", "pressure2"):
        assert kept.columns[name][probed].max() == pytest.approx(0.5 * bar, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"order": (0, 2, 1)}, "pressure1"),
        ({"valves": (1, 0)}, "pressure1"),
        ({"order": (0, 2, 1), "valves": (1, 0)}, "angle"),
        ({"gains": (-1.0, 1.0, 1.0)}, "angle"),
        ({"gains": (1.0, 1.0, 0.0)}, "pressure2"),
        ({"order": (0, 1, 1)}, "pressure1"),
        ({"gains": (1.0, math.nan, 1.0)}, "pressure 1 sensor"),
        ({"faults": [disconnected(0.25, "pressure2")]}, "pressure 2 sensor"),
        ({"faults": [supply_lost(0.0)]}, "pressure1"),
    ],
)
def test_wrong_channels_stop_before_the_pressure_rises_above_1_bar(stiff, changes, field):
    outcome, kept = run(stiff, **changes)
    assert outcome.kind == "stopped" and outcome.error.remedy
    assert outcome.error.field == field or field in outcome.text
    commands = np.stack([kept.columns["command1"], kept.columns["command2"]])
    assert not (commands > 0.5 * bar).any()
    assert np.array_equal(kept.columns["sample"], np.arange(kept.columns["sample"].size))
