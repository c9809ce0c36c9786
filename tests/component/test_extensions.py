"""An installed package with components, and modules named on the command line, each in a process of its own."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml

from mckibben.component.extensions import load_extension
from mckibben.errors import ScenarioError

EXAMPLE = Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml"

PACKAGE = """
    from mckibben.muscle import Domain, Parameter, PressureAffineLaw
    from mckibben.plant import FirstOrderValve

    class AcmeValve(FirstOrderValve):
        pass

    class AcmeLaw(PressureAffineLaw):
        a: float
        k: float
        domain: Domain = Domain()

        equation = "F = a p - k eps"
        source = "a test"
        linear_parameters = (
            Parameter("a", "N/Pa", "N/bar", "force per pressure"),
            Parameter("k", "N", "N", "stiffness"),
        )

        def pressure_terms(self, contraction):
            return -self.k * contraction, self.a
"""


def install(folder, name, text):
    """A package as `pip install --target` leaves it: modules and metadata with an entry point."""
    (folder / f"{name}_parts").mkdir(parents=True)
    (folder / f"{name}_parts" / "__init__.py").write_text(textwrap.dedent(text))
    about = folder / f"{name}-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (about / "top_level.txt").write_text(f"{name}_parts\n")
    (about / "entry_points.txt").write_text(f"[mckibben.components]\nparts = {name}_parts\n")
    return folder


def run(folder, *arguments, cwd):
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "mckibben", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300)


@pytest.fixture
def acme(tmp_path):
    return install(tmp_path / "site", "acme", PACKAGE)


def scenario(folder, valve):
    content = yaml.safe_load(EXAMPLE.read_text())
    content |= {"valve": {"class": valve, "time_constant": "30 ms"}, "duration": "50 ms"}
    content["reference"] = {"angle": "0 deg", "stiffness": content["reference"]["stiffness"]}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder / "scenario.yaml"


def test_components_of_an_installed_package_are_found_by_name(acme, tmp_path):
    out = run(acme, "identify", "dmsp-10-250-martens2017", "--law", "acme", "--out", "fit", cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    (path,) = (tmp_path / "fit").rglob("fit.yaml")
    content = yaml.safe_load(path.read_text())
    assert (content["law"], content["version"]) == ("acme_parts:AcmeLaw", "acme 1.2")
    out = run(acme, "validate", path, "dmsp-10-250-martens2017", cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    out = run(tmp_path / "elsewhere", "validate", path, "dmsp-10-250-martens2017", cwd=tmp_path)
    assert out.returncode == 2
    assert "--extension" in out.stderr


def test_a_valve_of_an_installed_package_is_simulated(acme, tmp_path):
    out = run(acme, "simulate", scenario(tmp_path, "AcmeValve"), cwd=tmp_path)
    assert out.returncode == 0, out.stderr


def test_a_broken_package_is_named_only_where_it_is_needed(acme, tmp_path):
    install(acme, "broken", "1 / 0")
    assert run(acme, "simulate", scenario(tmp_path, "AcmeValve"), cwd=tmp_path).returncode == 0
    out = run(acme, "simulate", scenario(tmp_path, "BrokenValve"), cwd=tmp_path)
    assert out.returncode == 2
    assert "the package broken" in out.stderr
    assert "ZeroDivisionError" in out.stderr


def test_an_extension_may_be_a_module(tmp_path):
    (tmp_path / "lone.py").write_text(textwrap.dedent(PACKAGE))
    out = run(tmp_path, "--extension", "lone", "simulate", scenario(tmp_path, "AcmeValve"), cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    with pytest.raises(ScenarioError) as error:
        load_extension("mckibben_no_such_module")
    assert "PYTHONPATH" in error.value.problems[0].remedy
