"""The muscle in its clamps: law, friction and creep along the way that it is drawn, one short move after another."""

from __future__ import annotations

import math

from mckibben.errors import RangeError
from mckibben.muscle import MaxwellCreep, MaxwellSlip, Muscle, NoCreep, NoFriction
from mckibben.rig.twin.table import ForceTable, force_table

_LEAST = 1e-9  # N: a band is never narrower, so that nothing is divided by 0


class Grip:
    """What a muscle pulls with, and what it remembers.

    The same numbers as `MaxwellSlip.along` and `MaxwellCreep.along` have, but as a state that goes along with the
    time, in plain floats.

    Parameters
    ----------
    muscle
        Friction and creep are its own; it has none unless given.
    contraction
        Where it is clamped [-]; it is relaxed there.

    Raises
    ------
    RangeError
        If it has a kind of friction or creep that is not known here, or a law that is too rough for a table.
    """

    def __init__(self, muscle: Muscle, contraction: float) -> None:
        specimen, friction, creep = muscle.specimen, muscle.friction, muscle.creep
        for part, kinds in ((friction, (NoFriction, MaxwellSlip)), (creep, (NoCreep, MaxwellCreep))):
            if not isinstance(part, kinds):
                raise RangeError(
                    f"a virtual rig has no {type(part).__name__}", remedy=f"give the muscle a {kinds[1].__name__}"
                )
        self.table: ForceTable = force_table(muscle)
        self.held = True
        self.start = contraction
        self.length = float(specimen.initial_length)
        self._shortest = float(specimen.domain.contraction_max)
        diameter, angle = float(specimen.initial_diameter), float(specimen.braid_angle)
        self._cylinder = math.pi * diameter**2 / 4 * self.length / math.sin(angle) ** 2
        self._cos2 = math.cos(angle) ** 2
        self._slipping = isinstance(friction, MaxwellSlip)
        self._stiffness: list[float] = []
        if isinstance(friction, MaxwellSlip):
            self._stiffness, shares = friction.stiffnesses.tolist(), friction.shares.tolist()
            self._reach = [share / k for share, k in zip(shares, self._stiffness, strict=True)]
            self._width = float(friction.half_width), float(friction.growth), float(friction.reference_pressure)
            self._viscous = float(friction.viscous)
        self._deflections = [0.0] * len(self._stiffness)
        self._times: list[float] = []
        if isinstance(creep, MaxwellCreep):
            self._times = [float(time) for time in creep.time_constants]
            self._share = float(creep.stiffness) / creep.arms
        self._relaxing = [0.0] * len(self._times)
        self._stretch = 0.0

    @property
    def shortest_time(self) -> float:
        """The time constant [s] of its quickest creep; infinite without."""
        return self._times[0] if self._times else math.inf

    def contraction(self, stretch: float) -> float:
        """The contraction [-] where it is stretched so far [m] from where it was clamped."""
        return self.start - stretch / self.length if self.held else self._shortest

    def volume(self, stretch: float) -> float:
        """Inside the braid [m^3]; as `Specimen.volume`, in a plain float."""
        ratio = 1 - self.contraction(stretch)
        return self._cylinder * ratio * (1 - self._cos2 * ratio * ratio)

    def force(self, stretch: float, pressure: float, span: float) -> float:
        """The pull [N] after a move within a time span [s] to a stretch [m], at a gauge pressure [Pa] now."""
        if not self.held:
            return 0.0
        travel, self._stretch = stretch - self._stretch, stretch
        tension = self.table.force(self.start - stretch / self.length, pressure)
        total = tension
        if self._slipping:
            base, growth, reference = self._width
            width = max(base + growth * (pressure - reference), _LEAST)
            limit = width * math.tanh(tension / (2 * width))
            deflections = self._deflections
            for k, (stiffness, reach) in enumerate(zip(self._stiffness, self._reach, strict=True)):
                most = reach * limit
                now = deflections[k] + travel
                now = most if now > most else -most if now < -most else now
                deflections[k] = now
                total += stiffness * now
            if travel and self._viscous and tension > 2 * _LEAST and span > 0:
                half = tension / 2
                total += half * math.tanh(self._viscous * travel / span / half)
        for k, time in enumerate(self._times):
            arms = len(self._times)
            most, ratio = tension / (2 * arms), span / time
            part = -math.expm1(-ratio) / ratio if ratio > 0 else 1.0
            now = self._relaxing[k] * math.exp(-ratio) + self._share * travel * part
            now = most if now > most else -most if now < -most else now
            self._relaxing[k] = now
            total += now
        return total
