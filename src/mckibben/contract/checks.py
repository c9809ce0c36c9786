"""Checks of the contract: units, files, determinism, batches, derivatives, C, and the identities of a base.

Each check has a fault that no other finds:

- units: a number of a file without a unit, or with one that is not SI;
- instance: a class that is abstract or cannot be made;
- file: a field that a file does not hold, so that a run cannot be repeated from it;
- batch: `if` or NumPy functions of traced numbers, or a result that depends on the other samples;
- determinism: random numbers, a clock, or state outside the state;
- derivatives: a `stop_gradient`, rounding, or a root at 0, with which gradients and tuning fail;
- C: an operation that the emitted controller computes differently;
- identities: what a base promises, such as an inverse, see `mckibben.contract.probes`.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Annotated, Any, get_args, get_origin

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jax.flatten_util import ravel_pytree
from numpy.typing import ArrayLike, NDArray

from mckibben.codegen.native import NativeFunction, compiler
from mckibben.component.base import Component, Units, field_hints, field_quantities
from mckibben.component.classes import name_in_files
from mckibben.component.extensions import load_extension
from mckibben.component.schema import ComponentField, declared_fields, parse_component, symbolic_fields, write
from mckibben.config.document import to_text
from mckibben.contract.probes import PERIOD, Identity, Probes, Ranges, plant_scope, probes_of
from mckibben.control.base import DiscreteTimeSystem
from mckibben.control.position_stiffness import AngleDerivativeGain, AngleIntegralGain
from mckibben.errors import CompilerError, ExportError, McKibbenError, ParameterError, printable
from mckibben.numerics.compiled import numeric
from mckibben.result import Remark, Result, TableColumns, column, number, row_columns
from mckibben.units import Angle, AngleGain, AngleScale, BoundedInt, Quantity, factor

UNITS = Units(
    signal=Angle, gain=AngleGain, integral_gain=AngleIntegralGain, derivative_gain=AngleDerivativeGain, scale=AngleScale
)
"""Units of symbolic fields in the file of the round trip: those of a position loop."""

_ROWS = 4  # samples, in addition to the lowest and the middle of the ranges
_STEP = 1e-6  # of a finite difference, relative to range or value
_EQUAL, _SLOPE, _NOISE = 1e-8, 1e-4, 1e-6  # relative tolerances: of values, of derivatives, and of their rounding
_ROUNDING = 1e-14  # of a result that is the difference of others, relative to the largest
_APART = 1e-4  # relative change of the parameters for finite differences, so that equal limits cause no kinks
_ADDRESS = re.compile(r"0x[0-9a-f]+")
# each program runs once or twice: optimising it takes longer than running it
_COMPILER: dict[str, Any] = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}


@dataclass(frozen=True)
class Finding:
    """Result of one check of a class.

    Attributes
    ----------
    kind, check
        Name of the class, and of the check.
    passed
        Whether the class keeps the contract; None if the check could not be run, as without a C compiler.
    found, remedy
        What was found, with the arguments at which, and what to do.
    """

    kind: str = column(title="class")
    check: str = column(title="check")
    passed: bool | None
    found: str = ""
    remedy: str = ""

    @property
    @number(title="result")
    def result(self) -> str:
        """The result in words."""
        return {True: "passed", False: "failed", None: "not checked"}[self.passed]

    @property
    @number(title="reason")
    def reason(self) -> str:
        """The message of the check."""
        return self.found


class ContractReport(Result):
    """Findings of all classes of a module.

    Attributes
    ----------
    module
        Name of the module, or path of the file.
    findings
        Findings in the order of the classes and checks; a failed one is a severe remark.
    """

    heading = "Contract"

    module: str
    findings: tuple[Finding, ...]

    def verdict(self) -> str:
        classes, failed = {finding.kind for finding in self.findings}, sum(f.passed is False for f in self.findings)
        count = f"{len(self.findings)} checks of {len(classes)} classes"
        return f"{failed} of {count} in {self.module} failed" if failed else f"all {count} in {self.module} passed"

    def remarks(self) -> Iterator[Remark]:
        for finding in self.findings:
            if finding.passed is False:
                text = f"{finding.kind}, {finding.check}: {finding.found}"
                yield Remark.severe(finding.check, text, finding.remedy)

    def declared(self) -> TableColumns:
        """Return the findings."""
        return super().declared() | row_columns(Finding, self.findings)


def check_extension(named: str | os.PathLike[str], fields: Mapping[str, str] | None = None) -> list[Finding]:
    """Check the contract of every class of a Python file or module.

    Parameters
    ----------
    named
        Path of a file, which is run, or name of a module.
    fields
        Values of fields as in a file. A class that has none of them is checked on its instances at the top level of the
        module, if there are any.

    Raises
    ------
    ScenarioError
        If the module cannot be run.
    ParameterError
        If it does not define a component, or none has a field.
    """
    module, values = load_extension(named), dict(fields or {})
    kinds = list(_own_classes(module))
    if not kinds:
        remedy = "define a class that derives from a base, such as Valve, Geometry or Controller"
        raise ParameterError(f"{os.fspath(named)} does not define a component", value=os.fspath(named), remedy=remedy)
    field_names = list(dict.fromkeys(name for kind in kinds for name in declared_fields(kind)))
    if unknown := [name for name in values if name not in field_names]:
        remedy = f"known are {', '.join(field_names)}"
        raise ParameterError(f"no class has the field {unknown[0]!r}", value=unknown[0], remedy=remedy)
    findings = []
    for kind in kinds:
        relevant = {name: value for name, value in values.items() if name in declared_fields(kind)}
        instances = [] if relevant else [value for value in vars(module).values() if type(value) is kind]
        findings += check_class(kind, relevant, instances)
    return findings


def _own_classes(module: ModuleType) -> Iterator[type]:
    """Components that a module or its package defines; not abstract bases of its other components."""
    package = module.__name__.partition(".")[0]
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, Component)]
    local = [kind for kind in dict.fromkeys(kinds) if kind.__module__.partition(".")[0] == package]
    for kind in local:
        is_base = inspect.isabstract(kind) and any(issubclass(other, kind) and other is not kind for other in local)
        if not kind.__name__.startswith("_") and not is_base:
            yield kind


def check_class(
    kind: type, fields: Mapping[str, str] | None = None, instances: Sequence[Component] = ()
) -> list[Finding]:
    """Check the contract of a component class; failures of the class are findings, not exceptions.

    Parameters
    ----------
    fields
        Values of fields as in a file, such as ``{"rate": "20 bar/s"}``; others have their defaults, and models of the
        plant are those of the paper's knee.
    instances
        Instances to check in place of one from `fields`.

    Returns
    -------
    list of Finding
        One for each check, the worst of all functions and instances.

    Examples
    --------
    >>> from mckibben.joint import SeriesSpring
    >>> [finding.found for finding in check_class(SeriesSpring) if not finding.passed]
    ['stiffness: is missing; preload: is missing; travel: is missing']
    """
    findings = [_finding(kind, "units", lambda: _check_units(kind))]
    if not instances:
        built: list[Component] = []
        findings.append(_finding(kind, "instance", lambda: built.append(_built(kind, fields or {}))))
        instances = built
    for instance in instances:
        findings += _check_instance(instance)
    worst: dict[str, Finding] = {}
    for finding in findings:
        recorded = worst.setdefault(finding.check, finding)
        if recorded.passed is not False and finding.passed is not True:
            worst[finding.check] = finding
    return list(worst.values())


def _check_instance(component: Component) -> Iterator[Finding]:
    """Findings of a component."""
    kind, probes = type(component), probes_of(component)
    if probes.in_files and probes.functions:
        yield _finding(kind, "file", lambda: _check_file(component))
    if isinstance(component, DiscreteTimeSystem):
        component = component.with_period(PERIOD)
    for function in probes.functions:
        sampled = _Sampled(component, probes, function)
        yield (traced := _finding(kind, "batch", lambda sampled=sampled: sampled.values))
        if traced.passed:
            yield (same := _finding(kind, "determinism", sampled.check_program))
            if same.passed:
                if probes.broadcasts:
                    yield _finding(kind, "batch", sampled.check_broadcast)
                yield _finding(kind, "derivatives", sampled.check_derivatives)
                if probes.emitted:
                    yield _finding(kind, "C", sampled.check_native)
    for identity in probes.identities:
        ranges = probes.ranges(identity.function, component)
        yield _finding(kind, identity.name, lambda i=identity, ranges=ranges: _check_identity(component, i, ranges))


def _finding(kind: type, check: str, function: Callable[[], object]) -> Finding:
    """Finding of a check, which raises where the contract does not hold: all exceptions become findings."""
    finding = Finding(kind.__name__, check, True)
    try:
        function()
    except CompilerError as error:
        return replace(finding, passed=None, found=error.message)
    except jax.errors.ConcretizationTypeError as error:
        remedy = "use jax.numpy: jnp.where in place of `if`, no float() or NumPy function of an argument or a field"
        text = f"uses the value of a traced number{_place(error, kind)}"
        return replace(finding, passed=False, found=text, remedy=remedy)
    except McKibbenError as error:
        return replace(finding, passed=False, found=printable(error.message), remedy=error.remedy)
    except Exception as error:
        text = next(iter(str(error).splitlines()), "")
        text = f"{type(error).__name__}: {text}{_place(error, kind)}"
        return replace(finding, passed=False, found=printable(text))
    return finding


def _place(error: BaseException, kind: type) -> str:
    """Line of the class's module in which an error was raised."""
    lines = [
        f" (line {line}, {frame.f_code.co_name})"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__") == kind.__module__
    ]
    return lines[-1] if lines else ""


def _base_of(kind: type) -> type:
    """Base class of a component: the one that derives from `Component` directly."""
    return next((base for base in kind.__mro__ if Component in base.__bases__), kind)


def _built(kind: type, fields: Mapping[str, str]) -> Component:
    """Component as a file with some of its fields gives it; `ParameterError` names what is missing."""
    if inspect.isabstract(kind):
        missing = ", ".join(sorted(getattr(kind, "__abstractmethods__", ())))
        raise ParameterError(f"it lacks {missing}", remedy="implement the abstract methods and fields of the base")
    try:
        section = {"class": name_in_files(_base_of(kind), kind), **fields}
        return _read(kind, "it:\n" + "".join(f"  {name}: {value}\n" for name, value in section.items()))
    except McKibbenError as error:
        problems = getattr(error, "problems", ())
        text = "; ".join(f"{item.field}: {item.message}".lstrip(": ") for item in problems) or error.message
        remedy = "define an instance in the module, or give fields: --with 'NAME=VALUE'"
        raise ParameterError(text, remedy=remedy) from error


def _read(kind: type, text: str) -> Component:
    """Component under the key `it` of a file, in the plant of `plant_scope`."""
    context = {"scope": (plant_scope(),)}
    return parse_component(_base_of(kind), text, source=kind.__name__, key="it", context=context, units=UNITS)


def _check_units(kind: type) -> None:
    """Each number of a file has a unit in SI."""
    hints, marks, symbolic = field_hints(kind), field_quantities(kind), symbolic_fields(kind)
    for name in declared_fields(kind):
        if name not in hints:
            raise ParameterError(f"the type of {name} is not found", remedy="import it at the top of the module")
        mark = marks.get(name) or kind.unit_of(name)  # type: ignore[attr-defined]
        if mark is None and _has_bare_float(hints[name]):
            remedy = "use a type of mckibben.units, or Annotated[float, Quantity('N*s/m', lower=0, upper=1e3)]"
            raise ParameterError(f"{name} has no unit", remedy=remedy)
        if mark is not None and name not in symbolic and not np.isclose(factor(mark.unit), 1.0, rtol=1e-12, atol=0):
            remedy = f"fields are in SI: Quantity('SI unit', '{mark.unit}')"
            raise ParameterError(f"{name} is in {mark.unit}", remedy=remedy)


def _has_bare_float(hint: object) -> bool:
    """Whether a type contains a float without a unit."""
    if get_origin(hint) is Annotated and any(isinstance(mark, Quantity | BoundedInt) for mark in get_args(hint)[1:]):
        return False
    return hint is float or any(_has_bare_float(argument) for argument in get_args(hint))


def _check_file(component: Component) -> None:
    """A component that is written to a file and read again is the same."""
    kind = type(component)
    back = _read(kind, to_text({"it": write(component, ComponentField(_base_of(kind), UNITS))}))
    if type(back) is not kind:
        raise ParameterError(f"a file gives a {type(back).__name__}", remedy="give the class another `short_name`")
    for name in declared_fields(kind):
        before, after = getattr(component, name), getattr(back, name)
        if not _is_same(before, after):
            text = f"{name} is {_short(before)} in Python and {_short(after)} after a file"
            remedy = "give it a type of files: a quantity, Flag, word, path, component, or a tuple of these"
            raise ParameterError(text, remedy=remedy)


def _short(value: object) -> str:
    return printable(" ".join(repr(value).split()), 60)


def _is_same(before: object, after: object) -> bool:
    """Whether two values of a field are equal, number by number."""
    (leaves, structure), (others, other) = (jax.tree.flatten(numeric(value)) for value in (before, after))
    return structure == other and all(np.array_equal(*pair) for pair in zip(leaves, others, strict=True))


def _samples(ranges: Ranges) -> NDArray[np.float64]:
    """Arguments, shape (samples, arguments): random ones, then the lowest and the middle of each range."""
    low, high = np.array(list(ranges.values())).T
    random = np.random.default_rng(0).uniform(low, high, (_ROWS, len(low)))
    return np.concatenate([random, [low, (low + high) / 2]])


class _Sampled:
    """A function of a component as one of a vector, of its arguments and then of its parameters, and its values.

    One compiled program evaluates all points: the samples, `_ROWS` of them with parameters apart from each other, and
    both sides of these along each number, for finite differences.

    Attributes
    ----------
    names
        Names of the numbers: arguments, then parameters.
    points
        Samples, shape (samples, numbers).
    scales
        Size of each number, by which it is varied: the range of an argument, the value of a parameter.
    """

    def __init__(self, component: Component, probes: Probes, function: Callable[..., Any]) -> None:
        self.component, self.probes, self.function = component, probes, function
        self.ranges = probes.ranges(function, component)
        parameters, self._static = eqx.partition(numeric(component), _is_parameter)
        vector, self._restore = ravel_pytree(parameters)
        values, leaves = np.asarray(vector, float), jax.tree_util.tree_leaves_with_path(parameters)
        names = [jax.tree_util.keystr(path).lstrip(".") for path, leaf in leaves for _ in range(np.size(leaf))]
        self.names = [*self.ranges, *names]
        self.arguments = _samples(self.ranges)
        self.points = np.concatenate([self.arguments, np.tile(values, (len(self.arguments), 1))], axis=1)
        self.scales = np.concatenate([[high - low for low, high in self.ranges.values()], np.abs(values)])
        self.moving = np.flatnonzero(self.scales)
        moves = np.eye(len(self.scales))[self.moving] * self.scales[self.moving, None]  # (directions, numbers)
        apart = np.random.default_rng(1).uniform(1 - _APART, 1 + _APART, (_ROWS, len(values)))
        self._middle = self.points[:_ROWS] * np.concatenate([np.ones_like(self.arguments[:_ROWS]), apart], axis=1)
        sides = [self._middle[:, None] + sign * _STEP * moves for sign in (1, -1)]
        self._points = np.concatenate([self.points, self._middle, *(x.reshape(-1, len(self.scales)) for x in sides)])

    def __call__(self, point: Array) -> Array:
        """Results, flat."""
        count = len(self.ranges)
        component = eqx.combine(self._restore(point[count:]), self._static)
        results = self.function(component, *(point[i] for i in range(count)))
        return jnp.concatenate([jnp.ravel(jnp.asarray(leaf, float)) for leaf in jax.tree.leaves(results)])

    def _trace(self) -> ClosedJaxpr:
        return jax.make_jaxpr(lambda point: self(point))(self.points[0])

    @functools.cached_property
    def _single(self) -> ClosedJaxpr:
        """The evaluation of a sample as it is traced first; batches and derivatives are made of it."""
        return self._trace()

    def _traced(self, point: Array) -> Array:
        return jaxpr_as_fun(self._single)(point)[0]

    @functools.cached_property
    def _program(self) -> Any:
        return _compiled(jax.vmap(self._traced), self._points)

    @functools.cached_property
    def _computed(self) -> NDArray[np.float64]:
        """Results of the samples and around them, shape (points, results), by one program."""
        return np.asarray(self._program(self._points))

    @property
    def values(self) -> NDArray[np.float64]:
        """Results of all samples, shape (samples, results)."""
        return self._computed[: len(self.points)]

    def check_program(self) -> None:
        """The same arguments give the same program and the same results."""
        same = np.array_equal(self._computed, self._program(self._points), equal_nan=True)
        if not same or _text(self._single) != _text(self._trace()):
            remedy = "use no random numbers, clock or counters outside the state: draw by a seed from the state"
            raise ParameterError("two evaluations with the same arguments differ", remedy=remedy)

    def check_broadcast(self) -> None:
        """An array of arguments gives the results of single samples."""
        leaves = jax.tree.leaves(self.function(self.component, *map(jnp.asarray, self.arguments.T)))
        if any(np.shape(leaf) != (len(self.arguments),) for leaf in leaves):
            raise ParameterError("an array of arguments does not give an array of results", remedy="use jax.numpy")
        if (pair := _difference(self.values, np.stack(leaves, axis=1), self.values)) is not None:
            text = f"the result of an array of arguments is {pair[1]:.6g}, that of a single evaluation {pair[0]:.6g}"
            raise ParameterError(text, remedy="the result must not depend on other samples or on their number")

    def _where(self, row: int) -> str:
        pairs = zip(self.ranges, np.concatenate([self.points, self._middle])[row], strict=False)
        return ", ".join(f"{name} {value:.4g}" for name, value in pairs)

    def check_derivatives(self) -> None:
        """Derivatives are finite and agree with finite differences; at a kink they lie between those of its sides.

        Relative to the larger slope of both sides, they may differ by 1e-4, and by the rounding of the differences.
        """
        values, moving = self.values, self.moving
        for row in np.flatnonzero(np.isnan(values).any(axis=1)).tolist():
            text = f"the result is not a number at {self._where(row)}"
            raise ParameterError(text, remedy="give a number in the whole range")
        points = np.concatenate([self.points, self._middle])
        try:
            jacobians = self._in_reverse(points)
        except ValueError:  # a loop that ends on a condition supports forward mode only
            jacobians = _compiled(jax.vmap(jax.jacfwd(self._traced)), points)(points)
        slopes = (np.asarray(jacobians)[..., moving] * self.scales[moving]).swapaxes(
            1, 2
        )  # (points, directions, results)
        bad = (np.isfinite(self._computed[: len(points), None]) & ~np.isfinite(slopes)).any(axis=2)
        for row, direction in np.argwhere(bad).tolist():
            text = f"the derivative with respect to {self.names[moving[direction]]} is not finite at {self._where(row)}"
            remedy = "keep arguments off the edge: jnp.sqrt(jnp.where(x > 0, x, 1.0)) within jnp.where(x > 0, ..., 0.0)"
            raise ParameterError(text, remedy=remedy)
        slopes, here = slopes[-_ROWS:], self._computed[len(self.points) :][:_ROWS, None]
        above, below = self._computed[len(self.points) + _ROWS :].reshape(2, *slopes.shape)
        with np.errstate(invalid="ignore"):
            sides = np.sort([(above - here) / _STEP, (here - below) / _STEP], axis=0)
            sizes = np.abs([*sides, slopes]).max(axis=0)
            allowed = _SLOPE * sizes + _NOISE * _sizes(values, _ROUNDING / _STEP / _NOISE)
            wrong = (slopes < sides[0] - allowed) | (slopes > sides[1] + allowed)
        for row, direction, result in np.argwhere(wrong & np.isfinite(here)).tolist():
            scale = self.scales[moving[direction]]
            slope, difference = slopes[row, direction, result], sides[:, row, direction, result].mean()
            text = (
                f"the derivative with respect to {self.names[moving[direction]]} is {slope / scale:.4g}, "
                f"finite differences give {difference / scale:.4g} at {self._where(row)}"
            )
            remedy = "use operations of jax.numpy that have derivatives, no stop_gradient or rounding"
            raise ParameterError(text, remedy=remedy)

    def _in_reverse(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Jacobians by reverse mode, shape (points, results, numbers), in C: it compiles five times as fast as XLA."""
        pulled = NativeFunction(lambda x, _: jax.vjp(self._traced, x[0])[1](x[1])[0], ("-O0",))
        try:
            rows = [[pulled((point, unit)) for unit in np.eye(self.values.shape[1])] for point in points]
            return np.reshape(rows, (len(points), -1, len(self.scales)))
        except ExportError:
            return _compiled(jax.vmap(jax.jacrev(self._traced)), points)(points)

    def check_native(self) -> None:
        """The emitted C, which evaluates samples one by one, gives the results of JAX."""
        if compiler() is None:
            raise CompilerError("there is no C compiler")
        rows = [_flat(_NATIVE((self.function, numeric(self.component), *row))) for row in self.arguments]
        if (pair := _difference(np.array(rows), self.values, self.values)) is not None:
            text = f"emitted C gives {pair[0]:.6g}, JAX {pair[1]:.6g}"
            raise ParameterError(text, remedy="report it, with the class")


def _text(program: ClosedJaxpr) -> tuple[str | bytes, ...]:
    """Equations of a traced function, and its constants."""
    return _ADDRESS.sub("", str(program.jaxpr)), *(np.asarray(constant).tobytes() for constant in program.consts)


def _compiled(function: Callable[[Any], Any], points: NDArray[np.float64]) -> Callable[[NDArray[np.float64]], Any]:
    """Program of a function for arrays of one shape."""
    return jax.jit(function).lower(points).compile(compiler_options=_COMPILER)


def _apply(shared: tuple[Any, ...], _: object) -> Any:
    function, component, *arguments = shared
    return function(component, *arguments)


_NATIVE = NativeFunction(_apply)


def _is_parameter(leaf: object) -> bool:
    """Whether a leaf has finite real numbers, by which to differentiate."""
    return isinstance(leaf, np.ndarray | jax.Array) and leaf.dtype.kind == "f" and bool(np.all(np.isfinite(leaf)))


def _sizes(values: NDArray[np.float64], rounding: float) -> NDArray[np.float64]:
    """Size of each result over all samples, and at least a small part of the largest."""
    sizes = np.where(np.isfinite(values), np.abs(values), 0.0).max(axis=0)
    return np.maximum(sizes, rounding * sizes.max(initial=0.0))


def _difference(results: ArrayLike, others: ArrayLike, values: NDArray[np.float64]) -> tuple[float, float] | None:
    """First two results that differ by more than rounding, 1e-8 of the largest of all `values`; None if none do."""
    results, others = np.broadcast_arrays(np.asarray(results, float), np.asarray(others, float))
    allowed = _EQUAL * _sizes(values, _ROUNDING / _EQUAL)
    wrong = ~np.isclose(results, others, rtol=_EQUAL, atol=allowed, equal_nan=True)
    return (float(results[wrong][0]), float(others[wrong][0])) if wrong.any() else None


def _check_identity(component: Component, identity: Identity, ranges: Ranges) -> None:
    """Both results of an identity are equal."""
    rows = _samples(ranges)
    pairs = [identity.function(component, *map(jnp.asarray, row)) for row in rows]
    results, expected = (np.array([_flat(pair[side]) for pair in pairs]) for side in (0, 1))
    for row, result, other in zip(rows, results, expected, strict=True):
        if (pair := _difference(result, other, expected)) is not None:
            where = ", ".join(f"{name} {value:.4g}" for name, value in zip(ranges, row, strict=True))
            raise ParameterError(f"{pair[0]:.6g} instead of {pair[1]:.6g} at {where}", remedy=identity.remedy)


def _flat(tree: object) -> NDArray[np.float64]:
    return np.concatenate([np.empty(0), *(np.ravel(np.asarray(leaf, float)) for leaf in jax.tree.leaves(tree))])
