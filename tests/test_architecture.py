import ast
import importlib
import inspect
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mckibben

ROOT = Path(__file__).parents[1]
MODULES = [m.name for m in pkgutil.walk_packages(mckibben.__path__, "mckibben.") if not m.name.endswith("__main__")]
SOURCES = {name: (importlib.util.find_spec(name) or sys.modules[name].__spec__).origin for name in MODULES}


def python(code: str, **environment: str) -> str:
    """What a fresh interpreter prints."""
    clean = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=clean | environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_import_stays_light():
    heavy = "jax equinox xarray matplotlib scipy pint pydantic numpy pandas"
    loaded = python(f"import sys, mckibben; print([m for m in {heavy.split()} if m in sys.modules])")
    assert loaded == "[]"


def test_the_units_and_errors_need_nothing_heavy():
    code = (
        "import sys, mckibben.units, mckibben.errors; print([m for m in ('jax', 'numpy', 'pint') if m in sys.modules])"
    )
    assert python(code) == "[]"


@pytest.mark.slow
def test_jax_computes_with_64_bits_after_the_import():
    assert python("import mckibben, jax.numpy as jnp; print(jnp.ones(1).dtype)") == "float64"


@pytest.mark.slow
def test_jax_computes_with_64_bits_even_when_it_was_imported_first():
    code = "import jax, jax.numpy as jnp; jnp.ones(1); import mckibben; print(jnp.ones(1).dtype)"
    assert python(code) == "float64"


@pytest.mark.slow
def test_the_users_xla_flags_are_kept():
    mine = "--xla_force_host_platform_device_count=2"
    code = "import mckibben, os, jax; print(os.environ['XLA_FLAGS'], jax.device_count())"
    found = python(code, XLA_FLAGS=mine)
    assert found.startswith(mine)
    assert found.endswith(" 2")


def test_a_second_import_in_a_child_adds_no_flag_twice():
    code = (
        "import mckibben, os, subprocess, sys;"
        "print(subprocess.run([sys.executable, '-c', 'import mckibben, os; print(os.environ.get(\"XLA_FLAGS\"))'],"
        "capture_output=True, text=True).stdout.strip() == str(os.environ.get('XLA_FLAGS')))"
    )
    assert python(code) == "True"


@pytest.mark.parametrize("name", mckibben.__all__)
def test_every_public_name_is_there_and_documented(name):
    thing = getattr(mckibben, name)
    assert inspect.getdoc(thing), f"{name} has no docstring"
    assert name in dir(mckibben)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("force_law", "read_law"),
        ("SarosiLaw", "from mckibben.muscle import SarosiLaw"),
        ("SmoothAffineLaw", "from mckibben.muscle import SmoothAffineLaw"),
        ("Trackability", "mckibben.reachability"),
        ("ExponentialLaws", "did you mean ExponentialLaw"),
    ],
)
def test_an_unknown_name_is_an_attribute_error(name, meant):
    with pytest.raises(AttributeError, match=f"{name}.*{meant}"):
        getattr(mckibben, name)


def test_modules_stay_short():
    lengths = {name: len(Path(path).read_text().splitlines()) for name, path in SOURCES.items()}
    assert {name: n for name, n in lengths.items() if n > 500} == {}


@pytest.mark.slow
def test_only_the_command_line_prints():
    for name, path in SOURCES.items():
        tree = ast.parse(Path(path).read_text())
        calls = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
        if not name.startswith(("mckibben.cli", "mckibben.study", "mckibben.storage")):
            assert "print" not in calls, name


@pytest.mark.slow
def test_no_two_public_classes_have_one_name():
    homes: dict[str, list[str]] = {}
    for name, path in SOURCES.items():
        for node in ast.parse(Path(path).read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(name)
    assert {cls: where for cls, where in homes.items() if len(where) > 1} == {}


@pytest.mark.slow
def test_kinds_of_actuators_are_told_apart_in_their_modules_only():
    """Elsewhere an attribute or a method of the actuator decides."""
    packages = "mckibben.actuator", "mckibben.plant"
    public = [one for package in packages for one in vars(importlib.import_module(package)).values()]
    kinds = {one.__name__ for one in public if isinstance(one, type) and issubclass(one, mckibben.actuator.Actuator)}
    kinds.remove("Actuator")
    assert {"Valve", "AirValve", "Tube", "UnequalValves"} <= kinds
    found = []
    for name, path in SOURCES.items():
        for node in ast.walk(ast.parse(Path(path).read_text())):
            called = getattr(node, "func", None)
            if getattr(called, "id", "") in ("isinstance", "issubclass") and not name.startswith("mckibben.actuator"):
                found += [(name, one.id) for one in ast.walk(node.args[1]) if getattr(one, "id", "") in kinds]
    assert found == []


OLD_WORDS = re.compile(
    r"\b(wish(es|ed)?|outlook|surroundings|undisturbed|beliefs?|believed|contest|standings|heeded|the watch|sheltered|"
    r"glued|virtual rig)\b",
    re.IGNORECASE,
)


def test_texts_use_the_terms_of_the_field():
    texts = [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").glob("*.md"), ROOT / "README.md"]
    found = {
        f"{path.relative_to(ROOT)}:{number}": line
        for path in texts
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if OLD_WORDS.search(line) and "renamed" not in line  # old keys, whose error names the new one
    }
    assert found == {}
