"""Run a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mckibben.errors import FileError, McKibbenError, Problem, ScenarioError
from mckibben.simulation import CheckedRun, checked_run
from mckibben.study.scenario import Scenario
from mckibben.study.starting import rest


def run_scenario(scenario: Scenario, *, source: str = "") -> CheckedRun:
    """Simulate a scenario.

    Parameters
    ----------
    scenario
        What to run.
    source
        The file that it came from, for messages; its name unless given.

    Returns
    -------
    CheckedRun
        The result, which carries the scenario's text, and the reach of its reference.

    Raises
    ------
    ScenarioError
        If its parts make no sense together; it names the part.
    """

    @contextmanager
    def building(field: str) -> Iterator[None]:
        try:
            yield
        except FileError:
            raise  # names a file and a place itself
        except McKibbenError as error:
            raise ScenarioError(source or scenario.name, [Problem(str(error), field=field)]) from error

    with building("joint, load or valve"):
        plant = scenario.plant()
    with building("controller"):
        control = scenario.control()
    with building("start"):  # all else has been checked
        return checked_run(
            plant,
            control,
            scenario.reference(),
            duration=scenario.duration,
            control_period=scenario.control_period,
            substeps=scenario.substeps,
            initial=rest(scenario),
            scenario=scenario.dumps(),
        )
