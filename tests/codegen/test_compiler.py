"""Compilers, folders and libraries that do not work: XLA computes, and nothing broken is stored."""

import pickle
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.codegen import native
from mckibben.codegen.engine import BatchFunction
from mckibben.codegen.native import NativeFunction, compiler
from mckibben.errors import CompilerError, ExportError, McKibbenWarning
from mckibben.rig.compiled import compile_flat
from mckibben.storage import private

REAL = compiler()
pytestmark = pytest.mark.skipif(REAL is None, reason="there is no C compiler")
LANES = np.arange(1.0, 6.0)


def double(_, lane):
    return lane * 2.0


def scaled(factor, lane):
    return factor * lane


double.__module__ = scaled.__module__ = "mckibben.pretended"  # only functions of this package are stored


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """An empty program cache, in a process in which nothing has been compiled."""
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path / "programs"))
    monkeypatch.setattr(native, "_FAILED", [])
    monkeypatch.setattr(native, "_WARNED", [])
    return tmp_path / "programs"


@pytest.fixture
def use(tmp_path, monkeypatch, programs):
    """Use a shell script as the compiler; `$OUT` is the library, `$REAL` the compiler of the machine."""

    def use(script):
        path = tmp_path / "fakecc"
        path.write_text(f'#!/bin/sh\nOUT=library.so REAL={REAL}\necho "$$" >> {tmp_path}/started\n{script}\n')
        path.chmod(0o755)
        monkeypatch.setenv("CC", str(path))
        return lambda: len((tmp_path / "started").read_text().split()) if (tmp_path / "started").exists() else 0

    return use


FAULTS = {
    "exit status": "echo 'out of licences' >&2; exit 3",
    "garbage": "head -c 5000 /dev/urandom > $OUT",
    "no symbol": "echo 'void other(void) {}' | $REAL -x c -shared -fPIC - -o $OUT",
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_compiler_that_does_not_work_leaves_it_to_xla_with_one_warning(use, programs, fault):
    use(FAULTS[fault])
    batch = BatchFunction(double)
    with pytest.warns(McKibbenWarning) as warned:
        answers = [batch("auto", None, LANES), BatchFunction(double)("auto", None, LANES)]
    assert len(warned) == 1
    assert native._WARNED[0].remedy in str(warned[0].message)
    for values, engine in answers:
        assert engine == "xla"
        np.testing.assert_array_equal(values, 2 * LANES)
    with pytest.raises(CompilerError) as caught:
        BatchFunction(double)("native", None, LANES)
    assert "CC" in caught.value.remedy
    assert list(programs.glob("*")) == []


def has_ended(process):
    """Whether a process has ended, or does within 5 s."""
    for _ in range(100):
        try:
            if Path(f"/proc/{process}/stat").read_text().split()[2] == "Z":  # until it is reaped
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.05)
    return False


def test_a_compiler_that_hangs_is_ended_with_its_children_and_not_started_again(use, programs, monkeypatch, tmp_path):
    started = use(f"sleep 600 & echo $! > {tmp_path}/child; wait")
    monkeypatch.setattr(native, "_COMPILING", (0.5, 1e9))
    begin = time.monotonic()
    with pytest.warns(McKibbenWarning) as warned:
        answers = [BatchFunction(double)("auto", None, LANES)[1] for _ in range(3)]
    assert time.monotonic() - begin < 10
    assert (answers, len(warned), started()) == (["xla"] * 3, 1, 1)
    assert has_ended((tmp_path / "child").read_text().strip())
    with pytest.raises(CompilerError):
        BatchFunction(double)("native", None, LANES)


def test_programs_in_a_folder_that_others_may_write_to_are_not_used_which_is_said_once(programs):
    programs.mkdir()
    programs.chmod(0o777)
    with pytest.warns(McKibbenWarning, match="MCKIBBEN_PROGRAMS_DIR") as warned:
        for factor in (2.0, 3.0):
            NativeFunction(scaled)(np.asarray(factor), LANES)
    assert len(warned) == 1
    assert [*programs.iterdir()] == []


def test_a_temporary_folder_that_forbids_execution_leaves_it_to_xla(programs, monkeypatch):
    """As on a file system mounted noexec: files are written there, and no library is loaded."""

    def refused(path):
        raise OSError(f"{path}: failed to map segment from shared object: Operation not permitted")

    monkeypatch.setattr(native.ctypes, "CDLL", refused)
    with pytest.warns(McKibbenWarning, match="TMPDIR") as warned:
        values, engine = BatchFunction(double)("auto", None, LANES)
    assert (engine, len(warned)) == ("xla", 1)
    np.testing.assert_array_equal(values, 2 * LANES)
    assert list(programs.glob("*")) == []


def test_the_words_of_cc_after_its_first_are_options(use, monkeypatch):
    use('[ "$1" = -g0 ] && exec $REAL "$@"')
    monkeypatch.setenv("CC", f"{native.os.environ['CC']} -g0")
    assert BatchFunction(double)("native", None, LANES)[1] == "native"


def test_a_program_that_is_too_large_is_left_to_xla(programs, monkeypatch):
    monkeypatch.setattr(native, "_LARGEST", 0)
    assert BatchFunction(double)("auto", None, LANES)[1] == "xla"
    with pytest.raises(ExportError):
        BatchFunction(double)("native", None, LANES)


def replaced(file, library):
    """Write another library into a stored program, with a valid checksum."""
    _, leaves, tree = pickle.loads(private.read_private(file))
    private.write_private(file, pickle.dumps((library, leaves, tree)))


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: replaced(file, b"garbage"),
        lambda file: private.write_private(file, pickle.dumps("another content")),
        lambda file: file.write_bytes(file.read_bytes()[:-1]),
    ],
    ids=["library", "content", "truncated"],
)
def test_a_broken_file_of_the_cache_is_replaced(programs, use, damage):
    started = use('exec $REAL "$@"')
    BatchFunction(double)("native", None, LANES)
    (file,) = programs.iterdir()
    good = private.read_private(file)
    damage(file)
    values, engine = BatchFunction(double)("native", None, LANES)
    np.testing.assert_array_equal(values, 2 * LANES)
    assert (engine, started()) == ("native", 2)
    assert [*programs.iterdir()] == [file]
    assert pickle.loads(private.read_private(file))[1:] == pickle.loads(good)[1:]
    BatchFunction(double)("native", None, LANES)
    assert started() == 2


def test_a_program_that_cannot_be_emitted_is_no_reason_to_warn(programs):
    def decided(_, lane):
        return jnp.linalg.svd(lane * jnp.eye(2))[1]

    assert BatchFunction(decided)("auto", None, LANES)[1] == "xla"  # warnings are errors in these tests


def test_the_real_time_loop_warns_too(use, programs):
    use(FAULTS["garbage"])
    with pytest.warns(McKibbenWarning, match="CC"):
        step = compile_flat(lambda x: x + 1, 2)
    np.testing.assert_array_equal(step(np.array([1.0, 2.0])), [2.0, 3.0])


def mixed(xp, x, carry):
    """Statements of all kinds, of which each uses one far before it."""
    values, count = [carry, x], xp.asarray(3)
    for n in range(100):
        count = count + xp.where(values[-1] > values[n // 2], n, 1)
        bound = xp.asarray(n % 7, float)
        values.append(xp.where((count % 3 == 0) | (values[n] < bound), values[-1] * 0.5, values[n] + bound))
    return values[-1] + values[50], count


def loop(shared, lane):
    x = lane + shared
    return lax.scan(lambda carry, _: mixed(jnp, x, carry), x, None, length=20)[0]


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [True, False])
def test_long_blocks_are_written_in_parts(lanes, monkeypatch):
    sources = []
    compile_library = native.compile_library
    monkeypatch.setattr(native, "compile_library", lambda *args: sources.append(args[0]) or compile_library(*args))
    function = loop if lanes else lambda shared, _: loop(shared, 2.0)
    x = LANES + 1.5 if lanes else np.array(3.5)
    results = NativeFunction(function)(np.array(1.5), LANES if lanes else None)
    assert sources[0].count("noinline") >= 2
    carry = x
    for _ in range(20):
        carry, _count = mixed(np, x, carry)
    np.testing.assert_array_equal(results, carry)
