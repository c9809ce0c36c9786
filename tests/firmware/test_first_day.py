"""Every command of docs/first-day.md, on the firmware of this computer with a simulated joint."""

import io
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben.cli import main
from mckibben.codegen.native import compiler
from mckibben.component.schema import read_component
from mckibben.muscle import Muscle, forces
from mckibben.rig.serial_line import SerialBackend
from mckibben.units import bar, deg

pytest.importorskip("serial", reason="needs the extra rig")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make"),
]
ROOT = Path(__file__).parents[2]
MUSCLE = Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), mk.catalog.law("lei-mas-10-180n"))


def commands():
    blocks = re.findall(r"^```sh\n(.*?)^```", (ROOT / "docs" / "first-day.md").read_text(), re.DOTALL | re.MULTILINE)
    lines = [line.partition("  #")[0].strip() for block in blocks for line in block.splitlines()]
    return [line.removeprefix("mckibben ") for line in lines]


class Board:
    """The firmware in a folder, as a process with a serial port."""

    process = None

    def flash(self, *weight):
        self.unplug()
        subprocess.run(["make", "-s", "-C", "firmware"], check=True)
        Path("board").unlink(missing_ok=True)
        self.process = subprocess.Popen(["firmware/firmware", "board", *weight])
        while not Path("board").exists():
            time.sleep(0.01)

    def unplug(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()


def change(name, texts):
    """Replace texts of a file, here by what takes less time."""
    text = Path(name).read_text(encoding="utf-8")
    for old, new in texts.items():
        assert old in text
        text = text.replace(old, new)
    Path(name).write_text(text, encoding="utf-8")


def clip_on(board):
    """Answers of an operator: the joint is bare; then the weight is clipped on."""
    yield "y"
    board.flash("0.5", "0.2")
    yield "y"


class Operator(io.TextIOBase):
    """Standard input with an answer for each question, made when it is asked."""

    def __init__(self, answers):
        self.answers = answers

    def readline(self, *_):
        return f"{next(self.answers)}\n"


def test_each_command_of_the_first_day_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(SerialBackend, "patience", 1.0)  # other tests run at the same time
    for path in (ROOT / "examples" / "first-day").iterdir():
        shutil.copy(path, tmp_path)
    change("bench.yaml", {"dwell: 1 s": "dwell: 40 ms", "500 ms": "100 ms", "samples: 500": "samples: 25"})
    change("bench.yaml", {"rate: 2 bar/s": "rate: 10 bar/s"})
    change("bench.yaml", {"MAS-10-180N-AA-MC-O}": "MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"})
    change("bench.yaml", {"{cycle: 40 ms}": "{cycle: 40 ms, steady: 200 ms}", "gap: 3 s": "gap: 3 s, settling: 30 s"})
    quick = "approach: {probing: 1 s, raising: 500 ms, settling: 500 ms}\n"
    Path("rig.yaml").write_text(Path("rig.yaml").read_text(encoding="utf-8") + quick, encoding="utf-8")
    host = "board: host\nsilence: 2 s\n"  # other tests run at the same time
    Path("board.yaml").write_text(
        f"{host}limits: {{frozen: 900 s, lowest_angle: -180 deg, highest_angle: 180 deg}}\n", encoding="utf-8"
    )
    board = Board()
    try:
        for command in commands():
            if command.endswith("--force"):
                Path("board.yaml").write_text(host, encoding="utf-8")
            arguments = [*re.sub(r"'(.*?)'", lambda m: m[1].replace(" ", "\0"), command).split()]
            arguments = [argument.replace("\0", " ") for argument in arguments]
            arguments += ["--duration", "20 s"] * (arguments[0] == "calibrate")
            arguments += ["--operator", "simulated"] * (arguments[:2] == ["rig", "run"])
            monkeypatch.setattr(sys, "stdin", Operator(clip_on(board)))
            monkeypatch.setattr(sys, "argv", ["mckibben", *arguments])
            with pytest.raises(SystemExit) as end:
                main()
            assert not end.value.code or arguments[1] == "control", (
                command,
                capsys.readouterr(),
            )  # a busy host is late
            if arguments[0] in ("export", "calibrate"):
                board.flash()
            if arguments[0] == "new":
                change(arguments[2], {"control_period: 1 ms": "control_period: 4 ms", "duration: 4 s": "duration: 2 s"})
        fitted = read_component(Muscle, Path("fit/muscle.yaml"))
        contraction, pressure = np.array([0.05, 0.1, 0.15]), np.array([3.0, 4.0, 5.0]) * bar
        np.testing.assert_allclose(
            forces(fitted, contraction, pressure), forces(MUSCLE, contraction, pressure), rtol=0.1
        )
        for name in ("run", "calibrated"):
            results = json.loads(Path(name, "results.json").read_text(encoding="utf-8"))["scalars"]
            assert results["ended"]["value"] == "completed"
            assert results["angle_rmse"]["value"] < 3 * deg  # a busy host is late
    finally:
        board.unplug()
