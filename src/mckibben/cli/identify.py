"""`mckibben points`, `identify` and `validate`: points from recordings, force laws, and their validation."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from typer import Argument, Option

from mckibben.cli.options import (
    Column,
    Data,
    Decimal,
    Displacement,
    Force,
    ForceSign,
    InitialLength,
    Json,
    Out,
    RecipeFile,
    SkipCorrupt,
    SlackForce,
    ZeroLength,
    echo,
    keeping,
    notify,
    on_command_line,
    parse_optional_quantity,
    parse_quantity,
    progress,
    read_data,
    recipe_of,
    report_reading,
    results_folder,
    table,
)
from mckibben.errors import DatasetError, ParameterError, Problem, UnitError
from mckibben.storage.files import atomic_write, make_subfolder, to_json, write_json
from mckibben.units import bar, percent, show

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints, IsobaricDataset, Recipe, Recording
    from mckibben.identification import Fit, FrictionForm, RankedLaw, Ranking
    from mckibben.muscle import MaxwellSlip


_SHOWN = 40  # rows of the table of points; below their columns, and the format of each
_COLUMNS = {
    "time_s": ".5g",
    "pressure_bar": ".5g",
    "contraction_percent": ".4g",
    "force_N": ".5g",
    "spread_N": ".2g",
    "samples": "",
    "came_by": "",
}
_LEADING_NUMBER = re.compile(r"^[+-]?[0-9.]+([eE][+-]?[0-9]+)?")


def points(
    recording: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="CSV, .xlsx, .mat, .tdms, .lvm or .nc, over time.")
    ],
    out: Annotated[
        Path | None, Option(metavar="FILE", help="New file: .csv, or .nc with the spread of the force.")
    ] = None,
    isometric: Annotated[bool, Option("--isometric", help="Points at pressure levels at a fixed length.")] = False,
    levels: Annotated[
        str, Option(metavar="'1, 2, 3 bar'", help="Levels of --isometric (default: evenly spaced).")
    ] = "",
    count: Annotated[int, Option(metavar="N", help="Number of evenly spaced levels of --isometric.")] = 12,
    contraction: Annotated[
        str, Option(metavar="RATIO", help="Contraction, such as '10 %', if no column gives it.")
    ] = "",
    pressure_tolerance: Annotated[str, Option(metavar="PRESSURE", help="Tolerance of a plateau.")] = "2 kPa",
    contraction_tolerance: Annotated[
        str, Option(metavar="RATIO", help="Tolerance of a plateau (default 0.1 %) or of --isometric (0.5 %).")
    ] = "",
    force_tolerance: Annotated[str, Option(metavar="FORCE", help="Tolerance of a plateau (default: none).")] = "",
    dwell: Annotated[str, Option(metavar="TIME", help="Shortest duration of a plateau.")] = "1 s",
    settle: Annotated[str, Option(metavar="TIME", help="Excluded start of a plateau.")] = "0 s",
    gap: Annotated[str, Option(metavar="TIME", help="Gap that ends a plateau (default: 10 sampling intervals).")] = "",
    sample_rate: Annotated[str, Option(metavar="RATE", help="For a file without times, such as '1000 Hz'.")] = "",
    initial_length: InitialLength = "",
    displacement: Displacement = "",
    zero_length: ZeroLength = "",
    slack_force: SlackForce = "",
    force_sign: ForceSign = None,
    specimen: Annotated[str, Option(metavar="NAME", help="Name of the specimen.")] = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    decimal: Decimal = "",
    recipe: RecipeFile = None,
    save_recipe: Annotated[
        Path | None, Option(metavar="FILE", help="New file: the options by which the recording was read.")
    ] = None,
    json: Json = False,
) -> None:
    """Extract points from a raw recording: steady plateaus, or pressure levels at a fixed length."""
    for file, endings in ((out, (".csv", ".nc")), (save_recipe, (".yaml", ".yml"))):
        if file is not None:
            _check_new(file, endings)
    pressures = _levels(levels)
    how = recipe_of(
        recipe,
        column,
        initial_length,
        displacement,
        zero_length,
        slack_force,
        force_sign,
        decimal,
        contraction=contraction,
        sample_rate=sample_rate,
        specimen=specimen,
    )
    held = how.contraction if isometric else None
    reader = how.model_copy(update={"contraction": None}) if isometric else how
    between = parse_optional_quantity("--gap", gap, "s")
    tolerance = parse_optional_quantity("--contraction-tolerance", contraction_tolerance, "1")
    steady = {
        "pressure_tolerance": parse_quantity("--pressure-tolerance", pressure_tolerance, "Pa"),
        "force_tolerance": parse_optional_quantity("--force-tolerance", force_tolerance, "N"),
        "dwell": parse_quantity("--dwell", dwell, "s"),
        "settle": parse_quantity("--settle", settle, "s"),
    }
    read = reader.recording(recording, on_corrupt="report" if skip_corrupt else "raise")
    if isometric:
        found = read.isometric(
            pressures,
            count=count,
            contraction=held,
            contraction_tolerance=0.005 if tolerance is None else tolerance,
            gap=between,
        )
    else:
        found = read.plateaus(contraction_tolerance=0.001 if tolerance is None else tolerance, gap=between, **steady)  # type: ignore[arg-type]
    if out is not None:
        write = found.dataset.to_netcdf if out.suffix.lower() == ".nc" else found.dataset.to_csv
        write(out)
    _show_points(read, found, recording, json)
    if out is not None:
        notify(f"wrote {len(found.dataset)} points to {out}; fit a law with: mckibben identify {out}", json)
    if save_recipe is not None:
        how.to_yaml(save_recipe)
        notify(f"wrote {save_recipe}; read the next file with: --recipe {save_recipe}", json)


def _show_points(read: Recording, found: ExtractedPoints, paths: list[Path], json: bool) -> None:
    report_reading(read.table.attrs)
    rows = _rows(found)
    if json:
        numbers = {
            "points": [dict(zip(_COLUMNS, row, strict=True)) for row in rows],
            "samples": dict(found.counts),
            "notes": list(found.notes),
            "repairs": read.table.attrs.get("repairs", "").splitlines(),
        }
        echo(to_json(numbers))
        return
    formats = _COLUMNS.values()
    shown = [tuple(map(format, row, formats)) for row in rows[:_SHOWN]]
    more = f" (first {_SHOWN} shown)" if len(rows) > _SHOWN else ""
    table(
        f"{', '.join(path.name for path in paths)}: {len(rows)} points from {len(read)} samples{more}",
        ("time s", "pressure bar", "contraction %", "force N", "spread N", "samples", "direction"),
        shown,
    )
    echo(on_command_line(found.describe()))


def _rows(found: ExtractedPoints) -> list[tuple[float | str, ...]]:
    data = found.dataset.table
    empty = [""] * len(found.dataset)
    direction, phase = (data[name].to_numpy() if name in data else empty for name in ("direction", "phase"))
    numbers = (
        data["time"].to_numpy(),
        found.dataset.pressure / bar,
        found.dataset.contraction / percent,
        found.dataset.force,
        data["force_spread"].to_numpy(),
        found.samples,
    )
    came_by = [str(one or other or "-") for one, other in zip(direction, phase, strict=True)]
    return list(zip(*(column.tolist() for column in numbers), came_by, strict=True))


def _check_new(out: Path, endings: tuple[str, str]) -> None:
    """Check, before the computation, that an output file is new and can be written."""
    if out.suffix.lower() not in endings:
        problem = Problem(f"is neither {endings[0]} nor {endings[1]}", remedy=f"use the ending {' or '.join(endings)}")
        raise DatasetError(str(out), [problem])
    if not out.parent.is_dir():
        raise DatasetError(str(out), [Problem(f"there is no folder {out.parent}", remedy="create it")])
    if out.exists():
        raise DatasetError(str(out), [Problem("exists already", remedy="choose another file, or delete it")])


def _levels(text: str) -> list[float] | None:
    """Parse pressures with one unit for all ("1, 2.5, 4 bar") or one each ("100 kPa, 2 bar")."""
    if not text:
        return None
    parts = [part.strip() for part in text.split(",")]
    units = [_LEADING_NUMBER.sub("", part).strip() for part in parts]
    if not any(units):
        raise UnitError(f"--levels {text!r} has no unit", value=text, remedy="write --levels '1, 2, 3 bar'")
    if not all(units):
        if any(units[:-1]) or not all(parts):
            raise UnitError(
                f"--levels {text!r} is not a list of pressures",
                value=text,
                remedy="write one unit for all, '1, 2, 3 bar', or one for each, '1 bar, 200 kPa'",
            )
        parts[:-1] = [f"{part} {units[-1]}" for part in parts[:-1]]
    return [parse_quantity("--levels", part, "Pa") for part in parts]


_ALL, _LEVEL = "all", 0.95


def identify(
    data: Data,
    law: Annotated[
        str, Option(help="Force law, such as exponential (Eq. 2); 'mckibben laws' lists them; 'all' ranks them.")
    ] = "exponential",
    level: Annotated[float, Option(help="Confidence level of the intervals.")] = _LEVEL,
    profile: Annotated[bool, Option("--profile", help="Profile likelihood of the shape parameters.")] = False,
    bootstrap: Annotated[int, Option(metavar="N", help="Block bootstrap with N resamples.")] = 0,
    hysteresis: Annotated[bool, Option("--hysteresis", help="Identify friction and drift with the law.")] = False,
    friction_form: Annotated[
        str,
        Option("--friction", metavar="FORM", help="Form of friction of --hysteresis (default: by held-out loops)."),
    ] = "",
    diameter: Annotated[
        str, Option(metavar="LENGTH", help="Inner diameter without pressure, from which muscle.yaml gets a volume.")
    ] = "",
    fill: Annotated[
        str, Option(metavar="VOLUME", help="Measured volume of the air at contraction 0, in place of --diameter.")
    ] = "",
    no_drift: Annotated[bool, Option("--no-drift", help="Do not estimate drift with --hysteresis.")] = False,
    initial_length: InitialLength = "",
    displacement: Displacement = "",
    zero_length: ZeroLength = "",
    slack_force: SlackForce = "",
    force_sign: ForceSign = None,
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    decimal: Decimal = "",
    recipe: RecipeFile = None,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Fit a force law to measured points: estimates with standard errors, and cross-validation errors.

    With --law all, every law is fitted, and laws are ranked by cross-validation over pressures, inner contractions,
    directions and repeats; the error at the highest pressure, predicted from all lower ones, is shown. With
    --hysteresis the friction between loading and unloading is identified with the law.
    """
    figures = ("fit", "bands", "loops", "ranking")
    names = [f"{name}{end}" for name in figures for end in (".png", ".svg")]
    results_folder(out, ("fit.yaml", "muscle.yaml", "recipe.yaml", "data.nc", "results.json", "fits", *names), force)
    from mckibben.study.inputs import law_type_named

    law_type = law_type_named(law) if law != _ALL else None
    if (friction_form or no_drift) and not hysteresis:
        raise ParameterError("--friction and --no-drift apply to --hysteresis", remedy="add --hysteresis")
    if law_type is None and (profile or bootstrap or hysteresis or level != _LEVEL):
        raise ParameterError(
            "--level, --profile, --bootstrap and --hysteresis apply to a single law",
            remedy="choose one, such as --law exponential",
        )
    form = _friction_form(friction_form) if friction_form else None
    inner = _Inner(_positive("--diameter", diameter, "m"), _positive("--fill", fill, "m^3"))
    if any(inner) and not out:
        raise ParameterError("--diameter and --fill apply to muscle.yaml", remedy="add --out DIR")
    how = recipe_of(recipe, column, initial_length, displacement, zero_length, slack_force, force_sign, decimal)
    points = read_data(data, how, skip_corrupt=skip_corrupt)
    inner.check(points.table.attrs.get("initial_length"))
    if law_type is None:
        _rank(data, points, how, inner, json, out)
        return
    from mckibben.identification import identify as run
    from mckibben.identification import identify_hysteresis
    from mckibben.identification.reporting import UncertaintyReport, fit_numbers, hysteresis_numbers

    friction = identify_hysteresis(law_type, points, drift=not no_drift, form=form) if hysteresis else None
    static = friction.corrected(points) if friction else points
    fit = run(law_type, static)
    uncertainty = UncertaintyReport.of(fit, level=level, profiles=profile, refits=bootstrap)
    notes = points.table.attrs.get("preprocessing", "").splitlines()
    numbers = {**fit_numbers(fit), "preprocessing": notes, "uncertainty": uncertainty.records()}
    if friction:
        numbers["hysteresis"] = hysteresis_numbers(friction)
    texts = [friction.report() + "\n\nForce law of the points corrected for friction and drift:\n" if friction else ""]
    texts += [fit.report(level), uncertainty.describe()]
    drawn, kept = {}, ""
    if out:
        from mckibben import report

        with keeping(out):
            fit.to_yaml(out / "fit.yaml")
            kept = _keep_muscle(out, data, points, fit, inner, friction.friction if friction else None)
            how.to_yaml(out / "recipe.yaml")
            points.to_netcdf(out / "data.nc")
            write_json(out / "results.json", numbers)
            drawn = {"fit": report.isobaric(static, fit), "bands": report.force_bands(static, fit, level=level)}
            drawn |= {f"profile-{one.name}": report.profile_likelihood(one, fit) for one in uncertainty.profiles}
            drawn |= {"loops": report.loops(points, friction)} if friction else {}
            for name, figure in drawn.items():
                report.save(figure, out, name)
    echo(to_json(numbers) if json else on_command_line("\n".join(filter(None, texts))))
    if out:
        figures = ", ".join(drawn)
        notify(f"wrote fit.yaml, recipe.yaml, data.nc, results.json, {figures} (.png, .svg) to {out}; {kept}", json)


class _Inner(NamedTuple):
    """Inner diameter [m] and measured volume [m^3] of a muscle at contraction 0, None if they are not given."""

    diameter: float | None
    fill: float | None

    def check(self, length: float | None) -> None:
        """Raise a `ParameterError` for a diameter above the initial length [m]."""
        if self.diameter is not None and length and self.diameter > length:
            raise ParameterError(
                f"--diameter is {show(self.diameter, 'mm')}, more than the initial length, {show(length, 'mm')}",
                value=self.diameter,
                upper=length,
                unit="m",
                remedy="check both, such as --diameter '10 mm' --initial-length '200 mm'",
            )


def _positive(option: str, text: str, unit: str) -> float | None:
    """Value of an option in SI units, None if it was not given."""
    value = parse_optional_quantity(option, text, unit)
    if value is not None and not 0 < value < math.inf:
        raise ParameterError(
            f"{option} {text!r} is not above 0", value=value, unit=unit, remedy="give a positive value"
        )
    return value


def _keep_muscle(
    out: Path,
    data: list[str],
    points: IsobaricDataset,
    fit: Fit,
    inner: _Inner,
    friction: MaxwellSlip | None = None,
) -> str:
    """Write the muscle file next to its fit; return a note on what was written, or why not."""
    from mckibben.muscle.air import volume_terms
    from mckibben.scenario import muscle_text

    attrs = points.table.attrs
    name, length = attrs["specimen"] or Path(data[0]).stem, attrs.get("initial_length")
    volume = inner.fill
    if volume is None and inner.diameter is not None and length:
        volume = math.pi / 4 * inner.diameter**2 * length
    terms = volume_terms(fit.law, length, volume) if length and volume is not None else None
    text = muscle_text("fit.yaml", specimen=name, initial_length=length, friction=friction, volume_terms=terms)
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


def validate(
    law: Annotated[str, Argument(metavar="LAW", help="A fit file, a law from the catalog, or 'chou'.")],
    data: Data,
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid angle and diameter 'chou' uses.")] = "",
    initial_length: InitialLength = "",
    displacement: Displacement = "",
    zero_length: ZeroLength = "",
    slack_force: SlackForce = "",
    force_sign: ForceSign = None,
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    decimal: Decimal = "",
    recipe: RecipeFile = None,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Validate a force law with measured points: errors by pressure and direction."""
    results_folder(out, ("results.json",), force)
    from mckibben.study.inputs import law_named

    known = law_named(law, specimen=specimen)
    how = recipe_of(recipe, column, initial_length, displacement, zero_length, slack_force, force_sign, decimal)
    points = read_data(data, how, skip_corrupt=skip_corrupt)
    from mckibben.identification import validate as run

    validation = run({Path(law).name if Path(law).is_absolute() else law: known}, points)
    numbers = {"slack": validation.slack, "errors": validation.records()}
    if out:
        with keeping(out):
            write_json(out / "results.json", numbers)
    echo(to_json(numbers) if json else validation.report())
    if out:
        notify(f"wrote results.json to {out}", json)


def _rank(data: list[str], points: IsobaricDataset, how: Recipe, inner: _Inner, json: bool, out: Path | None) -> None:
    from mckibben.identification import rank

    with progress() as report_progress:
        ranking = rank(points, progress=report_progress)
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
    for one in ranking.outliers:
        echo(f"left out, as it contradicts the points around it: {one}")
    for name, reason in ranking.missing.items():
        echo(f"no cross-validation over {name}s: {reason}")
    if not ranking.blocks:
        echo("no block of points could be held out: ranked by AICc")
    for entry in ranking.entries:
        for what, texts in (("not fitted", [entry.refused]), ("flagged", entry.flags), ("note on", entry.remarks)):
            if any(texts):
                echo(f"{what} {_short(entry)}: {'; '.join(texts)}")
    best, first = ranking.best, ranking.entries[0]
    if best is not first:
        echo(f"selected: {_short(best)}; {_short(first)} is flagged and not substantially better")


def _short(entry: RankedLaw) -> str:
    return entry.law.removesuffix("Law")
