"""A scenario on a joint rig, from the file to the recorded run."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

import mckibben
from mckibben.errors import FileError, McKibbenError, Problem, RigError, ScenarioError
from mckibben.plant import JointPlant, PlantState
from mckibben.realtime.compiled_step import ControlProgram, vented_angle
from mckibben.realtime.config import Connected, JointCardSpec, JointRig, Wiring
from mckibben.realtime.limits import Course, Ending, JointLimits, Shown, Watch
from mckibben.realtime.loop import Loop, StopFlag, Timing, signals_told, undisturbed
from mckibben.realtime.record import Rows, columns, measured_result
from mckibben.realtime.simulated import PERFECT, Sensing, VirtualJoint
from mckibben.rig.backend import Backend
from mckibben.rig.calibration import calibrations_in, content_of
from mckibben.rig.record import read_record
from mckibben.rig.recorder import Recorder
from mckibben.simulation import Reach, Result, check_reference, sampled
from mckibben.storage.files import file_lock, make_folder
from mckibben.study.scenario import Scenario
from mckibben.units import deg


def control(
    backend: Backend,
    program: ControlProgram,
    course: Course,
    limits: JointLimits,
    recorder: Recorder,
    *,
    wiring: Wiring | None = None,
    told: StopFlag | None = None,
    show: Callable[[Shown], None] | None = None,
) -> Ending:
    """Open a backend, run a controller on it, vent it and close it; what happened is recorded.

    Parameters
    ----------
    backend
        The joint.
    program
        The controller.
    course
        What it is to do.
    limits
        What may not be exceeded.
    recorder
        With the columns of `rows.columns`; it is left open.
    wiring
        What the volts mean.
    told
        Of signals; one of them stops the run.
    show
        Called each period; it must return at once.

    Returns
    -------
    Ending
        Of the run, or of what stopped it if that was foreseen. Any other exception is raised again, after the vent.

    Raises
    ------
    RigError
        If the backend does not fit: before anything moves.
    """
    connected = (wiring or Wiring()).connected(backend)
    _check(backend, course, connected)
    rows = Rows(recorder, program.telemetry)
    loop = Loop(backend, program, course, Watch(limits, course.period), rows, connected, told or StopFlag(), show)
    try:
        backend.open()
    except BaseException:
        backend.close()
        raise
    try:
        rows.event("opened", "", backend=dict(backend.described))
        loop.run()
        ending = Ending("completed", f"completed {len(course.wishes) * course.period:g} s")
    except McKibbenError as error:
        backend.vent()
        ending = Ending(_kind(error), str(error), error)
    except BaseException as error:
        try:
            backend.vent()
            _note(rows, "failed", f"{type(error).__name__}: {error}")
        finally:
            backend.close()
        raise
    else:
        backend.vent()
    try:
        _note(rows, ending.kind, ending.text)
        after = loop.watch_venting()
        vented = "not seen to be vented" if after is None else f"both pressures below 0.2 bar after {after:.3g} s"
        _note(rows, "vented" if after is not None else "not vented", vented)
    finally:
        backend.close()
    return Ending(ending.kind, ending.text, ending.error, after)


def _check(backend: Backend, course: Course, connected: Connected) -> None:
    """Raise before anything moves."""
    if not math.isclose(backend.rate * course.period, 1.0, rel_tol=1e-9):
        raise RigError(
            f"the rig takes {backend.rate:g} samples a second, and the control period is {course.period * 1e3:g} ms",
            remedy="set both alike",
        )
    if backend.patience < 3 * course.period:
        raise RigError(
            f"the rig waits {backend.patience:g} s for the host before it vents, and a period has {course.period:g} s",
            value=backend.patience,
            lower=3 * course.period,
            unit="s",
            remedy="give it the patience of some periods",
        )
    lowest, highest = zip(*course.limited_to, strict=True)
    problems = connected.check(min(*lowest, 0.0), max(highest))
    if problems:
        raise RigError("the valves cannot give what is asked for: " + "; ".join(map(str, problems)))


def _kind(error: McKibbenError) -> str:
    names = {"SignalledError": "signal", "SilentError": "silent", "StoppedError": "stopped", "RigError": "rig"}
    return names.get(type(error).__name__, "failed")


def _note(rows: Rows, kind: str, text: str) -> None:
    """Record what happened; a recorder that cannot is what happened, and then everything is vented already."""
    with contextlib.suppress(McKibbenError):
        rows.flush()
    with contextlib.suppress(McKibbenError):
        rows.event(kind, text)


_BEYOND = 10 * deg
_ABOVE = 1.05


class Ran(NamedTuple):
    """What came of a run.

    Attributes
    ----------
    ending
        How it ended.
    result
        What was measured, as a simulation would have it; None if it did not come so far.
    reach
        Of the reference.
    timing
        How well the loop kept its time; of an unpaced run it says nothing.
    priority
        Of the loop: "real-time" or "ordinary".
    """

    ending: Ending
    result: Result | None
    reach: Reach
    timing: Timing
    priority: str


@dataclasses.dataclass(frozen=True)
class Session:
    """A scenario and the rig that it is about to be run on, checked and compiled.

    Attributes
    ----------
    scenario
        What is to be done.
    plant
        What the joint is believed to be.
    reach
        Of the reference.
    backend, wiring, limits, course, program
        As `control` takes them.
    header
        Of the record.
    """

    scenario: Scenario
    plant: JointPlant
    reach: Reach
    backend: Backend
    wiring: Wiring
    limits: JointLimits
    course: Course
    program: ControlProgram
    header: Mapping[str, Any]

    def run(self, folder: str | os.PathLike[str], *, show: Callable[[Shown], None] | None = None) -> Ran:
        """Run it into a folder.

        Parameters
        ----------
        folder
            Where the record goes; it must not hold one.
        show
            Called each period; it must return at once.

        Raises
        ------
        FileError
            If the folder cannot be written to, or holds a record.
        RigError
            If the rig is not there, or does not fit: before anything moves.
        """
        folder = make_folder(folder)
        with file_lock(folder / "lock", "running a joint rig"), signals_told() as told, undisturbed() as priority:
            header = {**self.header, "priority": priority}
            with Recorder.create(folder, header, columns(self.program.telemetry)) as recorder:
                try:
                    ending = control(
                        self.backend,
                        self.program,
                        self.course,
                        self.limits,
                        recorder,
                        wiring=self.wiring,
                        told=told,
                        show=show,
                    )
                except RigError:
                    if recorder.rows == 0:  # nothing has moved: the folder may be used again
                        recorder.close()
                        recorder.path.unlink()
                    raise
        table = read_record(folder).columns
        period = self.course.period
        text = self.scenario.dumps()
        result = measured_result(table, self.plant, self.reach, period, scenario=text)
        return Ran(ending, result, self.reach, Timing.of(table, period), priority)


def prepared(
    scenario: Scenario,
    rig: JointRig | None = None,
    *,
    source: str = "",
    paced: bool = True,
    ideal: bool = False,
) -> Session:
    """Make ready what a scenario needs on a rig: all that can be wrong with it is said here.

    Parameters
    ----------
    scenario
        What to run.
    rig
        On what; the virtual joint unless given.
    source
        The scenario's file, for messages.
    paced
        Whether the virtual joint runs in real time.
    ideal
        Whether it is measured perfectly and starts where the scenario does, under pressure, instead of vented: then
        its run is that of a simulation, to rounding.

    Raises
    ------
    ScenarioError
        If parts of the scenario make no sense together, or a calibration cannot be read.
    """
    rig = rig or JointRig.model_validate({"virtual": {}})
    if ideal and rig.virtual is None:
        raise ScenarioError(rig.name, [Problem("is no virtual joint", remedy="leave --ideal out")])
    with _building(source or scenario.name, "joint, load or valve"):
        plant = scenario.plant()
        hanging = vented_angle(plant)
    with _building(source or scenario.name, "controller"):
        program = ControlProgram(scenario.control())
    period = scenario.control_period
    with _building(source or scenario.name, "start"):
        start = scenario.initial(plant)
        reach = check_reference(plant, scenario.reference(), duration=scenario.duration, control_period=period)
    _, wishes = sampled(scenario.reference(), scenario.duration, period)
    wished = np.stack([np.asarray(wishes.angle), np.asarray(wishes.stiffness)], axis=1)
    approach = rig.approach
    course = Course(
        wishes=wished,
        period=period,
        raising=0 if ideal else round(approach.raising / period),
        settling=0 if ideal else round(approach.settling / period),
        pressures=(float(start.pressures[0]), float(start.pressures[1])),
        limited_to=_rated(plant),
    )
    limits = _limits(rig, plant, wished[:, 0], (float(start.angle), hanging))
    wiring, backend = _connected(rig, plant, scenario, start if ideal else None, paced, ideal)
    header = {
        "what": "joint rig",
        "scenario": scenario.dumps(),
        "rig": rig.to_json(),
        "backend": dict(backend.described),
        "calibrations": wiring.to_json(),
        "limits": {name: value for name, value in vars(limits).items() if np.isfinite(value)},
        "course": {"raising": course.raising, "settling": course.settling, "run": len(wished), "period": period},
        "versions": {
            "mckibben": mckibben.__version__,
            "python": platform.python_version(),
            "jax": version("jax"),
            "numpy": version("numpy"),
            "system": platform.platform(),
        },
    }
    return Session(scenario, plant, reach, backend, wiring, limits, course, program, header)


def _rated(plant: JointPlant) -> tuple[tuple[float, float], tuple[float, float]]:
    """The pressures [Pa] that `JointPlant.clip_commands` allows."""
    one, two = plant.joint.muscle1.specimen.domain, plant.joint.muscle2.specimen.domain
    return (
        (float(one.pressure_min), float(one.pressure_max)),
        (float(two.pressure_min), float(two.pressure_max)),
    )


def _limits(rig: JointRig, plant: JointPlant, wished: np.ndarray, others: tuple[float, ...]) -> JointLimits:
    given = {name: value for name, value in rig.limits if value is not None}
    angles = [float(wished.min()), float(wished.max()), *others]
    defaults = {
        "lowest_angle": min(angles) - _BEYOND,
        "highest_angle": max(angles) + _BEYOND,
        "pressure": _ABOVE * max(high for _, high in _rated(plant)),
    }
    return JointLimits(**defaults | given)


def _connected(
    rig: JointRig, plant: JointPlant, scenario: Scenario, start: PlantState | None, paced: bool, ideal: bool
) -> tuple[Wiring, Backend]:
    period = scenario.control_period
    if rig.nidaqmx is not None:
        return _card(rig.nidaqmx, period, rig.patience)
    spec = rig.virtual
    assert spec is not None  # the model of the rig sees to it
    given = {name: value for name, value in spec if value is not None and name != "seed"}
    wiring = Wiring()
    joint = VirtualJoint(
        plant,
        period=period,
        substeps=scenario.substeps,
        start=start,
        wiring=wiring,
        sensing=PERFECT if ideal else Sensing(**given),
        patience=rig.patience,
        paced=paced,
        seed=spec.seed,
    )
    return wiring, joint


def _card(spec: JointCardSpec, period: float, patience: float) -> tuple[Wiring, Backend]:
    from mckibben.rig import ni

    def terminal(name: str) -> str:
        return f"{spec.device}/{name}"

    terminals = ni.Wiring(
        inputs={name: terminal(getattr(spec, name)) for name in ("angle", "pressure1", "pressure2")},
        outputs={name: terminal(getattr(spec, name)) for name in ("valve1", "valve2")},
        heartbeat=terminal(spec.heartbeat),
        hold=terminal(spec.hold),
        counter="",
    )
    wiring = read_wiring(cast(Path, spec.calibration))
    return wiring, ni.NiBackend(terminals, rate=1 / period, patience=patience, server=spec.server)


def read_wiring(path: str | os.PathLike[str]) -> Wiring:
    """The five calibrations of a JSON file: an object of them, by the names of their channels.

    Raises
    ------
    ScenarioError
        With all that is wrong with them.
    """
    names = [field.name for field in dataclasses.fields(Wiring)]
    remedy = f"it needs {', '.join(names)}"
    content = content_of(Path(path), remedy)
    problems = [Problem("is missing", field=name, remedy="calibrate it") for name in names if name not in content]
    problems += [
        Problem("is no channel of a joint", field=name, remedy=remedy) for name in content if name not in names
    ]
    found, wrong = calibrations_in({name: content[name] for name in names if name in content})
    problems += wrong
    for name, one in found.items():
        unit = "rad" if name == "angle" else "Pa"
        if (one.name, one.unit) != (name, unit):
            problems.append(Problem(f"is of {one.name!r} in {one.unit}, not in {unit}", field=name))
    if problems:
        raise ScenarioError(str(path), problems)
    return Wiring(**found)


@contextmanager
def _building(source: str, field: str) -> Iterator[None]:
    """Say of an error which part of a scenario it is about."""
    try:
        yield
    except FileError:
        raise  # names a file and a place itself
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field=field)]) from error
