"""The parameters of a scenario that can be varied."""

from __future__ import annotations

from typing import Self

import numpy as np

from mckibben.result import Result, column
from mckibben.scenario import StudiedScenario, list_parameters


class ParameterList(Result):
    """Names, nominal values, ranges and units of the parameters of a scenario."""

    scenario: str
    parameter: np.ndarray = column(title="parameter")
    value: np.ndarray = column(title="value")
    range: np.ndarray = column(title="range")
    unit: np.ndarray = column(title="unit")

    @classmethod
    def of(cls, scenario: StudiedScenario) -> Self:
        """Return the parameters of a scenario."""
        parameters = list_parameters(scenario)
        rows = [(p.name, "-" if p.nominal is None else p.show(p.nominal), p.range, p.shown) for p in parameters]
        return cls(scenario.name, *np.array(rows, dtype=str).T)

    def verdict(self) -> str:
        """Return the number of parameters, and how those of equal muscles are varied alone."""
        equal = any(name.startswith("joint.muscle.") for name in self.parameter)
        alone = "; joint.muscle1 and joint.muscle2, too, have those of joint.muscle" if equal else ""
        return f"{self.scenario}: {self.parameter.size} parameters can be varied{alone}"
