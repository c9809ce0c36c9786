"""Leg page: landings and jumps of a leg, and their motion in 3-D."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import events, ui
from numpy.typing import NDArray

from mckibben.config.document import LONGEST_TEXT
from mckibben.config.model import parse_model
from mckibben.errors import ParameterError
from mckibben.numerics.calculus import evenly_spaced
from mckibben.units import deg
from mckibben.web import resource
from mckibben.web.layout import (
    BLUE,
    GREEN,
    PALETTE,
    VERMILLION,
    JobPage,
    button,
    chart,
    draw,
    frame,
    line,
    panel,
    progress_row,
    quiet,
    results_side,
    select,
    side,
    table,
    text_area,
    upload,
)
from mckibben.web.scene import BONE, CABLE, HEIGHT, Film, pressure_color
from mckibben.web.session import JobState, session

if TYPE_CHECKING:
    from mckibben.leg import LegPlant, LegResult
    from mckibben.leg.scenario import LegScenario

MOST_LANDINGS = 20_000
_FRAMES = 240
_ARROW = 0.3  # length [m] of the largest force
_BONE = 0.09  # radius of a bone, in units of the scene
STARTS = {
    name: resource(f"starts/leg-{name.replace(' ', '-')}.yaml")
    for name in ("landing in space", "landing in the plane", "jump in the plane")
}
"""Files of legs to begin with."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MuscleFilm:
    """Ends of the straight parts [m], shape (part, time, end, 3), and the part with the muscle; its sizes over time."""

    parts: Floats
    place: int
    length: Floats
    diameter: Floats
    filling: Floats


@dataclass(frozen=True)
class LegFilm:
    """A run of a leg to be drawn: at `times` [s] the points of the skeleton, the muscles, and the force of the ground.

    `points` [m] has shape (time, point, 3); `force` is in weights of the leg, shape (time, 3).
    """

    times: Floats
    points: Floats
    muscles: dict[str, MuscleFilm]
    force: Floats
    angles: dict[str, Floats]
    foot_radius: float
    normal: Floats


@dataclass
class LegPageState(JobState):
    """State of the page; `films` are by title."""

    text: str = STARTS["landing in space"]
    films: dict[str, LegFilm] = field(default_factory=dict)
    shown: str = ""
    headers: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)
    about: str = ""


@dataclass(frozen=True)
class LegStudies:
    """Films by title, and a table of the studies with their description."""

    films: dict[str, LegFilm]
    headers: tuple[str, ...]
    rows: list[tuple[str, ...]]
    text: str


def parse(text: str, folder: Path) -> LegScenario:
    """Parse a leg with a landing or a jump that names only files of the session, within the limits of a page."""
    from mckibben.leg.scenario import LegScenario

    found = parse_model(LegScenario, text, source="leg", folder=folder, confined=True)[0]
    if found.landing is None and found.jump is None:
        raise ParameterError("there is neither a landing nor a jump", remedy="add a section `landing` or `jump`")
    if found.landing is not None:
        levels = found.landing.levels if found.landing.stiffness is None else len(found.landing.stiffness)
        valves = len(found.landing.time_constants) + 2
        count = valves * len(found.landing.drop) * levels * (found.uncertainty.draws + 1)
        if count > MOST_LANDINGS:
            message = f"the study has {count} landings, more than {MOST_LANDINGS}"
            remedy = "use fewer draws or drops, or use `mckibben leg land`"
            raise ParameterError(message, value=count, upper=MOST_LANDINGS, remedy=remedy)
    return found


def compute(scenario: LegScenario, progress: Callable[[str, float], None]) -> LegStudies:
    """Landings or jumps of a leg, as the commands compute them, and the motion of some."""
    from mckibben.leg.jumping import study_jump
    from mckibben.leg.landing import study_landing

    if scenario.landing is not None:
        landings = study_landing(scenario, progress=progress)
        (headers, rows), text = landings.rows(), landings.describe()
        runs = landings.compared_runs()
    else:
        jumps = study_jump(scenario, progress=progress)
        (headers, rows), text = jumps.rows(), jumps.describe()
        runs = {name: (scenario.plant(), jump.run) for name, jump in jumps.jumps.items()}
    progress("drawing", 1.0)
    largest = max(float(run["pressure"].max()) for _, run in runs.values()) or 1.0
    films = {title: film_of(plant, run, largest) for title, (plant, run) in runs.items()}
    return LegStudies(films, headers, rows, text)


def film_of(plant: LegPlant, run: LegResult, largest: float) -> LegFilm:
    """Return the film of a run, with muscles coloured relative to a largest pressure [Pa]."""
    from mckibben.report.leg_shapes import muscle_shapes, place_of, skeleton, straight_paths

    every = run.to_dataset()
    chosen = evenly_spaced(every.sizes["time"], _FRAMES)
    at = every.isel(time=chosen)
    shapes = muscle_shapes(plant, at, largest)
    muscles = {
        name: MuscleFilm(np.array(parts), place_of(plant, name), *shapes[name])
        for name, parts in straight_paths(plant, at).items()
    }
    weight = float(plant.leg.total_mass * plant.gravity)
    force = np.stack([at["ground_forward"], at["ground_left"], at["ground_up"]], -1) / weight
    names = [joint.name for joint in plant.leg.joints]
    angles = {name: at["angle"].to_numpy()[number] / deg for number, name in enumerate(names)}
    normal = np.array([float(one) for one in plant.ground.normal])
    return LegFilm(
        at["time"].to_numpy(), skeleton(plant, at), muscles, force, angles, float(plant.leg.foot_radius), normal
    )


class LegMotion(Film):
    """A leg in space; x points forwards, y to the left, and z up."""

    def __init__(self) -> None:
        super().__init__(height=460, slowed=10.0, digits=3)
        self._film: LegFilm | None = None

    def show(self, film: LegFilm) -> None:
        """Show another run."""
        self._film = film
        self._build(film)
        self.set_end(float(film.times[-1]))

    def _build(self, film: LegFilm) -> None:
        self._scale = scale = HEIGHT / float(film.points[..., 2].max())
        points = film.points[0]
        self.scene.clear()
        with self.scene as scene:
            normal, thin = film.normal, 0.004
            ground = scene.cylinder(1, 1, 1, 48).material("#e4e9ee")
            self.lay(ground, -thin * normal, 0 * normal, 0.35 * HEIGHT)
            self._bones = [self.rod(BONE, first, last, _BONE) for first, last in itertools.pairwise(points)]
            self._trunk = scene.sphere(0.45).material("#215c8f")
            self._hinges = [scene.sphere(0.2).material(CABLE) for _ in points[1:-1]]
            self._foot = scene.sphere(film.foot_radius * scale).material("#1c2024")
            self._cables = {
                name: [self.rod(CABLE, part[0, 0], part[0, 1], 0.05) for part in one.parts]
                for name, one in film.muscles.items()
            }
            self._muscles = {
                name: self.rod(CABLE, one.parts[one.place, 0, 0], one.parts[one.place, 0, 1], 0.2)
                for name, one in film.muscles.items()
            }
            self._force = self.rod("#00684a", points[-1], points[-2], 0.1)
        self.scene.move_camera(0.45 * HEIGHT, -0.7 * HEIGHT, 0.6 * HEIGHT, 0.0, 0.0, 0.47 * HEIGHT, duration=0)

    def move(self, time: float) -> float:
        """Move bones, muscles and force to a time [s]."""
        film = self._film
        assert film is not None
        at = int(np.searchsorted(film.times, time).clip(max=len(film.times) - 1))
        points, scale = film.points[at], self._scale
        for bone, first, last in zip(self._bones, points, points[1:], strict=False):
            self.lay(bone, first, last, _BONE)
        balls = zip((self._trunk, *self._hinges, self._foot), points, strict=True)
        for ball, point in balls:
            ball.move(*(scale * point).tolist())
        for name, one in film.muscles.items():
            for cable, part in zip(self._cables[name], one.parts, strict=True):
                self.lay(cable, part[at, 0], part[at, 1], 0.05)
            first, last = one.parts[one.place][at]
            middle, along = (first + last) / 2, (last - first) / np.linalg.norm(last - first)
            half = one.length[at] / 2
            muscle = self._muscles[name]
            self.lay(muscle, middle - half * along, middle + half * along, scale * float(one.diameter[at]) / 2)
            muscle.material(pressure_color(float(one.filling[at])))
        largest = float(np.linalg.norm(film.force, axis=-1).max()) or 1.0
        pushed = film.force[at] / largest * _ARROW
        self._force.visible(bool(np.linalg.norm(pushed) > 0.01 * _ARROW))
        self.lay(self._force, points[-1], points[-1] + pushed, 0.1)
        return float(film.times[at])


def page() -> None:
    """The page."""
    kept = session()
    with frame("/leg"):
        _Page(kept.state(LegPageState), kept.folder)


class _Page(JobPage[LegPageState]):
    """Text of a leg, and the motion of its runs."""

    def __init__(self, state: LegPageState, folder: Path) -> None:
        super().__init__(state, folder)
        self.film: LegFilm | None = None
        with side():
            self.progress = progress_row(state.jobs)
            with panel("Leg"):
                select(list(STARTS), "begin with", "begin", on_change=self.choose)
                text_area("leg", LONGEST_TEXT, 330).mark("leg").bind_value(state, "text")
                with ui.row().style("gap: 8px"):
                    button("Compute", self.start, "compute", main=True)
                    button("Download", self.download)
                upload("or a leg.yaml", 4 * LONGEST_TEXT, self.uploaded).props("accept=.yaml,.yml")
                quiet(f"At most {MOST_LANDINGS:,} landings; `mckibben leg` reads the same file.")
        with results_side():
            self.remarks = ui.column().classes("w-full")
            with ui.column().classes("w-full").style("gap: 16px") as self.results:
                with panel("Motion"):
                    self.run = select([], "run", "run", on_change=self.choose_run)
                    self.scene = LegMotion()
                    quiet(
                        "Drag to turn, scroll to zoom. Played at a tenth of the speed. Muscles are to scale and "
                        "coloured by pressure; the green rod is the force of the ground."
                    )
                with ui.element("div").classes("pair"):
                    with panel("Force of the ground"):
                        self.force = chart("time [s]", "force [weights of the leg]", height=240)
                    with panel("Joints"):
                        self.angles = chart("time [s]", "angle [°]", height=240)
                with panel("Numbers"):
                    self.numbers = ui.column().classes("w-full")
            with panel() as self.nothing:
                quiet("Choose a leg and press Compute: its landings or jumps appear here in 3-D.")
        self.results.visible = False
        ui.timer(0.15, self.refresh)

    def choose(self, event: events.ValueChangeEventArguments) -> None:
        """Begin with a leg."""
        if event.value:
            self.state.text = STARTS[event.value]

    async def uploaded(self, event: events.UploadEventArguments) -> None:
        """Compute an uploaded leg."""
        content = await event.file.read()
        self.state.text = content[: 4 * LONGEST_TEXT].decode("utf-8", errors="replace")
        self.start()

    def download(self) -> None:
        """Offer the text for download."""
        ui.download.content(self.state.text, "leg.yaml")

    def start(self) -> None:
        """Compute the studies of the text."""
        state, folder, text = self.state, self.folder, self.state.text or ""

        def done(found: LegStudies, heard: list[str]) -> None:
            state.films, state.headers, state.rows, state.about = found.films, found.headers, found.rows, found.text
            state.shown, state.error, state.notes = next(iter(found.films)), None, heard

        self.start_job(lambda progress: compute(parse(text, folder), progress), done)

    def choose_run(self, event: events.ValueChangeEventArguments) -> None:
        """Show another run."""
        if event.value and event.value != self.state.shown:
            self.state.shown = event.value
            self.show(self.state.films[event.value])

    def refresh(self) -> None:
        """Show progress, and new results."""
        state = self.state
        self.progress()
        if not self.news():
            return
        self.show_results(self.remarks, self.show_remarks)
        self.results.visible, self.nothing.visible = bool(state.films), not state.films
        self.results.classes(**{"add" if state.error is not None else "remove": "stale"})
        if state.films:
            self.run.set_options(list(state.films), value=state.shown)
            self.show(state.films[state.shown])
            self.numbers.clear()
            with self.numbers:
                table(state.headers, state.rows)
                for text in ["intervals are 5 to 95 % of the draws", *state.about.splitlines()]:
                    quiet(text)

    def show(self, film: LegFilm) -> None:
        """Draw a run."""
        if film is self.film:
            return
        self.film = film
        parts: Any = zip(("forwards", "to the left", "up"), film.force.T, (VERMILLION, GREEN, BLUE), strict=True)
        draw(self.force, [line(name, film.times, force, color) for name, force, color in parts])
        pairs = zip(film.angles.items(), PALETTE, strict=False)
        draw(self.angles, [line(name, film.times, angle, color) for (name, angle), color in pairs])
        self.scene.show(film)
