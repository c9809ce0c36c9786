"""`mckibben identify` and `validate`: force laws, friction, and their validation."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import Data, Reading, parse_positive, reads_files
from mckibben.errors import ParameterError, UnitError
from mckibben.result import Listing, Remark, Result
from mckibben.storage.files import atomic_write, make_subfolder
from mckibben.units import quantity, show

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import Fit, FitWithFriction, FrictionForm, PooledFit, Ranking, ThresholdFit

_ALL = "all"
_CHOICES = {"auto": None, "on": True, "off": False}
_DRAWN = ("fit", "bands", "loops")


@reads_files("contraction", "sample_rate", "specimen")
@command
def identify(
    data: Data,
    law: Annotated[
        str, Option(help="Force law, such as exponential (Eq. 2); 'mckibben catalog' lists them; 'all' ranks them.")
    ] = "exponential",
    friction: Annotated[
        str,
        Option(
            metavar="FORM",
            help="Friction and drift with the law: on, off, or a form such as coulomb (default: on if loading and "
            "unloading differ, in the form that predicts held-out loops best).",
        ),
    ] = "auto",
    inner: Annotated[
        str,
        Option(metavar="SIZE", help="Inner diameter or measured volume of air at contraction 0, for muscle.yaml."),
    ] = "",
    threshold: Annotated[bool, Option("--threshold", help="Identify a pressure threshold with the law.")] = False,
    pool: Annotated[
        bool, Option("--pool", help="Each file is another specimen of one make; one law for all, and errors left out.")
    ] = False,
    for_length: Annotated[
        str, Option(metavar="LENGTH", help="Initial length of a specimen that --pool predicts, for muscle.yaml.")
    ] = "",
    keep_outliers: Annotated[
        bool, Option("--keep-outliers", help="Fit all points, those off the surface through the others, too.")
    ] = False,
    *,
    reading: Reading,
    progress: Any = None,
) -> Result:
    """Fit a force law to measured points: estimates with standard errors, and cross-validation errors.

    With --law all, every law is fitted, and laws are ranked by cross-validation over pressures, inner contractions,
    directions and repeats; the error at the highest pressure, predicted from all lower ones, is shown. Where loading
    and unloading differ, friction and drift of the force sensor are identified with the law (--friction off: without).
    """
    from mckibben.study.inputs import law_type_named

    law_type, robust = law_type_named(law) if law != _ALL else None, not keep_outliers
    form = None if friction in _CHOICES else _friction_form(friction)
    if law_type is None and (friction != "auto" or threshold or pool):
        raise ParameterError(
            "--friction, --threshold and --pool apply to a single law", remedy="choose one, such as --law exponential"
        )
    volume = _inner(inner)
    if pool or for_length:
        if friction != "auto" or threshold or any(volume) or not pool:
            raise ParameterError(
                "--pool fits a single law, and applies to no other option of the fit",
                remedy="give --pool, --law, --for-length, --keep-outliers and --out alone",
            )
        return _pooled(law_type, [reading.data([file]) for file in data], for_length, robust)
    points = reading.data(data)
    _check_inner(volume[0], points.table.attrs.get("initial_length"))
    source = _Source(data, points, reading.recipe, volume)
    if law_type is None:
        from mckibben.identification import rank

        return _Ranked(rank(points, robust=robust, progress=progress), source)
    from mckibben.identification import identify_threshold, identify_with_friction, shows_hysteresis

    asked = True if form else _CHOICES[friction]
    if threshold and asked is None and shows_hysteresis(points):
        asked = True  # the misfit of the law without its threshold would hide the friction
    fitted = identify_with_friction(law_type, points, friction=asked, form=form, robust=robust)
    late = identify_threshold(law_type, fitted.points, robust=robust) if threshold else None
    return _Identified(fitted, late, source)


def _pooled(law_type: Any, data: list[IsobaricDataset], for_length: str, robust: bool) -> _Pool:
    """Pool of datasets, one per specimen."""
    from mckibben.identification import identify_pooled

    length = parse_positive("--for-length", for_length, "m") if for_length else None
    return _Pool(identify_pooled(law_type, data, robust=robust), length)


class _Source(Result):
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
        from mckibben.muscle.air import inner_volume, volume_terms
        from mckibben.scenario import muscle_text

        attrs, (diameter, volume) = self.points.table.attrs, self.inner
        common = os.path.commonprefix([Path(file).stem for file in self.files_read])  # noqa: RUF071, of characters
        common = common if len(self.files_read) == 1 else common.rstrip("0123456789.,+_- ")  # the numbers differ
        length = attrs.get("initial_length")
        if volume is None and diameter is not None and length:
            volume = inner_volume(length, diameter)
        terms = volume_terms(fit.law, length, volume) if length and volume is not None else None
        text = muscle_text(
            law, specimen=attrs["specimen"] or common, initial_length=length, volume_terms=terms, **friction
        )
        if text:
            with atomic_write(folder / "muscle.yaml", overwrite=True) as part:
                part.write_text(text, encoding="utf-8")

    def remarks(self) -> Iterable[Remark]:
        """Return a remark on a muscle that cannot be used in scenarios."""
        if self.points.table.attrs.get("initial_length") is None:
            text = "no muscle.yaml for scenarios, since the initial length is unknown"
            yield Remark.note("initial_length", text, "give --initial-length")
        for text in self.points.table.attrs.get("preprocessing", "").splitlines():
            yield Remark.note("data", text)


class _Identified(Result):
    """Law, friction and threshold that a command identified."""

    files: ClassVar = (
        *("fit.yaml", "muscle.yaml", "recipe.yaml", "data.nc"),
        *(f"{name}.{end}" for name in _DRAWN for end in ("png", "svg")),
    )

    fitted: FitWithFriction
    late: ThresholdFit | None
    source: _Source

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


class _Ranked(Result):
    """Ranking of laws that a command made."""

    files: ClassVar = (
        *("fits", "fit.yaml", "muscle.yaml", "recipe.yaml", "data.nc"),
        *("ranking.png", "ranking.svg", "fit.png", "fit.svg"),
    )

    ranking: Ranking
    source: _Source

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


class _Pool(Result):
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
        from mckibben.scenario import muscle_text

        self.pooled.fit.to_yaml(folder / "fit.yaml")
        if self.length is not None:
            specimen = self.pooled.specimen(self.length)
            text = muscle_text("fit.yaml", specimen=specimen.name, initial_length=float(specimen.initial_length))
            with atomic_write(folder / "muscle.yaml", overwrite=True) as part:
                part.write_text(text, encoding="utf-8")


def _inner(text: str) -> tuple[float | None, float | None]:
    """Inner diameter [m] or volume of air [m^3] at contraction 0, from either."""
    if not text:
        return None, None
    try:
        quantity(text, "m^3")
    except UnitError:
        return parse_positive("--inner", text, "m"), None
    return None, parse_positive("--inner", text, "m^3")


def _check_inner(diameter: float | None, length: float | None) -> None:
    """Raise a `ParameterError` for a diameter above the initial length [m]."""
    if diameter is not None and length and diameter > length:
        message = f"--inner is {show(diameter, 'mm')}, more than the initial length, {show(length, 'mm')}"
        remedy = "check both, such as --inner '10 mm' --initial-length '200 mm'"
        raise ParameterError(message, value=diameter, upper=length, unit="m", remedy=remedy)


def _friction_form(text: str) -> FrictionForm:
    from mckibben.identification import FrictionForm

    try:
        return FrictionForm(text)
    except ValueError:
        forms = ", ".join([*_CHOICES, *(form.value for form in FrictionForm)])
        message = f"--friction {text!r} is not a form of friction"
        raise ParameterError(message, value=text, remedy=f"take {forms}") from None


@reads_files("contraction", "sample_rate", "specimen")
@command
def validate(
    law: Annotated[
        str, Argument(metavar="LAW", help="A file of a fit or a muscle, a law from the catalog, or 'chou'.")
    ],
    data: Data,
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid angle and diameter 'chou' uses.")] = "",
    *,
    reading: Reading,
) -> Result:
    """Validate a force law with measured points: errors by pressure and direction. Friction is not included."""
    from mckibben.identification import validate as run
    from mckibben.study.inputs import law_named

    known = law_named(law, specimen=specimen)
    return run({Path(law).name if Path(law).is_absolute() else law: known}, reading.data(data))
