"""User-defined components of a module, used by the command in another process."""

import json
import os
import subprocess
import sys
import textwrap

import pytest
import yaml

PACKAGE = '''
    """A law of another package."""

    import jax.numpy as jnp

    from mckibben.muscle import Domain, Muscle, Parameter, PressureAffineLaw


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
