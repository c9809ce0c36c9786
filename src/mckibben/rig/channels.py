"""Names of the channels of a rig: those of the joints and muscles of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from mckibben.scenario import StudiedScenario


class Channels(NamedTuple):
    """Ends of the names of the channels, by joint and by muscle.

    A single joint without a name has the channels "angle", "pressure1", "pressure2", "valve1" and "valve2"; a robot has
    "angle.hip", "pressure.hip1" and so on.

    Examples
    --------
    >>> Channels().readings
    ('angle', 'pressure1', 'pressure2')
    >>> Channels((".hip",), (".flexor", ".extensor")).by_muscle("valve")
    ('valve.flexor', 'valve.extensor')
    """

    joints: tuple[str, ...] = ("",)
    muscles: tuple[str, ...] = ("1", "2")

    @classmethod
    def of(cls, scenario: StudiedScenario) -> Self:
        """Channels of a scenario."""
        if not scenario.joint_names:
            return cls()
        return cls(*(tuple(f".{name}" for name in names) for names in (scenario.joint_names, scenario.muscle_names)))

    @property
    def is_named(self) -> bool:
        """Whether joints have names: quantities are then tuples over joints, not those of a single one."""
        return self.joints != ("",)

    def by_joint(self, quantity: str) -> tuple[str, ...]:
        """Names of the channels or columns of a quantity of the joints."""
        return tuple(f"{quantity}{end}" for end in self.joints)

    def by_muscle(self, quantity: str) -> tuple[str, ...]:
        """Names of the channels or columns of a quantity of the muscles."""
        return tuple(f"{quantity}{end}" for end in self.muscles)

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of the inputs: angles and pressures."""
        return self.by_joint("angle") + self.by_muscle("pressure")

    @property
    def valves(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.by_muscle("valve")
