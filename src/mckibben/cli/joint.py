"""Commands on a joint: `simulate`, `envelope`, `stiffness`, `margins`, and `size`, which finds one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.cli.command import command
from mckibben.cli.options import (
    Progress,
    ScenarioFile,
    keeping,
    parse_limits,
    parse_pair,
    parse_quantity,
    results_folder,
)

if TYPE_CHECKING:
    from mckibben.reachability import Envelope, Selection
    from mckibben.simulation import Margins, SimulationResult
    from mckibben.study.stiffness import FeltStiffness


@command
def simulate(scenario: ScenarioFile, animate: Path | None = None, *, force: bool) -> SimulationResult:
    """Simulate a scenario: a controller on a joint, or on all joints of a robot.

    Parameters
    ----------
    animate : FILE
        Write an animation of the joint or robot, as .webp or .gif.
    """
    if animate:  # report mistakes before the run
        from mckibben.report.animation import animation_format

        animation_format(animate)
        results_folder(animate.parent, [animate.name], force)
    from mckibben.scenario import Scenario

    read = Scenario.read(scenario)
    result = read.run_once(source=str(scenario))
    if animate:
        from mckibben import report

        with keeping(animate.parent):
            report.animate(result, animate, read.plant(), overwrite=True)
    return result


@command
def envelope(scenario: ScenarioFile, *, progress: Progress = None) -> Envelope:
    """Show the attainable set of each joint, whether its reference is feasible, and what would be."""
    from mckibben import reachability
    from mckibben.scenario import Scenario

    return reachability.envelope(Scenario.read(scenario), progress=progress)


@command
def stiffness(
    scenario: ScenarioFile,
    motion: str | None = None,
    push: str | None = None,
    *,
    progress: Progress = None,
) -> FeltStiffness:
    """Measure the stiffness that a push of each joint feels at the setpoint held by the controller, and that over
    amplitude and rate of a motion.

    Of a robot one joint after the other is pushed, and the controller holds the others.

    Parameters
    ----------
    motion : RANGES
        Amplitudes and rates of the motion, by default 0.01..10 deg, of a slide 0.01..10 mm, and 0.1..10 Hz; of a robot
        only if given, as it takes minutes.
    push : TORQUE
        Amplitude of the push, of a slide a force (default: a tenth of half the range that the joint attains).
    """
    import numpy as np

    from mckibben.component.checks import check_positive
    from mckibben.scenario import Scenario
    from mckibben.study.felt import felt_stiffness
    from mckibben.study.stiffness import FeltStiffness, stiffness_tests

    read = Scenario.read(scenario)
    kind = read.joint_type
    torque = None if push is None else parse_quantity("--push", push, kind.unit("N*m"), positive=True)
    usual = f"0.01..10 {kind.shown('deg')}, 0.1..10 Hz"
    first, second = parse_pair("--motion", usual if motion is None else motion, usual)
    amplitudes, rates = parse_limits("--motion", first, kind.unit("rad")), parse_limits("--motion", second, "Hz")
    check_positive("--motion", kind.unit("rad"), amplitude=amplitudes[0])
    check_positive("--motion", "Hz", rate=rates[0])
    if read.joint_names and motion is None:
        return FeltStiffness(read, felt_stiffness(read, torque=torque, progress=progress))
    grid = np.unique(np.geomspace(*amplitudes, 13)), np.unique(np.geomspace(*rates, 5))
    return stiffness_tests(read, *grid, torque=torque, progress=progress)


@command
def margins(scenario: ScenarioFile) -> Margins:
    """Compute the stability margins of the sampled loop at operating points along the reference."""
    from mckibben.scenario import Scenario

    return Scenario.read(scenario).margins()


@command
def size(requirement: Path) -> Selection:
    """Size a joint: muscles and pulleys, or lengths of a given joint, with valves and air supply; simulate it.

    Parameters
    ----------
    requirement : REQUIREMENT.yaml
        Load, motion, stiffness and supply, see docs/size.md.
    """
    from mckibben.reachability import Requirement
    from mckibben.reachability import size as run

    return run(Requirement.read(requirement)).simulated()
