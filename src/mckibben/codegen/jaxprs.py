"""Analysis of a jaxpr: its size, the source line of an equation, and values that vary over lanes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from jax.extend import core

CALLS = {"jit", "pjit", "closed_call", "remat", "checkpoint", "custom_vjp_call", "custom_jvp_call"}


def equations(jaxpr: Any) -> int:
    """Equations of a jaxpr, with those of inner ones."""
    return sum(1 + sum(map(equations, _inner(equation))) for equation in jaxpr.eqns)


def _inner(equation: Any) -> Iterator[Any]:
    for value in equation.params.values():
        for one in value if isinstance(value, tuple) else (value,):
            inner = getattr(one, "jaxpr", one)
            if hasattr(inner, "eqns"):
                yield inner


def source(equation: Any) -> str:
    """Where an equation was written."""
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback is not None else ():
        if "/jax/" not in frame.file_name and "/equinox/" not in frame.file_name:
            return f"{frame.file_name.rpartition('/')[2]}, line {frame.line_num}, in {frame.function_name}"
    return ""


def varying_carry(body: Any, constants: Sequence[bool], carry: Sequence[bool], columns: Sequence[bool]) -> list[bool]:
    """Loop-carried variables that vary over lanes, by those constants, initial values and columns that do."""
    carry = list(carry)
    while True:
        results = _varying(body.jaxpr, [*constants, *carry, *columns])[: len(carry)]
        following = [before or after for before, after in zip(carry, results, strict=True)]
        if following == carry:
            return carry
        carry = following


def _varying(jaxpr: Any, inputs: Sequence[bool]) -> list[bool]:
    """Results that vary over lanes, by the inputs that do; those of branches and of stored rows always."""
    known = dict(zip(jaxpr.invars, inputs, strict=True))

    def read(variable: Any) -> bool:
        return not isinstance(variable, core.Literal) and known.get(variable, False)

    for equation in jaxpr.eqns:
        given, parameters = list(map(read, equation.invars)), equation.params
        results = [any(given)] * len(equation.outvars)
        if equation.primitive.name in CALLS:
            inner = parameters.get("jaxpr") or parameters["call_jaxpr"]
            results = _varying(getattr(inner, "jaxpr", inner), given)
        elif equation.primitive.name == "scan":
            begin = parameters["num_consts"]
            end = begin + parameters["num_carry"]
            carry = varying_carry(parameters["jaxpr"], given[:begin], given[begin:end], given[end:])
            results = carry + [True] * (len(results) - len(carry))
        elif equation.primitive.name == "cond":
            results = [True] * len(results)
        known.update(zip(equation.outvars, results, strict=True))
    return list(map(read, jaxpr.outvars))
