"""Session of a scenario on a joint rig, from the file to the recorded run."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.errors import FileError, McKibbenError, Problem, RangeError, RigError, ScenarioError, StoppedError
from mckibben.mechanism.base import joints_in
from mckibben.numerics.compiled import numeric
from mckibben.plant import Plant
from mckibben.result import Column, Listing, Remark, Result, TableColumns, table
from mckibben.rig.backend import Backend, ChannelStatus
from mckibben.rig.bench import JointLimits
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import (
    ControlProgram,
    angles_of,
    probing_torques,
    rated_commands,
    starting_state,
    vented_state,
)
from mckibben.rig.control_loop import (
    Followed,
    RunOutcome,
    RunPlan,
    RunProgress,
    ServiceEstimate,
    control,
    realtime_process_settings,
)
from mckibben.rig.joint_record import Timing, by_laws, columns, measured_run
from mckibben.rig.joint_rig import JointRig, RunConditions
from mckibben.rig.record import Recorder, read_record, segments, software_versions
from mckibben.rig.safety import PROBED, stop_on_signals
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import Feasibility, SimulationResult
from mckibben.simulation.problem import in_order, sampled_reference, sampling_times
from mckibben.simulation.simulate import Reached
from mckibben.storage import mcap
from mckibben.storage.files import file_lock, make_folder
from mckibben.units import HINGE, JointType, deg, ms

_BEYOND = 10 * deg  # of the angle limits beyond the reference, on a hinge
_ABOVE = 1.05  # pressure limit over the rated pressure


class JointRunResult(Result):
    """Result of a run.

    Attributes
    ----------
    outcome
        Outcome of the run.
    result
        Measured motion, pressures and stiffness, with the columns of a simulation; None if the run did not begin.
    timing
        Timing of the loop; meaningless unless the run is `paced`.
    priority
        Priority of the process: "real-time" or "ordinary".
    service
        Stiffness as estimated during the run; None without an estimate.
    """

    files: ClassVar = (*SimulationResult.files, "tracking.png", "tracking.svg")

    outcome: RunOutcome
    result: SimulationResult | None
    timing: Timing
    paced: bool
    priority: str
    service: Followed | None = None

    def verdict(self) -> str:
        """The verdict on the motion, or the reason of a stop, and the outcome of the venting."""
        text = self.result.verdict() if self.result is not None and self.outcome.completed else self.outcome.kind
        return f"{text}; {self.outcome.venting}{f'; {self.service.verdict()}' if self.service else ''}"

    @property
    def joint_type(self) -> JointType:
        return self.result.joint_type if self.result else HINGE

    @property
    def ok(self) -> bool:
        """Whether the run was completed and its motion is ok."""
        return self.outcome.completed and self.result is not None and self.result.ok

    def remarks(self) -> Iterator[Remark]:
        """The reason of a stop, and the remarks on the motion."""
        if not self.outcome.completed:
            yield Remark.severe("run", self.outcome.text)
        yield from self.result.remarks() if self.result else ()

    def declared(self) -> TableColumns:
        """Outcome of the run and of its venting, and the metrics of the motion."""
        columns: dict[str, tuple[Column, object]] = {
            "ended": (Column(title="end of the run"), self.outcome.kind),
            "vented_after": (Column("s", "duration of the venting"), self.outcome.vented_after),
            "remaining_pressure": (Column("Pa", "pressure after the venting", "bar"), self.outcome.remaining),
        }
        return columns | (self.result.declared() if self.result else {})

    @table()
    def timing_of_paced(self) -> Iterator[Listing]:
        """The timing of a paced run."""
        if self.paced:
            yield self.timing.listing(f"{self.priority} priority")

    @table()
    def in_service(self) -> Iterator[Listing]:
        """The stiffness as estimated, over time."""
        if self.service:
            yield self.service.listing()

    def write(self, folder: Path) -> None:
        """Write the files of a simulation."""
        if self.result:
            self.result.save(folder, force=True)


@dataclasses.dataclass(frozen=True)
class JointSession:
    """A scenario on a rig, checked and compiled; `prepare` makes one.

    Parameters
    ----------
    scenario, plant, start, reach
        The scenario, its plant and their start, and what of its reference is attainable: for a robot, remarks.
    backend, limits
        Backend of the rig, and its safety limits.
    plan, program
        Plan of the run, and compiled controller.
    header
        Header of the record.
    """

    scenario: Scenario | RobotScenario
    plant: Plant
    start: PyTree
    reach: Feasibility | tuple[Remark, ...]
    backend: Backend
    limits: JointLimits
    plan: RunPlan
    program: ControlProgram
    header: Mapping[str, object]

    def status(self) -> Iterator[ChannelStatus]:
        """Status of each channel, and of the line; limits in time that allow too much."""
        yield from self.backend.status()
        if (latency := self.backend.latency) > self.limits.late:
            slow = f"a message and its answer take {latency / ms:.3g} ms, limits.late is {self.limits.late / ms:g} ms"
            yield ChannelStatus("line", "", "", f"{slow}: connect it directly")
        if self.leniency:
            yield ChannelStatus("limits", "", self.leniency)

    @property
    def warnings(self) -> Iterator[str]:
        """Unattainable stretches of the reference, and limits in time that allow too much."""
        if isinstance(self.reach, tuple):
            yield from (remark.text for remark in self.reach)
        elif not self.reach.feasible:
            yield self.reach.verdict()
        if self.leniency:
            yield self.leniency

    @property
    def leniency(self) -> str:
        """Warning if a physical joint can cross its range of angles in the time for which samples may be late."""
        limits, wait = self.limits, max(self.limits.late, self.limits.silence)
        rooms = [high - low for name, (low, high) in self.plan.ranges.items() if name.startswith("angle")]
        travel, room = wait * limits.angle_rate, min([limits.highest_angle - limits.lowest_angle, *rooms])
        if not self.backend.physical or travel < room:
            return ""
        allowed = f"late: {limits.late / ms:g} ms and silence: {limits.silence / ms:g} ms hide a slow line"
        far, range_ = (self.plan.channels.joint_type.show(size, "deg", 3) for size in (travel, room))
        moved = f"meanwhile the joint may move by {far}, and its range is {range_}"
        return f"{allowed}: {moved}; by default they are {JointLimits.late / ms:g} and {JointLimits.silence / ms:g} ms"

    def run(
        self,
        folder: str | os.PathLike[str],
        *,
        progress: Callable[[RunProgress], None] | None = None,
        service: ServiceEstimate | None = None,
    ) -> JointRunResult:
        """Run the scenario and record it in a folder that holds no record; `progress` is called each period.

        An estimate in `service` gets the samples, and its numbers become those of the controller.

        Raises
        ------
        FileError
            If the folder cannot be written to, or holds a record.
        RigError
            If the rig is not connected, or does not match, before anything moves.
        StoppedError
            If the folder was removed during the run, which was stopped and vented.
        """
        folder, outcome = make_folder(folder), None
        with (
            file_lock(folder / "lock", "running a joint rig"),
            stop_on_signals() as stop_flag,
            realtime_process_settings() if self.backend.paced else nullcontext("ordinary") as priority,
        ):
            header = {**self.header, "priority": priority}
            attached = {"scenario.yaml": self.scenario.dumps().encode()}
            try:
                with Recorder(folder, header, self.columns, attached) as recorder:
                    outcome = control(
                        self.backend,
                        self.program,
                        self.plan,
                        self.limits,
                        recorder,
                        stop_flag=stop_flag,
                        progress=progress,
                        service=service,
                    )
            except RigError as error:
                if outcome is None:
                    raise
                if outcome.completed:  # the end of the record was not written
                    outcome = dataclasses.replace(outcome, kind="rig", text=str(error), error=error)
        if not segments(folder):  # it was removed
            raise StoppedError(f"stopped: {outcome.text}; {outcome.venting}")
        table, paced = read_record(folder).columns, self.backend.paced
        timing, result = Timing.of(table, self.plan.period), self.measured(table)
        if result is not None and paced:
            result = dataclasses.replace(result, missed=timing.missed, deadlines=timing.periods)
        followed = None if service is None else service.result()
        return JointRunResult(outcome, result, timing, paced, priority, followed)

    @property
    def columns(self) -> list[mcap.Column]:
        """Columns of the record."""
        return columns(self.program.telemetry, self.plan.channels)

    def measured(self, table: Mapping[str, NDArray[np.float64]]) -> SimulationResult | None:
        """Result of the columns of a record; None if the run did not begin."""
        text, run = self.scenario.dumps(), (self.start, self.plan.channels, self.plan.period)
        if not isinstance(self.reach, Feasibility):
            return measured_run(table, self.plant, *run, scenario=text, notes=self.reach)
        amplitude, plant = self.scenario.controller.stiffness_amplitude, by_laws(self.plant)  # type: ignore
        return measured_run(table, plant, *run, reach=self.reach, stiffness_amplitude=amplitude, scenario=text)


def prepare(
    scenario: Scenario | RobotScenario,
    rig: JointRig | None = None,
    *,
    source: str = "",
    paced: bool = True,
    ideal: bool = False,
    firmware: Scenario | RobotScenario | None = None,
) -> JointSession:
    """Check and compile a scenario for a rig (default: the simulated joint or robot).

    Parameters
    ----------
    source
        The scenario's file, for messages.
    paced
        Whether the simulated joint runs in real time.
    ideal
        Whether the simulated joint has ideal sensors and starts pressurised, at the scenario's start, instead of
        vented: its run is then that of a simulation, to rounding.
    firmware
        The scenario that the firmware of a board has to be made from (default: the same).

    Raises
    ------
    ScenarioError
        If parts of the scenario contradict each other, or a calibration cannot be read.
    """
    rig, source = rig or JointRig.parse("rig: simulated"), source or scenario.name
    if ideal and rig.physical:
        raise ScenarioError(rig.name, [Problem("is not a simulated joint", remedy="leave --ideal out")])
    period, channels = scenario.control_period, Channels.of(scenario)
    with _building(source, "joint, load or valve"):
        plant = scenario.plant()
    with _building(source, "start"):
        start = starting_state(scenario, plant)
    with _building(source, "joint, load or valve"):
        vented = vented_state(plant, start)
    with _building(source, "controller"):
        controller = scenario.control().with_period(period)
        if getattr(controller, "samples_ahead", 0):
            message, remedy = "a rig gives no setpoints ahead", "leave preview out"
            raise RangeError(message, field="controller.preview", remedy=remedy)
        program = ControlProgram(controller, channels)
    with _building(source, "start"):
        times = sampling_times(scenario.timing["duration"], period)
        setpoints = in_order(plant, sampled_reference(scenario.references(), times))
        by_joint = zip(*joints_in(setpoints), strict=True)
        references = np.concatenate([np.stack(columns, axis=1) for columns in by_joint], axis=1)
        reached = Reached(plant, numeric(plant), times, setpoints)
        reach = reached.by(scenario.control()) or tuple(reached.notes())
    approach, angles = rig.approach, references[:, : len(channels.joints)]
    extremes = np.vstack([angles.min(axis=0), angles.max(axis=0), angles_of(plant, start), angles_of(plant, vented)])
    limits, ranges = _limits(rig, plant, channels, extremes)
    plan = RunPlan(
        references=references,
        period=period,
        probing=round(approach.probing * len(channels.muscles) / 2 / period) if rig.physical else 0,
        torques=probing_torques(plant, vented, PROBED) if rig.physical else (),
        raising=0 if ideal else round(approach.raising / period),
        settling=0 if ideal else round(approach.settling / period),
        pressures=tuple(map(float, start.pressures)),
        command_limits=rated_commands(plant),
        channels=channels,
        ranges=ranges,
    )
    substeps, digest = 1 if rig.physical else scenario.needed_substeps(), (firmware or scenario).digest
    begun = start if ideal else vented
    conditions = RunConditions(period, rig.patience, substeps, paced, begun, ideal, digest, channels)
    backend = rig.rig.backend(plant, conditions)
    header = {
        "what": "joint rig",
        "scenario": scenario.dumps(),
        "rig": rig.to_json(),
        "backend": dict(backend.description),
        "limits": {name: value for name, value in vars(limits).items() if np.isfinite(value)},
        "ranges": {name: [end for end in ends if np.isfinite(end)] for name, ends in ranges.items()},
        "plan": {
            "probing": plan.probing,
            "raising": plan.raising,
            "settling": plan.settling,
            "run": len(references),
            "period": period,
        },
        "versions": software_versions("jax", "numpy"),
    }
    return JointSession(scenario, plant, start, reach, backend, limits, plan, program, header)


def _limits(
    rig: JointRig, plant: Plant, channels: Channels, extremes: NDArray[np.float64]
) -> tuple[JointLimits, dict[str, tuple[float, float]]]:
    """Limits of all joints and muscles, and those of each of a robot by input, where they differ.

    Parameters
    ----------
    extremes
        Angles [rad] that each joint takes, shape (angles, joints).
    """
    given = {name: value for name, value in rig.limits if value is not None}
    beyond = _BEYOND * channels.joint_type.scale
    lowest, highest = (extremes.min(axis=0) - beyond).tolist(), (extremes.max(axis=0) + beyond).tolist()
    pressures = [_ABOVE * high for _, high in rated_commands(plant)]
    widest = {"lowest_angle": min(lowest), "highest_angle": max(highest), "pressure": max(pressures)}
    rate = JointLimits.angle_rate * channels.joint_type.scale
    limits = JointLimits(**{"angle_rate": rate} | widest | given)
    if not channels.is_named:
        if rig.limits_of:
            raise _no_limit(rig, next(iter(rig.limits_of)), "give `limits`: the joint has no name")
        return limits, {}
    ends = zip(lowest, highest, strict=True)
    defaults = [{"lowest_angle": low, "highest_angle": high} for low, high in ends]
    defaults += [{"pressure": pressure} for pressure in pressures]
    return limits, _own_limits(rig, channels, given, defaults)


def _own_limits(
    rig: JointRig, channels: Channels, given: Mapping[str, float], defaults: Sequence[Mapping[str, float]]
) -> dict[str, tuple[float, float]]:
    """Lowest and highest value by input: its own limits, those of all, or the defaults of its joint or muscle."""
    names = [end[1:] for end in (*channels.joints, *channels.muscles)]
    limits_of = {
        name: {key: value for key, value in limits if value is not None} for name, limits in rig.limits_of.items()
    }
    defaults_of = dict(zip(names, defaults, strict=True))
    for name, settings in limits_of.items():
        if not settings.keys() <= defaults_of.get(name, {}).keys():
            choice = "; ".join(f"{part}: {', '.join(values)}" for part, values in defaults_of.items())
            raise _no_limit(rig, name, f"choose from {choice}")
    ranges = {}
    for reading, name in zip(channels.readings, names, strict=True):
        values = {key: given.get(key, default) for key, default in defaults_of[name].items()} | limits_of.get(name, {})
        ranges[reading] = values.get("lowest_angle", -math.inf), [*values.values()][-1]
        if not ranges[reading][0] < ranges[reading][1]:
            raise _no_limit(rig, name, "give both ends, the lower one first")
    return ranges


def _no_limit(rig: JointRig, name: str, remedy: str) -> ScenarioError:
    """Error of a limit that no joint or muscle has."""
    return ScenarioError(rig.name, [Problem("is no such limit", field=f"limits_of.{name}", remedy=remedy)])


@contextmanager
def _building(source: str, field: str) -> Iterator[None]:
    """Add the affected part of the scenario to an error."""
    try:
        yield
    except FileError:
        raise  # names a file and a place itself
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field=field)]) from error
