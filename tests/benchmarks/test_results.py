"""The pages of docs/results follow from a suite by one command."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.usefixtures("simulating_nothing")
@pytest.mark.slow
def test_a_page_of_results_has_its_command_and_tables(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    page, study = tmp_path / "page.md", tmp_path / "study"
    arguments = [str(ROOT / "tests" / "small-suite.yaml"), "--out", str(page), "--study", str(study), "--runs", "12"]
    arguments += ["--generations", "1", "--starts", "1"]
    importlib.import_module("results").main(arguments)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# ") and f"--out {page}" in text and "has a disk margin of 0.2" in text
    table = text[text.index("## ") :].splitlines()[2:]
    assert table[0].startswith("| controller | angle RMSE [deg] |")
    assert {row.split(" | ")[0].strip("| ") for row in table[2:5]} == {"PID 3", "decoupling", "as it is"}
    importlib.import_module("results").main(arguments)  # continued: the same
    assert page.read_text(encoding="utf-8") == text
