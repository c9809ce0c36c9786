"""A joint rig that is compiled once: the knee of the examples, 100 ms of its sine."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mckibben.plant import JointPlant, PlantState
from mckibben.rig import PERFECT, ControlProgram, JointLimits, RunPlan, control
from mckibben.rig.backend import Backend
from mckibben.rig.compiled import PlantProgram, StepResult
from mckibben.rig.joint_record import columns
from mckibben.scenario import Scenario
from mckibben.units import bar, deg, ms
from tests.rig.faults import FaultyJoint

EXAMPLE = Path(__file__).parents[3] / "examples" / "pre-contracted-step-pid.yaml"
PERIOD = 1 * ms


class Kept:
    """A recorder that keeps its rows in memory."""

    def __init__(self):
        self.rows, self.events, self.telemetry = [], [], SteadyControl.telemetry

    def append(self, rows):
        self.rows += [list(row) for row in rows]

    def event(self, kind, text="", **data):
        json.dumps(data, allow_nan=False)  # as a recorder does
        self.events.append((kind, text))

    @property
    def columns(self):
        names = [column.name for column in columns(self.telemetry)]
        return dict(zip(names, np.array(self.rows, float).T, strict=True))


class StiffJoint:
    """In place of a `PlantProgram`: the joint stands still, its valves lag by 20 ms. Nothing is compiled."""

    places = (0, 2, 3)

    def state(self, state):
        return np.array([0.0, 0.0, *map(float, state.pressures)])

    def advance(self, state, commands, time):
        (angle, velocity, pressure1, pressure2), (command1, command2) = state.tolist(), commands
        share = 1 - math.exp(-time / 0.02)
        pressure1, pressure2 = pressure1 + share * (command1 - pressure1), pressure2 + share * (command2 - pressure2)
        return np.array([angle, velocity, pressure1, pressure2])


class SteadyControl:
    """In place of a `ControlProgram`: always the same pressures [Pa]."""

    telemetry = ("saturated", "stiffness_estimate")

    def __init__(self, commands=(3 * bar, 3 * bar)):
        self.commands = commands

    def init(self, angle, pressure1, pressure2):
        return None

    def step(self, state, told):
        return StepResult(None, np.array([*self.commands, 0.0, 13.0]))


class Knee(NamedTuple):
    scenario: Scenario
    plant: JointPlant
    start: PlantState
    control: ControlProgram
    moved: PlantProgram

    def joint(self, *, vented=False, sensing=PERFECT, **changes):
        start = None if vented else self.start
        return FaultyJoint(self.plant, period=PERIOD, start=start, sensing=sensing, program=self.moved, **changes)

    def plan(self, periods=100, raising=0, settling=0, reference=None):
        times = np.arange(periods) * PERIOD
        angle = 10 * deg * np.sin(np.pi * times) if reference is None else np.full(periods, reference)
        references = np.stack([angle, np.full(periods, 13.0)], axis=1)
        pressures = tuple(map(float, self.start.pressures))
        return RunPlan(references, PERIOD, raising, settling, pressures, ((0.0, 8 * bar), (0.0, 8 * bar)))

    def run(self, joint=None, *, plan=None, limits=None, recorder=None, **options):
        kept = Kept() if recorder is None else recorder
        joint, kept.telemetry = joint or self.joint(), self.control.telemetry
        outcome = control(joint, self.control, plan or self.plan(), limits or LIMITS, kept, **options)
        return outcome, kept


LIMITS = JointLimits(lowest_angle=-30 * deg, highest_angle=45 * deg, pressure=8.4 * bar)


@pytest.fixture(scope="session")
def stiff():
    """A knee that stands still: cheap enough for hundreds of runs."""
    scenario = Scenario.read(EXAMPLE)
    plant = scenario.plant()
    start = PlantState(np.asarray(0.0), np.asarray(0.0), (np.asarray(3 * bar), np.asarray(3 * bar)))
    return Knee(scenario, plant, start, SteadyControl(), StiffJoint())


_MUSCLE = "  muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"
_MUSCLES = """  muscle1: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n,
    friction: {half_width: 7.5 N, presliding_length: 0.5 mm}}
  muscle2: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n, creep: {stiffness: 500 N/m, time_constant: 0.2 s}}
"""
_SLIDING = """controller:
  class: decoupling
  feedback: {class: sliding, slope: 40 1/s, reach: 250 rad/s^2}
  observer: {bandwidth: 200 rad/s}
  pressure_observer: {bandwidth: 200 rad/s}

"""


@pytest.fixture(scope="session")
def knee():
    """All that has a memory: friction, creep, sliding mode, observers. The tests of `rig control` run two PIDs."""
    text = EXAMPLE.read_text(encoding="utf-8").replace(_MUSCLE, _MUSCLES.rstrip())
    before, after = text.index("controller:"), text.index("reference:")
    scenario = Scenario.parse(text[:before] + _SLIDING + text[after:])
    plant = scenario.plant()
    return Knee(scenario, plant, scenario.initial(plant), ControlProgram(scenario.control()), PlantProgram(plant, 4))


class Borrowed(Backend):
    """The values come from elsewhere, all optional members are the defaults."""

    def __init__(self, other, port):
        self.other, self.port = other, port
        self.rate, self.patience = other.rate, other.patience

    inputs = property(lambda self: self.other.inputs)
    outputs = property(lambda self: self.other.outputs)
    description = property(lambda self: {"kind": "borrowed", "port": str(self.port)})

    def open(self):
        self.other.open()

    def clock(self):
        return self.other.clock()

    def read(self, count, *, timeout=1.0):
        return self.other.read(count, timeout=timeout)

    def set_valves(self, pressures):
        self.other.set_valves(pressures)

    def heartbeat(self):
        self.other.heartbeat()

    def vent(self):
        self.other.vent()

    def close(self):
        self.other.close()
