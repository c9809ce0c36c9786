"""Frame of the pages and their shared parts: panels, errors, tables, fields, sliders.

Text goes through labels and tables, which show it verbatim: file content never becomes HTML.
"""

from __future__ import annotations

import asyncio
import copy
import math
import re
from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

from nicegui import events, ui

from mckibben.config.document import plain, read_document
from mckibben.errors import DatasetError, FileError, McKibbenError, printable
from mckibben.report.palette import BLUE, GREEN, GREY, VERMILLION
from mckibben.result import Remark, Severity
from mckibben.web import resource
from mckibben.web.session import Jobs, JobState, session
from mckibben.web.wording import on_page, quotes

State = TypeVar("State", bound=JobState)
Value = TypeVar("Value")

_RED = "#B3261E"
LATER = 0.05
"""Delay [s] of updates other than the curves after a slider moves: the browser draws the curves first."""

PAGES = {
    "/": ("Start", "From a muscle's test data to a controlled joint."),
    "/identify": ("Muscle", "From measured points to a force law with friction and error bars."),
    "/joint": ("Joint", "The stiffness and torque that two muscles attain on your joint."),
    "/run": ("Run", "A joint or a robot with controller, valves and sensors, simulated."),
    "/tune": ("Tune", "Gains for your tolerances, with a margin to the limit of stability."),
    "/rig": ("Rig", "A test of a muscle on the simulated rig."),
    "/robot": ("Robot", "Arms, necks and legs: posture, and the torque and stiffness that their muscles attain."),
}
"""Title and purpose of each page, in the order of work."""
MEANINGS: dict[str, str] = plain(read_document(resource("starts/meanings.yaml")).data)
"""Descriptions of fields, by name or label."""


@contextmanager
def frame(here: str, form: object = None, *names: str, state: JobState | None = None) -> Iterator[None]:
    """Header with links to the pages, title, the columns of a page, and a link to the next page.

    Parameters
    ----------
    here
        Path of the page, a key of `PAGES`.
    form, names
        Object that holds the inputs of the page, and its attributes to which "undo" goes back.
    state
        State of the page; the next page is offered as soon as it has what that needs.
    """
    ui.colors(primary=BLUE, secondary=GREY, accent=VERMILLION, negative=_RED, positive=GREEN)
    ui.add_css(resource("style.css"))
    ui.add_body_html(f"<script>{resource('starts/page.js')}</script>")
    (title, purpose), look = PAGES[here], session().state(dict)
    ui.page_title(f"{title} - mckibben")
    dark = ui.dark_mode(look.get("dark", False), on_change=lambda event: look.update(dark=event.value))
    with ui.header().classes("items-center q-px-md q-py-sm").style("gap: 20px"):
        ui.label("mckibben").style("font-weight: 700; font-size: 16px")
        with ui.element("nav").classes("row").style("gap: 4px 18px").props('aria-label="pages"'):
            for path, (name, _) in PAGES.items():
                current = "page" if path == here else "false"
                ui.link(name, path).classes("tab").props(f'aria-current="{current}"')
        ui.space()
        if names:
            _undo(here, form, names)
        button("", dark.toggle, icon="contrast").props('round dense aria-label="dark theme"')
    with ui.column().classes("w-full").style("gap: 0"):
        heading(title, "h1")
        quiet(purpose)
    with ui.element("div").classes("columns"):
        yield
    if state is not None:
        following = [*PAGES][[*PAGES].index(here) + 1]
        following_link = ui.link(f"Next: {PAGES[following][0]}", following).classes("next").mark("next")
        following_link.bind_visibility_from(state, "finished")


def _undo(here: str, form: object, names: Sequence[str]) -> None:
    """A button that goes back to the inputs before the last change, by opening the page with them."""
    past: list[dict[str, object]] = session().state(dict).setdefault(here, [])
    latest: list[dict[str, object]] = [{}]

    def now() -> dict[str, object]:
        return copy.deepcopy({name: getattr(form, name) for name in names})

    def watch() -> None:
        """Keep inputs that have not changed since the last call; those of a job that runs are None."""
        before, latest[0] = latest[0], now()
        if before == latest[0] != (past[-1] if past else {}) and None not in before.values():
            past.append(before)
            del past[:-50]

    def undo() -> None:
        if past and past[-1] == now():
            past.pop()
        if past and None not in now().values():
            for name, value in copy.deepcopy(past[-1]).items():
                setattr(form, name, value)
            ui.navigate.to(here)

    ui.timer(0.3, watch)
    button("", undo, "undo", icon="undo").props('round dense aria-label="undo the last change"')


def heading(text: str, tag: str = "h2") -> ui.label:
    """A heading, "h1" of a page or "h2" of a panel."""
    label = ui.label(text).classes("heading" if tag == "h2" else "title")
    label.tag = tag
    return label


@contextmanager
def panel(title: str = "", *, stays: bool = False) -> Iterator[ui.column]:
    """A white box with a heading.

    Parameters
    ----------
    title
        Heading; empty for none.
    stays
        Whether it remains visible on a narrow screen.
    """
    with ui.column().classes("panel w-full" + (" stays" if stays else "")).style("gap: 10px") as box:
        if title:
            heading(title)
        yield box


@contextmanager
def side() -> Iterator[None]:
    """A column of panels."""
    with ui.column().classes("w-full").style("gap: 16px"):
        yield


def button(
    label: str, action: Callable[..., object], mark: str = "", *, main: bool = False, **options: Any
) -> ui.button:
    """A button, flat unless it is a main one of its panel.

    Parameters
    ----------
    label, action
        Text, and function that is called by a click.
    mark
        Name by which tests find it.
    main
        Whether it is filled.
    options
        Options of `ui.button`, such as its colour.
    """
    element = ui.button(label, on_click=action, **options).props(f"{'unelevated' if main else 'flat'} no-caps")
    return element.mark(mark) if mark else element


def select(options: list[str] | dict[Any, str], label: str, mark: str, **others: Any) -> ui.select:
    """A select as wide as its panel, with its meaning.

    Parameters
    ----------
    options, label
        Values, or texts by value; and the text above.
    mark
        Name by which tests find it, and `MEANINGS` has its meaning.
    others
        Options of `ui.select`.
    """
    meaning = MEANINGS.get(mark) or MEANINGS[re.split("-| of ", mark)[0]]
    return ui.select(options, label=label, **others).props("dense").classes("w-full").mark(mark).tooltip(meaning)


def fold(title: str, *, opened: bool = False) -> ui.expansion:
    """A part of a panel that opens and closes."""
    return ui.expansion(title, value=opened).classes("w-full").props("dense header-class=heading")


def quiet(text: str) -> ui.label:
    """A remark in small grey letters, in terms of the page."""
    return ui.label(on_page(text)).classes("quiet")


def actions() -> ui.row:
    """The main buttons of a page, which stay in sight on a narrow screen."""
    return ui.row().classes("actions items-center").style("gap: 8px")


def progress_row(jobs: Jobs) -> Callable[[], None]:
    """Panel with progress bar, step and button to cancel, visible while a job runs.

    Returns
    -------
    callable
        Function that refreshes it, to be called by a timer.
    """

    def cancel() -> None:
        jobs.cancel()
        ui.notify("cancelled")

    with panel() as shown:
        shown.classes("progress")
        with ui.row().classes("w-full items-center no-wrap"):
            bar = ui.linear_progress(0, show_value=False).props('instant-feedback aria-label="progress"')
            bar.classes("w-full")
            button("Cancel", cancel, "cancel").props("dense")
        step = ui.label().classes("quiet")

    def refresh() -> None:
        shown.visible = jobs.busy
        if jobs.busy:
            elapsed, expected = jobs.elapsed, jobs.expected
            bar.props(**{"remove" if expected else "add": "indeterminate"})
            bar.value = min(elapsed / expected, 0.95) if expected else 0.0
            about = f" of about {expected:.0f} s" if expected else " s"
            step.text = f"{jobs.step or 'starting'}, {elapsed:.0f}{about}"

    return refresh


def show_error(error: McKibbenError) -> None:
    """Show an error with its remedy; of a file, a table of at most 100 problems with line, field and remedy."""
    if not isinstance(error, FileError):
        _message(error.message, error.remedy)
        return
    count = len(error.problems)
    _message(f"{count} problem{'s' if count != 1 else ''}", "")
    rows = [
        (
            "" if problem.line is None else problem.line,
            printable(problem.field, 80),
            printable(quotes(problem.message), 400),
            printable(on_page(problem.remedy), 400),
        )
        for problem in error.problems[:100]
    ]
    place = "column" if isinstance(error, DatasetError) else "field"
    table(("line", place, "problem", "remedy"), rows, texts=range(4))
    if count > len(rows):
        ui.label(f"and {count - len(rows)} more").classes("quiet")


def _message(message: str, remedy: str) -> None:
    with ui.column().style(f"gap: 2px; border-left: 3px solid {_RED}; padding-left: 10px").mark("error"):
        for line in printable(quotes(message), 4000).splitlines():
            ui.label(line)
        if remedy:
            quiet(printable(remedy, 1000))


class JobPage(Generic[State]):
    """One visit of a page, which shows the results of its jobs as they appear.

    A subclass builds its panels in `__init__`, starts jobs by `start_job`, and calls `refresh` by a timer; what a job
    returns is kept in the state of the session, so that a reloaded page shows it again.

    Parameters
    ----------
    state
        State of the page in the session.
    folder
        Folder of the session's files.
    """

    def __init__(self, state: State, folder: Path) -> None:
        self.state, self.folder, self.shown = state, folder, -1
        self.seen: McKibbenError | None = None
        self.ended = False

    def start_job(
        self,
        compute: Callable[[Callable[[str, float], None]], Value],
        done: Callable[[Value, list[str]], None],
        *,
        scroll: bool = True,
        kind: str = "",
    ) -> None:
        """Run a job in a thread, as `Jobs.start`; an error is stored in the state.

        Parameters
        ----------
        compute
            Computation, which gets a function that reports step and progress, and raises where the job was cancelled.
        done
            Called on the event loop with the result and the texts of warnings.
        scroll
            Whether the page scrolls to the results, or stays where it is.
        kind
            Kind of the job, by which its duration is expected.
        """

        def end(result: Value, heard: list[str]) -> None:
            done(result, heard)
            self.ended = scroll

        self.state.jobs.start(compute, end, self.fail, kind)

    def fail(self, error: McKibbenError) -> None:
        """Store an error for display."""
        self.state.error = error

    def news(self) -> bool:
        """Whether there is something new to show."""
        new, self.shown = self.shown != self.state.jobs.version, self.state.jobs.version
        return new

    def show_results(self, on: ui.column, show: Callable[[], None]) -> None:
        """Replace the results in a column, and scroll to those of a job that has just ended.

        `show` shows them.
        """
        on.clear()
        with on:
            show()
        if self.ended:
            self.ended = False
            ui.run_javascript(f"document.getElementById('{on.html_id}').parentElement.scrollIntoView()")

    def show_failure(self, error: McKibbenError, title: str = "") -> None:
        """Show the error of the last job, scrolling to a new one."""
        with panel(title) as shown:
            show_error(error)
        if error is not self.seen:  # on a phone, the button of the job is far below
            ui.run_javascript(f"document.getElementById('{shown.html_id}').scrollIntoView({{block: 'center'}})")
            self.seen = error

    def show_notes(self) -> None:
        """Show the error of the last job, or its remarks."""
        if self.state.error is not None:
            self.show_failure(self.state.error)
        elif self.state.notes:
            with panel():
                show_remarks(Remark.warning("", text) for text in self.state.notes)


_SEVERITIES = {
    Severity.SEVERE: ("error", "severe"),
    Severity.WARNING: ("warning", "warning"),
    Severity.NOTE: ("info", "quiet"),
}
"""Icon of a remark, and class of its colour, in addition to its word."""


def show_remarks(remarks: Iterable[Remark]) -> None:
    """Show remarks, the most severe first, each with the colour and the word of its severity."""
    order = list(_SEVERITIES)
    for remark in sorted(remarks, key=lambda remark: order.index(remark.severity)):
        icon, look = _SEVERITIES[remark.severity]
        with ui.row().classes(f"no-wrap items-start remark {look}").style("gap: 8px"):
            ui.icon(icon).style("font-size: 18px")
            ui.label(on_page(printable(str(remark), 1000)))


_BREAKS_AT_DOTS = r"""
<q-td :props="props" :style="/^[-+0-9.]+ \S+$/.test(props.value) ? 'white-space: nowrap !important' : ''">
  <template v-for="part in String(props.value).split(/(?<=[._])(?=[A-Za-z])/)">{{part}}<wbr></template>
</q-td>
"""
"""A cell whose dotted names may continue on the next line, a unit not; copied text has no additional characters."""


def table(header: Sequence[str], rows: Iterable[Sequence[object]], *, texts: Collection[int] = (0,)) -> ui.table:
    """A table of texts and numbers.

    Parameters
    ----------
    header
        Heading of each column, with its unit.
    rows
        Cells of each row.
    texts
        Numbers of the columns that are texts; others are aligned to the right.
    """
    columns: list[dict[str, str]] = [
        {"name": str(i), "label": name, "field": str(i), "align": "left" if i in texts else "right"}
        for i, name in enumerate(header)
    ]
    cells = [{"key": k, **{str(i): cell for i, cell in enumerate(row)}} for k, row in enumerate(rows)]
    with ui.element("div").classes("w-full scrolled").props('tabindex=0 role="group" aria-label="table"'):
        element = ui.table(columns=columns, rows=cells, row_key="key").props("flat dense hide-pagination wrap-cells")
    element.add_slot("body-cell", _BREAKS_AT_DOTS)
    return element.classes("w-full number").props("rows-per-page-options=[0]")


def text_area(label: str, longest: int, height: int, **options: Any) -> ui.textarea:
    """A multi-line field.

    Parameters
    ----------
    label
        Name for screen readers, and for tests.
    longest, height
        Most characters, and height in pixels.
    options
        Options of `ui.textarea`.
    """
    look = f"outlined aria-label='{label}' maxlength={longest} spellcheck=false input-style='height: {height}px'"
    return ui.textarea(**options).props(look).classes("w-full mono").mark(label).tooltip(MEANINGS[label])


_UPLOAD_HEADER = """
<q-btn flat no-caps icon="upload_file" label="LABEL" class="full-width" @click="props.pickFiles" />
<label class="trigger">LABEL<q-uploader-add-trigger /></label>
"""
"""The field as a button that the keyboard reaches."""


def upload(
    label: str, largest: int, taken: Callable[[events.MultiUploadEventArguments], Awaitable[None]], *, most: int = 1
) -> ui.upload:
    """An upload of files; it lists no earlier ones.

    Parameters
    ----------
    label
        Text in the field.
    largest
        Largest total size [bytes].
    taken
        Called with the event, which has the files.
    most
        Most files at once.
    """

    async def uploaded(event: events.MultiUploadEventArguments) -> None:
        if event.files:  # a request may have none
            await taken(event)
        field.reset()

    field = ui.upload(auto_upload=True, max_total_size=largest, on_multi_upload=uploaded, multiple=True, max_files=most)
    field.add_slot("header", _UPLOAD_HEADER.replace("LABEL", label))
    return field.props("flat bordered").classes("w-full")


class NumberField(ui.number):
    """A number field; invalid or disallowed input is refused with a message at the field.

    Parameters
    ----------
    label, value
        Text in the field, and first number.
    holds, allowed
        Whether a finite number is allowed, and these numbers in words, after "give".
    changed
        Called with each new allowed number.
    step, words
        Step of the arrow keys, and meaning, which the tooltip tells with what is allowed.
    """

    def __init__(
        self,
        label: str | None,
        value: float,
        holds: Callable[[float], bool],
        allowed: str,
        changed: Callable[[float], object],
        *,
        step: float | None = None,
        words: str = "",
    ) -> None:
        def refused(number: float | None) -> str | None:
            return None if number is not None and math.isfinite(number) and holds(number) else f"give {allowed}"

        def taken() -> object:
            return changed(self.value) if self.value is not None and self.validate() else None

        super().__init__(label, value=value, step=step, on_change=taken, validation=refused)
        self.props("hide-bottom-space").tooltip(f"{words} Allowed: {allowed}.".strip())

    def _event_args_to_value(self, e: events.GenericEventArguments) -> float | None:
        try:
            number = float(e.args)
        except (TypeError, ValueError):
            return None
        return number if math.isfinite(number) else None

    def _value_to_model_value(self, value: object) -> str:
        return "" if value is None else f"{value:.12g}"


class PageSlider(ui.slider):
    """A slider whose value the server does not send back."""

    LOOPBACK = False


class NumberSlider:
    """A number with a slider and a field, between limits.

    Parameters
    ----------
    label, unit
        Name, and shown unit of all numbers.
    limits, step, value
        Lowest and highest number, step, and first number.
    changed
        Gets each new number, once: the field follows the slider later, so that curves are drawn first.
    """

    def __init__(
        self,
        label: str,
        unit: str,
        limits: tuple[float, float],
        step: float,
        value: float,
        changed: Callable[[float], Awaitable[None]],
    ) -> None:
        low, high = limits
        self._changed = changed
        with ui.column().classes("w-full").style("gap: 0"):
            with ui.row().classes("w-full items-center justify-between no-wrap"):
                ui.label(label).classes("quiet")
                held, allowed = (lambda number: low <= number <= high), f"{low:g} to {high:g} {unit}"
                words = MEANINGS.get(label, f"{label}.")
                self.field = NumberField(None, value, held, allowed, self._field, step=step, words=words)
                self.field.props(f'dense borderless suffix="{unit}" aria-label="{label}" debounce=300')
                self.field.classes("number").style("width: 120px; margin: -10px 0")
                self.field.mark(f"{label.replace(' ', '-')}-field")
            self.slider = PageSlider(min=low, max=high, step=step, value=value, on_change=self._slide)
            self.slider.props(f'aria-label="{label}"').style("height: 26px").mark(label.replace(" ", "-"))
            self.slider.tooltip(words)

    async def _slide(self) -> None:
        value = self.slider.value
        if value is not None and value != self.field.value:
            await self._changed(value)
            await asyncio.sleep(LATER)
            self.field.value = self.slider.value

    async def _field(self, value: float) -> None:
        if value != self.slider.value:
            self.slider.value = value
            await self._changed(value)
