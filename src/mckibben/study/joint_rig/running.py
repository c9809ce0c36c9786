"""A controller on a joint rig, from opening it to the empty muscles; whatever goes wrong, vent."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable

from mckibben.errors import McKibbenError, RigError
from mckibben.rig.backend import Backend
from mckibben.rig.recorder import Recorder
from mckibben.study.joint_rig.course import Course, Ending, Shown
from mckibben.study.joint_rig.limits import JointLimits, Watch
from mckibben.study.joint_rig.loop import Loop
from mckibben.study.joint_rig.programs import ControlProgram
from mckibben.study.joint_rig.rows import Rows
from mckibben.study.joint_rig.undisturbed import Told
from mckibben.study.joint_rig.wiring import Connected, Wiring


def control(
    backend: Backend,
    program: ControlProgram,
    course: Course,
    limits: JointLimits,
    recorder: Recorder,
    *,
    wiring: Wiring | None = None,
    told: Told | None = None,
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
    loop = Loop(backend, program, course, Watch(limits, course.period), rows, connected, told or Told(), show)
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
