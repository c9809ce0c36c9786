"""Pages and docstrings whose examples take seconds: `make verify` runs them, `make test` does not."""

from pathlib import Path

import pytest

SLOW = {
    "batches.md",
    "control.md",
    "export-simulators.md",
    "extending.md",
    "laws.md",
    "robot.md",
    "size.md",
    "stiffness.md",
    "tour.md",
    "tuning.md",
    "uncertainty.md",
    "your-muscle.md",
    "mckibben.reachability.selection.size",
    "mckibben.study.compare.compare.runs_of",
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow pages, and put the one that defines classes behind all tests of its process."""
    items.sort(key=lambda item: item.path.name == "extending.md")
    for item in items:
        if item.name in SLOW:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True)
def _files_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Examples may write files, and read those of the repository."""
    (tmp_path / "examples").symlink_to(Path(__file__).parents[1] / "examples")
    monkeypatch.chdir(tmp_path)
