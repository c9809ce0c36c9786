# ruff: noqa: E501 - tables of cases
"""Mistakes of each command: one error with its place and remedy, before anything moves or is written."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES, TABLES = ROOT / "examples", ROOT / "src" / "mckibben" / "catalog" / "tables"
FESTO, MARTENS = str(TABLES / "festo-tool_10mm.csv"), "dmsp-10-250-martens2017"
KNEE = str(EXAMPLES / "calibration" / "knee.yaml")
FAR = "start: {angle: 0 deg, stiffness: 12 N*m/rad}", "start: {angle: 12 deg}"
SIZING = (EXAMPLES / "sizing" / "pulleys.yaml").read_text(encoding="utf-8")
SUITE = (ROOT / "tests" / "small-suite.yaml").read_text(encoding="utf-8")
MASS, WEIGHT = ("--over", "load.mass2=0.2 kg..1.0 kg"), ("--weight", "0.5 kg, 200 mm")
COST = ("--cost", "angle_rmse/1 deg + stiffness_rmse/1 N*m/rad", "--out", "x")
START = ("tune", "s.yaml", "--over", "start.angle=-5..8 deg", *COST)
CONDITIONS = ("tune", "s.yaml", "--over", "controller.position.kp=1..4 bar/rad", "--out", "x")


@pytest.fixture
def files(tmp_path, shortened):
    """Files with and without mistakes, and their folder."""
    text = shortened("pre-contracted-step-pid")
    texts = {
        "s.yaml": text,
        "short-connector.yaml": text.replace("208 mm", "190 mm").replace(*FAR),
        "still.yaml": re.sub("stiffness: {class: step.*}", "stiffness: 15 N*m/rad", text),
        "suite.yaml": SUITE.replace("untuned: [as it is]", "untuned: [as it iss]"),
        "no-angles.yaml": SIZING.replace("angles: [-30 deg, 30 deg]\n", ""),
        "no-muscle.yaml": SIZING.replace("supply: 6 bar", "supply: 6 bar\nmuscles: [missing.yaml]"),
        "wrong-rig.yaml": "rig:\n  simulated: {angle_step: 5 bar}\n",
        "no-rig.yaml": "name: none\n",
        "indented.yaml": text.replace("\nload:", "\n  load:"),
        "uneven.yaml": "joint: {}\nvalve: {}\n  load: {}\n",
        "good.py": "from mckibben.control import Sine\n\nclass Wave(Sine):\n    pass\n\nWAVE = Wave(0.1, 2.0)\n",
    }
    for name, content in texts.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "knee-tuned.yaml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "joint.yaml"), "simulate"),
        (("stiffnes", "joint.yaml"), "stiffness"),
        (("export", "joint.yaml"), "--to"),
        (("export", "joint.yaml", "--to", "arduino"), "did you mean firmware?"),  # before --out
        (("robot", "redd", "joint.yaml"), "did you mean 'read'?"),
        (("identify", FESTO, "--of", "torqe"), "did you mean 'torque'?"),
        (("simulate", "sub/scenario.yaml"), "is it 'knee-tuned.yaml'?"),
        (("simulate", "indented.yaml"), "joint.load: is indented too far"),
        (("simulate", "uneven.yaml"), "is indented otherwise"),
        (("tune", "s.yaml", "--iterations", "-3"), "iterations is -3"),
        pytest.param(("simulate", "short-connector.yaml"), "a longer connector_length", marks=pytest.mark.slow),
        (("identify", "nowhere.csv"), "nowhere.csv: 1 problem\n  there is no such file; "),
        (("identify", "dmsp-10-250-martens207"), "did you mean 'dmsp-10-250-martens2017'?"),
        (("identify", FESTO, "--column", "force_N"), "--column 'force_N'"),
        (("identify", FESTO, "--friction", "coulombic"), "take auto, on, off, coulomb"),
        (("identify", FESTO, "--friction", "on", "--law", "all"), "--friction"),
        (("validate", "nobody", FESTO), "there is no law 'nobody'; give a fit file"),
        (("validate", "chou", FESTO), "add --read specimen=NAME, a file or one of MAS-10-180N-AA-MC-O, DMSP-10-250"),
        (("plan", MARTENS, "--for", "happiness"), "is not a quantity of interest; give stiffness, force"),
        (("plan", MARTENS, "--points", "0"), "0 points are not within 1..200"),
        (("plan", MARTENS, "--step", "1 bar, 0.5 bar"), "--step: unit 'bar'"),
        (("size", "no-angles.yaml"), "angles"),
        (("size", "no-muscle.yaml"), "missing.yaml"),
        (("stiffness", "s.yaml", "--motion", "1 deg, 10 deg"), "--motion"),
        (("sweep", "s.yaml", *MASS), "--out DIR"),
        (("sweep", "s.yaml", "--out", "x", "--over", "load.mas2=1..2 kg"), "did you mean 'load.mass2'?"),
        (("sweep", "s.yaml", "--out", "x", "--resume"), "there is no study to continue"),
        (("sweep", "s.yaml", "--out", "x", "--resume", "--force", *MASS), "leave --force out"),
        (("sweep", "s.yaml", "--out", "/proc/x", *MASS), "/proc/x: 1 problem\n  it cannot be made"),
        (START[:-2], "--out DIR"),
        (("tune", "s.yaml", "--over", "controller.positon.kp"), "did you mean 'controller.position.kp'"),  # before --out
        pytest.param(("tune", "still.yaml", *START[2:], "--cost", "coupling"), "coupling is not defined", marks=pytest.mark.slow),
        ((*START, "--resume"), "no study to continue; leave out --resume"),
        ((*CONDITIONS, "--percentile", "50"), "--conditions"),
        ((*CONDITIONS, "--conditions", "load.mass2=0.5 kg"), "does not vary"),
        (("compare", "s.yaml"), "--out DIR"),
        (("compare", "suite.yaml", "--out", "x"), "tuning.untuned[0]: there is no controller 'as it iss'"),
        (("calibrate", KNEE, "--out", "x", "--weight", "0.5 kg"), "--weight"),
        (("calibrate", KNEE, "--out", "x", "--duration", "5 s"), "duration"),
        (("calibrate", KNEE, "--out", "x", "--weighted", "w.csv"), "weight"),
        pytest.param(("calibrate", KNEE, "--out", "x", *WEIGHT, "--limb", "weighed", "--angles", "5..5 deg"), "angle", marks=pytest.mark.slow),
        (("calibrate", KNEE, "--out", "x", "--prior", "missing.yaml"), "missing.yaml"),
        (("calibrate", KNEE, "--out", "x", "--valves", *WEIGHT), "--valves"),
        (("rig", "control", "s.yaml"), "give one with --out DIR"),
        (("rig", "control", "s.yaml", "--out", "x", "--rig", "wrong-rig.yaml"), "line 2, rig.simulated.angle_step: unit 'bar'"),
        (("rig", "control", "s.yaml", "--out", "x", "--rig", "no-rig.yaml"), "rig: is missing; add it, such as `rig: simulated`"),
        (("rig", "control", "s.yaml", "--out", "s.yaml"), "it is a file"),
        (("check", "missing.py"), "missing.py"),
        (("check", "good.py", "--with", "rate"), "--with"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_error_and_nothing_is_in_the_way_of_the_next_try(cli, files, arguments, words):
    before = {path: path.read_bytes() for path in files.rglob("*") if path.is_file()}
    found = cli(*arguments)
    assert (found.code, found.out) == (2, ""), found
    assert re.search("^error: ", found.err, re.MULTILINE)  # after warnings
    assert words in found.err and "Traceback" not in found.err
    after = [path for path in files.rglob("*") if path.is_file() and path.suffix != ".pyc"]  # of an extension
    assert {path: path.read_bytes() for path in after} == before


@pytest.mark.slow
def test_a_run_that_swings_over_has_failed(cli, tmp_path, shortened):
    text = shortened("pre-contracted-step-pid").replace("ki: 60 bar/(rad*s)", "ki: 60 bar/(deg*s)")
    (tmp_path / "slip.yaml").write_text(text.replace("duration: 200 ms", "duration: 4 s"), encoding="utf-8")
    found = cli("simulate", "slip.yaml", "--out", "kept")
    assert found.code == 1
    assert "diverged: the angle error exceeded 90 deg" in found.out
    assert (tmp_path / "kept" / "result.nc").is_file()  # to see why


def test_lengths_that_no_muscle_has_are_doubted(cli, tmp_path):
    rows = [f"{p},{length},{p * (length - 130)},-" for p in (1, 2, 3) for length in (140, 150, 160, 170, 180, 185)]
    (tmp_path / "rig.csv").write_text("\n".join(["pressure_bar,length_mm,force_N,Bemerkung", *rows, ""]))
    for length, code in (("120 mm", 2), ("190 mm", 0), ("180", 2)):
        found = cli("identify", "rig.csv", "--initial-length", length, "--column", "Bemerkung=ignore")
        assert found.code == code
        assert ("Bemerkung" if code == 0 else "--initial-length") in found.err
