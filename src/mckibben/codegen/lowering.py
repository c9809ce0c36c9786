"""Lowering of a jaxpr to scalar expressions: arrays become scalars, calls are inlined, long loops stay loops."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jax.typing import DTypeLike
from jaxtyping import ArrayLike, PyTree

from mckibben.codegen.array_rules import ArrayRules, Parameters, Shape, array_of
from mckibben.codegen.graph import FOLDED, ForLoop, Graph, Kind, StoredArray, Value
from mckibben.codegen.polynomials import erf_inv, log1p, tanh
from mckibben.codegen.random_bits import MASK, RULES, is_supported
from mckibben.errors import ExportError
from mckibben.numerics import elementary

_UNROLLED = 300  # equations: loops with fewer in total are unrolled
_RENAMED = {
    "add_any": "add",
    "shift_right_arithmetic": "shift_right",
    ("shift_right_logical", "uint32"): "shift_word",  # never negative, but in vectors of 32 bits
}
_OWN = {"bits", "from_bits", "from_bits_32", "single", "real", "integer", "boolean"}  # not primitives of JAX
_ELEMENTWISE = FOLDED.keys() - _OWN - {"round"}
_RANDOM = RULES.keys() | {"random_wrap", "random_unwrap"}
_WRAPPING = {"add", "sub", "mul", "neg", "not", "shift_left"}  # around the range of unsigned integers
_SAME = {"stop_gradient", "copy", "copy_p", "optimization_barrier"}
_RULES = {"_exp_rule": ("exp",), "_sincos_rule": ("sin", "cos")}  # of `numerics.elementary`, for library functions
_CALLS = {
    "jit", "pjit", "closed_call", "remat", "checkpoint", "custom_vjp_call", "custom_jvp_call",
    "call_hi_primitive", "eval_jaxpr",  # of JAX 0.12, for `custom_root`
}  # fmt: skip
_TAKE_STORED = _CALLS | {"scan", "cond", "reshape", "squeeze", "expand_dims", "convert_element_type"}
_LARGEST = 50_000  # elements of an array that is not in memory
Array = Any  # an array of values, or `Stored`
Equation = Jaxpr = Any  # JAX does not publish their types


@dataclass(frozen=True, slots=True)
class Stored:
    """An array in memory, from a position on; without an array, the numbers 0, 1, 2, ... of a kind.

    It stays in memory as the column of a loop, and is expanded to values for every other use.
    """

    shape: tuple[int, ...]
    kind: Kind
    array: StoredArray | None = None
    begin: int = 0

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def dtype(self) -> np.dtype:
        """NumPy type, as of an array of values."""
        return np.dtype(object)


def kind_of(dtype: DTypeLike) -> Kind:
    """Kind of scalar of a NumPy type."""
    letter = np.dtype(dtype).kind
    if letter == "b":
        return Kind.BOOLEAN
    return Kind.INTEGER if letter in "iu" else Kind.REAL


_DECOMPOSED: dict[str, Callable[[Array], Array]] = {
    "square": lambda x: x * x,
    "one_minus_square": lambda x: (1 - x) * (1 + x),  # derivative of tanh by its value, in JAX 0.12 and newer
    "rsqrt": lambda x: 1 / jnp.sqrt(x),
    "logistic": lambda x: 1 / (1 + jnp.exp(-x)),
}
"""Primitives as functions of others."""
_FOR_LANES = {"tanh": tanh, "exp": elementary.exp, "sin": elementary.sin, "cos": elementary.cos}
"""Polynomials in place of library calls, which are not vectorised."""


class _UnsupportedError(Exception):
    """An unsupported primitive, with its source location, which the caller makes an `ExportError`."""

    def __init__(self, equation: Equation) -> None:
        super().__init__(equation.primitive.name)
        self.name = equation.primitive.name
        self.place = _source(equation)


class Lowering(ArrayRules):
    """Adds the equations of jaxprs to a graph.

    Arrays are NumPy arrays of values, so that operations on them become operations on scalars. Calls are inlined. A
    loop (`jax.lax.scan`) of at most 300 equations in all is unrolled, a longer one stays a loop, and its rows are in
    memory. A branch (`jax.lax.cond`) stays a branch where all lanes of a vector take the same one.

    Examples
    --------
    >>> graph = Graph()
    >>> x = np.array(graph.input("x", Kind.REAL), object)
    >>> (result,), shape = Lowering(graph).function(lambda x: 2.0 * x, (np.array(0.0),), [x])
    >>> result.item().operation, shape.dtype.name
    ('mul', 'float64')
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def function(
        self, function: Callable[..., PyTree], arguments: PyTree, inputs: Sequence[Array]
    ) -> tuple[list[Array], PyTree]:
        """Leaves of a function of trees for values of the leaves of arguments; tree of their shapes and types.

        Raises `ExportError`, with the name of the primitive and its place in the source, for one that has no rule.

        Parameters
        ----------
        arguments
            Examples of the arguments of the function, one tree each.
        inputs
            Arrays of values for all leaves of the arguments.
        """
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        try:
            return self._closed(closed, inputs), shape
        except _UnsupportedError as error:
            message = f"{error.name} cannot be written as a program: {error.place or 'unknown source'}"
            remedy = "use another option of this component, or write the function without it"
            raise ExportError(message, field=error.name, remedy=remedy) from None

    def _closed(self, closed: Jaxpr, arguments: Sequence[Array]) -> list[Array]:
        """Results of a jaxpr with its constants."""
        if not hasattr(closed, "consts"):
            return self._jaxpr(closed, (), arguments)
        return self._jaxpr(closed.jaxpr, [self.literal(constant) for constant in closed.consts], arguments)

    def _jaxpr(self, jaxpr: Jaxpr, constants: Sequence[Array], arguments: Sequence[Array]) -> list[Array]:
        """Results of a jaxpr, equation by equation."""
        arrays: dict[core.Var, Array] = {}

        def read(variable: core.Var | core.Literal) -> Array:
            return self.literal(variable.val) if isinstance(variable, core.Literal) else arrays[variable]

        arrays.update(zip(jaxpr.constvars, constants, strict=True))
        arrays.update(zip(jaxpr.invars, arguments, strict=True))
        for equation in jaxpr.eqns:
            if not (equation.outvars or equation.effects):  # reverse derivatives leave calls without results
                continue
            operands = [read(variable) for variable in equation.invars]
            if equation.primitive.name not in _TAKE_STORED:
                operands = [self.expanded(operand) if isinstance(operand, Stored) else operand for operand in operands]
            try:
                results = self._equation(equation, operands)
            except _UnsupportedError as error:
                error.place = error.place or _source(equation)
                raise
            arrays.update(zip(equation.outvars, results, strict=True))
        return [read(variable) for variable in jaxpr.outvars]

    def expanded(self, stored: Stored) -> Array:
        """The elements of an array in memory as values; raises `ExportError` for more than 50,000."""
        if not isinstance(stored.size, int) or stored.size > _LARGEST:
            remedy = "use its elements one after the other in a loop (jax.lax.scan)"
            message = f"an array of {stored.size} numbers is used as a whole"
            raise ExportError(message, value=stored.size, upper=_LARGEST, remedy=remedy)
        if stored.array is None:
            values = [self._graph.constant(place, stored.kind) for place in range(stored.size)]
        else:
            places = range(stored.begin, stored.begin + stored.size)
            values = [self._graph.element(stored.array, None, 0, place, self._graph.scope) for place in places]
        return np.array([*values, None], object)[:-1].reshape(stored.shape)

    def literal(self, number: ArrayLike) -> Array:
        """Constants with the shape of a number or array."""
        number = np.asarray(number)
        kind = kind_of(number.dtype)
        return array_of(number.shape, lambda at: self._graph.constant(number[at], kind))

    def _equation(self, equation: Equation, arguments: list[Array]) -> Sequence[Array]:
        """Results of one equation."""
        name, parameters = equation.primitive.name, equation.params
        aval = equation.outvars[0].aval
        if name in _RANDOM:
            return self._random(equation, arguments)
        kind = kind_of(aval.dtype)
        name = _RENAMED.get((name, aval.dtype.name), _RENAMED.get(name, name))
        if name == "erf_inv" and aval.dtype == np.float32:
            return self._closed(_jaxpr_of(erf_inv, aval.shape, aval.dtype), arguments)
        if name in _DECOMPOSED:
            return self._closed(_jaxpr_of(_DECOMPOSED[name], aval.shape, aval.dtype), arguments)
        if name == "log1p" and aval.dtype == np.float32 and not (self._graph.threads or self._graph.library):
            return self._single_logarithm(aval.shape, arguments)
        if name in _FOR_LANES and self._in_vectors(arguments):
            return self._closed(_jaxpr_of(_FOR_LANES[name], aval.shape, aval.dtype), arguments)
        if name in _ELEMENTWISE:
            return [self._elementwise(lambda *xs: self._operation(name, aval.dtype, *xs), *arguments)]
        if name in _SAME:
            return arguments
        if name in _CALLS:
            inner = _called(equation)
            rule = self._rule(name, inner, arguments)
            operations = (functools.partial(self._graph.operation, operation, kind) for operation in rule)
            results = [self._elementwise(operation, *arguments) for operation in operations]
            return results or self._closed(inner, arguments)
        handler = getattr(self, f"_{name}", None)
        results = None if handler is None else handler(parameters, kind, aval.shape, *arguments)
        if results is None:
            raise _UnsupportedError(equation)
        return results if isinstance(results, list) else [results]

    def _single_logarithm(self, shape: Shape, arguments: list[Array]) -> list[Array]:
        """Logarithm of 1 + x in 32 bits, the same in vectors of them and in programs of 64 bits."""
        if self._graph.single:
            return self._closed(_jaxpr_of(log1p, shape, np.dtype(np.float32)), arguments)
        (logarithm,) = self._closed(_jaxpr_of(log1p, shape, np.dtype(float)), arguments)
        return [self._elementwise(lambda x: self._graph.operation("single", Kind.REAL, x), logarithm)]

    def _operation(self, name: str, dtype: DTypeLike, *arguments: Value) -> Value:
        """Result of an operation, in 32 bits if its type is 32-bit."""
        result = self._graph.operation(name, kind_of(dtype), *arguments)
        if dtype == np.float32 and not self._graph.single:
            return self._graph.operation("single", Kind.REAL, result)
        if dtype == np.uint32 and name in _WRAPPING:
            return self._graph.operation("and", Kind.INTEGER, result, self._graph.constant(MASK, Kind.INTEGER))
        return result

    def _random(self, equation: Equation, arguments: list[Array]) -> list[Array]:
        """Random keys (two words each) and the bits drawn from them."""
        name, parameters = equation.primitive.name, equation.params
        is_single = name == "random_bits" or not equation.outvars[0].aval.ndim
        is_threefry = is_supported() and "fry" in str(parameters.get("impl", "fry"))
        if not is_single or not is_threefry or parameters.get("bit_width", 32) not in (32, 64):
            raise _UnsupportedError(equation)
        if name not in RULES:
            return arguments
        words = equation.invars[0].aval.dtype if name == "random_seed" else np.uint32
        shapes = [jax.ShapeDtypeStruct(x.shape, words) for x in arguments]
        options = {key: parameters[key] for key in ("bit_width", "shape") if key in parameters}
        return self._closed(jax.make_jaxpr(functools.partial(RULES[name], **options))(*shapes), arguments)

    def _rule(self, name: str, inner: Jaxpr, arguments: list[Array]) -> tuple[str, ...]:
        """Operations in place of one of our polynomials; of batches only the exponential, in kernels."""
        if name != "custom_jvp_call":
            return ()
        rule = _RULES.get(str(inner.jaxpr.debug_info.func_name), ())
        if all(map(_is_uniform, arguments)) or (self._graph.threads and rule == _RULES["_exp_rule"]):
            return rule
        return ()  # sine and cosine of CUDA have a branch for large angles

    def _reshape(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Array of another shape; one in memory stays there."""
        return replace(x, shape=tuple(shape)) if isinstance(x, Stored) else x.reshape(shape)

    _squeeze = _expand_dims = _reshape

    def _convert_element_type(self, parameters: Parameters, kind: Kind, shape: Shape, x: Array) -> Array:
        """Number of another type; real numbers of either precision are of one kind, in memory too."""
        if isinstance(x, Stored) and x.kind is kind is Kind.REAL:
            return x
        return super()._convert_element_type(parameters, kind, shape, self.plain(x))

    def _dim_as_value(self, parameters: Parameters, kind: Kind, shape: Shape) -> Array:
        """A length that is an argument of the program."""
        return array_of((), lambda _: self._graph.input(str(parameters["dim"]), Kind.INTEGER))

    def _iota(self, parameters: Parameters, kind: Kind, shape: Shape) -> Array:
        """Numbers that count along an axis."""
        if len(shape) == 1:
            return Stored(tuple(shape), kind)
        return self.literal(jax.lax.broadcasted_iota(parameters["dtype"], shape, parameters["dimension"]))

    # Control flow

    def _cond(self, parameters: Parameters, kind: Kind, shape: Shape, which: Array, *arguments: Array) -> list[Array]:
        """Results of the branch that an index chooses.

        Of two branches one runs; the second of lanes that differ if any takes it, with a selection. Of more, all do.
        """
        index, branches = which.item(), parameters["branches"]
        if index.constant is not None:
            return self._closed(branches[int(index.constant)], arguments)
        if len(branches) == 2:
            condition = self._graph.operation("boolean", Kind.BOOLEAN, index)
            differ = not (index.uniform or self._graph.threads)
            branch_results: list[list[Array]] = []

            def body(number: int) -> list[Value]:
                arrays = [np.asarray(self.plain(array), object) for array in self._closed(branches[number], arguments)]
                branch_results.append(arrays)
                values = [value for array in arrays for value in array.flat]
                if number and differ:
                    select = functools.partial(self._graph.operation, "select")
                    values = [select(x.kind, condition, x, y) for x, y in zip(values, body(0), strict=True)]
                return values

            first = self._graph.operation("any", Kind.BOOLEAN, condition) if differ else condition
            chosen = iter(self._graph.branch(first, [functools.partial(body, number) for number in (1, 0)]))
            return [array_of(array.shape, lambda _: next(chosen)) for array in branch_results[0]]
        cases = [list(map(self.plain, self._closed(branch, arguments))) for branch in branches]
        return [
            self._select_n({}, results[0].flat[0].kind if results[0].size else Kind.REAL, (), which, *results)
            for results in zip(*cases, strict=True)
        ]

    def plain(self, array: Array) -> Array:
        """An array of values, in memory or not."""
        return self.expanded(array) if isinstance(array, Stored) else array

    def _scan(self, parameters: Parameters, kind: Kind, shape: Shape, *arguments: Array) -> list[Array]:
        """Carried values after a loop, and its stacked rows.

        In vectors a carried value is the same in all lanes if its start is and if what follows depends on such values
        alone.
        """
        (count, carries), length = _scan_sizes(parameters), parameters["length"]
        body, reverse = parameters["jaxpr"], parameters["reverse"]
        constants, columns = arguments[:count], arguments[count + carries :]
        carry = [self.plain(array) for array in arguments[count : count + carries]]
        is_constant = isinstance(length, int)
        if is_constant and (length * _equations(body.jaxpr) <= _UNROLLED or length <= 1):
            return self._unrolled(body, length, reverse, constants, carry, list(map(self.plain, columns)))
        columns = [column if isinstance(column, Stored) else self._stored(column) for column in columns]
        inner: list[Array] = []
        varying = [False] * len(carry)
        if self._graph.lanes:
            varying = _varying_carry(body, *([not _is_uniform(x) for x in xs] for xs in (constants, carry, columns)))

        def passes(loop: ForLoop) -> list[list[Value]]:
            for array, varies in zip(carry, varying, strict=True):
                inner.append(self._carried(loop, array, uniform=not varies))
            rows = [self._row(loop, column) for column in columns]
            results = list(map(self.plain, self._closed(body, [*constants, *inner, *rows])))
            following = [value for array in results[:carries] for value in array.flat]
            for carried, value in zip(loop.carried, following, strict=True):
                carried.following = value
            inner.extend(results[carries:])
            return [list(row.flat) for row in results[carries:]]

        loop = self._graph.loop(length, passes, reverse=reverse)
        last = iter([self._graph.after(variable) for variable in loop.carried])
        results = [array_of(array.shape, lambda _: next(last)) for array in carry]
        rows = inner[carries:]
        return results + [
            Stored((length, *row.shape), array.kind, array) for array, row in zip(loop.arrays, rows, strict=True)
        ]

    def _carried(self, loop: ForLoop, array: Array, *, uniform: bool) -> Array:
        """Variables of a loop with the elements of an array as initial values."""
        return array_of(array.shape, lambda at: self._graph.carry(loop, array[at], uniform))

    def _while(self, parameters: Parameters, kind: Kind, shape: Shape, *arguments: Array) -> list[Array] | None:
        """Carried values after a loop that ends on a condition.

        Not for vectors whose lanes end at different iterations; each thread of a kernel ends by itself.
        """
        outside, inside = parameters["cond_nconsts"], parameters["body_nconsts"]
        outer, constants = arguments[:outside], arguments[outside : outside + inside]
        carry = list(map(self.plain, arguments[outside + inside :]))
        varying, ends_apart = [False] * len(carry), False
        if self._graph.lanes:
            kinds = ([not _is_uniform(x) for x in xs] for xs in (outer, constants, carry))
            varying, ends_apart = _varying_while(parameters, *kinds)
            if ends_apart and not self._graph.threads:
                return None
            if ends_apart:
                varying = [True] * len(carry)

        def condition(values: Sequence[Array]) -> Value:
            return self._closed(parameters["cond_jaxpr"], [*outer, *values])[0].item()

        first = condition(carry)

        def passes(loop: ForLoop) -> list[list[Value]]:
            inner = [
                self._carried(loop, array, uniform=not varies) for array, varies in zip(carry, varying, strict=True)
            ]
            results = list(map(self.plain, self._closed(parameters["body_jaxpr"], [*constants, *inner])))
            self._graph.carry(loop, first, not ends_apart)
            loop.going = loop.carried[-1]
            following = [value for array in results for value in array.flat]
            for carried, value in zip(loop.carried, [*following, condition(results)], strict=True):
                carried.following = value
            return []

        last = iter([self._graph.after(variable) for variable in self._graph.loop(0, passes).carried])
        return [array_of(array.shape, lambda _: next(last)) for array in carry]

    def _custom_linear_solve(self, parameters: Parameters, kind: Kind, shape: Shape, *arguments: Array) -> list[Array]:
        """Solution of a linear system by the function that was given for it."""
        counts = parameters["const_lengths"]
        before, end = counts.matvec + counts.vecmat, sum(counts)
        return self._closed(parameters["jaxprs"].solve, [*arguments[before : before + counts.solve], *arguments[end:]])

    def _in_vectors(self, arguments: Sequence[Array]) -> bool:
        """Whether an operation is one of vectors."""
        return not (self._graph.threads or all(map(_is_uniform, arguments)))

    def _stored(self, array: Array) -> Stored:
        """An array with its values in memory."""
        stored, begin = self._graph.array(list(array.reshape(-1)))
        return Stored(array.shape, stored.kind, stored, begin)

    def _row(self, loop: ForLoop, column: Stored) -> Array:
        """The row of an array at the index of a loop."""
        array, shape = column.array, column.shape[1:]
        size = math.prod(shape)
        places = iter(range(column.begin, column.begin + size))
        if array is not None:
            return array_of(shape, lambda _: self._graph.element(array, loop.row, size, next(places), loop.scope))
        operation, integer = self._graph.operation, Kind.INTEGER
        start = operation("mul", integer, loop.row, self._graph.constant(size, integer))

        def number(place: int) -> Value:
            return operation("add", integer, start, self._graph.constant(place, integer))

        return array_of(shape, lambda _: operation(column.kind.value, column.kind, number(next(places))))

    def _unrolled(
        self,
        body: Jaxpr,
        length: int,
        reverse: bool,
        constants: Sequence[Array],
        carry: Sequence[Array],
        columns: Sequence[Array],
    ) -> list[Array]:
        """An unrolled scan."""
        rows = []
        for number in reversed(range(length)) if reverse else range(length):
            here = [np.asarray(column[number], object) for column in columns]
            results = list(map(self.plain, self._closed(body, [*constants, *carry, *here])))
            carry = results[: len(carry)]
            rows.append(results[len(carry) :])
        rows = rows[::-1] if reverse else rows
        return [*carry, *(np.stack(column) for column in zip(*rows, strict=True))]


def _is_uniform(array: Array) -> bool:
    """Whether an array is the same in all lanes."""
    if isinstance(array, Stored):
        return array.array is None or array.array.uniform
    return all(value.uniform for value in array.flat)


@functools.cache
def _jaxpr_of(function: Callable[..., PyTree], shape: tuple[int, ...], dtype: DTypeLike) -> Jaxpr:
    """Jaxpr of a function of an array of a shape and type."""
    return jax.make_jaxpr(function)(jax.ShapeDtypeStruct(shape, dtype))


def _equations(jaxpr: Jaxpr) -> int:
    """Equations of a jaxpr, including nested ones."""
    return sum(1 + sum(map(_equations, _inner(equation))) for equation in jaxpr.eqns)


def _inner(equation: Equation) -> Iterator[Jaxpr]:
    """Jaxprs within an equation."""
    for value in equation.params.values():
        for item in value if isinstance(value, tuple) else (value,):
            inner = getattr(item, "jaxpr", item)
            if hasattr(inner, "eqns"):
                yield inner


def _called(equation: Equation) -> Jaxpr:
    """Jaxpr of the function that an equation calls."""
    parameters = equation.params
    if "_prim" in parameters:
        called = parameters["_prim"]
        shapes = [jax.ShapeDtypeStruct(variable.aval.shape, variable.aval.dtype) for variable in equation.invars]
        return jax.make_jaxpr(lambda *leaves: called.expand(*jax.tree.unflatten(called.in_tree, leaves)))(*shapes)
    return parameters.get("jaxpr") or parameters["call_jaxpr"]


def _source(equation: Equation) -> str:
    """Source location of an equation: file, line and function outside of JAX and Equinox."""
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback is not None else ():
        if "/jax/" not in frame.file_name and "/equinox/" not in frame.file_name:
            return f"{frame.file_name.rpartition('/')[2]}, line {frame.line_num}, in {frame.function_name}"
    return ""


def _varying_carry(
    body: Jaxpr, constants: Sequence[bool], carry: Sequence[bool], columns: Sequence[bool]
) -> list[bool]:
    """Loop-carried variables that vary over lanes, given the constants, initial values and columns that do."""
    carry = list(carry)
    while True:
        results = _varying(body.jaxpr, [*constants, *carry, *columns])[: len(carry)]
        following = [before or after for before, after in zip(carry, results, strict=True)]
        if following == carry:
            return carry
        carry = following


def _varying_while(
    parameters: Parameters, outer: Sequence[bool], constants: Sequence[bool], carry: Sequence[bool]
) -> tuple[list[bool], bool]:
    """Loop-carried variables of a `while` that vary over lanes, and whether its condition does."""
    varying = _varying_carry(parameters["body_jaxpr"], constants, carry, ())
    return varying, _varying(parameters["cond_jaxpr"].jaxpr, [*outer, *varying])[0]


def _scan_sizes(parameters: Parameters) -> tuple[int, int]:
    """Numbers of constants and of carried values of a scan."""
    if "ft_in" in parameters:  # JAX 0.12 and newer
        constants, carry, _ = (len(list(group.vals)) for group in parameters["ft_in"].unpack())
        return constants, carry
    return parameters["num_consts"], parameters["num_carry"]


def _varying(jaxpr: Jaxpr, inputs: Sequence[bool]) -> list[bool]:
    """Results that vary over lanes, given the inputs that do; results of branches and stored rows always vary."""
    varying = dict(zip(jaxpr.invars, inputs, strict=True))

    def read(variable: core.Var | core.Literal) -> bool:
        return not isinstance(variable, core.Literal) and varying.get(variable, False)

    for equation in jaxpr.eqns:
        varies, parameters = list(map(read, equation.invars)), equation.params
        results = [any(varies)] * len(equation.outvars)
        if equation.primitive.name in _CALLS:
            inner = _called(equation)
            results = _varying(getattr(inner, "jaxpr", inner), varies)
        elif equation.primitive.name == "scan":
            begin, carries = _scan_sizes(parameters)
            end = begin + carries
            carry = _varying_carry(parameters["jaxpr"], varies[:begin], varies[begin:end], varies[end:])
            results = carry + [True] * (len(results) - len(carry))
        elif equation.primitive.name == "while":
            begin = parameters["cond_nconsts"]
            end = begin + parameters["body_nconsts"]
            results = _varying_while(parameters, varies[:begin], varies[begin:end], varies[end:])[0]
        elif equation.primitive.name == "cond":
            results = [True] * len(results)
        varying.update(zip(equation.outvars, results, strict=True))
    return list(map(read, jaxpr.outvars))
