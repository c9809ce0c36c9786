"""`mckibben check`: the contract of user-defined classes."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import typer
from typer import Argument, Option

from mckibben.cli.options import Json, echo, table
from mckibben.errors import ParameterError
from mckibben.storage.files import to_json

_RESULTS = {True: "passed", False: "FAILED", None: "not checked"}


def check(
    module: Annotated[str, Argument(metavar="FILE.py|MODULE", help="Module with the classes, which is executed.")],
    given: Annotated[
        list[str] | None,
        Option("--with", metavar="'NAME=VALUE'", help="Value of a field as in a file, such as 'rate=20 bar/s'."),
    ] = None,
    json: Json = False,
) -> None:
    """Check user-defined classes: units, files, batches, derivatives, emitted C, and the promises of their bases.

    Instances at the top level of the module are checked; a class without one is made from the defaults of its fields
    and --with. Exit codes: 0 all passed, 1 a check failed, 2 bad input.
    """
    fields = {}
    for text in given or []:
        name, equals, value = text.partition("=")
        if not equals:
            raise ParameterError(f"--with {text!r} is not NAME=VALUE", value=text, remedy="write 'rate=20 bar/s'")
        fields[name.strip()] = value.strip()
    from mckibben.contract import check_extension

    findings = check_extension(module, fields)
    failed = [one for one in findings if one.passed is False]
    if json:
        echo(to_json({"passed": not failed, "findings": [dataclasses.asdict(one) for one in findings]}))
    else:
        rows = [(one.kind, one.check, _RESULTS[one.passed], one.found) for one in findings]
        table(f"Contract of {module}", ("class", "check", "result", "found"), rows)
        for one in failed:
            echo(f"{one.kind}, {one.check}: {one.found}" + (f"; {one.remedy}" if one.remedy else ""))
        classes = len({one.kind for one in findings})
        echo(f"{len(failed)} of {len(findings)} checks of {classes} classes failed" if failed else "all checks passed")
    if failed:
        raise typer.Exit(1)
