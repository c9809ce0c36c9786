"""Scenario files: reading, errors, builders; nothing but ScenarioError comes of a broken one."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import ScenarioError
from mckibben.scenario import Scenario
from mckibben.units import bar, deg

EXAMPLES = Path(__file__).parents[2] / "examples"
BASE = (EXAMPLES / "pre-contracted-step-pid.yaml").read_text()

PLAIN = Path(__file__).with_name("plain.yaml").read_text(encoding="utf-8")


VALVE, SINE = "valve: {time_constant: 20 ms}", "{class: sine, amplitude: 10 deg, frequency: 0.5 Hz}"
JOINT = BASE[BASE.index("joint:") : BASE.index("\nload:")]
MUSCLE = "{specimen: DMSP-10-250, law: chou}"


def problems(text: str, **options) -> list:
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(text, **options)
    assert all(problem.message for problem in caught.value.problems)
    return list(caught.value.problems)


def changed(old: str, new: str, text: str = BASE) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda p: p.stem)
def test_examples_come_back_from_files_and_go_to_other_processes(path, tmp_path):
    scenario = Scenario.read(path)
    scenario.to_yaml(tmp_path / "copy.yaml")
    assert Scenario.read(tmp_path / "copy.yaml") == scenario == pickle.loads(pickle.dumps(scenario))


def test_short_forms():
    load = Scenario.parse(changed("load: knee-table-2  ", "load: {from: knee-table-2}  "))
    assert load == Scenario.parse(BASE)
    constant = Scenario.parse(changed(SINE, "{class: constant, value: 3 deg}"))
    assert constant == Scenario.parse(changed(SINE, "3 deg"))
    assert "angle: 3 deg" in constant.dumps()
    assert "load: knee-table-2\n" in constant.dumps()


def test_a_scenario_of_objects_made_in_code_is_written_and_read_back():
    joint, load = mk.catalog.joint("knee-table-2"), mk.PendulumLoad(0.3, 0.25)
    control = mk.PositionStiffnessControl(mk.PID(2e5, 60e5, 4e4), mk.PID(-1.5e5, -100e5, 0.0), model=joint)
    reference = mk.Reference(mk.Sine(2 * deg, 0.5), 72.5)
    parts = {"joint": joint, "load": load, "valve": mk.FirstOrderValve(0.02), "controller": control}
    scenario = Scenario(name="made in code", **parts, reference=reference, duration=1.0, control_period=1e-3)
    assert Scenario.parse(scenario.dumps()) == scenario
    assert "model:" in scenario.dumps(), "what was given does not follow the plant"


def test_a_copy_with_other_fields_is_checked_as_a_new_scenario():
    scenario = Scenario.parse(BASE)
    assert scenario.replace() == scenario
    assert scenario.replace(duration="2 s").duration == 2.0
    heavy = scenario.replace(load=mk.PendulumLoad(0.3, 0.25))
    assert heavy.control() == scenario.control()
    assert heavy.plant().load.mass == 0.3
    with pytest.raises(ScenarioError) as caught:
        scenario.replace(duratio=2.0, valve=mk.PID(1.0, 0.0, 0.0), load={"class": "pendulum", "mass": "3 mm"})
    assert {one.field for one in caught.value.problems} == {"duratio", "valve", "load.mass", "load.length"}


def test_another_controller_runs_in_a_scenario():
    scenario = Scenario.parse(BASE).replace(duration=0.1)
    held = scenario.simulate(mk.OpenLoopControl(2 * bar, 2 * bar, scenario.plant().joint))["command1"]
    assert np.all(held == 2 * bar)
    assert np.ptp(scenario.simulate()["command1"]) > 0


# Errors ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", ["load", "valve", "sensors"])
def test_a_part_that_every_plant_has_cannot_be_none(part):
    lines = [line for line in BASE.splitlines() if not line.startswith(f"{part}:")]
    (problem,) = problems("\n".join([*lines, f"{part}: none"]))
    assert problem.field == part and problem.remedy


def test_three_mistakes_are_three_problems_with_lines():
    text = PLAIN.replace("20 ms", "20 mm").replace("amplitudes", "amplitude").replace("2 s\n", "2.001 s\n")
    wrong_unit, misspelt, no_whole = problems(text, source="three.yaml")
    assert (wrong_unit.line, wrong_unit.field) == (8, "valve.time_constant")
    assert "'mm'" in wrong_unit.message
    assert "such as ms" in wrong_unit.remedy
    assert (misspelt.line, misspelt.field) == (22, "reference.angle.amplitude")
    assert "'amplitudes'" in misspelt.remedy
    assert (no_whole.line, no_whole.field) == (25, "control_period")
    assert "2.001 s" in no_whole.message
    assert "2 ms" in no_whole.message
    with pytest.raises(ScenarioError, match=r"three\.yaml: 3 problems\n  line 8, valve"):
        Scenario.parse(text, source="three.yaml")


MISTAKES = [
    ("208 mm", "208", "joint.geometry.connector_length", "'208' has no unit; write it like '208 mm'"),
    ("duration: 10 s", "duration: 4,5 s", "duration", "write it like '4.5 s'"),
    ("208 mm", "", "joint.geometry.connector_length", "has no value"),
    ("from: knee-table-2, conn", "from: knee-tabel-2, conn", "joint.geometry", "did you mean 'knee-table-2'"),
    ("law: lei-mas-10-180n", "law: lei", "joint.muscle.law", "did you mean 'lei-mas-10-180n'"),
    ("law: lei-mas-10-180n", "law: missing.yaml", "joint.muscle.law", "there is no file 'missing.yaml'"),
    ("  muscle: {", "  muscles: {", "joint.muscles", "did you mean 'muscle'"),
    ("load: knee-table-2 ", "load: {class: pendulum, mass: 1 kg} ", "load.length", "is missing"),
    (  # no class of examples/components.py has it, which other tests of this process may run
        *("{from: knee-table-2, connector_length: 208 mm}", "{arm_slope: 8 mm}", "joint.geometry"),
        "lacks the key `class`",
    ),
    ("start: {angle", "disturbance: {amplitude: 1 N*m}\nstart: {angle", "disturbance", "give one of none, pulses"),
    (VALVE, "valve: perfect", "valve", "known are"),
    ("ki: 60", "ki: -60", "controller.position", "differ in sign"),
    ("rad}\n", "rad, derivative_on_error: yes}\n", "controller.position.derivative_on_error", "neither true nor false"),
    ("kp: 2 bar/rad, ", "", "controller.position.kp", "add it, such as `kp: 12.5 bar/rad`"),
    (SINE, "{sine: {amplitude: 10 deg}}", "reference.angle", "class: sine"),
    ("control_period: 1 ms", "control_period: 3 ms", "control_period", "duration 10 s is not a whole number"),
    ("name: pre-contracted knee, stiffness step, PID", 'name: "a\\0b"', "name", "not one line"),
    ("duration: 10 s", "\tduration: 10 s", "", "a tab in the indentation"),
    ("duration: 10 s", 'duration: "10 s', "", "not YAML"),
    ("duration: 10 s", "duration: 10 s\n---\nname: other", "", "found another document"),
]
SIGNALS = [
    ("samples, times: [0 s, 2 s, 1 s], values: [1 deg, 1 deg, 1 deg]", "times"),
    ("samples, times: [0 s], values: [1 deg, 1 deg]", "1 times"),
    ("samples, times: [0 s]", "is missing"),
    ("samples, times: [0 s], values: [1 deg], file: pyproject.csv", "not a known key"),
    ("samples_file, file: nowhere.csv", "there is no file 'nowhere.csv'"),
    ("multisine, amplitudes: [1 deg], frequencies: [1 Hz, 2 Hz]", "2 frequencies for 1"),
    ("multisine, amplitudes: [], frequencies: []", "at least one"),
]
MISTAKES += [(SINE, f"{{class: {signal}}}", "reference.angle", words) for signal, words in SIGNALS]
JOINTS = [
    ("geometry: knee-table-2", "`muscle` for both"),
    (f"geometry: knee-table-2, muscle1: {MUSCLE}", "lacks muscle2"),
    (f"geometry: {{from: knee-table-2, joint_radius: 2 m, joint_length: 1.5 m}}, muscle: {MUSCLE}", "outside"),
    (f"geometry: {{from: knee-table-2, joint_length: 1 m, connector_length: 2 m}}, muscle: {MUSCLE}", "outside"),
    (f"geometry: knee-table-2, connector_length: 2 mm, muscle: {MUSCLE}", "it is a key of geometry"),
]
MISTAKES += [(JOINT, f"joint: {{{joint}}}", "joint", words) for joint, words in JOINTS]


@pytest.mark.parametrize(("old", "new", "field", "words"), MISTAKES)
def test_one_mistake_is_told_with_its_place(old, new, field, words):
    (problem,) = problems(changed(old, new))
    assert problem.field.startswith(field) and words in f"{problem.message}; {problem.remedy}"
    expected = BASE[: BASE.index(old)].count("\n") + 1
    assert problem.line is not None and expected <= problem.line <= expected + 2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\xff\xfe\x00\x01", "not text"),
        (b"PK\x03\x04\x00\x00", "not YAML"),
        (b"just words", "keys and values"),
        (b"- a\n- b\n", "a list"),
    ],
)
def test_files_that_are_no_scenarios(tmp_path, content, words):
    (tmp_path / "a.yaml").write_bytes(content)
    with pytest.raises(ScenarioError, match=words):
        Scenario.read(tmp_path / "a.yaml")


@pytest.mark.parametrize(("name", "words"), [("missing.yaml", "No such file"), ("", "directory"), ("\0", "null")])
def test_paths_that_are_no_files(tmp_path, name, words):
    with pytest.raises(ScenarioError, match=words):
        Scenario.read(tmp_path / name)


def test_windows_line_ends_and_byte_order_marks_are_fine(tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode())
    assert Scenario.read(tmp_path / "a.yaml") == Scenario.parse(BASE)


# Other files ----------------------------------------------------------------------------------------------------------


def test_samples_from_a_table(tmp_path):
    (tmp_path / "reference.csv").write_text("time_ms,angle_deg,stiffness_N*m/rad\n0,0,13\n500,5,14\n1000,0,15\n")
    text = changed(SINE, "{class: samples_file, file: reference.csv}")
    text = changed(
        "{class: step, before: 13 N*m/rad, after: 17 N*m/rad, at: 5 s}",
        "{class: samples_file, file: reference.csv}",
        text,
    )
    scenario = Scenario.parse(text, folder=tmp_path)
    setpoint = scenario.reference()(0.25)
    np.testing.assert_allclose(setpoint.angle, 2.5 * deg)
    np.testing.assert_allclose(setpoint.stiffness, 13.5)

    scenario.to_yaml(tmp_path / "a.yaml")
    assert "file: reference.csv" in (tmp_path / "a.yaml").read_text()
    (tmp_path / "sub").mkdir()
    scenario.to_yaml(tmp_path / "sub" / "b.yaml")
    assert Scenario.read(tmp_path / "a.yaml") == Scenario.read(tmp_path / "sub" / "b.yaml") == scenario


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("time_s,angle_mm\n0,1\n", "'mm' does not have the dimensions of 'rad'"),
        ("time_s,angle_deg\n0,1\n0,2\n1\n", "line 3: the time does not rise; sort the rows (and 1 more)"),
    ],
)
def test_bad_tables(tmp_path, table, words):
    (tmp_path / "reference.csv").write_text(table)
    (problem,) = problems(changed(SINE, "{class: samples_file, file: reference.csv}"), folder=tmp_path)
    assert words in str(problem)


@pytest.mark.parametrize(
    ("text", "accuracy", "substeps"),
    [("accuracy: 2e-5 rad", 2e-5, None), ("accuracy: 0.001 deg", 0.001 * deg, None), ("substeps: 3", 1e-6, 3)],
)
def test_integration_steps_are_given_or_follow_from_an_accuracy(text, accuracy, substeps):
    scenario = Scenario.parse(BASE.replace("accuracy: 1e-6 rad ", f"{text} "))
    assert (scenario.accuracy, scenario.substeps) == (pytest.approx(accuracy, rel=1e-15), substeps)
    assert Scenario.parse(scenario.dumps()) == scenario
