"""A CUDA device that is this processor: the driver of `driver.cpp`, and a C++ compiler in place of NVRTC."""

import ctypes
import hashlib
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
COMPILER = shutil.which("c++")
OPTIONS = ("-std=c++17", "-O0", "-w", "-shared", "-fPIC", f"-I{HERE}")


def build(source: str, *options: str) -> bytes:
    """A shared library."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "source.cpp")
        path.write_text(source)
        subprocess.run([COMPILER, *options, *OPTIONS, path, "-o", f"{folder}/library.so"], check=True)
        return Path(folder, "library.so").read_bytes()


class Compiler:
    """In place of `Nvrtc`: kernels as C++, with a loop over the threads."""

    version = 12, 8

    def __init__(self, folder: Path) -> None:
        known = hashlib.sha256(b"".join((HERE / name).read_bytes() for name in ("before.h", "after.h")))
        self.name = f"of the tests {known.hexdigest()}"
        self.sources: list[str] = []
        self.folder = folder  # with the headers of the standard library, precompiled
        header = [*OPTIONS, "-x", "c++-header", HERE / "before.h", "-o", folder / "before.h.gch"]
        subprocess.run([COMPILER, *header], check=True)

    def compile(self, source: str, architecture: int) -> bytes:
        self.sources.append(source)
        library = build(f'#include "before.h"\n{source}\n#include "after.h"\n', f"-I{self.folder}")
        return struct.pack("q", len(library)) + library


def driver(folder: Path) -> ctypes.CDLL:
    """The driver, loaded."""
    path = folder / "libcuda.so"
    path.write_bytes(build((HERE / "driver.cpp").read_text(), "-ldl"))
    return ctypes.CDLL(str(path))
