"""Reports of the command `identify`, with the files that they write."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mckibben import report
from mckibben.cli.report import Report
from mckibben.component.schema import write as write_component
from mckibben.errors import ParameterError
from mckibben.identification.with_friction import titled
from mckibben.result import Remark
from mckibben.storage.files import make_folder

if TYPE_CHECKING:
    from mckibben.cli.reading import Reading
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import Fit, FitWithFriction, Ranking


class Source(NamedTuple):
    """Where a fit comes from, and the volume of air [m^3] of its muscle at contraction 0, if it is known."""

    files_read: list[str]
    points: IsobaricDataset
    recipe: Recipe
    volume: float | None

    def write(self, folder: Path, fit: Fit) -> None:
        """Write fit, recipe and points, and the muscle if its initial length is known."""
        from mckibben.scenario import write_identified  # 0.3 s to import

        self.recipe.to_yaml(folder / "recipe.yaml")
        self.points.to_netcdf(folder / "data.nc")
        common = os.path.commonprefix([Path(file).stem for file in self.files_read])  # noqa: RUF071, of characters
        common = common if len(self.files_read) == 1 else common.rstrip("0123456789.,+_- ")  # the numbers differ
        write_identified(folder, fit, self.points.table.attrs, name=common, volume=self.volume)

    def remarks(self) -> Iterator[Remark]:
        """Remarks on the data, and on a muscle that cannot be used in scenarios."""
        if self.points.table.attrs.get("initial_length") is None:
            text = "no muscle.yaml for scenarios, since the initial length is unknown"
            yield Remark.note("initial_length", text, "give --initial-length")
        for text in self.points.table.attrs.get("preprocessing", "").splitlines():
            yield Remark.note("data", text)


def identified(fitted: FitWithFriction, source: Source) -> Report:
    """Report of a law with friction."""
    loops = fitted.hysteresis

    def write(folder: Path) -> None:
        source.write(folder, fitted)
        report.save(report.isobaric(fitted.points, fitted), folder, "fit")
        report.save(report.force_bands(fitted.points, fitted), folder, "bands")
        if loops:
            report.save(report.loops(source.points, loops), folder, "loops")

    return Report(fitted.verdict(), tuple(fitted.listings()), (*fitted.remarks(), *source.remarks()), write)


def of_torque(files: list[str], law: str, reading: Reading) -> Report:
    """Report of the law of two equal muscles, from torques of their joint."""
    from mckibben.dataset.reading import read_torques
    from mckibben.identification import identify_torque
    from mckibben.study.inputs import geometry_named, law_type_named

    recipe = reading.recipe
    length, geometry = recipe.initial_length, geometry_named(recipe.joint)
    if length is None or geometry is None:
        remedy = "give --read joint=FILE and --initial-length '180 mm'"
        raise ParameterError("torques need the joint and the initial length of its muscles", field="of", remedy=remedy)
    fit = identify_torque(
        law_type_named(law), read_torques(files, recipe, geometry=geometry), geometry, initial_length=length
    )

    def write(folder: Path) -> None:
        from mckibben.scenario import write_muscle

        recipe.to_yaml(folder / "recipe.yaml")
        name = recipe.specimen or Path(files[0]).stem
        section = {"class": type(fit.law).__name__, **write_component(fit.law)}
        write_muscle(folder / "muscle.yaml", fit.law, specimen=name, initial_length=length, law=section)

    return Report(fit.verdict(), tuple(fit.listings()), tuple(fit.remarks()), write)


def ranked(ranking: Ranking, source: Source) -> Report:
    """Report of a ranking of laws."""

    def write(folder: Path) -> None:
        for entry in ranking.entries:
            if entry.fit:
                entry.fit.to_yaml(make_folder(folder / "fits") / f"{entry.law}.yaml")
        best = ranking.best.fit
        assert best is not None
        source.write(folder, best)
        report.save(report.ranking(ranking), folder, "ranking")
        report.save(report.isobaric(best.points, best), folder, "fit")

    tables, remarks = titled(ranking.listings(), "points"), (*ranking.remarks(), *source.remarks())
    return Report(ranking.verdict(), tuple(tables), remarks, write)
