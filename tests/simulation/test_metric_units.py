"""Names and units of metrics in results."""

import math

import pytest

from mckibben.simulation import Metrics
from mckibben.simulation.metrics import METRICS, in_shown_units


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
    found = in_shown_units(dict.fromkeys(Metrics._fields, math.pi))
    assert found["angle_rmse_deg"] == found["coupling_deg"] == pytest.approx(180)
    assert found["stiffness_rmse"] == found["stiffness_settling_s"] == math.pi
