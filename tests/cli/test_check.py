"""mckibben check: a good class, and a second-order lag without its state."""

import json

import pytest

GOOD = """
from mckibben.control import Sine

class Wave(Sine):
    "A sine."

WAVE = Wave(0.1, 2.0)
"""


def rows(numbers):
    (table,) = numbers["tables"]
    return list(zip(*(table["columns"][name]["values"] for name in ("class", "check", "result")), strict=True))


@pytest.mark.slow
def test_a_good_class_passes(cli, tmp_path):
    (tmp_path / "check_good.py").write_text(GOOD, encoding="utf-8")
    found = cli("check", "check_good.py")
    assert (found.code, found.err) == (0, "")
    assert "Wave" in found.out and "failed" not in found.out
    numbers = json.loads(cli("check", "check_good.py", "--json").out)
    assert numbers["ok"] is True
    assert {check for _, check, _ in rows(numbers)} == {"units", "file", "batch", "determinism", "derivatives"}
