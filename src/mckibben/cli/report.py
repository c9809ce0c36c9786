"""Result of a command that joins parts, with the files that it writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.result import Listing, Remark, WritingResult, figure_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Report(WritingResult):
    """Verdict, remarks and tables of several parts, and functions that write and draw their files."""

    text: str
    tables: tuple[Listing, ...]
    comments: tuple[Remark, ...]
    numbers: dict[str, object] | None = None
    """Data for JSON in place of verdict, remarks and tables."""
    drawings: Mapping[str, Callable[[], Figure]] = field(default_factory=dict, kw_only=True)
    """Functions that draw figures, by name."""

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
        """Write and draw the files of the parts."""
        from mckibben.report import save

        super().write(folder)
        for name, draw in self.drawings.items():
            save(draw(), folder, name)

    def saved_names(self) -> list[str]:
        """Names of the files of the parts."""
        return [*super().saved_names(), *figure_files(*self.drawings)]
