"""Simulated hardware of a joint rig."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import PyTree

from mckibben.component.base import Checked
from mckibben.component.checks import check_positive
from mckibben.plant import Plant
from mckibben.rig.backend import Channel
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import PlantProgram, complete_state, rated_commands, vented_state
from mckibben.rig.simulated.sampling import Sensor, SimulatedBackend
from mckibben.units import AngleStep, PressureNoise, bar, deg, kPa, ms


@dataclass(frozen=True)
class Sensing(Checked):
    """Sensors of a simulated joint or robot.

    Parameters
    ----------
    angle_step
        Resolution of the encoders [rad], 14 bits per revolution, of a slide 1 mm for 1 deg; 0 for none.
    pressure_noise
        Standard deviation of each sample [Pa].
    """

    angle_step: AngleStep = 0.022 * deg
    pressure_noise: PressureNoise = 4 * kPa

    def sensors(self, channels: Channels) -> tuple[Sensor, ...]:
        """The sensors of angles and pressures."""
        kind = channels.joint_type
        unit, highest = kind.unit("rad"), 170 * deg * kind.scale
        angles = (Channel(name, unit, -highest, highest, "simulated") for name in channels.by_joint("angle"))
        pressures = (
            Channel(name, "Pa", -0.5 * bar, 10.2 * bar, "simulated") for name in channels.by_muscle("pressure")
        )
        return (
            *(Sensor(channel=channel, resolution=self.angle_step * kind.scale) for channel in angles),
            *(Sensor(channel=channel, noise=self.pressure_noise) for channel in pressures),
        )


PERFECT = Sensing(0.0, 0.0)
"""Ideal sensors, as in a simulation."""


class SimulatedJoint(SimulatedBackend):
    """The plant of a scenario as a backend: angles and pressures in, a valve for each muscle out.

    Signals reach the valves when they are set, between two samples, or after the plant's command delay. Each opening
    begins at the initial state.

    Parameters
    ----------
    period
        Sampling period [s].
    substeps
        Runge-Kutta steps per sample.
    start
        Initial state, at constant pressures until then. Default: vented and at rest.
    channels
        Names of joints and muscles.
    program
        Compiled program of this plant and number of steps, if there is one.
    patience, paced, seed
        As for `SimulatedBackend`.
    """

    immediate = True

    def __init__(
        self,
        plant: Plant,
        *,
        period: float,
        substeps: int = 4,
        start: PyTree = None,
        channels: Channels = Channels(),  # noqa: B008
        sensing: Sensing | None = None,
        patience: float = 100 * ms,
        paced: bool = False,
        seed: int = 0,
        program: PlantProgram | None = None,
    ) -> None:
        check_positive("SimulatedJoint", "s", period=period)
        sensors = (sensing or Sensing()).sensors(channels)
        super().__init__(sensors, rate=1 / period, patience=patience, paced=paced, seed=seed)
        self._delay_of_commands, self._period = float(plant.command_delay or 0.0), period
        self._channels, self._rated = channels, rated_commands(plant)
        first = vented_state(plant) if start is None else complete_state(plant, start)
        self.program = program or PlantProgram(plant, substeps, first)
        self._start = self.program.state(first)
        self._initial_commands = tuple(map(float, first.pressures))
        self._begin()

    def _begin(self) -> None:
        self._state, self._commands = self._start, self._initial_commands
        self._pending: deque[tuple[float, tuple[float, ...]]] = deque()  # times and commands

    @property
    def outputs(self) -> Sequence[Channel]:
        highest = max(9 * bar, *(high for _, high in self._rated))
        return tuple(Channel(name, "Pa", 0.0, highest, "simulated") for name in self._channels.valves)

    @property
    def description(self) -> Mapping[str, str]:
        return {"kind": "simulated joint", "paced": "yes" if self.paced else "no", **super().description}

    @property
    def truth(self) -> tuple[float, ...]:
        """True angles [rad] and pressures [Pa], as last computed."""
        return self._truth()

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressures of the valves [Pa]; `RigError` if the watchdog has expired, or it is not open."""
        self._check_armed()
        commands = (min(max(float(p), low), high) for p, (low, high) in zip(pressures, self._rated, strict=True))
        self._pending.append((self.now + self._delay_of_commands, tuple(commands)))

    def vent(self) -> None:
        self._catch_up()
        self._rest()

    def _rest(self) -> None:
        delay = 0.0 if self._watchdog.has_expired else self._delay_of_commands
        if self._watchdog.has_expired:
            self._pending.clear()
        self._pending.append((self.now + delay, (0.0,) * len(self._rated)))

    def _truth(self) -> tuple[float, ...]:
        return tuple(self._state[[*self.program.places]].tolist())

    def _next_event(self) -> float:
        return self._pending[0][0] if self._pending else np.inf

    def _settle(self) -> None:
        while self._pending and self._pending[0][0] <= self.now:
            _, self._commands = self._pending.popleft()

    def _integrate(self, until: float) -> tuple[list[float], list[tuple[float, ...]]]:
        """Integrate under the present commands, in sampling periods and a remainder."""
        times, values, little = [self.now], [self._truth()], 1e-9 * self._period
        while (left := until - self.now) > 0:
            step = self._period if left > self._period - little else left
            self._state = self.program.advance(self._state, self._commands, step)
            self.now = until if left - step <= little else self.now + step
            times.append(self.now)
            values.append(self._truth())
        return times, values
