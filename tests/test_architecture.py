import ast
import dataclasses
import functools
import importlib
import inspect
import os
import pkgutil
import re
import subprocess
import sys
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

import mckibben
import mckibben.result

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
def test_jax_computes_with_64_bits_even_when_it_was_imported_first():
    code = "import jax, jax.numpy as jnp; jnp.ones(1); import mckibben; print(jnp.ones(1).dtype)"
    assert python(code) == "float64"


@pytest.mark.slow
def test_the_users_xla_flags_are_kept_and_jax_computes_with_64_bits():
    mine = "--xla_force_host_platform_device_count=2"
    code = "import mckibben, os, jax; print(os.environ['XLA_FLAGS'], jax.device_count(), jax.numpy.ones(1).dtype)"
    found = python(code, XLA_FLAGS=mine)
    assert found.startswith(mine)
    assert found.endswith(" 2 float64")


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
        ("ExponentialLaws", "did you mean ExponentialLaw"),
    ],
)
def test_an_unknown_name_is_an_attribute_error(name, meant):
    with pytest.raises(AttributeError, match=f"{name}.*{meant}"):
        getattr(mckibben, name)


# Code lines by package, without docstrings, comments and blank lines: what a feature adds, it has to take from here. To
# raise a number is a decision, whose reason is in the commit; to lower one is welcome. All are to come to 43,100.
BUDGET = {
    "top": 1070,
    "actuator": 1060,
    "calibration": 2240,
    "catalog": 230,
    "cli": 1590,
    "codegen": 2700,
    "component": 1060,
    "config": 580,
    "contract": 660,
    "control": 2730,
    "dataset": 4150,
    "experiment_design": 720,
    "export": 2900,
    "identification": 3790,
    "joint": 1480,
    "robot": 80,
    "mechanism": 2160,
    "muscle": 1610,
    "numerics": 820,
    "paper": 1190,
    "plant": 790,
    "reachability": 1150,
    "report": 2070,
    "rig": 5080,
    "scenario": 2350,
    "serial_protocol": 180,
    "simulation": 3560,
    "statics": 560,
    "storage": 600,
    "study": 4070,
    "web": 3090,
}

MOST_ANY = 710  # uses of `Any`
MOST_CONSTANTS = 468  # numbers at module level, to come to 500
MOST_PLACEHOLDERS = 0.005  # share of identifiers that name nothing
PLACEHOLDERS = {"one", "ones", "found", "given", "each", "kept"}


class Shape(NamedTuple):
    """Size and names of a module."""

    code: int
    docstrings: int
    lines: int
    any: int
    constants: int
    placeholders: int
    identifiers: int


@functools.cache
def parsed(path: str) -> ast.Module:
    return ast.parse(Path(path).read_text(encoding="utf-8"))


@functools.cache
def shape(path: str) -> Shape:
    text, tree = Path(path).read_text(encoding="utf-8"), parsed(path)
    docstrings: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node, clean=False):
            docstrings |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    lines = text.splitlines()
    code = [n for n, line in enumerate(lines, 1) if n not in docstrings and line.strip() and line.strip()[0] != "#"]
    names = [
        getattr(node, "id", getattr(node, "arg", getattr(node, "name", getattr(node, "attr", None))))
        for node in ast.walk(tree)
        if isinstance(node, ast.Name | ast.arg | ast.FunctionDef | ast.ClassDef | ast.Attribute)
    ]
    constants = sum(map(numbers, (node.value for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign))))
    empty = sum(name.strip("_") in PLACEHOLDERS for name in names)
    return Shape(len(code), len(docstrings), len(lines), names.count("Any"), constants, empty, len(names))


def numbers(value: ast.expr | None) -> int:
    """How many numbers are written in a constant: 1 in ``2 * deg``, one for each entry of a tuple."""
    if isinstance(value, ast.Tuple):
        return sum(map(numbers, value.elts))
    if isinstance(value, ast.BinOp):
        return int(numbers(value.left) + numbers(value.right) > 0)
    if isinstance(value, ast.UnaryOp):
        return numbers(value.operand)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def package_of(module: str) -> str:
    """Name of the package below mckibben, "top" for its modules."""
    parts = module.split(".")
    is_package = Path(SOURCES[module]).name == "__init__.py"
    return parts[1] if len(parts) > 2 or is_package else "top"


def test_every_package_keeps_its_budget():
    sizes: Counter[str] = Counter(top=shape(mckibben.__file__).code)
    for name, path in SOURCES.items():
        sizes[package_of(name)] += shape(path).code
    assert {name: size for name, size in sizes.items() if size > BUDGET[name]} == {}
    assert sizes.keys() == BUDGET.keys()


def test_types_constants_and_names_stay_few():
    total = Shape(*map(sum, zip(*map(shape, SOURCES.values()), strict=True)))
    assert total.any <= MOST_ANY
    assert total.constants <= MOST_CONSTANTS
    assert total.placeholders <= MOST_PLACEHOLDERS * total.identifiers


def test_no_function_is_of_grade_d():
    """At most 20 independent paths, as radon counts them."""
    complexity = pytest.importorskip("radon.complexity", reason="radon is not installed (make does it)")
    found = {}
    for name, path in SOURCES.items():
        for block in complexity.cc_visit_ast(parsed(path)):
            for function in (block, *getattr(block, "methods", ())):
                if type(function).__name__ == "Function" and function.complexity > 20:
                    found[f"{name}.{function.name}"] = function.complexity
    assert not found


@functools.cache
def imported(module: str) -> set[str]:
    """Modules that a module imports, also within functions and for types alone."""
    names: set[str] = set()
    for node in ast.walk(parsed(SOURCES[module])):
        if isinstance(node, ast.ImportFrom):
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= whole & SOURCES.keys() or {node.module or ""}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return (names & SOURCES.keys()) - {module}


def test_no_circle_of_imports():
    """Of modules, packages with their facades included; `mckibben.methods` has the calls of what is above a class."""
    TopologicalSorter({module: imported(module) for module in SOURCES}).prepare()


TEXT_IMPORTS = {"mckibben.export.targets", "mckibben.export.gym"}
"""A table of its own package, so that a target loads alone; and entry points of Gymnasium."""


def test_no_import_by_text():
    """A module named in a text is an arrow that no linter sees."""
    reference = re.compile(r"mckibben(\.\w+)+(:\w+)?")
    homes = set()
    for name, path in SOURCES.items():
        for node in ast.walk(parsed(path)):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            texts = [arg.value for arg in node.args if isinstance(arg, ast.Constant)] if called else []
            by_name = called.endswith("import_module") and any(reference.fullmatch(str(text)) for text in texts)
            entry = isinstance(node, ast.Constant) and re.fullmatch(r"mckibben(\.\w+)+:\w+", str(node.value))
            if by_name or entry:
                homes.add(name)
    assert homes <= TEXT_IMPORTS


def test_a_result_declares_and_does_not_write_itself():
    for name in MODULES:
        importlib.import_module(name)

    def below(kind: type) -> list[type]:
        return [kind, *(further for child in kind.__subclasses__() for further in below(child))]

    results = {kind for kind in below(mckibben.result.Result)[1:] if kind.__module__.startswith("mckibben.")}
    assert [kind for kind in results if {"listings", "to_dict", "describe"} & vars(kind).keys()] == []
    assert [kind for kind in results if not (kind.__subclasses__() or declares(kind))] == []


def declares(kind: type) -> bool:
    """Whether a result has a number or a table: a declared field or property, marked method, or own `declared`."""
    columns = any("column" in item.metadata for item in dataclasses.fields(kind))
    marks = {"_number", "_table"}
    members = [getattr(member, "fget", None) or member for base in kind.__mro__ for member in vars(base).values()]
    return (
        columns
        or kind.declared is not mckibben.result.Result.declared
        or any(marks & set(vars(member)) for member in members if inspect.isfunction(member))
    )


@pytest.mark.slow
def test_only_the_command_line_prints():
    for name, path in SOURCES.items():
        tree = parsed(path)
        calls = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
        if not name.startswith(("mckibben.cli", "mckibben.study", "mckibben.storage")):
            assert "print" not in calls, name


SHARED = {"Calibration", "Column", "Joint", "Measured", "Study", "Table"}
"""Names of two classes that remain to be told apart."""


@pytest.mark.slow
def test_no_two_further_public_classes_have_one_name():
    homes: dict[str, list[str]] = {}
    for name, path in SOURCES.items():
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(name)
    assert {cls for cls, where in homes.items() if len(where) > 1} <= SHARED


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
        for node in ast.walk(parsed(path)):
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
