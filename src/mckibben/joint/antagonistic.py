"""A joint between two antagonistic muscles: torque and stiffness, Eqs. 7 and 8 of the paper."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, Num

from mckibben.binding import call
from mckibben.component.base import Component
from mckibben.component.calls import checked_call
from mckibben.component.checks import check_positive, check_within
from mckibben.errors import RangeError, printable
from mckibben.joint import attainable
from mckibben.joint.geometry import Geometry, Pair, Pressures
from mckibben.joint.load import Load
from mckibben.joint.route import (
    Route,
    closed_valve_stiffness,
    init_states,
    pair_routes,
    secant_stiffness,
    update_states,
)
from mckibben.joint.tendon import RigidTendon, Tendon
from mckibben.muscle import NO_STATE, MaxwellSlip, Muscle, MuscleState, PressureAffineLaw
from mckibben.muscle.muscle import CHECK_LAW, warn_outside
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.compiled import cached_trace, jit_inline
from mckibben.numerics.elementary import floating
from mckibben.result import Remark
from mckibben.units import SLIDE, JointType, deg

SMALL_MOTION = 0.1 * deg
"""Amplitude of the small-motion stiffness [rad], at which friction is mostly presliding."""

MuscleStates = tuple[MuscleState, MuscleState]
"""Internal states of muscles 1 and 2."""

NO_STATES: MuscleStates = (NO_STATE, NO_STATE)


class Measurement(NamedTuple):
    """Measured angle [rad] and gauge pressures [Pa], (p1, p2), of a joint."""

    angle: Float[Array, ""]
    pressures: tuple[Float[Array, ""], Float[Array, ""]]


def pressure_pair(pressures: Pressures) -> Pressures:
    """Return the pressures of muscles 1 and 2; `RangeError` for anything other than a pair of numbers or arrays."""
    shape = (len(pressures),) if isinstance(pressures, tuple | list) else jnp.shape(pressures)
    if shape != (2,):
        raise RangeError(
            f"the pressures are an array of shape {shape}, not a pair",
            remedy="give (p1, p2), the gauge pressures of muscles 1 and 2; each may be an array",
        )
    return pressures[0], pressures[1]


class AffineMap(NamedTuple):
    """Quantity affine in the two pressures: offset + slope1 p1 + slope2 p2.

    >>> round(float(AffineMap(jnp.asarray(1.0), jnp.asarray(2e-5), jnp.asarray(-1e-5))((3e5, 2e5))), 9)
    5.0
    """

    offset: Array
    slope1: Array
    slope2: Array

    def __call__(self, pressures: Pressures) -> Float[Array, "..."]:
        """Return the value at a pair of gauge pressures [Pa]."""
        pressure1, pressure2 = pressure_pair(pressures)
        return self.offset + self.slope1 * pressure1 + self.slope2 * pressure2


class TorqueStiffnessMap(NamedTuple):
    """Torque [N*m] and stiffness [N*m/rad] at one angle as functions of the pressures of two taut muscles.

    Exact for rigid tendons and laws affine in pressure, such as Eq. 2: F = f(eps) + g(eps) p gives Eqs. 7 and 8 terms
    without pressure and terms proportional to p1 and p2.
    """

    torque: AffineMap
    stiffness: AffineMap


class MuscleForces(NamedTuple):
    """Tensions [N], torque [N*m] and contractions [-] of the muscles, friction and creep included."""

    tensions: Pair
    torque: Array
    contractions: Pair


class AntagonisticJoint(Component):
    r"""A joint actuated by two antagonistic muscles.

    In all methods `pressures` is a pair of gauge pressures [Pa], (p1, p2), `angle` is in rad, and scalars and arrays
    broadcast; anything other than a pair raises `RangeError`. Torque and stiffness follow from the muscles' laws;
    gravity belongs to the `Load`. Outside a muscle's domain `torque`, `stiffness`, `torque_and_stiffness`, `tensions`
    and `forces` issue a `DomainWarning`, except inside `jax.jit`. Friction and creep act through internal states of the
    muscles: `init_state`, `state_rate`, `update_state`, and `forces`, which includes them.

    Muscle 1, the antagonist, lengthens as the angle increases, muscle 2 shortens; the tendons are rigid by default.
    With tensions F and moment arms d,

    .. math:: \tau = F_2 d_2 - F_1 d_1 \quad \text{(Eq. 7)}, \qquad
        K = -\frac{\partial \tau}{\partial \theta}\Big|_{p_1, p_2} \quad \text{(Eq. 8)}

    Parameters
    ----------
    geometry
        Path lengths of both muscles over the angle.
    muscle1, muscle2
        The muscles, one of which may be a return spring. In a file, `muscle` gives both.
    tendon
        Connection of each muscle to its path: rigid, or a series spring.

    Raises `RangeError` for two return springs, for a muscle without a highest pressure, and for friction or creep that
    follows the rate of the length in series with a spring.

    >>> from mckibben import catalog
    >>> round(float(catalog.joint("knee-table-2").stiffness(0.0, (3e5, 3e5))), 2)
    71.93
    """

    geometry: Geometry
    muscle1: Muscle
    muscle2: Muscle
    tendon: Tendon = RigidTendon()

    aliases: ClassVar = {"muscle": ("muscle1", "muscle2")}
    suggestions: ClassVar = {
        name: f"scenario(load).{name}()" for name in ("simulate", "tune", "envelope", "margins")
    } | {"plot": "mk.report.draw_joint(joint, angle, pressures)"}

    def __check_init__(self) -> None:
        super().__check_init__()
        if all(self.springs):
            raise RangeError("AntagonisticJoint: two springs and no muscle", remedy="make one of them a muscle")
        self.geometry.check_muscles(self.muscles)
        for muscle in self.muscles:
            muscle.check_pressure_limit()
        if not isinstance(self.tendon, RigidTendon):  # the rate of the length is not a function of the state
            owner = f"muscle in series with a {type(self.tendon).__name__}"
            for muscle in self.muscles:
                if isinstance(muscle.friction, MaxwellSlip):
                    check_within(owner, 0.0, 0.0, "N*s/m", viscous=muscle.friction.viscous)
                    rates = (muscle.friction.viscous_growth, muscle.friction.viscous_length_growth)
                    if any(coefficient is not None for coefficient in (*rates, muscle.friction.rate_growth)):
                        message = f"{owner}: friction needs the rate of the muscle's length, which is unknown there"
                        remedy = "leave out viscous_growth, viscous_length_growth and rate_growth, or the spring"
                        raise RangeError(message, field="friction", remedy=remedy)
                if muscle.has_creep:
                    raise RangeError(
                        f"{owner}: creep needs the rate of the muscle's length, which is unknown there",
                        remedy="leave out the creep or the spring",
                    )

    def __repr__(self) -> str:
        muscles = f"two of {self.muscle1}" if self.muscle1 is self.muscle2 else f"{self.muscle1} and {self.muscle2}"
        tendon = "" if isinstance(self.tendon, RigidTendon) else f", {type(self.tendon).__name__}"
        return f"<AntagonisticJoint: {printable(eqx.tree_pformat(self.geometry, width=1000), 200)}, {muscles}{tendon}>"

    @checked_call
    def scenario(self, load: object, **sections: object) -> Any:  # is above this package
        """Return a `mckibben.Scenario` of this joint with a load, to be simulated, tuned and changed.

        Load and further sections are objects, or as in a file: ``joint.scenario({"class": "pendulum", "mass": "1 kg",
        "length": "250 mm"}, duration="6 s")``. Others are those of ``mckibben new joint``: decoupling control on valves
        of first order, a sine of the angle and a step of the stiffness between two that the joint can have. Raises
        `ScenarioError` for sections that cannot be, and `RangeError` if the joint cannot carry the load.
        """
        return call("starting_scenario", self, load, sections)

    @property
    def muscles(self) -> tuple[Muscle, Muscle]:
        """Muscles 1 and 2."""
        return self.muscle1, self.muscle2

    @property
    def has_friction(self) -> bool:
        """Whether a muscle has friction."""
        return any(muscle.has_friction for muscle in self.muscles)

    @property
    def remarks(self) -> list[Remark]:
        """Remarks on laws that are extrapolated or no muscle's, and on friction, for tables and figures."""
        texts = dict.fromkeys(muscle.extrapolation for muscle in self.muscles)
        remarks = [Remark.note("joint", text) for text in filter(None, texts)]
        wrong = dict.fromkeys(muscle.violation for muscle in self.muscles)
        remarks += [Remark.severe("joint", text, CHECK_LAW) for text in filter(None, wrong)]
        if self.has_friction:
            names = [f"muscle{number}" for number, muscle in enumerate(self.muscles, 1) if muscle.has_friction]
            have = "have" if len(names) > 1 else "has"
            text = (
                f"{' and '.join(names)} {have} friction, which the isobaric stiffness leaves out; the small-motion "
                f"stiffness, of motion by {SMALL_MOTION / deg:g} deg, includes it and depends on the presliding "
                "length, a guess where the comments of muscle.yaml say so"
            )
            remarks.append(Remark.note("joint", text))
        return remarks

    @property
    def springs(self) -> tuple[bool, bool]:
        """Whether muscle 1 and muscle 2 are return springs, or none: the other one is alone."""
        return self.muscle1.law.is_passive, self.muscle2.law.is_passive

    @property
    def joint_type(self) -> JointType:
        """How the joint moves: a slide's angles are positions [m], its torques forces [N]."""
        return self.geometry.joint_type

    def check_setpoint(self, stiffness: object) -> None:
        """Raise `RangeError` for a setpoint of the stiffness of a single muscle, or None for that of two."""
        if any(self.springs) and stiffness is not None:
            what = self.joint_type.words("angle")
            message = f"one muscle alone has no stiffness of its own choice: {what} and load determine it"
            raise RangeError(message, field="reference.stiffness", remedy="leave it out")
        if not any(self.springs) and stiffness is None:
            remedy = "give one, which `mckibben envelope` shows"
            raise RangeError("two muscles need a stiffness", field="reference.stiffness", remedy=remedy)

    def check_load(self, load: Load) -> None:
        """Raise `RangeError` for a load that moves in another way."""
        if load.joint_type is not self.joint_type:
            message = f"a {type(load).__name__} loads a {load.joint_type.name}, not a {self.joint_type.name}"
            remedy = "give `class: sliding_mass`" if self.joint_type is SLIDE else "give one that turns, as a pendulum"
            raise RangeError(message, field="load", remedy=remedy)

    @property
    def has_creep(self) -> bool:
        """Whether a muscle has creep."""
        return any(muscle.has_creep for muscle in self.muscles)

    def routes(self, angle: ArrayLike) -> tuple[Route, Route]:
        """Return both muscles with their paths at an angle [rad]."""
        return pair_routes(self.geometry, self.muscles, self.tendon, angle)

    @jit_inline
    def contractions(self, angle: ArrayLike, pressures: Pressures, states: MuscleStates = NO_STATES) -> Pair:
        """Return the contraction [-] of each muscle, (l0 - l)/l0 from the length of its path (Eq. 4)."""
        points = zip(self.muscles, self.geometry.path_lengths(angle), pressure_pair(pressures), states, strict=True)
        contraction1, contraction2 = (self.tendon.contraction(*point) for point in points)
        return contraction1, contraction2

    def tensions(self, angle: ArrayLike, pressures: Pressures) -> Pair:
        """Return the tension [N] of each muscle, F1 and F2, by its law; 0 where it is slack."""
        _warn_outside(self, angle, pressures)
        return self._tensions(angle, pressures)

    @jit_inline
    def _tensions(self, angle: ArrayLike, pressures: Pressures) -> Pair:
        return self._tensions_at(self.geometry.path_lengths(angle), pressures)

    def _tensions_at(self, paths: Pair, pressures: Pressures) -> Pair:
        points = zip(self.muscles, paths, pressure_pair(pressures), strict=True)
        tension1, tension2 = (self.tendon.tension(*point) for point in points)
        return tension1, tension2

    @checked_call
    def torque(self, angle: ArrayLike, pressures: Pressures) -> Float[Array, "..."]:
        """Return the torque of the muscles [N*m], F2 d2 - F1 d1 (Eq. 7 without gravity)."""
        _warn_outside(self, angle, pressures)
        return self._torque(angle, pressures)

    @jit_inline
    def _torque(self, angle: ArrayLike, pressures: Pressures) -> Float[Array, "..."]:
        paths, (arm1, arm2) = self.geometry.paths_and_arms(angle)
        tension1, tension2 = self._tensions_at(paths, pressures)
        return tension2 * arm2 - tension1 * arm1

    @checked_call
    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> Float[Array, "..."]:
        """Return the isobaric stiffness [N*m/rad]: minus the derivative of the torque at constant pressures (Eq. 8).

        Positive for a stable joint; the paper has the opposite sign.
        """
        _warn_outside(self, angle, pressures)
        return self.evaluate(angle, pressures)[1]

    def torque_and_stiffness(self, angle: ArrayLike, pressures: Pressures) -> Pair:
        """Return torque [N*m] (Eq. 7) and isobaric stiffness [N*m/rad] (Eq. 8) from one pass."""
        _warn_outside(self, angle, pressures)
        return self.evaluate(angle, pressures)

    @jit_inline
    @cached_trace
    def evaluate(self, angle: ArrayLike, pressures: Pressures) -> Pair:
        """Return `torque_and_stiffness` without a check of the domain."""
        # Chain rule by hand between geometry and tension: a third of the operations of differentiating the whole.
        (paths, arms), (path_slopes, arm_slopes) = value_and_derivative(self.geometry.paths_and_arms, angle)

        def unsigned_torque(i: int, pressure: ArrayLike) -> Pair:
            """Tension times moment arm of one muscle, and its derivative with respect to the angle."""
            muscle = self.muscles[i]
            tension, by_path = value_and_derivative(lambda path: self.tendon.tension(muscle, path, pressure), paths[i])
            return tension * arms[i], by_path * path_slopes[i] * arms[i] + tension * arm_slopes[i]

        (torque1, slope1), (torque2, slope2) = map(unsigned_torque, (0, 1), pressure_pair(pressures))
        return torque2 - torque1, slope1 - slope2

    def init_state(self, angle: ArrayLike, pressures: Pressures) -> MuscleStates:
        """Return unstressed, relaxed internal states of the muscles."""
        if not (self.has_friction or self.has_creep):
            return NO_STATES
        state1, state2 = init_states(self.routes(angle), pressure_pair(pressures))
        return state1, state2

    def state_rate(
        self, states: MuscleStates, angle: ArrayLike, velocity: ArrayLike, pressures: Pressures
    ) -> MuscleStates:
        """Return the time derivatives of the internal states at an angular velocity [rad/s]."""
        if not self.has_creep:
            return NO_STATES
        points = zip(self.routes(angle), states, pressure_pair(pressures), strict=True)
        rate1, rate2 = (route.muscle.state_rate(state, route.rate((velocity,)), p) for route, state, p in points)
        return rate1, rate2

    def update_state(self, states: MuscleStates, angle: ArrayLike, pressures: Pressures) -> MuscleStates:
        """Return the internal states after a short move to an angle and pressures; the forces do not change."""
        if not (self.has_friction or self.has_creep):
            return states
        state1, state2 = update_states(self.routes(angle), states, pressure_pair(pressures))
        return state1, state2

    def forces(
        self, angle: ArrayLike, velocity: ArrayLike | None, pressures: Pressures, states: MuscleStates = NO_STATES
    ) -> MuscleForces:
        """Return tensions, torque and contractions with friction and creep, at rest or at a velocity [rad/s].

        A velocity of None leaves out the viscous part of friction. No tension is negative.
        """
        _warn_outside(self, angle, pressures)
        points = zip(self.routes(angle), pressure_pair(pressures), states, strict=True)
        (tension1, contraction1, slope1), (tension2, contraction2, slope2) = (
            (*route.forces(p, state, None if velocity is None else route.rate((floating(velocity),))), route.slopes[0])
            for route, p, state in points
        )
        torque = -tension2 * slope2 - tension1 * slope1
        return MuscleForces((tension1, tension2), torque, (contraction1, contraction2))

    def friction_torque(
        self, angle: ArrayLike, velocity: ArrayLike | None, pressures: Pressures, states: MuscleStates
    ) -> Array:
        """Return the friction part [N*m] of the torque of `forces`."""
        added = jnp.asarray(self.forces(angle, velocity, pressures, states).torque) - self.torque(angle, pressures)
        return added - self.creep_torque(angle, pressures, states) if self.has_creep else added

    def creep_torque(self, angle: ArrayLike, pressures: Pressures, states: MuscleStates) -> Array:
        """Return the creep part [N*m] of the torque of `forces`."""
        (arm1, arm2), (tension1, tension2) = self.geometry.moment_arms(angle), self.tensions(angle, pressures)
        contraction1, contraction2 = self.contractions(angle, pressures)
        force1 = self.muscle1.creep_force(contraction1, tension1, states[0])
        return self.muscle2.creep_force(contraction2, tension2, states[1]) * arm2 - force1 * arm1

    def closed_valve_stiffness(
        self,
        angle: ArrayLike,
        pressures: Pressures,
        *,
        polytropic_index: ArrayLike | tuple[ArrayLike, ArrayLike] = 1.0,
        dead_volume: float = 0.0,
    ) -> Num[Array, "..."]:
        """Return the stiffness [N*m/rad] with closed valves: p V^n is constant, n = 1 for slow, 1.4 for fast motion.

        V is the muscle's volume plus a dead volume [m^3], such as tubing and fittings. The index may be one for each
        muscle; a complex one, of air with a temperature (`muscle.air.effective_index`), gives K' + i K''.
        """
        indices = polytropic_index if isinstance(polytropic_index, tuple) else (polytropic_index,) * 2
        return closed_valve_stiffness(self.routes(angle), 0, pressure_pair(pressures), indices, dead_volume)

    def secant_stiffness(
        self,
        angle: ArrayLike,
        pressures: Pressures,
        amplitude: ArrayLike,
        *,
        polytropic_index: ArrayLike | None = None,
        dead_volume: float = 0.0,
    ) -> Float[Array, "..."]:
        r"""Return the secant stiffness [N*m/rad] of slow motion with an amplitude [rad] about an angle, friction
        included.

        .. math:: K_a = \frac{\tau(\theta - a) - \tau(\theta + a)}{2a}

        between the reversals of a cycle, or for a first push by a with unstressed friction: with `MaxwellSlip` both are
        equal (Masing's rule). After motion to one side, a push back by a has the stiffness of a/2.

        Parameters
        ----------
        amplitude
            a [rad], above 0: half the peak-to-peak motion. As it approaches 0, all friction is presliding and acts as a
            spring.
        polytropic_index
            n of closed valves, p V^n constant, with `dead_volume` [m^3] as in `closed_valve_stiffness`. Default:
            constant pressures.

        Examples
        --------
        Friction of 7.5 N in each muscle of the paper's knee adds to an isobaric stiffness of 71.9 N*m/rad:

        >>> import dataclasses
        >>> from mckibben import MaxwellSlip, catalog
        >>> knee = catalog.joint("knee-table-2")
        >>> muscle = dataclasses.replace(knee.muscle1, friction=MaxwellSlip(7.5, 0.5e-3))
        >>> knee = dataclasses.replace(knee, muscle1=muscle, muscle2=muscle)
        >>> knee.secant_stiffness(0.0, (3e5, 3e5), jnp.deg2rad(jnp.array([0.01, 1.0, 3.0]))).round(1)
        Array([118.1,  94.3,  81.1], dtype=float64)
        """
        check_positive("secant_stiffness", "rad", amplitude=amplitude)
        air: Any = {"polytropic_index": polytropic_index, "dead_volume": dead_volume}
        return secant_stiffness(self.routes, 0, angle, pressure_pair(pressures), amplitude, **air)

    def stiffness_for(self, angle: ArrayLike, pressures: Pressures, amplitude: ArrayLike | None) -> Array:
        """Return `secant_stiffness`, or `stiffness` without a domain check if the amplitude is None."""
        if amplitude is None:
            return self.evaluate(angle, pressures)[1]
        return self.secant_stiffness(angle, pressures, amplitude)

    def affine_map(self, angle: ArrayLike) -> TorqueStiffnessMap:
        """Return torque and stiffness as affine functions of the pressures; `TypeError` if they are not affine."""
        for muscle in self.muscles:
            if not isinstance(muscle.law, PressureAffineLaw):
                raise TypeError(f"{type(muscle.law).__name__} is not affine in pressure: the joint has no affine map")
        if not isinstance(self.tendon, RigidTendon):
            raise TypeError(f"with a {type(self.tendon).__name__} the torque is not affine in the pressures")

        def torque_terms(a: Array) -> tuple[Array, Array, Array]:
            (path1, path2), (arm1, arm2) = self.geometry.paths_and_arms(a)
            offset1, gain1 = self.muscle1.force_law.pressure_terms(self.muscle1.specimen.contraction_at(path1))  # type: ignore
            offset2, gain2 = self.muscle2.force_law.pressure_terms(self.muscle2.specimen.contraction_at(path2))  # type: ignore
            return offset2 * arm2 - offset1 * arm1, -gain1 * arm1, gain2 * arm2

        torque, slopes = value_and_derivative(torque_terms, angle)
        return TorqueStiffnessMap(AffineMap(*torque), AffineMap(*(-slope for slope in slopes)))

    @checked_call
    def attainable_torque(
        self, angle: ArrayLike, *, pressure_limits: tuple[float, float] | None = None, minimum_tension: float = 0.0
    ) -> Pair:
        """Return the range of static torque [N*m] at an angle; arguments as for `attainable_stiffness`.

        From the lowest tension of one muscle with the highest of the other; NaN where no tensions are within limits.

        >>> from mckibben import catalog
        >>> [round(float(torque), 2) for torque in catalog.joint("knee-table-2").attainable_torque(0.0)]
        [-17.25, 17.25]
        """
        attainable.check_angle(angle)
        return attainable.torque_range(self, angle, pressure_limits, minimum_tension)

    @checked_call
    def attainable_stiffness(
        self,
        angle: ArrayLike,
        torque: ArrayLike,
        *,
        pressure_limits: tuple[float, float] | None = None,
        minimum_tension: float = 0.0,
        amplitude: ArrayLike | None = None,
    ) -> Pair:
        """Return the lowest and highest stiffness [N*m/rad] at which the taut muscles give a torque [N*m] at an angle.

        Exact with a rigid tendon and laws affine in pressure; with a series spring, from a scan of a few hundred
        tensions. NaN where the torque is not attainable: it violates pressure limits, a muscle's contraction domain or
        its rated force, or a muscle is slack at all pressures. A direct call warns, with the reason, if it is
        attainable nowhere.

        Parameters
        ----------
        pressure_limits
            Lowest and highest gauge pressure [Pa]. Default: the muscles' domains.
        minimum_tension
            Lowest tension [N] of each muscle.
        amplitude
            Amplitude [rad] of motion for `secant_stiffness`, evaluated at 33 tensions. Default: the isobaric stiffness.
        """
        attainable.check_angle(angle)
        band = attainable.stiffness_range(self, angle, torque, pressure_limits, minimum_tension, amplitude)
        attainable.warn_unattainable(self, angle, torque, band[0], pressure_limits, minimum_tension)
        return band

    @checked_call
    def pressures_for(self, angle: ArrayLike, torque: ArrayLike, stiffness: ArrayLike | None = None) -> Pair:
        """Return gauge pressures [Pa] within the muscles' domains that give a torque [N*m] and a stiffness [N*m/rad].

        Default stiffness: midway between the states of lowest and highest co-contraction.

        Raises
        ------
        UnreachableError
            If there are none; gives the attainable range.
        RangeError
            If a muscle would leave its domain, or a number is not finite.
        """
        attainable.check_angle(angle)
        return attainable.pressures_for(self, angle, torque, stiffness)


def _warn_outside(joint: AntagonisticJoint, angle: ArrayLike, pressures: Pressures) -> None:
    """Warn of concrete states outside a muscle's domain, and of angles in degrees; `RangeError` for text."""
    attainable.check_angle(angle)
    pressure1, pressure2 = pressure_pair(pressures)
    if not any(isinstance(value, Tracer) for value in (angle, pressure1, pressure2)):
        contraction1, contraction2 = joint.contractions(angle, pressures)
        warn_outside((joint.muscle1, contraction1, pressure1), (joint.muscle2, contraction2, pressure2))
