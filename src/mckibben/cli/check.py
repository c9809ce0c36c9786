"""`mckibben check`: the contract of user-defined classes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mckibben.cli.command import command
from mckibben.cli.options import parse_pairs

if TYPE_CHECKING:
    from mckibben.contract import ContractReport


@command
def check(module: str, with_: list[str] | None = None) -> ContractReport:
    """Check user-defined classes: units, files, batches, derivatives, emitted C, and the promises of their bases.

    Instances at the top level of the module are checked; a class without one is made from the defaults of its fields
    and --with. Exit codes: 0 all passed, 1 a check failed, 2 bad input.

    Parameters
    ----------
    module : FILE.py|MODULE
        Module with the classes, which is executed.
    with_ : 'NAME=VALUE'
        Value of a field as in a file, such as 'rate=20 bar/s'.
    """
    values = parse_pairs("--with", with_, "rate=20 bar/s")
    from mckibben.contract import ContractReport, check_extension

    return ContractReport(module, tuple(check_extension(module, values)))
