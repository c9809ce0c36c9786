"""Programs that are kept in files: taken up again as they were, made anew where they cannot be."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control import Constant, Sine
from mckibben.numerics.kept import KeptProgram

TRACED = []


def square(tree, power, *, offset):
    TRACED.append(power)
    return {"value": tree["x"] ** power + offset(jnp.asarray(0.0)), "sum": jnp.sum(tree["x"])}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path / "programs"))
    return tmp_path / "programs"


def asked(program, x=(1.0, 2.0, 3.0), power=2, offset=None):
    offset = offset or Constant(np.asarray(0.5))
    return {name: np.asarray(value) for name, value in program({"x": np.asarray(x)}, power, offset=offset).items()}


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.delenv("MCKIBBEN_PROGRAMS_DIR", raising=False)
    assert asked(KeptProgram(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert list(tmp_path.iterdir()) == []


def test_a_program_is_written_once_and_taken_up_by_the_next(folder):
    first = asked(KeptProgram(square))
    files = list(folder.iterdir())
    assert len(files) == 1
    TRACED.clear()
    again = asked(KeptProgram(square), x=(2.0, 3.0, 4.0))
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
def test_what_makes_another_program_makes_another_file(folder, change):
    program = KeptProgram(square)
    asked(program)
    found, expected = asked(program, **change), None
    assert len(list(folder.iterdir())) == 2
    given = {"x": (1.0, 2.0, 3.0), "power": 2, "offset": Constant(0.5)} | change
    expected = square({"x": jnp.asarray(given["x"])}, given["power"], offset=given["offset"])
    np.testing.assert_allclose(found["value"], expected["value"], rtol=1e-6)
    assert found["value"].dtype == expected["value"].dtype


def test_a_damaged_file_is_made_anew(folder):
    asked(KeptProgram(square))
    (file,) = folder.iterdir()
    for content in (b"", b"nonsense", file.read_bytes()[:1000]):
        file.write_bytes(content)
        assert asked(KeptProgram(square))["value"].tolist() == [1.5, 4.5, 9.5]
        assert file.stat().st_size > 1000


def test_a_folder_that_cannot_be_written_to_stops_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path / "file" / "programs"))
    assert asked(KeptProgram(square))["value"].tolist() == [1.5, 4.5, 9.5]


def test_where_jax_keeps_a_cache_of_its_own_nothing_is_kept_twice(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "theirs"))
    assert asked(KeptProgram(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert not folder.exists()


def test_a_program_that_does_not_run_again_is_not_kept(folder, monkeypatch):
    from jax.experimental import serialize_executable

    def unreadable(*_):
        raise RuntimeError("no such function")

    monkeypatch.setattr(serialize_executable, "deserialize_and_load", unreadable)
    assert asked(KeptProgram(square))["value"].tolist() == [1.5, 4.5, 9.5]
    assert list(folder.glob("*")) == []


def test_inside_other_programs_it_is_a_part_of_them(folder):
    program = KeptProgram(square)
    slope = jax.grad(lambda x: program({"x": x}, 2, offset=Constant(0.5))["value"])(3.0)
    assert float(slope) == 6.0
    assert not folder.exists()


def test_another_process_takes_it_up(folder):
    script = (
        "import numpy as np, mckibben, sys\n"
        "from mckibben.numerics.kept import KeptProgram\n"
        "from mckibben.numerics.elementary import exp\n"
        "print(KeptProgram(exp)(np.asarray(1.0)))\n"
    )
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=dict(os.environ))
        assert done.returncode == 0, done.stderr
        assert float(done.stdout) == pytest.approx(np.e, rel=1e-15)
        assert len(list(folder.iterdir())) == 1


def test_another_context_is_another_program():
    from mckibben.numerics.many import many_runs, traced_for

    seen = []
    program = KeptProgram(lambda x: (seen.append(traced_for()), x + 1)[1])
    for _ in range(2):
        program(np.asarray(1.0))
        with many_runs():
            program(np.asarray(1.0))
    assert seen == [(False, False), (True, True)]
