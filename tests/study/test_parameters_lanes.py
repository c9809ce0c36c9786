"""Scenarios with other numbers, one or many: nothing that a file may not say comes through."""

from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben.component.schema import replaced
from mckibben.errors import ParameterError
from mckibben.scenario import (
    Scenario,
    batched,
    find_parameter,
    followed_names,
    list_parameters,
    valid_rows,
    with_values,
)
from mckibben.study.compare import Suite

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENARIOS = [Scenario.read(path) for path in sorted(EXAMPLES.glob("*.yaml"))]
PID = Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml")
BACKPROP = Scenario.read(EXAMPLES / "pre-contracted-step-backprop.yaml")


def another(address):
    """A value near the nominal one that a scenario allows, too."""
    if ".domain." in address.name and address.nominal is not None:
        return address.nominal  # limits must stay in order
    if address.nominal is None and not address.holds(1e-4):
        return 5e5 if address.holds(5e5) else 0.5
    if address.nominal in (None, 0, 0.0):
        sign = -1 if address.name == "controller.stiffness.kd" and address.nominal == 0 else 1
        return 3 if address.is_integer else 1e-4 * sign
    return address.nominal * 1.01


def built(scenario):
    return {"plant": scenario.plant(), "control": scenario.control(), "reference": scenario.reference()}


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda s: s.name)
@pytest.mark.slow
def test_each_number_alone_comes_where_the_file_would_put_it(scenario):
    for address in list_parameters(scenario):
        value = another(address)
        if address.name == "controller.stiffness.kd":
            value = np.sign(find_parameter(scenario, "controller.stiffness.ki").nominal) * 1e-4
        one = with_values(scenario, {address.name: value})
        assert find_parameter(one, address.name).nominal == value
        many = batched(scenario, {address.name: np.array([value, value])}, model_follows="all")
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
        in_model = address.name.startswith("joint.")
        assert varied == (len(address.places) + spring) * (1 + in_model), address.name


KNEE = Suite.read(EXAMPLES / "comparison" / "knee.yaml")
LEARNING = KNEE.controllers["PID and learned inverse"]


CONTROLLERS = KNEE.controllers | {
    "inverse learned without a model": replaced(LEARNING, {"load": None}),
}
OTHER_NUMBERS = {"PID, ten times the budget", "PID, derivative of the measurement"}  # of the class and parts of "PID"
OF_THE_PLANT = ("joint", "load", "valve", "sensors", "disturbance")


def with_controller(name):
    """The knee of the comparison with a controller as the file has it: its model is left to the plant."""
    return KNEE.example().model_copy(update={"controller": CONTROLLERS[name]})


def model_of(address):
    """The names of what a controller's model has of a number of the plant."""
    part, *rest = address.name.split(".")
    if part == "valve":
        return {f"valve.{rest[0]}"}
    return {".".join(("load" if part == "load" else "model", *rest))} if part in ("load", "joint") else set()


def varies(control):
    return any(np.ndim(leaf) == 1 for leaf in jax.tree.leaves(control))


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name not in OTHER_NUMBERS])
@pytest.mark.slow
def test_numbers_of_the_plant_reach_no_controller_unless_known(name):
    scenario = with_controller(name)
    own = jax.tree.leaves(scenario.control())
    taken = [each.name for each in list_parameters(scenario.with_fixed_model()) if each.part == "controller"]
    plant = [each for each in list_parameters(scenario) if each.part in OF_THE_PLANT]
    assert {each.part for each in plant} == set(OF_THE_PLANT)
    table = {each.name: np.array([another(each)] * 2) for each in plant}
    many = batched(scenario, table)
    for leaf, mine in zip(jax.tree.leaves(many.control()), own, strict=True):
        np.testing.assert_array_equal(leaf, mine)
    assert sum(np.ndim(leaf) == 1 for leaf in jax.tree.leaves(many.plant())) >= len(table)
    one = with_values(scenario, {key: column[0].item() for key, column in table.items()}, model_follows=())
    assert jax.tree.leaves(one.control()) == own
    known = followed_names(scenario, "all", table)
    believed = {
        each.name
        for each in plant
        if any(own == name or own.endswith(f".{name}") for own in taken for name in model_of(each))
    }
    assert set(known) == believed
    unknown = {key: column for key, column in table.items() if key not in known}
    assert not varies(batched(scenario, unknown, model_follows="all").control())
    for name in known:
        assert varies(batched(scenario, {name: table[name]}, model_follows="all").control()), name
    if known:
        both = [batched(scenario, table, model_follows=asked).control() for asked in ("all", known)]
        for one, other in zip(*map(jax.tree.leaves, both), strict=True):
            np.testing.assert_array_equal(one, other)


def test_what_is_known_varies_in_the_model_and_the_rest_does_not():
    scenario = with_controller("decoupling")
    table = {
        "load.mass2": [0.4, 0.6],
        "valve.time_constant": [0.01, 0.03],
        "controller.feedback.bandwidth": [30.0, 40.0],
    }
    control = batched(scenario, table, model_follows=["load.mass2"]).control()
    assert control.load.mass2.tolist() == table["load.mass2"]
    assert control.valve.time_constant == 0.02
    assert control.feedback.bandwidth.tolist() == [30.0, 40.0]  # a number of the controller's own
    with pytest.raises(ParameterError, match=r"joint\.geometry\.connector_length, which is not varied"):
        followed_names(scenario, ["joint.geometry.connector_length"], table)
    given = with_values(scenario.with_fixed_model(), {"controller.load.mass2": 0.4})
    with pytest.raises(ParameterError, match=r"does not take load\.mass2 from the plant"):
        followed_names(given, ["load.mass2"], table)
    assert followed_names(given, "all", table) == ()


FORBIDDEN = [
    (PID, {"joint.geometry.connector_length": [0.2, 0.36]}, 1, "outside 0..0.34"),
    (PID, {"joint.geometry.joint_length": [0.37, 0.2, 0.1]}, 1, "outside 0..0.17"),
    (
        PID,
        {"joint.geometry.joint_length": [0.37, 0.4], "joint.geometry.connector_length": [0.39, 0.39]},
        0,
        "connector_length 390 mm.* outside",
    ),
    (PID, {"controller.position.kp": [1e5, -1e5, 2e5]}, 1, "differ in sign"),
    (PID, {"controller.position.kp": [1e5, -1e5], "controller.position.ki": [1e5, -1e5]}, 1, "differ in sign"),
    (PID, {"load.inertia": [0.0], "load.mass1": [0.0], "load.mass2": [0.0]}, 0, "total_inertia is 0"),
]


@pytest.mark.parametrize(("scenario", "table", "row", "why"), FORBIDDEN)
def test_a_forbidden_combination_is_told_with_its_first_row(scenario, table, row, why):
    rows = len(next(iter(table.values())))
    with pytest.raises(ParameterError, match=why) as caught:
        batched(scenario, table)
    message = str(caught.value)
    assert message.startswith(f"row {row}: with " if rows > 1 else "with ")
    for name, column in table.items():
        address = find_parameter(scenario, name)
        assert f"{address.name} {address.show(column[row])}" in message
    with pytest.raises(ParameterError, match=why):
        with_values(scenario, {name: column[row] for name, column in table.items()})
    mask = valid_rows(scenario, table)
    assert not mask[row]
    assert mask[:row].all()


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ({}, "no values"),
        ({"load.mass2": [0.5, -1.0]}, r"row 1: load\.mass2 is -1 kg, outside 0 to 10000 kg"),
        ({"load.mass2": [np.inf, 1.0]}, "row 0: .*inf kg"),
        ({"valve.time_constant": [0.02, 0.0]}, "outside above 0"),
        ({"controller.position.seed": [1.5, 2.0]}, "1.5, not a whole number"),
        ({"controller.position.momentum": [0.5, 0.9999999]}, r"row 1: controller\.position\.momentum is 1, outside"),
        ({"load.mass2": [0.5], "load.mass1": [0.5, 0.6]}, "differ in length"),
        ({"load.mass2": [[0.5], [0.5, 0.6]]}, "column of numbers"),
        ({"load.mass2": ["0.5"]}, "column of numbers"),
        ({"joint.geometry.connector_length": [0.2], "connector_length": [0.2]}, "same parameter"),
        ({"substeps": [4]}, "cannot be varied"),
    ],
)
def test_tables_that_are_none_are_refused(table, why):
    for take in (batched, valid_rows):
        with pytest.raises(ParameterError, match=why):
            take(BACKPROP, table)
