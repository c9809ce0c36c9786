"""Rules for the primitives that compute, reduce or move array elements."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from mckibben.codegen.graph import Graph, Kind, Value
from mckibben.codegen.random_bits import MASK

Array = Any  # an array of values
Shape = tuple[int, ...]
Parameters = Mapping[str, Any]
"""Parameters of an equation of a jaxpr."""
Rule = Callable[..., Array]


def _over_axes(method: str, *operations: str) -> Iterator[Rule]:
    """Rules of primitives that apply a method to the axes in their parameters, each with an operation."""
    for name in operations:
        yield lambda self, parameters, kind, _, x, name=name: getattr(self, method)(name, parameters["axes"], kind, x)


class ArrayRules:
    """Rules of the primitives of JAX that compute, reduce or move elements, one method per primitive.

    A rule is named as its primitive, with an underscore before it. It takes the parameters of the equation, the kind
    and the shape of its result, and the arguments as arrays of values; it returns the result, or None for parameters
    that it does not support, which is reported with the place in the source.
    """

    _graph: Graph

    def _elementwise(self, function: Callable[..., Value], *arrays: Array) -> Array:
        """Result of a function of scalars for each element of arrays, which broadcast."""
        if not any(array.ndim for array in arrays):  # the common case
            result = np.empty((), object)
            result[()] = function(*(array[()] for array in arrays))
            return result
        arrays = np.broadcast_arrays(*arrays)
        return array_of(arrays[0].shape, lambda at: function(*(array[at] for array in arrays)))

    # Elementwise, with parameters

    def _integer_pow(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Integer power, by multiplications."""
        return self._elementwise(lambda x: self._graph.power(x, parameters["y"]), x)

    def _round(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array | None:
        """Nearest integer, of two the even one; other ways of rounding are not supported."""
        if parameters["rounding_method"] is not jax.lax.RoundingMethod.TO_NEAREST_EVEN:
            return None
        return self._elementwise(lambda x: self._graph.operation("round", kind, x), x)

    def _reduce_precision(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array | None:
        """Number rounded to 32 bits; other precisions than 32 and 64 bits are not supported."""
        bits = parameters["exponent_bits"], parameters["mantissa_bits"]
        if bits == (11, 52) or (bits == (8, 23) and self._graph.single):
            return x
        single = lambda x: x if x.operation == "single" else self._graph.operation("single", kind, x)  # noqa: E731
        return self._elementwise(single, x) if bits == (8, 23) else None

    def _select_n(self, parameters: Parameters, kind: Kind, shape: Shape, which: Array, *cases: Array) -> Array:
        """Element of the case that `which`, a boolean or the number of the case, tells."""
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

    def _clamp(self, parameters: Parameters, kind: Kind, shape: Shape, low: Array, x: Array, high: Array) -> Array:
        """Number limited to bounds; NaN if it or a bound is NaN."""
        operation = self._graph.operation
        within = lambda low, x, high: operation("min", kind, operation("max", kind, x, low), high)  # noqa: E731
        return self._elementwise(within, low, x, high)

    def _convert_element_type(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Number of another type; an unsigned one is taken modulo 2^32."""

        def convert(x: Value) -> Value:
            result = self._graph.operation(kind.value, kind, x)
            if np.dtype(parameters["new_dtype"]) == np.uint32 and x.kind is not Kind.BOOLEAN:
                result = self._graph.operation("and", kind, result, self._graph.constant(MASK, kind))
            return result

        return self._elementwise(convert, x)

    def _bitcast_convert_type(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array | None:
        """Bits of a number as those of another type of the same width.

        Integers have 64 bits, except in vectors of a program of 32 bits, where numbers of 64 bits have none.
        """
        reals, words = {"f8": "from_bits", "f4": "from_bits_32"}, {"i8": "bits"}
        if self._graph.single:
            words = {} if x.flat[0].uniform else {"i4": "bits"}
            if not self._graph.threads and not x.flat[0].uniform:  # whose integers have 32 bits
                reals = {"f4": "from_bits_32"}
        name = (reals | words).get(np.dtype(parameters["new_dtype"]).str[1:])
        if name is None:
            return None
        return self._elementwise(lambda x: self._graph.operation(name, kind, x), x)

    def _shift_right_logical(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array, places: Array) -> Array:
        """Shift to the right that fills with zeros: an arithmetic one whose copies of the sign are masked."""

        def shifted(x: Value, places: Value) -> Value:
            result = self._graph.operation("shift_right", kind, x, places)
            if places.constant is None:
                return result
            mask = self._graph.constant((1 << (64 - places.constant)) - 1, kind)  # of a 64-bit word
            return self._graph.operation("and", kind, result, mask)

        return self._elementwise(shifted, x, places)

    # Reductions

    def _reduce(self, name: str, axes: Sequence[int], kind: Kind, x: Array) -> Array:
        """Elements along axes combined by an operation, in their order."""
        kept_axes = [axis for axis in range(x.ndim) if axis not in axes]
        rows = x.transpose([*axes, *kept_axes]).reshape(-1, *(x.shape[axis] for axis in kept_axes))
        result, *others = (np.asarray(row, object) for row in rows)
        for row in others:
            result = self._elementwise(lambda x, y: self._graph.operation(name, kind, x, y), result, row)
        return result

    _reduce_sum, _reduce_max, _reduce_min = _over_axes("_reduce", "add", "max", "min")
    _reduce_and, _reduce_or = _over_axes("_reduce", "and", "or")
    _argmin, _argmax = _over_axes("_first_of", "lt", "gt")

    def _first_of(self, better: str, axes: Sequence[int], kind: Kind, x: Array) -> Array:
        """Index of the first smallest or largest element along an axis; of the first NaN if there is one.

        `better` is the comparison that a new best element fulfils, ``lt`` or ``gt``.
        """
        operation = self._graph.operation

        def preferred(x: Value, best: Value) -> Value:
            if x.kind is not Kind.REAL:
                return operation(better, Kind.BOOLEAN, x, best)
            no_number, number = operation("ne", Kind.BOOLEAN, x, x), operation("eq", Kind.BOOLEAN, best, best)
            unordered = operation("and", Kind.BOOLEAN, no_number, number)
            return operation("or", Kind.BOOLEAN, operation(better, Kind.BOOLEAN, x, best), unordered)

        best, *others = (np.asarray(candidate, object) for candidate in np.moveaxis(x, axes[0], 0))
        index = array_of(best.shape, lambda _: self._graph.constant(0, kind))
        for number, candidate in enumerate(others, 1):
            chosen, place = self._elementwise(preferred, candidate, best), self._graph.constant(number, kind)
            index = self._elementwise(lambda c, i, n=place: operation("select", kind, c, n, i), chosen, index)
            best = self._elementwise(
                lambda c, new, old: operation("select", new.kind, c, new, old), chosen, candidate, best
            )
        return index

    def _dot_general(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array, y: Array) -> Array | None:
        """Sum of products over the axes of two arrays; batched axes are not supported."""
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

    # Moves

    def _broadcast_in_dim(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Array repeated along new axes."""
        axes = [1] * len(shape)
        for axis, size in zip(parameters["broadcast_dimensions"], x.shape, strict=True):
            axes[axis] = size
        return np.broadcast_to(x.reshape(axes), shape)

    def _transpose(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Array with its axes in another order."""
        return x.transpose(parameters["permutation"])

    def _rev(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Array reversed along axes."""
        return np.flip(x, parameters["dimensions"])

    def _concatenate(self, parameters: Parameters, kind: Kind, shape: Shape, *arrays: Array) -> Array:
        """Arrays joined along an axis."""
        return np.concatenate(arrays, parameters["dimension"])

    def _stack(self, parameters: Parameters, kind: Kind, shape: Shape, *arrays: Array) -> Array:
        """Arrays joined along a new axis."""
        return np.stack(arrays, parameters.get("axis", 0))

    def _split(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> list[Array]:
        """Parts of an array of given sizes along an axis."""
        return np.split(x, np.cumsum(parameters["sizes"])[:-1], parameters["axis"])

    def _unstack(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> list[Array]:
        """Items along an axis; a primitive of JAX 0.12 and newer."""
        axis = parameters["axis"]
        return [np.squeeze(slab, axis) for slab in np.split(x, x.shape[axis], axis)]

    def _slice(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Part of an array between bounds, with strides."""
        strides = parameters["strides"] or [1] * x.ndim
        ends = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
        return x[tuple(slice(*bounds) for bounds in ends)]

    def _dynamic_slice(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array, *starts: Array) -> Array:
        """Part of an array of few values, by a selection for each place where it may begin."""
        operation = self._graph.operation
        for axis, (start, size) in enumerate(zip(starts, parameters["slice_sizes"], strict=True)):
            first, *others = (x.take(range(k, k + size), axis) for k in range(x.shape[axis] - size + 1))
            for k, candidate in enumerate(others, 1):
                beyond = operation("ge", Kind.BOOLEAN, start[()], self._graph.constant(k, start[()].kind))
                select = lambda yes, no, c=beyond: operation("select", kind, c, yes, no)  # noqa: E731
                first = self._elementwise(select, candidate, first)
            x = first
        return x

    def _pad(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array, value: Array) -> Array | None:
        """Array with a value around and between its elements; negative amounts, which cut, are not supported."""
        config = parameters["padding_config"]
        if any(min(amounts) < 0 for amounts in config):
            return None
        result, sizes = np.broadcast_to(value, shape).copy(), zip(config, shape, strict=True)
        result[tuple(slice(low, size - high, between + 1) for (low, high, between), size in sizes)] = x
        return result


def array_of(shape: tuple[int, ...], value: Callable[[tuple[int, ...]], Value]) -> Array:
    """Array of values, by position."""
    result = np.empty(shape, object)
    for at in np.ndindex(*shape):
        result[at] = value(at)
    return result
