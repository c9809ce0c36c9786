"""Muscles and loads of one's own in files: they read, write and build, and each mistake is named with its file."""

import re
from pathlib import Path
from typing import Any

import pytest

import mckibben as mk
from mckibben.errors import RangeError, ScenarioError
from mckibben.identification import read_law
from mckibben.rig.document import RigTest
from mckibben.scenario import Scenario, edit_scenario, write_muscle
from mckibben.units import bar, mm

FOLDER = Path(__file__).parent / "own_muscle"
TEXT = (FOLDER / "pendulum.yaml").read_text()
MUSCLE, LOAD = "muscle: fit/muscle.yaml", "load: {class: pendulum, mass: 2 kg, length: 250 mm, damping: 0.1 N*m*s/rad}"


def read(muscle="fit/muscle.yaml", load=LOAD, folder=FOLDER):
    text = TEXT.replace(MUSCLE, f"muscle: {muscle}")
    return Scenario.parse(text.replace(LOAD, load), folder=folder)


def built(muscle, folder=FOLDER) -> Any:
    return read(muscle, folder=folder).plant().joint.muscle1


def problem(muscle="fit/muscle.yaml", load=LOAD, folder=FOLDER):
    with pytest.raises(ScenarioError) as caught:
        read(muscle, load, folder)
    assert len(caught.value.problems) == 1, caught.value
    return caught.value.problems[0]


def test_a_muscle_from_its_file():
    muscle = built("fit/muscle.yaml")
    assert (muscle.specimen.name, muscle.specimen.initial_length) == ("my muscle", 300 * mm)
    assert muscle.law == read_law(FOLDER / "fit" / "fit.yaml")
    assert float(muscle.friction.half_width) == 7.0
    assert muscle.specimen.domain.contraction_max == 0.22  # the law's
    assert (muscle.specimen.domain.pressure_min, muscle.specimen.domain.pressure_max) == (0.0, 6 * bar)


def test_changes_of_a_file_and_of_a_catalog_entry():
    law = "law: fit/fit.yaml"
    for text, length, diameter in (
        ("{from: fit/muscle.yaml, specimen: {initial_length: 310 mm}, friction: {half_width: 9 N}}", 310, 20),
        (f"{{specimen: fit/muscle.yaml, {law}}}", 300, 20),
        (f"{{specimen: {{from: fit/muscle.yaml, initial_diameter: 18 mm}}, {law}}}", 300, 18),
        (f"{{specimen: {{from: DMSP-10-250, initial_length: 120 mm}}, {law}}}", 120, 10),
    ):
        muscle = built(text)
        assert muscle.specimen.initial_length / mm == pytest.approx(length)
        assert muscle.specimen.initial_diameter / mm == pytest.approx(diameter)
    narrower = built("{specimen: {from: DMSP-10-250, domain: {pressure_max: 4 bar}}, law: chou}")
    assert (narrower.specimen.domain.pressure_max, narrower.specimen.domain.contraction_max) == (4 * bar, 0.25)


def test_a_kept_scenario_has_relative_paths_and_reads_back(tmp_path):
    scenario = read("{from: fit/muscle.yaml, strength: 0.9}")
    scenario.to_yaml(tmp_path / "kept.yaml")
    assert re.search(r"law: \.\./\S*/fit/fit.yaml", (tmp_path / "kept.yaml").read_text())
    assert Scenario.read(tmp_path / "kept.yaml") == scenario
    changed = edit_scenario(TEXT, {"joint.muscle.friction.half_width": 8.0}, folder=FOLDER)
    assert "{from: fit/muscle.yaml, friction: {half_width: 8 N}}" in changed
    friction: Any = Scenario.parse(changed, folder=FOLDER).plant().joint.muscle1.friction
    assert float(friction.half_width) == 8.0


@pytest.mark.parametrize(
    ("muscle", "field", "said"),
    [
        ("fit/mucsle.yaml", "joint.muscle", "fit/mucsle.yaml"),
        ("fit/fit.yaml", "joint.muscle", "is a fit"),
        ("{from: fit/muscle.yaml, strenght: 0.9}", "joint.muscle.strenght", "not a known key"),
        ("{specimen: {name: x, initial_length: 300}, law: chou}", "joint.muscle.specimen.initial_length", "no unit"),
        (
            "{specimen: {name: x, initial_length: 1 m, domain: {pressure_min: 5 bar, pressure_max: 1 bar}}, law: chou}",
            "joint.muscle.specimen.domain",
            "pressure",
        ),
    ],
)
def test_mistakes(muscle, field, said):
    found = problem(muscle)
    assert found.field == field and found.line == 8 and said in found.message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("specimen: {name: x, initial_lenght: 3 m}\nlaw: chou", "specimen.initial_lenght"),
        ("specimen: DMSP-10-250\nlaw: missing.yaml", "missing.yaml"),
        ("from: muscle.yaml", "itself"),
    ],
)
def test_a_mistake_in_a_muscle_file_names_both_files(tmp_path, text, said):
    (tmp_path / "muscle.yaml").write_text(text)
    found = problem("muscle.yaml", folder=tmp_path)
    assert found.field == "joint.muscle" and found.line == 8
    assert "muscle.yaml: line" in found.message and said in found.message


RIG = """
name: own test
muscle: fit/muscle.yaml
rig: {simulated: {seed: 1}}
limits: {pressure: 6.5 bar, stretch: 5 mm, shorten: 80 mm}
protocol: {isobaric: {pressures: [2 bar, 6 bar], repeats: 1}}
"""


def test_the_rig_tests_a_muscle_from_its_file(tmp_path):
    test = RigTest.parse(RIG, folder=FOLDER)
    bench = test.bench(test.rig.backend())
    assert isinstance(bench.of, mk.Muscle) and bench.specimen.name == "my muscle"
    assert bench.limits.force == 1500.0
    (tmp_path / "bare.yaml").write_text(
        f"specimen: {{name: x, initial_length: 0.3 m}}\nlaw: {FOLDER / 'fit/fit.yaml'}\n"
    )
    with pytest.raises(ScenarioError) as caught:
        RigTest.parse(RIG.replace("fit/muscle.yaml", "bare.yaml"), folder=tmp_path)
    assert [one.field for one in caught.value.problems] == ["limits"]


def test_a_muscle_file_is_written_from_what_is_known(tmp_path):
    friction = mk.MaxwellSlip(half_width=7.0, presliding_length=0.5123456 * mm)
    path, known = tmp_path / "muscle.yaml", {"law": str(FOLDER / "fit" / "fit.yaml"), "friction": friction}
    law = read_law(FOLDER / "fit" / "fit.yaml")
    assert write_muscle(path, law, specimen="mine", initial_length=0.3, volume=1e-4, **known)
    muscle = built("muscle.yaml", tmp_path)
    assert (muscle.specimen.name, muscle.specimen.initial_length) == ("mine", 0.3)
    assert float(muscle.friction.half_width) == 7.0
    assert float(muscle.specimen.volume(0.0)) == pytest.approx(1e-4)
    bounds = {"presliding_length": 1.2 * mm}
    assert write_muscle(path, law, specimen="mine", initial_length=0.3, undetermined=bounds, **known)
    assert float(built("muscle.yaml", tmp_path).friction.presliding_length) == pytest.approx(0.51 * mm, rel=1e-12)
    assert any(line.startswith("#") and "presliding_length" in line for line in path.read_text().splitlines())
    assert write_muscle(path, law, specimen="DMSP-10-250", initial_length=None, **known)
    assert "specimen: DMSP-10-250" in path.read_text()
    path.unlink()
    assert not write_muscle(path, law, specimen="mine", initial_length=None, **known) and not path.exists()


def test_a_valve_with_air_needs_the_volume_of_the_muscle():
    air = "{class: FlowValve, conductance: 0.4 L/(s*bar), supply: 7 bar}"
    text = re.sub(r"valve: .*", f"valve: {air}", TEXT)
    unknown = text.replace(MUSCLE, "muscle: {specimen: {name: x, initial_length: 300 mm}, law: fit/fit.yaml}")
    with pytest.raises(RangeError) as caught:
        Scenario.parse(unknown, folder=FOLDER).plant()
    assert caught.value.field == "initial_diameter"
    Scenario.parse(text, folder=FOLDER).plant()
