"""Scenarios and runs of the page of runs: initial texts, section changes, and the curves of a run."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from nicegui.elements.upload_files import FileUpload
from numpy.typing import NDArray

from mckibben.config.document import plain, read_document, to_text
from mckibben.config.model import parse_model
from mckibben.errors import ParameterError
from mckibben.scenario import UNKNOWN, Scenario, StudiedScenario, laboratory, starting_stiffness, starting_text
from mckibben.simulation import SimulationResult
from mckibben.web import resource
from mckibben.web.results import Presented, Repetition
from mckibben.web.session import JobState

MOST_STEPS = 2_000_000
"""Most integration steps of a run; the command line allows more, as a run can be stopped there."""
START, LEG = resource("starts/knee.yaml"), resource("starts/leg.yaml")
"""Scenarios of the paper: its knee, and its leg."""
OFFERED: dict[str, dict[str, str]] = plain(read_document(resource("starts/choices.yaml")).data)
"""What the selects put into a scenario, as YAML by part and label."""
READ = 'mk.Scenario.read("scenario.yaml")'
"""Python that reads the scenario of a download."""
SMALL_MOTION = "small_motion_stiffness"
"""Column of results whose muscles have friction."""


class ScenarioRun(NamedTuple):
    """A run of the page: the text of its scenario in YAML, the names of its joints and muscles, and its columns.

    Without names, columns are those of a joint and two muscles.
    """

    text: str
    joints: tuple[str, ...]
    muscles: tuple[str, ...]
    result: SimulationResult
    presented: Presented

    def of_joint(self, values: Mapping[str, Any], name: str, joint: str) -> NDArray[np.float64]:
        """Column or metric of a joint by its name, "" of an unnamed one; empty where the run has none."""
        if name not in values or joint not in (self.joints or ("",)):
            return np.empty(0)
        return np.asarray(values[name])[self.joints.index(joint)] if self.joints else np.asarray(values[name])

    @property
    def pressures(self) -> dict[str, NDArray[np.float64]]:
        """Pressures [Pa] by muscle."""
        if not self.muscles:
            return {f"muscle {number}": self.result[f"pressure{number}"] for number in (1, 2)}
        return dict(zip(self.muscles, self.result["pressure"], strict=True))


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
    joint
        Joint that the charts show, of several.
    waiting, note
        What reads the scenario of another page, to be run when this page opens, from the session's folder; and a
        remark on it, or on the one that ran.
    form
        Number of the present fields, which are made again when it changes.
    """

    scenario: StudiedScenario | None = None
    options: dict[str, str | None] = field(default_factory=dict)
    text: str = START
    current: ScenarioRun | None = None
    overlays: list[ScenarioRun] = field(default_factory=list)
    studies: dict[str, Presented] = field(default_factory=dict)
    joint: str = ""
    waiting: Callable[[Path], StudiedScenario] | None = None
    note: str = ""
    form: int = 0

    @property
    def ran(self) -> str | None:
        """Text of the scenario that ran last; None while another one runs. Another text is run when the page opens."""
        return None if self.jobs.busy or self.waiting or self.current is None else self.current.text

    @ran.setter
    def ran(self, text: str) -> None:
        self.waiting = partial(parse, text)

    @property
    def finished(self) -> bool:
        return self.current is not None


def read_text(text: str) -> StudiedScenario:
    """Scenario of a text of ours."""
    return Scenario.parse(text)


def parse(text: str, folder: Path) -> StudiedScenario:
    """Parse a scenario that names only files of the session, and is short enough for a page."""
    kind = Scenario.class_of(text)
    scenario = parse_model(kind, text, source="scenario", folder=folder, confined=True)[0]
    steps = (scenario.timing["duration"] or 0.0) / scenario.control_period * (scenario.substeps or 1 + 2)
    if steps > MOST_STEPS:
        message = f"the run has {steps:.3g} integration steps, more than {MOST_STEPS:.3g}"
        raise ParameterError(message, value=steps, remedy="shorten the duration, or use `mckibben simulate`")
    return scenario


def compute(scenario: StudiedScenario, folder: Path) -> ScenarioRun:
    """Run a scenario."""
    result = scenario.run_once()
    text = scenario.dumps(folder=folder)
    words = ("simulate", "scenario.yaml", "--out", "run")
    again = Repetition.of(words, f"result = {READ}.simulate()", scenario_files(text, folder))
    presented = Presented.of(result, again, charts=True)
    return ScenarioRun(text, scenario.joint_names, scenario.muscle_names, result, presented)


async def save_scenario(files: Sequence[FileUpload], folder: Path) -> Path:
    """Save files that were uploaded together; the path of the scenario, MJCF or URDF that names the others.

    Raises `ParameterError` if there are several.
    """
    paths = [folder / (re.sub(r"[^\w.,+ -]", "_", Path(file.name).name)[-80:].lstrip(".") or "file") for file in files]
    for file, path in zip(files, paths, strict=True):
        await file.save(path)
    texts = {path: path.read_bytes() for path in paths}
    named = [path for path in paths if any(path.name.encode() in texts[other] for other in paths if other != path)]
    first = [path for path in paths if path not in named and (len(paths) == 1 or _describes(path, texts[path]))]
    if len(first) != 1:
        message = f"{len(first)} of the {len(paths)} files describe a joint or a robot and are named by no other"
        raise ParameterError(message, remedy="choose one, with the files that it names")
    return first[0]


def _describes(path: Path, content: bytes) -> bool:
    """Whether a file is MJCF, URDF, or YAML with a joint or a robot."""
    is_yaml = path.suffix.lower() in (".yaml", ".yml")
    return path.suffix.lower() in (".xml", ".urdf") or (is_yaml and bool(re.search(rb"(?m)^(joint|robot):", content)))


def scenario_files(text: str, folder: Path) -> dict[str, bytes]:
    """A scenario as a file, with those of the session that it names."""
    names = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {"scenario.yaml": text.encode()} | {name: names[name].read_bytes() for name in names if name in text}


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


def with_joint(joint: str, folder: Path) -> StudiedScenario:
    """The scenario of `mckibben new joint` with another joint, and a stiffness reference that it can hold.

    Raises `RangeError` if the muscles cannot hold the load.
    """
    values = dict.fromkeys(("file", "muscle", "rest_length"), "") | UNKNOWN | {"name": "my joint"}
    section = {"joint": plain(read_document(joint).data)["joint"]}

    def text() -> str:
        return to_text(plain(read_document(starting_text(values)).data) | section)

    scenario: Any = parse(text(), folder)
    values |= laboratory(scenario.joint) | starting_stiffness(scenario.plant().supplied_joint, scenario.load)
    return parse(text(), folder)
