"""Programs that are kept in files: taken up again as they were, made anew where they cannot be."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

import mckibben
from mckibben.control import Constant, Sine
from mckibben.errors import McKibbenWarning
from mckibben.numerics import program_cache
from mckibben.numerics.compiled import Program

TRACED = []


def square(tree, power, *, offset):
    TRACED.append(power)
    return {"value": tree["x"] ** power + offset(jnp.asarray(0.0)), "sum": jnp.sum(tree["x"])}


square.__module__ = "mckibben.pretended"  # what comes from elsewhere is not kept


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)  # beside which nothing is kept
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path / "programs"))
    jax.config.update("jax_enable_compilation_cache", False)  # a program that JAX took from its cache cannot be stored
    compilation_cache.reset_cache()
    yield tmp_path / "programs"
    jax.config.update("jax_enable_compilation_cache", True)
    compilation_cache.reset_cache()


def asked(program, x=(1.0, 2.0, 3.0), power=2, offset=None):
    offset = offset or Constant(np.asarray(0.5))
    return {name: np.asarray(value) for name, value in program({"x": np.asarray(x)}, power, offset=offset).items()}


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.delenv("MCKIBBEN_PROGRAMS_DIR", raising=False)
    assert asked(Program(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert list(tmp_path.iterdir()) == []


def test_a_program_is_written_once_and_taken_up_by_the_next(folder):
    first = asked(Program(square))
    files = list(folder.iterdir())
    assert len(files) == 1
    TRACED.clear()
    again = asked(Program(square), x=(2.0, 3.0, 4.0))
    assert first["value"].tolist() == [1.5, 4.5, 9.5]
    assert again["value"].tolist() == [4.5, 9.5, 16.5]
    assert float(again["sum"]) == 9.0
    assert TRACED == []
    assert list(folder.iterdir()) == files


@pytest.mark.parametrize(
    "change",
    [
        {"x": (1.0, 2.0)},
        {"x": np.array([1.0, 2.0, 3.0], np.float32)},
        {"power": 3},
        {"offset": Sine(np.asarray(1.0), np.asarray(1.0))},
    ],
    ids=["shape", "type", "static", "structure"],
)
@pytest.mark.slow
def test_what_makes_another_program_makes_another_file(folder, change):
    program = Program(square)
    asked(program)
    found, expected = asked(program, **change), None
    assert len(list(folder.iterdir())) == 2
    given = {"x": (1.0, 2.0, 3.0), "power": 2, "offset": Constant(0.5)} | change
    expected = square({"x": jnp.asarray(given["x"])}, given["power"], offset=given["offset"])
    np.testing.assert_allclose(found["value"], expected["value"], rtol=1e-6)
    assert found["value"].dtype == expected["value"].dtype


def test_a_damaged_file_is_made_anew(folder):
    asked(Program(square))
    (file,) = folder.iterdir()
    for content in (b"", b"nonsense", file.read_bytes()[:1000]):
        file.write_bytes(content)
        assert asked(Program(square))["value"].tolist() == [1.5, 4.5, 9.5]
        assert file.stat().st_size > 1000


def users_own(factor):
    """A signal as it stands in a user's file; the class has the same name whatever the factor."""
    names = {"__name__": "users_own", "eqx": eqx}
    exec(f"class Mine(eqx.Module):\n    def __call__(self, time):\n        return {factor} * (time + 1.0)", names)
    return names["Mine"]()


def test_a_class_of_the_users_that_was_edited_is_the_new_one(folder):
    for factor in (1.0, 7.0):
        assert asked(Program(square), offset=users_own(factor))["value"].tolist() == [
            1 + factor,
            4 + factor,
            9 + factor,
        ]
    assert not folder.exists()


def solved(matrix, vector):
    return jnp.linalg.solve(matrix, vector)


solved.__module__ = "mckibben.pretended"


def test_a_program_that_calls_lapack_is_not_kept_as_it_would_crash_another_process(folder):
    assert np.asarray(Program(solved)(2 * np.eye(2), np.ones(2))).tolist() == [0.5, 0.5]
    assert list(folder.glob("*.program")) == []


def test_while_the_source_is_edited_nothing_is_written(folder, monkeypatch):
    monkeypatch.setattr(program_cache, "source_files", lambda: program_cache.SOURCES[:-1])
    assert asked(Program(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert list(folder.iterdir()) == []


def test_a_folder_that_others_can_write_or_a_link_is_not_used(folder, tmp_path, monkeypatch):
    folder.mkdir(mode=0o700)
    folder.chmod(0o770)
    with pytest.warns(McKibbenWarning, match="chmod 700"):
        assert asked(Program(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert list(folder.iterdir()) == []
    folder.chmod(0o700)
    asked(Program(square))
    (file,) = folder.iterdir()
    file.rename(tmp_path / "elsewhere")
    file.symlink_to(tmp_path / "elsewhere")
    monkeypatch.setattr(program_cache.pickle, "loads", lambda content: 1 / 0)
    assert asked(Program(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert not file.is_symlink()


@pytest.mark.slow
def test_another_process_takes_it_up_unless_the_source_was_edited_in_between(folder, tmp_path):
    shutil.copytree(Path(mckibben.__file__).parent, tmp_path / "mckibben", ignore=shutil.ignore_patterns("__pycache__"))
    script = (
        "import os, numpy as np, pathlib, mckibben, sys\n"
        "from mckibben.numerics import compiled, elementary\n"
        "file = pathlib.Path(elementary.__file__)\n"
        "assert file.is_relative_to(os.getcwd())\n"
        "for name in sys.argv[1:]:\n"
        "    file.write_text(file.read_text() + '\\n')\n"
        "print(compiled.Program(elementary.exp)(np.asarray(1.0)))\n"
    )
    left = []
    for arguments in (["edit"], [], []):
        done = subprocess.run(
            [sys.executable, "-c", script, *arguments], cwd=tmp_path, capture_output=True, text=True, env=os.environ
        )
        assert done.returncode == 0, done.stderr
        assert float(done.stdout) == pytest.approx(np.e, rel=1e-15)
        left.append([(path.name, path.stat().st_mtime_ns) for path in folder.glob("*")])
    assert left[0] == []
    assert len(left[1]) == 1 and left[2] == left[1]


def test_where_jax_keeps_a_cache_of_its_own_nothing_is_kept_twice(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "theirs"))
    assert asked(Program(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert not folder.exists()


def test_another_context_is_another_program():
    from mckibben.numerics.batching import batched_program, trace_mode

    seen = []
    program = Program(lambda x: (seen.append(trace_mode()), x + 1)[1])
    for _ in range(2):
        program(np.asarray(1.0))
        with batched_program():
            program(np.asarray(1.0))
    assert seen == [(False, False), (True, True)]
