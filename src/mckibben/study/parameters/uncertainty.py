"""Uncertainty of a scenario's plant: what a calibration left, or what is usual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mckibben.scenario import StudiedScenario, list_parameters
from mckibben.study.parameters.sampling import SweptParameter, Table, parse_sweeps

_DELAY = 2.0  # ms about the delay of the commands
_INSIDE = 0.95  # of a distribution, between its extremes


def usual_variation(scenario: StudiedScenario) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return texts of the strengths of both muscles, 10 % about nominal, and of the masses of the load, 20 %.

    Of a robot, those of all muscles and bodies.

    >>> from mckibben.scenario import Scenario
    >>> usual_variation(Scenario.read("examples/pre-contracted-step-pid.yaml"))[1]
    ('load.mass1=+-20 %', 'load.mass2=+-20 %')
    """
    masses, names = [], []
    for parameter in list_parameters(scenario):
        if parameter.part in ("load", "robot") and parameter.unit == "kg" and parameter.nominal:
            masses.append(parameter)
        if parameter.part == "robot" and parameter.name.endswith(".strength"):
            names.append(parameter.name)
    if not names:
        muscles = scenario.joint.muscles  # type: ignore[attr-defined]  # of no robot
        pulling = [number for number, muscle in enumerate(muscles, 1) if muscle.law.pulls]
        names = [f"joint.muscle{number}.strength" for number in pulling]
    strengths = tuple(f"{name}=+-10 %" for name in names)
    return strengths, tuple(f"{mass.name}=+-20 %" for mass in masses)


def sensor_noise(scenario: StudiedScenario) -> dict[str, float]:
    """Return the sizes [SI] of the noise and the steps of a scenario's sensors by name; 0 is ideal.

    >>> from mckibben.scenario import Scenario
    >>> sensor_noise(Scenario.read("examples/own-joint.yaml"))["sensors.pressure_noise"]
    4000.0
    """
    noise = [p for p in list_parameters(scenario) if p.part == "sensors" and not p.is_integer and p.nominal]
    return {p.name: float(p.nominal or 0.0) for p in noise if p.lower == 0}


def uncertainty(scenario: StudiedScenario) -> tuple[tuple[SweptParameter, ...], ...]:
    """Return the uncertain parameters of a scenario's plant, in groups that vary together.

    Those of the scenario, each alone; without any, the strengths of the muscles by 10 %, the delay of the commands by 2
    ms, and the masses of the load by 20 %.

    Raises `ParameterError` if a text of the scenario is not a distribution of one of its parameters.
    """
    if texts := scenario.uncertain:
        return tuple((swept,) for swept in parse_sweeps(texts, scenario))
    strengths, masses = usual_variation(scenario)
    delay = 1e3 * (scenario.command_delay or 0.0)
    delays = (f"command_delay={max(delay - _DELAY, 0.0)!r}..{delay + _DELAY!r} ms",)
    return tuple(parse_sweeps(texts, scenario) for texts in (strengths, delays, masses) if texts)


def extremes(groups: Sequence[Sequence[SweptParameter]], *, without: Sequence[str] = ()) -> Table:
    """Return the nominal values, then extremes of groups of parameters [SI], the 2.5 and 97.5 % quantiles.

    In a two-level design (R. Plackett and J. Burman, Biometrika 33 (1946) 305) of three groups, the last one is low
    where the others are high, as for a strong muscle, a late valve and a light load.

    Parameters
    ----------
    groups
        Parameters that vary together.
    without
        Names that are left out.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> table = extremes(uncertainty(scenario), without=["load.mass1"])
    >>> print(np.column_stack([table[name] for name in ("joint.muscle1.strength", "command_delay", "load.mass2")]))
    [[1.000e+00 0.000e+00 5.000e-01]
     [9.050e-01 5.000e-05 4.050e-01]
     [1.095e+00 5.000e-05 5.950e-01]
     [9.050e-01 1.950e-03 5.950e-01]
     [1.095e+00 1.950e-03 4.050e-01]]
    """
    from scipy.linalg import hadamard

    signs = -hadamard(1 << len(groups).bit_length())[:, 1 : len(groups) + 1]
    table = {}
    for group, column in zip(groups, signs.T, strict=True):
        for swept in group:
            nominal = swept.distribution.ppf(0.5) if swept.parameter.nominal is None else swept.parameter.nominal
            if swept.name not in without:
                table[swept.name] = np.append(nominal, swept.distribution.ppf((1 + _INSIDE * column) / 2))
    return table
