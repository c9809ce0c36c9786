"""User-defined components of a module, used by the command in another process."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml

EXAMPLE = Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml"

PACKAGE = '''
    """A law and a valve of another package."""

    import jax.numpy as jnp

    from mckibben.muscle import Domain, Muscle, Parameter, PressureAffineLaw
    from mckibben.actuator import Valve
    from mckibben.units import PressureRate


    class AcmeLaw(PressureAffineLaw):
        a: float
        b: float
        k: float
        domain: Domain = Domain()

        equation = "F = (a - b eps) p - k eps"
        source = "a test"
        linear_parameters = (
            Parameter("a", "N/Pa", "N/bar", "force per pressure"),
            Parameter("b", "N/Pa", "N/bar", "its change with contraction"),
            Parameter("k", "N", "N", "stiffness"),
        )

        def pressure_terms(self, contraction):
            return -self.k * contraction, self.a - self.b * contraction


    class AcmeValve(Valve):
        rate: PressureRate = 1e6

        def pressure_after(self, pressure, command, elapsed):
            most = self.rate * jnp.asarray(elapsed)
            return pressure + jnp.clip(jnp.asarray(command) - pressure, -most, most)

        def command_for(self, pressure, rate):
            return jnp.asarray(pressure) + 0.01 * rate
'''


COMMANDS = """
import contextlib, io, json, os, sys, warnings
from mckibben.cli import main
for line in sys.stdin:
    folder, *arguments = json.loads(line)
    os.chdir(folder)
    sys.argv, out, err = ["mckibben", *arguments], io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("default")
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    print(json.dumps([code, out.getvalue(), err.getvalue()]), flush=True)
"""


def commands(folder):
    """A process that runs commands of mckibben one after another, with a folder on its path."""
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-c", COMMANDS],
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "160"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def process(tmp_path_factory):
    """Commands with the module acme_parts, which each of them loads: one process for all tests."""
    site = tmp_path_factory.mktemp("site")
    (site / "acme_parts.py").write_text(textwrap.dedent(PACKAGE))
    with commands(site) as started:
        yield started


@pytest.fixture
def run(process, tmp_path):
    """Call a command in the folder of the test: standard output and standard error."""

    def run(*arguments, code=0, by=process):
        loaded = ["--extension", "acme_parts"] if by is process else []
        by.stdin.write(json.dumps([str(tmp_path), *loaded, *map(str, arguments)]) + "\n")
        by.stdin.flush()
        found, out, err = json.loads(by.stdout.readline())
        assert found == code, err
        return out, err

    return run


def scenario(folder, **parts):
    content = yaml.safe_load(EXAMPLE.read_text()) | {"duration": "50 ms"} | parts
    content["reference"] = {"angle": "0 deg", "stiffness": content["reference"]["stiffness"]}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder / "scenario.yaml"


@pytest.mark.slow
def test_a_law_of_a_module_is_identified_and_read_with_its_equation(run, tmp_path):
    run("identify", "dmsp-10-250-martens2017", "--law", "acme", "--out", "fit")
    (path,) = (tmp_path / "fit").rglob("fit.yaml")
    content = yaml.safe_load(path.read_text())
    assert content["law"]["class"] == "AcmeLaw"
    run("validate", path, "dmsp-10-250-martens2017")
    with commands(tmp_path) as without:
        assert "--extension" in run("validate", path, "dmsp-10-250-martens2017", code=2, by=without)[1]
    path.write_text(path.read_text().replace("p - k eps", "p + k eps"))  # as of another version of the module
    _, message = run("validate", path, "dmsp-10-250-martens2017", code=2)
    assert "equation" in message


@pytest.mark.slow
def test_a_valve_and_a_law_of_a_module_are_simulated(run, tmp_path):
    law = {"class": "acme_parts:AcmeLaw", "a": "60 N/bar", "b": "200 N/bar", "k": "400 N"}
    joint = {"geometry": "knee-table-2", "muscle": {"specimen": "MAS-10-180N-AA-MC-O", "law": law}}
    read = scenario(tmp_path, joint=joint, valve={"class": "AcmeValve", "rate": "20 bar/s"})
    run("simulate", read, "--out", "run")
    (kept,) = (tmp_path / "run").glob("*.yaml")
    content = yaml.safe_load(kept.read_text())
    assert content["valve"]["class"] == "AcmeValve"
    assert content["joint"]["muscle"]["law"]["equation"].endswith("p - k eps")
    other = tmp_path / "other.yaml"
    other.write_text(kept.read_text().replace("p - k eps", "p + k eps"))
    _, message = run("simulate", other, code=2)
    assert "equation" in message and "p + k eps" in message
    assert json.loads(run("simulate", kept, "--json")[0])["verdict"]
