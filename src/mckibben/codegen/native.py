"""Functions compiled by the machine's C compiler, for one run or for many runs in parallel.

The source of a function is compiled to a shared library in a temporary folder, and loaded by ctypes. It is kept in the
program cache with the tree of its results. Whatever fails there raises `CompilerError`, upon which XLA computes.
"""

from __future__ import annotations

import ctypes
import functools
import math
import os
import pickle
import platform
import shlex
import shutil
import signal
import struct
import subprocess
import tempfile
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax import export
from jax.tree_util import PyTreeDef
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.codegen import kernels
from mckibben.codegen.functions import definitions, native_language
from mckibben.codegen.graph import Graph, Kind, StoredArray
from mckibben.codegen.kernels import KernelWriter
from mckibben.codegen.lowering import Lowering, Stored, kind_of
from mckibben.codegen.parts import in_parts
from mckibben.codegen.templates import filled
from mckibben.codegen.vectors import VectorWriter, interleaved
from mckibben.codegen.writer import Writer, inputs_of
from mckibben.errors import CompilerError, ExportError, McKibbenWarning, quoted
from mckibben.numerics.program_cache import ARRAY, ARRAYS, program_path, read_program, write_program
from mckibben.numerics.runtime import programs_folder

E = TypeVar("E", bound=ExportError)

_FLAGS = tuple("-march=native -fno-math-errno -fno-trapping-math -fwrapv -frename-registers -w".split())
_ALONE = ("-O2", "-fno-tree-vectorize")
_FOR_LANES = ("-O2", *(("-mprefer-vector-width=512",) if platform.machine() in ("x86_64", "AMD64") else ()))
_SHORT = 100_000  # characters
_FOR_LONG = '#ifndef __clang__\n#pragma GCC optimize("ira-region=one")\n#endif\n'  # registers in half the time
_LONGEST, _LARGEST = 3_000_000, 300_000  # characters of a source, and operations, which have some 20 characters each
_COMPILING = 360.0, 5000.0  # s for the compiler, which may share its processor, plus a second per so many characters
_OTHER_COMPILER = "use engine='xla', or set another compiler in the environment variable CC"
_OTHER_FOLDER = (
    "set TMPDIR to a folder that allows execution, or CC to another compiler; engine='xla' needs neither of them"
)
_HEAD = "void run(const void *scalars, const double *arrays, double *results, int64_t lanes)"
_PERIODS = "periods"  # their number, as an argument
_TYPES = {Kind.REAL: "double", Kind.INTEGER: "int64_t", Kind.BOOLEAN: "int64_t"}


def compiler_words() -> list[str]:
    """Name and options of the C compiler, from the environment variable CC (``ccache gcc``) or cc."""
    return shlex.split(os.environ.get("CC", "")) or ["cc"]


def compiler() -> str | None:
    """Path of the C compiler; None, with a warning if CC names it, if it is not found."""
    return _compiler_path(os.environ.get("CC", ""))


@functools.cache
def _compiler_path(words: str) -> str | None:
    """Path of the compiler of some words."""
    name, *_ = shlex.split(words) or ["cc"]
    if (path := shutil.which(name)) is None and name != "cc":
        warn_of_fallback(CompilerError(f"the compiler of the environment variable CC, {quoted(name)}, is not found"))
    return path


def own_flags() -> list[str]:
    """The user's compiler options, from the environment variable MCKIBBEN_CFLAGS."""
    return os.environ.get("MCKIBBEN_CFLAGS", "").split()


_FAILED: list[CompilerError] = []  # of a compiler that took too long, after which none is started
_WARNED: list[CompilerError] = []


def _without_frames(error: E) -> E:
    """Copy of an error that keeps none of the arrays in the frames of its traceback."""
    bare = copy(error).with_traceback(None)  # tblib, which Dask installs, copies the traceback, too
    bare.__cause__ = bare.__context__ = None
    return bare


def warn_of_fallback(error: ExportError) -> None:
    """Warn that XLA computes in place of compiled C, once per process and only if the compiler is the reason."""
    if isinstance(error, CompilerError) and not _WARNED:
        _WARNED.append(_without_frames(error))
        warnings.warn(f"XLA computes in place of compiled C: {error}", McKibbenWarning, stacklevel=3)


class NativeFunction:
    """A pure function of a shared tree and, in a batch, one with the runs along the last axis, compiled as C.

    It is written and compiled once per structure, static leaves, shapes and types of its arguments, not per number of
    runs, and kept in the program cache. Arrays are arguments; all other leaves are static.

    Parameters
    ----------
    function
        ``function(shared, lane)`` of JAX, for one run; `lane` is None for a function of the shared tree alone.
    flags
        Further options of the compiler.

    Examples
    --------
    >>> torque = NativeFunction(lambda stiffness, angle: -stiffness * angle)
    >>> torque(np.array(40.0), np.array([0.0, 0.25, 0.5]))
    array([ -0., -10., -20.])
    """

    def __init__(self, function: Callable[..., PyTree], flags: Sequence[str] = ()) -> None:
        self._function, self._flags = function, tuple(flags)
        self._programs: dict[object, Compiled | ExportError] = {}
        self._lock = threading.Lock()

    def __call__(self, shared: PyTree, lanes: PyTree = None, *, single: bool = False) -> PyTree:
        """Results, with 32 bits where they differ between runs of a `single` program; raises `ExportError`."""
        return self.bound(shared, lanes, single=single)()

    def bound(self, shared: PyTree, lanes: PyTree = None, *, single: bool = False) -> Callable[[], PyTree]:
        """The compiled function with its arguments packed, as a callable that computes the results.

        Raises `ExportError` for an operation that cannot be written, `CompilerError` if the compiler fails; both also
        at every later call, without another try.
        """
        common, varying = Split.of(shared), Split.of(lanes, lanes=True)
        key = common.key, varying.key, single, *own_flags()  # which may change in a notebook
        with self._lock:
            if (program := self._programs.get(key)) is None:
                try:
                    written = lambda: self.written(common, varying, single=single)  # noqa: E731
                    program = self.cached(key, written, many=bool(varying.arrays))
                except ExportError as error:  # it will fail next time too
                    program = _without_frames(error)
                self._programs[key] = program
        if isinstance(program, ExportError):
            raise _without_frames(program)
        return program.bound(common.arrays, varying.arrays)

    def cached(self, key: tuple[PyTree, ...], written: Callable[[], Written], *, many: bool = False) -> Compiled:
        """Return the program of a key from the program cache, or write and compile it."""
        folder, path = programs_folder(), None
        if folder is not None:
            path = program_path(folder, self._function, key, *self._state())
        if path is not None and (compiled := self._stored(path)) is not None:
            return compiled
        source, leaves, tree = written()
        program = self._built(source, many)
        compiled = self._loaded(program, leaves, tree)
        if path is not None:
            write_program(path, pickle.dumps((program, leaves, jax.tree.unflatten(tree, [0] * len(leaves)))))
        return compiled

    def _stored(self, path: Path) -> Compiled | None:
        """The program of a file of the cache; None if it is missing or cannot be loaded."""
        if (content := read_program(path)) is None:
            return None
        try:
            program, leaves, tree = pickle.loads(content)
            return self._loaded(program, leaves, jax.tree.structure(tree))
        except Exception:  # another content, or a program that does not load here: it is compiled again and replaced
            return None

    def written(self, shared: Split, lanes: Split, *, single: bool) -> Written:
        """Source for arguments."""

        def function(common: Sequence[NDArray], varying: Sequence[NDArray]) -> PyTree:
            return self._function(shared.filled(common), lanes.filled(varying))

        return write_native(function, shared.arrays, [x[..., 0] for x in lanes.arrays], single, self._threads)

    _threads = False  # whether each run of a batch is a thread

    def _state(self) -> tuple[object, ...]:
        """Identity of the compiler, for the program cache."""
        return _compiler_state(), self._flags, "native"

    def _built(self, source: str, many: bool) -> bytes:
        """Library of a source, with the options for its length and for `many` runs."""
        if not many and len(source) >= _SHORT:
            source = _FOR_LONG + source
        return compile_library(source, (*(_FOR_LANES if many else _ALONE), *self._flags))

    def _loaded(self, program: bytes, leaves: list[tuple[tuple[int, ...], str]], tree: PyTree) -> Compiled:
        """The program of a library, with shapes, types and tree of its results."""
        return Compiled(*load_library(program), leaves, tree)


class OverPeriods(np.ndarray):
    """Array over the control periods of a run, its first axis: one program serves any number of them."""


def over_periods(tree: PyTree) -> PyTree:
    """Arrays of a tree as `OverPeriods`, all of the same length."""
    return jax.tree.map(lambda x: np.asarray(x).view(OverPeriods), tree)


class Repeated(NamedTuple):
    """An array that an earlier leaf of the tree is, too, by its place among the arguments."""

    place: int


@dataclass(frozen=True)
class Split:
    """Leaves of a tree, with the arrays separated; an array that stands in several places is one argument.

    Attributes
    ----------
    static
        All leaves, `ARRAY` in place of arrays, and a `Repeated` in place of one that came before.
    lanes
        Whether the last axis of each array is that of the runs.

    Examples
    --------
    >>> split = Split.of({"law": "Chou", "pressure": np.array([1e5, 2e5])}, lanes=True)
    >>> split.static, split.filled([3e5])
    (('Chou', array), {'law': 'Chou', 'pressure': 300000.0})
    """

    structure: PyTreeDef
    static: tuple[object, ...]
    arrays: list[NDArray]
    lanes: bool

    @classmethod
    def of(cls, tree: PyTree, *, lanes: bool = False) -> Split:
        """Split a tree."""
        leaves, structure = jax.tree.flatten(tree)
        places: dict[int, int] = {}  # of the arrays among the arguments, by identity
        static, arrays = [], []
        for leaf in leaves:
            if not isinstance(leaf, ARRAYS):
                static.append(leaf)
            elif (place := places.setdefault(id(leaf), len(arrays))) < len(arrays):
                static.append(Repeated(place))
            else:
                static.append(ARRAY)
                arrays.append(leaf if type(leaf) in (np.ndarray, OverPeriods) else np.asarray(leaf))
        return cls(structure, tuple(static), arrays, lanes)

    @property
    def key(self) -> tuple[PyTree, ...]:
        """Cache key: structure, static leaves, shapes and types, without the number of runs."""
        shapes = tuple([_shape(x[..., 0] if self.lanes else x) for x in self.arrays])
        kinds = "".join([x.dtype.char for x in self.arrays])
        return self.structure, self.static, tuple(map(type, self.static)), shapes, kinds

    def filled(self, arrays: Sequence[NDArray]) -> PyTree:
        """The tree with new arrays."""
        remaining = iter(arrays)
        leaves = [
            next(remaining) if leaf is ARRAY else arrays[leaf.place] if isinstance(leaf, Repeated) else leaf
            for leaf in self.static
        ]
        return jax.tree.unflatten(self.structure, leaves)


@dataclass(frozen=True)
class Compiled:
    """A program, with shapes, types and tree of its results.

    Attributes
    ----------
    run
        The function of the library, of addresses of scalars, arrays and results, and of the number of runs.
    width
        Runs per vector.
    leaves
        Shape and type of each leaf of the results; -1 stands for the number of control periods.
    """

    run: Any
    width: int  # runs per vector
    leaves: list[tuple[tuple[int, ...], str]]
    tree: PyTree

    def bound(self, common: Sequence[NDArray], varying: Sequence[NDArray] = ()) -> Callable[[], PyTree]:
        """Arguments packed in 64-bit words, as a callable that computes the results of all runs."""
        count = varying[0].shape[-1] if varying else 1
        size = -(-count // self.width) * self.width if varying else 1
        periods = [x.shape[0] for x in (*common, *varying) if isinstance(x, OverPeriods)][:1]
        scalars = [*map(np.asarray, periods), *(x for x in common if not x.ndim)]
        kinds = "".join(["d" if x.dtype.kind == "f" else "q" for x in scalars])
        packed = struct.pack(kinds, *[x.item() for x in scalars])
        arrays = [_words(x) for x in common if x.ndim] + [_words(_padded(x, size)) for x in varying]
        words = np.concatenate([np.empty(0), *arrays])
        leaves = [(tuple([n if n >= 0 else periods[0] for n in shape]), kind) for shape, kind in self.leaves]
        lengths = [math.prod(shape) * size for shape, _ in leaves]

        def compute() -> PyTree:
            results = np.empty(sum(lengths))
            self._call(packed, words, results, size)
            values, at = [], 0
            for (shape, kind), length in zip(leaves, lengths, strict=True):
                value = results[at : at + length]
                at += length
                value = value.reshape(*shape, size)[..., :count] if varying else value.reshape(shape)
                values.append((value if kind[1] == "f" else value.view(np.int64)).astype(kind, copy=False))
            return jax.tree.unflatten(self.tree, values)

        return compute

    def _call(self, scalars: bytes, words: NDArray, results: NDArray, lanes: int) -> None:
        """Run the program on its arguments in memory."""
        self.run(scalars, words.ctypes.data, results.ctypes.data, lanes)


EXACT = ("-ffp-contract=off",)
"""Compiler option by which a computation has the same result in every program: no product and sum are fused."""


def compile_native(
    function: Callable[..., PyTree], *sizes: int, static: tuple[object, ...] = ()
) -> Callable[..., PyTree]:
    """Compile a function of static arguments and float vectors for calls of microseconds.

    Products and sums are not fused, so that results are the same in every program. Raises `ExportError`.

    Parameters
    ----------
    sizes
        Lengths of the vectors.
    static
        First arguments of the function.

    Examples
    --------
    >>> scaled = compile_native(lambda factor, x: factor * x, 2, static=(3.0,))
    >>> scaled(np.array([1.0, 2.0]))
    array([3., 6.])
    """

    def written() -> Written:
        vectors = [np.zeros(size) for size in sizes]
        return write_native(lambda vectors_given, _: function(*static, *vectors_given), vectors, ())

    compiled = NativeFunction(function, EXACT).cached((*static, *sizes), written)
    ends = np.cumsum([math.prod(shape) for shape, _ in compiled.leaves]).tolist()
    columns = zip(ends, compiled.leaves, strict=True)
    spans = [(slice(end - math.prod(shape), end), shape, kind) for end, (shape, kind) in columns]

    def compute(*vectors: NDArray[np.float64]) -> PyTree:
        words, results = np.concatenate(vectors), np.empty(ends[-1])
        compiled.run(b"", words.ctypes.data, results.ctypes.data, 1)
        values = [(results[span].reshape(shape), kind) for span, shape, kind in spans]
        leaves = [x if kind[1] == "f" else x.view(np.int64).astype(kind) for x, kind in values]
        return jax.tree.unflatten(compiled.tree, leaves)

    return compute


class Written(NamedTuple):
    """Source of a function of arrays, with shapes, types and tree of its results.

    Attributes
    ----------
    leaves
        Shape and NumPy type of each leaf of the results.
    """

    source: str
    leaves: list[tuple[tuple[int, ...], str]]
    tree: PyTree


def write_native(
    function: Callable[..., PyTree],
    common: Sequence[NDArray],
    varying: Sequence[NDArray],
    single: bool = False,
    threads: bool = False,
) -> Written:
    """Write a function of arrays shared by all runs and arrays with an entry per run, as C or as a CUDA kernel.

    Raises `ExportError` for operations that cannot be written, and for programs that a compiler takes too long for.

    Parameters
    ----------
    common, varying
        Examples of the arrays, of a single run.
    single
        Whether values that differ between runs have 32 bits.
    threads
        Whether each run is a thread of a kernel, instead of an element of a vector.
    """
    graph = Graph(lanes=bool(varying), single=single, threads=threads, reciprocals=bool(varying), most=_LARGEST)
    graph.scope = graph.root.inner()
    common, varying = ([_example(x) for x in arrays] for arrays in (common, varying))
    graph.input(_PERIODS, Kind.INTEGER)
    inputs = [_input_value(graph, f"in{n}", x, n < len(common)) for n, x in enumerate([*common, *varying])]
    results, shape = Lowering(graph).function(function, (common, varying), inputs)
    values: list[Any] = []
    for result in results:
        values += filter(None, [result.array]) if isinstance(result, Stored) else result.flat
    before = ""
    if threads:
        writer = KernelWriter([graph.scope], values, single=single)
    elif varying:
        writer = VectorWriter([graph.scope], values, single=single)
    else:
        writer, before = Writer([graph.scope], native_language(), values), definitions()
    leaves = [(leaf.shape, leaf.dtype.str) for leaf in jax.tree.leaves(shape)]
    places, body = _places(common, varying, leaves), _body(graph, writer, inputs, results)
    if isinstance(writer, VectorWriter):
        count = 2 if sum(map(len, body)) < _SHORT else 1  # a longer program would take seconds more to compile
        before = filled("vectors.h", {"single": single, "count": count})
        body = interleaved(body, count)
    if isinstance(writer, KernelWriter):
        preparing = KernelWriter([graph.scope], writer.constants, single=single)
        prepared = _body(graph, preparing, inputs, ())
        constants = [preparing.text(constant) for constant in writer.constants]
        real = writer.language.types[Kind.REAL]
        lines = [kernels.kernels(sum(not x.ndim for x in common), places, prepared, constants, body, real)]
        writer.helpers |= preparing.helpers
    else:
        parts, calling = in_parts([*places, "    for (int64_t b = 0; b < lanes; b += width) {", *body, "    }"])
        lines = [*parts, _HEAD, "{", *calling, "}"]
    source = "\n".join([before, *sorted(writer.helpers), *lines, ""])
    if len(source) > _LONGEST:
        raise ExportError(f"a program of {len(source)} characters", value=len(source), upper=_LONGEST)
    leaves = [(_shape(leaf), leaf.dtype.str) for leaf in jax.tree.leaves(shape)]
    return Written(source, leaves, jax.tree.structure(shape))


def _example(x: NDArray) -> Any:
    """Example of an argument, of unknown length if it is over the control periods."""
    if not isinstance(x, OverPeriods):
        return x
    return jax.ShapeDtypeStruct((*_symbol(), *x.shape[1:]), x.dtype)


@functools.cache
def _symbol() -> Any:
    """The number of control periods as a length."""
    return export.symbolic_shape(_PERIODS)


def _shape(x: NDArray | jax.ShapeDtypeStruct) -> tuple[int, ...]:
    """Shape of an argument or result, with -1 for the number of control periods."""
    if isinstance(x, OverPeriods):
        return (-1, *x.shape[1:])
    return tuple([n if isinstance(n, int) else -1 for n in x.shape])


def _places(
    common: Sequence[NDArray], varying: Sequence[NDArray], leaves: Sequence[tuple[tuple[int, ...], str]]
) -> list[str]:
    """Declarations of the location of each argument and result: 64-bit words, as packed by `Compiled`."""
    lines, scalars, shared, lanes, at = list[str](), 0, 0, 0, 0
    if any(not isinstance(n, int) for x in (*common, *varying) for n in x.shape):
        lines.append(f"    const int64_t {_PERIODS} = *(const int64_t *)scalars;")
        scalars = 1
    for n, x in enumerate([*common, *varying]):
        kind, size = _TYPES[kind_of(x.dtype)], math.prod(x.shape)
        if n >= len(common):
            place, lanes = f"arrays + {shared} + ({lanes}) * lanes", lanes + size
        elif x.shape:
            place, shared = f"arrays + {shared}", shared + size
        else:
            place, scalars = f"(const double *)scalars + {scalars}", scalars + 1
        lines.append(f"    const {kind} *in{n} = (const {kind} *)({place});")
    for n, (shape, dtype) in enumerate(leaves):
        kind = _TYPES[kind_of(np.dtype(dtype))]
        lines.append(f"    {kind} *out{n} = ({kind} *)(results + ({at}) * lanes);")
        at += math.prod(shape)
    return lines


def _input_value(graph: Graph, name: str, x: NDArray, uniform: bool) -> Any:
    """An argument: a number, or an array in memory."""
    kind = kind_of(x.dtype)
    if x.shape:
        return Stored(x.shape, kind, StoredArray(kind, math.prod(x.shape), [], name=name, uniform=uniform))
    value = np.empty((), object)
    value[()] = graph.input(name, kind, uniform=uniform)
    return value


def _body(graph: Graph, writer: Writer, inputs: Sequence[Any], results: Sequence[Any]) -> list[str]:
    """Statements that compute the results of one run or of a vector of runs."""
    indent = " " * 8
    for argument in inputs:
        if isinstance(argument, Stored) and argument.array is not None:
            writer.name_array(argument.array, argument.array.name)
    for place, result in enumerate(results):
        if isinstance(result, Stored):
            if result.array is None or result.array.loop is None or result.begin or result.array.size != result.size:
                raise ExportError("a result is a part of an array", remedy="return a copy, such as x + 0")
            writer.name_array(result.array, f"out{place}")
    lines = []
    for value in inputs_of(graph.scope):
        if value.data == _PERIODS:
            writer.name(value, _PERIODS)
        elif writer.is_needed(value):
            name = writer.new_name("p", value.uniform)
            writer.name(value, name)
            lines.append(f"{indent}{writer.constant(value)} {name} = {writer.loaded(value)};")
    lines += writer.scope(graph.scope, indent)
    for place, result in enumerate(results):
        if not isinstance(result, Stored):
            array = StoredArray(result.flat[0].kind, result.size, [], name=f"out{place}")
            writer.name_array(array, array.name)
            lines += [f"{indent}{writer.store(array, str(at), value)};" for at, value in enumerate(result.flat)]
    return lines


def compile_library(source: str, flags: Sequence[str]) -> bytes:
    """Compile a source to a shared library; raises `CompilerError` if that fails."""
    options = ["-std=gnu11", *_FLAGS, *flags, *own_flags(), "source.c", "-lm"]
    return build_library({"source.c": source}, options, _COMPILING[0] + len(source) / _COMPILING[1])


@functools.cache
def compiler_version(path: str) -> str:
    """Name and version of a compiler: the first line that it prints of them, or its path."""
    try:
        with tempfile.TemporaryDirectory(prefix="mckibben-") as folder:
            return _call([path, "--version"], folder, _COMPILING[0])
    except (CompilerError, OSError):
        return path


def build_library(texts: Mapping[str, str], options: Sequence[str], seconds: float = _COMPILING[0]) -> bytes:
    """Shared library of the machine's C compiler, built in a temporary folder, which is removed in any case.

    Raises `CompilerError`; after a compiler that took longer than some seconds, at every later call.

    Parameters
    ----------
    texts
        Contents of the files in the folder.
    options
        Options of the compiler and names of sources.
    seconds
        Longest duration [s].
    """
    if _FAILED:
        raise _without_frames(_FAILED[0])
    words = compiler_words()
    if (name := shutil.which(words[0])) is None:
        raise CompilerError(f"there is no C compiler {quoted(words[0])}", field="CC", remedy=_OTHER_COMPILER)
    try:
        with tempfile.TemporaryDirectory(prefix="mckibben-", ignore_cleanup_errors=True) as folder:
            for path, text in texts.items():
                Path(folder, path).write_text(text, encoding="utf-8")
            _call([name, *words[1:], "-shared", "-fPIC", *options, "-o", "library.so"], folder, seconds)
            return Path(folder, "library.so").read_bytes()
    except OSError as error:
        raise CompilerError(f"no program can be compiled: {error}", remedy=_OTHER_FOLDER) from error


def _call(command: Sequence[str], folder: str, seconds: float) -> str:
    """First line that a compiler prints; raises `CompilerError` if it fails, or takes too long and is ended."""
    with Path(folder, "messages.txt").open("w+b") as messages:  # not a pipe, which a hanging child would hold open
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=messages, stderr=messages, start_new_session=True
        )
        late = threading.Event()
        timer = threading.Timer(seconds, lambda: (late.set(), _kill(process)))
        timer.start()  # a wait with a timeout looks only every 50 ms
        try:
            process.wait()
        finally:
            timer.cancel()
            if process.returncode is None:
                _kill(process)
        slow = late.is_set()
        reason = f"it takes longer than {seconds:.0f} s" if slow else f"exit status {process.returncode}"
        messages.seek(0)
        line, *_ = [*messages.read(10_000).decode(errors="replace").strip().splitlines(), reason]
    if process.returncode:
        message = f"{command[0]} does not compile the program: {reason if slow else line}"
        error = CompilerError(message, value=command[0], remedy=_OTHER_COMPILER)
        _FAILED.extend([error] * slow)
        raise error
    return line


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process and its children."""
    with suppress(ProcessLookupError):  # it has just ended
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()


def load_library(library: bytes) -> tuple[Any, int]:
    """The function of a shared library, and its runs per vector; raises `CompilerError` if it cannot be loaded.

    The library is loaded from a file that this user alone can access, and which is removed at once.
    """
    np.empty(31 << 17)  # 31 MiB, untouched: once it is freed, glibc reuses the pages of arrays up to its size
    try:
        # accessible to this user only, with a unique name
        with tempfile.TemporaryDirectory(prefix="mckibben-", ignore_cleanup_errors=True) as folder:
            path = Path(folder, "library.so")
            path.write_bytes(library)
            loaded = ctypes.CDLL(str(path))
            run, width = loaded.run, ctypes.c_int64.in_dll(loaded, "width").value
    except (OSError, AttributeError, ValueError) as error:
        raise CompilerError(f"a compiled program cannot be loaded: {error}", remedy=_OTHER_FOLDER) from error
    run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64]
    run.restype = None
    return run, width


def _compiler_state() -> str:
    """Identity of the compiler, and its options, for the program cache."""
    name = compiler()
    if name is None:
        return ""
    try:
        status = Path(name).resolve().stat()
    except OSError:  # removed since it was found
        return ""
    options = compiler_words(), _FLAGS, _ALONE, _FOR_LANES, own_flags()
    return f"{Path(name).resolve()} {status.st_size} {status.st_mtime_ns} {options}"


def _words(x: NDArray) -> NDArray:
    """Elements of an array in 64-bit words."""
    return x.ravel() if x.dtype.kind == "f" else x.astype(np.int64).ravel().view(float)


def _padded(x: NDArray, size: int) -> NDArray:
    """Lanes padded with the last one."""
    short = size - x.shape[-1]
    return np.concatenate([x, np.repeat(x[..., -1:], short, axis=-1)], axis=-1) if short else x
