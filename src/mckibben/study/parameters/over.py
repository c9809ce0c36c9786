"""A number of a scenario together with what it is varied over."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

from mckibben.errors import ParameterError
from mckibben.study.parameters.address import Address, find_all
from mckibben.study.parameters.spread import LogUniform, Normal, Spread, Uniform, Values, Wholes
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.quantity import Quantity


@dataclass(frozen=True)
class Over:
    """A number and its spread, which go together: values lie in the field's range, and are whole where they must be.

    Raises
    ------
    ParameterError
        If they do not go together.
    """

    address: Address
    spread: Spread

    def __post_init__(self) -> None:
        address, spread = self.address, _of_its_kind(self.address, self.spread)
        object.__setattr__(self, "spread", spread)
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
        return self.address.name

    @property
    def text(self) -> str:
        """What `read_over` reads back to the last bit; of a `Normal` the deviation alone is written.

        >>> from mckibben.study.parameters import read_over
        >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
        >>> read_over("load.m2 = 200 g..1.0 kg in 9", scenario).text
        'load.mass2=0.2 kg..1 kg in 9'
        """
        write, spread = self.address.write, self.spread
        match spread:
            case Uniform() | LogUniform():
                log = " log" if isinstance(spread, LogUniform) else ""
                points = "" if spread.points is None else f" in {spread.points}"
                said = f"{write(spread.low)}..{write(spread.high)}{log}{points}"
            case Wholes():
                said = f"{spread.low}..{spread.high}"
            case Values():
                said = ", ".join(write(value) for value in spread.values)
            case Normal():
                said = f"normal {write(spread.deviation)}"
            case _:
                said = repr(spread)
        return f"{self.name}={said}"


def over(scenario: Scenario, spreads: Mapping[str, Spread]) -> tuple[Over, ...]:
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
    >>> [each.text for each in over(scenario, {"load.m2": Uniform(0.2, 1.0)})]
    ['load.mass2=0.2 kg..1 kg']
    """
    found = find_all(scenario, spreads)
    return tuple(Over(address, spread) for address, spread in zip(found, spreads.values(), strict=True))


def _of_its_kind(address: Address, spread: Spread) -> Spread:
    """The spread with whole numbers where they must be, and cut off at what the field may be."""
    if isinstance(spread, Wholes) and not address.whole:
        raise ParameterError(f"{address.name} is no whole number", remedy="give a Uniform range or Values")
    if isinstance(spread, Values) and not address.whole:
        return Values(tuple(float(value) for value in spread.values))
    if isinstance(spread, Values) and all(float(value).is_integer() for value in spread.values):
        return Values(tuple(int(value) for value in spread.values))
    if address.whole and not isinstance(spread, Wholes):
        raise ParameterError(f"{address.name} is a whole number", remedy="give some, like `0..19` or `0, 1, 5`")
    return _cut_off(address, spread) if isinstance(spread, Normal) else spread


def _cut_off(address: Address, spread: Normal) -> Normal:
    """The distribution within what the field may be, open ends left out."""
    lower, upper = float(address.lower), float(address.upper)
    mark = address.mark
    if isinstance(mark, Quantity) and mark.open_lower:
        lower = math.nextafter(lower, math.inf)
    if isinstance(mark, Quantity) and mark.open_upper:
        upper = math.nextafter(upper, -math.inf)
    return dataclasses.replace(spread, lower=max(spread.lower, lower), upper=min(spread.upper, upper))
