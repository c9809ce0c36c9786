"""A project of the pages as one file: a zip with the points, muscle and scenario that the command line reads."""

from __future__ import annotations

import io
import re
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from mckibben.component.schema import parse_component
from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.errors import DatasetError, ParameterError, printable
from mckibben.muscle import Muscle
from mckibben.scenario import Scenario
from mckibben.web.identify import IdentificationState
from mckibben.web.security import LARGEST
from mckibben.web.workbench import Workbench, parse

SCENARIO, MUSCLE, FIT, POINTS = "scenario.yaml", "muscle.yaml", "fit.yaml", "points.csv"
MOST_FILES = 32
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_ .-]{0,99}\.(?:yaml|yml|csv)")
"""Files of a project: texts without a folder."""


@dataclass(frozen=True)
class Project:
    """Contents of a project; None for what it lacks."""

    scenario: Scenario | None
    muscle: Muscle | None
    points: IsobaricDataset | None


def pack(folder: Path, scenario: str, points: IsobaricDataset | None) -> bytes:
    """The zip file of a scenario, the points, and the files of a session's folder that can belong to a project."""
    kept = io.BytesIO()
    with zipfile.ZipFile(kept, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(SCENARIO, scenario)
        if points is not None:
            with tempfile.TemporaryDirectory(dir=folder) as place:
                points.to_csv(Path(place) / POINTS)
                archive.write(Path(place) / POINTS, POINTS)
        for path in sorted(folder.iterdir()):
            own = path.name in (SCENARIO, POINTS) or path.name.startswith("data-")  # uploads of points
            if path.is_file() and _NAME.fullmatch(path.name) and not own:
                archive.write(path, path.name)
    return kept.getvalue()


def contents(content: bytes) -> dict[str, bytes]:
    """Files of a zip file by name; `ParameterError` for anything but a few texts outside folders, within the limit."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            if len(entries) > MOST_FILES:
                raise _refused(f"the project has {len(entries)} files, more than {MOST_FILES}")
            names = [one.filename for one in entries]
            for name in names:
                if not _NAME.fullmatch(name):
                    remedy = "a project has .yaml and .csv files, and no folders"
                    raise _refused(f"the project has a file {printable(repr(name), 80)}", remedy)
            if len({name.lower() for name in names}) < len(names):
                raise _refused("the project has two files of one name")
            found, left = {}, LARGEST
            for entry in entries:
                with archive.open(entry) as file:
                    found[entry.filename] = file.read(left + 1)  # whatever size the entry claims
                left -= len(found[entry.filename])
                if left < 0:
                    raise _refused(f"the files of the project are larger than {LARGEST // 2**20} MiB")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        raise _refused(f"this is not a readable zip file: {printable(str(error), 200)}") from None
    return found


def _refused(message: str, remedy: str = "download a project from the page Run, and upload that") -> ParameterError:
    return ParameterError(message, remedy=remedy)


def unpack(content: bytes, folder: Path) -> Project:
    """Read a project, and put its files into a session's folder if all of them are valid; any error leaves it as is."""
    files = contents(content)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        place = Path(made)
        for name, text in files.items():
            (place / name).write_bytes(text)
        project = _read(files, place)
        for name in files:
            (place / name).replace(folder / name)
    return project


def _read(files: dict[str, bytes], place: Path) -> Project:
    """Check the files of a project as they are checked when they are uploaded one by one."""
    if not {SCENARIO, MUSCLE, POINTS} & set(files):
        raise _refused(f"the project has none of {SCENARIO}, {MUSCLE} and {POINTS}")

    def text(name: str) -> str:
        return files[name].decode("utf-8-sig", errors="replace")

    muscle = points = scenario = None
    if MUSCLE in files:
        context = {"confined": True}
        muscle = parse_component(Muscle, text(MUSCLE), source=MUSCLE, folder=place, context=context)
    if POINTS in files:
        try:
            points = read_dataset(place / POINTS)
        except DatasetError as error:
            raise DatasetError(POINTS, error.problems) from None
    if SCENARIO in files:
        scenario = parse(text(SCENARIO), place)
    return Project(scenario, muscle, points)


def adopt(project: Project, folder: Path, bench: Workbench, identification: IdentificationState) -> None:
    """Show a project on the pages Muscle, Joint and Run."""
    if project.points is not None:
        identification.use(POINTS, project.points, [folder / POINTS])
        identification.reading.clear()
    if project.muscle is not None:
        identification.muscle = project.muscle
    identification.jobs.version += 1
    if project.scenario is not None:
        bench.waiting = (folder / SCENARIO).read_text(encoding="utf-8-sig")
