"""Numbers for people and for JSON."""

import json
import math

import numpy as np
import pytest

from mckibben import catalog
from mckibben.identification import identify
from mckibben.muscle import ChouLaw, ExponentialLaw
from mckibben.simulation import Metrics
from mckibben.study.reporting import METRICS, fit_numbers, plain, shown, to_json, write_json


def test_every_metric_is_shown_once_under_a_name_that_says_its_unit():
    assert sorted(metric for metric, _, _ in METRICS.values()) == sorted(Metrics._fields)
    for name, (metric, unit, factor) in METRICS.items():
        assert name.startswith(metric)
        if unit == "deg":
            assert name.endswith("_deg")
            assert factor == pytest.approx(math.pi / 180)
        if unit == "s":
            assert name.endswith("_s")
            assert factor == 1.0


def test_metrics_are_shown_in_degrees():
    found = shown(dict.fromkeys(Metrics._fields, math.pi))
    assert found["angle_rmse_deg"] == found["coupling_deg"] == pytest.approx(180)
    assert found["stiffness_rmse"] == found["stiffness_settling_s"] == math.pi


def test_json_has_no_nan():
    odd = {"a": math.nan, "b": [math.inf, (1.0, -math.inf)], "c": {"d": np.float64("nan")}, "e": "NaN", "f": True}
    assert plain(odd) == {"a": None, "b": [None, [1.0, None]], "c": {"d": None}, "e": "NaN", "f": True}
    assert json.loads(to_json(odd)) == plain(odd)
    assert json.loads(to_json({"x": 0.1 + 0.2}))["x"] == 0.1 + 0.2
    assert math.isnan(odd["a"])  # a copy


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "results.json"
    write_json(path, {"text": "Sárosi, 1 °", "x": math.nan})
    assert json.loads(path.read_text(encoding="utf-8")) == {"text": "Sárosi, 1 °", "x": None}
    with pytest.raises(TypeError):
        write_json(path, {"x": object()})
    assert json.loads(path.read_text(encoding="utf-8"))["x"] is None
    assert [p.name for p in tmp_path.iterdir()] == ["results.json"]


def test_a_fit_is_shown_in_the_units_of_the_publication():
    data = catalog.dataset("dmsp-10-250-martens2017")
    fit = identify(ExponentialLaw, data)
    found = fit_numbers(fit)
    assert found["decay_per_percent"] == pytest.approx(float(fit.law.decay) / 100)
    parameters = found["parameters"]
    assert {name: p["unit"] for name, p in parameters.items()} == {
        "a1": "N",
        "a2": "N/bar",
        "b1": "N/percent",
        "b2": "N/(bar*percent)",
        "c1": "N",
        "c2": "N/bar",
        "decay": "1/percent",
    }
    p, eps = 4.5, 7.0  # bar, percent: the published form with these numbers is the law
    a1, a2, b1, b2, c1, c2, mu = (
        parameters[name]["estimate"] for name in ("a1", "a2", "b1", "b2", "c1", "c2", "decay")
    )
    published = (a1 + a2 * p) + (b1 + b2 * p) * eps + (c1 + c2 * p) * math.exp(-mu * eps)
    assert published == pytest.approx(float(fit.law.force(eps / 100, p * 1e5)), rel=1e-9)
    assert parameters["a2"]["standard_error"] == pytest.approx(fit.standard_errors["a2"] * 1e5)
    residuals = np.asarray(fit.law.force(data.taut.contraction, data.taut.pressure)) - data.taut.force
    assert found["rmse_N"] == pytest.approx(np.sqrt(np.mean(residuals**2)))
    assert found["max_N"] == pytest.approx(np.abs(residuals).max())
    assert (found["points_used"], found["points_slack"]) == (40, 45)


def test_a_law_without_a_decay_has_none():
    found = fit_numbers(identify(ChouLaw, catalog.dataset("dmsp-10-250-martens2017")))
    assert "decay_per_percent" not in found
    assert found["law"] == "ChouLaw"
    json.loads(to_json(found))
