"""mckibben check: a good class, and a second-order lag without its state."""

import json

import pytest

GOOD = """
from mckibben.control import Sine

class Wave(Sine):
    "A sine."

WAVE = Wave(0.1, 2.0)
"""
BAD = """
import jax.numpy as jnp

from mckibben.actuator import Valve
from mckibben.units import Bandwidth

class Lag(Valve):
    "Second order, without the rate of the pressure."
    bandwidth: Bandwidth

    def pressure_after(self, pressure, command, elapsed):
        phase = self.bandwidth * elapsed
        return command + (pressure - command) * (1 + phase) * jnp.exp(-phase)

    def command_for(self, pressure, rate):
        return jnp.asarray(pressure)
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


@pytest.mark.slow
def test_a_second_order_lag_without_its_state_is_found(cli, tmp_path):
    (tmp_path / "check_bad.py").write_text(BAD, encoding="utf-8")
    answer = cli("check", "check_bad.py", "--with", "bandwidth = 60 rad/s", "--json")
    numbers = json.loads(answer.out)
    assert answer.code == 1 and numbers["ok"] is False
    assert "SecondOrderValve" in numbers["remarks"][0]["remedy"]
    assert [row[:2] for row in rows(numbers) if row[2] == "failed"] == [("Lag", "composition")]


def test_mistakes_are_bad_input(cli, tmp_path):
    (tmp_path / "check_good.py").write_text(GOOD, encoding="utf-8")
    for arguments in (("missing.py",), ("check_good.py", "--with", "rate"), ("check_good.py", "--with", "rate=1")):
        found = cli("check", *arguments)
        assert (found.code, found.out) == (2, "") and found.err.startswith("error: ")
