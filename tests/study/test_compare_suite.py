# ruff: noqa: E501 - tables of cases
"""Suite files, with the line and field of each mistake; and their runs, each of which is that of its scenario."""

import dataclasses
import re
from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.errors import ScenarioError, SimulationError
from mckibben.plant import PerfectSensors
from mckibben.scenario import Scenario
from mckibben.study.compare import NOMINAL_JOINT, Suite, draw
from mckibben.units import deg, ms

EXAMPLES = Path(__file__).parents[2] / "examples" / "comparison"
TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
TIMES = np.arange(60) * 2 * ms


@pytest.fixture(scope="module")
def suite():
    return Suite.parse(TEXT)


def changed(*pairs):
    text = TEXT
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def problems(*pairs):
    with pytest.raises(ScenarioError) as caught:
        Suite.parse(changed(*pairs))
    return caught.value.problems


@pytest.mark.slow
def test_what_a_suite_says_comes_back(suite, tmp_path):
    assert Suite.parse(suite.dumps()) == suite
    example = Suite.read(EXAMPLES / "knee.yaml")
    again = Suite.parse(example.dumps(folder=tmp_path), folder=tmp_path)
    assert again == example
    assert len(example.references) == 5
    assert example.evaluation.runs >= 500
    lag = "  - valve.time_constant=10..50 ms\n", ""
    assert Suite.parse(changed(("valve: {time_constant: 20 ms}", "valve: ideal"), lag)).valve == IdealValve()


@pytest.mark.parametrize("controller", ["PID 3", "decoupling"])
def test_controllers_believe_in_the_suites_own_plant(suite, controller):
    """In whatever plant a run has; and two plants whose numbers all differ have the same controller."""
    own = suite.scenario(controller, "angle step")
    other = suite.scenario(controller, "both move", "longer")
    assert other.joint.geometry.connector_length == pytest.approx(0.21)
    assert np.asarray(other.plant().joint.geometry.connector_length) == pytest.approx(0.21)
    heavy = other.model_copy(
        update={"load": dataclasses.replace(other.load, mass2=2.0), "valve": IdealValve(), "sensors": PerfectSensors()}
    )
    first, *others = ([np.asarray(x) for x in jax.tree.leaves(scenario.control())] for scenario in (own, other, heavy))
    assert own.control().model.geometry.connector_length == pytest.approx(0.208)
    for leaves in others:
        assert all(np.array_equal(a, b) for a, b in zip(first, leaves, strict=True))
    if controller == "decoupling":
        control = heavy.control()
        assert float(control.load.mass2) == float(own.plant().load.mass2) == 0.5
        assert float(control.valve.time_constant) == 0.02


def test_what_is_tuned(suite):
    gains = suite.tuned_over("PID 3")
    shown = {gain.name: tuple(round(end, 6) for end in gain.distribution.bounds) for gain in gains}
    assert shown["controller.position.kp"] == (0.12e5, 12e5)  # a decade down and up
    assert "controller.stiffness.kd" not in shown, "a gain of zero stays zero"
    assert len(shown) == 5
    assert suite.tuned_over("as it is") == ()
    assert all(gain.name.startswith("controller.") for gain in suite.tuned_over("decoupling"))
    text = changed(("untuned:", "over: {PID 3: [controller.position.kp=1..2 bar/rad]}, untuned:"))
    (gain,) = Suite.parse(text).tuned_over("PID 3")
    assert gain.distribution.bounds == pytest.approx((1e5, 2e5))


@pytest.mark.slow
def test_a_wrapper_starts_at_the_gains_of_the_loops_within_at_any_depth():
    rival = "PID, feedforward and delay compensated"
    valves = Suite.read(EXAMPLES / "valves.yaml").of_setup("SMC ITV0050")
    inside = valves.tuned_inside(rival, {"PID": {"controller.position.kp": 2e5}, "decoupling": {}})
    assert inside == {"controller.controller.loops.position.kp": 2e5}
    assert inside.keys() <= {swept.name for swept in valves.tuned_over(rival)}


MISTAKES = [
    ([("load.mass2=+-50 %", "controller.position.kp=1..2 bar/rad")], "conditions[0]", "load.mass2", "not a parameter of the plant"),
    ([("sensors.delay=0, 1", "load.mass2=1..2 kg")], "conditions", "conditions:", "varied twice"),
    ([("over: [reference.stiffness.frequency=2..6 Hz log]", "over: [load.mass2=1..2 kg]")], "references.both move.over[0]", "2..6 Hz", "not a parameter of the reference"),
    ([("untuned:", "over: {PID 4: [controller.position.kp]}, untuned:")], "tuning.over.PID 4", "untuned:", "did you mean 'PID 3'"),
    ([("untuned:", "over: {PID 3: [load.mass2=1..2 kg]}, untuned:")], "tuning.over.PID 3", "untuned:", "not a parameter of the controller"),
    ([("untuned: [as it is]", "untuned: [as it iss]")], "tuning.untuned[0]", "untuned:", "did you mean 'as it is'"),
    ([("seed: 1}", "seed: 99}")], "evaluation", "evaluation:", "seed of the tuning"),
    ([("tuning: {runs: 8", "tuning: {cost: coupling, runs: 8")], "tuning.cost", "untuned:", "coupling is defined for stiffness steps"),
    ([("feedback: {bandwidth: 40", "friction_compensation: true\n    feedback: {bandwidth: 40")], "controllers.decoupling.friction_compensation", "feedback: {bandwidth: 40", "no muscle of its model has friction"),
    ([("  as it is:", "  pid-3:"), ("untuned: [as it is]", "untuned: [pid-3]")], "controllers.pid-3", "  as it is:", "the same file as 'PID 3'"),
    ([("  longer:", f"  {NOMINAL_JOINT}:")], "other_joints.nominal", "  longer:", "the suite's own joint"),
    ([("  longer:\n", "  longer:\n    valve: {class: FlowValve, conductance: 1 L/(s*bar), supply: 7 bar, direct: true}\n")], "other_joints.longer", "  longer:", "commands pressures"),
    ([("  longer:\n    joint:\n", "  longer:\n    share: 2\n  short:\n    joint:\n")], "other_joints.longer", "  longer:", "the suite's own plant"),
]  # fmt: skip


@pytest.mark.parametrize(("pairs", "field", "marked", "said"), MISTAKES)
def test_a_mistake_is_told_with_its_line_and_field(pairs, field, marked, said):
    (problem,) = problems(*pairs)
    assert problem.field == field and said in str(problem)
    assert [problem.line] == [i for i, line in enumerate(TEXT.splitlines(), 1) if marked in line]


@pytest.mark.slow
def test_gains_that_are_all_zero_need_a_word():
    zeros = "{kp: 0 bar/rad, ki: 0 bar/(rad*s), kd: 0 bar*s/rad}"
    both = re.sub(
        r"as it is:\n.*\n.*",
        f"as it is:\n    position: {zeros}\n    stiffness: "
        "{kp: 0 bar/(N*m/rad), ki: 0 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad)}",
        TEXT,
    )
    assert Suite.parse(both).tuned_over("as it is") == ()
    with pytest.raises(ScenarioError, match="has no nonzero gain") as caught:
        Suite.parse(both.replace("untuned: [as it is]", "untuned: []"))
    assert [problem.field for problem in caught.value.problems] == ["controllers.as it is"]


def test_runs_have_to_differ():
    text = re.sub(r"conditions:\n(  - .*\n)+", "", TEXT)
    text = re.sub(r"other_joints:\n(  .*\n)+", "", text)
    text = re.sub(r"  (sine and step|angle step):\n(    .*\n)+", "", text)
    text = re.sub(r"    over: .*\n|sensors: .*\n", "", text)
    with pytest.raises(ScenarioError, match="all runs are identical"):
        Suite.parse(text)
    assert Suite.parse(text + "sensors: {pressure_noise: 4 kPa}\n").conditions == ()


# Runs -----------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs(suite):
    return draw(suite, 64, 1)


def counted(names):
    return {name: names.count(name) for name in dict.fromkeys(sorted(names))}


@pytest.mark.slow
def test_joints_and_references_come_in_their_shares(suite, runs):
    assert counted(runs.joint) == {NOMINAL_JOINT: 48, "longer": 16}  # 3 to 1
    assert counted(runs.reference_name) == {"angle step": 16, "both move": 16, "sine and step": 32}  # 1 to 1 to 2
    few = draw(suite, 6, 1)
    assert counted(few.joint) == {NOMINAL_JOINT: 5, "longer": 1}
    assert counted(few.reference_name) == {"angle step": 1, "both move": 1, "sine and step": 4}
    assert runs.count == 64
    assert len(set(zip(runs.joint, runs.reference_name, strict=True))) == 6, "one does not follow from the other"


@pytest.mark.slow
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


def test_the_same_seed_draws_the_same(suite, runs):
    again, other = draw(suite, 64, 1), draw(suite, 64, 2)
    assert again.joint == runs.joint
    assert again.reference_name == runs.reference_name
    for mine, same in zip(*(jax.tree.leaves(each.groups[0].parts.plant) for each in (runs, again)), strict=True):
        assert np.array_equal(mine, same)
    assert other.reference_name != runs.reference_name
    assert not np.array_equal(other.conditions["load.mass2"], runs.conditions["load.mass2"])


def test_each_run_has_noise_of_its_own(suite, runs):
    seeds = runs.conditions["sensors.seed"]
    assert len(set(seeds.tolist())) == 64
    assert not set(seeds.tolist()) & set(draw(suite, 64, suite.tuning.seed).conditions["sensors.seed"].tolist())
    assert (
        "sensors.seed"
        not in draw(suite.model_copy(update={"sensors": PerfectSensors(), "conditions": ()}), 8, 1).conditions
    )
    given = suite.model_copy(update={"conditions": ("sensors.seed=7, 8",)})
    assert set(draw(given, 8, 1).conditions["sensors.seed"].tolist()) == {7, 8}


OTHER_PLANTS = """other_joints:
  other law:
    joint:
      geometry: {from: knee-table-2, connector_length: 208 mm}
      muscle: {specimen: MAS-10-180N-AA-MC-O, law: chou}
  flow valves: {valve: {class: FlowValve, conductance: 0.4 L/(s*bar), supply: 5 bar}}
"""
SIGNALS = """
references:
  random:
    reference:
      angle: {class: random_steps, low: -8 deg, high: 8 deg, dwell: 10 ms, longest_dwell: 30 ms}
      stiffness: {class: ramp, before: 14 N*m/rad, after: 16 N*m/rad, start: 20 ms, duration: 40 ms}
    over: [reference.angle.seed=0..9999, reference.stiffness.duration=10..80 ms]
  recorded:
    reference: {angle: {class: samples_file, file: recorded.csv}, stiffness: 15 N*m/rad}
  sines:
    reference:
      angle: {class: multisine, amplitudes: [3 deg, 1 deg], frequencies: [2 Hz, 5 Hz]}
      stiffness: 15 N*m/rad
    over: [reference.angle.amplitudes.0=1..3 deg]
"""


@pytest.fixture(scope="module")
def mixed():
    """A suite whose plants are of three kinds."""
    start, end = TEXT.index("other_joints:"), TEXT.index("load: knee")
    return Suite.parse(TEXT[:start] + OTHER_PLANTS + TEXT[end:].replace("substeps: 1", "substeps: 8"))


@pytest.fixture
def of_signals(tmp_path):
    """A suite with other random steps for another seed, ramps, samples and single sines."""
    (tmp_path / "recorded.csv").write_text("time_s,angle_deg\n0,1\n0.05,3\n0.1,-2\n")
    text = TEXT[: TEXT.index("references:")] + TEXT[TEXT.index("max_angular_acceleration") :]
    return Suite.parse(re.sub(r"other_joints:\n(  .*\n)+", "", text) + SIGNALS, folder=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["suite", "mixed", "of_signals"])
def test_a_run_of_the_arrays_is_that_of_its_scenario(name, request, tmp_path):
    """Every leaf of the plant, and the references at all times; the scenario is written down and read again."""
    drawn = draw(request.getfixturevalue(name), 12, 1)
    assert [group.joint for group in drawn.groups] == list(dict.fromkeys(drawn.joint))
    assert np.array_equal(np.sort(np.concatenate([group.rows for group in drawn.groups])), np.arange(12))
    for group in drawn.groups:
        for row, run in enumerate(group.rows.tolist()):
            scenario = Scenario.parse(drawn.scenario("PID 3", run).dumps(folder=tmp_path), folder=tmp_path)
            plant, reference = scenario.plant(), scenario.reference()
            lane = jax.tree.map(
                lambda leaf, row=row: np.asarray(leaf)[row] if np.ndim(leaf) else leaf, group.parts.plant
            )
            assert jax.tree.structure(plant) == jax.tree.structure(lane)
            for a, b in zip(jax.tree.leaves(plant), jax.tree.leaves(lane), strict=True):
                assert np.asarray(a) == pytest.approx(np.asarray(b), rel=1e-14)
            for quantity in ("angle", "stiffness"):
                expected, sampled = (getattr(part, quantity) for part in (reference, group.parts.reference))
                np.testing.assert_allclose(sampled.values[row], expected(TIMES), rtol=1e-13, atol=1e-15)
            assert scenario.start.angle == pytest.approx(float(reference.angle(0.0)), abs=1e-15)
    if name == "of_signals":
        rows = np.flatnonzero(np.array(drawn.reference_name) == "random")
        angles = [np.asarray(drawn.groups[0].parts.reference.angle.values[row]).tobytes() for row in rows]
        assert len(set(angles)) == len(angles) == 4


def test_a_frequency_that_no_control_period_resolves_is_refused():
    with pytest.raises(SimulationError) as caught:
        draw(Suite.parse(TEXT.replace("frequencies: [2 Hz, 5 Hz]", "frequencies: [2 Hz, 250 Hz]")), 8, 1)
    assert caught.value.upper == pytest.approx(250.0)


@pytest.mark.slow
def test_a_plant_needs_as_many_substeps_as_its_valve(mixed):
    few = mixed.model_copy(update={"substeps": 1})
    with pytest.raises(SimulationError) as caught:
        draw(few, 20, 1)
    assert caught.value.field == "substeps" and 1 < caught.value.lower <= 8
