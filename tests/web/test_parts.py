"""Choices of the plant on the page of runs: each is a scenario that reads and runs, and is recognised again."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from mckibben.scenario import run_scenario, with_values
from mckibben.units import deg
from mckibben.web.parts import control_choices, plant_choices
from mckibben.web.workbench import LEG, START, read_text, with_section

JOINT, ROBOT = read_text(START), read_text(LEG)


def choices(scenario):
    return control_choices(scenario) | plant_choices(scenario)


OPTIONS = [(START, label, name) for label, choice in choices(JOINT).items() for name in choice.options]
OPTIONS += [(LEG, label, choice.options[-1]) for label, choice in choices(ROBOT).items()]


@pytest.mark.parametrize(("text", "label", "name"), OPTIONS, ids=lambda value: value.replace("\n", " ")[:30])
@pytest.mark.slow
def test_an_option_is_recognised_in_the_text_of_its_scenario(text, label, name):
    choice, start = choices(read_text(text))[label], {START: JOINT, LEG: ROBOT}[text]
    chosen = choice.choose(start, name)
    again = read_text(chosen.dumps())
    assert choice.chosen(chosen) == choice.chosen(again) == name
    assert again.plant() == chosen.plant()
    assert again.control() == chosen.control()


@pytest.mark.slow
def test_choices_are_independent_of_each_other():
    scenario, wanted = JOINT, {label: choice.options[-1] for label, choice in plant_choices(JOINT).items()}
    for label, name in wanted.items():
        scenario = choices(scenario)[label].choose(scenario, name)
    assert {label: choices(scenario)[label].chosen(scenario) for label in wanted} == wanted
    assert not run_scenario(scenario.replace(duration=0.5)).outcome.failed


def test_changed_numbers_keep_the_choice_where_its_class_is_the_only_one():
    offered = choices(JOINT)
    rubbed = offered["friction of the joint"].choose(JOINT, "presliding")
    changed = with_values(rubbed, {"friction.torque": 0.7, "valve.time_constant": 0.05})
    assert offered["friction of the joint"].chosen(changed) == "presliding"
    assert offered["valves"].chosen(changed) == "first order"
    regulator = offered["valves"].choose(JOINT, "smc-itv0050")
    other = with_values(regulator, {"valve.supply": 6e5})  # which of the regulators it was is not known
    assert offered["valves"].chosen(other) is None


def test_a_signal_of_a_robot_begins_about_the_mean_of_the_one_before_and_leaves_other_joints():
    stepped = choices(ROBOT)["angle reference of knee"].choose(ROBOT, "step")
    signal, others = stepped.references()["knee"].angle, [stepped.references()[name] for name in ("side", "hip")]
    assert others == [ROBOT.references()[name] for name in ("side", "hip")]
    mean = np.mean([float(ROBOT.references()["knee"].angle(time)) for time in np.linspace(0.0, 4.0, 400)])
    assert (signal.before + signal.after) / 2 == pytest.approx(mean, abs=0.05 * deg)


@pytest.mark.slow
def test_a_reference_of_a_point_has_no_select():
    planar = LEG.replace("lei-leg,", "lei-leg-planar,")
    point = "{position: [-90 mm, -700 mm], principal: [23 N/m, 890 N/m], direction: -12 deg}"
    text = with_section(planar, point, ("reference",))
    assert list(control_choices(read_text(text))) == ["controller"]
