"""Coordinates of a leg over a run for drawing: joints, muscle paths, and muscle lengths and diameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.export.leg_mjcf import anchors
from mckibben.export.mjcf import Transmission, path_transmission, transmissions
from mckibben.joint.mechanism import SLENDER, specimen_size
from mckibben.leg.dynamics import Posture, at_rest, frames
from mckibben.numerics.spatial import Vector
from mckibben.plant.bodies import Frame

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.leg import LegJoint, LegPlant
    from mckibben.muscle import Muscle

SLACK, FULL = np.array([0.80, 0.85, 0.90]), np.array([0xD5, 0x5E, 0x00]) / 255
"""Colours of a muscle at zero pressure and at the largest pressure of a run."""


class Shape(NamedTuple):
    """Length and diameter [m] of a muscle over time, and its pressure relative to the largest."""

    length: NDArray[np.float64]
    diameter: NDArray[np.float64]
    filling: NDArray[np.float64]


def muscle_shapes(plant: LegPlant, run: xr.Dataset, largest: float) -> dict[str, Shape]:
    """Shapes of the muscles in a run by name, at a `largest` pressure [Pa]."""
    return {
        name: _shape(muscle, run["contraction"].sel(muscle=name), run["pressure"].sel(muscle=name) / largest)
        for name, muscle in zip(plant.leg.muscle_names, plant.leg.muscles, strict=True)
    }


def _shape(muscle: Muscle, contraction: Any, filling: Any) -> Shape:
    """Shape of a muscle as a cylinder with its volume; slender if that is unknown."""
    length, diameter = specimen_size(muscle.specimen, np.asarray(contraction, float))
    return Shape(length, SLENDER * length if diameter is None else diameter, np.asarray(filling, float))


def place_of(plant: LegPlant, name: str) -> int:
    """Index of the path segment with the muscle: over two joints, the one with the longer connectors."""
    for one in plant.leg.biarticular:
        if one.name == name:
            return int(np.argmax([float(getattr(path, "connector_length", 0.0)) for path in (one.path1, one.path2)]))
    return 0


def run_posture(plant: LegPlant, run: xr.Dataset) -> Posture:
    """Postures of a run, as arrays over time."""
    x, z, pitch, angles = (run[name].to_numpy() for name in ("x", "z", "pitch", "angle"))
    others = {name: run[name].to_numpy() for name in ("y", "yaw", "roll") if name in plant.leg.trunk.motions}
    return Posture(x, z, pitch, tuple(angles), **others)  # type: ignore[arg-type]


def _frames(plant: LegPlant, run: xr.Dataset) -> list[Frame]:
    """Frames of trunk and links over time."""
    posture = run_posture(plant, run)
    return frames(plant.leg, posture, at_rest(posture))


def _over_time(points: Sequence[Vector], run: xr.Dataset) -> NDArray[np.float64]:
    """Points as an array, (time, point, 3) [m]."""
    times = run["z"].to_numpy()
    return np.array([np.broadcast_arrays(*point, times)[:3] for point in points]).transpose(2, 0, 1)


def skeleton(plant: LegPlant, run: xr.Dataset) -> NDArray[np.float64]:
    """Positions [m] of the top of the trunk, the joints, and the foot over time: (time, point, 3)."""
    found, leg = _frames(plant, run), plant.leg
    top = max([0.1, *(point[1] for moved in transmissions(leg.joints[0].muscles.geometry) for point in moved.points)])
    points = [found[0].point(top)[0], *(frame.position for frame in found[1:])]
    return _over_time([*points, found[-1].point(-leg.links[-1].length)[0]], run)


def straight_paths(plant: LegPlant, run: xr.Dataset) -> dict[str, list[NDArray[np.float64]]]:
    """Ends of the straight parts of each muscle over time, (time, end, 3) [m]; other muscles are omitted."""
    leg, found = plant.leg, _frames(plant, run)

    def ends(joint: LegJoint, moved: Transmission) -> NDArray[np.float64]:
        index = leg.index(joint.name)
        above, below = found[index : index + 2]
        fixed, moving = anchors(joint, moved)
        return _over_time([below.position + above.axes.apply(fixed), below.position + below.axes.apply(moving)], run)

    paths: dict[str, list[NDArray[np.float64]]] = {}
    for joint in leg.joints:
        for number, moved in enumerate(transmissions(joint.muscles.geometry), 1):
            if moved.points:
                paths[f"{joint.name}{number}"] = [ends(joint, moved)]
    for one in leg.biarticular:
        both = (one.joint1, one.path1), (one.joint2, one.path2)
        parts = [(leg.joints[leg.index(name)], path_transmission(0, path, 1)) for name, path in both]
        if all(moved.points for _, moved in parts):
            paths[one.name] = [ends(*part) for part in parts]
    return paths
