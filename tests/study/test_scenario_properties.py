"""What holds for every scenario: it survives being written, and nothing but ScenarioError comes of a broken one."""

import math
import random
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
BASES = [
    {info.alias or name: getattr(scenario, name) for name, info in Scenario.model_fields.items()}
    for scenario in map(Scenario.parse, TEXTS)
]
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


@st.composite
def scenarios(draw) -> Scenario:
    data = draw(st.sampled_from(BASES))

    def of(name: str, fields: dict[str, st.SearchStrategy], **optional: st.SearchStrategy) -> st.SearchStrategy:
        return st.fixed_dictionaries({"class": st.just(name), **fields}, optional=optional)

    def signal(kind: Quantity) -> st.SearchStrategy:
        value, time = floats(kind), floats(KINDS["Instant"])
        rate = floats(KINDS["Frequency"])
        many = st.integers(1, 4).flatmap(
            lambda n: st.fixed_dictionaries(
                {
                    "amplitudes": st.tuples(*[value] * n),
                    "frequencies": st.tuples(*[rate] * n),
                },
                optional={"phases": st.tuples(*[floats(KINDS["Phase"])] * n)},
            )
        )
        samples = st.lists(st.tuples(time, value), min_size=1, max_size=20, unique_by=lambda s: s[0]).map(
            lambda pairs: dict(zip(("times", "values"), zip(*sorted(pairs), strict=True), strict=True))
        )
        return st.one_of(
            value,
            of("constant", {"value": value}),
            of("step", {"before": value, "after": value, "at": time}),
            of("sine", {"amplitude": value, "frequency": rate}, offset=value),
            many.map(lambda fields: {"class": "multisine", **fields}),
            of("ramp", {"before": value, "after": value, "start": time, "duration": floats(KINDS["Duration"])}),
            of(
                "random_steps",
                {"low": value, "high": value, "dwell": floats(KINDS["PositiveTime"])},
                seed=st.integers(0, 2**31 - 1),
            ),
            samples.map(lambda fields: {"class": "samples", **fields}),
        )

    periods, period = draw(st.integers(1, 10_000)), draw(st.floats(1e-5, 10))
    changes = {
        "name": draw(st.text(st.characters(codec="utf-8"), min_size=1, max_size=40)),
        "reference": {
            "angle": draw(signal(KINDS["Angle"])),
            "stiffness": draw(signal(KINDS["Stiffness"])),
        },
        "valve": draw(st.just("ideal") | st.fixed_dictionaries({"time_constant": floats(KINDS["ValveTime"])})),
        "load": {"from": "knee-table-2", "mass2": draw(floats(KINDS["Mass"])), "hanging": draw(st.booleans())},
        "start": {"angle": draw(floats(KINDS["Angle"]))},
        "control_period": period,
        "duration": periods * period,
        "substeps": draw(st.integers(1, 1000)),
    }
    if not changes["name"].strip().isprintable() or not changes["name"].strip():
        changes["name"] = "plain"
    return Scenario.model_validate({**data, **changes})


@settings(quick, max_examples=60)
@given(scenarios())
@pytest.mark.slow
def test_a_scenario_survives_being_written(scenario):
    text = scenario.dumps()
    again = Scenario.parse(text)
    assert again == scenario
    assert again.dumps() == text


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


scalars = st.sampled_from(["1", "1 mm", "5 deg", "ideal", "sine", "knee-table-2", "x", "", "10 s", "[]", "{}", "nan s"])
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["class", "sine", "from", "muscle", "times", "values", "z", "kp"]), inner, max_size=3
        )
    ),
    max_leaves=8,
)


@pytest.mark.slow
@settings(quick, max_examples=150)
@given(st.integers(0, 2**32), trees)
def test_a_tree_in_the_wrong_place_is_an_error(seed, tree):
    chooser = random.Random(seed)
    written = Scenario.parse(chooser.choice(TEXTS)).model_dump(mode="json", by_alias=True, exclude_none=True)
    place = written
    while True:
        key = chooser.choice(list(place))
        if not isinstance(place[key], dict) or chooser.random() < 0.3:
            place[key] = tree
            break
        place = place[key]
    accepts(flow(written))


def flow(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    return f'"{value}"' if isinstance(value, str) and ("," in value or not value) else str(value)


def accepts(text: str) -> None:
    """Read it; only a ScenarioError that says something may come out."""
    try:
        scenario = Scenario.parse(text)
    except ScenarioError as error:
        assert error.problems
        assert all(problem.message for problem in error.problems)
    else:
        assert Scenario.parse(scenario.dumps()) == scenario
