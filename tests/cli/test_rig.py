"""`mckibben rig`, as it is typed."""

import pytest

from mckibben.rig.document import RigTest

TEXT = """name: a short test
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {simulated: {seed: 1}}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}
protocol:
  isobaric: {pressures: [3 bar, 4 bar, 6 bar], contraction_min: 2 %, contraction_max: 6 %, repeats: 2, speed: 4 mm/s,
    dwell: 200 ms, acquisition: 100 ms, samples: 100}
"""


@pytest.fixture
def protocol(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(TEXT)
    return path


def test_a_dry_run_prints_the_steps_and_what_they_take(cli, protocol, tmp_path):
    answer = cli("rig", "run", "p.yaml", "--dry-run")
    assert answer.code == 0 and answer.err == ""
    lines = answer.out.splitlines()
    assert lines[0] == "a short test: MAS-10-180N-AA-MC-O on the simulated rig"
    steps = RigTest.parse(TEXT[: TEXT.index("protocol:")] + "protocol:\n  " + "\n  ".join(lines[1:-2])).protocol.steps
    assert [step.short_name for step in steps[:6]] == ["vent", "move", "pressurise", "move", "dwell", "repeat"]
    assert steps[5].times == 2 and steps[5].steps[0].acquire.direction == "unloading"
    assert "96 points, 9600 samples, " in lines[-2] and "m of travel" in lines[-2]
    assert lines[-1].startswith("contraction 0..5.889 %, pressure 0..6 bar; ")
    assert {path.name for path in tmp_path.iterdir()} == {"p.yaml"}


@pytest.mark.slow
def test_it_runs_and_its_dataset_is_identified(cli, protocol):
    answer = cli("rig", "run", "p.yaml", "--out", "out")
    assert answer.code == 0, answer.err
    assert "96 points" in answer.out and "mckibben identify out/isobaric.nc" in answer.out
    found = cli("identify", "out/isobaric.nc", "--law", "chou", "--json")
    assert found.code == 0 and "ChouLaw describes" in found.out
    assert cli("rig", "data", "out").out.startswith("<IsobaricDataset")
    again = cli("rig", "run", "p.yaml", "--out", "out")
    assert again.code == 2 and "resume it (--resume)" in again.err


@pytest.mark.slow
def test_a_stopped_test_says_why_and_how_to_go_on(cli, protocol):
    protocol.write_text(TEXT.replace("shorten: 50 mm", "shorten: 50 mm, force: 300 N"))
    text = protocol.read_text().replace("law: lei-mas-10-180n}", "mounted_at: 0 %}")
    protocol.write_text(text.replace("{seed: 1}", "{seed: 1, law: lei-mas-10-180n}"))
    answer = cli("rig", "run", "p.yaml", "--out", "out")
    assert answer.code == 1
    for text in ("stopped: the force of 3", "beyond the limit of 300 N", "; the muscle is vented"):
        assert text in answer.err
    assert "resume with: mckibben rig run p.yaml --out out --resume" in answer.err


def test_check_shows_the_channels_and_what_stands_against_it(cli, protocol):
    answer = cli("rig", "check", "p.yaml")
    assert answer.code == 0, answer.err
    assert "force at simulated force: " in answer.out and " N" in answer.out
    assert answer.out.splitlines()[-1] == "no violations"
    protocol.write_text(TEXT.replace("shorten: 50 mm", "shorten: 5 mm"))
    answer = cli("rig", "check", "p.yaml")
    assert answer.code == 1 and "limits.shorten" in answer.out


def test_standing_at_is_for_a_test_that_goes_on(cli, protocol):
    answer = cli("rig", "run", "p.yaml", "--out", "out", "--standing-at", "5 %")
    assert answer.code == 2 and "add --resume" in answer.err
