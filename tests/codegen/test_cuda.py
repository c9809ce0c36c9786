"""CUDA kernels: compiled by NVRTC without a GPU, and run on this processor as C++; what is missing is named."""

from pathlib import Path
from runpy import run_path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.codegen import cuda
from mckibben.codegen.cuda import CudaFunction, driver_library
from mckibben.codegen.engine import check_engine
from mckibben.codegen.native import Split
from mckibben.errors import CompilerError, DeviceError, ParameterError
from mckibben.simulation.engine import chunk_size

PARTS = {"nvrtc": cuda.nvrtc.__wrapped__, "driver_library": driver_library}
RUNS = 200  # two blocks of threads
X = np.random.default_rng(2).normal(size=RUNS)
ARCHITECTURE = 90


EMITTED = run_path(str(Path(__file__).with_name("test_emitted.py")))


def operations(shared, x):
    *found, whole, reduced = EMITTED["elementwise"](x)
    return *found, whole, reduced + shared * x


def loops(shared, x):
    """Rows stored by a loop, constant tables, branches and lengths of loops that differ between runs."""

    def body(carry, row):
        a, b = carry
        a, b = b, a * 0.9 + jnp.sin(row)
        here = lax.cond(x > 0, lambda t: t + 1.0, lambda t: t - 1.0, a)
        return (a, b), jnp.stack([here, a * b])

    rows = x + jnp.linspace(0.0, 1.0, 60)
    _, stored = lax.scan(body, (x, 2 * x), rows)
    last, back = lax.scan(lambda c, r: (0.9 * c + r[0] * r[1] * shared, c), x, stored, reverse=True)
    halved, count = lax.while_loop(lambda s: s[0] > 0.01, lambda s: (s[0] / 2, s[1] + 1), (jnp.abs(x), 0))
    clock, _ = lax.scan(lambda t, _: (t + 0.1 * shared, None), 0.0, None, length=100)  # of all runs alike
    return last, back, halved, count, clock + x, stored


def draws(_, x):
    return EMITTED["random"](x)


def with_columns(shared, lane):
    """Arrays, of all runs and of each, and numbers that are whole or true."""
    column, own, whole, yes = shared[0], lane[0], lane[1], lane[2]

    def body(total, at):
        one, other = at
        return total + jnp.where(yes, one * other, whole), total

    return lax.scan(body, shared[1] + 0.0 * own[0], (column, own))


COLUMNS = (np.linspace(0.0, 1.0, 100), 0.25), (np.outer(np.linspace(1.0, 2.0, 100), X), np.arange(RUNS), X > 0)
FUNCTIONS = [(operations, (0.3, X)), (loops, (0.3, X)), (draws, (0.3, X)), (with_columns, COLUMNS)]
each_function = pytest.mark.parametrize("function, given", FUNCTIONS, ids=[one.__name__ for one, _ in FUNCTIONS])


@each_function
@pytest.mark.slow
def test_kernels_compute_what_jax_does(cuda_here, function, given):
    shared, lanes = given
    expected = jax.jit(jax.vmap(lambda lane: function(shared, lane), in_axes=-1, out_axes=-1))(lanes)
    found = CudaFunction(function)(jax.tree.map(np.asarray, shared), lanes)
    tolerance = 3e-7 if function is draws else 1e-12  # normal numbers are of 32 bits
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)


@pytest.mark.slow
def test_in_32_bits_only_numbers_of_all_runs_have_64(cuda_here):
    def function(shared, x):
        tiny = shared + 1e-12
        return tiny - shared + 0 * x, (x + 1e-12) - x

    found = CudaFunction(function)(np.asarray(1.0), X.astype(np.float32), single=True)
    np.testing.assert_allclose(found[0], 1e-12, rtol=1e-3)
    np.testing.assert_array_equal(found[1], 0.0)
    ours, theirs = (CudaFunction(loops)(np.asarray(0.3), X, single=single) for single in (True, False))
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-5)
    assert not np.array_equal(ours[0], theirs[0])


@each_function
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.slow
def test_nvrtc_compiles_them(nvrtc, function, given, single):
    shared, lanes = jax.tree.map(np.asarray, given[0]), given[1]
    written = CudaFunction(function).written(Split.of(shared), Split.of(lanes, lanes=True), single=single)
    assert nvrtc.compile(written.source, ARCHITECTURE).startswith(b"\x7fELF")


@pytest.mark.slow
def test_a_device_newer_than_nvrtc_gets_ptx_and_an_older_one_an_error(nvrtc):
    written = CudaFunction(loops).written(Split.of(np.asarray(0.3)), Split.of(X, lanes=True), single=True)
    newer = nvrtc.compile(written.source, 990)
    assert b".entry run" in newer and newer.endswith(b"\0")
    with pytest.raises(DeviceError) as caught:
        nvrtc.compile(written.source, 20)
    assert caught.value.value == 20 and caught.value.lower == min(nvrtc.architectures)


def test_what_nvrtc_does_not_compile_is_an_error(nvrtc):
    with pytest.raises(CompilerError) as caught:
        nvrtc.compile('extern "C" __global__ void run() { unknown(); }', ARCHITECTURE)
    assert "unknown" in caught.value.message


# What is missing


def missing_part():
    with pytest.raises(ParameterError) as caught:
        check_engine("cuda", many=True)
    assert (caught.value.field, caught.value.value) == ("engine", "cuda")
    return caught.value


def no_library(path):
    raise OSError(path)


@pytest.mark.slow
@pytest.mark.parametrize("part, named", [("nvrtc", "mckibben[gpu]"), ("driver_library", "libcuda")])
def test_without_compiler_or_driver_it_is_named(cuda_here, monkeypatch, part, named):
    monkeypatch.setattr(cuda, part, PARTS[part])
    monkeypatch.setattr(cuda.ctypes, "CDLL", no_library)
    assert named in str(missing_part())


@pytest.mark.parametrize(
    "answers, words",
    [
        ({"devices": 0}, "no device"),
        ({"failing": "cuInit", "status": 100}, "no device"),
        ({"failing": "cuInit", "status": 803}, "too old"),
        ({"version": 11080}, "11.8"),
        ({"failing": "cuInit", "status": 999}, "cuInit"),
    ],
)
def test_a_driver_that_cannot_be_used_is_named(cuda_here, answers, words):
    cuda_here.set(**answers)
    assert words in missing_part().message


def test_it_computes_batches_only_and_is_never_chosen(cuda_here):
    assert check_engine("cuda", many=True) == "cuda"
    assert check_engine("auto", many=True) != "cuda"
    with pytest.raises(ParameterError) as caught:
        check_engine("cuda")
    assert caught.value.field == "engine"


@pytest.mark.parametrize(
    "count, numbers, size",
    [(100, 1, 112), (65_536, 0, 65_536), (70_000, 1, 35_008), (65_536, 2 * 10_000, 13_120), (100, 10**9, 16)],
)
def test_chunks_are_even_and_fit_the_memory(cuda_here, count, numbers, size):
    assert chunk_size(None, count, 2, "cuda", numbers=numbers) == size


@pytest.mark.slow
@pytest.mark.parametrize("failing", ["cuMemAlloc_v2", "cuLaunchKernel", "cuCtxSynchronize", "cuModuleLoadData"])
def test_a_driver_that_fails_is_named_and_memory_freed(cuda_here, failing):
    function = CudaFunction(operations)
    if failing != "cuModuleLoadData":
        function(np.asarray(0.3), X)
    cuda_here.set(failing=failing, status=2)
    with pytest.raises(DeviceError) as caught:
        function(np.asarray(0.3), X)
    assert (caught.value.field, caught.value.value) == (failing, 2)
    assert cuda_here.driver.in_use() == 0
    cuda_here.set(failing="")
    assert function(np.asarray(0.3), X)[0].shape == (RUNS,)


def double(_, lane):
    return lane * 2.0


double.__module__ = "mckibben.pretended"  # only functions of this package are stored


def test_a_compiled_kernel_is_stored(cuda_here, tmp_path, monkeypatch):
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", str(tmp_path / "programs"))
    cuda_here.compiler.sources.clear()
    for _ in range(2):  # functions without memory of one another
        np.testing.assert_array_equal(CudaFunction(double)(None, X), 2 * X)
    assert len(cuda_here.compiler.sources) == 1
    cuda_here.set(capability=80)
    cuda.device.cache_clear()
    CudaFunction(double)(None, X)
    assert len(cuda_here.compiler.sources) == 2
    for path in (tmp_path / "programs").iterdir():
        path.write_bytes(path.read_bytes()[:-100])
    np.testing.assert_array_equal(CudaFunction(double)(None, X), 2 * X)
    assert len(cuda_here.compiler.sources) == 3
