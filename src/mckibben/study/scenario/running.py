"""Runs of a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from mckibben.errors import FileError, McKibbenError, Problem, ScenarioError
from mckibben.simulation import AtRest, Batch, CheckedRun, Metrics, checked_run, simulate_many
from mckibben.study.parameters import Known, Table, lanes
from mckibben.study.scenario import Scenario


def rest(scenario: Scenario) -> AtRest:
    """The rest to start from; its numbers may be arrays with one value a run.

    >>> rest(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    AtRest(angle=0.0, stiffness=12.0)
    """
    stiffness = scenario.start.stiffness
    return AtRest(scenario.start.angle, math.nan if stiffness is None else stiffness)


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
            raise ScenarioError(source or scenario.name, [Problem.of(error, field=field)]) from error

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


def run_many(
    scenario: Scenario,
    table: Table,
    *,
    known: Known = (),
    metrics: Sequence[str] = Metrics._fields,
    precision: int = 64,
    chunk: int | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Batch:
    """Simulate a scenario once for each row of a table of values.

    Parameters
    ----------
    scenario
        What all runs share.
    table
        Arrays of one length by the names of the scenario's fields, SI; see `mckibben.study.parameters.sampling`.
    known
        Numbers of the plant that the controller's model follows; see `mckibben.study.parameters.values`.
    metrics, precision, chunk, workers, progress
        As for `simulate_many`.

    Raises
    ------
    ParameterError
        If a row of the table makes no valid scenario; it names the first.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.2})
    >>> run_many(scenario, {"load.mass2": [0.4, 0.5]}, metrics=["angle_rmse"]).count
    2
    """
    many = lanes(scenario, table, known=known)
    return simulate_many(
        many.plant(),
        many.control(),
        many.reference(),
        duration=scenario.duration,
        control_period=scenario.control_period,
        substeps=scenario.substeps,
        initial=rest(many),
        metrics=metrics,
        precision=precision,
        chunk=chunk,
        workers=workers,
        progress=progress,
    )
