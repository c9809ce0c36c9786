"""A bench without a motor: an operator moves the muscle, or hangs weights on it, when asked."""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future

import numpy as np
from scipy.optimize import root_scalar

from mckibben.errors import RigError, UnitError
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import Backend, Block, Channel, ChannelStatus, MovingBackend
from mckibben.units import quantity


class HandBench(MovingBackend):
    """A backend of sensors and a valve, and an operator in place of a motor.

    With weights the force is that of the weight, unless a sensor "force" measures it; the operator gives the length of
    the muscle at each point. Otherwise the operator turns a screw to the contraction that is asked for.

    Parameters
    ----------
    backend
        Sensors and valve: the inputs "pressure" and, without weights, "force", and the output "valve".
    weights
        Whether weights hang on the muscle.
    ask
        Shows a text and returns the answer; called in a thread of its own. Default: on the terminal.

    Attributes
    ----------
    simulated
        Muscle that hangs there in place of a real one, and whose lengths nobody is asked for; None for a real one.
    """

    simulated: Muscle | None = None

    by_hand = True

    def __init__(self, backend: Backend, *, weights: bool = False, ask: Callable[[str], str] | None = None) -> None:
        self.inner, self.weights, self._ask = backend, weights, ask or typed
        self.rate, self.patience, self.paced = backend.rate, backend.patience, backend.paced
        self.position, self.weight = 0.0, 0.0  # [m], [N]
        self._weighs = weights and "force" not in [channel.name for channel in backend.inputs]

    @property
    def inputs(self) -> Sequence[Channel]:
        return [*self.inner.inputs, *([Channel("force", "N", where="weight")] if self._weighs else [])]

    @property
    def outputs(self) -> Sequence[Channel]:
        return self.inner.outputs

    @property
    def description(self) -> Mapping[str, str]:
        return {**self.inner.description, "moved": "by weights" if self.weights else "by hand"}

    @property
    def latency(self) -> float:
        return self.inner.latency

    def status(self) -> Iterator[ChannelStatus]:
        return self.inner.status()

    def ask(self, text: str) -> Future[str]:
        """Ask the operator; samples go on meanwhile."""
        future: Future[str] = Future()

        def wait() -> None:
            try:
                future.set_result(self._ask(f"{text}: "))
            except BaseException as error:
                future.set_exception(error)

        threading.Thread(target=wait, name="operator", daemon=True).start()
        return future

    def hanging(self, pressure: float) -> float:
        """Contraction of the simulated muscle under the weight at a pressure [Pa]; an end of its domain beyond it."""
        muscle = self.simulated
        assert muscle is not None
        ends = float(muscle.domain.contraction_min), float(muscle.domain.contraction_max)

        def excess(contraction: float) -> float:
            return float(forces(muscle, contraction, pressure)) - self.weight

        if excess(ends[0]) <= 0:
            return ends[0]
        return ends[1] if excess(ends[1]) >= 0 else float(root_scalar(excess, bracket=ends).root)

    def open(self) -> None:
        self.position, self.weight = 0.0, 0.0
        self.inner.open()

    def clock(self) -> float:
        return self.inner.clock()

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        block = self.inner.read(count, timeout=timeout)
        rows, values = len(block.time), block.values
        if self._weighs:
            values = np.column_stack([values, np.full(rows, self.weight)])
        return block._replace(values=values, position=np.full(rows, self.position))

    def set_valves(self, pressures: Sequence[float]) -> None:
        self.inner.set_valves(pressures)

    def heartbeat(self) -> None:
        self.inner.heartbeat()

    def vent(self) -> None:
        self.inner.vent()

    def close(self) -> None:
        self.inner.close()

    def move(self, distance: float, speed: float) -> None:
        """Take the muscle as moved by a distance [m], as the operator has confirmed."""
        self.position += distance

    moving = False

    def stop(self) -> None:
        """Nothing moves by itself."""


def typed(text: str) -> str:
    """Line that an operator types after a text; `RigError` at the end of the input.

    Standard input is read without its buffer: Python aborts if it ends while a thread waits with the lock of that.
    """
    try:
        number = sys.stdin.fileno()
    except OSError:  # not a file
        return input(text)
    sys.stdout.write(text)
    sys.stdout.flush()
    line = io.FileIO(number, closefd=False).readline()
    if not line:
        raise RigError("the input has ended, and an answer is needed", remedy="run it on a terminal")
    return line.decode(errors="replace").strip()


def length_of(answer: str) -> float | None:
    """Length [m] in an answer; None if it is none.

    >>> length_of("16.35 cm"), length_of("long")
    (0.1635, None)
    """
    try:
        return quantity(answer, "m")
    except UnitError:
        return None
