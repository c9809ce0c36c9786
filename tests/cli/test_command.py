"""The command as a whole: exit codes, what goes where, what is imported."""

import errno
import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import mckibben
from mckibben import catalog
from mckibben.cli import app, options
from mckibben.errors import FileError
from mckibben.muscle import LAWS


def run(*arguments: str, cwd=None, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "mckibben", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={k: v for k, v in os.environ.items() if k != "MCKIBBEN_DEBUG"} | environment,
        timeout=120,
    )


ROOT = Path(__file__).parents[2]
LIGHT = "jax equinox matplotlib scipy xarray numpy"


@pytest.mark.parametrize(
    ("arguments", "unused"),
    [
        (["--help"], LIGHT),
        (["simulate", "--help"], LIGHT),
        pytest.param(["catalog"], "matplotlib scipy xarray pandas mckibben.control", marks=pytest.mark.slow),
        pytest.param(
            ["simulate", str(ROOT / "examples/pre-contracted-step-pid.yaml"), "--out", "results"],
            "matplotlib.pyplot scipy xarray pandas",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ["identify", "festo-tool-10mm"],
            "matplotlib scipy.stats scipy.signal mckibben.codegen mckibben.control mckibben.simulation",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_command_imports_only_what_it_needs(tmp_path, arguments, unused):
    code = (
        "import sys; unused, *sys.argv[1:] = sys.argv[1:]\n"
        "from mckibben.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "print('imported:', [m for m in unused.split() if m in sys.modules], file=sys.stderr)\n"
    )
    command = [sys.executable, "-c", code, unused, *arguments]
    found = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    assert found.stderr.strip() == "imported: []"
    assert found.stdout


@pytest.mark.parametrize("arguments", [["identify"], ["identify", "x", "--lw", "y"]])
def test_bad_usage_ends_with_2(cli, arguments):
    found = cli(*arguments)
    assert (found.code, found.out) == (2, "")
    assert "error: mckibben identify: " in found.err and "see mckibben identify --help" in found.err


def options_of(command, path=()):
    """Options of each command by its words, without those that only name the right one."""
    if commands := getattr(command, "commands", None):
        return {words: flags for name in commands for words, flags in options_of(commands[name], (*path, name)).items()}
    return {path: {p.opts[0] for p in command.params if p.param_type_name == "option" and not p.hidden}}


def test_commands_and_options_stay_few():
    """A new option names what it replaces: a file holds settings, and most of these are asked for once."""
    commands = options_of(typer.main.get_command(app))
    shared = {"--details", "--json", "--out", "--force"}
    assert len(commands) <= 25
    assert len(shared) + sum(len(flags - shared) for flags in commands.values()) <= 94
    assert sum(map(len, commands.values())) <= 161


MISTAKES = [
    ["identify", "nowhere.csv"],
    ["identify", "festo-tool-10mm", "--lw", "x"],
    ["identify", "festo-tool-10mm", "--law", "exponentiel"],
    ["validate", "unknown", "festo-tool-10mm"],
    ["simulat"],
    ["plan", "festo-tool-10mm", "--for", "everything"],
    ["catalog", "--extension"],
]


@pytest.mark.parametrize("width", [80, pytest.param(60, marks=pytest.mark.slow)])
def test_help_and_errors_keep_to_the_width_of_a_terminal_and_are_whole_in_a_pipe(cli, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    for words in options_of(typer.main.get_command(app)):
        common, whole = (cli(*words, option).out.splitlines() for option in ("--help", "--help-all"))
        assert max(map(len, (*common, *whole))) <= width, words
        assert len(common) <= 40 or width < 80, words
        options = {flag for line in whole for flag in re.findall(r"^  (--[a-z-]+)", line)}
        assert {flag for line in common for flag in re.findall(r"^  (--[a-z-]+)", line)} <= options
    for mistake in MISTAKES:
        piped = cli(*mistake)
        with monkeypatch.context() as terminal:
            terminal.setattr(sys.stderr, "isatty", lambda: True)
            shown = cli(*mistake)
        assert shown.code == piped.code == 2
        assert shown.err.split() == piped.err.split()
        assert max(map(len, shown.err.splitlines())) <= width


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("identify --la", "--law"),
        ("identify --law expo", "exponential"),
        ("identify --friction x --of cr", "creep"),
        ("identify dmsp-10", "dmsp-10-250-martens2017"),
        ("validate lei", "lei-mas-10-180n"),
        ("identify x.csv --read specimen=MAS", "specimen=MAS-10-180N-AA-MC-O"),
        ("sweep own-joint.yaml --over load.ma", "load.mass1"),
        ("simul", "simulate"),
    ],
)
def test_words_and_values_are_completed(cli, monkeypatch, tmp_path, typed, completed):
    (tmp_path / "own-joint.yaml").write_text((ROOT / "examples" / "own-joint.yaml").read_text())
    monkeypatch.setenv("_MCKIBBEN_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"mckibben {typed}")
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split())))
    assert completed in cli().out.splitlines()


def test_a_fault_of_ours_ends_with_1_and_says_what_to_do(cli, monkeypatch):
    import mckibben.scenario.inputs

    def faulty(*_, **__):
        raise ZeroDivisionError("deep inside")

    monkeypatch.setattr(mckibben.scenario.inputs, "data_named", faulty)
    found = cli("identify", "festo-tool-10mm")
    assert (found.code, found.out) == (1, "")
    assert found.err.startswith("failed: ZeroDivisionError: deep inside\n")
    assert "MCKIBBEN_DEBUG=1" in found.err
    assert "Traceback" not in found.err
    monkeypatch.setenv("MCKIBBEN_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli("identify", "festo-tool-10mm")


def test_version(cli):
    assert cli("--version") == (0, f"mckibben {mckibben.__version__}\n", "")


def test_the_catalog_lists_laws_and_entries_at_any_width(cli, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    found = cli("catalog")
    assert (found.code, found.err) == (0, "")
    for name in (
        *LAWS,
        *(name for kind in ("laws", "specimens", "datasets", "valves") for name in catalog.names(kind)),
    ):
        assert name in found.out
    assert max(map(len, found.out.splitlines())) <= 80
    tables = {table["title"]: table["columns"] for table in json.loads(cli("catalog", "--json").out)["tables"]}
    assert tables["Force laws"]["law"]["values"] == list(LAWS)
    row = tables["Specimens"]["name"]["values"].index("MAS-10-180N-AA-MC-O")
    size = [tables["Specimens"][name]["values"][row] for name in ("initial_length", "initial_diameter", "rated_force")]
    assert size == pytest.approx([0.18, 0.01, 630])


def test_a_log_gets_lines_of_progress_with_the_time_left(monkeypatch, capsys):
    clock = itertools.count(100.0, 4.0)
    monkeypatch.setattr(options.time, "monotonic", lambda: next(clock))
    with options.job_progress() as report:
        for part in range(101):
            report("tuning", part / 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["tuning", "3 % after 0:00:12, about 0:06:28 left: tuning"]
    assert 8 < len(lines) < 20


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO])
def test_a_disk_that_takes_no_more_says_what_is_kept(tmp_path, number):
    (tmp_path / "old").touch()
    os.utime(tmp_path / "old", (0, 0))
    with pytest.raises(FileError) as caught, options.keeping(tmp_path):
        (tmp_path / "new").touch()
        raise OSError(number, os.strerror(number))
    (problem,) = caught.value.problems
    assert problem.message.endswith("; kept are new") and "--force" in problem.remedy
    with pytest.raises(FileNotFoundError), options.keeping(tmp_path):
        (tmp_path / "missing").read_bytes()
    with pytest.raises(FileError, match="has disappeared"), options.keeping(tmp_path / "out"):
        (tmp_path / "out" / "file").read_bytes()


def test_a_full_disk_while_printing_is_one_line_and_exit_1():
    with Path("/dev/full").open("w") as full:
        found = subprocess.run(
            [sys.executable, "-m", "mckibben", "--version"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60
        )
    assert found.returncode == 1
    assert found.stderr == f"failed: the output is incomplete: {os.strerror(errno.ENOSPC)}\n"


def test_a_closed_pipe_is_not_a_failure():
    reading, writing = os.pipe()
    os.close(reading)
    found = subprocess.run(
        [sys.executable, "-m", "mckibben", "--version"], stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60
    )
    os.close(writing)
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.slow
def test_names_that_the_terminal_cannot_show_are_escaped(tmp_path, shortened):
    text = shortened("pre-contracted-step-pid")
    name = re.search("^name: (.*)$", text, re.MULTILINE)[1]
    (tmp_path / "odd.yaml").write_text(text.replace(name, "Knie ü \N{GRINNING FACE}"), encoding="utf-8")
    found = run("sweep", "odd.yaml", "--list", cwd=tmp_path, PYTHONIOENCODING="ascii")
    assert (found.returncode, found.stderr) == (0, "")
    assert r"Knie \xfc \U0001f600" in found.stdout


def test_an_interrupt_during_an_import_ends_the_command_without_a_word(tmp_path):
    (tmp_path / "slow.py").write_text(
        "import os, signal\ntry: os.kill(os.getpid(), signal.SIGINT)\nexcept BaseException: pass\n"
    )
    found = run("--extension", "slow.py", "catalog", cwd=tmp_path)
    assert (found.returncode, found.stdout, found.stderr) == (130, "", "")
