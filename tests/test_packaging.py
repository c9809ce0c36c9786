"""The wheel, built from the source archive and installed in a bare environment, outside of the checkout.

Its dependencies are those of this environment: `make wheel` installs them anew, from the index.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from ruamel.yaml import YAML

pytest.importorskip("build", reason="the package build is not installed (make does it)")
pytest.importorskip("hatchling", reason="the package hatchling is not installed (make does it)")

ROOT = Path(__file__).parents[1]
DEPENDENCIES = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
VERSION = re.search(r'__version__ = "(.*)"', (ROOT / "src/mckibben/version.py").read_text(encoding="utf-8"))[1]

# Third-party packages are imported first; then nothing of ours may need what Windows lacks.
IMPORT_ALL = """
import importlib, os, pkgutil, signal, sys
import casadi, distributed, gymnasium, h5py, jax, matplotlib.figure, mujoco, nicegui.testing, scipy.optimize, xarray
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
gone = {
    os: "fork getuid geteuid O_NOFOLLOW O_DIRECTORY posix_fallocate sched_getaffinity sched_setscheduler sched_param",
    signal: "SIGHUP SIGQUIT SIGKILL SIGALRM alarm",
}
for module, names in gone.items():
    for name in names.split():
        delattr(module, name)
import mckibben
for found in pkgutil.walk_packages(mckibben.__path__, "mckibben."):
    if found.name != "mckibben.__main__":
        importlib.import_module(found.name)
assert mckibben.__file__.startswith(sys.prefix), mckibben.__file__
print(mckibben.__version__)
"""


def run(*command, **options):
    """Output of a command that has to succeed."""
    done = subprocess.run([str(one) for one in command], capture_output=True, text=True, timeout=300, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    assert len(list(folder.glob("*.tar.gz"))) == 1
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def bare(wheel, tmp_path_factory):
    """Folder of the programs of an environment with the wheel; other packages come from this one, without mckibben."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder, symlinks=True)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        programs / "python",
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        wheel,
    )
    packages = sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)})
    others = sysconfig.get_path("purelib")  # a folder named in a .pth file: its own .pth files are not read
    (Path(packages) / "others.pth").write_text(f"{others}\n", encoding="utf-8")
    return programs


@pytest.fixture
def outside(tmp_path):
    """Options of a process that runs outside of the checkout."""
    dropped = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    return {"cwd": tmp_path, "env": {k: v for k, v in os.environ.items() if k not in dropped and "PYTEST" not in k}}


@pytest.mark.slow
def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(wheel):
    held = {name for name in zipfile.ZipFile(wheel).namelist() if not re.match(r"mckibben-[^/]*\.dist-info/", name)}
    there = (path for path in (ROOT / "src").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    assert held == {path.relative_to(ROOT / "src").as_posix() for path in there}
    assert {"py.typed", "__init__.pyi", "paper/report.css", "dataset/vocabulary.toml"} <= {
        name.partition("/")[2] for name in held
    }


@pytest.mark.slow
def test_the_source_archive_has_every_tracked_file(wheel):
    """So that its tests pass."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("this is no checkout of the repository, or git is not installed")
    (archive,) = wheel.parent.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        held = {name.partition("/")[2] for name in opened.getnames()}
    assert {*run("git", "-c", "safe.directory=*", "ls-files", cwd=ROOT).splitlines()} <= held


def test_workflows_test_the_versions_of_python_that_are_supported():
    texts = {path.stem: YAML(typ="safe").load(path) for path in (ROOT / ".github/workflows").glob("*.yml")}
    assert set(texts) == {"tests", "docs", "release"}
    tested = texts["tests"]["jobs"]["everyday"]["strategy"]["matrix"]["python"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    listed = re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    assert tested == listed and project["requires-python"] == f">={tested[0]}"


@pytest.mark.slow
def test_the_installed_command_fits_data_of_the_catalog_outside_of_the_checkout(bare, outside):
    told = run(bare / "mckibben", "identify", "dmsp-10-250-martens2017", "--out", "fit", **outside)
    assert "ExponentialLaw" in told
    assert {"fit.yaml", "muscle.yaml"} <= {path.name for path in (outside["cwd"] / "fit").iterdir()}


@pytest.mark.slow
def test_no_import_needs_what_windows_lacks(bare, outside):
    assert run(bare / "python", "-c", IMPORT_ALL, **outside).strip() == VERSION


def test_versions_agree():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {VERSION}\n" in citation


def test_the_conda_recipe_has_the_dependencies_of_the_package():
    """Under the names of conda-forge."""
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    other = {"matplotlib": "matplotlib-base", "lazy_loader": "lazy-loader"}

    def listed(key):
        block = re.search(rf"^  {key}:\n((?:    - .*\n)+)", recipe, re.MULTILINE)
        return {line.removeprefix("    - ") for line in block[1].splitlines()}

    wanted = {re.match(r"([\w.]+)(.*)", one).groups() for one in DEPENDENCIES}
    assert {f"{other.get(name, name)} {bound}" for name, bound in wanted} <= listed("run")
    assert "python >=3.11" in listed("run")
    assert f'version: "{VERSION}"' in recipe
