"""Which terminal of a card goes where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mckibben.errors import Problem, RangeError


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Terminals by name, as the driver calls them.

    Parameters
    ----------
    inputs
        Analog inputs of the sensors, each differential: "Dev1/ai0" is AI 0 against AI 8.
    outputs
        Analog outputs of the valves.
    heartbeat
        Digital line that changes with each beat; an external relay lets go when it does not.
    hold
        Digital line that, through that relay, holds the current of the spring valve: high = closed.
    counter
        Counter that sends the motor's pulses; empty where there is no motor.
    direction
        Digital line of the motor's direction: high = stretching.
    input_range, output_range
        Lowest and highest volts [V] of all inputs and of all outputs.
    rest
        Signal [V] of the outputs at which a valve lets all air out.

    Raises
    ------
    RangeError
        If something is missing, or one terminal is given twice; all of it at once.

    Examples
    --------
    >>> wiring = Wiring()  # the paper's rig
    >>> wiring.inputs["pressure"], wiring.outputs["valve"], wiring.counter
    ('Dev1/ai1', 'Dev1/ao0', 'Dev1/ctr0')
    """

    inputs: Mapping[str, str] = field(default_factory=lambda: {"force": "Dev1/ai0", "pressure": "Dev1/ai1"})
    outputs: Mapping[str, str] = field(default_factory=lambda: {"valve": "Dev1/ao0"})
    heartbeat: str = "Dev1/port0/line0"
    hold: str = "Dev1/port0/line1"
    counter: str = "Dev1/ctr0"
    direction: str = "Dev1/port0/line2"
    input_range: tuple[float, float] = (-10.0, 10.0)
    output_range: tuple[float, float] = (0.0, 10.0)
    rest: float = 0.0

    def __post_init__(self) -> None:
        problems: list[Problem] = []
        if not self.inputs:
            problems.append(Problem("a rig without a sensor measures nothing", field="inputs"))
        if not self.outputs:
            problems.append(Problem("a rig without a valve has no pressure", field="outputs"))
        problems += [
            Problem("without it nothing vents when the host dies", field=name)
            for name in ("heartbeat", "hold")
            if not getattr(self, name)
        ]
        if self.counter and not self.direction:
            problems.append(Problem("a motor needs one", field="direction"))
        for name in ("input_range", "output_range"):
            low, high = getattr(self, name)
            if not low < high:
                problems.append(Problem(f"{low:g}..{high:g} V is empty", field=name))
        low, high = self.output_range
        if not low <= self.rest <= high:
            problems.append(Problem(f"{self.rest:g} V is outside {low:g}..{high:g} V", field="rest"))
        given = [*self.inputs.values(), *self.outputs.values(), *self.lines.values()]
        problems += [
            Problem(f"{terminal} is given twice", field="wiring")
            for terminal in sorted({one for one in given if given.count(one) > 1})
        ]
        if problems:
            raise RangeError("\n  ".join([f"wiring: {len(problems)} problem(s)", *map(str, problems)]))

    @property
    def lines(self) -> dict[str, str]:
        """The digital lines by name, in the order in which they are written."""
        lines = {"heartbeat": self.heartbeat, "hold": self.hold}
        return lines | {"direction": self.direction} if self.counter else lines
