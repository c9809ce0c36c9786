"""Writer of CUDA kernels: C with one thread per run.

In 32 bits, values that differ between runs are `float`; values equal in all runs, such as the reference, are `double`.
A kernel of one thread computes those that are also the same in all periods; they are constants of the kernel of the
runs, and take no registers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mckibben.codegen.graph import Kind, Scope, StoredArray, Value
from mckibben.codegen.languages import c_language
from mckibben.codegen.templates import filled
from mckibben.codegen.writer import ATOM, Language, Text, Writer

THREADS = 128
"""Threads per block."""

_BLOCKS = {"double": 4, "float": 2}  # per multiprocessor, as is fastest on an H100: 128 and 255 registers per thread
_MOST = 8192  # constants: the device has 64 KiB for them


def _language(real: str) -> Language:
    """C; with `float`, the bits of numbers are those of 32."""
    language = c_language(real)
    if real == "double":
        return language
    bits = language.helpers["bits"].replace("double", real).replace("int64_t i;", "int32_t i;")
    return replace(language, helpers={**language.helpers, "bits": bits})


def kernels(
    scalars: int,
    places: Sequence[str],
    prepared: Sequence[str],
    constants: Sequence[str],
    body: Sequence[str],
    real: str,
) -> str:
    """Text of both kernels of a program.

    Parameters
    ----------
    scalars
        Number of arguments that are numbers of all runs.
    places
        Declarations of the places of arguments and results.
    prepared, constants
        Statements of the kernel of one thread, and the texts of the constants that it stores.
    body
        Statements of a run.
    real
        ``float`` or ``double``, the type of values that differ between runs.
    """
    values = {"scalars": scalars, "threads": THREADS, "blocks": _BLOCKS[real], "real": real, "constants": constants}
    return filled("kernels.cu", values | {"places": places, "prepared": prepared, "body": body})


class KernelWriter(Writer):
    """Writes the scopes of a kernel.

    Attributes
    ----------
    constants
        Values that all runs and periods share, in the order of their places in the memory for constants.
    """

    def __init__(self, scopes: Sequence[Scope], results: Sequence[Value | StoredArray], *, single: bool) -> None:
        super().__init__(scopes, _language("float" if single else "double"), results, wide_language=_language("double"))
        self._first = scopes[0]
        self.constants: list[Value] = []
        self._places: dict[int, int] = {}  # their places, by identity

    def _is_wide(self, value: Value) -> bool:
        """Whether a value is the same in all runs, and has 64 bits."""
        return value.uniform

    def variable(self, kind: Kind, uniform: bool) -> str:
        return (self._wide_language if uniform else self.language).types[kind]

    def loaded(self, value: Value) -> str:
        return f"{value.data}[{'0' if value.uniform else 'b'}]"

    def store(self, array: StoredArray, place: str, value: Value) -> str:
        name = self._arrays[id(array)]
        return f"{name}[{self._at(array, place)}] = {self.text(value)}"

    def element(self, array: StoredArray, place: str) -> str:
        """Text of an element of an array, with the precision of its users."""
        text = f"{self._arrays[id(array)]}[{self._at(array, place)}]"
        return text if array.uniform else f"(({self.language.types[array.kind]}){text})"

    def _at(self, array: StoredArray, place: str) -> str:
        """Text of a position: in arguments and results, of this run."""
        argument = array.name and not array.uniform
        return f"({place}) * lanes + b" if argument or self._arrays[id(array)].startswith("out") else place

    def _array(self, array: StoredArray, texts: Sequence[str] | None, indent: str) -> list[str]:
        name = self._arrays[id(array)] = self.new_name("a")
        language = self._wide_language if array.uniform else self.language
        return [f"{indent}{language.array(name, array.kind, array.size, texts, array.constant)}"]

    def _argument(self, value: Value, argument: Value) -> Text:
        """Text of an argument; a value that all runs and periods share becomes a constant of the kernel."""
        is_parameter = argument.uniform and argument.scope is self._first and argument.operation != "constant"
        if not is_parameter or argument.kind is not Kind.REAL or all(argument.uniform for argument in value.arguments):
            return super()._argument(value, argument)
        if id(argument) not in self._places:
            if len(self.constants) == _MOST:
                return super()._argument(value, argument)
            self._places[id(argument)] = len(self.constants)
            self.constants.append(argument)
        return f"known[{self._places[id(argument)]}]", ATOM
