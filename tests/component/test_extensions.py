"""Components of others: an installed package, a module and a file, each used by a process of its own."""

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

PACKAGE = '''
    """A law, a valve and a rig of another package."""

    from contextlib import contextmanager
    from dataclasses import dataclass
    from pathlib import Path
    from typing import Annotated

    import jax.numpy as jnp

    from mckibben import catalog
    from mckibben.muscle import Domain, Muscle, Parameter, PressureAffineLaw
    from mckibben.plant import Valve
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
        """Stands for hardware: it is physical, and has a watchdog on the host."""

        port: Annotated[int, BoundedInt(0, 9)] = 0
        physical = True

        def __post_init__(self):
            specimen, law = catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")
            SimulatedRig.__init__(self, Muscle(specimen, law), seed=1)

        @property
        def description(self):
            return {"kind": "acme", "port": str(self.port)}

        @contextmanager
        def host_watchdog(self):
            yield Path("watched").touch()
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


def run(folder, *arguments, cwd, code=0):
    """Standard output of mckibben with a folder on its path."""
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "mckibben", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == code, done.stderr
    return done.stderr if code else done.stdout


@pytest.fixture
def acme(tmp_path):
    return install(tmp_path / "site", "acme", PACKAGE)


def scenario(folder, **parts):
    content = yaml.safe_load(EXAMPLE.read_text()) | {"duration": "50 ms"} | parts
    content["reference"] = {"angle": "0 deg", "stiffness": content["reference"]["stiffness"]}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder / "scenario.yaml"


@pytest.mark.slow
def test_a_law_of_a_package_is_identified_and_read_with_its_version_and_equation(acme, tmp_path):
    run(acme, "identify", "dmsp-10-250-martens2017", "--law", "acme", "--out", "fit", cwd=tmp_path)
    (path,) = (tmp_path / "fit").rglob("fit.yaml")
    content = yaml.safe_load(path.read_text())
    assert (content["law"], content["version"]) == ("acme_parts:AcmeLaw", "acme 1.2")
    run(acme, "validate", path, "dmsp-10-250-martens2017", cwd=tmp_path)
    assert "--extension" in run(tmp_path, "validate", path, "dmsp-10-250-martens2017", cwd=tmp_path, code=2)
    package = acme / "acme_parts" / "__init__.py"
    package.write_text(package.read_text().replace("p - k eps", "p + k eps"))
    message = run(acme, "validate", path, "dmsp-10-250-martens2017", cwd=tmp_path, code=2)
    assert "equation" in message and "acme 1.2" in message


@pytest.mark.slow
def test_a_valve_and_a_law_of_a_package_are_simulated(acme, tmp_path):
    law = {"class": "acme_parts:AcmeLaw", "a": "60 N/bar", "b": "200 N/bar", "k": "400 N"}
    joint = {"geometry": "knee-table-2", "muscle": {"specimen": "MAS-10-180N-AA-MC-O", "law": law}}
    read = scenario(tmp_path, joint=joint, valve={"class": "AcmeValve", "rate": "20 bar/s"})
    run(acme, "simulate", read, "--out", "run", cwd=tmp_path)
    (kept,) = (tmp_path / "run").glob("*.yaml")
    content = yaml.safe_load(kept.read_text())
    assert content["valve"]["class"] == "acme_parts:AcmeValve"
    assert content["packages"] == ["acme 1.2"]
    assert content["joint"]["muscle"]["law"]["equation"].endswith("p - k eps")
    other = tmp_path / "other.yaml"
    other.write_text(kept.read_text().replace("p - k eps", "p + k eps"))
    message = run(acme, "simulate", other, cwd=tmp_path, code=2)
    assert "equation" in message and "p + k eps" in message
    assert yaml.safe_load(run(acme, "simulate", kept, "--json", cwd=tmp_path))["outcome"]
    kept.write_text(kept.read_text().replace("acme 1.2", "acme 1.1"))
    command = "import sys; from mckibben.scenario import Scenario; Scenario.read(sys.argv[1])"
    path = os.pathsep.join([str(acme), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-c", command, kept], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "acme 1.1" in done.stderr and "acme 1.2" in done.stderr


@pytest.mark.slow
def test_a_rig_of_a_package_runs_a_test_under_its_own_watchdog(acme, tmp_path):
    (tmp_path / "protocol.yaml").write_text(PROTOCOL)
    assert "acme" in run(acme, "rig", "check", "protocol.yaml", cwd=tmp_path)
    assert not (tmp_path / "watched").exists()
    run(acme, "rig", "run", "protocol.yaml", "--out", "test", cwd=tmp_path)
    assert (tmp_path / "watched").exists()
    assert (tmp_path / "test" / "isobaric.nc").exists()
    assert "acme_parts:AcmeRig" in (tmp_path / "test" / "protocol.yaml").read_text()


@pytest.mark.slow
def test_a_broken_package_is_named_only_where_it_is_needed(acme, tmp_path):
    install(acme, "broken", "1 / 0")
    run(acme, "simulate", scenario(tmp_path, valve={"class": "AcmeValve"}), cwd=tmp_path)
    message = run(acme, "simulate", scenario(tmp_path, valve={"class": "BrokenValve"}), cwd=tmp_path, code=2)
    assert "the package broken" in message
    assert "ZeroDivisionError" in message


@pytest.mark.slow
def test_an_extension_may_be_a_module(tmp_path):
    (tmp_path / "lone.py").write_text(textwrap.dedent(PACKAGE))
    read = scenario(tmp_path, valve={"class": "lone:AcmeValve"})
    run(tmp_path, "--extension", "lone", "simulate", read, cwd=tmp_path)
    with pytest.raises(ScenarioError) as error:
        load_extension("mckibben_no_such_module")
    assert "PYTHONPATH" in error.value.problems[0].remedy


@pytest.mark.slow
def test_workers_of_dask_load_the_extensions(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "own.py").write_text(textwrap.dedent(PACKAGE))
    read = scenario(tmp_path, valve={"class": "AcmeValve", "rate": "20 bar/s"})
    varied = ("--over", "valve.rate=10 bar/s..30 bar/s", "--samples", 4, "--metrics", "angle_rmse")
    run(".", "--extension", "own.py", "sweep", read, *varied, "--out", "here", cwd=tmp_path)
    run(".", "--extension", "own.py", "sweep", read, *varied, "--out", "there", "--dask", "local", cwd=tmp_path)
    assert (tmp_path / "there" / "sweep.nc").read_bytes() == (tmp_path / "here" / "sweep.nc").read_bytes()
