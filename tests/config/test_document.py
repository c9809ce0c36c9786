"""Hostile and damaged YAML and JSON, for every kind of configuration file; text written and read back."""

import re
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mckibben.config.document import edit_yaml, read_document, to_text
from mckibben.dataset import read_dataset
from mckibben.errors import DatasetError, ScenarioError
from mckibben.identification import Fit, read_law
from mckibben.rig.document import RigTest
from mckibben.rig.joint_rig import JointRig
from mckibben.scenario import Scenario
from mckibben.study.compare.suite import Suite
from mckibben.units import HINGE, SLIDE

READERS = [Scenario.read, Suite.read, RigTest.read, JointRig.read, read_law, Fit.from_yaml]
EXAMPLES = Path(__file__).parents[2] / "examples"
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + previous] * 9)}]\n"
    for previous, name in zip("abcdefgh", "bcdefghi", strict=True)
)
HOSTILE = {
    "aliases": BOMB,
    "brackets": "[" * 1_000,
    "braces": "{a: " * 20_000,
    "tag of an integer": "law: !!int abc",
    "date": "law: 2020-99-99",
    "long integer": f"law: {'9' * 5000}",
    "duplicate omap": "law: !!omap [a: 1, a: 2]",
    "version": "%YAML 1.99999\n---\nlaw: x",
    "huge version": f"%YAML 1.{'9' * 5000}\n---\nlaw: x",
    "escape beyond Unicode": 'law: "\\UFFFFFFFF"',
    "escape of a surrogate": 'law: "\\uD800"',
    "duplicate key": "law: x\nlaw: y",
    "python object": "law: !!python/object/apply:os.system [echo]",
    "merge key": "<<: {law: x}",
    "keys that are lists": "[a]: 1\n{b: 1}: 2",
    "null": "law: \0",
    "recursive alias": "&a [*a]",
    "too long": "a" * 300_000,
    "too long to read": "é" * 1_500_000,
}


@pytest.mark.parametrize(
    ("name", "read"), [*((name, Scenario.read) for name in HOSTILE), *(("duplicate key", read) for read in READERS)]
)
def test_hostile_text_is_an_error_of_moderate_length(name, read, tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text(HOSTILE[name], encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        read(path)
    assert len(str(caught.value)) < 5000
    assert all(problem.message for problem in caught.value.problems)
    if not name.startswith("too long"):
        assert any(problem.line is not None for problem in caught.value.problems)


WORDS = st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn")), max_size=20)
PLAIN = st.recursive(
    WORDS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3), max_leaves=12
)


def _as_read(value):
    if isinstance(value, dict):
        return {key: _as_read(item) for key, item in value.items()}
    return tuple(map(_as_read, value)) if isinstance(value, list) else value


@given(st.dictionaries(WORDS, PLAIN, min_size=1, max_size=5))
@example({"k" * 100: {}})
def test_what_is_written_is_read_back(data):
    document = read_document(to_text(data))
    assert not document.problems
    assert document.data == _as_read(data)


def _scalars(value, place=()):
    if isinstance(value, str):
        yield place
    else:
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _scalars(item, (*place, key))


def test_every_scalar_of_an_example_can_be_edited_alone():
    text = (EXAMPLES / "pre-contracted-step-pid.yaml").read_text()
    document = read_document(text)
    places = list(_scalars(document.data))
    assert len(places) > 15
    assert edit_yaml(text, {}) == text
    for place in places:
        changed = edit_yaml(text, {place: "new"})
        assert re.findall(r" *#.*", changed) == re.findall(r" *#.*", text)
        edited = read_document(changed)
        assert edited.lines == document.lines
        assert [at for at in places if edited.value(at) != document.value(at)] == [place]


@pytest.mark.parametrize(
    "name",
    """
        comparison/knee.yaml rig/paper-protocol.yaml rig/joint-rig.yaml your-muscle/fit/fit.yaml
        your-muscle/fit/muscle.yaml
    """.split(),
)
def test_a_file_of_another_kind_is_one_problem(name):
    with pytest.raises(ScenarioError) as caught:
        Scenario.read(EXAMPLES / name)
    (problem,) = caught.value.problems
    assert problem.line is None and "examples/" in problem.remedy
    with pytest.raises(ScenarioError) as caught:
        Suite.read(EXAMPLES / "pre-contracted-step-pid.yaml")
    assert len(caught.value.problems) == 1


def test_a_model_for_mujoco_is_one_problem_with_the_command_that_reads_it():
    with pytest.raises(ScenarioError) as caught:
        Scenario.read(EXAMPLES / "robot" / "arm.xml")
    (problem,) = caught.value.problems
    assert problem.line == 1 and "`mckibben robot read" in problem.remedy


@pytest.mark.parametrize("name", ["own-joint.yaml", "comparison/knee.yaml", "robot/lei-leg.yaml"])
def test_a_configuration_is_not_read_as_measurements(name):
    with pytest.raises(DatasetError) as caught:
        read_dataset(EXAMPLES / name)
    (problem,) = caught.value.problems
    assert problem.line is None and problem.remedy


def test_a_scenario_with_misspelt_sections_is_still_a_scenario():
    text = (EXAMPLES / "pre-contracted-step-pid.yaml").read_text().replace("\nload:", "\nlod:")
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(text)
    assert [problem.field for problem in caught.value.problems] == ["lod"]


def test_what_stands_beside_a_slide_is_in_its_units():
    text = "rig: simulated\nlimits: {lowest_angle: -30 UNIT, angle_rate: 300 UNIT/s}"
    limits = JointRig.parse(text.replace("UNIT", "mm"), joint_type=SLIDE).limits
    assert (limits.lowest_angle, limits.angle_rate) == pytest.approx((-0.03, 0.3))
    for unit, joint_type in (("deg", SLIDE), ("mm", HINGE)):
        with pytest.raises(ScenarioError) as caught:
            JointRig.parse(text.replace("UNIT", unit), joint_type=joint_type)
        assert {problem.field for problem in caught.value.problems} == {"limits.lowest_angle", "limits.angle_rate"}
