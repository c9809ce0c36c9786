"""`mckibben identify` and `validate`: force laws, friction, and their validation."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Argument, Option

from mckibben.cli.options import (
    Data,
    Force,
    Json,
    Out,
    Reading,
    echo,
    keeping,
    notify,
    on_command_line,
    parse_positive,
    progress,
    reads_files,
    results_folder,
    show_results,
    table,
)
from mckibben.errors import ParameterError
from mckibben.storage.files import atomic_write, make_subfolder, to_json, write_json
from mckibben.units import bar, show

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.identification import Fit, FrictionForm, HysteresisFit, RankedLaw, Ranking, ThresholdFit
    from mckibben.muscle import ForceLaw


_ALL, _LEVEL = "all", 0.95
_EFFECTIVE = "fit-effective.yaml"  # of a law at the pressures above its threshold


@reads_files("contraction", "sample_rate", "specimen")
def identify(
    data: Data,
    law: Annotated[
        str, Option(help="Force law, such as exponential (Eq. 2); 'mckibben catalog' lists them; 'all' ranks them.")
    ] = "exponential",
    level: Annotated[float, Option(help="Confidence level of the intervals.")] = _LEVEL,
    profile: Annotated[bool, Option("--profile", help="Profile likelihood of the shape parameters.")] = False,
    hysteresis: Annotated[
        bool | None, Option(help="Identify friction and drift with the law (default: if loading and unloading differ).")
    ] = None,
    friction_form: Annotated[
        str, Option("--friction", metavar="FORM", help="Form of friction (default: by held-out loops).")
    ] = "",
    diameter: Annotated[
        str, Option(metavar="LENGTH", help="Inner diameter without pressure, from which muscle.yaml gets a volume.")
    ] = "",
    fill: Annotated[
        str, Option(metavar="VOLUME", help="Measured volume of the air at contraction 0, in place of --diameter.")
    ] = "",
    threshold: Annotated[bool, Option("--threshold", help="Identify a pressure threshold with the law.")] = False,
    pool: Annotated[
        bool, Option("--pool", help="Each file is another specimen of one make; one law for all, and errors left out.")
    ] = False,
    for_length: Annotated[
        str, Option(metavar="LENGTH", help="Initial length of a specimen that --pool predicts: force and muscle.yaml.")
    ] = "",
    no_drift: Annotated[bool, Option("--no-drift", help="Do not estimate drift with the friction.")] = False,
    keep_outliers: Annotated[
        bool, Option("--keep-outliers", help="Fit all points, those off the surface through the others, too.")
    ] = False,
    *,
    reading: Reading,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Fit a force law to measured points: estimates with standard errors, and cross-validation errors.

    With --law all, every law is fitted, and laws are ranked by cross-validation over pressures, inner contractions,
    directions and repeats; the error at the highest pressure, predicted from all lower ones, is shown. Where loading
    and unloading differ, friction and drift of the force sensor are identified with the law (--no-hysteresis: without).
    """
    figures = ("fit", "bands", "loops", "ranking")
    names = [f"{name}{end}" for name in figures for end in (".png", ".svg")]
    results_folder(
        out, ("fit.yaml", _EFFECTIVE, "muscle.yaml", "recipe.yaml", "data.nc", "results.json", "fits", *names), force
    )
    from mckibben.study.inputs import law_type_named

    law_type, robust = law_type_named(law) if law != _ALL else None, not keep_outliers
    if friction_form or no_drift:
        if hysteresis is False:
            raise ParameterError("--friction and --no-drift need friction", remedy="leave out --no-hysteresis")
        hysteresis = True
    if law_type is None and (profile or hysteresis is not None or threshold or level != _LEVEL):
        raise ParameterError(
            "--level, --profile, --hysteresis and --threshold apply to a single law",
            remedy="choose one, such as --law exponential",
        )
    form = _friction_form(friction_form) if friction_form else None
    inner = _Inner(
        parse_positive("--diameter", diameter, "m") if diameter else None,
        parse_positive("--fill", fill, "m^3") if fill else None,
    )
    if any(inner) and not out:
        raise ParameterError("--diameter and --fill apply to muscle.yaml", remedy="add --out DIR")
    if pool or for_length:
        others = (profile, hysteresis, threshold, *inner, law_type is None or not pool)
        if any(other is not None and other is not False and other != 0 for other in others):
            raise ParameterError(
                "--pool fits a single law, and applies to no other option of the fit",
                remedy="give --pool, --law, --for-length, --keep-outliers, --level and --out alone",
            )
        assert law_type is not None
        each = [reading.data([one]) for one in data]
        length = parse_positive("--for-length", for_length, "m") if for_length else None
        _pool(law_type, each, robust, length, level, json, out)
        return
    points = reading.data(data)
    inner.check(points.table.attrs.get("initial_length"))
    if law_type is None:
        _rank(data, points, reading.recipe, inner, robust, json, out)
        return
    from mckibben.identification import identify_threshold, identify_with_friction, shows_hysteresis
    from mckibben.identification.reporting import UncertaintyReport, fit_numbers, hysteresis_numbers

    if threshold and hysteresis is None and shows_hysteresis(points):
        hysteresis = True  # the misfit of the law without its threshold would hide the friction
    found = identify_with_friction(law_type, points, friction=hysteresis, drift=not no_drift, form=form, robust=robust)
    fit, static, loops = found.fit, found.points, found.hysteresis
    threshold_fit = identify_threshold(law_type, static, robust=robust) if threshold else None
    fit, static = (threshold_fit.fit, threshold_fit.effective(static)) if threshold_fit else (fit, static)
    uncertainty = UncertaintyReport.of(fit, level=level, profiles=profile)
    notes = points.table.attrs.get("preprocessing", "").splitlines()
    numbers = {**fit_numbers(fit), "preprocessing": notes, "uncertainty": uncertainty.records()}
    if loops:
        numbers["hysteresis"] = hysteresis_numbers(loops)
    note = found.note + (" (--no-hysteresis)" if found.note and loops else "")
    numbers["friction_note"] = note
    texts = [note + "\n"] if note else []
    texts += [loops.report() + "\n\nForce law of the points corrected for friction and drift:\n"] if loops else []
    if threshold_fit:
        numbers["threshold"] = threshold_fit.records()
        texts.append(threshold_fit.report())
        texts += (
            [f"\nForce law at the pressures above it, as in figures and {_EFFECTIVE}:\n"]
            if threshold_fit.is_significant
            else []
        )
    texts += [fit.report(level), uncertainty.describe()]
    drawn, kept = {}, ""
    fit_name = _EFFECTIVE if threshold_fit and threshold_fit.is_significant else "fit.yaml"
    if out:
        from mckibben import report

        with keeping(out):
            for other in {"fit.yaml", _EFFECTIVE} - {fit_name}:  # of an earlier run
                (out / other).unlink(missing_ok=True)
            fit.to_yaml(out / fit_name)
            kept = _keep_muscle(out, data, points, fit, inner, loops, threshold_fit)
            reading.recipe.to_yaml(out / "recipe.yaml")
            points.to_netcdf(out / "data.nc")
            write_json(out / "results.json", numbers)
            drawn = {"fit": report.isobaric(static, fit), "bands": report.force_bands(static, fit, level=level)}
            drawn |= {f"profile-{one.name}": report.profile_likelihood(one, fit) for one in uncertainty.profiles}
            drawn |= {"loops": report.loops(points, loops)} if loops else {}
            for name, figure in drawn.items():
                report.save(figure, out, name)
    echo(to_json(numbers) if json else on_command_line("\n".join(filter(None, texts))))
    if out:
        figures = ", ".join(drawn)
        notify(f"wrote {fit_name}, recipe.yaml, data.nc, results.json, {figures} (.png, .svg) to {out}; {kept}", json)


def _pool(
    law: type[ForceLaw],
    data: list[IsobaricDataset],
    robust: bool,
    length: float | None,
    level: float,
    json: bool,
    out: Path | None,
) -> None:
    import numpy as np

    from mckibben.identification import identify_pooled
    from mckibben.scenario import muscle_text

    found = identify_pooled(law, data, robust=robust)
    numbers, texts = found.numbers(), [found.report()]
    if length is not None:
        domain = found.law.domain
        ends = (float(domain.contraction_min), float(domain.contraction_max))
        ratio = 1 - found.dead_length / length
        at = np.linspace(max(ends[0] * ratio, 0.0), ends[1] * ratio, 4)
        highest = float(domain.pressure_max)
        columns = np.column_stack([at, *found.predict(at, highest, length, level=level)])
        numbers["predicted"] = {"pressure_bar": highest / bar, "points": columns.tolist()}
        texts.append(f"\nforce of {show(length, 'mm')} at {highest / bar:.3g} bar, {100 * level:g} % interval:")
        texts += [f"  {100 * one[0]:5.1f} %  {one[1]:8.4g} N  {one[2]:.4g} .. {one[3]:.4g} N" for one in columns]
    if out:
        with keeping(out):
            found.fit.to_yaml(out / "fit.yaml")
            write_json(out / "results.json", numbers)
            if length is not None:
                specimen = found.specimen(length)
                text = muscle_text("fit.yaml", specimen=specimen.name, initial_length=float(specimen.initial_length))
                with atomic_write(out / "muscle.yaml", overwrite=True) as part:
                    part.write_text(text, encoding="utf-8")
    echo(to_json(numbers) if json else "\n".join(texts))
    if out:
        muscle = ""
        if length is not None:
            dead = show(found.dead_length, "mm", 4)
            muscle = (
                f" and muscle.yaml, whose length is the active one; the dead length, {dead}, belongs to the connector"
            )
        notify(f"wrote fit.yaml and results.json{muscle} to {out}", json)


class _Inner(NamedTuple):
    """Inner diameter [m] and measured volume [m^3] of a muscle at contraction 0, None if they are not given."""

    diameter: float | None
    fill: float | None

    def check(self, length: float | None) -> None:
        """Raise a `ParameterError` for a diameter above the initial length [m]."""
        if self.diameter is not None and length and self.diameter > length:
            message = f"--diameter is {show(self.diameter, 'mm')}, more than the initial length, {show(length, 'mm')}"
            remedy = "check both, such as --diameter '10 mm' --initial-length '200 mm'"
            raise ParameterError(message, value=self.diameter, upper=length, unit="m", remedy=remedy)


def _keep_muscle(
    out: Path,
    data: list[str],
    points: IsobaricDataset,
    fit: Fit,
    inner: _Inner,
    loops: HysteresisFit | None = None,
    threshold_fit: ThresholdFit | None = None,
) -> str:
    """Write the muscle file next to its fit; return a note on what was written, or why not."""
    from mckibben.muscle.air import inner_volume, volume_terms
    from mckibben.scenario import muscle_text

    attrs = points.table.attrs
    common = os.path.commonprefix([Path(one).stem for one in data])  # noqa: RUF071, of characters
    common = common if len(data) == 1 else common.rstrip("0123456789.,+_- ")  # the numbers differ
    name, length = attrs["specimen"] or common, attrs.get("initial_length")
    volume = inner.fill
    if volume is None and inner.diameter is not None and length:
        volume = inner_volume(length, inner.diameter)
    terms = volume_terms(fit.law, length, volume) if length and volume is not None else None
    law: Any = "fit.yaml"
    if threshold_fit and threshold_fit.is_significant:
        law = {"class": "threshold", "law": _EFFECTIVE, "threshold": show(threshold_fit.threshold, "bar", 15)}
    slip, unknown = (loops.friction, loops.undetermined) if loops else (None, ())
    text = muscle_text(
        law, specimen=name, initial_length=length, friction=slip, undetermined=unknown, volume_terms=terms
    )
    if not text:
        return "no muscle.yaml, since the initial length is unknown (give --initial-length)"
    with atomic_write(out / "muscle.yaml", overwrite=True) as part:
        part.write_text(text, encoding="utf-8")
    return "muscle.yaml for scenarios and protocols"


def _friction_form(text: str) -> FrictionForm:
    from mckibben.identification import FrictionForm

    try:
        return FrictionForm(text)
    except ValueError:
        forms = ", ".join(form.value for form in FrictionForm)
        raise ParameterError(
            f"--friction {text!r} is not a form of friction", value=text, remedy=f"take {forms}"
        ) from None


@reads_files("contraction", "sample_rate", "specimen")
def validate(
    law: Annotated[
        str, Argument(metavar="LAW", help="A file of a fit or a muscle, a law from the catalog, or 'chou'.")
    ],
    data: Data,
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid angle and diameter 'chou' uses.")] = "",
    *,
    reading: Reading,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Validate a force law with measured points: errors by pressure and direction. Friction is not included."""
    results_folder(out, ("results.json",), force)
    from mckibben.study.inputs import law_named

    known = law_named(law, specimen=specimen)
    points = reading.data(data)
    from mckibben.identification import validate as run

    validation = run({Path(law).name if Path(law).is_absolute() else law: known}, points)
    numbers = {"slack": validation.slack, "errors": validation.records()}
    show_results(out, numbers, validation.report(), json)


def _rank(
    data: list[str], points: IsobaricDataset, how: Recipe, inner: _Inner, robust: bool, json: bool, out: Path | None
) -> None:
    from mckibben.identification import rank

    with progress() as report_progress:
        ranking = rank(points, robust=robust, progress=report_progress)
    best = ranking.best
    numbers = {
        "best": best.law,
        "ranked_by": ranking.criterion,
        "points": len(ranking.points),
        "slack": ranking.slack,
        "not_left_out": ranking.missing,
        "outliers": [dataclasses.asdict(one) for one in ranking.outliers],
        "laws": ranking.records(),
    }
    kept = ""
    if out:
        from mckibben import report

        assert best.fit is not None
        with keeping(out):
            for entry in ranking.entries:
                if entry.fit:
                    entry.fit.to_yaml(make_subfolder(out, "fits") / f"{entry.law}.yaml")
            best.fit.to_yaml(out / "fit.yaml")
            kept = _keep_muscle(out, data, points, best.fit, inner)
            how.to_yaml(out / "recipe.yaml")
            points.to_netcdf(out / "data.nc")
            write_json(out / "results.json", numbers)
            report.save(report.ranking(ranking), out, "ranking")
            report.save(report.isobaric(points, best.fit), out, "fit")
    if json:
        echo(to_json(numbers))
    else:
        _show(ranking)
    if out:
        names = f"fit.yaml ({best.law}), fits/, recipe.yaml, data.nc, results.json, ranking.png and fit.png"
        notify(f"wrote {names} to {out}; {kept}", json)


def _show(ranking: Ranking) -> None:
    from mckibben.identification.ranking import EXTRAPOLATION

    specimen = ranking.points.table.attrs["specimen"] or "unnamed specimen"
    fitted = [entry for entry in ranking.entries if entry.fit]
    least = min((entry.aicc for entry in fitted if entry.aicc == entry.aicc), default=0.0)

    def row(entry: RankedLaw) -> tuple[str, ...]:
        held_out = [entry.cross_validation.get(name) for name in ranking.blocks]
        return (
            _short(entry),
            str(entry.parameters),
            *(f"{errors.rmse:.2f}" if errors else "-" for errors in (entry.fit, *held_out)),
            f"+{entry.aicc - least:.1f}" if entry.aicc == entry.aicc else "-",
            (entry.residual_correlation.pattern if entry.residual_correlation else "") or "-",
        )

    blocks = (f"{name} [N]" if name == EXTRAPOLATION else f"held-out {name}s [N]" for name in ranking.blocks)
    headers = ("law", "parameters", "RMSE [N]", *blocks, "AICc difference", "residual pattern over")
    rows = [row(entry) for entry in fitted]
    table(f"{specimen}: {len(ranking.points)} taut points, {ranking.slack} slack excluded", headers, rows)
    for text in ranking.remarks():
        echo(on_command_line(text))
    for entry in ranking.entries:
        for what, texts in (("not fitted", [entry.refused]), ("flagged", entry.flags), ("note on", entry.remarks)):
            if any(texts):
                echo(f"{what} {_short(entry)}: {'; '.join(texts)}")


def _short(entry: RankedLaw) -> str:
    return entry.law.removesuffix("Law")
