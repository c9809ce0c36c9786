"""`mckibben check`: the contract of user-defined classes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mckibben.cli.command import command
from mckibben.errors import ParameterError

if TYPE_CHECKING:
    from mckibben.contract import ContractReport


@command
def check(
    module: str,
    with_: list[str] | None = None,
) -> ContractReport:
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
    values = {}
    for text in with_ or []:
        name, equals, value = text.partition("=")
        if not equals:
            raise ParameterError(f"--with {text!r} is not NAME=VALUE", value=text, remedy="write 'rate=20 bar/s'")
        values[name.strip()] = value.strip()
    from mckibben.contract import ContractReport, check_extension

    return ContractReport(module, tuple(check_extension(module, values)))
