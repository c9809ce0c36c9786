"""From a jaxpr to scalar expressions: arrays become scalars, calls are inlined, long loops stay loops."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from mckibben.codegen.graph import ForLoop, Graph, Kind, Value
from mckibben.errors import ExportError

_UNROLLED = 300  # equations: loops of fewer in all passes are written out
_RENAMED = {"add_any": "add"}
_UNARY = {
    "neg", "abs", "sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh",
    "tanh", "floor", "ceil", "cbrt", "sign", "is_finite", "not",
}  # fmt: skip
_BINARY = {
    "add", "sub", "mul", "div", "max", "min", "pow", "atan2", "rem", "lt", "le", "gt", "ge", "eq", "ne", "and", "or",
    "xor",
}  # fmt: skip
_SAME = {"stop_gradient", "copy", "copy_p", "optimization_barrier", "reduce_precision"}
_CALLS = {"jit", "pjit", "closed_call", "remat", "checkpoint", "custom_vjp_call", "custom_jvp_call"}
_RULES = {"_exp_rule": ("exp",), "_sincos_rule": ("sin", "cos")}  # of `numerics.elementary`: the libraries' are called
Array = np.ndarray[Any, Any]  # of values


def kind_of(dtype: Any) -> Kind:
    """Kind of scalar of a NumPy type."""
    letter = np.dtype(dtype).kind
    if letter == "b":
        return Kind.BOOLEAN
    return Kind.INTEGER if letter in "iu" else Kind.REAL


class Lowering:
    """Adds the equations of jaxprs to a graph."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def function(self, function: Callable[..., Any], arguments: Any, inputs: Sequence[Array]) -> Any:
        """Lower a function of trees: example arguments, the values of their leaves; returns the tree of results."""
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        results = self._closed(closed, inputs)
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    def _closed(self, closed: Any, arguments: Sequence[Array]) -> list[Array]:
        if not hasattr(closed, "consts"):
            return self._jaxpr(closed, (), arguments)
        return self._jaxpr(closed.jaxpr, [self.literal(one) for one in closed.consts], arguments)

    def _jaxpr(self, jaxpr: Any, constants: Sequence[Array], arguments: Sequence[Array]) -> list[Array]:
        known: dict[Any, Array] = {}

        def read(variable: Any) -> Array:
            return self.literal(variable.val) if isinstance(variable, core.Literal) else known[variable]

        known.update(zip(jaxpr.constvars, constants, strict=True))
        known.update(zip(jaxpr.invars, arguments, strict=True))
        for equation in jaxpr.eqns:
            results = self._equation(equation, [read(one) for one in equation.invars])
            known.update(zip(equation.outvars, results, strict=True))
        return [read(one) for one in jaxpr.outvars]

    def literal(self, number: Any) -> Array:
        """Constants of the shape of a number or array."""
        number = np.asarray(number)
        kind = kind_of(number.dtype)
        return _array(number.shape, lambda at: self._graph.constant(number[at], kind))

    def _equation(self, equation: Any, arguments: list[Array]) -> Sequence[Array]:
        """Results of one equation."""
        name, parameters = equation.primitive.name, equation.params
        aval = equation.outvars[0].aval
        if any(_is_key(one.dtype) for one in (aval, *arguments)) or (name in ("jit", "pjit") and _known(arguments)):
            return self._evaluated(equation, arguments)
        if np.dtype(aval.dtype).kind == "u":
            raise _cannot(equation)  # it wraps around
        kind = kind_of(aval.dtype)
        name = _RENAMED.get(name, name)
        if name in _UNARY | _BINARY:
            return [self._elementwise(lambda *xs: self._graph.operation(name, kind, *xs), *arguments)]
        if name in _SAME:
            return arguments
        if name in _CALLS:
            inner = parameters.get("jaxpr") or parameters["call_jaxpr"]
            rule = (
                _RULES.get(str(getattr(inner.jaxpr.debug_info, "func_name", ""))) if name == "custom_jvp_call" else None
            )
            if rule:
                (x,) = arguments
                return [self._elementwise(lambda x, n=one: self._graph.operation(n, kind, x), x) for one in rule]
            return self._closed(inner, arguments)
        handler = getattr(self, f"_{name}", None)
        found = None if handler is None else handler(parameters, kind, aval.shape, *arguments)
        if found is None:
            raise _cannot(equation)
        return found if isinstance(found, list) else [found]

    def _evaluated(self, equation: Any, arguments: list[Array]) -> list[Any]:
        """Results of an equation of known numbers, such as random keys."""
        if not _known(arguments):
            raise _cannot(equation)
        variables = [one.aval for one in equation.invars]
        known = [
            jnp.asarray([x.data for x in one.flat], aval.dtype).reshape(one.shape) if one.dtype == object else one
            for one, aval in zip(arguments, variables, strict=True)
        ]
        found = equation.primitive.bind(*known, **equation.params)
        found = found if equation.primitive.multiple_results else [found]
        return [one if _is_key(one.dtype) else self.literal(one) for one in found]

    def _elementwise(self, function: Callable[..., Value], *arrays: Array) -> Array:
        arrays = np.broadcast_arrays(*arrays)
        return _array(arrays[0].shape, lambda at: function(*(one[at] for one in arrays)))

    # Elementwise, with parameters

    def _square(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._elementwise(lambda x: self._graph.power(x, 2), x)

    def _integer_pow(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._elementwise(lambda x: self._graph.power(x, parameters["y"]), x)

    def _rsqrt(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        one = self._graph.constant(1.0, kind)
        root = lambda x: self._graph.operation("sqrt", kind, x)  # noqa: E731
        return self._elementwise(lambda x: self._graph.operation("div", kind, one, root(x)), x)

    def _logistic(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        one, operation = self._graph.constant(1.0, kind), self._graph.operation

        def logistic(x: Value) -> Value:
            power = operation("exp", kind, operation("neg", kind, x))
            return operation("div", kind, one, operation("add", kind, one, power))

        return self._elementwise(logistic, x)

    def _round(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array | None:
        if parameters["rounding_method"] is not jax.lax.RoundingMethod.TO_NEAREST_EVEN:
            return None
        return self._elementwise(lambda x: self._graph.operation("round", kind, x), x)

    def _select_n(self, parameters: Any, kind: Kind, shape: Any, which: Array, *cases: Array) -> Array:
        result = cases[0]
        for number, case in enumerate(cases[1:], 1):
            chosen = which
            if len(cases) > 2 or (which.size and which.flat[0].kind is Kind.INTEGER):
                at_least = self._graph.constant(number, Kind.INTEGER)
                compare = lambda x, n=at_least: self._graph.operation("ge", Kind.BOOLEAN, x, n)  # noqa: E731
                chosen = self._elementwise(compare, which)
            select = lambda c, yes, no: self._graph.operation("select", kind, c, yes, no)  # noqa: E731
            result = self._elementwise(select, chosen, case, result)
        return result

    def _clamp(self, parameters: Any, kind: Kind, shape: Any, low: Array, x: Array, high: Array) -> Array:
        operation = self._graph.operation
        within = lambda low, x, high: operation("min", kind, operation("max", kind, x, low), high)  # noqa: E731
        return self._elementwise(within, low, x, high)

    def _convert_element_type(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._elementwise(lambda x: self._graph.operation(kind.value, kind, x), x)

    # Shapes

    def _broadcast_in_dim(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        axes = [1] * len(shape)
        for axis, size in zip(parameters["broadcast_dimensions"], x.shape, strict=True):
            axes[axis] = size
        return np.broadcast_to(x.reshape(axes), shape)

    def _reshape(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return x.reshape(shape)

    _squeeze = _expand_dims = _reshape

    def _transpose(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return x.transpose(parameters["permutation"])

    def _rev(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return np.flip(x, parameters["dimensions"])

    def _concatenate(self, parameters: Any, kind: Kind, shape: Any, *arrays: Array) -> Array:
        return np.concatenate(arrays, parameters["dimension"])

    def _stack(self, parameters: Any, kind: Kind, shape: Any, *arrays: Array) -> Array:
        return np.stack(arrays, parameters.get("axis", 0))

    def _split(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> list[Array]:
        return np.split(x, np.cumsum(parameters["sizes"])[:-1], parameters["axis"])

    def _slice(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        strides = parameters["strides"] or [1] * x.ndim
        ends = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
        return x[tuple(slice(*one) for one in ends)]

    def _pad(self, parameters: Any, kind: Kind, shape: Any, x: Array, value: Array) -> Array | None:
        config = parameters["padding_config"]
        if any(min(one) < 0 for one in config):
            return None
        result = np.broadcast_to(value, shape).copy()
        result[
            tuple(
                slice(low, size - high, between + 1) for (low, high, between), size in zip(config, shape, strict=True)
            )
        ] = x
        return result

    def _iota(self, parameters: Any, kind: Kind, shape: Any) -> Array:
        return self.literal(jax.lax.broadcasted_iota(parameters["dtype"], shape, parameters["dimension"]))

    # Reductions

    def _reduce(self, name: str, axes: Sequence[int], kind: Kind, x: Array) -> Array:
        rest = [axis for axis in range(x.ndim) if axis not in axes]
        rows = x.transpose([*axes, *rest]).reshape(-1, *(x.shape[axis] for axis in rest))
        result = rows[0]
        for row in rows[1:]:
            result = self._elementwise(lambda x, y: self._graph.operation(name, kind, x, y), result, row)
        return np.asarray(result, object)

    def _reduce_sum(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._reduce("add", parameters["axes"], kind, x)

    def _reduce_max(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._reduce("max", parameters["axes"], kind, x)

    def _reduce_min(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._reduce("min", parameters["axes"], kind, x)

    def _reduce_and(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._reduce("and", parameters["axes"], kind, x)

    def _reduce_or(self, parameters: Any, kind: Kind, shape: Any, x: Array) -> Array:
        return self._reduce("or", parameters["axes"], kind, x)

    def _dot_general(self, parameters: Any, kind: Kind, shape: Any, x: Array, y: Array) -> Array | None:
        (over_x, over_y), (batch, _) = parameters["dimension_numbers"]
        if batch:
            return None
        left = np.moveaxis(x, over_x, range(len(over_x)))
        right = np.moveaxis(y, over_y, range(len(over_y)))
        count = len(over_x)
        left = left.reshape(*left.shape, *[1] * (right.ndim - count))
        right = right.reshape(*right.shape[:count], *[1] * (x.ndim - count), *right.shape[count:])
        terms = self._elementwise(lambda x, y: self._graph.operation("mul", kind, x, y), left, right)
        return self._reduce("add", range(count), kind, terms) if count else terms

    # Control flow

    def _cond(self, parameters: Any, kind: Kind, shape: Any, which: Array, *arguments: Array) -> list[Array]:
        """All branches are computed: they are pure, and few."""
        index = which.item()
        if index.constant is not None:
            return self._closed(parameters["branches"][int(index.constant)], arguments)
        cases = [self._closed(branch, arguments) for branch in parameters["branches"]]
        return [
            self._select_n(None, kind_of_values(results[0]), None, which, *results)
            for results in zip(*cases, strict=True)
        ]

    def _scan(self, parameters: Any, kind: Kind, shape: Any, *arguments: Array) -> list[Array]:
        count, carries, length = parameters["num_consts"], parameters["num_carry"], parameters["length"]
        body, reverse = parameters["jaxpr"], parameters["reverse"]
        constants, carry, columns = arguments[:count], arguments[count : count + carries], arguments[count + carries :]
        if length * _equations(body.jaxpr) <= _UNROLLED or length <= 1:
            return self._unrolled(body, length, reverse, constants, carry, columns)
        arrays = [self._graph.array(list(column.reshape(-1))) for column in columns]
        inner: list[Array] = []

        def passes(loop: ForLoop) -> list[list[Value]]:
            inner.extend(_array(one.shape, lambda at, one=one: self._graph.carry(loop, one[at])) for one in carry)
            rows = [
                self._row(loop, array, begin, column.shape[1:])
                for (array, begin), column in zip(arrays, columns, strict=True)
            ]
            results = self._closed(body, [*constants, *inner, *rows])
            following = [value for one in results[:carries] for value in one.flat]
            for carried, value in zip(loop.carried, following, strict=True):
                carried.following = value
            inner.extend(results[carries:])
            return [list(one.flat) for one in results[carries:]]

        loop = self._graph.loop(length, passes, reverse=reverse)
        last = iter([self._graph.after(one) for one in loop.carried])
        results = [_array(one.shape, lambda _: next(last)) for one in carry]
        for array, row in zip(loop.arrays, inner[carries:], strict=True):
            stored = [self._graph.element(array, None, 0, place, self._graph.scope) for place in range(array.size)]
            results.append(np.array([*stored, None], object)[:-1].reshape(length, *row.shape))
        return results

    def _row(self, loop: ForLoop, array: Any, begin: int, shape: tuple[int, ...]) -> Array:
        """The row of an array at the index of a loop."""
        size = int(np.prod(shape))
        places = iter(range(begin, begin + size))
        return _array(shape, lambda _: self._graph.element(array, loop.row, size, next(places), loop.scope))

    def _unrolled(
        self, body: Any, length: int, reverse: bool, constants: Any, carry: Sequence[Array], columns: Any
    ) -> list[Array]:
        """A scan written out."""
        rows = []
        for number in reversed(range(length)) if reverse else range(length):
            here = [np.asarray(column[number], object) for column in columns]
            results = self._closed(body, [*constants, *carry, *here])
            carry = results[: len(carry)]
            rows.append(results[len(carry) :])
        rows = rows[::-1] if reverse else rows
        return [*carry, *(np.stack(column) for column in zip(*rows, strict=True))]


def kind_of_values(array: Array) -> Kind:
    """Kind of the values of an array."""
    return array.flat[0].kind if array.size else Kind.REAL


def _array(shape: tuple[int, ...], value: Callable[[tuple[int, ...]], Value]) -> Array:
    """Array of values, by their place."""
    result = np.empty(shape, object)
    for at in np.ndindex(*shape):
        result[at] = value(at)
    return result


def _equations(jaxpr: Any) -> int:
    """Equations of a jaxpr, with those of inner ones."""
    return sum(1 + sum(map(_equations, _inner(equation))) for equation in jaxpr.eqns)


def _inner(equation: Any) -> Iterator[Any]:
    for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")):
        inner = getattr(value, "jaxpr", value)
        if hasattr(inner, "eqns"):
            yield inner


def _known(arrays: Sequence[Any]) -> bool:
    """Whether all values are constants, or random keys."""
    return all(one.dtype != object or all(x.constant is not None for x in one.flat) for one in arrays)


def _is_key(dtype: Any) -> bool:
    """Whether arrays of a type are of random keys."""
    return jnp.issubdtype(dtype, jax.dtypes.extended)


def _cannot(equation: Any) -> ExportError:
    name = equation.primitive.name
    return ExportError(
        f"{name} cannot be written as a program: {_source(equation)}",
        field=name,
        remedy="use another option of this part, or write the function without it",
    )


def _source(equation: Any) -> str:
    """Where an equation was written."""
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback is not None else ():
        if "/jax/" not in frame.file_name and "/equinox/" not in frame.file_name:
            return f"{frame.file_name.rpartition('/')[2]}, line {frame.line_num}, in {frame.function_name}"
    return "of an unknown source"
