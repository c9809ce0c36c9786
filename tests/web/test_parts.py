"""Choices of the plant on the page of runs: each is a scenario that reads and runs, and is recognised again."""

import pytest

pytest.importorskip("nicegui")

from mckibben import Scenario
from mckibben.scenario import run_scenario, with_values
from mckibben.web.parts import CHOICES
from mckibben.web.workbench import START

OPTIONS = [(label, name) for label, choice in CHOICES.items() for name in choice.options]


@pytest.fixture(scope="module")
def start():
    return Scenario.parse(START)


@pytest.mark.parametrize(("label", "name"), OPTIONS)
@pytest.mark.slow
def test_an_option_is_recognised_in_the_text_of_its_scenario(start, label, name):
    chosen = CHOICES[label].choose(start, name)
    again = Scenario.parse(chosen.dumps())
    assert CHOICES[label].chosen(chosen) == CHOICES[label].chosen(again) == name
    assert again.plant() == chosen.plant()


@pytest.mark.slow
def test_choices_are_independent_of_each_other(start):
    scenario, wanted = start, {label: CHOICES[label].options[-1] for label in [*CHOICES][3:]}
    for label, name in wanted.items():
        scenario = CHOICES[label].choose(scenario, name)
    assert {label: CHOICES[label].chosen(scenario) for label in wanted} == wanted
    assert run_scenario(scenario.replace(duration=0.5)).outcome.name == "COMPLETED"


def test_changed_numbers_keep_the_choice_where_its_class_is_the_only_one(start):
    rubbed = CHOICES["friction of the joint"].choose(start, "presliding")
    changed = with_values(rubbed, {"friction.torque": 0.7, "valve.time_constant": 0.05})
    assert CHOICES["friction of the joint"].chosen(changed) == "presliding"
    assert CHOICES["valves"].chosen(changed) == "first order"
    regulator = CHOICES["valves"].choose(start, "smc-itv0050")
    other = with_values(regulator, {"valve.supply": 6e5})  # which of the regulators it was is not known
    assert CHOICES["valves"].chosen(other) is None
