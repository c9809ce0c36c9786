"""Runs of a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from mckibben.errors import FileError, McKibbenError, Problem, ScenarioError
from mckibben.simulation import AtRest, Batch, CheckedRun, Metrics, checked_run, simulate_many
from mckibben.study.parameters import Known, Table, batched
from mckibben.study.scenario import Scenario


def initial_state(scenario: Scenario) -> AtRest:
    """Initial state of a scenario, at rest; of a batch with one value a run.

    >>> initial_state(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    AtRest(angle=0.0, stiffness=12.0)
    """
    stiffness = scenario.start.stiffness
    return AtRest(scenario.start.angle, math.nan if stiffness is None else stiffness)


def run_scenario(scenario: Scenario, *, source: str = "") -> CheckedRun:
    """Simulate a scenario.

    Parameters
    ----------
    scenario
        Scenario.
    source
        File of the scenario, for errors. Default: its name.

    Returns
    -------
    CheckedRun
        Result, with the scenario's text, and the feasibility of its reference.

    Raises
    ------
    ScenarioError
        If its parts do not fit together.
    """

    @contextmanager
    def building(field: str) -> Iterator[None]:
        try:
            yield
        except FileError:
            raise  # has its own file and line
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
            initial=initial_state(scenario),
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
        Scenario with the nominal values.
    table
        Values [SI] by parameter name, columns of one length; see `mckibben.study.parameters.sample`.
    known
        Plant parameters that the controller's model follows; see `mckibben.study.parameters.batched`.
    metrics, precision, chunk, workers, progress
        As for `simulate_many`.

    Raises
    ------
    ParameterError
        If a row makes no valid scenario; it names the first such row.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.2})
    >>> run_many(scenario, {"load.mass2": [0.4, 0.5]}, metrics=["angle_rmse"]).count
    2
    """
    many = batched(scenario, table, known=known)
    return simulate_many(
        many.plant(),
        many.control(),
        many.reference(),
        duration=scenario.duration,
        control_period=scenario.control_period,
        substeps=scenario.substeps,
        initial=initial_state(many),
        metrics=metrics,
        precision=precision,
        chunk=chunk,
        workers=workers,
        progress=progress,
    )
