"""Result of a command that joins parts, with the files that it writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import ClassVar

from mckibben.result import Listing, Remark, Result


class Report(Result):
    """Verdict, remarks and tables of several parts, and a function that writes their files to a folder."""

    files: ClassVar = (
        *("fit.yaml", "muscle.yaml", "recipe.yaml", "data.nc", "fits"),
        "robot.yaml",
        *(
            f"{name}.{end}"
            for name in ("fit", "bands", "loops", "ranking", "posture", "point_stiffness")
            for end in ("png", "svg")
        ),
    )

    text: str
    tables: tuple[Listing, ...]
    comments: tuple[Remark, ...]
    write_files: Callable[[Path], None]
    numbers: dict[str, object] | None = None
    """Data for JSON in place of verdict, remarks and tables."""

    def verdict(self) -> str:
        """Return the verdict of the parts."""
        return self.text

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the parts."""
        return self.comments

    def listings(self) -> Iterable[Listing]:
        """Return the tables of the parts."""
        return self.tables

    def to_dict(self) -> dict[str, object]:
        """Return the data for JSON."""
        return super().to_dict() if self.numbers is None else dict(self.numbers)

    def write(self, folder: Path) -> None:
        """Write the files of the parts."""
        self.write_files(folder)
