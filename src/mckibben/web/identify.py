"""Muscle page: measured points, force law and friction, residuals, ranking of laws.

Files are those of one test, uploaded or of the catalog. A picker shows what each column is read as, and asks
what is not plain; the points are drawn before any fit. Results are those of `mckibben.identification`; their download
has muscle.yaml, fit.yaml and recipe.yaml.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from nicegui import events, ui

from mckibben import catalog
from mckibben.component.schema import read_component
from mckibben.dataset import IsobaricDataset, Question, Recipe, Table
from mckibben.dataset.formats import ENDINGS
from mckibben.errors import ScenarioError, printable
from mckibben.identification import identify_with_friction, rank
from mckibben.identification.with_friction import FitWithFriction
from mckibben.muscle import LAWS, Muscle
from mckibben.muscle.muscle import forces, half_widths
from mckibben.report.palette import CONTRACTION, FORCE, PRESSURE
from mckibben.result import Remark
from mckibben.scenario import air_volume, write_identified
from mckibben.units import bar, percent
from mckibben.web.charts import Series, chart, cloud, draw, line, pressure_colour
from mckibben.web.layout import (
    MEANINGS,
    JobPage,
    actions,
    button,
    fold,
    frame,
    panel,
    progress_row,
    quiet,
    select,
    show_remarks,
    side,
    upload,
)
from mckibben.web.picker import ColumnPicker
from mckibben.web.reading import Read, ReadingFields, read, refusal
from mckibben.web.results import Presented, Repetition, show_result
from mckibben.web.security import LARGEST
from mckibben.web.session import JobState, session
from mckibben.web.wording import FRICTION, KEEP, on_page

_MOST_FILES = 64
_FIELDS = {"initial_length": ("initial length", "180 mm"), "ambient": ("ambient pressure, if absolute", "101.3 kPa")}
_OVER_TIME = {
    "pressure": ("bar", bar, PRESSURE),
    "force": ("N", 1.0, FORCE),
    "contraction": ("%", percent, CONTRACTION),
}
_FRICTION = {"where the data show it": None, "with": True, "without": False}


@dataclass
class IdentificationState(JobState):
    """State of the page.

    Attributes
    ----------
    name, sources, data
        Title, files and points of the test; no files for a dataset from the catalog.
    old
        Whether the points are of an earlier file than that of `name`, which is not read.
    law, friction, keep_outliers, diameter
        Settings of the fit: name of the class, a key of the friction select, whether outliers are fitted, and inner
        diameter or volume of air with its unit.
    reading, read_by, reading_notes
        Fields by which files are read, those by which `data` were read, and warnings of reading.
    example
        Dataset of the catalog that the page shows when it opens.
    tables, questions
        What was understood of each file, and what is not plain.
    results
        Fit and ranking by name, the newest first.
    curves
        Curves of the fit over the points.
    muscle
        Identified muscle; None without an initial length.
    """

    name: str = ""
    sources: tuple[Path, ...] = ()
    data: IsobaricDataset | None = None
    old: bool = False  # whether the data are of an earlier file than that of `name`, which is not read
    law: str = "ExponentialLaw"
    friction: str = "where the data show it"
    keep_outliers: bool = False
    diameter: str = ""
    reading: ReadingFields = field(default_factory=ReadingFields)
    read_by: ReadingFields | None = None  # the fields by which the data were read; none for the catalog
    reading_notes: list[str] = field(default_factory=list)
    tables: tuple[Table, ...] = ()
    questions: tuple[Question, ...] = ()
    example: str = ""
    results: dict[str, Presented] = field(default_factory=dict)  # fit and ranking, the newest first
    curves: list[Series] = field(default_factory=list)
    muscle: Muscle | None = None

    @property
    def finished(self) -> bool:
        return self.muscle is not None

    def use(
        self,
        name: str,
        read: Read,
        sources: Sequence[Path] = (),
        read_by: ReadingFields | None = None,
        reading_notes: Sequence[str] = (),
    ) -> None:
        """Replace the points and forget the results of earlier ones.

        Parameters
        ----------
        name, read, sources
            Title, what was read, and the files.
        read_by, reading_notes
            Fields by which they were read, and warnings.
        """
        self.name, self.sources, self.read_by, self.old = name, tuple(sources), read_by, False
        self.tables, self.data, self.questions = read
        self.results, self.curves, self.error = {}, [], None
        self.reading_notes, self.notes = list(reading_notes), []

    def steps(self, law: str, *, friction: bool | None = None, robust: bool, inner: str = "") -> Repetition:
        """Command and program that identify the points with a law, or "all" laws."""
        files = {path.name.removeprefix("data-"): path.read_bytes() for path in self.sources}
        names, read, recipe = list(files) or [self.name], [], ""
        if self.read_by is not None:
            files["recipe.yaml"], read = self.read_by.recipe().dumps().encode(), ["--read", "recipe.yaml"]
            recipe = ", recipe=mk.Recipe.read('recipe.yaml')"
        options = [] if friction is None else ["--friction", "on" if friction else "off"]
        options += [*["--inner", inner] * bool(inner.strip()), *["--keep-outliers"] * (not robust)]
        call = f"mk.identify({names if files else names[0]!r}, {law!r}, friction={friction}, robust={robust}{recipe})"
        if law == "all":
            data = f"mk.read_dataset({names}{recipe})" if files else f"mk.catalog.dataset({names[0]!r})"
            call = f"mk.rank({data}, robust={robust})"
        words = ["identify", *names, *read, "--law", law, *options, "--out", "identified"]
        return Repetition.of(words, f"result = {call}", files)

    def show_first(self, name: str, result: Presented, heard: list[str]) -> None:
        """Replace a result, which is then the newest."""
        self.results = {name: result} | {other: old for other, old in self.results.items() if other != name}
        self.notes, self.error = heard, None


def _span(data: IsobaricDataset) -> tuple[float, float]:
    """Lowest and highest pressure [bar]."""
    return float(np.min(data.pressure)) / bar, float(np.max(data.pressure)) / bar


def fit_curves(fit: FitWithFriction, data: IsobaricDataset, most: int = 8) -> list[Series]:
    """Curves of a law, and of loading and unloading with its friction, at up to `most` of the pressures of points."""
    domain, levels, (low, high) = fit.law.domain, data.pressures, _span(data)
    contraction = np.linspace(float(domain.contraction_min), float(domain.contraction_max), 120)
    curves = []
    for level in levels[np.unique(np.linspace(0, len(levels) - 1, most).astype(int))]:
        colour = pressure_colour((level / bar - low) / (high - low or 1.0))
        force = forces(fit.law, contraction, level)
        half = half_widths(fit.friction, force, level) if fit.friction else 0.0
        for sign in (0, 1, -1) if fit.friction else (0,):
            values = force + sign * half
            shown = np.where((force > 0) & (values > 0), values, np.nan)
            name = f"{level / bar:.3g} bar" + ("", ", loading", ", unloading")[sign]
            curves.append(line(name, contraction / percent, shown, colour, dash=sign != 0, width=2 - abs(sign)))
    return curves


def page() -> None:
    """The page."""
    visitor = session()
    state = visitor.state(IdentificationState)
    with frame("/identify", state, "law", "friction", "keep_outliers", "diameter", "reading", state=state):
        _Page(state, visitor.folder)


class _Page(JobPage[IdentificationState]):
    """Inputs and results of one visit."""

    def __init__(self, state: IdentificationState, folder: Path) -> None:
        super().__init__(state, folder)
        self.tried = state.read_by  # the fields by which files were read last, or refused
        with side():
            with panel("Measured points"):
                upload("Drop or choose files", LARGEST, self.uploaded, most=_MOST_FILES).on_rejected(
                    lambda: ui.notify(f"more than {_MOST_FILES} files or {LARGEST // 2**20} MiB", type="negative")
                ).tooltip("several files are those of one test; a recipe.yaml sets how they are read")
                examples = {"": "none", **{name: name for name in catalog.names("datasets")}}
                self.examples = select(examples, "or an example", "dataset", value="", on_change=self.example)
                for name, (label, example) in _FIELDS.items():
                    element = ui.input(label, placeholder=example, validation=partial(refusal, name))
                    element.on_value_change(partial(self.reread, name)).props("dense hide-bottom-space stack-label")
                    element.props("debounce=700").classes("w-full").mark(name).bind_value(state.reading, name)
                    element.tooltip(MEANINGS[name])
                with ui.expansion("further settings of a recipe").props("dense").classes("w-full") as self.options:
                    label = "such as displacement: lengthening"
                    further = ui.textarea(label).props("dense autogrow").classes("w-full mono").mark("further")
                    further.bind_value(state.reading, "further").tooltip(MEANINGS["further"])
                    button("Read again", self.read)
            with panel("Force law"):
                select(sorted(LAWS), "law", "law").bind_value(state, "law")
                ui.input("inner diameter or fill", placeholder="such as 14 mm or 30 mL").props(
                    "dense stack-label"
                ).classes("w-full").bind_value(state, "diameter").tooltip(MEANINGS["diameter"])
                select(list(_FRICTION), FRICTION, "with-friction").bind_value(state, "friction")
                ui.checkbox(KEEP).props("dense").mark("keep").bind_value(state, "keep_outliers").tooltip(
                    "fit all points, those off the surface through the others, too"
                )
                with actions():
                    button("Fit", self.fit, "fit", main=True)
                    button("Rank all laws", self.rank, "rank")
            self.progress = progress_row(state.jobs)
        with side():
            self.results = ui.column().classes("w-full").style("gap: 16px")
        ui.timer(0.0, self.begin, once=True)
        ui.timer(0.15, self.refresh)

    def begin(self) -> None:
        """Show the dataset that another page asks for; read files again by fields to which the user went back."""
        state = self.state
        if state.example:
            self.examples.value, state.example = state.example, ""
        elif state.read_by not in (None, state.reading) and not state.jobs.busy:
            self.read()

    def refresh(self) -> None:
        """Show progress, and new results as they appear."""
        self.progress()
        if self.news():
            self.show_results(self.results, self.show)

    async def uploaded(self, event: events.MultiUploadEventArguments) -> None:
        """Store the uploaded files of a test; a recipe fills the fields by which they, or earlier ones, are read."""
        files = [file for file in event.files if not file.name.lower().endswith((".yaml", ".yml"))]
        for file in event.files:
            if file not in files:
                text = (await file.read()).decode("utf-8", errors="replace")
                try:
                    self.state.reading.take(Recipe.parse(text, source=printable(file.name, 80)))
                except ScenarioError as error:
                    ui.notify(printable(on_page(str(error)), 1000), type="negative", multi_line=True)
                    return
        if self.state.sources and len(files) == len(event.files):  # names and answers are those of the file before
            self.state.reading.columns, self.state.reading.accept = {}, ()
        if not files:
            self.options.value = True
            self.read()
            return
        paths = [self.new_file(file.name) for file in files]
        for file, path in zip(files, paths, strict=True):
            await file.save(path)
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        self.take(printable(files[0].name, 80) + more, *paths)

    def new_file(self, name: str) -> Path:
        """Path of a new file in a folder of its own, as two tabs may send data at once, with our ending and prefix."""
        sent = Path(name)
        ending = suffix if (suffix := sent.suffix.lower())[1:] in ENDINGS else ".csv"
        stem = re.sub(r'[\x00-\x1f/\\:*?"<>|]', "_", sent.stem)[-60:]  # the characters that no system forbids
        return Path(tempfile.mkdtemp(dir=self.folder, prefix="data-")) / f"data-{stem}{ending}"

    def example(self, event: events.ValueChangeEventArguments) -> None:
        """Use a dataset from the catalog."""
        if event.value:
            self.take(event.value)

    def take(self, name: str, *sources: Path) -> None:
        """Replace the points by those of files of a test or, without files, of a dataset from the catalog."""
        state = self.state
        for old in state.sources:
            if old not in sources and old.parent.parent == self.folder:  # not those of the page Rig and of projects
                shutil.rmtree(old.parent, ignore_errors=True)
        state.name, state.sources = name, sources
        fields = replace(state.reading, columns=dict(state.reading.columns))

        self.tried = fields if sources else None

        def load() -> Read:
            return read(sources, fields) if sources else Read((), catalog.dataset(name), ())

        state.error, state.old = None, True

        def done(found: Read, heard: list[str]) -> None:
            state.use(name, found, sources, fields if sources else None, [*map(self.named, heard)])

        self.start_job(lambda _: load(), done, scroll=False)

    def named(self, text: str) -> str:
        """A text with the names of our files without their folder."""
        for path in self.state.sources:
            text = text.replace(str(path), path.name.removeprefix("data-"))
        return text

    def read(self) -> None:
        """Read the same file again, with other fields."""
        if self.state.name:
            self.take(self.state.name, *self.state.sources)

    def reread(self, name: str, event: events.ValueChangeEventArguments) -> None:
        """Read the same file again if a field has another value, which is valid."""
        if self.tried is not None and refusal(name, event.value) is None and event.value != getattr(self.tried, name):
            self.read()

    def points(self) -> IsobaricDataset | None:
        """The points to be fitted; None, with a message, if there are none or questions are open."""
        state = self.state
        if state.data is None or state.old or state.questions:
            ui.notify("answer the questions about the file first" if state.questions else "give measured points first")
            return None
        return state.data

    def fit(self) -> None:
        """Fit the chosen law, with friction as chosen, in a job."""
        state, folder = self.state, self.folder
        if (data := self.points()) is None:
            return
        law, inner, keep = LAWS[state.law], state.diameter, state.keep_outliers
        friction = _FRICTION[state.friction]

        def compute(_: Callable[[str, float], None]) -> tuple[Presented, list[Series], Muscle | None, Path]:
            volume = air_volume(inner, data.table.attrs.get("initial_length"))
            fit = identify_with_friction(law, data, friction=friction, robust=not keep)
            written = Path(tempfile.mkdtemp(dir=folder))
            fit.to_yaml(written / "fit.yaml")
            path = written / "muscle.yaml"
            is_written = write_identified(path, fit, data.table.attrs, volume=volume)
            muscle = read_component(Muscle, path) if is_written else None
            steps = state.steps(law.__name__, friction=friction, robust=not keep, inner=inner)
            steps.files.update({path.name: path.read_bytes() for path in written.iterdir()})
            return Presented.of(fit, steps, charts=True), fit_curves(fit, data), muscle, written

        def done(result: tuple[Presented, list[Series], Muscle | None, Path], heard: list[str]) -> None:
            fit, state.curves, state.muscle, written = result
            state.show_first("fit", fit, heard)
            for name in ("fit.yaml", "muscle.yaml"):  # only now: a cancelled fit leaves the files of the last one
                (folder / name).unlink(missing_ok=True)
                if (written / name).exists():
                    (written / name).replace(folder / name)
            written.rmdir()

        self.start_job(compute, done, kind="fit")

    def rank(self) -> None:
        """Fit all laws, and rank them."""
        state = self.state
        if (data := self.points()) is None:
            return

        robust = not state.keep_outliers

        def compute(progress: Callable[[str, float], None]) -> Presented:
            steps = state.steps("all", robust=robust)
            return Presented.of(rank(data, robust=robust, progress=progress), steps)

        self.start_job(compute, partial(state.show_first, "ranking"), kind="rank")

    def show(self) -> None:
        """Show everything known."""
        state = self.state
        if state.error is not None:
            self.options.value |= state.data is None or state.old
            self.show_failure(state.error, state.name)
        elif not state.name and not state.jobs.busy:
            with panel("No points yet"):
                quiet(
                    "A table with pressure, force, and contraction or length, one row per point, units in the headers."
                )
        elif notes := dict.fromkeys([*state.reading_notes, *state.notes]):
            with panel():
                show_remarks(Remark.warning("", text) for text in notes)
        with ui.column().classes("w-full" + (" stale" if state.old else "")).style("gap: 16px"):
            for name, result in state.results.items():
                show_result(result, name, self.show_fit if name == "fit" else lambda: None)
            if state.questions:
                self.show_columns()
            if state.data is not None and "fit" not in state.results:
                with panel(f"{len(state.data)} points, {len(state.data) - len(state.data.taut)} slack"):
                    self.show_points(state.data)
            folded = bool(state.results and state.tables)
            with panel() if folded else nullcontext(), fold("The file") if folded else nullcontext():
                self.show_recordings()
                if not state.questions:
                    self.show_columns()

    def show_columns(self) -> None:
        """Quantity and unit of each column, and the questions."""
        state = self.state
        if not state.tables:
            return
        count = len(state.questions)
        with panel(f"{count} question{'s' * (count > 1)} about {state.name}" if count else f"Columns of {state.name}"):
            ColumnPicker(state.tables[0], state.reading, state.questions, self.read)

    def show_points(self, data: IsobaricDataset) -> None:
        """The points as measured, with the curves of a fit, and remarks from reading."""
        pressure, directions = data.pressure / bar, data.table.get("direction")
        loading = np.zeros(len(data), bool) if directions is None else directions.values == "loading"
        points = chart("contraction [%]", "force [N]", height=360, scale="pressure [bar]", span=_span(data))
        clouds = [
            cloud(name, data.contraction[rows] / percent, data.force[rows], pressure[rows], symbol)
            for name, rows, symbol in (("loading", loading, "circle"), ("measured", ~loading, "emptyCircle"))
        ]
        draw(points, [*clouds, *self.state.curves])
        quiet(
            ("Filled points: loading, the muscle is stretched. " if loading.any() else "")
            + ("Lines: the law; dashed: with its friction." if self.state.curves else "")
        )
        for text in self.named(data.table.attrs.get("preprocessing", "")).splitlines():
            quiet(printable(text, 500))

    def show_fit(self) -> None:
        """The points with the curves of the fit, and what can be done with the muscle."""
        assert self.state.data is not None
        self.show_points(self.state.data)
        if self.state.muscle is not None:
            button("Design a joint with it", self.design, main=True)
        else:
            quiet("give the initial length to use the muscle in scenarios")

    def show_recordings(self) -> None:
        """The columns over time, those that are understood while questions are open."""
        tables = [table.columns for table in self.state.tables if "time" in table.columns]
        with panel("Over time") if tables else nullcontext():
            for name, (unit, size, color) in _OVER_TIME.items():
                shown = [(columns["time"].values, columns[name].values / size) for columns in tables if name in columns]
                if shown:
                    curves = [line(name, time, values, color, width=1) for time, values in shown]
                    draw(chart("time [s]", f"{name} [{unit}]", height=190), curves, legend=())

    def design(self) -> None:
        """Use the muscle on the joint page."""
        from mckibben.web.design import YOURS, JointDesign

        session().state(JointDesign).muscle = YOURS
        ui.navigate.to("/joint")
