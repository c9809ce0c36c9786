"""Protocol files: what they say comes back, and what is wrong with them is told all at once."""

from pathlib import Path

import pytest

from mckibben.errors import ScenarioError
from mckibben.rig import IsobaricProtocol
from mckibben.rig.document import RigTest, read_test
from mckibben.rig.running import check

EXAMPLES = Path(__file__).parents[2] / "examples"
HEAD = """name: a test
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {simulated: {seed: 1}}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}
"""
STEPS = (
    HEAD
    + """protocol:
  steps:
    - vent
    - move: 10 %
    - move: {to: 5 %, speed: 1 mm/s}
    - dwell: 5 s
    - pressurise: 2 bar
    - pressurise: {pressure: 3 bar, rate: 0.5 bar/s, holding: 100 N}
    - hold_force: 100 N
    - acquire
    - acquire: {samples: 500, duration: 1 s, direction: loading, keep: false}
    - repeat:
        times: 3
        steps:
          - walk: {to: 20 %, step: 2 mm, acquire: {direction: unloading}}
          - walk
          - repeat: {times: 2, steps: [vent]}
"""
)


@pytest.mark.parametrize(
    "protocol",
    [
        "isobaric:",
        "isobaric: {pressures: [0 bar, 2.3 bar], step: 2 mm, force_reserve: 7 %, repeats: 3}",
        "isometric: {contractions: [0 %, 3.3 %], rate: 0.1 bar/s}",
        "isotonic:",
        "isotonic: {forces: [30 N], tolerance: 1 N}",
    ],
)
def test_a_whole_test_comes_back(protocol):
    test = RigTest.parse(f"{HEAD}protocol:\n  {protocol}\n")
    assert RigTest.parse(test.dumps()) == test


def test_steps_come_back_as_they_were_written():
    test = RigTest.parse(STEPS)
    text = test.dumps()
    assert RigTest.parse(text) == test
    assert "    - move: 10 %\n" in text and "    - hold_force: 100 N\n" in text
    assert RigTest.parse(text).dumps() == text


def test_everything_that_is_wrong_is_told_at_once_with_its_line():
    text = """name: a test
muscle: {specimen: MAS-10-180N, law: lei-mas-10-180n}
rig: {simulated: {seed: -1}}
limits: {pressure: 6.5, stretch: 8 mm}
protocol:
  steps:
    - move: 10
    - dwel: 5 s
    - acquire: {samples: none}
    - walk: {stp: 1 mm}
"""
    with pytest.raises(ScenarioError) as found:
        RigTest.parse(text, source="p.yaml")
    said = str(found.value)
    for part in (
        "line 2, muscle.specimen: 'MAS-10-180N' is not the name of a specimen; did you mean 'MAS-10-180N-AA-MC-O'?",
        "line 3, rig.simulated.seed: -1 is out of range (0 to",
        "line 4, limits.pressure: '6.5' has no unit; write it like '6.5 bar'",
        "line 4, limits.shorten: is missing",
        "line 7, protocol.steps[0].move: '10' has no unit, and as a ratio is out of range (-50 to 80 %); write '10 %'",
        "line 8, protocol.steps[1]: lacks the key `class`",
        "line 10, protocol.steps[3].walk.stp: is not a known key here; did you mean 'step'?",
        "line 9, protocol.steps[2].acquire.samples: 'none' is not a whole number",
    ):
        assert part in said, said
    assert said.startswith("p.yaml: 8 problems")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("isobaric:", "isobaric:\n  isotonic:"), "protocol: lacks the key `class`"),
        (("  isobaric:", "  {}"), "protocol: lacks the key `class`; give one of steps, isobaric, isometric, isotonic"),
        (("rig: {simulated: {seed: 1}}", "rig: {}"), "rig: lacks the key `class`; give one of .*simulated, nidaqmx"),
        ((", law: lei-mas-10-180n", ""), "rig: has no law for its simulated muscle; give"),
    ],
)
def test_what_does_not_go_together_is_told(change, message):
    with pytest.raises(ScenarioError, match=message.replace("{", r"\{").replace("}", r"\}")):
        RigTest.parse(f"{HEAD}protocol:\n  isobaric:\n".replace(*change))


@pytest.mark.parametrize("line", ["rate: 500", "rate: 1000 Hz", "supply: 3 bar"])
def test_what_the_rig_decides_is_not_set_by_the_recording(line):
    with pytest.raises(ScenarioError) as found:
        RigTest.parse(f"{STEPS}recording: {{{line}}}\n")
    (problem,) = found.value.problems
    assert problem.field == f"recording.{line.split(':')[0]}" and problem.remedy


def test_pressures_are_checked_against_the_supply_and_the_regulator():
    for limit in ("supply", "highest"):
        with pytest.raises(ScenarioError) as caught:
            check(RigTest.parse(STEPS.replace("{seed: 1}", f"{{regulator: {{{limit}: 2.5 bar}}}}")))
        (problem,) = caught.value.problems
        assert problem.field == "protocol.steps[5].pressurise.pressure" and problem.remedy


def test_what_exceeds_the_rig_is_told_with_its_line_before_anything_moves(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        STEPS.replace("pressurise: 2 bar", "pressurise: 7 bar").replace("step: 2 mm", "step: 2 mm, speed: 6 mm/s")
    )
    test, document = read_test(path)
    with pytest.raises(ScenarioError) as found:
        check(test, document, source="p.yaml")
    said = str(found.value)
    assert "line 11, protocol.steps[4].pressurise.pressure: 7 bar is above 6.5 bar" in said
    assert "line 19, protocol.steps[9].repeat.steps[0].walk.speed: 6 mm/s is above 5 mm/s" in said


def test_the_example_is_the_papers_test():
    checked = check(RigTest.read(EXAMPLES / "rig" / "paper-protocol.yaml"))
    assert checked.dry_run.samples == 5_850_000
    paper = IsobaricProtocol(contraction_min=0.0, contraction_max=0.245, slack_steps=44)
    assert checked.test.protocol == paper
    assert "5850 points, 5850000 samples" in checked.describe()


def test_a_card_and_its_wiring(tmp_path):
    (tmp_path / "card.yaml").write_text(Path("examples/rig/card.yaml").read_text().replace("Dev1", "Dev2"))
    text = HEAD.replace("rig: {simulated: {seed: 1}}", "rig: {nidaqmx: {card: card.yaml}}")
    test = RigTest.parse(f"{text}protocol:\n  isobaric:\n", folder=tmp_path)
    assert RigTest.parse(test.dumps(folder=tmp_path), folder=tmp_path) == test
    backend = check(test).backend
    assert [channel.where for channel in backend.inputs] == ["Dev2/ai0", "Dev2/ai1"]
    assert backend.inputs[0].high == 800 and backend.inputs[1].high < 1e6  # before the end of the converter
