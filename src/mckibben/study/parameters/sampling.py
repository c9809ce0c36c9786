"""Swept parameters, their text form such as `load.mass2=0.2 kg..1.0 kg`, and samples of their values."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn

import numpy as np

from mckibben.errors import CallError, ParameterError, RangeError, UnitError, described, quoted
from mckibben.scenario import ScenarioParameter, StudiedScenario, find_parameter, find_parameters
from mckibben.study.parameters.distributions import (
    MAX_ROWS,
    Distribution,
    LogUniform,
    Normal,
    Range,
    Uniform,
    Values,
)
from mckibben.study.study import Table
from mckibben.units import NUMBER, Quantity, split_range


@dataclass(frozen=True)
class SweptParameter:
    """A parameter and its distribution, which must lie in the parameter's range; else raises ParameterError."""

    parameter: ScenarioParameter
    distribution: Distribution

    def __post_init__(self) -> None:
        parameter, distribution = self.parameter, _fitted(self.parameter, self.distribution)
        object.__setattr__(self, "distribution", distribution)
        for bound in distribution.bounds:
            if not parameter.holds(bound):
                message = f"{parameter.name} reaches {parameter.show(bound)}, which is out of range ({parameter.range})"
                raise parameter.outside(message, bound)

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.parameter.name

    @property
    def text(self) -> str:
        """Text from which `parse_sweep` restores it exactly; of a `Normal` only the deviation is written.

        >>> from mckibben.study.parameters import parse_sweep
        >>> from mckibben.scenario import Scenario
        >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
        >>> parse_sweep("load.mass2 = 200 g..1.0 kg in 9", scenario).text
        'load.mass2=0.2 kg..1 kg in 9'
        """
        write, distribution = self.parameter.write, self.distribution
        match distribution:
            case Range():
                log = " log" if isinstance(distribution, LogUniform) else ""
                points = "" if distribution.points is None else f" in {distribution.points}"
                text = f"{write(distribution.low)}..{write(distribution.high)}{log}{points}"
            case Values(values=(int() as low, *_, int() as high) as values) if values == (*range(low, high + 1),):
                text = f"{low}..{high}"
            case Values(values=values):
                text = ", ".join(map(write, values))
            case Normal(deviation=deviation):  # a percentage would be relative to the nominal value
                text = f"normal {deviation if self.parameter.shown == '%' else write(deviation)}"
            case _:
                text = repr(distribution)
        return f"{self.name}={text}"


def sweep_parameters(
    scenario: StudiedScenario, distributions: Mapping[str, Distribution]
) -> tuple[SweptParameter, ...]:
    """Swept parameters from distributions [SI] by name.

    Raises `ParameterError` if a name is unknown or repeated, or a distribution does not fit its parameter.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> [swept.text for swept in sweep_parameters(scenario, {"load.mass2": Uniform(0.2, 1.0)})]
    ['load.mass2=0.2 kg..1 kg']
    """
    parameters = find_parameters(scenario, distributions)
    for name, distribution in distributions.items():
        if not isinstance(distribution, Distribution):
            remedy = f"give a Distribution of mckibben.study.parameters, or texts, such as ['{name}=+-10 %']"
            raise CallError(
                f"over[{name!r}] is {described(distribution)}",
                field=f"over[{name!r}]",
                value=distribution,
                remedy=f"{remedy}; `simulate_many` takes arrays",
            )
    return tuple(SweptParameter(*pair) for pair in zip(parameters, distributions.values(), strict=True))


def _fitted(parameter: ScenarioParameter, distribution: Distribution) -> Distribution:
    """The distribution with integers for an integer parameter, and truncated at the parameter's range."""
    values = distribution.values if isinstance(distribution, Values) else ()
    whole = parameter.is_integer and bool(values) and all(float(value).is_integer() for value in values)
    if parameter.is_integer and not whole:
        raise ParameterError(f"{parameter.name} is a whole number", remedy="give some, like `0..19` or `0, 1, 5`")
    if values:
        return Values(tuple(map(int if whole else float, values)))
    return _truncated(parameter, distribution) if isinstance(distribution, Normal) else distribution


def _truncated(parameter: ScenarioParameter, normal: Normal) -> Normal:
    """The distribution truncated at the parameter's range, without open ends."""
    lower, upper = float(parameter.lower), float(parameter.upper)
    mark = parameter.mark
    if isinstance(mark, Quantity) and mark.open_lower:
        lower = math.nextafter(lower, math.inf)
    if isinstance(mark, Quantity) and mark.open_upper:
        upper = math.nextafter(upper, -math.inf)
    return replace(normal, lower=max(normal.lower, lower), upper=min(normal.upper, upper))


_RANGE = re.compile(r"(.*?)(\s+log)?(?:\s+in\s+(\S+))?", re.DOTALL)
_RELATIVE = re.compile(rf"({NUMBER.pattern})\s*(?:%|percent)")
_QUANTITY = re.compile(rf"{NUMBER.pattern}\s*(?:[A-Za-z(/1][^%\s]*(?:\s+[^0-9+.\s-]\S*)*)?")
_FORMS = "a range (0.2 kg..1.0 kg), values (1 kg, 2 kg), `+-10 %` or `normal 10 %`"


def parse_sweep(text: str, scenario: StudiedScenario) -> SweptParameter:
    """Parse a parameter and its distribution.

    Raises `ParameterError` if the text is not such a distribution of a parameter of the scenario.

    Parameters
    ----------
    text
        A name, "=", and one of

        ============================  ============================================================================
        ``0.2 kg..1.0 kg``            uniform; the unit of the upper end applies to both: ``0.2..1.0 kg``
        ``1..100 bar/rad log``        log-uniform
        ``0.2..1.0 kg in 9``          uniform, with 9 points on a grid
        ``1 kg, 2 kg, 4 kg``          discrete values
        ``0..19``                     all integers of a range, for an integer parameter
        ``+-10 %``, ``+-0.1 kg``      uniform around the nominal value; a percentage is relative to it
        ``normal 10 %``               normal around the nominal value with this standard deviation (or
                                      ``normal 0.05 kg``), truncated at the range of the parameter
        ============================  ============================================================================
    scenario
        Scenario with the parameter and its nominal value.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> parse_sweep("load.mass2=+-10 %", scenario).distribution
    Uniform(low=0.45, high=0.55, points=None)
    >>> parse_sweep("load.mass2=1 kg..0.2 kg", scenario)
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.mass2=1 kg..0.2 kg': the range is empty; write the lower end first
    """
    name, equals, definition = text.partition("=")
    try:
        if not equals:
            _fail("is not a parameter and its range", "write it like 'load.mass2=0.2 kg..1.0 kg'")
        parameter = find_parameter(scenario, name)
        return SweptParameter(parameter, _parse_distribution(definition.strip().replace("±", "+-"), parameter))
    except ParameterError as error:
        fields = {"value": error.value, "lower": error.lower, "upper": error.upper, "unit": error.unit}
        raise ParameterError(f"{quoted(text)}: {error.message}", remedy=error.remedy, **fields) from None


def parse_sweeps(texts: Iterable[str], scenario: StudiedScenario) -> tuple[SweptParameter, ...]:
    """Parse several parameters and their distributions, each as by `parse_sweep`.

    Raises `ParameterError` as well if a parameter is repeated.
    """
    return distinct(parse_sweep(text, scenario) for text in texts)


def distinct(swept: Iterable[SweptParameter]) -> tuple[SweptParameter, ...]:
    """Return the parameters; raises `ParameterError` if one is repeated."""
    parameters = {}
    for parameter in swept:
        if parameter.name in parameters:
            message = f"{parameter.name} is varied twice"
            raise ParameterError(message, field=parameter.name, remedy="keep one of them")
        parameters[parameter.name] = parameter
    return tuple(parameters.values())


def _parse_distribution(text: str, parameter: ScenarioParameter) -> Distribution:
    if not text:
        _fail("says nothing after '='", f"give {_FORMS}")
    if text.startswith("+-"):
        amount, nominal = _parse_amount(text[2:], parameter)
        return Uniform(nominal - amount, nominal + amount)
    if re.match(r"normal\b", text):
        amount, nominal = _parse_amount(text[len("normal") :], parameter)
        return Normal(nominal, amount)
    return _parse_range(text, parameter) if ".." in text else _parse_values(text, parameter)


def _parse_range(text: str, parameter: ScenarioParameter) -> Distribution:
    match = _RANGE.fullmatch(text)
    assert match is not None  # the ends of the text are optional
    ends, log, points = match.groups()
    low_text, high_text = split_range(ends)
    high, low = _read(parameter.mark, high_text), _read(parameter.mark, low_text)
    if parameter.is_integer:
        if log is not None or points is not None:
            _fail("a range of whole numbers is all of them", "leave `log` and `in ...` out, or list values")
        if high - low >= 100_000:
            _fail("more than 100000 whole numbers", "choose fewer")
        return Values(tuple(range(low, high + 1))) if low < high else Uniform(low, high)  # which is empty
    if points is not None and not re.fullmatch(r"[0-9]{1,9}", points):
        _fail(f"{quoted(points)} is not a number of points", "write it like `in 9`")
    return (Uniform if log is None else LogUniform)(low, high, None if points is None else int(points))


def _parse_values(text: str, parameter: ScenarioParameter) -> Values:
    if not parameter.is_integer and re.search(r"[0-9],[0-9]", text):
        _fail(f"{quoted(text)} has a comma between digits", "write decimals with a point, and lists like `1 kg, 2 kg`")
    return Values(tuple(_read(parameter.mark, value) for value in text.split(",")))


def _parse_amount(text: str, parameter: ScenarioParameter) -> tuple[float, float]:
    """Deviation from the nominal value, and that value [SI]."""
    text, mark, nominal = text.strip(), parameter.mark, parameter.nominal
    if parameter.is_integer or not isinstance(mark, Quantity):
        _fail(f"{parameter.name} is a whole number", "give whole numbers, like `0..19` or `0, 1, 5`")
    if nominal is None:
        _fail(f"{parameter.name} has no nominal value in the scenario", "give a range, like `12..18 N*m/rad`")
    relative = _RELATIVE.fullmatch(text)
    if not relative:
        amount = _read(replace(mark, lower=0.0, upper=1e60, open_lower=True, open_upper=False), text)
    elif nominal == 0:
        _fail(
            f"{text} of a nominal value of {parameter.show(0.0)} is nothing",
            f"give an amount in {parameter.shown}" if parameter.unit != "1" else "give an amount",
        )
    else:
        amount = float(relative[1]) / 100 * abs(nominal)
    if not amount > 0 or amount > 1e300:
        _fail(f"{quoted(text)} is not an amount", "give one above zero")
    return amount, nominal


def _read(mark: Any, text: str) -> Any:
    """Value [SI] of a field from text, with the errors of the field."""
    text = text.strip()
    if not text:
        _fail("a value is missing", f"give {_FORMS}")
    try:
        return mark.read(text)
    except (UnitError, RangeError) as error:
        remedy = error.remedy
        if not _QUANTITY.fullmatch(text):  # perhaps another form of range
            remedy = f"give {_FORMS}"
        _fail(error.message, remedy or "give a finite one")


def _fail(message: str, remedy: str) -> NoReturn:
    raise ParameterError(message, remedy=remedy)


SamplingMethod = Literal["sobol", "random", "grid"]
"""Method by which combinations of values are chosen."""


def sample(
    swept: Sequence[SweptParameter], method: SamplingMethod = "sobol", samples: int = 1024, seed: int = 0
) -> Table:
    """Sample combinations of values.

    Raises `ParameterError` if there is no parameter, one is repeated, or a grid has no number of points or another
    design has one.

    Parameters
    ----------
    swept
        Parameters and their distributions.
    method
        "sobol": scrambled Sobol sequence (`scipy.stats.qmc.Sobol`); "random": independent draws; with both, a longer
        table begins with the shorter one. "grid": all combinations; the last parameter varies fastest.
    samples, seed
        Number of rows, and seed of the scrambling or the draws; not of a grid.

    Examples
    --------
    >>> from mckibben.study.parameters import parse_sweeps
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> over = parse_sweeps(["load.mass2=1..2 kg in 2", "load.mass1=0.1 kg, 0.2 kg, 0.4 kg"], scenario)
    >>> for name, column in sample(over, "grid").items():
    ...     print(name, column)
    load.mass2 [1. 1. 1. 2. 2. 2.]
    load.mass1 [0.1 0.2 0.4 0.1 0.2 0.4]
    """
    if not distinct(swept):
        raise ParameterError("nothing is varied", remedy="name a parameter, as in 'load.mass2=0.2 kg..1.0 kg'")
    if method == "grid":
        return _grid(swept)
    if pointed := next((parameter for parameter in swept if getattr(parameter.distribution, "points", None)), None):
        remedy = "leave `in ...` out, or sample a grid (command line: --design grid)"
        raise ParameterError(f"{pointed.text} has points of a grid, and the design is {method}", remedy=remedy)
    check_count("samples", samples, 1, MAX_ROWS)
    check_count("seed", seed, 0, 2**63 - 1)
    generator = np.random.Generator(np.random.PCG64(seed))
    if method == "sobol":
        from scipy.stats import qmc

        with warnings.catch_warnings():  # of a number that is not a power of two
            warnings.simplefilter("ignore", UserWarning)
            quantiles = qmc.Sobol(len(swept), scramble=True, rng=generator).random(samples)
    elif method == "random":
        quantiles = generator.random((samples, len(swept)))
    else:
        raise ParameterError(f"there is no design {method!r}", remedy="choose sobol, random or grid")
    return {parameter.name: parameter.distribution.ppf(quantiles[:, i]) for i, parameter in enumerate(swept)}


def _grid(swept: Sequence[SweptParameter]) -> Table:
    """All combinations of the grid points of each parameter."""
    axes = []
    for parameter in swept:
        try:
            axes.append(parameter.distribution.grid())
        except ParameterError as error:
            raise ParameterError(f"{parameter.text}: {error.message}", remedy=error.remedy) from None
    rows = math.prod(len(axis) for axis in axes)
    if rows > MAX_ROWS:
        message = f"{rows} combinations are more than {MAX_ROWS}"
        raise ParameterError(message, value=rows, upper=MAX_ROWS, remedy="choose fewer points")
    places = np.unravel_index(np.arange(rows), [len(axis) for axis in axes])
    return {parameter.name: axis[place] for parameter, axis, place in zip(swept, axes, places, strict=True)}


def check_count(what: str, value: object, least: int, most: int) -> None:
    """Raise ParameterError unless a value is a whole number in a range."""
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        remedy = f"choose a whole number, {least} to {most}"
        raise ParameterError(f"{what} is {value!r}", value=value, lower=least, upper=most, remedy=remedy)
