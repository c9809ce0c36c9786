"""Computed torque with the stiffness of all joints, by the pressures of all muscles of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

import equinox as eqx
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.component.base import Inherited
from mckibben.component.columns import Label
from mckibben.control.base import Setpoint, ValveModel
from mckibben.control.bounded_allocation import MOST_MUSCLES
from mckibben.control.feedback import Feedback
from mckibben.control.linearisation import LinearisedState, LinearisingControl
from mckibben.control.mechanics import Scalars, TreeMechanics
from mckibben.control.model_based import Estimates, FrictionShare
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.control.robot_control import RobotController
from mckibben.errors import RangeError
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.ground import Ground
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.terms import JointTerms
from mckibben.statics.posture import check_affine
from mckibben.units import GRAVITY, AngleScale, CommandDelay, Force, Gravity, PositiveTime


class ComputedTorque(LinearisingControl, RobotController):
    r"""Computed torque, and the stiffness of all joints, by the pressures of all muscles.

    The torques for the accelerations of references and feedback follow from a model of the robot, with its base at rest
    and its foot in the air,

    .. math:: \tau = M(q)\,(\ddot q_r + a(e, \dot e) - \hat d) + h(q, \dot q) + c\,\dot q

    at the angles to be expected after the lag T of the feedback. Torques T p + t and stiffness K p + k of the joints
    are affine in the pressures of taut muscles, and the pressures those of

    .. math:: \min_p\; W^2 \| T p + t - \tau \|^2 + \sum_i \Big( \frac{K_i p + k_i}{K_{r,i}} - 1 \Big)^2,
              \qquad \underline p \le p \le \overline p

    with muscles taut, below their ratings, and within what the valves reach; torques have priority by their weight. An
    active set is continued from period to period. ``allocation_gap`` is a certificate: no pressures have errors whose
    sum of squares is smaller by more. Where the muscles are a pair of each joint, their pressures follow in closed
    form, as those of `DecouplingControl`. Laws are affine in pressure, and tendons rigid.

    Parameters
    ----------
    feedback
        Outer loop of each joint: `PolePlacement` or `SlidingMode`.
    observer, pressure_observer
        Observers of the motion of each joint with its disturbance, and of the pressures.
    robot, valve, gravity, command_delay
        Models of robot and valves, g [m/s^2], and delay of the commands [s] over which the motion is predicted; in a
        file, by default, those of the plant. No joint is locked.
    friction_compensation, friction_in_observer, preview
        As for `DecouplingControl`, with the friction of muscles and joints.
    stiffness_amplitude
        Likewise, for muscles that are a pair of each joint.
    minimum_tension
        Lower limit of each muscle's tension [N].
    impedance
        Whether each joint is a spring of its stiffness about its reference, as for `DecouplingControl`.

    References
    ----------
    J. Y. S. Luh, M. W. Walker and R. P. C. Paul, Resolved-acceleration control of mechanical manipulators, IEEE Trans.
    Automatic Control 25, 1980 (computed torque); O. Harkegard, Efficient active set algorithms for solving constrained
    least squares problems in aircraft control allocation, CDC 2002.
    """

    short_name = "computed_torque"
    telemetry_labels: ClassVar = {
        "allocation_gap": Label("1", "bound on the squared error of torques and stiffness above the least possible"),
    }

    feedback: Feedback
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()
    robot: Annotated[Robot, Inherited(lambda scope: scope["robot"])] = eqx.field(kw_only=True)
    valve: ValveModel = eqx.field(kw_only=True)
    command_delay: Annotated[CommandDelay | None, Inherited(lambda scope: scope.get("command_delay"))] = eqx.field(
        kw_only=True, default=None
    )
    gravity: Gravity = eqx.field(kw_only=True, default=GRAVITY)
    minimum_tension: Force = eqx.field(kw_only=True, default=5.0)
    impedance: bool = eqx.field(kw_only=True, default=False, static=True)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)
    friction_in_observer: FrictionShare | None = eqx.field(kw_only=True, default=None)
    stiffness_amplitude: AngleScale | None = eqx.field(kw_only=True, default=None)
    preview: PositiveTime | None = eqx.field(kw_only=True, static=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_affine(self.robot)
        for joint in self.robot.joints:
            if joint.locked is not None:
                remedy = "unlock it, or give each joint its own of `controllers`"
                raise RangeError(f"{joint.name} is locked", field="robot", value=joint.name, remedy=remedy)
        count = len(self.robot.all_muscles)
        if count > MOST_MUSCLES and not self.mechanics.is_paired:
            message = f"pressures of {count} muscles: the program that finds them grows with the cube of their number"
            remedy = "join muscles that act alike, or give controllers of pairs (controllers), or pressures in Python"
            raise RangeError(message, field="robot", value=count, upper=MOST_MUSCLES, remedy=remedy)
        if self.stiffness_amplitude is not None and not self.mechanics.is_paired:
            message = "a stiffness_amplitude, and muscles that are not a pair of each joint"
            raise RangeError(message, field="stiffness_amplitude", remedy="leave it out, for the isobaric stiffness")

    @property
    def mechanics(self) -> TreeMechanics:
        return TreeMechanics(self.robot, Ground(), self.gravity)

    def init(self, measurement: RobotMeasurement) -> LinearisedState:
        return self.init_linearised(measurement.angles, measurement.pressures)

    def step(
        self,
        state: LinearisedState,
        setpoint: Sequence[Setpoint],
        measurement: RobotMeasurement,
        period: ArrayLike,
    ) -> tuple[LinearisedState, tuple[Array, ...]]:
        return self.steer(state, setpoint, measurement.angles, measurement.pressures, period)

    def _stiffness(self, estimates: Estimates, terms: JointTerms) -> Scalars:
        if self.stiffness_amplitude is None:  # of the terms at hand: that in the posture of the sample takes longer
            return terms.stiffness_at(estimates.pressures)
        return estimates.stiffness

    def telemetry(self, state: LinearisedState) -> dict[str, PyTree]:
        certificate = {} if self.mechanics.is_paired else {"allocation_gap": state.solution.gap}
        return super().telemetry(state) | certificate
