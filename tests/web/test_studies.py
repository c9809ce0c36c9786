"""Results of the pages are those of the commands and programs that they copy."""

import contextlib
import io
import json
import re
import shlex
import sys
import zipfile

import pytest

pytest.importorskip("nicegui")

from mckibben import Scenario, catalog
from mckibben.cli import main
from mckibben.study.tune import parse_cost
from mckibben.study.tune import tune as search
from mckibben.web import identify, reading, tune, workbench
from mckibben.web.results import Presented

SHORT = workbench.START.replace("duration: 6 s", "duration: 0.6 s").replace("at: 3 s", "at: 0.2 s")
SHORT_LEG = re.sub(r"at: \d s", "at: 0.2 s", workbench.LEG).replace("duration: 4 s", "duration: 0.4 s")
POINTS = "pressure_bar,contraction_percent,force_N\n" + "".join(
    f"{p},{100 * e:.0f},{float(catalog.law('lei-mas-10-180n').force(e, p * 1e5)):.3f}\n"
    for p in (3, 4, 5, 6)
    for e in (0.0, 0.03, 0.06, 0.09, 0.12, 0.15)
)


def repeated(presented, folder, monkeypatch):
    """Numbers of the page, of the copied command, and of the copied program, run in the unpacked download."""
    with zipfile.ZipFile(io.BytesIO(presented.archive())) as archive:
        archive.extractall(folder)
    monkeypatch.chdir(folder)
    words = shlex.split((folder / "command.txt").read_text())
    out = folder / words[words.index("--out") + 1]
    monkeypatch.setattr(sys, "argv", words)
    with contextlib.suppress(SystemExit):
        main()
    program = {}
    exec(compile((folder / "program.py").read_text(), "program.py", "exec"), program)
    numbers = [json.loads((place / "results.json").read_text()) for place in (folder, out)]
    return *numbers, program["result"].to_dict()


@pytest.mark.slow
def test_gains_are_tuned_as_by_the_copied_command_and_go_into_the_scenario(tmp_path, monkeypatch):
    names = ("controller.position.ki", "controller.position.kp")
    request = tune.TuningRequest(over=names, method="local", iterations=4, tolerances={"angle_rmse": 0.2})
    study = tune.tuned(SHORT, request, tmp_path, lambda _step, _part: None)
    cost = parse_cost("angle_rmse/0.2 deg", gain_margin=request.gain_margin, disk_margin=request.disk_margin)
    expected = search(Scenario.parse(SHORT), names, cost, method="local", iterations=4)
    assert study.presented.result.cost == expected.cost < expected.cost_before
    assert study.text == SHORT and study.tuned == expected.scenarios[0]
    page, command, program = repeated(study.presented, tmp_path, monkeypatch)
    assert page["scalars"] == command["scalars"] == program["scalars"]
    assert (tmp_path / "figure.png").read_bytes() == study.presented.picture


@pytest.mark.slow
@pytest.mark.parametrize("text", [SHORT, SHORT_LEG], ids=["joint", "robot"])
def test_a_run_is_repeated_by_the_copied_command(text, tmp_path, monkeypatch):
    presented = workbench.compute(workbench.read_text(text), tmp_path).presented
    page, command, program = repeated(presented, tmp_path, monkeypatch)
    assert page["scalars"] == command["scalars"] == program["scalars"]


@pytest.mark.slow
def test_a_fit_is_repeated_by_the_copied_command(tmp_path, monkeypatch):
    source = tmp_path / "data-a file.csv"
    source.write_text(POINTS.replace("force_N", "pull"))
    fields, state = reading.ReadingFields(columns={"pull": "force_N"}), identify.IdentificationState()
    state.use("a file.csv", reading.read([source], fields), [source], fields)
    law, options = identify.LAWS["ExponentialLaw"], {"friction": False, "robust": False}
    fit = identify.identify_with_friction(law, state.data, **options)
    presented = Presented.of(fit, state.steps("ExponentialLaw", **options, inner="10 mm"))
    page, command, program = repeated(presented, tmp_path, monkeypatch)
    for listing, other, third in zip(page["tables"], command["tables"], program["tables"], strict=True):
        assert listing["columns"] == other["columns"] == third["columns"]
