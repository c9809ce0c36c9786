"""Search spaces and search methods."""

from __future__ import annotations

import enum
import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, quoted, suggest
from mckibben.scenario import Scenario, ScenarioParameter, find_parameter, list_parameters
from mckibben.study.parameters import LogUniform, SweptParameter, Uniform, parse_sweep
from mckibben.study.parameters.sampling import parse_distinct
from mckibben.units import quantity

Vector = NDArray[np.float64]

AT_BOUND = 0.01
"""Distance from a face of the unit cube within which a parameter counts as at its bound."""

_DIGITS = 6  # digits of values written to files


@dataclass(frozen=True)
class SearchSpace:
    """Parameters with ranges (else raises ParameterError); points of the unit cube map to their values [SI]."""

    swept: tuple[SweptParameter, ...]

    def __post_init__(self) -> None:
        if not self.swept:
            raise ParameterError("nothing to tune", remedy="give at least one parameter")
        for each in self.swept:
            if not isinstance(each.distribution, Uniform | LogUniform):
                raise ParameterError(
                    f"{each.name} has no range to search", remedy="give one, such as `1..10 bar/rad log`"
                )

    def __len__(self) -> int:
        return len(self.swept)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(each.name for each in self.swept)

    @property
    def nominal(self) -> Vector:
        """Nominal values [SI]; the middle of the range if there is none."""
        middle = self.values(np.full((1, len(self)), 0.5))[0]
        nominal = (each.parameter.nominal for each in self.swept)
        return np.array([m if n is None else float(n) for n, m in zip(nominal, middle, strict=True)])

    def values(self, points: Vector) -> Vector:
        """Values [SI] at points, both of shape (n, parameters)."""
        return np.stack([each.distribution.ppf(points[:, i]) for i, each in enumerate(self.swept)], axis=1)

    def point(self, values: Vector) -> Vector:
        """Point of values [SI] of shape (parameters,), clipped to the ranges."""
        pairs = zip(self.swept, values, strict=True)
        return np.array([float(each.distribution.quantile(value)) for each, value in pairs])

    def rounded(self, values: Vector) -> Vector:
        """Values [SI] rounded to six digits in the unit of files, within the ranges."""
        written = [
            round(value)
            if each.parameter.is_integer
            else quantity(each.parameter.show(value, _DIGITS), each.parameter.unit)
            for each, value in zip(self.swept, values, strict=True)
        ]
        return np.array(written).clip(*np.array([each.distribution.bounds for each in self.swept]).T)

    def at_bound(self, point: Sequence[float] | Vector) -> tuple[str, ...]:
        """Names of the parameters within `AT_BOUND` of an end of their range."""
        return tuple(each.name for each, at in zip(self.swept, point, strict=True) if min(at, 1 - at) < AT_BOUND)

    def slopes(self, values: Vector) -> Vector:
        """Derivatives of values [SI], shape (n, parameters), with respect to the points of the cube."""
        slopes = np.empty_like(values)
        for i, each in enumerate(self.swept):
            low, high = each.distribution.bounds
            is_log = isinstance(each.distribution, LogUniform)
            slopes[:, i] = values[:, i] * np.log(high / low) if is_log else high - low
        return slopes


_GAINS = ("kp", "ki", "kd", "bandwidth", "stiffness_bandwidth", "slope", "reach")


def is_gain(name: str) -> bool:
    """Whether a scenario parameter is a gain of its controller."""
    *above, last = name.split(".")
    return above[:1] == ["controller"] and "adaptation" not in above and last in _GAINS


def gain_ranges(scenario: Scenario, decades: float = 2.0) -> dict[str, LogUniform]:
    """Logarithmic ranges around all nonzero gains of a scenario, a number of decades down and up.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> gain_ranges(scenario, 1.0)["controller.position.kp"]
    LogUniform(low=20000.0, high=2000000.0, points=None)
    """
    gains = (each for each in list_parameters(scenario) if is_gain(each.name) and each.nominal)
    return {each.name: _range_around(each, decades) for each in gains}


def parse_ranges(texts: Sequence[str], scenario: Scenario) -> tuple[SweptParameter, ...]:
    """Parse parameters and their ranges from texts: ``NAME=LOW..HIGH``, followed by ``log`` for a logarithmic one.

    A name alone gets a range from 0.01 to 100 times its value; without texts, all gains are used.

    Raises `ParameterError` if a name is unknown or repeated, a range is invalid, or there is no nonzero value for a
    range around it.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> [each.text for each in parse_ranges(["controller.position.kp", "valve.time_constant=5..50 ms"], scenario)]
    ['controller.position.kp=0.02 bar/rad..200 bar/rad log', 'valve.time_constant=5 ms..50 ms']
    """
    if not texts:
        gains = gain_ranges(scenario)
        if not gains:
            raise ParameterError("all gains are zero", remedy="give parameters with --parameters 'NAME=LOW..HIGH'")
        return tuple(SweptParameter(find_parameter(scenario, name), around) for name, around in gains.items())

    def parse(text: str) -> SweptParameter:
        if "=" in text:
            return parse_sweep(text, scenario)
        parameter = find_parameter(scenario, text)
        if not parameter.nominal or parameter.is_integer:
            what = "a whole number" if parameter.is_integer else "zero, or not given"
            remedy = f"write {parameter.name}=LOW..HIGH"
            raise ParameterError(f"{parameter.name} is {what}: there is no range around it", value=text, remedy=remedy)
        return SweptParameter(parameter, _range_around(parameter, 2.0))

    return parse_distinct(texts, parse)


def _range_around(parameter: ScenarioParameter, decades: float) -> LogUniform:
    nominal, factor = float(parameter.nominal or 0.0), 10.0**decades
    return LogUniform(*sorted((nominal / factor, nominal * factor)))


Points = NDArray[np.float64]
Costs = Callable[[Points], NDArray[np.float64]]
Fraction = Callable[[float], None]
"""Called with the completed fraction of a search, 0 to 1."""
CostsAndGradients = Callable[[Points], tuple[NDArray[np.float64], Points]]

_LINE_SEARCH = 8  # evaluations along a direction: the huge slopes of a chattering loop would prevent termination
_STEP = 0.25
"""Initial step of CMA-ES, relative to each range."""


class Method(enum.Enum):
    """Search method.

    GRADIENT: L-BFGS-B from several starts; few runs, local.

    EVOLUTION: differential evolution; global, many runs.

    CMA: covariance matrix adaptation evolution strategy, between the two.
    """

    GRADIENT = "gradient"
    EVOLUTION = "evolution"
    CMA = "cma"

    @classmethod
    def _missing_(cls, value: object) -> None:
        known = [one.value for one in cls]
        remedy = suggest(value, known) if isinstance(value, str) else f"give one of {', '.join(known)}"
        raise ParameterError(f"method is {quoted(value)}", field="method", value=value, remedy=remedy)


_MIN_POPULATION = {Method.EVOLUTION: 5, Method.CMA: 4}


def check_method(method: Method, *, numbers: int, population: int) -> None:
    """Check that a method can search a number of parameters with a population."""
    if method is Method.CMA and numbers < 2:
        raise ParameterError("CMA-ES needs at least two parameters", remedy="use gradient or evolution")
    least = _MIN_POPULATION.get(method, 1)
    if population < least:
        raise ParameterError(
            f"{method.value} with {population} points per generation", value=population, remedy=f"give at least {least}"
        )


def by_gradient(
    function: CostsAndGradients, first: Points, *, starts: int, iterations: int, seed: int, progress: Fraction
) -> None:
    """L-BFGS-B (Byrd et al., SIAM J. Sci. Comput. 16 (1995) 1190) from the first and Sobol points, in parallel."""
    from scipy.optimize import minimize  # 0.3 s at import
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Sobol points need not be a power of two here
        others = qmc.Sobol(first.size, rng=seed).random(starts - 1) if starts > 1 else []
    steps, counting = [0] * starts, threading.Lock()

    def count(number: int, reached: int) -> None:
        with counting:  # so that progress never decreases
            steps[number] = reached
            progress(sum(steps) / (starts * iterations))

    def descend(number: int, start: Points, ask: Callable[[Points], tuple[float, Points]]) -> None:
        minimize(
            ask,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * start.size,
            callback=lambda _: count(number, steps[number] + 1),
            options={"maxiter": iterations, "maxls": _LINE_SEARCH},
        )
        count(number, iterations)

    side_by_side(function, [(lambda ask, i=i, x=x: descend(i, x, ask)) for i, x in enumerate([first, *others])])


def side_by_side(
    function: CostsAndGradients, searches: list[Callable[[Callable[[Points], tuple[float, Points]]], None]]
) -> None:
    """Run searches in threads; `function` gets the points that all of them are waiting for, shape (n, parameters)."""
    meeting = threading.Condition()
    asked: dict[int, Points] = {}
    answers: dict[int, tuple[float, Points]] = {}
    active = set(range(len(searches)))
    failures: list[BaseException] = []

    def ask(number: int, point: Points) -> tuple[float, Points]:
        with meeting:
            asked[number] = np.array(point)
            meeting.notify_all()
            meeting.wait_for(lambda: number in answers or failures)
            if failures:
                raise failures[0]
            return answers.pop(number)

    def search(number: int) -> None:
        try:
            searches[number](lambda point: ask(number, point))
        except BaseException as error:  # re-raised by the caller
            failures.append(error)
        finally:
            with meeting:
                active.discard(number)
                meeting.notify_all()

    threads = [threading.Thread(target=search, args=(i,), daemon=True) for i in range(len(searches))]
    for thread in threads:
        thread.start()
    try:
        while True:
            with meeting:
                meeting.wait_for(lambda: set(asked) == active or failures)
                if failures or not active:
                    break
                numbers = sorted(asked)
                points = np.stack([asked.pop(number) for number in numbers])
            costs, gradients = function(points)
            found = [(float(cost), slope) for cost, slope in zip(costs, gradients, strict=True)]
            with meeting:
                answers.update(zip(numbers, found, strict=True))
                meeting.notify_all()
    except BaseException as error:  # end every search, also on interruption
        failures.insert(0, error)
    with meeting:
        meeting.notify_all()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]


def by_evolution(
    function: Costs, first: Points, *, population: int, generations: int, seed: int, progress: Fraction
) -> None:
    """Differential evolution (Storn and Price, J. Global Optim. 11 (1997) 341) from random points and the first one."""
    from scipy.optimize import differential_evolution  # 0.3 s at import

    done = 0

    def stepped(*_: object) -> None:
        nonlocal done
        done += 1
        progress(min(done / generations, 1.0))

    differential_evolution(
        lambda columns: function(columns.T),
        [(0.0, 1.0)] * first.size,
        x0=first,
        init=np.random.default_rng(seed).uniform(0.0, 1.0, (population, first.size)),
        maxiter=generations,
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
        rng=seed,
        callback=stepped,
    )
    if done < generations:  # ended early: all costs are equal
        progress(1.0)


def by_cma(function: Costs, first: Points, *, population: int, generations: int, seed: int, progress: Fraction) -> None:
    """CMA-ES (Hansen, arXiv:1604.00772) from the first point, which replaces the first draw."""
    from cmaes import CMA

    bounds = np.tile([0.0, 1.0], (first.size, 1))
    strategy = CMA(mean=first, sigma=_STEP, bounds=bounds, population_size=population, seed=seed)
    for generation in range(generations):
        points = np.stack([strategy.ask() for _ in range(population)])
        points[0] = first if generation == 0 else points[0]
        strategy.tell(list(zip(points, function(points).tolist(), strict=True)))
        progress((generation + 1) / generations)
