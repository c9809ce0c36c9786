"""Scalar expressions in nested scopes: the intermediate representation between a jaxpr and program text.

An expression is placed in the outermost scope that contains all of its arguments: loop invariants are hoisted, and
values that depend on parameters alone are computed once. Equal expressions are merged.
"""

from __future__ import annotations

import enum
import math
import operator
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mckibben.errors import ExportError


class Kind(enum.Enum):
    """Type of a scalar."""

    REAL = "real"
    INTEGER = "integer"
    BOOLEAN = "boolean"


@dataclass(eq=False, repr=False, slots=True)
class Value:
    """A scalar: a constant, an input, a carried variable of a loop, an element of an array, or an operation.

    Values are compared by identity: equal expressions of a graph are one object.

    Attributes
    ----------
    operation
        Name of the operation in `FOLDED`, or ``select``, ``constant``, ``input``, ``carried``, ``element``, ``index``
        or ``chosen``.
    scope
        The block that computes it.
    data
        Number of a constant, name of an input, `Carried`, `Element`, or a `Branch` and a place.
    uniform
        Whether it is the same in all lanes of a batched program.
    """

    operation: str
    kind: Kind
    arguments: tuple[Value, ...]
    scope: Scope
    data: Any = None
    uniform: bool = True

    @property
    def constant(self) -> Any:
        """Its number, if known."""
        return self.data if self.operation == "constant" else None


@dataclass(eq=False, repr=False, slots=True)
class Scope:
    """A block of statements.

    Attributes
    ----------
    shared
        Values of this block by what they compute, so that none is computed twice.
    floor
        The innermost branch around the block, beyond which nothing is hoisted.
    """

    parent: Scope | None = None
    statements: list[Value | ForLoop | Branch | StoredArray] = field(default_factory=list)
    shared: dict[object, Value] = field(default_factory=dict)
    depth: int = 0
    floor: Scope | None = None

    def inner(self, *, branch: bool = False) -> Scope:
        """A new block inside."""
        scope = Scope(self, depth=self.depth + 1, floor=self.floor)
        if branch:
            scope.floor = scope
        return scope


@dataclass(eq=False, repr=False, slots=True)
class Carried:
    """A variable of a loop: its value before the first iteration, and after each."""

    loop: ForLoop
    initial: Value
    following: Any = None  # its value after an iteration
    uniform: bool = True


@dataclass(eq=False, repr=False, slots=True)
class ForLoop:
    """A loop.

    Attributes
    ----------
    length, index
        Number of iterations, and the count of them.
    row
        Row of its arrays: the index, or counted from the last.
    arrays
        Arrays that receive one row per iteration.
    going
        Condition for a further iteration, in place of a fixed number.
    """

    scope: Scope
    length: int
    index: Value
    row: Any = None
    carried: list[Carried] = field(default_factory=list)
    arrays: list[StoredArray] = field(default_factory=list)
    going: Carried | None = None


@dataclass(eq=False, repr=False, slots=True)
class Branch:
    """Two blocks, one of which runs.

    Text runs one of them, `export.evaluation` computes both and selects. Vectors whose lanes differ have no branch.
    """

    condition: Value
    scopes: tuple[Scope, Scope]
    values: tuple[list[Value], list[Value]]  # if the condition holds, and if not
    chosen: list[Value] = field(default_factory=list)  # their data are the branch and the position in `values`


@dataclass(eq=False, repr=False, slots=True)
class StoredArray:
    """Array in memory that a loop can index: constants, an input, or rows stored by a loop.

    The array of a loop has `size` elements in rows of ``len(elements)``, one row per iteration.
    """

    kind: Kind
    size: int
    elements: list[Value]  # all, none for an input, or the elements of one row
    loop: ForLoop | None = None
    name: str = ""  # of an input
    uniform: bool = True

    @property
    def constant(self) -> bool:
        """Whether all elements are known numbers."""
        listed = self.loop is None and not self.name
        return listed and all(element.operation == "constant" for element in self.elements)


@dataclass(frozen=True, slots=True)
class Element:
    """Position in an array: row (the argument of its value) times stride plus offset."""

    array: StoredArray
    stride: int
    offset: int


def count_operations(scope: Scope) -> Counter[str]:
    """Operations of a block by name, at most: each loop to its end, and of two branches the longer one.

    Raises `ExportError` for a loop without a known length.
    """
    counts: Counter[str] = Counter()
    for statement in scope.statements:
        if isinstance(statement, ForLoop):
            if statement.going is not None:
                raise ExportError("a loop has no largest number of iterations", remedy="use one with a fixed number")
            inner = count_operations(statement.scope)
            counts.update({name: statement.length * number for name, number in inner.items()})
        elif isinstance(statement, Branch):
            counts.update(max(map(count_operations, statement.scopes), key=Counter.total))
        elif isinstance(statement, Value) and statement.operation in {"select", *FOLDED}:
            counts[statement.operation] += 1
    return counts


FOLDED: dict[str, Callable[..., Any]] = {
    **{
        name: getattr(operator, name)
        for name in ("add", "sub", "mul", "neg", "lt", "le", "gt", "ge", "eq", "ne", "xor")
    },
    **{name: getattr(operator, f"{name}_") for name in ("and", "or", "not")},
    **{
        name: getattr(np, name)
        for name in (
            *("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh"),
            *("cosh", "tanh", "pow", "floor", "ceil", "cbrt", "sign"),
        )
    },
    "div": np.divide,
    "max": np.maximum,
    "min": np.minimum,
    "abs": abs,
    "round": np.rint,
    "rem": np.fmod,
    "shift_left": operator.lshift,
    "shift_right": operator.rshift,
    "shift_word": operator.rshift,
    "is_finite": np.isfinite,
    "bits": lambda x: np.float64(x).view(np.int64),
    "from_bits": lambda x: np.int64(x).view(np.float64),
    "from_bits_32": lambda x: np.uint32(x & 0xFFFFFFFF).view(np.float32),
    "single": np.float32,
    "real": lambda x: x,
    "integer": int,
    "boolean": bool,
}
"""Operations by name, evaluated on known numbers; only `select` (condition and two values) is missing.

`bits` are the bits of a real number as an integer, `from_bits` the inverse; `single` is the nearest 32-bit number.
"""


class Graph:
    """Statements in scopes; `scope` is the current one.

    Equal operations on equal arguments are one value. Operations on known numbers, and neutral ones, are folded.

    Parameters
    ----------
    lanes
        Whether the program is batched.
    single
        Whether values that differ between runs have 32 bits.
    threads
        Whether each run of a batch is a thread, instead of an element of a vector.
    reciprocals
        Whether divisors known further out become factors, computed there.
    library
        Whether functions are those of the language, which has no bits of real numbers.
    most
        Largest number of operations; `ExportError` for more.

    Examples
    --------
    >>> graph = Graph()
    >>> x, two = graph.input("x", Kind.REAL), graph.constant(2.0, Kind.REAL)
    >>> graph.operation("mul", Kind.REAL, x, two) is graph.operation("mul", Kind.REAL, x, two)
    True
    >>> graph.operation("pow", Kind.REAL, two, two).constant
    4.0
    """

    def __init__(
        self,
        *,
        lanes: bool = False,
        single: bool = False,
        threads: bool = False,
        reciprocals: bool = False,
        library: bool = False,
        most: float = math.inf,
    ) -> None:
        self.root = Scope()
        self.scope = self.root
        self.lanes = lanes
        self.threads = threads
        self.single = single
        self.reciprocals = reciprocals
        self.library = library
        self._room = most  # for more operations
        self._alive: list[Value] = []  # expressions are distinguished by the identities of values

    def constant(self, number: float, kind: Kind) -> Value:
        """A known number."""
        number = {Kind.REAL: float, Kind.INTEGER: int, Kind.BOOLEAN: bool}[kind](number)
        if kind is Kind.INTEGER:
            number = (number + 2**63) % 2**64 - 2**63  # 64 bits
        key = ("constant", kind, repr(number))
        if key not in self.root.shared:
            self.root.shared[key] = Value("constant", kind, (), self.root, number)
        return self.root.shared[key]

    def input(self, name: str, kind: Kind, *, uniform: bool = True) -> Value:
        """A named input of the current scope."""
        return self._shared(("input", name), self.scope, lambda: Value("input", kind, (), self.scope, name, uniform))

    def operation(self, name: str, kind: Kind, *arguments: Value) -> Value:
        """Result of an operation: a new value in the outermost scope that has all arguments, or a known one.

        Parameters
        ----------
        name
            Name of the operation, a key of `FOLDED` or ``select``.
        kind
            Kind of the result.
        """
        name, arguments = self._plain(name, arguments)
        if (simple := self._simplified(name, kind, arguments)) is not None:
            return simple
        if self.reciprocals and name == "div" and kind is Kind.REAL:
            numerator, divisor = arguments
            number = numerator.constant or 1.0
            if divisor.scope.depth < numerator.scope.depth or (number != 1.0 and abs(math.frexp(number)[0]) == 0.5):
                reciprocal = self.operation("div", kind, self.constant(1.0, kind), divisor)
                return self.operation("mul", kind, numerator, reciprocal)
        scope = self._place(arguments)
        key = (name, kind, *map(id, arguments))
        uniform = name == "any" or all(argument.uniform for argument in arguments)
        return self._shared(key, scope, lambda: Value(name, kind, arguments, scope, None, uniform))

    def _plain(self, name: str, arguments: tuple[Value, ...]) -> tuple[str, tuple[Value, ...]]:
        """The operation without orders of booleans and complements of integers, which languages write differently."""
        kind = arguments[0].kind
        if name == "not" and kind is Kind.INTEGER:
            return "sub", (self.constant(-1, kind), *arguments)
        if kind is Kind.BOOLEAN and name in ("lt", "le", "gt", "ge"):
            arguments = tuple(self.operation("integer", Kind.INTEGER, x) for x in arguments)
        return {"max": "or", "min": "and"}.get(name, name) if kind is Kind.BOOLEAN else name, arguments

    def _place(self, arguments: Sequence[Value]) -> Scope:
        """The outermost scope that contains all arguments, within the innermost branch."""
        scopes = [argument.scope for argument in arguments]
        if self.scope.floor is not None:
            scopes.append(self.scope.floor)
        return max(scopes, key=lambda scope: scope.depth)

    def element(self, array: StoredArray, row: Value | None, stride: int, offset: int, scope: Scope) -> Value:
        """An element of an array.

        Parameters
        ----------
        row, stride, offset
            It stands at ``row * stride + offset``; without a row at `offset`.
        scope
            The scope that reads it.
        """
        place = Element(array, stride, offset)
        arguments = () if row is None else (row,)
        key = ("element", place, *map(id, arguments))
        return self._shared(key, scope, lambda: Value("element", array.kind, arguments, scope, place, array.uniform))

    def _shared(self, key: object, scope: Scope, make: Callable[[], Value]) -> Value:
        """The value of a key in a scope or an enclosing one; created and added to its statements if missing."""
        outer: Scope | None = scope
        while outer is not None:
            if key in outer.shared:
                return outer.shared[key]
            outer = outer.parent
        self._room -= 1
        if self._room < 0:
            raise ExportError("a program of too many operations")
        scope.shared[key] = value = make()
        scope.statements.append(value)
        return value

    def _simplified(self, name: str, kind: Kind, arguments: tuple[Value, ...]) -> Value | None:
        """A constant or one of the arguments, if the operation reduces to it."""
        constants = [argument.constant for argument in arguments]
        if name == "select":
            _, yes, no = arguments
            if yes is no:
                return yes
            return None if constants[0] is None else yes if constants[0] else no
        if all(number is not None for number in constants) and name in FOLDED:
            with np.errstate(all="ignore"):
                return self.constant(FOLDED[name](*constants), kind)
        first = arguments[0]
        if name in ("real", "integer", "boolean"):
            return first if first.kind is kind else None
        if name in ("and", "or") and kind is Kind.BOOLEAN:
            for number, other in ((constants[0], arguments[1]), (constants[1], first)):
                if number is not None:
                    return other if number is (name == "and") else self.constant(number, kind)
        neutral = {"add": 0, "sub": 0, "mul": 1, "div": 1}.get(name)
        if neutral is None:
            return None
        if constants[1] == neutral:
            return first
        return arguments[1] if constants[0] == neutral and name in ("add", "mul") else None

    def power(self, x: Value, exponent: int) -> Value:
        """Integer power by squaring: 2 log2(n) multiplications at most, of the reciprocal for a negative one.

        >>> graph = Graph()
        >>> float(graph.power(graph.constant(2.0, Kind.REAL), -3).constant)
        0.125
        """
        if exponent < 0:
            return self.power(self.operation("div", x.kind, self.constant(1.0, x.kind), x), -exponent)
        result, square, bits = self.constant(1.0, x.kind), x, exponent
        while bits:
            if bits & 1:
                result = self.operation("mul", x.kind, result, square)
            bits >>= 1
            square = self.operation("mul", x.kind, square, square) if bits else square
        return result

    def array(self, elements: Sequence[Value]) -> tuple[StoredArray, int]:
        """An array with these elements, and the position of the first.

        Elements that follow each other in an array already are found there; others make a new one.
        """
        first = elements[0]
        if first.operation == "element" and not first.arguments:
            array, begin = first.data.array, first.data.offset
            places = [Element(array, 0, begin + place) for place in range(len(elements))]
            if all(value.operation == "element" for value in elements) and [v.data for v in elements] == places:
                return array, begin
        uniform = all(value.uniform for value in elements)
        array = StoredArray(first.kind, len(elements), list(elements), uniform=uniform)
        self.scope.statements.append(array)
        return array, 0

    def loop(
        self, length: int, body: Callable[[ForLoop], Sequence[Sequence[Value]]], *, reverse: bool = False
    ) -> ForLoop:
        """Loop of a length, from the last row to the first if `reverse`.

        Parameters
        ----------
        body
            Makes the statements of an iteration in the scope of the loop that it gets, and returns the rows of the
            arrays to store.
        """
        outer, inside = self.scope, self.scope.inner()
        loop = ForLoop(inside, length, Value("index", Kind.INTEGER, (), inside))
        self.scope = inside
        row = loop.index
        if reverse:
            row = self.operation("sub", Kind.INTEGER, self.constant(length - 1, Kind.INTEGER), row)
        loop.row = row
        rows = body(loop)
        self.scope = outer
        loop.arrays = [
            StoredArray(row[0].kind, length * len(row), list(row), loop, uniform=not self.lanes) for row in rows
        ]
        outer.statements.append(loop)
        return loop

    def carry(self, loop: ForLoop, initial: Value, uniform: bool = True) -> Value:
        """A loop variable, as seen by the body."""
        loop.carried.append(Carried(loop, initial, uniform=uniform))
        return Value("carried", initial.kind, (), loop.scope, loop.carried[-1], uniform)

    def after(self, carried: Carried) -> Value:
        """The final value of a loop variable, in the enclosing scope."""
        value = Value("carried", carried.initial.kind, (), self.scope, carried, carried.uniform)
        self._alive.append(value)
        return value

    def branch(self, condition: Value, bodies: Sequence[Callable[[], Sequence[Value]]]) -> list[Value]:
        """Values of the first body if a condition holds, else of the second; each has its own scope.

        Both bodies return as many values, of the same kinds.
        """
        outer, scopes, values = self.scope, [], []
        for body in bodies:
            self.scope = outer.inner(branch=True)
            scopes.append(self.scope)
            values.append(list(body()))
        self.scope = outer
        branch = Branch(condition, (scopes[0], scopes[1]), (values[0], values[1]))
        outer.statements.append(branch)
        results = []
        for place, (yes, no) in enumerate(zip(*values, strict=True)):
            if yes is not no:
                branch.chosen.append(Value("chosen", yes.kind, (), outer, (branch, place), not self.lanes))
            results.append(yes if yes is no else branch.chosen[-1])
        return results


def needed(results: Sequence[Value | StoredArray]) -> set[int]:
    """Identities of the values, loops, branches and arrays that results depend on.

    A loop counts only with those of its variables and arrays that something uses: the others are not written.
    """
    reached: set[int] = set()
    waiting: list[Any] = list(results)
    while waiting:
        node = waiting.pop()
        if id(node) in reached:
            continue
        reached.add(id(node))
        if isinstance(node, ForLoop):
            if node.going is not None:
                reached.add(id(node.going))
                waiting += [node.going.initial, node.going.following]
            continue
        if isinstance(node, StoredArray):
            waiting += node.elements if node.loop is None else [*node.elements, node.loop, node.loop.row]
            continue
        waiting += node.arguments
        if node.operation == "carried":
            reached.add(id(node.data))
            waiting += [node.data.initial, node.data.following, node.data.loop]
        elif node.operation == "element":
            waiting.append(node.data.array)
        elif node.operation == "chosen":
            branch, place = node.data
            reached.add(id(branch))
            waiting += [branch.condition, branch.values[0][place], branch.values[1][place]]
    return reached
