"""Methods of lower classes whose work is done by packages above them: all arrows of the code that would point upwards.

Imports are within the functions, so that ``import mckibben`` stays light.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.binding import bind

if TYPE_CHECKING:
    from jaxtyping import PyTree
    from matplotlib.figure import Figure

    from mckibben.export.targets import Exported
    from mckibben.identification import FitWithFriction
    from mckibben.joint import AntagonisticJoint
    from mckibben.reachability import Envelope
    from mckibben.scenario import Scenario, StudiedScenario
    from mckibben.scenario.robot import RobotScenario
    from mckibben.study.compare import CompareResult, Suite
    from mckibben.study.compare.robots import RobotSuite
    from mckibben.study.compare.settings import ComparedCalibration
    from mckibben.study.tune import TuneResult


@bind
def draw(figure: str, *shown: object) -> Figure:
    """Figure of `mckibben.report` that shows a result."""
    from mckibben import report

    return getattr(report, figure)(*shown)


@bind
def save_figure(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure of a result to a folder."""
    from mckibben.report import save

    save(figure, folder, name)


@bind
def png_of(figure: Figure) -> bytes:
    """Return a figure of a result as PNG, for a notebook."""
    from mckibben.report import png_of

    return png_of(figure)


@bind
def register_catalog() -> None:
    """Register the published components, which files can name."""
    import mckibben.catalog.entries  # noqa: F401


@bind
def starting_scenario(joint: AntagonisticJoint, load: object, sections: Mapping[str, object]) -> Scenario:
    """`AntagonisticJoint.scenario`."""
    from mckibben.scenario import starting_scenario

    return starting_scenario(joint, load, sections)


@bind
def write_identified(path: Path, fit: FitWithFriction) -> None:
    """Write the muscle of a fit."""
    from mckibben.scenario import write_identified

    write_identified(path, fit, fit.points.table.attrs)


@bind
def check_uncertainty(scenario: Scenario) -> None:
    """Raise a `ParameterError` if the uncertainty of a scenario is not that of its parameters."""
    from mckibben.study.parameters import parse_sweeps

    parse_sweeps(scenario.uncertainty or (), scenario)


@bind
def envelope(scenario: Scenario) -> Envelope:
    """`Scenario.envelope`."""
    from mckibben.reachability import envelope

    return envelope(scenario)


@bind
def tune(scenario: StudiedScenario, over: PyTree, cost: PyTree, **options: PyTree) -> TuneResult:
    """`Scenario.tune`."""
    from mckibben.study.tune import tune

    return tune(scenario, over, cost, **options)


@bind
def joint_suite(scenario: Scenario, controllers: PyTree, **settings: PyTree) -> Suite:
    """`Scenario.suite`."""
    from mckibben.study.compare import Suite

    return Suite.of(scenario, controllers, **settings)


@bind
def robot_suite(scenario: RobotScenario, controllers: PyTree, **settings: PyTree) -> RobotSuite:
    """`RobotScenario.suite`."""
    from mckibben.study.compare.robots import RobotSuite

    return RobotSuite.of(scenario, controllers, **settings)


@bind
def compare(suite: Suite | RobotSuite, out: Path | None) -> CompareResult:
    """`Scenario.compare`."""
    from mckibben.study.compare import compare

    return compare(suite, out=out)


@bind
def calibrated_models(scenario: Scenario, settings: ComparedCalibration) -> PyTree:
    """Joint and load of a controller's model, calibrated on the plant of a scenario; None if that is not possible."""
    from mckibben.calibration import JointPrior, Sweeps
    from mckibben.calibration.experiment import simulated_calibration
    from mckibben.errors import McKibbenError
    from mckibben.plant import NoDisturbance

    weight = {"added_mass": settings.weight, "distance": settings.distance}
    sweeps = Sweeps(-settings.angle, settings.angle, 60.0, **weight)
    try:
        calm = scenario.model_copy(update={"disturbance": NoDisturbance()})
        model = simulated_calibration(calm, sweeps, JointPrior()).model
    except McKibbenError:
        return None
    return {"model": model.joint, "load": model.load}


@bind
def export(scenario: Scenario | RobotScenario, target: str, out: PathLike[str] | str, **options: PyTree) -> Exported:
    """`Scenario.export`."""
    from mckibben.export import export

    return export(scenario, target, out, **options)
