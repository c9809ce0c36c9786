"""Animation of a run: a joint or robot with its muscles, next to angles, stiffness and pressures over time."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import PyTree
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray
from PIL import Image

from mckibben.errors import ParameterError, SimulationError
from mckibben.joint.linkage import linkage_of, muscle_sizes
from mckibben.mechanism.outline import BASE, outline
from mckibben.report.drawing import JointPicture, outer_points
from mckibben.report.palette import MEASURED
from mckibben.report.robot import BONE, set_space
from mckibben.report.style import DESIRED, Look, looks_of, pressure_colours, robust_limits, styled
from mckibben.report.tracking import TIME, draw_angle, draw_pressures, draw_stiffness
from mckibben.scenario.robot import RobotScenario
from mckibben.storage.files import atomic_write
from mckibben.units import bar, deg, mm

if TYPE_CHECKING:
    from mckibben.plant import JointPlant
    from mckibben.plant.robot_plant import RobotPlant
    from mckibben.simulation import SimulationResult

Stage = tuple[Sequence[Artist], Callable[[int], None]]
"""Moving artists, and a function that moves them to a frame."""

FORMATS = {".webp": "WEBP", ".gif": "GIF"}
"""Format by the end of a file's name."""

_SIZE = (6.4, 4.0)  # inches
_DPI = 100
_RATE = 12  # frames per second
_MOST_FRAMES = 120


def animation_format(path: str | os.PathLike[str]) -> str:
    """Format of an animation by the end of its name.

    >>> animation_format("knee.webp")
    'WEBP'

    Raises `ParameterError` for any other ending.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        message = f"{Path(path).name!r} is not the name of an animation"
        raise ParameterError(message, field="path", value=suffix, remedy=f"end it in {' or '.join(FORMATS)}")
    return FORMATS[suffix]


def animate(
    result: SimulationResult, path: str | os.PathLike[str], plant: PyTree = None, *, overwrite: bool = False
) -> Path:
    """Write an animation of a run: a joint or robot moves, its muscles are coloured by pressure.

    The diameter of a joint's muscles follows from the volume of their specimens at the current contraction. Runs up to
    10 s play in real time, longer ones in 10 s.

    Parameters
    ----------
    result
        Run.
    path
        File to write, ending in ``.webp`` or ``.gif``.
    plant
        Plant of the run. Default: the plant of its scenario.
    overwrite
        Replace an existing file.

    Raises
    ------
    ParameterError
        If the name has any other ending.
    SimulationError
        If the run has no scenario and no plant is given, or its state is not finite.
    FileError
        If the file exists and `overwrite` is not set.
    """
    kind = animation_format(path)
    if not np.isfinite(result["angle"]).all():
        raise SimulationError("the run diverged: there is nothing to draw", remedy="animate a run that is finite")
    frames = _frames(result, _plant_of(result) if plant is None else plant)
    milliseconds = round(1000 * min(result.times[-1] / len(frames), _MOST_FRAMES / _RATE / len(frames)))
    options: Look = {"lossless": True, "quality": 30, "method": 2} if kind == "WEBP" else {}
    options |= {"save_all": True, "append_images": frames[1:], "loop": 0, "duration": max(milliseconds, 20)}
    with atomic_write(path, overwrite=overwrite) as temporary:
        frames[0].save(temporary, format=kind, **options)
    return Path(path)


def _plant_of(result: SimulationResult) -> PyTree:
    """The plant of a result's scenario."""
    if not result.scenario:
        remedy = "give its plant: animate(result, path, plant)"
        raise SimulationError("the run has no scenario, so there is nothing to draw", field="plant", remedy=remedy)
    from mckibben.scenario import Scenario

    return (RobotScenario if result.joints else Scenario).parse(result.scenario).plant()


@styled
def _frames(result: SimulationResult, plant: PyTree) -> list[Image.Image]:
    """Images of a run at 12 per second, at most 120; static parts are drawn once."""
    times = result.times
    count = int(np.clip(times[-1] * _RATE, 2, _MOST_FRAMES))
    at = np.linspace(0, len(times) - 1, count).round().astype(int)
    figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    halves: Any = figure.subfigures(1, 2, width_ratios=(0.85, 1.7))
    draw: PyTree = (_stage_of_robot, _plots_of_robot) if result.joints else (_stage_of_joint, _plots)
    (artists, update), rows = draw[0](halves[0], result, plant, at), draw[1](halves[1], result)
    rows[2].set(xlabel=TIME, xlim=(0, times[-1]))
    halves[1].align_ylabels(list(rows))
    cursors = [axes.axvline(0.0, color="#222222", linewidth=1.2, zorder=9) for axes in rows]
    moving = [*artists, *cursors]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    figure.set_layout_engine("none")
    background = canvas.copy_from_bbox(figure.bbox)
    images = []
    for frame, index in enumerate(at):
        canvas.restore_region(background)
        update(frame)
        for cursor in cursors:
            cursor.set_xdata([times[index]])
        for artist in sorted(moving, key=Artist.get_zorder):
            assert artist.axes is not None
            artist.axes.draw_artist(artist)
        images.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    return images


def _pressure_scale(figure: SubFigure, axes: Axes, highest: float) -> ScalarMappable:
    """Colours of pressures [bar], with their bar."""
    scale = ScalarMappable(Normalize(0.0, highest or 1.0), pressure_colours())
    figure.colorbar(scale, ax=axes, location="bottom", label="pressure [bar]", fraction=0.04, pad=0.02)
    return scale


def _stage_of_joint(figure: SubFigure, result: SimulationResult, plant: JointPlant, at: NDArray[np.int64]) -> Stage:
    angles = result["angle"][at]
    linkage = linkage_of(plant.joint.geometry, (float(angles.min()), float(angles.max())), plant.load)
    lengths, diameters = muscle_sizes(plant.joint, (result["contraction1"][at], result["contraction2"][at]))
    pressures = np.array([result["pressure1"][at], result["pressure2"][at]]) / bar
    stage = figure.subplots()
    picture = JointPicture(stage, linkage, plant.joint.springs)
    box = outer_points(linkage, np.linspace(angles.min(), angles.max(), 5).tolist())
    margin = 0.05 * np.ptp(box, axis=0).max()
    stage.set_xlim(box[:, 0].min() - margin, box[:, 0].max() + margin)
    stage.set_ylim(box[:, 1].min() - margin, box[:, 1].max() + margin)
    scale = _pressure_scale(figure, stage, float(pressures.max()))

    def update(frame: int) -> None:
        size = [length[frame] for length in lengths], [None if width is None else width[frame] for width in diameters]
        picture.update(float(angles[frame]), *size, list(scale.to_rgba(pressures[:, frame])))

    return picture.artists, update


def _stage_of_robot(figure: SubFigure, result: SimulationResult, plant: RobotPlant, at: NDArray[np.int64]) -> Stage:
    robot, base = plant.robot, [[result[name][i] for name in BASE] for i in at]
    shapes = [outline(robot, result["angle"][:, i].tolist(), where) for i, where in zip(at, base, strict=True)]
    axes = figure.add_subplot(projection="3d", proj_type="ortho", computed_zorder=False)
    set_space(axes, [line for shape in shapes for line in (*shape.bodies, *shape.muscles.values())])
    axes.set(xlabel="", ylabel="", zlabel="", title="mm")
    axes.tick_params(labelsize=5, pad=-3)
    axes.set_box_aspect((1, 1, 1.6), zoom=1.3)
    scale = _pressure_scale(figure, axes, robot.highest_pressure / bar)
    bones: list[PyTree] = [axes.plot([], [], [], **BONE)[0] for _ in shapes[0].bodies]
    muscles: dict[str, PyTree] = {name: axes.plot([], [], [], linewidth=2)[0] for name in shapes[0].muscles}

    def update(frame: int) -> None:
        lines, pressures = shapes[frame], dict(zip(result.muscles, result["pressure"][:, at[frame]], strict=True))
        for artist, line in zip(bones, lines.bodies, strict=True):
            artist.set_data_3d(*line.T / mm)
        for name, artist in muscles.items():
            artist.set_data_3d(*lines.muscles[name].T / mm)
            artist.set_color(scale.to_rgba(pressures[name] / bar))

    return [*bones, *muscles.values()], update


def _plots_of_robot(figure: SubFigure, result: SimulationResult) -> Sequence[Axes]:
    """Plot angles, stiffness and pressures over time; references are dashed."""
    rows = figure.subplots(3, 1, sharex=True)
    quantities = (("angle", "angle [deg]", deg), ("stiffness", "stiffness\n[N·m/rad]", 1.0))
    looks = looks_of(result.joints)
    for axes, (name, label, unit) in zip(rows, quantities, strict=False):
        for column, dashed in ((name, {}), (f"desired_{name}", DESIRED)):
            for joint, values in zip(result.joints, result[column] / unit, strict=True):
                axes.plot(result.times, values, **looks[joint] | dashed, label=None if dashed else joint)
        axes.set_ylabel(label)
    rows[0].legend(loc="upper right", fontsize=6, ncols=2)
    for muscle, look in zip(result["pressure"], looks_of(result.muscles).values(), strict=True):
        rows[2].plot(result.times, muscle / bar, **look)
    rows[2].set_ylabel("pressure [bar]")
    return rows


def _plots(figure: SubFigure, result: SimulationResult) -> Sequence[Axes]:
    """Plot angle, stiffness and pressures over time."""
    rows = figure.subplots(3, 1, sharex=True)
    looks = {"run": {"color": MEASURED}}
    draw_angle(rows[0], {"run": result}, looks)
    draw_stiffness(rows[1], {"run": result}, looks)
    draw_pressures(rows[2], result)
    kind = result.joint_type
    angle, stiffness = kind.size("deg"), kind.size("N*m/rad")
    rows[0].set_ylim(*robust_limits([result["angle"] / angle, result["desired_angle"] / angle]))
    rows[1].set(ylabel=kind.label("stiffness", "N*m/rad").replace(" [", "\n["))
    values = result["stiffness"] / stiffness, result["desired_stiffness"] / stiffness
    rows[1].set_ylim(*robust_limits([curve for curve in values if np.isfinite(curve).all()], margin=0.3))
    return rows
