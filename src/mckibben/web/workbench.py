"""Scenarios and runs of the page of runs: initial texts, section changes, and the curves of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mckibben.config.document import plain, read_document, to_text
from mckibben.config.model import parse_model
from mckibben.errors import ParameterError
from mckibben.scenario import UNKNOWN, Scenario, run_scenario, starting_stiffness, starting_text
from mckibben.simulation import SimulationResult
from mckibben.web import resource
from mckibben.web.results import Presented, Repetition
from mckibben.web.session import JobState

MOST_STEPS = 2_000_000
"""Most integration steps of a run; the command line allows more, as a run can be stopped there."""
START = resource("starts/knee.yaml")
OFFERED: dict[str, dict[str, str]] = plain(read_document(resource("starts/choices.yaml")).data)
"""What the selects put into a scenario, as YAML by part and label."""
SMALL_MOTION = "small_motion_stiffness"
"""Column of results whose muscles have friction."""


class ScenarioRun(NamedTuple):
    """A run of the page: the text of its scenario in YAML, its columns, and what is shown of it."""

    text: str
    result: SimulationResult
    presented: Presented


@dataclass
class Workbench(JobState):
    """State of the page.

    Attributes
    ----------
    scenario, current
        The last scenario that ran, and its run.
    options
        Option of each select by its label; None if the scenario has a part that the page does not offer.
    text
        Text of the scenario on the page, which may be invalid.
    overlays
        Kept runs.
    studies
        Margins and attainable set of the current scenario, the newest first.
    joint, waiting
        A section `joint` from the page Joint, and a scenario from the page Tune, to be run when this page opens.
    form
        Number of the present fields, which are made again when it changes.
    """

    scenario: Scenario | None = None
    options: dict[str, str | None] = field(default_factory=dict)
    text: str = START
    current: ScenarioRun | None = None
    overlays: list[ScenarioRun] = field(default_factory=list)
    studies: dict[str, Presented] = field(default_factory=dict)
    joint: str = ""
    waiting: str = ""
    form: int = 0

    @property
    def ran(self) -> str | None:
        """Text of the scenario that ran last; None while another one runs. Another text is run when the page opens."""
        return None if self.jobs.busy or self.waiting or self.current is None else self.current.text

    @ran.setter
    def ran(self, text: str) -> None:
        self.waiting = text


def parse(text: str, folder: Path) -> Scenario:
    """Parse a scenario that names only files of the session, and is short enough for a page."""
    scenario = parse_model(Scenario, text, source="scenario", folder=folder, confined=True)[0]
    steps = scenario.duration / scenario.control_period * (scenario.substeps or 1 + 2)  # by accuracy: of one, then two
    if steps > MOST_STEPS:
        message = f"the run has {steps:.3g} integration steps, more than {MOST_STEPS:.3g}"
        raise ParameterError(message, value=steps, remedy="shorten the duration, or use `mckibben simulate`")
    return scenario


def compute(scenario: Scenario, folder: Path) -> ScenarioRun:
    """Run a scenario."""
    result = run_scenario(scenario)
    text = scenario.dumps(folder=folder)
    words = ("simulate", "scenario.yaml", "--out", "run")
    python = 'result = mk.Scenario.read("scenario.yaml").simulate()'
    again = Repetition.of(words, python, scenario_files(text, folder))
    return ScenarioRun(text, result, Presented.of(result, again, charts=True))


def scenario_files(text: str, folder: Path) -> dict[str, bytes]:
    """A scenario as a file, with those of the session that it may name."""
    named = ("muscle.yaml", "fit.yaml") if "muscle.yaml" in text else ()
    return {"scenario.yaml": text.encode()} | {name: (folder / name).read_bytes() for name in named}


def with_section(text: str, section: str, place: tuple[str, ...]) -> str:
    """The text of a scenario with a section replaced."""
    data = plain(read_document(text).data)
    inner: Any = data
    for key in place[:-1]:
        inner = inner[key]
    document = section if "\n" in section else f"only: {section}"
    read = plain(read_document(document).data)
    inner[place[-1]] = read if "\n" in section else read["only"]
    return to_text(data)


def with_joint(text: str | None, joint: str, folder: Path) -> Scenario:
    """The scenario with a new joint, and a stiffness reference that it can hold; without a text, that of a new file.

    Raises `RangeError` if the muscles cannot hold the load.
    """
    values = dict.fromkeys(("file", "muscle", "rest_length"), "") | UNKNOWN
    data = plain(read_document(starting_text(values | {"name": "my joint"}) if text is None else text).data)
    data["joint"] = plain(read_document(joint).data)["joint"]
    scenario = parse(to_text(data), folder)
    plant = scenario.plant()
    stiffness = starting_stiffness(plant.supplied_joint, plant.load)
    before, after, at = stiffness["low"], stiffness["high"], f"{scenario.duration / 2:g} s"
    data["reference"]["stiffness"] = {"class": "step", "before": before, "after": after, "at": at}
    data["start"] = {"angle": "0 deg", "stiffness": before}
    return parse(to_text(data), folder)
