"""Names of the channels of a rig: those of the joints and muscles of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

from mckibben.units import HINGE, JointType, deg

if TYPE_CHECKING:
    from mckibben.scenario import StudiedScenario


class Channels(NamedTuple):
    """Ends of the names of the channels, by joint and by muscle, and how the joints move.

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
    joint_type: JointType = HINGE

    @classmethod
    def of(cls, scenario: StudiedScenario) -> Self:
        """Channels of a scenario."""
        if not scenario.joint_names:
            return cls(joint_type=scenario.joint_type)
        joints, muscles = (
            tuple(f".{name}" for name in names) for names in (scenario.joint_names, scenario.muscle_names)
        )
        return cls(joints, muscles, scenario.joint_type)

    @property
    def least_motion(self) -> float:
        """Change of an angle [rad], or a position [m], that counts as a motion."""
        return 0.5 * deg * self.joint_type.scale

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
