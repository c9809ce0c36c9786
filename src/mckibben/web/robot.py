"""Robot page: bodies and muscles in space in a posture, and what is attainable at each joint."""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from nicegui import events, ui

from mckibben import catalog
from mckibben.component.schema import read_component
from mckibben.config.document import LONGEST_TEXT, plain, read_document, to_text
from mckibben.config.model import parse_model
from mckibben.errors import McKibbenError, RangeError, printable
from mckibben.mechanism.outline import Ellipsoid, Outline, outline, stiffness_ellipsoid
from mckibben.muscle import Muscle
from mckibben.report.palette import BLUE, GREY
from mckibben.result import Listing, Remark
from mckibben.scenario import StudiedScenario
from mckibben.scenario.robot import RobotScenario
from mckibben.statics.attainable import attainable_listing, attainable_statics
from mckibben.statics.posture import holding_torques
from mckibben.statics.pressures import pressures_for_joint_stiffness
from mckibben.units import deg
from mckibben.web.charts import pressure_colour
from mckibben.web.design import muscles
from mckibben.web.identify import IdentificationState
from mckibben.web.layout import (
    NumberSlider,
    actions,
    button,
    fold,
    frame,
    panel,
    quiet,
    select,
    show_error,
    show_remarks,
    side,
    upload,
)
from mckibben.web.results import show_listing
from mckibben.web.session import Latest, in_thread, session
from mckibben.web.workbench import LEG, Workbench, parse, save_scenario

_NEW_ROBOT = (
    "The robot is that of the page Robot. Without a controller in its file, its base is held, and computed torque "
    "moves each joint about the posture of the sliders, with a stiffness that it can have: set them here."
)


@dataclass
class RobotPageState:
    """State of the page.

    Attributes
    ----------
    name, scenario
        Name of the example or file, and the robot; None at first.
    angles
        Angles [deg] of its joints.
    remarks
        What is not carried over from a file of MJCF or URDF.
    """

    name: str = catalog.names("legs")[0]
    scenario: RobotScenario | None = None
    angles: list[float] = field(default_factory=list)
    remarks: tuple[Remark, ...] = ()

    def use(self, name: str, scenario: RobotScenario, remarks: tuple[Remark, ...] = ()) -> None:
        """Replace the robot; its joints begin as near 0 as they can be, or in the posture of the file."""
        posture = {} if scenario.stiffness is None else scenario.stiffness.posture
        self.name, self.scenario, self.remarks = name, scenario, remarks
        self.angles = [round(angle / deg, 1) for angle in scenario.robot.posture_angles(posture)]


class Posed(NamedTuple):
    """A robot in a posture.

    Attributes
    ----------
    lines
        Its outline.
    pressures
        Gauge pressures [Pa] nearest to the middle of their ranges that hold it against gravity; None if none do.
    ellipsoid
        That of the stiffness of its point, or foot, at these pressures; None without one, or if it is not stable.
    tables
        What is attainable at each joint, and the pressures.
    error
        Reason why there are none.
    """

    lines: Outline
    pressures: np.ndarray | None
    ellipsoid: Ellipsoid | None
    tables: tuple[Listing, ...]
    error: McKibbenError | None


def read_robot_file(path: Path, muscle: Muscle) -> tuple[RobotScenario, tuple[Remark, ...]]:
    """Read a robot of ours, or of MJCF or URDF, which MuJoCo reads, with one muscle for all tendons.

    Parameters
    ----------
    path
        File in a folder with those that it may name.
    muscle
        Muscle of all tendons, unless the folder has the file of one.
    """
    if path.suffix not in (".xml", ".urdf"):
        text = path.read_text("utf-8")
        return parse_model(RobotScenario, text, source=path.name, folder=path.parent, confined=True)[0], ()
    from mckibben.scenario.reading import read_mjcf

    for file in path.parent.glob("*.y*ml"):
        muscle = read_component(Muscle, file)
    read = read_mjcf(path, muscle, confined=True)
    return read.scenario(), tuple(read.remarks())


def pose(scenario: RobotScenario, angles: tuple[float, ...]) -> Posed:
    """Compute outline, attainable ranges and pressures of a robot at angles [rad]."""
    robot = scenario.robot
    lines = outline(robot, angles)
    try:
        held = holding_torques(robot, angles)
        ranges = attainable_statics(robot, angles, torques=held, supply=scenario.supply)
        any_stiffness = [None] * len(angles)
        solved = pressures_for_joint_stiffness(robot, angles, any_stiffness, torques=held, supply=scenario.supply)
    except McKibbenError as error:
        return Posed(lines, None, None, (), error)
    holding = replace(list(solved.listings())[-1], title="Pressures that hold this posture", detail=True)
    point = (scenario.stiffness.point if scenario.stiffness else None) or robot.foot
    ellipsoid = None
    if point is not None:
        with contextlib.suppress(RangeError):
            ellipsoid = stiffness_ellipsoid(robot, angles, solved.joint_stiffness, point, 0.15 * extent(lines)[1])
    return Posed(lines, np.array(solved.pressures), ellipsoid, (attainable_listing(ranges), holding), None)


def with_control(scenario: RobotScenario, angles: tuple[float, ...], folder: Path) -> StudiedScenario:
    """A robot whose held base carries joints that move about a posture [rad]; one with a controller as it is.

    Their stiffness is the nearest to the middle of the stable part of their ranges that they have together. Raises
    `McKibbenError` if the muscles cannot hold the posture.
    """
    data, control = plain(read_document(scenario.dumps(folder=folder)).data), plain(read_document(LEG).data)
    if scenario.duration:
        return parse(to_text(data), folder)
    robot, held = scenario.robot, holding_torques(scenario.robot, angles)
    ranges = attainable_statics(robot, angles, torques=held, supply=scenario.supply)
    stable = {name: float(np.mean(np.maximum(ranges[name].stiffness, 0.0))) for name in ranges}
    middle = [stable.get(name) for name in robot.joint_names]
    solved = pressures_for_joint_stiffness(robot, angles, middle, torques=held, supply=scenario.supply)
    for name in ("landing", "jump", "stiffness"):
        data.pop(name, None)
    data["robot"].pop("base", None)
    data |= {key: control[key] for key in ("controller", "start", "duration", "control_period")} | {"reference": {}}
    for joint, angle, stiffness in zip(robot.joint_names, angles, np.diag(solved.joint_stiffness), strict=True):
        sine = {"class": "sine", "amplitude": "3 deg", "frequency": "0.5 Hz", "offset": f"{angle / deg:.4g} deg"}
        data["reference"][joint] = {"angle": sine, "stiffness": f"{stiffness:.3g} N*m/rad"}
    return parse(to_text(data), folder)


def extent(lines: Outline) -> tuple[np.ndarray, float]:
    """Middle and size [m] of an outline."""
    points = np.concatenate([*lines.bodies, *lines.muscles.values()])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    return (low + high) / 2, float(np.max(high - low)) or 1.0


def page() -> None:
    """The page."""
    visitor = session()
    with frame("/robot"):
        _Page(visitor.state(RobotPageState), visitor.folder, visitor.state(IdentificationState).muscle)


class _Page:
    """Joint angles, view and tables of one visit.

    Parameters
    ----------
    state, folder
        State of the page, and the folder of the session's files.
    fitted
        Muscle that was identified in the session.
    """

    def __init__(self, state: RobotPageState, folder: Path, fitted: Muscle | None) -> None:
        self.state, self.folder, self.choices = state, folder, muscles(fitted)
        self.latest = Latest(pose, self.show, self.fail)
        self.size = 1.0
        with side():
            with panel("Robot"):
                select(list(catalog.names("legs")), "an example", "example", on_change=self.example)
                upload("or robot.yaml, MJCF, URDF, with the files that it names", LONGEST_TEXT, self.uploaded, most=16)
                label = "muscle of all tendons of MJCF"
                self.muscle = select(list(self.choices), label, "muscle", value=next(iter(self.choices)))
                self.name = quiet("")
                self.remarks = ui.column()
            with panel("Posture"):
                self.sliders = ui.column().classes("w-full").style("gap: 10px")
            with actions():
                button("Run this robot", self.run, "run-robot", main=True)
                button("Download robot.yaml", self.download, "download")
        with side():
            with panel("", stays=True):
                self.view = ui.scene(height=420, grid=False, background_color="#f4f6f8").classes("w-full")
                self.view.props('role="img" aria-label="bodies and muscles of the robot"').mark("view")
                quiet(
                    "Drag to turn, scroll to zoom. Muscles have the colour of the pressure that holds the posture: "
                    "dark at 0, light at the highest. Those given by moment arms are drawn beside the bodies."
                )
                self.force = quiet("")
            with panel("Attainable at each joint"):
                self.results = ui.column().classes("w-full")
        ui.timer(0.0, self.begin, once=True)

    async def begin(self) -> None:
        """Show the robot of the session, or the first example."""
        if self.state.scenario is None:
            await self.load(self.state.name)
        else:
            await self.shown()

    async def example(self, event: events.ValueChangeEventArguments) -> None:
        """Show a robot of the catalog."""
        if event.value:
            await self.load(event.value)

    async def load(self, name: str) -> None:
        """Load a robot of the catalog."""
        text = f"name: {name}\nrobot: {{from: {name}}}\n"
        scenario, _ = await in_thread(lambda: RobotScenario.parse(text))
        self.state.use(name, scenario)
        await self.shown()

    async def uploaded(self, event: events.MultiUploadEventArguments) -> None:
        """Show the robot of a file."""
        folder = Path(tempfile.mkdtemp(dir=self.folder, prefix="robot-"))
        try:
            path = await save_scenario(event.files, folder)
            read, _ = await in_thread(read_robot_file, path, self.choices[self.muscle.value])
        except McKibbenError as error:
            self.fail(error)
            return
        self.state.use(printable(path.name, 80), *read)
        await self.shown()

    async def shown(self) -> None:
        """Build the sliders of a new robot, look at it, and compute."""
        state = self.state
        assert state.scenario is not None
        robot = state.scenario.robot
        self.name.text = f"{state.name}: {len(robot.joints)} joints, {len(robot.all_muscles)} muscles"
        self.remarks.clear()
        with self.remarks:
            show_remarks(state.remarks)
        self.sliders.clear()
        with self.sliders:
            for index, joint in enumerate(robot.joints):
                if joint.locked is None:
                    self.slider(index, joint.name, (joint.lower / deg, joint.upper / deg))
        middle, self.size = extent(outline(robot, [angle * deg for angle in state.angles]))
        x, y, z = (middle + np.array([0.4, -0.9, 0.2]) * self.size).tolist()
        look_at = dict(zip(("look_at_x", "look_at_y", "look_at_z"), middle.tolist(), strict=True))
        self.view.move_camera(x, y, z, **look_at, duration=0.0)
        await self.again()

    def slider(self, index: int, name: str, limits: tuple[float, float]) -> None:
        """A slider for the angle of a joint."""

        async def changed(value: float) -> None:
            self.state.angles[index] = value
            await self.again()

        NumberSlider(printable(name, 40), "°", limits, 0.5, self.state.angles[index], changed)

    async def again(self) -> None:
        """Compute for the angles of the sliders."""
        assert self.state.scenario is not None
        await self.latest(self.state.scenario, tuple(angle * deg for angle in self.state.angles))

    def show(self, posed: Posed) -> None:
        """Draw the robot, and show its tables."""
        assert self.state.scenario is not None
        robot, shape = self.state.scenario.robot, posed.ellipsoid
        shades = dict.fromkeys(robot.muscle_names, GREY)
        if posed.pressures is not None:
            shares = posed.pressures / robot.highest_pressure
            shades = dict(zip(robot.muscle_names, map(pressure_colour, shares), strict=True))
        with self.view:
            self.view.clear()
            for start, end in posed.lines.bodies:
                self.tube(start, end, 0.015, "#aab4bd")
            for name, points in posed.lines.muscles.items():
                for start, end in itertools.pairwise(points):
                    if not np.isnan([start, end]).any():
                        self.tube(start, end, 0.01, shades[name])
            if shape is not None:
                self.ellipsoid(shape)
        self.force.text = "" if shape is None else f"Ellipsoid: displacement under {shape.force:g} N."
        self.results.clear()
        with self.results:
            if posed.error is not None:
                show_error(posed.error)
            for table in posed.tables:
                with fold(table.title) if table.detail else ui.column().classes("w-full"):
                    show_listing(table)

    def tube(self, start: np.ndarray, end: np.ndarray, part: float, colour: str) -> None:
        """A straight tube of a radius that is a part of the robot's size."""
        ends = start.tolist(), ((start + end) / 2).tolist(), end.tolist()
        self.view.quadratic_bezier_tube(*ends, tubular_segments=1, radius=part * self.size).material(colour)

    def ellipsoid(self, shape: Ellipsoid) -> None:
        """The displacements of the point by its stiffness."""
        lengths = np.maximum(shape.lengths, 0.003 * self.size).tolist()
        solid = self.view.sphere(1.0).scale(*lengths).rotate_R(shape.axes.tolist()).move(*shape.centre.tolist())
        solid.material(BLUE, opacity=0.45)

    def fail(self, error: Exception) -> None:
        """Show why a file is no robot."""
        assert isinstance(error, McKibbenError)
        self.results.clear()
        with self.results:
            show_error(error)

    def run(self) -> None:
        """Run the robot on the page of runs, from this posture."""
        bench, angles = session().state(Workbench), tuple(angle * deg for angle in self.state.angles)
        if self.state.scenario is not None:
            bench.waiting, bench.note = partial(with_control, self.state.scenario, angles), _NEW_ROBOT
            ui.navigate.to("/run")

    def download(self) -> None:
        """Offer the robot as a file, in this posture."""
        if self.state.scenario is not None:
            ui.download.content(self.state.scenario.dumps().encode(), "robot.yaml")
