"""Writer of CUDA kernels: C with one thread per run.

In 32 bits, values that differ between runs are `float`; values equal in all runs, such as the reference, are `double`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mckibben.codegen.graph import Kind, Scope, StoredArray, Value
from mckibben.codegen.languages import c_language
from mckibben.codegen.writer import Language, Text, Writer

THREADS = 128
"""Threads per block."""

FIRST, STEP = "blockIdx.x * (int64_t)blockDim.x + threadIdx.x", "(int64_t)gridDim.x * blockDim.x"
"""First run of a thread, and step to its next one."""
_BLOCKS = 2, 4  # per multiprocessor, in 64 and 32 bits: they limit the registers per thread to 255 and 128
_ATOM = 8
_OF_INTEGERS = {
    "abs": "{0} < 0 ? -{0} : {0}",
    "rem": "{0} % {1}",
    "max": "{0} > {1} ? {0} : {1}",
    "min": "{0} < {1} ? {0} : {1}",
}


def _language(real: str) -> Language:
    """C; with `float`, the bits of numbers are those of 32."""
    language = c_language(real)
    if real == "double":
        return language
    bits = language.helpers["bits"].replace("double", real).replace("int64_t i;", "int32_t i;")
    return replace(language, helpers={**language.helpers, "bits": bits})


def head(scalars: int, *, single: bool) -> str:
    """Declaration of a kernel; numbers of all runs are its parameters, which take no registers."""
    pointers = "const double *__restrict__ arrays, double *__restrict__ results, int64_t lanes"
    return f"""struct Scalars {{ double x[{max(scalars, 1)}]; }};
extern "C" __global__ void __launch_bounds__({THREADS}, {_BLOCKS[single]}) run(const Scalars given, {pointers})"""


class KernelWriter(Writer):
    """Writes the scopes of a kernel."""

    def __init__(self, scopes: Sequence[Scope], results: Sequence[Value | StoredArray], *, single: bool) -> None:
        super().__init__(scopes, _language("float" if single else "double"), results, wide_language=_language("double"))

    def _is_wide(self, value: Value) -> bool:
        return value.uniform

    def variable(self, kind: Kind, uniform: bool) -> str:
        return (self._wide_language if uniform else self.language).types[kind]

    def loaded(self, value: Value) -> str:
        return f"{value.data}[{'0' if value.uniform else 'b'}]"

    def store(self, array: StoredArray, place: str, value: Value) -> str:
        name = self._arrays[id(array)]
        return f"{name}[{self._at(array, place)}] = {self.text(value)}"

    def element(self, array: StoredArray, place: str) -> str:
        text = f"{self._arrays[id(array)]}[{self._at(array, place)}]"
        return text if array.uniform else f"(({self.language.types[array.kind]}){text})"

    def _at(self, array: StoredArray, place: str) -> str:
        """Text of a position: in arguments and results, of this run."""
        argument = array.name and not array.uniform
        return f"({place}) * lanes + b" if argument or self._arrays[id(array)].startswith("out") else place

    def _array(self, array: StoredArray, texts: Sequence[str] | None, indent: str) -> list[str]:
        name = self._arrays[id(array)] = self._new("a")
        language = self._wide_language if array.uniform else self.language
        return [f"{indent}{language.array(name, array.kind, array.size, texts, array.constant)}"]

    def _operation(self, value: Value) -> Text:
        if value.kind is Kind.INTEGER and value.operation in _OF_INTEGERS:
            texts = (f"({self.text(one)})" for one in value.arguments)
            return f"({_OF_INTEGERS[value.operation].format(*texts)})", _ATOM
        return super()._operation(value)
