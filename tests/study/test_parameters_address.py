"""The numbers of a scenario by name: which there are, how they are spelt, what is refused and why."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario, edit_scenario, find_parameter, find_parameters, list_parameters, with_values
from mckibben.units import bar, deg, mm

EXAMPLES = Path(__file__).parents[2] / "examples"
PID = Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml")
BACKPROP = Scenario.read(EXAMPLES / "pre-contracted-step-backprop.yaml")
PRINTED = Scenario.read(EXAMPLES / "as-printed-constant-pid.yaml")

FULL = """\
name: full
joint:
  geometry: {joint_length: 370 mm, joint_radius: 3 cm, connector_length: 0.208 m}
  muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
  tendon: {stiffness: 20 N/mm, preload: 50 N, travel: 18 mm}
load: {from: knee-table-2, mass2: 0.8 kg}
controller:
  position: {kp: 2 bar/rad, ki: 60 bar/(rad*s), kd: 0.4 bar*s/rad}
  stiffness: {kp: 0.08 bar/(N*m/rad), ki: 5 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad)}
  model: {geometry: knee-table-2, muscle: {specimen: DMSP-10-250, law: chou}}
reference:
  angle: {class: multisine, amplitudes: [3 deg, 1 deg], frequencies: [0.5 Hz, 1.25 Hz]}
  stiffness: {class: samples, times: [0 s, 1 s], values: [13 N*m/rad, 14 N*m/rad]}
duration: 2 s
control_period: 2 ms
"""


@pytest.fixture
def full():
    return Scenario.parse(FULL)


@pytest.mark.parametrize(
    ("scenario", "name", "nominal", "shown"),
    [
        (PID, "load.mass2", 0.5, "kg"),  # of the catalog
        (PID, "load.hanging_angle", 30 * deg, "deg"),
        (PID, "valve.time_constant", 0.02, "ms"),
        (PID, "joint.geometry.connector_length", 208 * mm, "mm"),  # as written
        (PRINTED, "joint.geometry.connector_length", 190 * mm, "mm"),  # of the catalog
        (PID, "joint.geometry.joint_radius", 30 * mm, "mm"),
        (PID, "controller.position.kp", 2 * bar, "bar/rad"),
        (PID, "controller.position.filter_time", 0.005, "ms"),  # of the class
        (BACKPROP, "controller.position.momentum", 0.5, "1"),
        (BACKPROP, "controller.position.seed", 0, "1"),
        (PID, "reference.angle.amplitude", 10 * deg, "deg"),
        (PID, "reference.stiffness.after", 17.0, "N*m/rad"),
        (PRINTED, "reference.stiffness", 72.5, "N*m/rad"),
        (PID, "start.angle", 0.0, "deg"),
    ],
)
def test_a_number_has_its_unit_and_its_nominal_value(scenario, name, nominal, shown):
    address = find_parameter(scenario, name)
    assert address.name == name
    assert address.shown == shown
    assert address.nominal == pytest.approx(nominal, rel=1e-12)
    assert type(address.nominal) is (int if address.is_integer else float)
    assert address.is_integer == name.endswith("seed")


def test_parts_that_are_given_have_their_numbers(full):
    names = {address.name: address.nominal for address in list_parameters(full)}
    assert names["joint.tendon.stiffness"] == 20e3
    assert names["joint.geometry.connector_length"] == 0.208
    assert names["controller.model.geometry.connector_length"] == pytest.approx(0.19)
    assert names["controller.model.muscle.law.braid_angle"] == names["controller.model.muscle.specimen.braid_angle"]
    assert names["controller.model.geometry.joint_length"] == pytest.approx(0.37)
    assert names["reference.angle.offset"] == 0.0
    assert names["load.mass2"] == 0.8
    assert names["load.mass1"] == 0.5
    assert names["start.stiffness"] is None
    assert names["start.angle"] == 0.0
    assert not {name for name in names if name.startswith(("valve", "reference.stiffness"))}
    assert find_parameter(full, "joint.muscle2.law.a1").nominal == names["joint.muscle.law.a1"], "muscle 2 alone"


@pytest.mark.parametrize("scenario", [PID, BACKPROP, PRINTED, Scenario.parse(FULL)])
def test_every_listed_name_finds_itself_and_nominal_values_are_allowed(scenario):
    listed = list_parameters(scenario)
    assert len({address.name for address in listed}) == len({address.places for address in listed}) == len(listed) > 20
    for address in listed:
        assert find_parameter(scenario, address.name) == address
        if address.nominal is not None:
            assert address.holds(address.nominal)
            assert address.mark.read(address.write(address.nominal)) == address.nominal


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("duration", "one number for all runs"),
        ("name", "not a number"),
        ("joint.muscle.specimen", "a group of parameters"),
        ("load.hanging", "not a number"),
        ("controller.position.hidden", "size of what is compiled"),
        ("joint.tendon.stiffness", "tendon, of class rigid"),
        ("friction.torque", "the scenario has none"),
        ("controller.model.geometry.connector_length", "follows the plant"),
        ("controller.position.kp", "of class backprop"),
        ("reference.angle.after", "of class sine"),
        ("frequency.x", "no parameter"),
        ("load", "a group of parameters"),
    ],
)
def test_what_is_refused_says_why_and_what_to_do(name, why):
    with pytest.raises(ParameterError, match=why) as caught:
        find_parameter(BACKPROP, name)
    assert name.split(".")[-1] in str(caught.value)
    assert caught.value.remedy


def test_an_item_of_a_list_of_sines_is_a_parameter(full):
    found = find_parameter(full, "reference.angle.amplitudes.1")
    assert found.name == "reference.angle.amplitudes.1"
    assert found.nominal == 1 * deg
    assert with_values(full, {found.name: 0.1}).signals.angle.amplitudes == (3 * deg, 0.1)
    edited = edit_scenario(FULL, {"reference.angle.amplitudes.1": 2.5 * deg})
    assert "amplitudes: [3 deg, 2.5 deg]" in edited
    with pytest.raises(ParameterError) as caught:
        find_parameter(full, "reference.angle.amplitudes.2")
    assert "reference.angle.amplitudes.0" in caught.value.remedy


def test_one_number_by_two_spellings_is_an_error():
    with pytest.raises(ParameterError, match=r"'load\.mass2' and 'load\.mass2' are the same parameter"):
        find_parameters(PID, ["load.mass2", "start.angle", "load.mass2"])
    with pytest.raises(ParameterError, match="same parameter"):
        find_parameters(PID, ["joint.geometry.connector_length", "joint.geometry.connector_length"])


@given(st.text(max_size=200) | st.text("load.ms12controlpsin_", max_size=40))
def test_any_name_is_found_or_a_parameter_error(name):
    try:
        assert find_parameter(PID, name) in list_parameters(PID)
    except ParameterError as error:
        assert len(str(error)) < 400
