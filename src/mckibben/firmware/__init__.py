"""Firmware of a joint: its controller, its parts, and the serial protocol."""

from __future__ import annotations

from typing import ClassVar

import mckibben
from mckibben.codegen import templates
from mckibben.config.model import DocumentModel
from mckibben.containment.limits import Limits
from mckibben.serial_protocol import LONGEST, VERSION, CommandSource, FaultCode, FirmwareState, MessageKind


class Hardware(DocumentModel):
    """A file of hardware.

    Attributes
    ----------
    limits
        Limits of the samples of the controller.
    single
        Whether the numbers of the controller have 32 bits, for processors without a 64-bit unit.
    """

    kind: ClassVar[str] = "hardware file"

    limits: Limits = Limits()
    single: bool = False


_ENUMS = {"KIND": MessageKind, "STATE": FirmwareState, "CODE": FaultCode, "SOURCE": CommandSource}
"""Enumerations of the protocol by their prefixes in C."""


def link_files() -> dict[str, str]:
    """Codec of the serial protocol as C99."""
    enums = [{"prefix": prefix, "members": list(members)} for prefix, members in _ENUMS.items()]
    values = {"version": mckibben.__version__, "protocol": VERSION, "longest": LONGEST, "enums": enums}
    return {name: templates.filled(name, values, "mckibben.firmware") for name in ("link.h", "link.c")}
