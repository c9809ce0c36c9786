"""Coordinates of a leg over a run for drawing: joints, muscle paths, and muscle lengths and diameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from mckibben.export.leg_mjcf import anchors
from mckibben.export.mjcf import Transmission, path_transmission, transmissions
from mckibben.joint.mechanism import specimen_size
from mckibben.leg.dynamics import Posture, Velocity, frames
from mckibben.report.drawing import SLENDER
from mckibben.report.style import VERMILLION

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.leg import LegJoint, LegPlant
    from mckibben.muscle import Muscle

SLACK, FULL = np.array([0.80, 0.85, 0.90]), np.array(to_rgb(VERMILLION))
"""Colours of a muscle at zero pressure and at the largest pressure of a run."""


class Shape(NamedTuple):
    """Length and diameter [m] of a muscle over time, and its pressure relative to the largest."""

    length: NDArray[np.float64]
    diameter: NDArray[np.float64]
    filling: NDArray[np.float64]


def muscle_shapes(plant: LegPlant, run: xr.Dataset, largest: float) -> dict[str, Shape]:
    """Shapes of the muscles in a run by name, at a `largest` pressure [Pa]; side-swing muscles are slack."""
    found = {
        name: _shape(muscle, run["contraction"].sel(muscle=name), run["pressure"].sel(muscle=name) / largest)
        for name, muscle in zip(plant.leg.muscle_names, plant.leg.muscles, strict=True)
    }
    side = plant.leg.side_swing
    if side is not None:
        paths = side.muscles.geometry.path_lengths(0.0)
        pair = zip((side.muscles.muscle1, side.muscles.muscle2), paths, strict=True)
        for number, (muscle, path) in enumerate(pair, 1):
            contraction = np.full(run.sizes["time"], float(muscle.specimen.contraction_at(path)))
            found[f"{side.name}{number}"] = _shape(muscle, contraction, np.zeros_like(contraction))
    return found


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


def posture_of(run: xr.Dataset) -> Posture:
    """Postures of a run, as arrays over time."""
    x, z, pitch = (run[name].to_numpy() for name in ("x", "z", "pitch"))
    return Posture(x, z, pitch, tuple(run["angle"].to_numpy()))  # type: ignore[arg-type]


def _frames(plant: LegPlant, run: xr.Dataset) -> list[Any]:
    """Frames of trunk and links over time."""
    posture = posture_of(run)
    rest = Velocity(*jax.tree.map(jnp.zeros_like, posture))
    return frames(plant.leg, posture, rest)


def skeleton(plant: LegPlant, run: xr.Dataset) -> NDArray[np.float64]:
    """Positions (forwards, up) [m] of the top of the trunk, the joints, and the foot over time: (time, point, 2)."""
    found, leg = _frames(plant, run), plant.leg
    top = max([0.1, *(point[1] for moved in transmissions(leg.joints[0].muscles.geometry) for point in moved.points)])
    points = [found[0].point(-top)[:2], *((frame.x, frame.z) for frame in found[1:])]
    points.append(found[-1].point(leg.links[-1].length)[:2])
    return np.array([np.broadcast_arrays(*point, run["z"].to_numpy())[:2] for point in points]).transpose(2, 0, 1)


def straight_paths(plant: LegPlant, run: xr.Dataset) -> dict[str, list[NDArray[np.float64]]]:
    """Ends of the straight parts of each muscle over time, (time, end, 2) [m]; other muscles are omitted."""
    leg, found = plant.leg, _frames(plant, run)

    def ends(joint: LegJoint, moved: Transmission) -> NDArray[np.float64]:
        index = leg.index(joint.name)
        above, below = found[index : index + 2]
        (x, up), (across, beneath) = anchors(joint, moved)
        fixed = below.x + x * above.cosine - up * above.sine, below.z + x * above.sine + up * above.cosine
        moving = (
            below.x + across * below.cosine - beneath * below.sine,
            below.z + across * below.sine + beneath * below.cosine,
        )
        return np.array([fixed, moving]).transpose(2, 0, 1)

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
