"""Recipe for reading the files of a logger: assigned columns, sign and zero, kept for the next file."""

from __future__ import annotations

from typing import Annotated, Any

from mckibben.config.fields import OneOf
from mckibben.config.model import DocumentModel
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.quantities import OnCorrupt
from mckibben.dataset.reading import FilePaths, read_dataset, read_recording
from mckibben.dataset.recording import Recording
from mckibben.units import BoundedInt, Contraction, Force, Length, SampleRate

_OF_SAMPLES = ("contraction", "sample_rate")


class Recipe(DocumentModel):
    """How the files of a logger are read: the arguments of `read_dataset` and `read_recording`, in SI.

    `read` and `to_yaml` know the units. `contraction` and `sample_rate` apply to recordings only. A `ScenarioError`
    lists all mistakes of a file, a pydantic `ValidationError` those of arguments.

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
    force_sign: Annotated[int, BoundedInt(-1, 1)] | None = None
    decimal: Annotated[str, OneOf((".", ","))] | None = None
    specimen: str | None = None

    def dataset(self, path: FilePaths, *, on_corrupt: OnCorrupt = "raise") -> IsobaricDataset:
        """Read points, see `read_dataset`."""
        return read_dataset(path, on_corrupt=on_corrupt, **self._arguments(*_OF_SAMPLES))

    def recording(self, path: FilePaths, *, on_corrupt: OnCorrupt = "raise") -> Recording:
        """Read samples over time, see `read_recording`."""
        return read_recording(path, on_corrupt=on_corrupt, **self._arguments())

    def _arguments(self, *without: str) -> dict[str, Any]:
        return self.model_dump(exclude_none=True, exclude=set(without))

    def _written(self, folder: Any) -> dict[str, Any]:
        return {key: one for key, one in super()._written(folder).items() if one is not None}
