# ruff: noqa: E501 - tables of cases
"""The numbers of a scenario by name, in one or many scenarios, and in its text: no forbidden value comes through."""

import functools
import re
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mckibben import scenario as scenarios
from mckibben.errors import ParameterError
from mckibben.study.compare import Suite
from mckibben.units import deg, mm

EXAMPLES = Path(__file__).parents[2] / "examples"
TEXTS = {path.stem: path.read_text(encoding="utf-8") for path in sorted(EXAMPLES.glob("*.yaml"))}
PID, BACKPROP, PRINTED = "pre-contracted-step-pid", "pre-contracted-step-backprop", "as-printed-constant-pid"

BLOCK = Path(__file__).with_name("block.yaml").read_text(encoding="utf-8").removesuffix("\n")


TEXTS_AND_BLOCK = TEXTS | {"block": BLOCK}


@functools.cache
def known(name):
    """A scenario of ours, and what can be varied in it."""
    scenario = scenarios.Scenario.parse(TEXTS_AND_BLOCK[name], folder=EXAMPLES)
    return scenario, scenarios.list_parameters(scenario)


@pytest.fixture
def scenario(request):
    return known(request.param)[0]


@pytest.fixture
def full():
    return known("block")[0]


def of(names):
    return pytest.mark.parametrize("scenario", names, indirect=True)


@pytest.mark.parametrize(
    ("scenario", "name", "nominal", "shown"),
    [
        (PID, "load.mass2", 0.5, "kg"),  # of the catalog
        (PID, "joint.geometry.connector_length", 208 * mm, "mm"),  # as written
        (PRINTED, "joint.geometry.connector_length", 190 * mm, "mm"),  # of the catalog
        (PID, "controller.position.filter_time", 0.005, "ms"),  # of the class
        (BACKPROP, "controller.position.seed", 0, "1"),
        (PRINTED, "reference.stiffness", 72.5, "N*m/rad"),
    ],
    indirect=["scenario"],
)
def test_a_number_has_its_unit_and_its_nominal_value(scenario, name, nominal, shown):
    address = scenarios.find_parameter(scenario, name)
    assert address.name == name
    assert address.shown == shown
    assert address.nominal == pytest.approx(nominal, rel=1e-12)
    assert type(address.nominal) is (int if address.is_integer else float)
    assert address.is_integer == name.endswith("seed")


@of([PID, BACKPROP, PRINTED, "block"])
def test_every_listed_name_finds_itself_and_nominal_values_are_allowed(scenario):
    listed = scenarios.list_parameters(scenario)
    assert len({address.name for address in listed}) == len({address.places for address in listed}) == len(listed) > 20
    for address in listed:
        assert scenarios.find_parameter(scenario, address.name) == address
        if address.nominal is not None:
            assert address.holds(address.nominal)
            assert address.mark.read(address.write(address.nominal)) == address.nominal


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("duration", "one number for all runs"),
        ("load.hanging", "not a number"),
        ("controller.position.hidden", "size of what is compiled"),
        ("friction.torque", "the scenario has none"),
        ("controller.model.geometry.connector_length", "follows the plant"),
        ("controller.position.kp", "of class backprop"),
        ("load", "a group of parameters"),
    ],
)
def test_what_is_refused_says_why_and_what_to_do(name, why):
    with pytest.raises(ParameterError, match=why) as caught:
        scenarios.find_parameter(known(BACKPROP)[0], name)
    assert name.split(".")[-1] in str(caught.value)
    assert caught.value.remedy


def test_an_item_of_a_list_of_sines_is_a_parameter(full):
    found = scenarios.find_parameter(full, "reference.angle.amplitudes.1")
    assert found.name == "reference.angle.amplitudes.1"
    assert found.nominal == 1 * deg
    assert scenarios.with_values(full, {found.name: 0.1}).signals.angle.amplitudes == (3 * deg, 0.1)
    edited = scenarios.edit_scenario(BLOCK, {"reference.angle.amplitudes.1": 2.5 * deg})
    assert "amplitudes: [3 deg, 2.5 deg]" in edited
    with pytest.raises(ParameterError) as caught:
        scenarios.find_parameter(full, "reference.angle.amplitudes.2")
    assert "reference.angle.amplitudes.0" in caught.value.remedy


# Scenarios with other numbers, one or many ----------------------------------------------------------------------------


def another(address):
    """A value near the nominal one that a scenario allows, too."""
    if ".domain." in address.name and address.nominal is not None:
        return address.nominal  # limits must stay in order
    if address.nominal is None and not address.holds(1e-4):
        return 5e5 if address.holds(5e5) else 0.5
    if address.nominal in (None, 0, 0.0):
        sign = -1 if address.name == "controller.stiffness.kd" and address.nominal == 0 else 1
        return 3 if address.is_integer else 1e-4 * sign
    return address.nominal * (1.01 if address.holds(address.nominal * 1.01) else 0.99)


def built(scenario):
    return {"plant": scenario.plant(), "control": scenario.control(), "reference": scenario.reference()}


@of(TEXTS)
@pytest.mark.slow
def test_each_number_alone_comes_where_the_file_would_put_it(scenario):
    linearising = hasattr(scenario.controller, "feedback")
    inherited = ("joint", "load", "valve", "command_delay") if linearising else ("joint",)  # by the controller's model
    for address in scenarios.list_parameters(scenario):
        if address.nominal is None and address.name.endswith(("pressure_share", "pressure_time_constant")):
            continue  # of creep: both or none
        value = another(address)
        if address.name == "controller.stiffness.kd":
            value = np.sign(scenarios.find_parameter(scenario, "controller.stiffness.ki").nominal) * 1e-4
        one = scenarios.with_values(scenario, {address.name: value})
        assert scenarios.find_parameter(one, address.name).nominal == value
        many = scenarios.batched(scenario, {address.name: np.array([value, value])}, model_follows="all")
        if address.name.startswith("start."):
            assert getattr(many.start, address.places[0][-1]).tolist() == [value, value]
            continue
        flat_one, structure_one = jax.tree.flatten(built(one))
        flat_many, structure_many = jax.tree.flatten(built(many))
        assert structure_one == structure_many
        varied = 0
        for single, several in zip(flat_one, flat_many, strict=True):
            if isinstance(several, np.ndarray):
                varied += 1
                assert several.shape == (2,)
                assert several.dtype == (np.int64 if address.is_integer else np.float64)
                assert several.tolist() == [single, single] == [value, value]
            else:
                assert np.array_equal(single, several)
        # the joint is that of the plant and that of the controller's model; a spring's force begins at its length
        spring = address.name == "joint.muscle1.specimen.initial_length" and scenario.joint.springs[0]
        if ".domain." in address.name:  # that of a law limits the specimen's
            continue
        in_model = address.name.partition(".")[0] in inherited
        assert varied == (len(address.places) + spring) * (1 + in_model), address.name


KNEE = EXAMPLES / "comparison" / "knee.yaml"
OF_THE_PLANT = ("joint", "load", "valve", "sensors", "disturbance")


def with_controller(name):
    """The knee of the comparison with a controller as the file has it: its model is left to the plant."""
    suite = Suite.read(KNEE)
    return suite.example().model_copy(update={"controller": suite.controllers[name]})


def model_of(address):
    """The names of what a controller's model has of a number of the plant."""
    part, *rest = address.name.split(".")
    if part == "valve":
        return {f"valve.{rest[0]}"}
    return {".".join(("load" if part == "load" else "model", *rest))} if part in ("load", "joint") else set()


def varies(control):
    return any(np.ndim(leaf) == 1 for leaf in jax.tree.leaves(control))


@pytest.mark.parametrize("name", ["PID", "PID and model feedforward", "decoupling", "predictive"])
@pytest.mark.slow
def test_numbers_of_the_plant_reach_no_controller_unless_known(name):
    scenario = with_controller(name)
    own = jax.tree.leaves(scenario.control())
    taken = [each.name for each in scenarios.list_parameters(scenario.with_fixed_model()) if each.part == "controller"]
    plant = [each for each in scenarios.list_parameters(scenario) if each.part in OF_THE_PLANT]
    assert {each.part for each in plant} == set(OF_THE_PLANT)
    table = {each.name: np.array([another(each)] * 2) for each in plant}
    many = scenarios.batched(scenario, table)
    for leaf, mine in zip(jax.tree.leaves(many.control()), own, strict=True):
        np.testing.assert_array_equal(leaf, mine)
    assert sum(np.ndim(leaf) == 1 for leaf in jax.tree.leaves(many.plant())) >= len(table)
    one = scenarios.with_values(scenario, {key: column[0].item() for key, column in table.items()}, model_follows=())
    assert jax.tree.leaves(one.control()) == own
    known = scenarios.followed_names(scenario, "all", table)
    believed = {
        each.name
        for each in plant
        if any(own == name or own.endswith(f".{name}") for own in taken for name in model_of(each))
    }
    assert set(known) == believed
    unknown = {key: column for key, column in table.items() if key not in known}
    assert not varies(scenarios.batched(scenario, unknown, model_follows="all").control())
    for name in known:
        assert varies(scenarios.batched(scenario, {name: table[name]}, model_follows="all").control()), name
    if known:
        both = [scenarios.batched(scenario, table, model_follows=asked).control() for asked in ("all", known)]
        for one, other in zip(*map(jax.tree.leaves, both), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_what_is_known_varies_in_the_model_and_the_rest_does_not():
    scenario = with_controller("decoupling")
    table = {
        "load.mass2": [0.4, 0.6],
        "valve.time_constant": [0.01, 0.03],
        "controller.feedback.bandwidth": [30.0, 40.0],
    }
    control = scenarios.batched(scenario, table, model_follows=["load.mass2"]).control()
    assert control.load.mass2.tolist() == table["load.mass2"]
    assert control.valve.time_constant == 0.02
    assert control.feedback.bandwidth.tolist() == [30.0, 40.0]  # a number of the controller's own
    with pytest.raises(ParameterError, match=r"joint\.geometry\.connector_length, which is not varied"):
        scenarios.followed_names(scenario, ["joint.geometry.connector_length"], table)
    given = scenarios.with_values(scenario.with_fixed_model(), {"controller.load.mass2": 0.4})
    with pytest.raises(ParameterError, match=r"does not take load\.mass2 from the plant"):
        scenarios.followed_names(given, ["load.mass2"], table)
    assert scenarios.followed_names(given, "all", table) == ()


FORBIDDEN = [
    (PID, {"joint.geometry.connector_length": [0.2, 0.36]}, 1, "outside 0..0.34"),
    (PID, {"joint.geometry.joint_length": [0.37, 0.4], "joint.geometry.connector_length": [0.39, 0.39]}, 0, "connector_length 390 mm.* outside"),
    (PID, {"controller.position.kp": [1e5, -1e5, 2e5]}, 1, "differ in sign"),
    (PID, {"load.inertia": [0.0], "load.mass1": [0.0], "load.mass2": [0.0]}, 0, "total_inertia is 0"),
]  # fmt: skip


@pytest.mark.parametrize(("scenario", "table", "row", "why"), FORBIDDEN, indirect=["scenario"])
def test_a_forbidden_combination_is_told_with_its_first_row(scenario, table, row, why):
    rows = len(next(iter(table.values())))
    with pytest.raises(ParameterError, match=why) as caught:
        scenarios.batched(scenario, table)
    message = str(caught.value)
    assert message.startswith(f"row {row}: with " if rows > 1 else "with ")
    for name, column in table.items():
        address = scenarios.find_parameter(scenario, name)
        assert f"{address.name} {address.show(column[row])}" in message
    with pytest.raises(ParameterError, match=why):
        scenarios.with_values(scenario, {name: column[row] for name, column in table.items()})
    mask = scenarios.valid_rows(scenario, table)
    assert not mask[row]
    assert mask[:row].all()


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ({}, "no values"),
        ({"load.mass2": [0.5, -1.0]}, r"row 1: load\.mass2 is -1 kg, out of range"),
        ({"valve.time_constant": [0.02, 0.0]}, "out of range"),
        ({"controller.position.seed": [1.5, 2.0]}, "1.5, not a whole number"),
        ({"load.mass2": [0.5], "load.mass1": [0.5, 0.6]}, "differ in length"),
        ({"load.mass2": ["0.5"]}, "column of numbers"),
        ({"joint.geometry.connector_length": [0.2], "connector_length": [0.2]}, "same parameter"),
    ],
)
def test_tables_that_are_none_are_refused(table, why):
    for take in (scenarios.batched, scenarios.valid_rows):
        with pytest.raises(ParameterError, match=why):
            take(known(BACKPROP)[0], table)


# The text of a scenario with other numbers ----------------------------------------------------------------------------

PID_TEXT = TEXTS["pre-contracted-step-pid"]
TWICE = PID_TEXT.replace(
    "muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n} ",
    "muscle1: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}\n"
    "  muscle2: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n} ",
)


def test_two_equal_muscles_are_changed_where_they_stand():
    changed = scenarios.edit_scenario(TWICE, {"joint.muscle.strength": 0.9, "joint.muscle.law.a1": -250.0})
    assert changed.count("law: {from: lei-mas-10-180n, a1: -250 N}, strength: 0.9}") == 2
    assert "# From the angle error" in changed
    changed = scenarios.edit_scenario(TWICE, {"joint.muscle1.strength": 0.9})
    assert changed.count("strength: 0.9") == 1


@pytest.mark.parametrize(
    ("text", "values", "old", "new"),
    [
        (PID_TEXT, {"load.mass2": 0.8}, "load: knee-table-2  ", "load: {from: knee-table-2, mass2: 0.8 kg}  "),
        (PID_TEXT, {"controller.position.filter_time": 1e-3}, "0.4 bar*s/rad}", "0.4 bar*s/rad, filter_time: 1 ms}"),
        (PID_TEXT, {"reference.angle.offset": 0.0}, "frequency: 0.5 Hz}", "frequency: 0.5 Hz, offset: 0 deg}"),
        (BLOCK, {"joint.geometry.connector_length": 0.2}, "'208 mm'", "200 mm"),
        (BLOCK, {"load.mass2": 0.8}, "  from: knee-table-2\n  # a", "  from: knee-table-2\n  mass2: 0.8 kg\n  # a"),
        (BLOCK, {"controller.position.tracking_time": 0.1}, "rad,}", "rad, tracking_time: 100 ms,}"),
        (BLOCK, {"controller.stiffness.filter_time": 0.0}, "# none\n", "# none\n    filter_time: 0 ms\n"),
        (BLOCK, {"start.stiffness": 13.0, "start.angle": 0.0}, "# the last line", "# the last line\nstart: {stiffness: 13 N*m/rad, angle: 0 deg}"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_what_was_asked_for_changes(text, values, old, new, newline):
    assert text.count(old) == 1
    expected = text.replace(old, new).replace("\n", newline)
    assert scenarios.edit_scenario(text.replace("\n", newline), values) == expected


@settings(max_examples=10)
@given(st.data())
@pytest.mark.slow
def test_any_numbers_are_read_back_to_the_bit_and_comments_stay(data):
    name = data.draw(st.sampled_from(sorted(TEXTS_AND_BLOCK)))
    text, (scenario, parameters) = TEXTS_AND_BLOCK[name], known(name)
    bound = "controller.stiffness.kd", "joint.muscle.creep.pressure_time_constant"  # to the sign of ki, to a share
    parameters = [address for address in parameters if address.name not in bound]
    chosen = data.draw(st.lists(st.sampled_from(parameters), min_size=1, max_size=8, unique_by=lambda one: one.name))
    values = {address.name: another(address) for address in chosen}
    changed = scenarios.edit_scenario(text, values, folder=EXAMPLES)
    assert scenarios.Scenario.parse(changed, folder=EXAMPLES) == scenarios.with_values(scenario, values)
    spring = "return_spring" in text and any(name.startswith("joint.muscle1.") for name in values)
    for comment in re.findall(r"#.*", text):
        assert comment in changed or spring, "the text of a spring is written anew, as that of a muscle"
    assert scenarios.edit_scenario(changed, values, folder=EXAMPLES) == changed


def test_one_muscle_alone_has_no_stiffness_to_vary():
    scenario, parameters = known("linear-axis")
    assert "start.stiffness" not in {parameter.name for parameter in parameters}
    with pytest.raises(ParameterError):
        scenarios.with_values(scenario, {"start.stiffness": 1e4})


def test_a_default_among_the_values_is_in_a_text_that_is_written_anew():
    text = (EXAMPLES / "linear-axis.yaml").read_text(encoding="utf-8")
    values = {"joint.muscle1.specimen.initial_length": 0.12, "reference.position.offset": 0.0}
    changed = scenarios.edit_scenario(text, values, folder=EXAMPLES)
    assert "offset: 0 mm" in changed
    assert scenarios.edit_scenario(changed, values, folder=EXAMPLES) == changed
