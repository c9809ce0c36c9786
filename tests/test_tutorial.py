"""The notebook and the files of the tutorial are those of its page and its data."""

import json
from doctest import DocTestParser
from pathlib import Path

import pytest

from mckibben import ExponentialLaw, Fit, identify_hysteresis, read_dataset
from mckibben.identification import fit_law
from mckibben.units import mm

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "your-muscle"


def test_the_notebook_has_the_code_of_the_page_and_was_run():
    cells = json.loads((FOLDER / "your-muscle.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    page = DocTestParser().get_examples((ROOT / "docs" / "your-muscle.md").read_text(encoding="utf-8"))
    lines = "\n".join("".join(cell["source"]) for cell in code)
    assert lines.split() == "\n".join(example.source for example in page).split()
    outputs = [output for cell in code for output in cell["outputs"]]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    assert not any(output["output_type"] == "error" for output in outputs)


@pytest.mark.slow
def test_the_muscle_of_the_scenario_is_that_of_the_data():
    columns = {"Druck [bar]": "pressure_bar", "Kraft [N]": "force_N", "Laenge [mm]": "length_mm"}
    data = read_dataset(FOLDER / "rig.csv", columns=columns, initial_length=300 * mm)
    friction = identify_hysteresis(ExponentialLaw, data)
    assert friction.friction.half_width == pytest.approx(7.0, abs=0.3)
    fresh = fit_law(ExponentialLaw, friction.corrected_points)
    kept = Fit.from_yaml(FOLDER / "fit" / "fit.yaml")
    for name, value in fresh.estimates.items():
        assert kept.estimates[name] == pytest.approx(value, rel=1e-4)
