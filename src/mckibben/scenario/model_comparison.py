"""A robot against the model of the file that it was read from: masses, forces and lengths at random states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mckibben.mechanism.bodies import PathElement
from mckibben.mechanism.dynamics import at_rest, motion_equations, posture_of
from mckibben.mechanism.robot import Robot
from mckibben.scenario.model_file import Coordinate, ModelFile
from mckibben.units import GRAVITY

Floats = NDArray[np.float64]

_FORCES = {
    "inertia": "",
    "forces of gravity and velocities": "qfrc_bias",
    "forces of springs": "qfrc_spring",
    "forces of dampers": "qfrc_damper",
    "compensation of gravity": "qfrc_gravcomp",
    "forces of a fluid": "qfrc_fluid",
}


def is_spring(file: ModelFile, tendon: int) -> bool:
    """Whether a tendon has a stiffness, and no actuator drives it."""
    stiff = bool(np.ravel(file.model.tendon_stiffness[tendon])[0])
    return stiff and file.name("tendon", tendon) not in file.driven and not file.disabled("spring")


def _lengths(file: ModelFile, coordinates: Sequence[Coordinate], angles: Floats) -> Floats:
    file.move(coordinates, angles.tolist())
    file.mujoco.mj_comPos(file.model, file.data)
    file.mujoco.mj_tendon(file.model, file.data)
    return file.data.ten_length.copy()


def path_ranges(
    file: ModelFile, coordinates: Sequence[Coordinate], robot: Robot, tendons: Mapping[int, tuple[PathElement, ...]]
) -> dict[int, tuple[float, float]]:
    """Return the shortest and longest path [m] of tendons within the ranges of the joints.

    One joint after the other moves to the best of five angles until none changes the length, from the lower ends, the
    middle and the upper ends: work grows with the number of joints, and not with that of their combinations.
    """
    lower, upper = (np.array([float(getattr(joint, end)) for joint in robot.joints]) for end in ("lower", "upper"))
    ranges = {}
    for tendon in tendons:
        shortest, longest = (_longest(file, coordinates, tendon, lower, upper, sign) for sign in (-1.0, 1.0))
        ranges[tendon] = -shortest, longest
    return ranges


def _longest(
    file: ModelFile, coordinates: Sequence[Coordinate], tendon: int, lower: Floats, upper: Floats, sign: float
) -> float:
    """Longest path times a sign [m]."""

    def length(angles: Floats) -> float:
        return sign * float(_lengths(file, coordinates, angles)[tendon])

    tried, best = lower + 0.37 * (upper - lower), -np.inf
    reference = length(tried)
    acting = []
    for number, angle in enumerate(tried):
        tried[number] = lower[number]
        if abs(length(tried) - reference) > 1e-12:
            acting.append(number)
        tried[number] = angle
    for start in (0.0, 0.5, 1.0):
        angles = lower + start * (upper - lower)
        found, before = length(angles), -np.inf
        while found > before + 1e-12:
            before = found
            for number in acting:
                trials = [(found, float(angles[number]))]
                for angle in np.linspace(lower[number], upper[number], 5).tolist():
                    angles[number] = angle
                    trials.append((length(angles), angle))
                found, angles[number] = max(trials)
        best = max(best, found)
    return best


def differences(
    file: ModelFile,
    robot: Robot,
    base: int,
    coordinates: Sequence[Coordinate],
    tendons: Mapping[int, tuple[PathElement, ...]],
) -> Iterator[str]:
    """Yield the masses, forces and lengths that differ at random states; the base rests at the pose of the file."""
    rng, joints = np.random.default_rng(0), robot.joints
    low, high = ([float(getattr(joint, end)) for joint in joints] for end in ("lower", "upper"))
    angles = rng.uniform(low, high, (2, len(joints)))
    rates = rng.normal(size=angles.shape)
    ours = _own(robot, coordinates, angles, rates)
    theirs = [_of_file(file, robot, base, coordinates, *state) for state in zip(angles, rates, strict=True)]
    names = [*(f"the base along or about {name}" for name in robot.motions), *robot.joint_names]
    for kind in _FORCES:
        found, expected = ours[kind], np.array([state[kind] for state in theirs])
        scale = max(float(np.abs(expected).max()), float(np.abs(found).max()), 1e-9)
        error = np.abs(found - expected).reshape(len(angles), len(names), -1).max(axis=(0, 2))
        where = [name for name, wrong in zip(names, error > 1e-7 * scale, strict=True) if wrong]
        if where:
            shown = ", ".join(where[:3]) + (f" and {len(where) - 3} more" if len(where) > 3 else "")
            yield f"{kind} of {shown}: different by {error.max() / scale:.2g} of the largest, {scale:.3g}"
    for number, points in tendons.items():
        lengths = np.asarray(robot.path_along(points, list(map(jnp.asarray, angles.T)))[0])
        error = np.abs(lengths - [state["lengths"][number] for state in theirs]).max()
        if error > 1e-9:
            yield f"length of {file.named('tendon', number)}: different by {error:.2g} m"


def _own(robot: Robot, coordinates: Sequence[Coordinate], angles: Floats, rates: Floats) -> dict[str, Floats]:
    """Masses and forces of a robot at states; balls have rates where forces are linear in them alone."""
    posture = posture_of(robot, [jnp.asarray(column) for column in angles.T])
    moving = rates * [axis is None for _, axis in coordinates]
    velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, moving.T)))
    made = motion_equations(robot, posture, velocity, GRAVITY)
    size, still = len(made.bias), [0.0] * len(robot.motions)

    def over_states(columns: Sequence) -> Floats:
        return np.stack([np.broadcast_to(np.asarray(one, float), len(angles)) for one in columns], axis=1)

    matrix = over_states([made.matrix[max(i, j)][min(i, j)] for i in range(size) for j in range(size)])
    held = over_states(
        [*still, *(joint.spring_torque(angle) for joint, angle in zip(robot.joints, angles.T, strict=True))]
    )
    pulled = np.zeros_like(held)
    for routed in robot.routed_muscles(posture.angles) if robot.muscles else ():
        if not float(routed.muscle.domain.pressure_max):  # a spring
            tension = np.asarray(routed.tension(0.0))
            for joint, slope in routed.slopes.items():
                pulled[:, len(still) + joint] -= tension * np.asarray(slope)
    damped = over_states([*still, *(-joint.damping * rate for joint, rate in zip(robot.joints, rates.T, strict=True))])
    zero = np.zeros_like(held)
    bias = over_states(made.bias) - held
    return dict(zip(_FORCES, (matrix.reshape(-1, size, size), bias, pulled - held, damped, zero, zero), strict=True))


def _of_file(
    file: ModelFile, robot: Robot, base: int, coordinates: Sequence[Coordinate], angles: Floats, rates: Floats
) -> dict[str, Floats]:
    """Masses, forces and lengths of the file at a state, over motions of ours."""
    model, data, mujoco = file.model, file.data, file.mujoco
    file.move(coordinates, angles.tolist(), rates.tolist())
    columns = file.jacobian(base, robot.base, coordinates)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    forces = {kind: columns.T @ getattr(data, field) for kind, field in _FORCES.items() if field}
    data.qvel[:] = columns @ [*np.zeros(len(robot.motions)), *rates]  # of balls, too
    mujoco.mj_fwdVelocity(model, data)
    forces["forces of dampers"] = columns.T @ data.qfrc_damper
    return {"inertia": columns.T @ matrix @ columns, **forces, "lengths": data.ten_length.copy()}
