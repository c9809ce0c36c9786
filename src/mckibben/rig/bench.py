"""What stands on the bench: the muscle, how it is mounted, the motor, the calibrations and the limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mckibben.errors import RangeError
from mckibben.muscle import Muscle, Specimen
from mckibben.rig.backend import Drive
from mckibben.rig.calibration import Calibration
from mckibben.rig.protocol import specimen_of
from mckibben.rig.safety import Limits
from mckibben.units import Hz, N, bar, ms, s


@dataclass(frozen=True, kw_only=True)
class Bench:
    """What a test is run on.

    Parameters
    ----------
    of
        The muscle, or the specimen where its law is not known.
    mounted_at
        Contraction [-] at which the muscle was mounted: where the motor stands when the backend is opened anew.
    drive
        The motor.
    calibrations
        Of "force", "pressure" (inputs) and "valve" (output).
    limits
        What may not be exceeded.
    rate
        Samples a second of the backend [Hz].
    cycle
        How often readings are taken and looked at [s]: 100 ms.
    between
        Samples a second that are recorded between plateaus [Hz]: 10 Hz. All are watched; those of a block that stopped
        the test, and those after it, are all recorded.
    settled
        How near to the set pressure the mean of a cycle has to be [Pa] before it counts as reached: 0.1 bar.
    vented
        Below this pressure [Pa] the muscle is vented: 0.1 bar.
    steady
        How long it has to be so [s], either of them: 1 s.
    slack_force
        Up to this mean force [N] a point is one of a slack muscle: 1 N, by which a sensor's zero may be off.
    """

    of: Muscle | Specimen
    mounted_at: float = 0.0
    drive: Drive
    calibrations: Mapping[str, Calibration]
    limits: Limits
    rate: float = 1000 * Hz
    cycle: float = 100 * ms
    between: float = 10 * Hz
    settled: float = 0.1 * bar
    vented: float = 0.1 * bar
    steady: float = 1 * s
    slack_force: float = 1 * N

    def __post_init__(self) -> None:
        if not 1 <= self.rate * self.cycle:
            raise RangeError(f"no sample is taken within a cycle of {self.cycle:g} s", remedy="lengthen it")

    @property
    def specimen(self) -> Specimen:
        """The specimen."""
        return specimen_of(self.of)

    @property
    def samples_a_cycle(self) -> int:
        """Of each input."""
        return max(1, round(self.rate * self.cycle))

    @property
    def every(self) -> int:
        """Of the samples between plateaus each so manyth is recorded."""
        return max(1, round(self.rate / self.between))

    def pulses_at(self, contraction: float) -> int:
        """Where the motor stands at a contraction [-], from where the muscle was mounted; the nearest pulse."""
        return self.drive.nearest((self.mounted_at - contraction) * float(self.specimen.initial_length))

    def contraction_at(self, pulses: float) -> float:
        """The contraction [-] where the motor stands."""
        return self.mounted_at - pulses / self.drive.pulses_per_metre / float(self.specimen.initial_length)
