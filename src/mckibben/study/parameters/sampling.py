"""Swept parameters, their text form, for example `load.mass2=0.2 kg..1.0 kg`, and tables of their values."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray
from pydantic_core import PydanticCustomError

from mckibben.config.fields import Quantity, quoted
from mckibben.errors import ParameterError
from mckibben.study.parameters.distributions import (
    MOST,
    Distribution,
    IntegerRange,
    LogUniform,
    Normal,
    Uniform,
    Values,
)
from mckibben.study.parameters.parameter import ScenarioParameter, find_parameter, find_parameters
from mckibben.study.scenario import Scenario


@dataclass(frozen=True)
class SweptParameter:
    """A number and its spread, which go together: values lie in the field's range, and are whole where they must be.

    Raises
    ------
    ParameterError
        If they do not go together.
    """

    parameter: ScenarioParameter
    distribution: Distribution

    def __post_init__(self) -> None:
        address, spread = self.parameter, _of_its_kind(self.parameter, self.distribution)
        object.__setattr__(self, "distribution", spread)
        for end in spread.ends:
            if not address.holds(end):
                raise ParameterError(
                    f"{address.name} reaches {address.show(end)}, which is outside {address.range}",
                    value=end,
                    lower=address.lower,
                    upper=address.upper,
                    unit=address.unit,
                    remedy="choose values inside",
                )

    @property
    def name(self) -> str:
        """The canonical name of the number."""
        return self.parameter.name

    @property
    def text(self) -> str:
        """What `parse_sweep` reads back to the last bit; of a `Normal` the deviation alone is written.

        >>> from mckibben.study.parameters import parse_sweep
        >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
        >>> parse_sweep("load.m2 = 200 g..1.0 kg in 9", scenario).text
        'load.mass2=0.2 kg..1 kg in 9'
        """
        write, spread = self.parameter.write, self.distribution
        match spread:
            case Uniform() | LogUniform():
                log = " log" if isinstance(spread, LogUniform) else ""
                points = "" if spread.points is None else f" in {spread.points}"
                said = f"{write(spread.low)}..{write(spread.high)}{log}{points}"
            case IntegerRange():
                said = f"{spread.low}..{spread.high}"
            case Values():
                said = ", ".join(write(value) for value in spread.values)
            case Normal():
                said = f"normal {write(spread.deviation)}"
            case _:
                said = repr(spread)
        return f"{self.name}={said}"


def sweep_parameters(scenario: Scenario, spreads: Mapping[str, Distribution]) -> tuple[SweptParameter, ...]:
    """What a study varies, said in Python.

    Parameters
    ----------
    scenario
        Whose numbers they are.
    spreads
        By name; values in SI.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, or a spread is none for its number.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> [each.text for each in sweep_parameters(scenario, {"load.m2": Uniform(0.2, 1.0)})]
    ['load.mass2=0.2 kg..1 kg']
    """
    found = find_parameters(scenario, spreads)
    return tuple(SweptParameter(address, spread) for address, spread in zip(found, spreads.values(), strict=True))


def _of_its_kind(address: ScenarioParameter, spread: Distribution) -> Distribution:
    """The spread with whole numbers where they must be, and cut off at what the field may be."""
    if isinstance(spread, IntegerRange) and not address.whole:
        raise ParameterError(f"{address.name} is no whole number", remedy="give a Uniform range or Values")
    if isinstance(spread, Values) and not address.whole:
        return Values(tuple(float(value) for value in spread.values))
    if isinstance(spread, Values) and all(float(value).is_integer() for value in spread.values):
        return Values(tuple(int(value) for value in spread.values))
    if address.whole and not isinstance(spread, IntegerRange):
        raise ParameterError(f"{address.name} is a whole number", remedy="give some, like `0..19` or `0, 1, 5`")
    return _cut_off(address, spread) if isinstance(spread, Normal) else spread


def _cut_off(address: ScenarioParameter, spread: Normal) -> Normal:
    """The distribution within what the field may be, open ends left out."""
    lower, upper = float(address.lower), float(address.upper)
    mark = address.mark
    if isinstance(mark, Quantity) and mark.open_lower:
        lower = math.nextafter(lower, math.inf)
    if isinstance(mark, Quantity) and mark.open_upper:
        upper = math.nextafter(upper, -math.inf)
    return dataclasses.replace(spread, lower=max(spread.lower, lower), upper=min(spread.upper, upper))


LONGEST = 10_000
"""Characters of what is said about one number."""

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_PLAIN = re.compile(_NUMBER)
_UNIT = re.compile(rf"\s*{_NUMBER}\s*(.*)", re.DOTALL)
_POINTS = re.compile(r"(.*\S)\s+in\s+(\S+)", re.DOTALL)
_LOG = re.compile(r"(.*\S)\s+log", re.DOTALL)
_RELATIVE = re.compile(rf"({_NUMBER})\s*(?:%|percent)")
_ONE = re.compile(rf"{_NUMBER}\s*(?:[A-Za-z(/1][^%\s]*(?:\s+[^0-9+.\s-]\S*)*)?")
_FORMS = "a range (0.2 kg..1.0 kg), values (1 kg, 2 kg), `+-10 %` or `normal 10 %`"


def parse_sweep(text: str, scenario: Scenario) -> SweptParameter:
    """Read what one number is varied over.

    Parameters
    ----------
    text
        A name, "=", and one of

        ============================  ============================================================================
        ``0.2 kg..1.0 kg``            a range, even; the unit of its end will do for both: ``0.2..1.0 kg``
        ``1..100 bar/rad log``        a range, even in the logarithm
        ``0.2..1.0 kg in 9``          a range of which a grid has 9 points
        ``1 kg, 2 kg, 4 kg``          these values
        ``0..19``                     all of these numbers, where only whole ones make sense
        ``+-10 %``, ``+-0.1 kg``      evenly around the nominal value; a percentage is always one of it
        ``normal 10 %``               a normal distribution around the nominal value with this standard deviation
                                      (or ``normal 0.05 kg``), cut off at the ends of what the number may be
        ============================  ============================================================================
    scenario
        Whose numbers are meant; nominal values are its own.

    Raises
    ------
    ParameterError
        With the text, what is wrong with it, and what to do.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> parse_sweep("load.mass2=+-10 %", scenario).distribution
    Uniform(low=0.45, high=0.55, points=None)
    >>> parse_sweep("load.mass2=1 kg..0.2 kg", scenario)
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.mass2=1 kg..0.2 kg': the range is empty: 1 kg is not below
    0.2 kg; write the lower end first
    """
    name, equals, said = text.partition("=")
    try:
        if len(text) > LONGEST:
            _fail(f"is longer than {LONGEST} characters", "say less")
        if not equals:
            _fail("is no name and what it is varied over", "write it like 'load.mass2=0.2 kg..1.0 kg'")
        address = find_parameter(scenario, name)
        return SweptParameter(address, _spread(said.strip().replace("±", "+-"), address))
    except ParameterError as error:
        raise _about(text, error) from None


def parse_sweeps(texts: Iterable[str], scenario: Scenario) -> tuple[SweptParameter, ...]:
    """Read what several numbers are varied over.

    Raises
    ------
    ParameterError
        As for `parse_sweep`, and if two texts are about the same number, however it is spelt.
    """
    found: dict[str, str] = {}
    several = []
    for text in texts:
        one = parse_sweep(text, scenario)
        if one.name in found:
            _fail(f"{quoted(found[one.name])} and {quoted(text)} are about the same number", "keep one of them")
        found[one.name] = text
        several.append(one)
    return tuple(several)


def _spread(said: str, address: ScenarioParameter) -> Distribution:
    if not said:
        _fail("says nothing after '='", f"give {_FORMS}")
    if said.startswith("+-"):
        amount, nominal = _amount(said[2:], address), address.nominal
        assert nominal is not None  # an amount has looked at it
        return Uniform(nominal - amount, nominal + amount)
    if re.match(r"normal\b", said):
        amount, nominal = _amount(said[len("normal") :], address), address.nominal
        assert nominal is not None
        return Normal(nominal, amount)
    return _range(said, address) if ".." in said else _values(said, address)


def _range(said: str, address: ScenarioParameter) -> Distribution:
    said, points = _without(_POINTS, said)
    said, log = _without(_LOG, said)
    low_text, _, high_text = said.partition("..")
    high = _number(high_text, address)
    low = _number(_with_unit_of(low_text, high_text), address)
    if not low < high:
        _fail(f"the range is empty: {address.show(low)} is not below {address.show(high)}", "write the lower end first")
    if address.whole:
        if log is not None or points is not None:
            _fail("a range of whole numbers is all of them", "leave `log` and `in ...` out, or list values")
        return IntegerRange(int(low), int(high))
    if points is not None and not re.fullmatch(r"[0-9]{1,9}", points):
        _fail(f"{quoted(points)} is no number of points", "write it like `in 9`")
    count = None if points is None else int(points)
    if log is None:
        return Uniform(low, high, count)
    if low <= 0 <= high:
        _fail(
            f"a range from {address.show(low)} to {address.show(high)} has no even logarithm",
            "give two ends of one sign, neither of them zero, or leave `log` out",
        )
    return LogUniform(low, high, count)


def _values(said: str, address: ScenarioParameter) -> Values:
    if not address.whole and re.search(r"[0-9],[0-9]", said):
        _fail(f"{quoted(said)} has a comma between digits", "write decimals with a point, and lists like `1 kg, 2 kg`")
    return Values(tuple(_number(each, address) for each in said.split(",")))


def _amount(said: str, address: ScenarioParameter) -> float:
    """How far from the nominal value, in SI."""
    said = said.strip()
    if address.whole or not isinstance(address.mark, Quantity):
        _fail(f"{address.name} is a whole number", "give whole numbers, like `0..19` or `0, 1, 5`")
    if address.nominal is None:
        _fail(f"{address.name} has no nominal value in the scenario", "give a range, like `12..18 N*m/rad`")
    relative = _RELATIVE.fullmatch(said)
    if not relative:
        amount = _read(
            dataclasses.replace(address.mark, lower=0.0, upper=1e12, open_lower=True, open_upper=False), said
        )
    elif address.nominal == 0:
        _fail(
            f"{said} of a nominal value of {address.show(0.0)} is nothing",
            f"give an amount in {address.shown}" if address.unit != "1" else "give an amount",
        )
    else:
        amount = float(relative[1]) / 100 * abs(address.nominal)
    if not amount > 0 or amount > 1e300:
        _fail(f"{quoted(said)} is no amount", "give one above zero")
    return amount


def _number(said: str, address: ScenarioParameter) -> Any:
    """A number of the field, in SI, with all that the field itself says of it."""
    return _read(address.mark, said.strip())


def _read(mark: Any, said: str) -> Any:
    if not said:
        _fail("a value is missing", f"give {_FORMS}")
    try:
        return mark.read(said)
    except PydanticCustomError as error:
        context = error.context or {}
        message, remedy = str(context.get("message", error)), str(context.get("remedy", ""))
        if not _ONE.fullmatch(said):  # more, or less, than a number and a unit: a range that is written otherwise?
            remedy = f"give {_FORMS}"
        _fail(message, remedy or "give a finite one")


def _with_unit_of(low: str, high: str) -> str:
    """The lower end, with the unit of the upper one if it has none."""
    unit = _UNIT.fullmatch(high)
    return f"{low.strip()} {unit[1]}" if unit and _PLAIN.fullmatch(low.strip()) else low


def _without(ending: re.Pattern[str], said: str) -> tuple[str, str | None]:
    """A text without an ending, and what the ending says."""
    found = ending.fullmatch(said)
    return (found[1], found[found.lastindex or 1]) if found else (said, None)


def _fail(message: str, remedy: str) -> NoReturn:
    raise ParameterError(message, remedy=remedy)


def _about(text: str, error: ParameterError) -> ParameterError:
    """The same error, with the text that it is about."""
    message = str(error).removesuffix(f"; {error.remedy}") if error.remedy else str(error)
    about = {"value": error.value, "lower": error.lower, "upper": error.upper, "unit": error.unit}
    return ParameterError(f"{quoted(text)}: {message}", remedy=error.remedy, **about)  # type: ignore[arg-type]


Table = dict[str, NDArray]
"""Values in SI by canonical name, float64 or int64, one row a run."""

SamplingMethod = Literal["sobol", "random", "grid"]
"""How combinations are chosen."""


def sample(over: Sequence[SweptParameter], kind: SamplingMethod = "sobol", samples: int = 1024, seed: int = 0) -> Table:
    """Choose combinations of values.

    Parameters
    ----------
    over
        What is varied.
    kind
        "sobol": a scrambled Sobol sequence, which fills the space evenly; the first rows of a longer table are the
        shorter one. "random": independent draws, with the same property. "grid": every combination of listed values,
        of ranges `in` so many points, and of whole numbers; the last of `over` runs fastest.
    samples
        The number of rows; a grid has its own.
    seed
        Of the scrambling or the draws; with it a table is the same to the last bit.

    Raises
    ------
    ParameterError
        If nothing is varied, a number is varied twice, or a grid does not know its points.

    References
    ----------
    `scipy.stats.qmc.Sobol`; S. Joe and F. Y. Kuo, SIAM J. Sci. Comput. 30 (2008) 2635-2654.

    Examples
    --------
    >>> from mckibben.study.parameters import parse_sweeps
    >>> from mckibben.study.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> over = parse_sweeps(["load.mass2=1..2 kg in 2", "load.mass1=0.1 kg, 0.2 kg, 0.4 kg"], scenario)
    >>> for name, column in sample(over, "grid").items():
    ...     print(name, column)
    load.mass2 [1. 1. 1. 2. 2. 2.]
    load.mass1 [0.1 0.2 0.4 0.1 0.2 0.4]
    """
    names = [each.name for each in over]
    if not names:
        raise ParameterError("nothing is varied", remedy="say what, like 'load.mass2=0.2 kg..1.0 kg'")
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"{name} is varied twice", remedy="keep one of them")
    if kind == "grid":
        return _grid(over)
    _check_count("samples", samples, 1, MOST)
    _check_count("seed", seed, 0, 2**63 - 1)
    if kind == "sobol":
        quantiles = _sobol(len(over), samples, seed)
    elif kind == "random":
        quantiles = _generator(seed).random((samples, len(over)))
    else:
        raise ParameterError(f"there is no design {kind!r}", remedy="choose sobol, random or grid")
    return {each.name: each.distribution.at(quantiles[:, i]) for i, each in enumerate(over)}


def _grid(over: Sequence[SweptParameter]) -> Table:
    axes = []
    for each in over:
        try:
            axes.append(each.distribution.grid())
        except ParameterError as error:
            message = str(error).removesuffix(f"; {error.remedy}")
            raise ParameterError(f"{each.text}: {message}", remedy=error.remedy) from None
    rows = math.prod(len(axis) for axis in axes)
    if rows > MOST:
        raise ParameterError(f"the grid has {rows} combinations, more than {MOST}", remedy="choose fewer points")
    columns = np.meshgrid(*axes, indexing="ij")
    return {each.name: column.ravel() for each, column in zip(over, columns, strict=True)}


def _sobol(dimensions: int, samples: int, seed: int) -> NDArray[np.float64]:
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, scramble=True, rng=_generator(seed))
    return sequence.random_base2(max(samples - 1, 0).bit_length())[:samples]


def _generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def _check_count(what: str, value: object, least: int, most: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise ParameterError(
            f"{what} is {value!r}",
            value=value,
            lower=least,
            upper=most,
            remedy=f"choose a whole number, {least} to {most}",
        )
