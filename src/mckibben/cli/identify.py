"""`mckibben identify` and `mckibben validate`: force laws from measured points, and their validation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.cli.options import (
    Column,
    Data,
    InitialLength,
    Json,
    Out,
    SkipCorrupt,
    SlackForce,
    notify,
    progress,
    read_data,
    table,
)
from mckibben.errors import ParameterError
from mckibben.storage.files import make_folder

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset
    from mckibben.identification import RankedLaw, Ranking

_ALL, _LEVEL = "all", 0.95


def identify(
    data: Data,
    law: Annotated[
        str, typer.Option(help="Force law, such as exponential (Eq. 2); 'mckibben laws' lists them; 'all' ranks them.")
    ] = "exponential",
    level: Annotated[float, typer.Option(help="Confidence level of the intervals.")] = _LEVEL,
    profile: Annotated[bool, typer.Option("--profile", help="Profile likelihood of the shape parameters.")] = False,
    bootstrap: Annotated[int, typer.Option(metavar="N", help="Block bootstrap with N resamples.")] = 0,
    hysteresis: Annotated[
        bool,
        typer.Option("--hysteresis", help="Identify friction and sensor drift with the law."),
    ] = False,
    initial_length: InitialLength = "",
    slack_force: SlackForce = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    json: Json = False,
    out: Out = None,
) -> None:
    """Fit a force law to measured points: estimates with standard errors, and cross-validation errors.

    With --law all every law is fitted, and they are ranked by cross-validation over pressures, directions and repeats.
    With --hysteresis the friction between loading and unloading is identified with the law.
    """
    if out:
        make_folder(out)
    from mckibben.study.inputs import law_type_named

    law_type = law_type_named(law) if law != _ALL else None
    points = read_data(data, column, initial_length, slack_force, skip_corrupt=skip_corrupt)
    if law_type is None:
        if profile or bootstrap or hysteresis or level != _LEVEL:
            raise ParameterError(
                "--level, --profile, --bootstrap and --hysteresis apply to a single law",
                remedy="choose one, such as --law exponential",
            )
        _rank(points, json, out)
        return
    from mckibben.identification import identify as run
    from mckibben.identification import identify_hysteresis
    from mckibben.identification.reporting import UncertaintyReport, fit_numbers, hysteresis_numbers
    from mckibben.storage.files import to_json, write_json

    friction = identify_hysteresis(law_type, points) if hysteresis else None
    static = friction.corrected(points) if friction else points
    fit = run(law_type, static)
    uncertainty = UncertaintyReport.of(fit, level=level, profiles=profile, refits=bootstrap)
    numbers = {**fit_numbers(fit), "uncertainty": uncertainty.records()}
    if friction:
        numbers["hysteresis"] = hysteresis_numbers(friction)
    texts = [friction.report() + "\n\nForce law of the points corrected for friction and drift:\n" if friction else ""]
    texts += [fit.report(level), uncertainty.describe()]
    typer.echo(to_json(numbers) if json else "\n".join(filter(None, texts)))
    if out:
        from mckibben import report

        fit.to_yaml(out / "fit.yaml")
        points.to_netcdf(out / "data.nc")
        write_json(out / "results.json", numbers)
        figures = {"fit": report.isobaric(static, fit), "bands": report.force_bands(static, fit, level=level)}
        figures |= {f"profile-{one.name}": report.profile_likelihood(one, fit) for one in uncertainty.profiles}
        figures |= {"loops": report.loops(points, friction)} if friction else {}
        for name, figure in figures.items():
            report.save(figure, out, name)
        notify(f"wrote fit.yaml, data.nc, results.json and {', '.join(figures)} as .png and .svg to {out}", json)


def validate(
    law: Annotated[str, typer.Argument(metavar="LAW", help="A fit file, a law of the catalog, or 'chou'.")],
    data: Data,
    specimen: Annotated[str, typer.Option(help="Specimen whose braid angle and diameter 'chou' uses.")] = "",
    initial_length: InitialLength = "",
    slack_force: SlackForce = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    json: Json = False,
    out: Out = None,
) -> None:
    """Validate a force law with measured points: errors by pressure and direction."""
    if out:
        make_folder(out)
    from mckibben.study.inputs import law_named

    known = law_named(law, specimen=specimen)
    points = read_data(data, column, initial_length, slack_force, skip_corrupt=skip_corrupt)
    from mckibben.identification import validate as run
    from mckibben.storage.files import to_json, write_json

    validation = run({law: known}, points)
    numbers = {"slack": validation.slack, "errors": validation.records()}
    typer.echo(to_json(numbers) if json else validation.report())
    if out:
        write_json(out / "results.json", numbers)
        notify(f"wrote results.json to {out}", json)


def _rank(points: IsobaricDataset, json: bool, out: Path | None) -> None:
    from mckibben.identification import rank
    from mckibben.storage.files import to_json, write_json

    with progress() as report_progress:
        ranking = rank(points, progress=report_progress)
    best = ranking.best
    numbers = {
        "best": best.law,
        "ranked_by": ranking.criterion,
        "points": len(ranking.points),
        "slack": ranking.slack,
        "not_left_out": ranking.missing,
        "laws": ranking.records(),
    }
    if json:
        typer.echo(to_json(numbers))
    else:
        _show(ranking)
    if out:
        from mckibben import report

        for entry in ranking.entries:
            if entry.fit:
                entry.fit.to_yaml(make_folder(out / "fits") / f"{entry.law}.yaml")
        assert best.fit is not None
        best.fit.to_yaml(out / "fit.yaml")
        points.to_netcdf(out / "data.nc")
        write_json(out / "results.json", numbers)
        report.save(report.ranking(ranking), out, "ranking")
        report.save(report.isobaric(points, best.fit), out, "fit")
        notify(f"wrote fit.yaml ({best.law}), fits/, data.nc, results.json, ranking.png and fit.png to {out}", json)


def _show(ranking: Ranking) -> None:
    specimen = ranking.points.table.attrs["specimen"] or "unnamed specimen"
    fitted = [entry for entry in ranking.entries if entry.fit]
    least = min((entry.aicc for entry in fitted if entry.aicc == entry.aicc), default=0.0)
    headers = (
        "law",
        "parameters",
        "RMSE N",
        *(f"held-out {name}s N" for name in ranking.blocks),
        "AICc",
        "residual pattern over",
    )
    rows = [
        (
            _short(entry),
            str(entry.parameters),
            f"{entry.fit.rmse:.2f}" if entry.fit else "-",
            *(
                f"{entry.cross_validation[name].rmse:.2f}" if name in entry.cross_validation else "-"
                for name in ranking.blocks
            ),
            f"+{entry.aicc - least:.1f}" if entry.aicc == entry.aicc else "-",
            (entry.residual_correlation.pattern if entry.residual_correlation else "") or "-",
        )
        for entry in fitted
    ]
    table(f"{specimen}: {len(ranking.points)} taut points, {ranking.slack} slack excluded", headers, rows)
    for name, reason in ranking.missing.items():
        typer.echo(f"no cross-validation over {name}s: {reason}")
    if not ranking.blocks:
        typer.echo("no block of points could be held out: ranked by AICc")
    for entry in ranking.entries:
        _remark(entry)
    best, first = ranking.best, ranking.entries[0]
    if best is not first:
        typer.echo(f"selected: {_short(best)}; {_short(first)} is flagged and not substantially better")


def _remark(entry: RankedLaw) -> None:
    for what, texts in (("not fitted", [entry.refused]), ("flagged", entry.flags), ("note on", entry.remarks)):
        if any(texts):
            typer.echo(f"{what} {_short(entry)}: {'; '.join(texts)}")


def _short(entry: RankedLaw) -> str:
    return entry.law.removesuffix("Law")
