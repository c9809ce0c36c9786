"""Animation of a run of a leg: MuJoCo's rendering next to forces, angles and pressures."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from mckibben.errors import ExportError
from mckibben.export.leg_mjcf import coordinates, leg_scene
from mckibben.export.mujoco import import_mujoco
from mckibben.numerics.calculus import evenly_spaced
from mckibben.report.animation import animation_format, write_frames
from mckibben.report.leg_shapes import FULL, SLACK, muscle_shapes, place_of, run_posture, skeleton
from mckibben.report.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION, styled
from mckibben.units import bar, deg, ms

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.leg import LegPlant, LegResult

_SIZE = 560, 400
"""Height and width of the picture of the leg, in pixels."""
_CURSOR = 0x50
_ARROW = 0.4
"""Length [m] of the arrow of the largest force."""
_LINES = (BLUE, SKY, VERMILLION, ORANGE, GREEN, PURPLE)


def render_leg(
    plant: LegPlant,
    run: LegResult,
    path: str | os.PathLike[str],
    *,
    frames: int = 72,
    seconds: float = 4.5,
    overwrite: bool = False,
) -> Path:
    """Write an animation of a run, WebP or GIF by the suffix of the path; return the path.

    Muscles between points are drawn with the volume at their contraction and coloured by pressure; muscles on pulleys
    and cams are not drawn. An arrow shows the ground force.

    Parameters
    ----------
    plant, run
        The leg, and the result of `simulate_leg`.
    frames, seconds
        Number of pictures, and time [s] in which they are shown.
    overwrite
        Replace an existing file.

    Raises
    ------
    ExportError
        Without MuJoCo, or if it cannot render.
    ParameterError
        For any other format.
    FileError
        If the file exists and `overwrite` is not set.
    """
    animation_format(path)
    table = run.to_dataset()
    chosen = evenly_spaced(table.sizes["time"], frames)
    pictures = _pictures(plant, table, chosen)
    plot, places, rows = _plot(plant, table, seconds)
    images = []
    for picture, place in zip(pictures, places[chosen], strict=True):
        beside = plot.copy()
        for low, high in rows:
            beside[low:high, place - 1 : place + 1] = _CURSOR
        images.append(Image.fromarray(np.concatenate([picture, beside], axis=1)))
    return write_frames(images, path, round(seconds / len(images) * 1000), overwrite=overwrite, quality=64, method=4)


def _pictures(plant: LegPlant, run: xr.Dataset, chosen: NDArray[np.int_]) -> NDArray[np.uint8]:
    """Pictures of the leg at some times, rendered by MuJoCo in a separate process."""
    import_mujoco()
    at = run.isel(time=chosen)
    shapes = muscle_shapes(plant, at, float(run["pressure"].max()) or 1.0)
    scene = leg_scene(plant, plant.init_state(*_start(run)))
    rows = [(sites, shapes[name]) for name, parts in scene.parts.items() for sites in [parts[place_of(plant, name)]]]
    colours = [SLACK + one.filling[:, None] * (FULL - SLACK) for _, one in rows]
    posture = run_posture(plant, at)
    force = np.stack([at[f"ground_{name}"] for name in ("forward", "left", "up")], -1)
    force *= _ARROW / (float(run["ground_up"].max()) or 1.0)
    top = float(run["z"].max()) + 0.47
    points = skeleton(plant, at)
    left, right = float(points[..., 0].min()), float(points[..., 0].max())
    given = {
        "position": np.stack(coordinates(plant, posture), -1),
        "sites": np.array([sites for sites, _ in rows]).reshape(-1, 2),
        "length": np.array([one.length for _, one in rows]),
        "diameter": np.array([one.diameter for _, one in rows]),
        "colour": np.array([np.c_[one, np.ones(len(one))] for one in colours]),
        "force": force,
        "lookat": [(left + right) / 2, 0.0, top / 2 - 0.03],
        "distance": max(top, (right - left + 0.3) * _SIZE[0] / _SIZE[1]) * 1.32,
        "azimuth": 68.0,
        "elevation": -9.0,
        "size": _SIZE,
    }
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.xml").write_text(scene.xml, encoding="utf-8")
        np.savez(Path(folder) / "frames.npz", **given)
        _draw(folder)
        return np.load(Path(folder) / "frames.npy")


def _draw(folder: str) -> None:
    """Run the renderer with the first working OpenGL."""
    program, said = str(Path(__file__).with_name("leg_frames.py")), ""
    own = os.environ.get("MUJOCO_GL")
    for kind in (own,) if own else ("egl", "osmesa"):
        environment = os.environ | {"MUJOCO_GL": kind}
        done = subprocess.run([sys.executable, program, folder], env=environment, capture_output=True, text=True)
        if not done.returncode:
            return
        said = done.stderr.strip().splitlines()[-1:]
    message = f"MuJoCo cannot draw without a display: {' '.join(said)[:300]}"
    remedy = "install offscreen OpenGL: apt install libegl1 or libosmesa6, or set MUJOCO_GL"
    raise ExportError(message, field="MUJOCO_GL", value=own, remedy=remedy)


def _start(run: xr.Dataset) -> tuple[list[float], list[float]]:
    """Angles and pressures at the start of a run."""
    first = run.isel(time=0)
    return first["angle"].to_numpy().tolist(), first["pressure"].to_numpy().tolist()


@styled
def _plot(
    plant: LegPlant, run: xr.Dataset, seconds: float
) -> tuple[NDArray[np.uint8], NDArray[np.int_], list[tuple[int, int]]]:
    """Force, angles and pressures over time as an image; column of each time, and rows of the panels."""
    height, width = _SIZE[0], 480
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, layout="constrained")
    force, angle, pressure = figure.subplots(3, 1, sharex=True)
    times = run["time"].to_numpy() / ms
    weight = float(plant.leg.total_mass * plant.gravity)
    force.plot(times, run["ground_up"] / weight, color=GREEN)
    force.set_ylabel("ground force,\nbody weights")
    _lines(angle, times, run["angle"] / deg, "joint")
    angle.set_ylabel("angle, deg")
    _lines(pressure, times, run["pressure"] / bar, "muscle")
    pressure.set_ylabel("pressure, bar")
    pressure.set_ylim(bottom=0)
    pressure.set_xlabel(f"time, ms (shown at 1/{seconds / (times[-1] * ms):.0f} of the speed)")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    panels = [force, angle, pressure]
    columns = force.transData.transform(np.c_[times, np.zeros_like(times)])[:, 0]
    boxes = [one.get_window_extent() for one in panels]
    rows = [(round(height - box.y1), round(height - box.y0)) for box in boxes]
    return pixels, columns.round().astype(int), rows


def _lines(axes: Axes, times: NDArray[np.float64], values: xr.DataArray, along: str) -> None:
    """One line per joint or muscle, with its name."""
    names = values[along].to_numpy()
    looks = _LINES if len(names) > 2 else (BLACK, VERMILLION)
    for number, name in enumerate(names):
        again = "-" if number < len(looks) else "--"
        axes.plot(times, values.sel({along: name}), again, color=looks[number % len(looks)], label=str(name))
    axes.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 0.98), borderaxespad=0.1)
