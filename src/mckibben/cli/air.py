"""`mckibben identify-air`: heat to the wall, leak and dead volume of a muscle from tests with a shut valve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mckibben.cli.options import (
    Column,
    Decimal,
    Force,
    InitialLength,
    Json,
    Out,
    echo,
    keeping,
    notify,
    parse_columns,
    parse_optional_quantity,
    parse_quantity,
    report_reading,
    results_folder,
)
from mckibben.storage.files import to_json, write_json


def identify_air(
    recordings: Annotated[list[Path], Argument(metavar="RECORDING...", help="Files of pressure over time.")],
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid gives the volume.")],
    contraction: Annotated[
        str, Option(metavar="RATIO", help="Contraction, such as '10 %', if no column gives it.")
    ] = "",
    dead_volume: Annotated[
        str, Option(metavar="VOLUME", help="Volume of tube and fittings up to the valve, if tests are at one length.")
    ] = "0 cm^3",
    initial_length: InitialLength = "",
    column: Column = None,
    decimal: Decimal = "",
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Identify heat to the wall, leak and dead volume: fill a muscle fast, shut the valve, watch; vent, shut, watch."""
    results_folder(out, ("results.json",), force)
    from mckibben.calibration import identify_air as run
    from mckibben.dataset import read_recording
    from mckibben.study.inputs import specimen_named

    read = [
        read_recording(
            path,
            columns=parse_columns(column),
            initial_length=parse_optional_quantity("--initial-length", initial_length, "m"),
            decimal=decimal,  # type: ignore[arg-type]  # checked by the reader
        )
        for path in recordings
    ]
    found = run(
        read,
        specimen_named(specimen),
        contraction=parse_optional_quantity("--contraction", contraction, "1"),
        dead_volume=parse_quantity("--dead-volume", dead_volume, "m^3"),
    )
    if out:
        with keeping(out):
            write_json(out / "results.json", found.records())
    for one in read:
        report_reading(one.table.attrs)
    echo(to_json(found.records()) if json else found.report())
    if out:
        notify(f"wrote results.json to {out}", json)
