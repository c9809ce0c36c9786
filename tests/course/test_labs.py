"""The labs of the course: solutions earn all points, empty and wrong answers none."""

import contextlib
import importlib.util
import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

import mckibben

COURSE = Path(__file__).parents[2] / "course"


@pytest.fixture(autouse=True)
def on_path(monkeypatch):
    """The labs import `grading`, which stands beside them."""
    monkeypatch.syspath_prepend(str(COURSE))


def load(name):
    spec = importlib.util.spec_from_file_location(f"course_{name}", COURSE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    sys.path.insert(0, str(COURSE))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(COURSE))
    return module


notebooks, grade, grading = (load(name) for name in ("notebooks", "grade", "grading"))
LABS = notebooks.LABS
WRONG = {  # task: plausible mistakes, as changes of the solution
    "force_law": {
        "ideal": [("np.pi * DIAMETER**2 / 4 * pressure", "np.pi * DIAMETER**2 / 4 * pressure / bar")],
        "fit": [("np.exp(-decay * contraction)", "contraction**2"), ("np.sqrt(np.mean(", "np.sqrt(np.sum(")],
        "validate": [("data.select(~out)", "data"), ("np.unique(pressure)", "pressure[:3]")],
        "compare": [("fit.rmse", "1.0")],
    },
    "attainable_stiffness": {
        "torque": [("return -sum", "return sum"), ("joint.tensions", "(lambda *_: (100.0, 100.0))")],
        "stiffness": [("return -(", "return ("), ("(2 * step)", "step")],
        "common": [("6 * bar, 6 * bar", "4 * bar, 4 * bar")],
        "attainable": [("taut & (pressure2 >= 0)", "(pressure2 >= 0)")],
        "design": [("208 * mm", "190 * mm"), ("208 * mm", "201 * mm")],
    },
    "position_control": {
        "step": [("ki * period * error", "ki * error")],
        "error": [("np.sqrt(np.mean(", "np.sqrt(np.max(")],
        "tune": [("150 * bar", "60 * bar"), ("4 * bar", "4"), ("150 * bar", "5000 * bar")],
        "feasible": [("np.all", "np.any"), ("(lowest <= stiffness) & ", "")],
    },
    "valves_and_delay": {
        "lag": [("-period", "-2 * period")],
        "flow": [("1.0 if ratio <= CRITICAL else ", ""), ("** 2)", ")"), ("upstream * share", "downstream * share")],
        "fill": [("start + air.ATMOSPHERE", "start"), ("1.2 * ", "")],
        "margin": [("np.pi + np.angle", "np.angle"), ("2 * np.pi * frequency[crossing]", "frequency[crossing]")],
        "cycle": [("2 * np.mean", "np.mean"), (" * control_period", "")],
        "onset": [("np.argmax(", "-1 - 0 * np.argmax("), ("np.arange(10, 25) * ms", "np.arange(10, 25, 4) * ms")],
        "predict": [("[-1]", "[0]"), ('["angle_rmse"])', '["angle_rmse"]) / deg')],
    },
}


def source_of(book):
    return ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]


@pytest.mark.parametrize("lab", LABS)
def test_a_released_notebook_has_the_tasks_but_neither_solutions_nor_hidden_tests(lab):
    full, released = (notebooks.notebook(lab, solutions=each) for each in (True, False))
    text = "\n".join(source_of(released))
    assert "SOLUTION" not in text
    assert "HIDDEN" not in text
    assert text.count("raise NotImplementedError()") == "\n".join(source_of(full)).count("### BEGIN SOLUTION")
    for cell in source_of(released):
        compile(cell, lab, "exec")
    names = [cell["metadata"]["nbgrader"]["grade_id"] for cell in full["cells"] if cell["metadata"]]
    assert len(set(names)) == len(names)
    assert {one.removeprefix("task_") for one in names if one.startswith("task_")} == set(WRONG[lab])
    assert {one.removeprefix("check_") for one in names if one.startswith("check_")} == set(WRONG[lab])


@pytest.mark.slow
def test_solutions_earn_all_points_and_an_empty_task_none(tmp_path):
    """That the checks of all labs accept their solutions and no others is tested with the wrong answers."""
    points = {one.name: one.points for one in notebooks.cells(LABS[0]) if one.kind == "check"}
    submitted, released = (notebooks.notebook(LABS[0], solutions=each) for each in (True, False))
    last = max(n for n, one in enumerate(released["cells"]) if "raise NotImplementedError()" in one["source"])
    submitted["cells"][last] = released["cells"][last]
    path = tmp_path / "submitted.ipynb"
    path.write_text(json.dumps(submitted), encoding="utf-8")
    assert grade.grade(LABS[0], path) == points | {list(points)[-1]: 0}


def remembering(compute):
    """The same function, which keeps its results."""
    known = {}

    def remembered(*given, **options):
        key = pickle.dumps((given, options))
        if key not in known:
            known[key] = compute(*given, **options)
        return known[key]

    return remembered


@pytest.fixture
def remembered(monkeypatch):
    """Checks and wrong answers repeat most runs and fits of a solution."""
    for name in ("identify", "simulate", "simulate_many"):
        monkeypatch.setattr(mckibben, name, remembering(getattr(mckibben, name)))


@pytest.mark.slow
@pytest.mark.parametrize("lab", LABS)
def test_checks_fail_for_wrong_answers(lab, remembered):
    """Each wrong answer, and none, is tried where its task stands, then replaced by the solution, which passes."""
    space, wrong = {}, dict.fromkeys(WRONG[lab], 0)
    found = notebooks.cells(lab)
    checks = {one.name.removeprefix("check_"): one.source for one in found if one.kind == "check"}
    for one in found:
        name = one.name.removeprefix("task_")
        if one.kind == "task":
            empty = dict(space)
            with contextlib.suppress(NotImplementedError):  # in a function, its check meets it
                exec(one.released, empty)
            with pytest.raises((AssertionError, NameError, NotImplementedError)):
                exec(checks[name], empty)
            for old, new in WRONG[lab][name]:
                assert old in one.source
                changed = one.source.replace(old, new)
                tried = dict(space)
                exec(changed, tried)
                with pytest.raises(AssertionError):
                    exec(checks[name], tried)
                wrong[name] += 1
        if one.kind != "markdown":
            exec(one.source, space)
    assert all(wrong.values())


def test_comparisons_name_likely_causes():
    cases = {"bar": 1e-5, "percent": 100.0, "mm": 1e3, "deg": np.pi / 180, "sign": -1.0, "half": 2.0, "Hz": 0.5 / np.pi}
    for word, factor in cases.items():
        with pytest.raises(AssertionError, match=word):
            grading.close(3.0 * factor, 3.0, tolerance=0.01)
    grading.close([1.0, 2.0], [1.0, 2.001], tolerance=0.01)
    for answer in (None, "1", np.nan, [1.0, 2.0], lambda: 1.0):
        with pytest.raises(AssertionError):
            grading.close(answer, 1.5, tolerance=0.01)
    with pytest.raises(AssertionError):
        grading.below([0.1, np.nan], 1.0)
    with pytest.raises(AssertionError):
        grading.below([0.1, 1.1], 1.0)


def test_a_notebook_that_does_not_run_earns_nothing(tmp_path):
    path = tmp_path / "broken.ipynb"
    path.write_text("{", encoding="utf-8")
    assert set(grade.grade("force_law", path).values()) == {0}
