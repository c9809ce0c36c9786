"""User-defined components: an installed package, a module and a file, used by the command in another process."""

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
    """A law, a valve and a rig of another package."""

    from dataclasses import dataclass
    from typing import Annotated

    import jax.numpy as jnp

    from mckibben import catalog
    from mckibben.muscle import Domain, Muscle, Parameter, PressureAffineLaw
    from mckibben.actuator import Valve
    from mckibben.rig.simulated import SimulatedRig
    from mckibben.units import BoundedInt, PressureRate


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


    @dataclass
    class AcmeRig(SimulatedRig):
        """Stands for hardware: it is physical, and has a port."""

        port: Annotated[int, BoundedInt(0, 9)] = 0
        physical = True

        def __post_init__(self):
            specimen, law = catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")
            SimulatedRig.__init__(self, Muscle(specimen, law), seed=1)

        @property
        def description(self):
            return {"kind": "acme", "port": str(self.port)}
'''

PROTOCOL = """name: a test on a rig of others
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {class: AcmeRig, port: 3}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}
protocol:
  isobaric: {pressures: [3 bar], contraction_min: 2 %, contraction_max: 4 %, repeats: 1, dwell: 0.2 s, samples: 100}
"""


def install(folder, name, text):
    """A package as `pip install --target` leaves it: modules, and metadata with an entry point."""
    (folder / f"{name}_parts").mkdir(parents=True)
    (folder / f"{name}_parts" / "__init__.py").write_text(textwrap.dedent(text))
    about = folder / f"{name}-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (about / "top_level.txt").write_text(f"{name}_parts\n")
    (about / "entry_points.txt").write_text(f"[mckibben.components]\nparts = {name}_parts\n")
    return folder


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
    """Commands with the packages acme and broken, and a module that no package registers: one process for all tests."""
    site = install(tmp_path_factory.mktemp("site"), "acme", PACKAGE)
    install(site, "broken", "1 / 0")
    (site / "lone.py").write_text(textwrap.dedent(PACKAGE).replace("Acme", "Lone"))
    with commands(site) as started:
        yield started


@pytest.fixture
def run(process, tmp_path):
    """Call a command in the folder of the test: standard output and standard error."""

    def run(*arguments, code=0, by=process):
        by.stdin.write(json.dumps([str(tmp_path), *map(str, arguments)]) + "\n")
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
def test_a_law_of_a_package_is_identified_and_read_with_its_version_and_equation(run, tmp_path):
    run("identify", "dmsp-10-250-martens2017", "--law", "acme", "--out", "fit")
    (path,) = (tmp_path / "fit").rglob("fit.yaml")
    content = yaml.safe_load(path.read_text())
    assert (content["law"]["class"], content["version"]) == ("acme_parts:AcmeLaw", "acme 1.2")
    run("validate", path, "dmsp-10-250-martens2017")
    with commands(tmp_path) as without:
        assert "--extension" in run("validate", path, "dmsp-10-250-martens2017", code=2, by=without)[1]
    path.write_text(path.read_text().replace("p - k eps", "p + k eps"))  # as of another version of the package
    _, message = run("validate", path, "dmsp-10-250-martens2017", code=2)
    assert "equation" in message and "acme 1.2" in message


@pytest.mark.slow
def test_a_valve_and_a_law_of_a_package_are_simulated(run, tmp_path):
    law = {"class": "acme_parts:AcmeLaw", "a": "60 N/bar", "b": "200 N/bar", "k": "400 N"}
    joint = {"geometry": "knee-table-2", "muscle": {"specimen": "MAS-10-180N-AA-MC-O", "law": law}}
    read = scenario(tmp_path, joint=joint, valve={"class": "AcmeValve", "rate": "20 bar/s"})
    run("simulate", read, "--out", "run")
    (kept,) = (tmp_path / "run").glob("*.yaml")
    content = yaml.safe_load(kept.read_text())
    assert content["valve"]["class"] == "acme_parts:AcmeValve"
    assert content["joint"]["muscle"]["law"]["equation"].endswith("p - k eps")
    other = tmp_path / "other.yaml"
    other.write_text(kept.read_text().replace("p - k eps", "p + k eps"))
    _, message = run("simulate", other, code=2)
    assert "equation" in message and "p + k eps" in message
    assert json.loads(run("simulate", kept, "--json")[0])["verdict"]


@pytest.mark.slow
def test_a_rig_of_a_package_runs_a_test(run, tmp_path):
    (tmp_path / "protocol.yaml").write_text(PROTOCOL)
    assert "acme" in run("rig", "check", "protocol.yaml")[0]
    run("rig", "run", "protocol.yaml", "--out", "test")
    assert (tmp_path / "test" / "isobaric.nc").exists()
    assert "acme_parts:AcmeRig" in (tmp_path / "test" / "protocol.yaml").read_text()


@pytest.mark.slow
def test_a_broken_package_is_named_only_where_it_is_needed(run, tmp_path):
    """The other tests do not need it."""
    _, message = run("simulate", scenario(tmp_path, valve={"class": "BrokenValve"}), code=2)
    assert "the package broken" in message
    assert "ZeroDivisionError" in message
