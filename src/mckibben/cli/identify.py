"""`mckibben identify` and `mckibben validate`: laws from measured points, and laws against them."""

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
    measured,
    progress,
    said,
    table,
)
from mckibben.errors import ParameterError
from mckibben.storage.files import make_folder

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset
    from mckibben.identification import Ranked, Ranking

_ALL, _LEVEL = "all", 0.95


def identify(
    data: Data,
    law: Annotated[
        str, typer.Option(help="Which law, such as exponential (Eq. 2); 'mckibben laws' lists them. all: rank them.")
    ] = "exponential",
    level: Annotated[float, typer.Option(help="Of the intervals: the share that holds the truth.")] = _LEVEL,
    profile: Annotated[
        bool, typer.Option("--profile", help="Profile the shape parameters: are they determined?")
    ] = False,
    bootstrap: Annotated[int, typer.Option(metavar="N", help="Refit N times to blocks of points drawn anew.")] = 0,
    hysteresis: Annotated[
        bool, typer.Option("--hysteresis", help="Find friction and sensor drift with the law, from both directions.")
    ] = False,
    initial_length: InitialLength = "",
    slack_force: SlackForce = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    json: Json = False,
    out: Out = None,
) -> None:
    """Fit a force law to measured points: estimates with standard errors, and errors at unseen pressures.

    With --law all every law is fitted, and they are ranked by their errors at whole pressures, directions and repeats
    left out. With --hysteresis the friction between loading and unloading is found with the law.
    """
    if out:
        make_folder(out)
    from mckibben.study.inputs import law_type_named

    law_type = law_type_named(law) if law != _ALL else None
    points = measured(data, column, initial_length, slack_force, skip_corrupt=skip_corrupt)
    if law_type is None:
        if profile or bootstrap or hysteresis or level != _LEVEL:
            raise ParameterError(
                "--level, --profile, --bootstrap and --hysteresis are about one law",
                remedy="name it, such as --law exponential",
            )
        _rank(points, json, out)
        return
    from mckibben.identification import identify as run
    from mckibben.identification import identify_hysteresis
    from mckibben.study.reporting import (
        fit_numbers,
        further,
        further_report,
        hysteresis_numbers,
        interval_numbers,
        to_json,
        write_json,
    )

    way = identify_hysteresis(law_type, points) if hysteresis else None
    static = way.corrected(points) if way else points
    fit = run(law_type, static)
    found = further(fit, level=level, profiles=profile, refits=bootstrap)
    numbers = {**fit_numbers(fit), "uncertainty": interval_numbers(fit, found)}
    if way:
        numbers["hysteresis"] = hysteresis_numbers(way)
    texts = [way.report() + "\n\nThe law, of the points without friction and drift:\n" if way else ""]
    texts += [fit.report(level), further_report(fit, found)]
    typer.echo(to_json(numbers) if json else "\n".join(filter(None, texts)))
    if out:
        from mckibben import report

        fit.to_yaml(out / "fit.yaml")
        points.to_netcdf(out / "data.nc")
        write_json(out / "results.json", numbers)
        figures = {"fit": report.isobaric(static, fit), "bands": report.force_bands(static, fit, level=level)}
        figures |= {f"profile-{one.name}": report.profile_likelihood(one, fit) for one in found.profiles}
        figures |= {"loops": report.loops(points, way)} if way else {}
        for name, figure in figures.items():
            report.save(figure, out, name)
        said(f"kept fit.yaml, data.nc, results.json and {', '.join(figures)} as .png and .svg in {out}", json)


def validate(
    law: Annotated[str, typer.Argument(metavar="LAW", help="A fit file, a law of the catalog, or 'chou'.")],
    data: Data,
    specimen: Annotated[str, typer.Option(help="Whose braid angle and diameter 'chou' takes.")] = "",
    initial_length: InitialLength = "",
    slack_force: SlackForce = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    json: Json = False,
    out: Out = None,
) -> None:
    """Hold a force law against measured points: errors by pressure and direction."""
    if out:
        make_folder(out)
    from mckibben.study.inputs import law_named

    known = law_named(law, specimen=specimen)
    points = measured(data, column, initial_length, slack_force, skip_corrupt=skip_corrupt)
    from mckibben.identification import validate as run
    from mckibben.study.reporting import to_json, write_json

    validation = run({law: known}, points)
    numbers = {"slack": validation.slack, "errors": validation.records()}
    typer.echo(to_json(numbers) if json else validation.report())
    if out:
        write_json(out / "results.json", numbers)
        said(f"kept results.json in {out}", json)


def _rank(points: IsobaricDataset, json: bool, out: Path | None) -> None:
    from mckibben.identification import rank
    from mckibben.study.reporting import to_json, write_json

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
        said(f"kept fit.yaml ({best.law}), fits/, data.nc, results.json, ranking.png and fit.png in {out}", json)


def _show(ranking: Ranking) -> None:
    specimen = ranking.points.table.attrs["specimen"] or "unnamed specimen"
    fitted = [entry for entry in ranking.entries if entry.fit]
    least = min((entry.aicc for entry in fitted if entry.aicc == entry.aicc), default=0.0)
    headers = (
        "law",
        "numbers",
        "RMSE N",
        *(f"unseen {name}s N" for name in ranking.blocks),
        "AICc",
        "pattern left along",
    )
    rows = [
        (
            _short(entry),
            str(entry.parameters),
            f"{entry.fit.rmse:.2f}" if entry.fit else "-",
            *(f"{entry.unseen[name].rmse:.2f}" if name in entry.unseen else "-" for name in ranking.blocks),
            f"+{entry.aicc - least:.1f}" if entry.aicc == entry.aicc else "-",
            (entry.structure.pattern if entry.structure else "") or "-",
        )
        for entry in fitted
    ]
    table(f"{specimen}: {len(ranking.points)} taut points, {ranking.slack} slack left out", headers, rows)
    for name, reason in ranking.missing.items():
        typer.echo(f"no error at unseen {name}s: {reason}")
    if not ranking.blocks:
        typer.echo("no block of points could be held out: ranked by AICc, which says nothing of unseen points")
    for entry in ranking.entries:
        _remark(entry)
    best, first = ranking.best, ranking.entries[0]
    if best is not first:
        typer.echo(f"taken for the best: {_short(best)}, since {_short(first)} is flagged and hardly better")


def _remark(entry: Ranked) -> None:
    for what, texts in (("refused", [entry.refused]), ("flagged", entry.flags), ("remark on", entry.remarks)):
        if any(texts):
            typer.echo(f"{what} {_short(entry)}: {'; '.join(texts)}")


def _short(entry: Ranked) -> str:
    return entry.law.removesuffix("Law")
