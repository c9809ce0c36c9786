"""What is drawn: shares, ranges, the same runs for the same seed; and a run of the arrays is that of its scenario."""

from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben.control import Constant, Multisine, Sine, Step
from mckibben.errors import ParameterError
from mckibben.study.benchmark import NOMINAL_JOINT, Suite, draw
from mckibben.study.benchmark.runs import _as_step_and_sines
from mckibben.study.scenario import Scenario
from mckibben.units import deg, ms

TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
TIMES = np.arange(60) * 2 * ms


@pytest.fixture(scope="module")
def suite():
    return Suite.parse(TEXT)


@pytest.fixture(scope="module")
def runs(suite):
    return draw(suite, 64, 1)


def lane(tree, run):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[run] if np.ndim(leaf) else leaf, tree)


def counted(names):
    return {name: names.count(name) for name in dict.fromkeys(sorted(names))}


def test_joints_and_references_come_in_their_shares(suite, runs):
    assert counted(runs.joint) == {NOMINAL_JOINT: 48, "longer": 16}  # 3 to 1
    assert counted(runs.reference_name) == {"angle step": 16, "both move": 16, "sine and step": 32}  # 1 to 1 to 2
    few = draw(suite, 6, 1)
    assert counted(few.joint) == {NOMINAL_JOINT: 5, "longer": 1}
    assert counted(few.reference_name) == {"angle step": 1, "both move": 1, "sine and step": 4}
    assert runs.count == 64
    assert len(set(zip(runs.joint, runs.reference_name, strict=True))) == 6, "one does not follow from the other"


def test_conditions_fill_their_ranges(runs):
    found = runs.conditions
    assert list(found)[:-1] == [
        "load.mass2",
        "valve.time_constant",
        "sensors.delay",
        "disturbance.pulses.height",
    ]
    for name, low, high in (("load.mass2", 0.25, 0.75), ("valve.time_constant", 0.01, 0.05)):
        cells = np.floor((found[name] - low) / (high - low) * 64)
        assert sorted(cells) == list(range(64)), "a Sobol sequence has one point in each 64th"
    assert counted(found["sensors.delay"].tolist()) == {0.0: 32, 1.0: 32}
    assert counted(found["disturbance.pulses.height"].tolist()) == {0.0: 32, 0.5: 32}


def test_references_fill_their_ranges(runs):
    angle = runs.reference_values["angle step"]
    assert sorted(np.floor((angle["reference.angle.before"] / deg + 5) / 10 * 16)) == list(range(16))
    both = runs.reference_values["both move"]["reference.stiffness.frequency"]
    assert sorted(np.floor(np.log(both / 2) / np.log(3) * 16)) == list(range(16)), "evenly in the logarithm"


def test_fast_sines_are_made_smaller(suite, runs):
    sine = runs.reference_values["sine and step"]
    amplitude, frequency = sine["reference.angle.amplitude"], sine["reference.angle.frequency"]
    max_angular_acceleration = amplitude * (2 * np.pi * frequency) ** 2
    assert max_angular_acceleration.max() == pytest.approx(60.0)
    cut = max_angular_acceleration > 60.0 * (1 - 1e-9)
    assert 0 < cut.sum() < 16
    assert np.all(amplitude[~cut] >= 2 * deg)
    free = draw(suite.model_copy(update={"max_angular_acceleration": None}), 64, 1).reference_values["sine and step"]
    assert np.array_equal(free["reference.angle.frequency"], frequency)
    assert np.array_equal(free["reference.angle.amplitude"][~cut], amplitude[~cut])
    assert np.all(free["reference.angle.amplitude"][cut] > amplitude[cut])


def test_a_sine_that_does_not_differ_is_made_smaller_too():
    text = TEXT.replace(
        "over: [reference.angle.amplitude=2..10 deg, reference.angle.frequency=0.25..4 Hz log, ", "over: ["
    )
    slow = draw(Suite.parse(text), 8, 1)
    assert np.allclose(slow.reference_values["sine and step"]["reference.angle.amplitude"], 5 * deg)  # 3.4 rad/s^2
    fast = draw(Suite.parse(text.replace("frequency: 1 Hz", "frequency: 10 Hz")), 8, 1)
    assert np.allclose(fast.reference_values["sine and step"]["reference.angle.amplitude"], 60 / (20 * np.pi) ** 2)


def test_the_same_seed_draws_the_same(suite, runs):
    again, other = draw(suite, 64, 1), draw(suite, 64, 2)
    assert again.joint == runs.joint
    assert again.reference_name == runs.reference_name
    for mine, same, different in zip(
        *(jax.tree.leaves((each.plant, each.reference)) for each in (runs, again, other)), strict=True
    ):
        assert np.array_equal(mine, same)
        if np.ndim(mine):
            assert np.shape(mine) == (64,)
            assert np.shape(different) == (64,)
    assert other.reference_name != runs.reference_name
    assert not np.array_equal(other.conditions["load.mass2"], runs.conditions["load.mass2"])


def test_each_run_has_noise_of_its_own(suite, runs):
    seeds = runs.conditions["sensors.seed"]
    assert len(set(seeds.tolist())) == 64
    assert not set(seeds.tolist()) & set(draw(suite, 64, suite.tuning.seed).conditions["sensors.seed"].tolist())
    assert "sensors.seed" not in draw(suite.model_copy(update={"sensors": None, "conditions": ()}), 8, 1).conditions
    given = suite.model_copy(update={"conditions": ("sensors.seed=7, 8",)})
    assert set(draw(given, 8, 1).conditions["sensors.seed"].tolist()) == {7, 8}


def test_a_run_of_the_arrays_is_that_of_its_scenario(runs):
    """Every leaf of the plant, and the references at all times; the scenario is written down and read again."""
    for run in range(0, 64, 5):
        scenario = Scenario.parse(runs.scenario("PID 3", run).dumps())
        plant = scenario.plant()
        drawn = lane(runs.plant, run)
        assert jax.tree.structure(plant) == jax.tree.structure(drawn)
        for a, b in zip(jax.tree.leaves(plant), jax.tree.leaves(drawn), strict=True):
            assert np.asarray(a) == pytest.approx(np.asarray(b), rel=1e-14)
        reference, expected = scenario.reference(), lane(runs.reference, run)
        for quantity in ("angle", "stiffness"):
            wanted = np.asarray(getattr(reference, quantity)(TIMES))
            assert wanted == pytest.approx(np.asarray(getattr(expected, quantity)(TIMES)), rel=1e-13, abs=1e-15)
        assert scenario.start.angle == pytest.approx(float(reference.angle(0.0)), abs=1e-15)


def test_a_tuned_controller_is_put_into_the_run(runs):
    plain = runs.scenario("PID 3", 3)
    tuned = runs.scenario("PID 3", 3, {"controller.position.kp": 3e5})
    assert (plain.control().position.kp, tuned.control().position.kp) == (1.2e5, 3e5)
    assert tuned.plant() == plain.plant()


def test_a_run_in_which_nothing_differs_is_the_scenario_as_it_stands(suite):
    reference = suite.references["both move"].model_copy(update={"over": ()})
    bare = suite.model_copy(update={"sensors": None, "conditions": (), "references": {"both move": reference}})
    drawn = draw(bare, 4, 1)
    assert drawn.scenario("PID 3", 2) == bare.scenario("PID 3", "both move", drawn.joint[2])


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        (Constant(2.0), lambda t: 2.0 + 0 * t),
        (Step(1.0, 3.0, 0.05), lambda t: np.where(t < 0.05, 1.0, 3.0)),
        (Sine(2.0, 3.0, 1.0, 0.5), lambda t: 1 + 2 * np.sin(6 * np.pi * t + 0.5)),
        (
            Multisine((1.0, 2.0), (3.0, 4.0), (0.1, 0.2), 5.0),
            lambda t: 5 + np.sin(6 * np.pi * t + 0.1) + 2 * np.sin(8 * np.pi * t + 0.2),
        ),
        (Multisine((1.0,), (3.0,)), lambda t: np.sin(6 * np.pi * t)),
    ],
)
def test_all_references_have_one_form(signal, expected):
    form = _as_step_and_sines(signal, 3)
    assert jax.tree.structure(form) == jax.tree.structure(_as_step_and_sines(Constant(0.0), 3))
    assert np.asarray(form(TIMES)) == pytest.approx(expected(TIMES), abs=1e-13)


def test_joints_that_differ_in_more_than_numbers_are_refused(suite):
    other = suite.other_joints["longer"]
    chou = other.joint.model_copy(update={"muscle": other.joint.muscle.model_copy(update={"law": "chou"})})
    wrong = suite.model_copy(update={"other_joints": {"longer": other.model_copy(update={"joint": chou})}})
    with pytest.raises(ParameterError, match="differ in more than numbers"):
        draw(wrong, 8, 1)
