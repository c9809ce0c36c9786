"""A scenario on a joint rig, from the file to the folder that holds what was measured."""

from __future__ import annotations

import dataclasses
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
from mckibben.files import folder as made
from mckibben.plant import JointPlant, PlantState
from mckibben.rig.backend import Backend
from mckibben.rig.record import read_record
from mckibben.rig.recorder import Recorder
from mckibben.simulation import Reach, Result, check_reference, sampled
from mckibben.study.calibrations import calibrations_in, content_of
from mckibben.study.joint_rig.course import Course, Ending, Shown
from mckibben.study.joint_rig.document import JointCardSpec, JointRig
from mckibben.study.joint_rig.limits import JointLimits
from mckibben.study.joint_rig.measured import measured_result
from mckibben.study.joint_rig.programs import ControlProgram
from mckibben.study.joint_rig.resting import vented_angle
from mckibben.study.joint_rig.rows import columns
from mckibben.study.joint_rig.running import control
from mckibben.study.joint_rig.timing import Timing
from mckibben.study.joint_rig.undisturbed import signals_told, undisturbed
from mckibben.study.joint_rig.virtual import PERFECT, Sensing, VirtualJoint
from mckibben.study.joint_rig.wiring import Wiring
from mckibben.study.keeping import alone
from mckibben.study.scenario import Scenario
from mckibben.units import deg

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
        folder = made(folder)
        with alone(folder / "lock", "running a joint rig"), signals_told() as told, undisturbed() as priority:
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
        pressures=(float(start.pressure1), float(start.pressure2)),
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
    """The pressures [Pa] that `JointPlant.limited` lets through."""
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
        raise ScenarioError(source, [Problem(str(error), field=field)]) from error
