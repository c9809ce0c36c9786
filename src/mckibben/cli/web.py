"""`mckibben web`: the local page."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from mckibben.cli.options import echo
from mckibben.errors import ParameterError


def web(
    port: Annotated[int, Option(min=1, max=65535, help="Port of the address.")] = 8080,
    no_browser: Annotated[bool, Option("--no-browser", help="Open no browser.")] = False,
) -> None:
    """Serve a page on this machine: identify a muscle, design a joint, run it."""
    try:
        import nicegui  # noqa: F401
    except ImportError as error:
        raise ParameterError("NiceGUI is not installed", remedy="install it: pip install 'mckibben[web]'") from error
    from mckibben.web.app import start

    start(port, show=not no_browser, ready=lambda address: echo(f"{address} (Ctrl-C ends it)"))
