"""Tables of values: which combinations of numbers a study runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError
from mckibben.study.parameters.over import Over
from mckibben.study.parameters.spread import MOST

Table = dict[str, NDArray]
"""Values in SI by canonical name, float64 or int64, one row a run."""

Kind = Literal["sobol", "random", "grid"]
"""How combinations are chosen."""


def design(over: Sequence[Over], kind: Kind = "sobol", samples: int = 1024, seed: int = 0) -> Table:
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
    >>> from mckibben.study.parameters import read_overs
    >>> from mckibben.study.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> over = read_overs(["load.mass2=1..2 kg in 2", "load.mass1=0.1 kg, 0.2 kg, 0.4 kg"], scenario)
    >>> for name, column in design(over, "grid").items():
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
    return {each.name: each.spread.at(quantiles[:, i]) for i, each in enumerate(over)}


def _grid(over: Sequence[Over]) -> Table:
    axes = []
    for each in over:
        try:
            axes.append(each.spread.grid())
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
