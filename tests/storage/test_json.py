"""JSON of results."""

import json
import math

import numpy as np
import pytest

from mckibben.storage.files import json_ready, to_json, write_json


def test_json_has_no_nan():
    odd = {"a": math.nan, "b": [math.inf, (1.0, -math.inf)], "c": {"d": np.float64("nan")}, "e": "NaN", "f": True}
    assert json_ready(odd) == {"a": None, "b": [None, [1.0, None]], "c": {"d": None}, "e": "NaN", "f": True}
    assert json.loads(to_json(odd)) == json_ready(odd)
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
