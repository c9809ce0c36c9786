"""A scenario's text with other numbers: what was not asked for stays, to the character."""

import functools
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mckibben.scenario import Scenario, edit_scenario, list_parameters, with_values

EXAMPLES = Path(__file__).parents[2] / "examples"
TEXTS = {path.stem: path.read_text() for path in sorted(EXAMPLES.glob("*.yaml"))}
PID = TEXTS["pre-contracted-step-pid"]
PRINTED = TEXTS["as-printed-constant-pid"]

BLOCK = """\
# A comment at the top.
name: >-
  two lines
  of a name
joint:
  geometry:
    from: knee-table-2  # of the catalog
    connector_length: '208 mm'
  muscle:
    specimen: MAS-10-180N-AA-MC-O
    law: "lei-mas-10-180n"
load:
  from: knee-table-2
  # a comment at the end of the load

controller:
  position: {kp: 2 bar/rad,   # proportional
                   ki: 60 bar/(rad*s), kd: 0.4 bar*s/rad,}
  stiffness:
    kp: 0.08 bar/(N*m/rad)
    ki: 5 bar/(N*m*s/rad)
    kd: 0 bar*s/(N*m/rad)   # none
reference:
  angle: 0 deg
  stiffness: {class: samples, times: [0 s, 1 s], values: [13 N*m/rad, 14 N*m/rad]}
duration: 2 s
control_period: 2 ms   # the last line"""

TWICE = PID.replace(
    "muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n} ",
    "muscle1: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}\n"
    "  muscle2: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n} ",
)


def test_two_equal_muscles_are_changed_where_they_stand():
    changed = edit_scenario(TWICE, {"joint.muscle.strength": 0.9, "joint.muscle.law.a1": -250.0})
    assert changed.count("law: {from: lei-mas-10-180n, a1: -250 N}, strength: 0.9}") == 2
    assert "# From the angle error" in changed
    changed = edit_scenario(TWICE, {"joint.muscle1.strength": 0.9})
    assert changed.count("strength: 0.9") == 1


@pytest.mark.parametrize(
    ("text", "values", "old", "new"),
    [
        (PID, {"load.mass2": 0.8}, "load: knee-table-2  ", "load: {from: knee-table-2, mass2: 0.8 kg}  "),
        (PID, {"controller.position.filter_time": 1e-3}, "0.4 bar*s/rad}", "0.4 bar*s/rad, filter_time: 1 ms}"),
        (PID, {"reference.angle.offset": 0.0}, "frequency: 0.5 Hz}", "frequency: 0.5 Hz, offset: 0 deg}"),
        (PRINTED, {"reference.stiffness": 72.0}, "stiffness: 72.5 N*m/rad ", "stiffness: 72 N*m/rad "),
        (
            PRINTED,
            {"joint.geometry.connector_length": 0.2},
            "geometry: knee-table-2",
            "geometry: {from: knee-table-2, connector_length: 200 mm}",
        ),
        (BLOCK, {"joint.geometry.connector_length": 0.2}, "'208 mm'", "200 mm"),
        (BLOCK, {"load.mass2": 0.8}, "  from: knee-table-2\n  # a", "  from: knee-table-2\n  mass2: 0.8 kg\n  # a"),
        (
            BLOCK,
            {"joint.geometry.joint_radius": 0.04},
            "connector_length: '208 mm'\n",
            "connector_length: '208 mm'\n    joint_radius: 40 mm\n",
        ),
        (BLOCK, {"controller.position.tracking_time": 0.1}, "rad,}", "rad, tracking_time: 100 ms,}"),
        (BLOCK, {"controller.position.kp": 1e5}, "kp: 2 bar/rad,   #", "kp: 1 bar/rad,   #"),
        (BLOCK, {"controller.stiffness.filter_time": 0.0}, "# none\n", "# none\n    filter_time: 0 ms\n"),
        (
            BLOCK,
            {"start.stiffness": 13.0, "start.angle": 0.0},
            "# the last line",
            "# the last line\nstart: {stiffness: 13 N*m/rad, angle: 0 deg}",
        ),
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_what_was_asked_for_changes(text, values, old, new, newline):
    assert text.count(old) == 1
    expected = text.replace(old, new).replace("\n", newline)
    assert edit_scenario(text.replace("\n", newline), values) == expected


@functools.cache
def known(text):
    """A scenario of ours, and what can be varied in it."""
    scenario = Scenario.parse(text, folder=EXAMPLES)
    return scenario, list_parameters(scenario)


@settings(max_examples=20)
@given(st.data())
@pytest.mark.slow
def test_any_numbers_are_read_back_to_the_bit_and_comments_stay(data):
    text = data.draw(st.sampled_from([*TEXTS.values(), BLOCK]))
    scenario, parameters = known(text)
    chosen = data.draw(st.lists(st.integers(0, len(parameters) - 1), min_size=1, max_size=8, unique=True))
    values = {}
    for address in (parameters[index] for index in chosen):
        if address.is_integer:
            values[address.name] = data.draw(st.integers(0, 2**31 - 1))
        else:
            absent = 13.0 if address.mark.holds(13.0) else 5e5 if address.mark.holds(5e5) else 0.02
            absent *= 0.9 if address.name.endswith("_min") else 1.0  # below the maximum
            nominal = address.nominal if address.nominal is not None else absent
            values[address.name] = nominal * data.draw(st.floats(0.995, 1.005))
    changed = edit_scenario(text, values, folder=EXAMPLES)
    assert Scenario.parse(changed, folder=EXAMPLES) == with_values(scenario, values)
    spring = "return_spring" in text and any(name.startswith("joint.muscle1.") for name in values)
    for comment in re.findall(r"#.*", text):
        assert comment in changed or spring, "the text of a spring is written anew, as that of a muscle"
    again = {address.name: address for address in list_parameters(Scenario.parse(changed, folder=EXAMPLES))}
    for name, value in values.items():
        assert again[name].nominal == value
    assert edit_scenario(changed, values, folder=EXAMPLES) == changed


def test_a_default_among_the_values_is_in_a_text_that_is_written_anew():
    text = (EXAMPLES / "linear-axis.yaml").read_text(encoding="utf-8")
    values = {"joint.muscle1.specimen.initial_length": 0.12, "reference.angle.offset": 0.0}
    changed = edit_scenario(text, values, folder=EXAMPLES)
    assert "offset: 0 deg" in changed
    assert edit_scenario(changed, values, folder=EXAMPLES) == changed
