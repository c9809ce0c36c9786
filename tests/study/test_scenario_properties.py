"""Quantities come back from their text to the last bit, and nothing but ScenarioError comes of a broken scenario."""

import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from mckibben import units
from mckibben.errors import ScenarioError
from mckibben.scenario import Scenario
from mckibben.units import Quantity, factor

EXAMPLES = Path(__file__).parents[2] / "examples"
TEXTS = [path.read_text() for path in sorted(EXAMPLES.glob("*.yaml"))]
KINDS = {
    name: kind.__metadata__[0]
    for name, kind in vars(units).items()
    if isinstance(getattr(kind, "__metadata__", [None])[0], Quantity) and kind.__metadata__[0].unit not in units.SYMBOLS
}

quick = settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def floats(kind: Quantity) -> st.SearchStrategy[float]:
    scale = factor(kind.shown, kind.unit)
    return st.floats(
        kind.lower * scale,
        kind.upper * scale,
        exclude_min=kind.open_lower,
        exclude_max=kind.open_upper,
        allow_subnormal=False,  # XLA takes them for 0
    )


def test_kinds_are_found():
    assert len(KINDS) > 25


def test_si_units_are_exact():
    for name, kind in KINDS.items():
        assert factor(kind.unit) == factor(kind.unit, kind.unit) == 1.0, name


@settings(quick, max_examples=400)
@given(st.data())
def test_every_quantity_comes_back_to_the_last_bit(data):
    kind = data.draw(st.sampled_from(list(KINDS.values())))
    value = data.draw(floats(kind))
    assert kind.read(kind.write(value)) == value


@quick
@given(st.sampled_from(list(KINDS.values())), st.integers(1, 9999))
def test_what_people_write_is_written_back(kind, number):
    assume(number / 10000 >= kind.lower)
    text = f"{number / 10000:g} {kind.shown}"
    if kind.unit != "1":
        assert kind.write(kind.read(text)) == text


INDICATORS = ["\n  ", ": ", "- ", " #", "&a ", "!!int ", "|\n", "---\n", "...\n", "<<: ", *"\t\n:[]{},*|>%@`'\"#?-/()~"]
STRANGE = ["\\x", "\0", "\x85", "\ufeff", "\ud7ff", "é", "𝛼", "1e999", "nan", "9" * 400, "null", "0x1F", "5 °", "m^9"]
NASTY = st.sampled_from([*INDICATORS, *STRANGE])


@settings(quick, max_examples=250)
@given(st.sampled_from(TEXTS), st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), NASTY), min_size=1, max_size=4))
@pytest.mark.slow
def test_a_damaged_scenario_is_a_scenario_or_an_error(text, damages):
    for where, removed, inserted in damages:
        at = math.floor(where * len(text))
        text = text[:at] + inserted + text[at + removed :]
    accepts(text)


@settings(quick, max_examples=150)
@given(st.text(st.sampled_from("abz019 .:-{}[],&*!|>'\"%@`#?\n\t\\_~<=^()/"), max_size=60) | st.text(max_size=30))
def test_any_text_is_a_scenario_or_an_error(text):
    accepts(text)


def accepts(text: str) -> None:
    """Read it; only a ScenarioError that says something may come out."""
    try:
        scenario = Scenario.parse(text)
    except ScenarioError as error:
        assert error.problems
        assert all(problem.message for problem in error.problems)
    else:
        assert Scenario.parse(scenario.dumps()) == scenario
