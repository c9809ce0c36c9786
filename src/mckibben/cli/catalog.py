"""`mckibben catalog`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mckibben.cli.command import command

if TYPE_CHECKING:
    from mckibben.catalog.overview import Overview


@command
def catalog() -> Overview:
    """List the force laws, published parameters, specimens, datasets and valves."""
    from mckibben.catalog.overview import Overview

    return Overview()
