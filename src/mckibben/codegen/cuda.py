"""Functions compiled as CUDA kernels by NVRTC, and run by NVIDIA's driver; both are called by ctypes."""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from ctypes import byref, c_char_p, c_int, c_int64, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.codegen.kernels import THREADS
from mckibben.codegen.native import Compiled, NativeFunction
from mckibben.codegen.templates import filled
from mckibben.errors import CompilerError, DeviceError

_WHEELS = {12: "cuda_nvrtc", 13: "cu13"}  # folders of NVRTC in the package `nvidia`, by version of CUDA
_DRIVER = "libcuda.so.1"
_OPTIONS = (
    "--std=c++17",
    "--device-as-default-execution-space",
    "--prec-div=false",  # in 32 bits, an error of two units in the last place
    "--prec-sqrt=false",
)
_OLD = 222, 803, 804  # driver's errors: unsupported version of PTX, mismatched or incompatible driver
_NO_DEVICE = 100
_OUT_OF_MEMORY = 2
_MAJOR, _MINOR = 75, 76  # attributes of a device: its compute capability
_OTHER_ENGINE = "use engine='native' or 'xla'"


class DeviceProgram(NamedTuple):
    """A loaded kernel of runs, the one that computes its constants, and their memory."""

    run: c_void_p
    prepare: c_void_p
    constants: c_int64
    size: c_size_t


class Nvrtc:
    """NVIDIA's runtime compiler.

    Attributes
    ----------
    version
        Version of CUDA, (major, minor).
    architectures
        Compute capabilities that it compiles for, 10 times their number, such as 90.
    """

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        major, minor, count = c_int(), c_int(), c_int()
        self._call("nvrtcVersion", byref(major), byref(minor))
        self.version = major.value, minor.value
        self._call("nvrtcGetNumSupportedArchs", byref(count))
        architectures = (c_int * count.value)()
        self._call("nvrtcGetSupportedArchs", architectures)
        self.architectures = list(architectures)

    def compile(self, source: str, architecture: int) -> bytes:
        """Compile to the binary for a compute capability, such as 90, or to PTX if that is newer than the compiler.

        Raises `DeviceError` for a capability older than all that the compiler knows, `CompilerError`, with the first
        error of its log, for a source that does not compile.
        """
        if architecture < min(self.architectures):
            raise DeviceError(
                f"the device has compute capability {architecture / 10}, NVRTC {self.name} compiles from "
                f"{min(self.architectures) / 10} up",
                value=architecture,
                lower=min(self.architectures),
                remedy=f"install an older NVRTC, or {_OTHER_ENGINE}",
            )
        supported = architecture in self.architectures
        target = f"sm_{architecture}" if supported else f"compute_{max(self.architectures)}"
        options = [option.encode() for option in (f"--gpu-architecture={target}", *_OPTIONS)]
        program, text = c_void_p(), filled("cuda.h", {}) + source
        self._call("nvrtcCreateProgram", byref(program), text.encode(), b"run.cu", 0, None, None)
        try:
            status = self._library.nvrtcCompileProgram(program, len(options), (c_char_p * len(options))(*options))
            log = self._text(program, "ProgramLog").decode(errors="replace").rstrip("\0")
            if status:
                first = next((line for line in log.splitlines() if "error" in line), self._error(status))
                raise CompilerError(f"NVRTC {self.name} does not compile the program: {first}", value=status)
            return self._text(program, "CUBIN" if supported else "PTX")
        finally:
            self._call("nvrtcDestroyProgram", byref(program))

    @property
    def name(self) -> str:
        """Its version as text."""
        return ".".join(map(str, self.version))

    def _text(self, program: c_void_p, what: str) -> bytes:
        """A text of a program: its log, PTX or binary."""
        size = c_size_t()
        self._call(f"nvrtcGet{what}Size", program, byref(size))
        text = ctypes.create_string_buffer(size.value)
        self._call(f"nvrtcGet{what}", program, text)
        return text.raw

    def _error(self, status: int) -> str:
        """Text of a status."""
        self._library.nvrtcGetErrorString.restype = c_char_p
        return self._library.nvrtcGetErrorString(status).decode()

    def _call(self, name: str, *arguments: PyTree) -> None:
        """Call a function of the library; raises `CompilerError` for a status other than 0."""
        if status := getattr(self._library, name)(*arguments):
            raise CompilerError(f"{name}: {self._error(status)}", value=status)


@functools.cache
def nvrtc() -> Nvrtc:
    """NVRTC of a wheel or the system; raises `DeviceError` if there is none."""
    # Version 12 comes first, as drivers of CUDA 13 load its programs, but not the other way round.
    spec = importlib.util.find_spec("nvidia")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []
    for major, wheel in _WHEELS.items():
        name = f"libnvrtc.so.{major}"
        for path in (*(str(folder / wheel / "lib" / name) for folder in folders), name):
            with suppress(OSError):
                return Nvrtc(ctypes.CDLL(path))
    raise DeviceError(
        "there is no NVRTC, the compiler of CUDA 12 or 13",
        remedy=f"install mckibben with the extra gpu (pip install 'mckibben[gpu]'), or {_OTHER_ENGINE}",
    )


def driver_library() -> ctypes.CDLL:
    """The library of the CUDA driver; raises `DeviceError` if there is none."""
    try:
        return ctypes.CDLL(_DRIVER)
    except OSError as error:
        remedy = f"install NVIDIA's driver, or {_OTHER_ENGINE}"
        raise DeviceError(f"there is no CUDA driver ({_DRIVER})", remedy=remedy) from error


class Device:
    """The first CUDA device, with its primary context.

    Raises `DeviceError` if there is none, if its driver fails, or if the driver is too old for the compiler.

    Attributes
    ----------
    name
        Name of the device, such as ``NVIDIA H200``.
    architecture
        10 times its compute capability.
    compiler
        Name and version of the compiler.
    """

    def __init__(self, driver: ctypes.CDLL, compiler: Nvrtc) -> None:
        self._driver, self._lock = driver, threading.Lock()
        self.compiler = f"NVRTC {compiler.name}"
        self._call("cuInit", 0)
        version, count, device, major, minor = (c_int() for _ in range(5))
        self._call("cuDriverGetVersion", byref(version))
        if version.value // 1000 < compiler.version[0]:
            raise _old_driver(f"is of CUDA {version.value // 1000}.{version.value % 1000 // 10}", self.compiler)
        self._call("cuDeviceGetCount", byref(count))
        if count.value == 0:
            raise _no_device()
        self._call("cuDeviceGet", byref(device), 0)
        name = ctypes.create_string_buffer(100)
        self._call("cuDeviceGetName", name, len(name), device)
        self.name = name.value.decode(errors="replace")
        self._call("cuDeviceGetAttribute", byref(major), _MAJOR, device)
        self._call("cuDeviceGetAttribute", byref(minor), _MINOR, device)
        self.architecture = 10 * major.value + minor.value
        self._context = c_void_p()
        self._call("cuDevicePrimaryCtxRetain", byref(self._context), device)

    def load(self, image: bytes) -> DeviceProgram:
        """A compiled program."""
        module, program = c_void_p(), DeviceProgram(c_void_p(), c_void_p(), c_int64(), c_size_t())
        with self._used():
            self._call("cuModuleLoadData", byref(module), image)
            for function, name in (program.run, b"run"), (program.prepare, b"prepare"):
                self._call("cuModuleGetFunction", byref(function), module, name)
            self._call("cuModuleGetGlobal_v2", byref(program.constants), byref(program.size), module, b"known")
        return program

    def run(self, program: DeviceProgram, scalars: bytes, words: NDArray, results: NDArray, lanes: int) -> None:
        """Compute all runs, with the device for this thread alone.

        Parameters
        ----------
        scalars
            Numbers that all runs share, 64 bits each.
        words
            Arrays, in words of 64 bits.
        results
            Results of all runs, an array in the memory of this machine, which is overwritten.
        lanes
            Number of runs.
        """
        with self._used(), ExitStack() as memory:
            sizes = words.nbytes, max(results.nbytes, program.size.value)
            places = [self._allocated(memory, size) for size in sizes]
            self._call("cuMemcpyHtoD_v2", places[0], c_void_p(words.ctypes.data), c_size_t(words.nbytes))
            arguments = [ctypes.create_string_buffer(scalars), *places, c_int64(lanes)]
            self._launch(program.prepare, 1, 1, arguments)
            self._call("cuMemcpyDtoD_v2", program.constants, places[1], program.size)
            self._launch(program.run, -(-lanes // THREADS), THREADS, arguments)
            self._call("cuCtxSynchronize")
            self._call("cuMemcpyDtoH_v2", c_void_p(results.ctypes.data), places[1], c_size_t(results.nbytes))

    def _launch(self, function: c_void_p, blocks: int, threads: int, arguments: Sequence[Any]) -> None:
        """Start a kernel."""
        pointers = (c_void_p * len(arguments))(*(ctypes.addressof(argument) for argument in arguments))
        sizes = map(c_uint, (blocks, 1, 1, threads, 1, 1, 0))
        self._call("cuLaunchKernel", function, *sizes, None, pointers, None)

    @contextmanager
    def _used(self) -> Iterator[None]:
        """The device for this thread alone, so that memory is that of one chunk."""
        with self._lock:
            self._call("cuCtxSetCurrent", self._context)
            yield

    def _allocated(self, memory: ExitStack, size: int) -> c_int64:
        """Memory on the device, freed at the end of the stack."""
        place = c_int64()
        self._call("cuMemAlloc_v2", byref(place), c_size_t(max(size, 1)))
        memory.callback(lambda: self._driver.cuMemFree_v2(place))
        return place

    def _call(self, name: str, *arguments: PyTree) -> None:
        """Call a function of the driver; raises `DeviceError` for a status other than 0."""
        status = getattr(self._driver, name)(*arguments)
        if status == 0:
            return
        if status == _NO_DEVICE:
            raise _no_device()
        if status in _OLD:
            raise _old_driver(f"fails with error {status}", self.compiler)
        text = c_char_p()
        has_name = self._driver.cuGetErrorName(status, byref(text)) == 0 and text.value
        remedy = "give a smaller `chunk`" if status == _OUT_OF_MEMORY else _OTHER_ENGINE
        error = has_name.decode() if has_name else f"error {status}"
        raise DeviceError(f"the CUDA driver fails: {name}: {error}", field=name, value=status, remedy=remedy)


def _no_device() -> DeviceError:
    """Error of a driver without a device."""
    return DeviceError("the CUDA driver finds no device", value=_NO_DEVICE, remedy=_OTHER_ENGINE)


def _old_driver(reason: str, compiler: str) -> DeviceError:
    """Error of a driver older than the compiler."""
    remedy = f"update NVIDIA's driver, or install an NVRTC of its version, or {_OTHER_ENGINE}"
    return DeviceError(f"the CUDA driver {reason}, too old for {compiler}", field="driver", remedy=remedy)


@functools.cache
def device() -> Device:
    """The first CUDA device; raises `DeviceError`, which names the missing part, if it cannot be used."""
    return Device(driver_library(), nvrtc())


@dataclass(frozen=True)
class _OnDevice(Compiled):
    """A kernel on the device."""

    def _call(self, scalars: bytes, words: NDArray, results: NDArray, lanes: int) -> None:
        device().run(self.run, scalars, words, results, lanes)


class CudaFunction(NativeFunction):
    """A pure function compiled as a CUDA kernel, of a tree shared by all runs and a tree with an entry per run.

    It is used as a `NativeFunction`, and raises `DeviceError` in addition.
    """

    _threads = True

    def _state(self) -> tuple[str, ...]:
        return repr((device().compiler, device().architecture, _OPTIONS)), "cuda"

    def _built(self, source: str, many: bool) -> bytes:
        return nvrtc().compile(source, device().architecture)

    def _loaded(self, program: bytes, leaves: Sequence[tuple[tuple[int, ...], str]], tree: PyTree) -> Compiled:
        return _OnDevice(device().load(program), 1, list(leaves), tree)
