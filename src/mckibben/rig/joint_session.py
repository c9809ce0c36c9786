"""Session of a scenario on a joint rig, from the file to the recorded run."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mckibben.errors import FileError, McKibbenError, Problem, RangeError, RigError, ScenarioError, StoppedError
from mckibben.plant import JointPlant
from mckibben.result import Column, Listing, Remark, Result, TableColumns
from mckibben.rig.backend import Backend, ChannelStatus
from mckibben.rig.bench import JointLimits
from mckibben.rig.compiled import ControlProgram, probing_torques, vented_angle
from mckibben.rig.control_loop import RunOutcome, RunPlan, RunProgress, control, realtime_process_settings
from mckibben.rig.joint_record import Timing, columns, measured_result
from mckibben.rig.joint_rig import JointRig, RunConditions
from mckibben.rig.record import Recorder, read_record, segments, software_versions
from mckibben.rig.safety import PROBED, stop_on_signals
from mckibben.rig.simulated.joint import rated_commands
from mckibben.scenario import Scenario
from mckibben.simulation import Feasibility, SimulationResult, check_reference, sampled
from mckibben.storage.files import file_lock, make_folder
from mckibben.units import deg, ms

_BEYOND = 10 * deg  # of the angle limits beyond the reference
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
    """

    files: ClassVar = (*SimulationResult.files, "tracking.png", "tracking.svg")

    outcome: RunOutcome
    result: SimulationResult | None
    timing: Timing
    paced: bool
    priority: str

    def verdict(self) -> str:
        """The outcome of the run, its missed deadlines, and the outcome of the venting."""
        text = self.result.verdict() if self.result is not None and self.outcome.completed else self.outcome.kind
        missed = f"; {self.timing.missed} of {self.timing.periods} deadlines missed" * (
            self.paced and self.timing.missed > 0
        )
        return f"{text}{missed}; {self.outcome.venting}"

    def remarks(self) -> Iterator[Remark]:
        """The reason of a stop, and the remarks on the motion."""
        if not self.outcome.completed:
            yield Remark.severe("run", self.outcome.text)
        yield from self.result.remarks() if self.result else ()

    def declared(self) -> TableColumns:
        """Outcome of the run and of its venting, and the metrics of the motion."""
        own: dict[str, tuple[Column, object]] = {
            "ended": (Column(title="end of the run"), self.outcome.kind),
            "vented_after": (Column("s", "duration of the venting"), self.outcome.vented_after),
            "remaining_pressure": (Column("Pa", "pressure after the venting", "bar"), self.outcome.remaining),
        }
        return own | (self.result.declared() if self.result else {})

    def listings(self) -> Iterator[Listing]:
        """The metrics of the motion, and the timing of a paced run."""
        yield from self.result.listings() if self.result else ()
        if self.paced:
            yield self.timing.listing(f"{self.priority} priority")

    def write(self, folder: Path) -> None:
        """Write the files of a simulation."""
        if self.result:
            self.result.save(folder, force=True)


@dataclasses.dataclass(frozen=True)
class JointSession:
    """A scenario on a rig, checked and compiled; `prepare` makes one.

    Parameters
    ----------
    scenario, plant, reach
        The scenario, its plant, and the feasibility of its reference.
    backend, limits
        Backend of the rig, and its safety limits.
    plan, program
        Plan of the run, and compiled controller.
    header
        Header of the record.
    """

    scenario: Scenario
    plant: JointPlant
    reach: Feasibility
    backend: Backend
    limits: JointLimits
    plan: RunPlan
    program: ControlProgram
    header: Mapping[str, Any]

    def status(self) -> Iterator[ChannelStatus]:
        """Status of each channel, and of the line; limits in time that allow too much."""
        yield from self.backend.status()
        if (latency := self.backend.latency) > self.limits.late:
            slow = f"a message and its answer take {latency / ms:.3g} ms, limits.late is {self.limits.late / ms:g} ms"
            yield ChannelStatus("line", "", "", f"{slow}: connect it directly")
        if self.leniency:
            yield ChannelStatus("limits", "", self.leniency)

    @property
    def leniency(self) -> str:
        """Warning if a physical joint can cross its range of angles in the time for which samples may be late."""
        limits, wait = self.limits, max(self.limits.late, self.limits.silence)
        travel, room = wait * limits.angle_rate, limits.highest_angle - limits.lowest_angle
        if not self.backend.physical or travel < room:
            return ""
        allowed = f"late: {limits.late / ms:g} ms and silence: {limits.silence / ms:g} ms hide a slow line"
        moved = f"meanwhile the joint may move by {travel / deg:.0f} deg, and its range is {room / deg:.0f} deg"
        return f"{allowed}: {moved}; by default they are {JointLimits.late / ms:g} and {JointLimits.silence / ms:g} ms"

    def run(
        self,
        folder: str | os.PathLike[str],
        *,
        progress: Callable[[RunProgress], None] | None = None,
    ) -> JointRunResult:
        """Run the scenario and record it in a folder that holds no record; `progress` is called each period.

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
                with Recorder(folder, header, columns(self.program.telemetry), attached) as recorder:
                    outcome = control(
                        self.backend,
                        self.program,
                        self.plan,
                        self.limits,
                        recorder,
                        stop_flag=stop_flag,
                        progress=progress,
                    )
            except RigError as error:
                if outcome is None:
                    raise
                if outcome.completed:  # the end of the record was not written
                    outcome = dataclasses.replace(outcome, kind="rig", text=str(error), error=error)
        if not segments(folder):  # it was removed
            raise StoppedError(f"stopped: {outcome.text}; {outcome.venting}")
        table = read_record(folder).columns
        period = self.plan.period
        text = self.scenario.dumps()
        result = measured_result(
            table, self.plant, self.reach, period, self.scenario.controller.stiffness_amplitude, scenario=text
        )
        return JointRunResult(outcome, result, Timing.of(table, period), self.backend.paced, priority)


def prepare(
    scenario: Scenario,
    rig: JointRig | None = None,
    *,
    source: str = "",
    paced: bool = True,
    ideal: bool = False,
    firmware: Scenario | None = None,
) -> JointSession:
    """Check and compile a scenario for a rig (default: the simulated joint).

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
    rig = rig or JointRig.parse("rig: simulated")
    if ideal and rig.physical:
        raise ScenarioError(rig.name, [Problem("is not a simulated joint", remedy="leave --ideal out")])
    with _building(source or scenario.name, "joint, load or valve"):
        plant = scenario.plant()
        hanging = vented_angle(plant)
    with _building(source or scenario.name, "controller"):
        controller = scenario.control().with_period(scenario.control_period)
        if controller.samples_ahead:
            message, remedy = "a rig gives no setpoints ahead", "leave preview out"
            raise RangeError(message, field="controller.preview", remedy=remedy)
        program = ControlProgram(controller)
    period = scenario.control_period
    with _building(source or scenario.name, "start"):
        start = scenario.initial(plant)
        reach = check_reference(
            plant,
            scenario.reference(),
            duration=scenario.duration,
            control_period=period,
            stiffness_amplitude=scenario.controller.stiffness_amplitude,
        )
    _, setpoints = sampled(scenario.reference(), scenario.duration, period)
    references = np.stack([np.asarray(setpoints.angle), np.asarray(setpoints.stiffness)], axis=1)
    approach = rig.approach
    plan = RunPlan(
        references=references,
        period=period,
        probing=round(approach.probing / period) if rig.physical else 0,
        torques=probing_torques(plant, hanging, PROBED) if rig.physical else (0.0, 0.0),
        raising=0 if ideal else round(approach.raising / period),
        settling=0 if ideal else round(approach.settling / period),
        pressures=(float(start.pressures[0]), float(start.pressures[1])),
        command_limits=rated_commands(plant),
    )
    limits = _limits(rig, plant, references[:, 0], (float(start.angle), hanging))
    substeps = 1 if rig.physical else scenario.needed_substeps()
    conditions = RunConditions(
        period, rig.patience, substeps, paced, start if ideal else None, (firmware or scenario).digest
    )
    backend = rig.rig.backend(plant, conditions)
    header = {
        "what": "joint rig",
        "scenario": scenario.dumps(),
        "rig": rig.to_json(),
        "backend": dict(backend.description),
        "limits": {name: value for name, value in vars(limits).items() if np.isfinite(value)},
        "plan": {
            "probing": plan.probing,
            "raising": plan.raising,
            "settling": plan.settling,
            "run": len(references),
            "period": period,
        },
        "versions": software_versions("jax", "numpy"),
    }
    return JointSession(scenario, plant, reach, backend, limits, plan, program, header)


def _limits(rig: JointRig, plant: JointPlant, angles: np.ndarray, others: tuple[float, ...]) -> JointLimits:
    given = {name: value for name, value in rig.limits if value is not None}
    extremes = [float(angles.min()), float(angles.max()), *others]
    defaults = {
        "lowest_angle": min(extremes) - _BEYOND,
        "highest_angle": max(extremes) + _BEYOND,
        "pressure": _ABOVE * max(high for _, high in rated_commands(plant)),
    }
    return JointLimits(**defaults | given)


@contextmanager
def _building(source: str, field: str) -> Iterator[None]:
    """Add the affected part of the scenario to an error."""
    try:
        yield
    except FileError:
        raise  # names a file and a place itself
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field=field)]) from error
