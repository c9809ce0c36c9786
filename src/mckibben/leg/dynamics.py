"""Dynamics of the planar leg by the articulated-body algorithm.

R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, ch. 7 and 9, in the plane: motions are (angular,
forward, up), forces (moment, forward, up), both in world axes at the upper joint of each body. Angles are positive
forwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.leg.mechanism import Leg
from mckibben.numerics.elementary import sincos

Scalar = Float[Array, ""]


class Posture(NamedTuple):
    """Position of a leg: hip [m], pitch of the trunk [rad], and angles of the joints [rad]."""

    x: Scalar
    z: Scalar
    pitch: Scalar
    angles: tuple[Scalar, ...]


class Velocity(NamedTuple):
    """Rates of a `Posture` [m/s], [rad/s]."""

    x: Scalar
    z: Scalar
    pitch: Scalar
    angles: tuple[Scalar, ...]


class Frame(NamedTuple):
    """Upper joint of a body: sine and cosine of its angle from hanging down, rate, position and velocity."""

    sine: Any
    cosine: Any
    rate: Any
    x: Any
    z: Any
    vx: Any
    vz: Any

    def point(self, along: Any) -> tuple[Any, Any, Any, Any]:
        """Return position and velocity of a point at a distance [m] along the body."""
        dx, dz = along * self.sine, -along * self.cosine
        return self.x + dx, self.z + dz, self.vx - self.rate * dz, self.vz + self.rate * dx


class Contact(NamedTuple):
    """Lowest point of the foot: position [m] and velocity [m/s]."""

    x: Any
    z: Any
    vx: Any
    vz: Any


def frames(leg: Leg, posture: Posture, velocity: Velocity) -> list[Frame]:
    """Return the frames of trunk and links; the trunk's is at the hip."""
    pitch, rate = (posture.pitch, velocity.pitch) if leg.trunk.freedom == "free" else (jnp.zeros(()), jnp.zeros(()))
    found = [Frame(*sincos(pitch), rate, posture.x, posture.z, velocity.x, velocity.z)]
    angle, distance = pitch, 0.0
    for joint, link, at, moving in zip(leg.joints, leg.links, posture.angles, velocity.angles, strict=True):
        angle = angle + joint.link_angle + joint.sign * at
        rate = rate + joint.sign * moving
        found.append(Frame(*sincos(angle), rate, *found[-1].point(distance)))
        distance = link.length
    return found


def contact(leg: Leg, found: Sequence[Frame]) -> Contact:
    """Return the lowest point of the foot."""
    x, z, vx, vz = found[-1].point(leg.links[-1].length)
    return Contact(x, z - leg.foot_radius, vx + found[-1].rate * leg.foot_radius, vz)


def centres(leg: Leg) -> list[tuple[Any, Any, Any]]:
    """Return mass, distance of the centre of mass along the body, and inertia of trunk and links."""
    trunk = leg.trunk
    return [(trunk.mass, -trunk.centre, trunk.inertia), *((one.mass, one.centre, one.inertia) for one in leg.links)]


class BodyMotion(NamedTuple):
    """Mechanical state in sums: energies [J], and height [m], speeds [m/s] of the centre of mass."""

    kinetic: Scalar
    potential: Scalar
    height: Scalar
    forward_speed: Scalar
    upward_speed: Scalar


def motion(leg: Leg, posture: Posture, velocity: Velocity, gravity: ArrayLike) -> BodyMotion:
    """Return energies and the motion of the centre of mass; the potential energy of the height 0 is 0."""
    kinetic = moment = forward = upward = jnp.zeros(())
    for frame, (mass, along, inertia) in zip(frames(leg, posture, velocity), centres(leg), strict=True):
        _, z, vx, vz = frame.point(along)
        kinetic = kinetic + (mass * (vx * vx + vz * vz) + inertia * frame.rate * frame.rate) / 2
        moment, forward, upward = moment + mass * z, forward + mass * vx, upward + mass * vz
    each = 1 / leg.total_mass
    return BodyMotion(kinetic, moment * gravity, moment * each, forward * each, upward * each)


class _Articulated(NamedTuple):
    """Articulated inertia (symmetric) and bias force: moment, forward, up."""

    a: Any
    bx: Any
    bz: Any
    cxx: Any
    cxz: Any
    czz: Any
    n: Any
    fx: Any
    fz: Any

    def __add__(self, other: Any) -> _Articulated:
        return _Articulated(*(one + two for one, two in zip(self, other, strict=True)))

    def moved(self, dx: Any, dz: Any, rate: Any) -> _Articulated:
        """The same at the upper joint of the body above, which turns at a rate, and is at -(dx, dz)."""
        a, bx, bz, cxx, cxz, czz, n, fx, fz = self
        ax, az = -rate * rate * dx, -rate * rate * dz  # centripetal acceleration
        n, fx, fz = n + bx * ax + bz * az, fx + cxx * ax + cxz * az, fz + cxz * ax + czz * az
        ex, ez = bx - dz * cxx + dx * cxz, bz - dz * cxz + dx * czz
        return _Articulated(a + dx * (bz + ez) - dz * (bx + ex), ex, ez, cxx, cxz, czz, n + dx * fz - dz * fx, fx, fz)


def acceleration(
    leg: Leg,
    posture: Posture,
    velocity: Velocity,
    torques: Sequence[ArrayLike],
    force: tuple[Array, Array],
    gravity: ArrayLike,
) -> Velocity:
    """Return the accelerations under torques [N*m] of the joints and a force [N] (forward, up) at the foot.

    Locked joints, and motions that the trunk lacks, have an acceleration of 0.
    """
    found = frames(leg, posture, velocity)
    bodies = centres(leg)
    joint_terms: list[Any] = []
    point = contact(leg, found)
    dx, dz = point.x - found[-1].x, point.z - found[-1].z
    outer = _Articulated(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, dz * force[0] - dx * force[1], -force[0], -force[1])
    for index in range(len(found) - 1, 0, -1):
        frame, above = found[index], found[index - 1]
        here = _rigid(frame, bodies[index], gravity) + outer
        joint = leg.joints[index - 1]
        if joint.locked is not None:
            joint_terms.append(None)
            outer = here.moved(frame.x - above.x, frame.z - above.z, above.rate)
            continue
        a, bx, bz, cxx, cxz, czz, n, fx, fz = here
        inverse = 1 / a
        surplus = joint.sign * torques[index - 1] - n
        joint_terms.append((a, bx, bz, inverse, surplus))
        gx, gz = bx * inverse, bz * inverse
        torque = joint.sign * torques[index - 1]
        rest = cxx - gx * bx, cxz - gx * bz, czz - gz * bz
        here = _Articulated(0.0, 0.0, 0.0, *rest, torque, fx + gx * surplus, fz + gz * surplus)
        outer = here.moved(frame.x - above.x, frame.z - above.z, above.rate)
    angular, ax, az = first = _trunk_acceleration(leg.trunk.freedom, _rigid(found[0], bodies[0], gravity) + outer)
    accelerations = []
    for index, (joint, terms) in enumerate(zip(leg.joints, reversed(joint_terms), strict=True)):
        frame, above = found[index + 1], found[index]
        dx, dz = frame.x - above.x, frame.z - above.z
        square = above.rate * above.rate
        ax, az = ax - angular * dz - square * dx, az + angular * dx - square * dz
        if terms is None:
            accelerations.append(jnp.zeros(()))
            continue
        a, bx, bz, inverse, surplus = terms
        relative = (surplus - (a * angular + bx * ax + bz * az)) * inverse
        angular = angular + relative
        accelerations.append(joint.sign * relative)
    return Velocity(first[1], first[2], first[0], tuple(accelerations))


def foot_mobility(leg: Leg, posture: Posture) -> Float[Array, "2 2"]:
    """Return the acceleration of the foot per force on it [1/kg], forwards and up: its inverse apparent mass."""
    zero = jnp.zeros(())
    still = Velocity(zero, zero, zero, tuple(zero for _ in leg.joints))

    def moved(force: Array) -> Array:
        rates = acceleration(leg, posture, still, (0.0,) * len(leg.joints), (force[0], force[1]), 0.0)
        point = contact(leg, frames(leg, posture, rates))  # at rest, accelerations depend on forces as velocities do
        return jnp.stack([point.vx, point.vz])

    return jax.jacfwd(moved)(jnp.zeros(2))


def joint_mobility(leg: Leg, posture: Posture) -> Float[Array, "joints joints"]:
    """Return the accelerations of the joints per torque on them [1/(kg*m^2)]; 0 for locked joints."""
    zero = jnp.zeros(())
    still = Velocity(zero, zero, zero, tuple(zero for _ in leg.joints))

    def moved(torques: Array) -> Array:
        return jnp.stack(acceleration(leg, posture, still, tuple(torques), (zero, zero), 0.0).angles)

    return jax.jacfwd(moved)(jnp.zeros(len(leg.joints)))


def _rigid(frame: Frame, body: tuple[Any, Any, Any], gravity: ArrayLike) -> _Articulated:
    """Inertia and bias force of one body, with gravity."""
    mass, along, inertia = body
    rx, rz = along * frame.sine, -along * frame.cosine
    square = frame.rate * frame.rate
    forces = mass * gravity * rx, -mass * square * rx, mass * gravity - mass * square * rz
    return _Articulated(inertia + mass * along * along, -mass * rz, mass * rx, mass, 0.0, mass, *forces)


def _trunk_acceleration(freedom: str, base: _Articulated) -> tuple[Any, Any, Any]:
    """Angular, forward and upward acceleration of the trunk, in the motions that it has."""
    a, bx, bz, cxx, cxz, czz, n, fx, fz = base
    zero = jnp.zeros(())
    if freedom == "fixed":
        return zero, zero, zero
    if freedom == "vertical":
        return zero, zero, -fz / czz
    if freedom == "free":  # eliminates the rotation
        inverse = 1 / a
        gx, gz = bx * inverse, bz * inverse
        cxx, cxz, czz, fx, fz = cxx - gx * bx, cxz - gx * bz, czz - gz * bz, fx - gx * n, fz - gz * n
    inverse_determinant = 1 / (cxx * czz - cxz * cxz)
    ax, az = (cxz * fz - czz * fx) * inverse_determinant, (cxz * fx - cxx * fz) * inverse_determinant
    return (-(n + bx * ax + bz * az) / a if freedom == "free" else zero), ax, az
