"""Command line: parse, call, print. Heavy imports are inside the commands."""

from __future__ import annotations

import gc
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

import mckibben
from mckibben.cli.compare import compare
from mckibben.cli.identify import identify, points, validate
from mckibben.cli.options import Force, Json, Out, format_metrics, keeping, notify, progress, results_folder, table
from mckibben.cli.plan import envelope, plan
from mckibben.cli.rig import rig
from mckibben.cli.sweep import sweep, tune
from mckibben.errors import McKibbenError, McKibbenWarning
from mckibben.storage.files import make_folder, to_json, write_json
from mckibben.units import mm

if TYPE_CHECKING:
    from mckibben.simulation import Result
    from mckibben.study.scenario import Scenario

app = typer.Typer(
    name="mckibben",
    help="Pneumatic artificial muscles, from the test rig to a controlled joint.",
    epilog="Exit codes: 0 done, 1 failed, 2 bad input.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def reproduce(
    out: Annotated[Path, Option(metavar="DIR", help="Folder of the report.")] = Path("mckibben-report"),
    quick: Annotated[bool, Option("--quick", help="Fewer repeats, seeds and tuning steps.")] = False,
    json: Json = False,
) -> None:
    """Reproduce the paper: test, identification, knee and control, with a report and figures."""
    make_folder(out)  # fails before the computation

    with progress() as report:
        from mckibben.paper import reproduce as run

        done = run(quick=quick, progress=lambda what, part: report(what, 0.8 * part))
        report("writing results", 0.8)
        done.save(out)  # before the figures
        from mckibben.report import write_report

        report("figures and report", 0.85)
        page = write_report(done, out)
        report("done", 1.0)
    if json:
        typer.echo(to_json(done.results()))
        return
    table(
        "The paper's claims",
        ("verdict", "claim", "source"),
        [
            ("holds" if claim.holds else "does not hold", claim.claim, claim.source if claim.of_paper else "(ours)")
            for claim in done.claims
        ],
    )
    typer.echo(f"{done.seconds:.0f} s; evidence and figures in {page}, all numbers in {out / 'results.json'}")


app.command()(points)
app.command()(identify)
app.command()(validate)


@app.command()
def simulate(
    scenario: Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario file; see examples/.")],
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Simulate a scenario: a controller on a joint."""
    results_folder(out, ("result.nc", "results.json", "scenario.yaml", "tracking.png", "tracking.svg"), force)
    from mckibben.study.scenario import Scenario

    read = Scenario.read(scenario)
    from mckibben.simulation.metrics import in_shown_units
    from mckibben.study.scenario.building import run_scenario

    result, feasibility = run_scenario(read, source=str(scenario))
    infeasible = "" if feasibility.feasible else feasibility.describe()
    numbers = {
        "scenario": read.name,
        "outcome": result.outcome.name.lower(),
        "described": result.describe(),
        "infeasible": infeasible,
        "metrics": in_shown_units(result.metrics),
    }
    if out:  # before it is printed: who reads that may have gone
        with keeping(out):
            _keep_run(out, read, result)
            write_json(out / "results.json", numbers)
    if json:
        typer.echo(to_json(numbers))
    else:
        if infeasible:
            typer.echo(f"warning: {infeasible}", err=True)
        table(read.name, ("metric", "value", "unit"), format_metrics(numbers["metrics"]))
        typer.echo(result.describe())
    if out:
        notify(f"wrote result.nc, results.json, scenario.yaml, tracking.png and tracking.svg to {out}", json)
    if result.outcome.failed:
        raise typer.Exit(1)


app.command()(envelope)
app.command()(plan)
app.command()(sweep)
app.command()(tune)
app.command()(compare)
app.add_typer(rig)


@app.command()
def laws(json: Json = False) -> None:
    """List the force laws and the published parameter sets."""
    from mckibben import catalog
    from mckibben.muscle import LAWS

    published = {name: catalog.law(name) for name in catalog.names("laws")}
    if json:
        numbers = {name: {"equation": law.equation, "source": law.source} for name, law in LAWS.items()}
        sets = {name: {"law": type(law).__name__, "domain": str(law.domain)} for name, law in published.items()}
        typer.echo(to_json({"laws": numbers, "published": sets}))
        return
    rows = [(name, law.equation, law.source) for name, law in LAWS.items()]
    table("Laws", ("law", "equation", "source"), rows)
    sets = [(name, type(law).__name__, str(law.domain)) for name, law in published.items()]
    table("Published parameter sets", ("name", "law", "domain"), sets)


@app.command()
def specimens(json: Json = False) -> None:
    """List the specimens and measured datasets of the catalog."""
    from mckibben import catalog

    known = {name: catalog.specimen(name) for name in catalog.names("specimens")}
    data = {name: catalog.cite(name).splitlines()[0] for name in catalog.names("datasets")}
    if json:
        numbers = {
            name: {
                "initial_length_mm": s.initial_length / mm,
                "initial_diameter_mm": s.initial_diameter / mm,
                "rated_force_N": s.rated_force,
                "domain": str(s.domain),
                "source": catalog.cite(name),
            }
            for name, s in known.items()
        }
        typer.echo(to_json({"specimens": numbers, "datasets": data}))
        return
    rows = [
        (name, f"{s.initial_length / mm:g} x {s.initial_diameter / mm:g} mm", f"{s.rated_force:g} N", str(s.domain))
        for name, s in known.items()
    ]
    table("Specimens", ("name", "length x diameter", "rated", "domain"), rows)
    table("Datasets", ("name", "source"), list(data.items()))


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, Option("--version", help="Print the version.")] = False,
    extension: Annotated[
        list[Path] | None,
        Option(metavar="FILE.py", help="Python file with classes of one's own; runs it. Repeat for several."),
    ] = None,
) -> None:
    if version:
        typer.echo(f"mckibben {mckibben.__version__}")
        raise typer.Exit
    for path in extension or ():
        from mckibben.config.schema import load_extension

        load_extension(path)


def main() -> None:
    """Run the command line: exit code 2 with a message for bad input, 1 for other failures."""
    from mckibben.numerics.runtime import use_program_cache

    use_program_cache()
    warnings.showwarning = _show_warning
    try:
        app()
    except (McKibbenError, OSError) as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)
    except Exception as error:
        if os.environ.get("MCKIBBEN_DEBUG"):
            raise
        typer.echo(
            f"failed: {type(error).__name__}: {error}\n"
            "This is a fault of mckibben. Please report it, with what the same command prints under MCKIBBEN_DEBUG=1.",
            err=True,
        )
        sys.exit(1)


def run() -> None:
    """Entry point of the installed command; garbage collection of permanent objects would take 40 % of its time."""
    gc.set_threshold(100_000, 10, 10)
    try:
        main()
    finally:
        gc.freeze()


def _keep_run(out: Path, scenario: Scenario, result: Result) -> None:
    from mckibben import report

    scenario.to_yaml(out / "scenario.yaml")
    result.to_netcdf(out / "result.nc")
    report.save(report.tracking({scenario.name: result}), out, "tracking")


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if issubclass(category, McKibbenWarning):
        typer.echo(f"warning: {message}", err=True)
