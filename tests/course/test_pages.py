"""What the pages of the labs compute when sliders are moved, in Node, against the same in Python."""

import sys
from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben.leg import Ground, LegPlant, LegStart, PressureSchedule, read_leg, simulate_leg
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.scenario.values import with_values
from mckibben.units import bar, deg, mm, ms
from tests.report.test_explorers import needs_node, run

pytestmark = [pytest.mark.slow, needs_node]
COURSE = Path(__file__).parents[2] / "course"
TO_THE_END = """const [low, high, count] = options.range, found = [];
    if (module.init) module.init(self);
    for (let k = 0; k < count; ++k) found.push(module.row(self, low + (high - low) * k / (count - 1)));
    say([found, module.summary(self)]);"""


@pytest.fixture(scope="module")
def pages():
    sys.path.insert(0, str(COURSE))
    import pages

    yield pages
    sys.path.remove(str(COURSE))


def knee(**parts):
    """The scenario of a page, as in the file."""
    path = COURSE.parent / "examples" / "pre-contracted-step-pid.yaml"
    return mk.Scenario.read(path).replace(**parts)


def test_valves_and_delay(pages):
    """A delay and gains that end in a limit cycle."""
    values = {"command_delay": 17.5 * ms, "valve.time_constant": 22 * ms, "controller.position.kp": 2.2 * bar}
    reference = mk.Reference(angle=mk.Sine(amplitude=5 * deg, frequency=0.5), stiffness=mk.Constant(14.0))
    scenario = knee(command_delay=5 * ms, reference=reference, start={"stiffness": 14.0}, duration=4.0)
    result = with_values(scenario, values).simulate()
    rows, summary = run(
        pages.EXPLORERS["valves_and_delay"](),
        TO_THE_END,
        **{name.replace(".", "_"): one for name, one in values.items()},
    )
    metrics = result.metrics
    assert metrics["oscillation_amplitude"] > 1 * deg
    assert summary["amplitude"] == pytest.approx(metrics["oscillation_amplitude"] / deg, rel=1e-3)
    assert summary["frequency"] == pytest.approx(1 / metrics["oscillation_period"], rel=1e-3)
    assert summary["air"] == pytest.approx(metrics["air"] * 1e3, rel=1e-3)
    assert np.allclose([row["command1"] for row in rows], result["command1"], rtol=1e-3)


def test_model_based_control_keeps_its_model(pages):
    """With weaker muscles the angle stays good, and the stiffness does not."""
    summaries = [
        run(pages.EXPLORERS["model_based_control"](), TO_THE_END, joint_muscle_strength=each)[1] for each in (1.0, 0.9)
    ]
    assert summaries[1]["angle"] < 1.1 * summaries[0]["angle"]
    assert summaries[1]["stiffness"] == pytest.approx(1.4, abs=0.1)


def test_jumping_leg(pages):
    leg = read_leg("lei-leg-planar")
    valve = mk.PressureRegulator(0.5 * L_PER_S_BAR, 7 * bar, time_constant=5 * ms, dead_volume=3e-6)
    plant = LegPlant(leg, valve, Ground(20e3, 0.5, friction=0.0))
    levels = tuple((1 * bar, each) for each in (0 * bar, 6 * bar, 0 * bar, 6 * bar))
    schedule = PressureSchedule(levels, ((140 * ms,),) * 4)
    metrics = simulate_leg(plant, schedule, LegStart((0.0, -20 * deg), (1 * bar,) * 4), duration=0.7).metrics
    _, summary = run(pages.EXPLORERS["jumping_leg"](), TO_THE_END, wait=140 * ms)
    assert summary["rise"] == pytest.approx(metrics["take_off_speed"] ** 2 / (2 * 9.81) / mm, rel=0.02)
    assert summary["landing"] == pytest.approx(metrics["peak_landing_force"] / (9.81 * float(leg.total_mass)), rel=0.1)
    assert summary["work"] == pytest.approx(metrics["muscle_work"], rel=0.02)


def test_hysteresis(pages):
    rows, summary = run(pages.EXPLORERS["hysteresis"](), TO_THE_END, half_width=12.0, amplitude=4 * mm)
    muscle = mk.Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), mk.catalog.law("lei-mas-10-180n"))
    slope = -float(muscle.slope(0.08, 4 * bar)) / muscle.specimen.initial_length
    assert summary["isobaric"] == pytest.approx(slope * mm, rel=1e-3)
    assert rows[0]["isobaric"] == pytest.approx(slope, rel=1e-3)
    friction = mk.MaxwellSlip(12.0, 0.6 * mm)
    path = 0.1656 + 4 * mm * np.sin(2 * np.pi * np.linspace(0, 2.75, 441))
    tension = np.asarray(muscle.tension(1 - path / 0.18, 4 * bar))
    expected = tension + friction.path_response(path, tension, 4 * bar)
    assert np.allclose([row["force"] for row in rows[220:]], expected[220:], rtol=1e-6)
    assert summary["energy"] == pytest.approx(1e3 * np.trapezoid(expected[280:] - tension[280:], path[280:]), rel=0.01)


def test_uncertainty(pages):
    """Errors in common make the intervals of the page too narrow, as in the lab."""
    explorer = pages.EXPLORERS["uncertainty"]()
    _, independent = run(explorer, TO_THE_END)
    _, common = run(explorer, TO_THE_END, common=2.0)
    assert independent["coverage"] == pytest.approx(95, abs=4)
    assert common["coverage"] < 88
    points = run(explorer, "say(module.points(self).points);", scatter=0.0, common=0.0, outlier=30.0)
    assert sorted(points["measured"])[-2:] == [0.0, 30.0]
    rows = run(explorer, "say([0.03, 0.1].map((x) => module.row(self, x)));", scatter=2.0, pressure=3 * bar)
    shapes = [lambda x: x * 0 + 1, lambda x: x, lambda x: np.exp(-mk.catalog.law("lei-mas-10-180n").decay * x)]
    at, pressure = (np.ravel(each) for each in np.meshgrid(np.linspace(0, 0.12, 8), np.arange(2.0, 7.0)))
    matrix, new = (
        np.column_stack([column for shape in shapes for column in (shape(x), shape(x) * p)])
        for x, p in ((at, pressure), (np.array([0.03, 0.1]), 3.0))
    )
    leverage = np.sum(new @ np.linalg.inv(matrix.T @ matrix) * new, axis=1)
    confidence, prediction = (
        np.array([row[high] - row[low] for row in rows]) for low, high in (("low", "high"), ("lowest", "highest"))
    )
    assert confidence / prediction == pytest.approx(np.sqrt(leverage / (1 + leverage)), rel=1e-9)


def test_explorers_are_those_of_the_labs(pages):
    sys.path.insert(0, str(COURSE))
    from notebooks import LABS

    assert tuple(pages.EXPLORERS) == LABS
