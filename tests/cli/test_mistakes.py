"""Mistakes that newcomers made, and what they are told."""

import pytest


@pytest.mark.slow
def test_a_run_that_swings_over_has_failed(cli, tmp_path, shortened):
    text = shortened("pre-contracted-step-pid").replace("ki: 60 bar/(rad*s)", "ki: 60 bar/(deg*s)")
    text = text.replace("duration: 200 ms", "duration: 4 s")
    (tmp_path / "slip.yaml").write_text(text, encoding="utf-8")
    found = cli("simulate", "slip.yaml", "--out", "kept")
    assert found.code == 1
    assert "diverged: the angle error exceeded 90 deg" in found.out
    assert (tmp_path / "kept" / "result.nc").is_file()  # to see why


def test_a_part_that_makes_no_sense_is_named(cli, tmp_path, shortened):
    text = shortened("pre-contracted-step-pid")
    (tmp_path / "long.yaml").write_text(text.replace("208 mm", "500 mm"), encoding="utf-8")
    found = cli("simulate", "long.yaml")
    assert found.code == 2
    assert found.err.startswith("error: long.yaml: 1 problem")
    assert "joint" in found.err
    assert "connector_length is 0.5" in found.err


@pytest.mark.parametrize(
    ("connector", "remedy"),
    [("190 mm", "a longer connector_length"), ("255 mm", "a shorter connector_length or a shorter muscle")],
)
def test_the_remedy_points_the_right_way(cli, tmp_path, shortened, connector, remedy):
    text = shortened("pre-contracted-step-pid").replace("208 mm", connector)
    text = text.replace("start: {angle: 0 deg, stiffness: 12 N*m/rad}", "start: {angle: 12 deg}")
    (tmp_path / "far.yaml").write_text(text, encoding="utf-8")
    found = cli("simulate", "far.yaml")
    assert found.code == 2
    assert "start: contraction" in found.err
    assert remedy in found.err


def test_lengths_that_no_muscle_has_are_doubted(cli, tmp_path):
    rows = "\n".join(
        f"{p},{length},{p * (length - 130)}" for p in (1, 2, 3) for length in (140, 150, 160, 170, 180, 185)
    )
    (tmp_path / "rig.csv").write_text(
        f"pressure_bar,length_mm,force_N,Bemerkung\n{rows.replace(chr(10), ',-' + chr(10))},-\n"
    )
    ignored = "--column", "Bemerkung=ignore"
    found = cli("identify", "rig.csv", "--initial-length", "120 mm", *ignored)
    assert found.code == 2
    assert "--initial-length" in found.err
    assert "Bemerkung" in cli("identify", "rig.csv", "--initial-length", "190 mm", *ignored).err
    named = cli("identify", "rig.csv", "--initial-length", "180", *ignored)
    assert named.code == 2
    assert "--initial-length" in named.err


def test_a_name_of_the_catalog_with_a_slip_is_guessed(cli):
    found = cli("identify", "dmsp-10-250-martens207")
    assert found.code == 2
    assert "did you mean 'dmsp-10-250-martens2017'?" in found.err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("run", "joint.yaml"), "simulate"),
        (("fit", "rig.csv"), "identify"),
        (("stiffnes", "joint.yaml"), "stiffness"),
        (("export", "joint.yaml"), "--to"),
    ],
)
def test_a_wrong_command_names_the_one_that_is_meant(cli, words, meant):
    found = cli(*words)
    assert found.code == 2
    assert found.err.startswith("error: ") and meant in found.err
