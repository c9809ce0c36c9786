"""Suite files: what they say comes back to the last bit, and every mistake is told with its line and field."""

import dataclasses
import re
from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.errors import ScenarioError
from mckibben.plant import PerfectSensors
from mckibben.study.compare import NOMINAL_JOINT, Suite, draw
from mckibben.units import ms

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "tests" / "small-suite.yaml").read_text(encoding="utf-8")
REFERENCES = ("sine and step", "angle step", "both move")
WITHOUT_LAG = (("  - valve.time_constant=10..50 ms\n", ""),)


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


def line_of(part):
    (found,) = [i for i, line in enumerate(TEXT.splitlines(), 1) if part in line]
    return found


@pytest.mark.slow
def test_what_a_suite_says_comes_back(suite, tmp_path):
    assert Suite.parse(suite.dumps()) == suite
    example = Suite.read(ROOT / "examples" / "comparison" / "knee.yaml")
    again = Suite.parse(example.dumps(folder=tmp_path), folder=tmp_path)
    assert again == example
    assert len(example.references) == 5
    assert example.evaluation.runs >= 500
    assert Suite.parse(changed(("valve: {time_constant: 20 ms}", "valve: ideal"), *WITHOUT_LAG)).valve == IdealValve()


def test_the_delay_of_the_commands_is_a_condition():
    late = Suite.parse(TEXT.replace("conditions:", "conditions:\n  - command_delay=0..20 ms", 1))
    (delay,) = [one for one in late.conditions_over() if one.parameter.name == "command_delay"]
    assert delay.parameter.shown == "ms"
    assert np.ptp(draw(late, 16, 3).groups[0].plant.command_delay) > 5 * ms
    assert Suite.parse(TEXT + "command_delay: 5 ms\n").example().plant().command_delay == 5 * ms


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
    first, *others = ([np.asarray(x) for x in jax.tree.leaves(each.control())] for each in (own, other, heavy))
    assert own.control().model.geometry.connector_length == pytest.approx(0.208)
    for leaves in others:
        assert all(np.array_equal(a, b) for a, b in zip(first, leaves, strict=True))
    if controller == "decoupling":
        control = heavy.control()
        assert float(control.load.mass2) == float(own.plant().load.mass2) == 0.5
        assert float(control.valve.time_constant) == 0.02


def test_what_is_tuned(suite):
    gains = suite.tuned_over("PID 3")
    shown = {each.name: tuple(round(end, 6) for end in each.distribution.bounds) for each in gains}
    assert shown["controller.position.kp"] == (0.12e5, 12e5)  # a decade down and up
    assert "controller.stiffness.kd" not in shown, "a gain of zero stays zero"
    assert len(shown) == 5
    assert suite.tuned_over("as it is") == ()
    assert all(each.name.startswith("controller.") for each in suite.tuned_over("decoupling"))
    text = changed(("untuned:", "over: {PID 3: [controller.position.kp=1..2 bar/rad]}, untuned:"))
    (one,) = Suite.parse(text).tuned_over("PID 3")
    assert one.distribution.bounds == pytest.approx((1e5, 2e5))


def test_a_wrapper_starts_at_the_gains_of_the_loops_within_at_any_depth():
    rival = "PID, feedforward and delay compensated"
    valves = Suite.read(ROOT / "examples" / "comparison" / "valves.yaml").of_setup("SMC ITV0050")
    inside = valves.tuned_inside(rival, {"PID": {"controller.position.kp": 2e5}, "decoupling": {}})
    assert inside == {"controller.controller.loops.position.kp": 2e5}
    assert inside.keys() <= {swept.name for swept in valves.tuned_over(rival)}
    assert valves.tuning.starts_of[rival] == valves.tuning.starts_of["PID"]


KP = "{kp: 1.2 bar/rad, ki: 40 bar/(rad*s), kd: 0.2 bar*s/rad}"
MISTAKES = {
    "condition": (
        ("load.mass2=+-50 %", "controller.position.kp=1..2 bar/rad"),
        ("conditions[0]", "load.mass2", "not a parameter of the plant"),
    ),
    "condition twice": (
        ("sensors.delay=0, 1", "load.mass2=1..2 kg"),
        ("conditions", "conditions:", "varied twice"),
    ),
    "reference over": (
        ("over: [reference.stiffness.frequency=2..6 Hz log]", "over: [load.mass2=1..2 kg]"),
        ("references.both move.over[0]", "2..6 Hz", "not a parameter of the reference"),
    ),
    "tuning over nobody": (
        ("untuned:", "over: {PID 4: [controller.position.kp]}, untuned:"),
        ("tuning.over.PID 4", "untuned:", "did you mean 'PID 3'"),
    ),
    "tuning over the plant": (
        ("untuned:", "over: {PID 3: [load.mass2=1..2 kg]}, untuned:"),
        ("tuning.over.PID 3", "untuned:", "not a parameter of the controller"),
    ),
    "untuned nobody": (
        ("untuned: [as it is]", "untuned: [as it iss]"),
        ("tuning.untuned[0]", "untuned:", "did you mean 'as it is'"),
    ),
    "seed": (("seed: 1}", "seed: 99}"), ("evaluation", "evaluation:", "seed of the tuning")),
    "cost of steps": (
        ("tuning: {runs: 8", "tuning: {cost: coupling, runs: 8"),
        ("tuning.cost", "untuned:", "coupling is defined for stiffness steps"),
    ),
    "friction": (
        ("feedback: {bandwidth: 40", "friction_compensation: true\n    feedback: {bandwidth: 40"),
        ("controllers.decoupling", "  decoupling:\n".strip("\n") + "@", "no muscle of its model has friction"),
    ),
    "same file": (("  as it is:", "  pid-3:"), ("controllers.pid-3", "  as it is:", "the same file as 'PID 3'")),
    "reserved": (
        ("  longer:", f"  {NOMINAL_JOINT}:"),
        ("other_joints.nominal", "  longer:", "the suite's own joint"),
    ),
    "openings for commands of other valves": (
        (
            "  longer:\n",
            "  longer:\n    valve: {class: FlowValve, conductance: 1 L/(s*bar), supply: 7 bar, direct: true}\n",
        ),
        ("other_joints.longer", "  longer:", "commands pressures"),
    ),
    "the suite's own plant": (
        ("  longer:\n    joint:\n", "  longer:\n    share: 2\n  short:\n    joint:\n"),
        ("other_joints.longer", "  longer:", "the suite's own plant"),
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_with_its_line_and_field(name):
    pair, (field, marked, said) = MISTAKES[name]
    pairs = [pair]
    if name == "same file":  # nobody of that name is left to be untuned
        pairs.append(("untuned: [as it is]", "untuned: [pid-3]"))
    found = problems(*pairs)
    assert [problem.field for problem in found] == [field], [str(problem) for problem in found]
    expected = TEXT.splitlines().index("  decoupling:") + 1 if marked.endswith("@") else line_of(marked)
    assert found[0].line == expected
    assert said in str(found[0])


def test_many_mistakes_are_told_at_once():
    found = problems(
        ("load.mass2=+-50 %", "load.mas2=+-50 %"),
        ("over: [reference.stiffness.frequency=2..6 Hz log]", "over: [load.mass2=1..2 kg]"),
        ("untuned: [as it is]", "untuned: [as it was]"),
    )
    assert [problem.field for problem in found] == [
        "conditions[0]",
        "references.both move.over[0]",
        "tuning.untuned[0]",
    ]


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
