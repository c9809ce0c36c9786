"""Renderer of leg frames with MuJoCo: a separate program, as MuJoCo selects OpenGL once per process.

    MUJOCO_GL=egl python leg_frames.py FOLDER

Reads scene.xml and frames.npz in the folder; writes frames.npy, an array of shape (frames, height, width, 3).
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

_FITTING = 0.75, 0.77, 0.80, 1.0
_ARROW = 0.0, 0.45, 0.33, 1.0


def main(folder: Path) -> None:
    """Render all frames."""
    import mujoco

    engine: Any = mujoco
    given = np.load(folder / "frames.npz")
    model = engine.MjModel.from_xml_path(str(folder / "scene.xml"))
    data = engine.MjData(model)
    camera = engine.MjvCamera()
    camera.lookat[:], camera.distance = given["lookat"], given["distance"]
    camera.azimuth, camera.elevation = given["azimuth"], given["elevation"]
    height, width = map(int, given["size"])
    pictures = np.empty((len(given["position"]), height, width, 3), np.uint8)
    with engine.Renderer(model, height, width) as renderer:
        for number, position in enumerate(given["position"]):
            data.qpos[:] = position
            engine.mj_forward(model, data)
            renderer.update_scene(data, camera)
            painter = _Painter(engine, renderer.scene)
            rows = zip(given["sites"], given["length"], given["diameter"], given["colour"], strict=True)
            for sites, length, diameter, colour in rows:
                ends = [data.site(str(site)).xpos for site in sites]
                painter.muscle(ends, length[number], diameter[number] / 2, colour[number])
            foot = data.geom("foot")
            painter.arrow(foot.xpos - [0, 0, model.geom("foot").size[0]], given["force"][number])
            pictures[number] = renderer.render()
    np.save(folder / "frames.npy", pictures)


class _Painter:
    """Adds objects outside the model to a scene."""

    def __init__(self, engine: Any, scene: Any) -> None:
        self._engine, self._scene = engine, scene

    def _geometry(self, kind: str, colour: Any) -> Any:
        scene, engine = self._scene, self._engine
        made = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        shape = getattr(engine.mjtGeom, f"mjGEOM_{kind}")
        engine.mjv_initGeom(made, shape, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.asarray(colour, np.float32))
        return made, shape

    def _between(self, kind: str, radius: float, first: Any, last: Any, colour: Any) -> None:
        made, shape = self._geometry(kind, colour)
        self._engine.mjv_connector(made, shape, radius, first, last)
        made.specular, made.shininess = 0.3, 0.4

    def muscle(self, ends: list[Any], length: float, radius: float, colour: Any) -> None:
        """A muscle midway between two points, with its fittings."""
        middle, along = (ends[0] + ends[1]) / 2, ends[1] - ends[0]
        along = along / np.linalg.norm(along)
        half = length / 2
        inner = max(half - radius, 1e-3)
        self._between("CAPSULE", radius, middle - inner * along, middle + inner * along, colour)
        for side in (-1, 1):
            near, far = (middle + side * (half + one) * along for one in (-0.012, 0.012))
            self._between("CYLINDER", 0.0085, near, far, _FITTING)

    def arrow(self, point: Any, force: Any) -> None:
        """The force on the foot, from the point where it acts."""
        if np.linalg.norm(force) > 0.02:
            start = point + np.array([0.0, -0.06, 0.005])
            self._between("ARROW", 0.014, start, start + 2 * np.asarray(force), _ARROW)  # drawn at half


if __name__ == "__main__":
    main(Path(sys.argv[1]))
