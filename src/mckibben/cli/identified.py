"""Results of the command `identify`, with the files that they write."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mckibben import report
from mckibben.component.schema import write as write_component
from mckibben.errors import ParameterError

if TYPE_CHECKING:
    from mckibben.cli.reading import Reading
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import Fit, FitWithFriction, Ranking
    from mckibben.result import Result


class Source(NamedTuple):
    """Where a fit comes from, and the volume of air [m^3] of its muscle at contraction 0, if it is known."""

    files_read: list[str]
    points: IsobaricDataset
    recipe: Recipe
    volume: float | None

    def writers(self, fit: Fit) -> dict[str, Callable[[Path], None]]:
        """Functions that write fit, recipe and points, and the muscle if its initial length is known."""
        common = os.path.commonprefix([Path(file).stem for file in self.files_read])  # noqa: RUF071, of characters
        common = common if len(self.files_read) == 1 else common.rstrip("0123456789.,+_- ")  # the numbers differ

        def write(path: Path) -> None:
            from mckibben.scenario import write_identified  # 0.3 s to import

            write_identified(path, fit, self.points.table.attrs, name=common, volume=self.volume)

        points = {"recipe.yaml": self.recipe.to_yaml, "data.nc": self.points.to_netcdf}
        return {"fit.yaml": fit.to_yaml, "muscle.yaml": write, **points}


def identified(fitted: FitWithFriction, source: Source) -> Result:
    """Return a law with friction, with its files."""
    drawings = {"bands": lambda: report.force_bands(fitted.points, fitted)}
    if hysteresis := fitted.hysteresis:
        drawings["loops"] = lambda: report.loops(source.points, hysteresis)
    return fitted.with_files(source.writers(fitted), drawings)


def of_torque(files: list[str], law: str, reading: Reading) -> Result:
    """Identify the law of two equal muscles from torques of their joint."""
    from mckibben.dataset.reading import read_torques
    from mckibben.identification import identify_torque
    from mckibben.identification.storage import rounded_law
    from mckibben.scenario.inputs import geometry_named, law_type_named

    recipe = reading.recipe
    length, geometry = recipe.initial_length, geometry_named(recipe.joint)
    if length is None or geometry is None:
        remedy = "give --read joint=FILE and --initial-length '180 mm'"
        raise ParameterError("torques need the joint and the initial length of its muscles", field="of", remedy=remedy)
    fit = identify_torque(
        law_type_named(law), read_torques(files, recipe, geometry=geometry), geometry, initial_length=length
    )

    def write(path: Path) -> None:
        from mckibben.scenario import write_muscle

        name = recipe.specimen or Path(files[0]).stem
        section = {"class": type(fit.law).__name__, **write_component(fit.law)}
        section = rounded_law(section, fit.law, fit.force_error)
        write_muscle(path, fit.law, specimen=name, initial_length=length, law=section)

    return fit.with_files({"recipe.yaml": recipe.to_yaml, "muscle.yaml": write})


def ranked(ranking: Ranking, source: Source) -> Result:
    """Return a ranking of laws, with the files of the best one."""
    best = ranking.best.fit
    assert best is not None
    fits = {f"fits/{entry.law}.yaml": entry.fit.to_yaml for entry in ranking.entries if entry.fit}
    drawings = {"fit": lambda: report.isobaric(best.points, best)}
    return ranking.with_files({**source.writers(best), **fits}, drawings)
