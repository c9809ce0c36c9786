"""Start of the local server."""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import Callable

from nicegui import app, background_tasks, ui
from nicegui.server import Server
from starlette.middleware.trustedhost import TrustedHostMiddleware

from mckibben.errors import ParameterError
from mckibben.web import identify, joint, rig, run
from mckibben.web.security import LOCAL, Guard
from mckibben.web.session import collect_warnings

HOST = LOCAL[0]


def pages() -> None:
    """Register the pages."""
    collect_warnings()
    ui.page("/")(joint.page)
    ui.page("/identify")(identify.page)
    ui.page("/run")(run.page)
    ui.page("/rig")(rig.page)


def start(port: int, *, show: bool, ready: Callable[[str], None]) -> None:
    """Serve the pages on this machine until Ctrl-C.

    Parameters
    ----------
    port
        Port of the address.
    show
        Whether to open a browser.
    ready
        Called with the address as soon as it answers.

    Raises
    ------
    ParameterError
        If the port is taken.
    """
    _check_free(port)
    pages()
    app.add_middleware(Guard)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOCAL))

    async def announce() -> None:
        while not Server.instance.started:
            await asyncio.sleep(0.01)
        ready(f"http://{HOST}:{port}")

    app.on_startup(lambda: background_tasks.create(announce(), name="announce"))
    ui.run(
        host=HOST,
        port=port,
        show=show,
        reload=False,
        title="mckibben",
        storage_secret=secrets.token_urlsafe(32),  # of this server alone: cookies of an earlier one are void
        show_welcome_message=False,
    )


def _check_free(port: int) -> None:
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((HOST, port))
        except OSError as error:
            raise ParameterError(
                f"port {port} of {HOST}: {error.strerror}", value=port, remedy="choose another with --port"
            ) from None
