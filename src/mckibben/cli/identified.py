"""Results of the command `identify`, with the files that it writes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from mckibben.result import Listing, Remark, Result
from mckibben.storage.files import make_subfolder
from mckibben.units import show

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import Fit, FitWithFriction, PooledFit, Ranking, ThresholdFit

_DRAWN = ("fit", "bands", "loops")


class Source(Result):
    """Where a fit comes from, and what gives its muscle a volume."""

    files_read: list[str]
    points: IsobaricDataset
    recipe: Recipe
    inner: tuple[float | None, float | None]

    def write_inputs(self, folder: Path) -> None:
        """Write recipe and points."""
        self.recipe.to_yaml(folder / "recipe.yaml")
        self.points.to_netcdf(folder / "data.nc")

    def write_muscle(self, folder: Path, fit: Fit, law: Any = "fit.yaml", **friction: Any) -> None:
        """Write the muscle file next to its fit, if the initial length is known."""
        from mckibben.muscle.air import inner_volume
        from mckibben.scenario import write_muscle

        attrs, (diameter, volume) = self.points.table.attrs, self.inner
        common = os.path.commonprefix([Path(file).stem for file in self.files_read])  # noqa: RUF071, of characters
        common = common if len(self.files_read) == 1 else common.rstrip("0123456789.,+_- ")  # the numbers differ
        length = attrs.get("initial_length")
        if volume is None and diameter is not None and length:
            volume = inner_volume(length, diameter)
        name = attrs["specimen"] or common
        write_muscle(
            folder / "muscle.yaml",
            fit.law,
            specimen=name,
            initial_length=length,
            volume=volume,
            law=law,
            **friction,
        )

    def remarks(self) -> Iterable[Remark]:
        """Return a remark on a muscle that cannot be used in scenarios."""
        if self.points.table.attrs.get("initial_length") is None:
            text = "no muscle.yaml for scenarios, since the initial length is unknown"
            yield Remark.note("initial_length", text, "give --initial-length")
        for text in self.points.table.attrs.get("preprocessing", "").splitlines():
            yield Remark.note("data", text)


class Identified(Result):
    """Law, friction and threshold that a command identified."""

    files: ClassVar = (
        *("fit.yaml", "muscle.yaml", "recipe.yaml", "data.nc"),
        *(f"{name}.{end}" for name in _DRAWN for end in ("png", "svg")),
    )

    fitted: FitWithFriction
    late: ThresholdFit | None
    source: Source

    def verdict(self) -> str:
        """Return the verdicts of the parts."""
        return self.fitted.verdict() + (f". {self.late.verdict()}" if self.late else "")

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the parts."""
        yield from self.fitted.remarks()
        yield from self.late.notes if self.late else ()
        yield from self.source.remarks()

    def listings(self) -> Iterable[Listing]:
        """Return the tables of the parts."""
        from mckibben.identification.with_friction import titled

        loops, late = self.fitted.hysteresis, self.late
        yield from titled((late if late and self._late else self.fitted).fit.listings(), "law")
        yield from titled(late.listings(), "threshold") if late else ()
        yield from titled(loops.listings(), "law and friction") if loops else ()

    @property
    def _late(self) -> bool:
        return self.late is not None and self.late.is_significant

    def write(self, folder: Path) -> None:
        """Write fit, muscle, inputs and figures."""
        from mckibben import report

        fit, points, law = self.fitted.fit, self.fitted.points, "fit.yaml"
        if self.late and self._late:
            fit, points = self.late.fit, self.late.effective(points)
            law = {"class": "threshold", "law": "fit.yaml", "threshold": show(self.late.threshold, "bar", 15)}
        loops = self.fitted.hysteresis
        friction = {"friction": loops.friction, "undetermined": loops.undetermined} if loops else {}
        fit.to_yaml(folder / "fit.yaml")
        self.source.write_muscle(folder, fit, law, **friction)
        self.source.write_inputs(folder)
        report.save(report.isobaric(points, fit), folder, "fit")
        report.save(report.force_bands(points, fit), folder, "bands")
        if loops:
            report.save(report.loops(self.source.points, loops), folder, "loops")


class Ranked(Result):
    """Ranking of laws that a command made."""

    files: ClassVar = (
        *("fits", "fit.yaml", "muscle.yaml", "recipe.yaml", "data.nc"),
        *("ranking.png", "ranking.svg", "fit.png", "fit.svg"),
    )

    ranking: Ranking
    source: Source

    def verdict(self) -> str:
        """Return the verdict of the ranking."""
        return self.ranking.verdict()

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the ranking."""
        yield from self.ranking.remarks()
        yield from self.source.remarks()

    def listings(self) -> Iterable[Listing]:
        """Return the table of laws."""
        from mckibben.identification.with_friction import titled

        return titled(self.ranking.listings(), "points")

    def write(self, folder: Path) -> None:
        """Write all fits, the best one, its muscle, inputs and figures."""
        from mckibben import report

        for entry in self.ranking.entries:
            if entry.fit:
                entry.fit.to_yaml(make_subfolder(folder, "fits") / f"{entry.law}.yaml")
        best = self.ranking.best.fit
        assert best is not None
        best.to_yaml(folder / "fit.yaml")
        self.source.write_muscle(folder, best)
        self.source.write_inputs(folder)
        report.save(report.ranking(self.ranking), folder, "ranking")
        report.save(report.isobaric(self.source.points, best), folder, "fit")


class Pool(Result):
    """Pool of specimens that a command fitted, and another specimen that it predicts."""

    files: ClassVar = ("fit.yaml", "muscle.yaml")

    pooled: PooledFit
    length: float | None

    def verdict(self) -> str:
        """Return the verdict of the pool."""
        return self.pooled.verdict()

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the pool, and one on the length in muscle.yaml."""
        yield from self.pooled.remarks()
        if self.length is not None and self.pooled.dead_length:
            dead = show(self.pooled.dead_length, "mm", 4)
            text = f"the length in muscle.yaml is the active one; the dead length, {dead}, belongs to the connector"
            yield Remark.note("dead_length", text)

    def listings(self) -> Iterable[Listing]:
        """Return the tables of the pool, and the forces of another specimen."""
        from mckibben.identification.with_friction import titled

        yield from titled(self.pooled.listings(), "pool")
        if self.length is not None:
            yield self.pooled.prediction(self.length)

    def write(self, folder: Path) -> None:
        """Write the fit, and the muscle of another length."""
        from mckibben.scenario import write_muscle

        self.pooled.fit.to_yaml(folder / "fit.yaml")
        if self.length is not None:
            specimen = self.pooled.specimen(self.length)
            length = float(specimen.initial_length)
            write_muscle(folder / "muscle.yaml", self.pooled.fit.law, specimen=specimen.name, initial_length=length)
