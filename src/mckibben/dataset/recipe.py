"""Recipe for reading the files of a logger: assigned columns, sign and zero, kept for the next file."""

from __future__ import annotations

import os
import warnings
from typing import Annotated, Any, Self

from pydantic import AfterValidator

from mckibben.component.calls import user_level
from mckibben.config.fields import OneOf
from mckibben.config.model import DocumentModel, fail_validation
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.quantities import OnCorrupt
from mckibben.dataset.reading import FilePaths, read_dataset, read_recording
from mckibben.dataset.recording import Recording
from mckibben.errors import McKibbenWarning
from mckibben.units import BoundedInt, Contraction, Force, Length, SampleRate

_OF_SAMPLES = ("contraction", "sample_rate")


def _check_sign(value: int) -> int:
    if value not in (-1, 1):
        fail_validation(f"{value} is neither 1 nor -1", "write -1 for a load cell that reads a pull as negative")
    return value


class Recipe(DocumentModel):
    """Settings for reading the files of a logger: the arguments of `read_dataset` and `read_recording`, in SI units.

    `read` and `to_yaml` know the units. `contraction` and `sample_rate` apply to recordings only. A `ScenarioError`
    lists all mistakes of a file, or of the arguments.

    Examples
    --------
    >>> recipe = Recipe(columns={"Weg [mm]": "displacement_mm"}, displacement="shortening", initial_length=0.3)
    >>> print(recipe.dumps())
    columns: {"Weg [mm]": displacement_mm}
    initial_length: 300 mm
    displacement: shortening
    <BLANKLINE>
    """

    kind = "recipe"
    examples = "docs/files.md"

    columns: dict[str, str] | None = None
    initial_length: Length | None = None
    displacement: Annotated[str, OneOf(("shortening", "lengthening"))] | None = None
    zero_length: Length | None = None
    contraction: Contraction | None = None
    sample_rate: SampleRate | None = None
    slack_force: Force | None = None
    largest_force: Force | None = None
    force_sign: Annotated[int, BoundedInt(-1, 1), AfterValidator(_check_sign)] | None = None
    decimal: Annotated[str, OneOf((".", ","))] | None = None
    specimen: str | None = None
    from_name: str | None = None

    @classmethod
    def parse(cls, text: str, *, source: str = "", folder: str | os.PathLike[str] = ".") -> Self:
        """Read YAML text; one without any line but comments is the recipe of a file that needs no options."""
        if all(not line.strip() or line.lstrip().startswith("#") for line in text.splitlines()):
            return cls()
        return super().parse(text, source=source, folder=folder)

    def dataset(self, path: FilePaths, *, on_corrupt: OnCorrupt = "raise") -> IsobaricDataset:
        """Read points, see `read_dataset`; warns of `contraction` and `sample_rate`, which have no effect."""
        if unused := [name for name in _OF_SAMPLES if getattr(self, name) is not None]:
            text = f"the recipe has settings that apply to recordings only, not to points: {', '.join(unused)}"
            warnings.warn(text, McKibbenWarning, stacklevel=user_level())
        return read_dataset(path, on_corrupt=on_corrupt, **self._arguments(*_OF_SAMPLES))

    def recording(self, path: FilePaths, *, on_corrupt: OnCorrupt = "raise") -> Recording:
        """Read samples over time, see `read_recording`."""
        return read_recording(path, on_corrupt=on_corrupt, **self._arguments())

    def _arguments(self, *without: str) -> dict[str, Any]:
        return self.model_dump(exclude_none=True, exclude=set(without))

    def __repr__(self) -> str:
        return f"<Recipe: {', '.join(self.dumps().splitlines())}>"

    def _written(self, folder: Any) -> dict[str, Any]:
        return {key: one for key, one in super()._written(folder).items() if one is not None}
