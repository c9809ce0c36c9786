"""Start of the local server."""

from __future__ import annotations

import asyncio
import gc
import importlib
import secrets
import socket
import sys
from collections.abc import Callable

from fastapi.dependencies import models
from nicegui import app, background_tasks, binding, ui
from nicegui.server import Server
from starlette.middleware.sessions import SessionMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware

from mckibben.errors import ParameterError
from mckibben.storage.files import handle_signals
from mckibben.web import identify, joint, rig, robot, run, tune
from mckibben.web import start as start_page
from mckibben.web.layout import PAGES
from mckibben.web.security import LOCAL, Access, Guard
from mckibben.web.session import collect_warnings, end_sessions, share_heaps

HOST = LOCAL[0]


def pages() -> None:
    """Register the pages."""
    collect_warnings()
    app.on_delete(forget_routes)
    for path, module in zip(PAGES, (start_page, identify, joint, run, tune, rig, robot), strict=True):
        ui.page(path)(module.page)
    ui.page(run.MOVING)(run.moving)


def forget_routes() -> None:
    """Clear FastAPI's caches, which keep the functions of removed routes, and with them uploads and their pages."""
    for cache in vars(models).values():
        if callable(clear := getattr(cache, "cache_clear", None)):
            clear()


def start(port: int, *, show: bool, ready: Callable[[str], None]) -> None:
    """Serve the pages on this machine until Ctrl-C, to browsers that open the address with its token.

    Parameters
    ----------
    port
        Port of the address.
    show
        Whether to open a browser.
    ready
        Called with the address and its token as soon as it answers.

    Raises
    ------
    ParameterError
        If the port is taken.
    """
    _check_free(port)
    share_heaps()
    pages()
    binding.MAX_PROPAGATION_TIME = float("inf")  # on a busy machine it would remark on each step of the page
    gc.set_threshold(700, 10, 10)  # Python's own: a page that was left is a cycle, and the command line collects rarely
    access, secret, signals = Access(port), secrets.token_urlsafe(32), []
    # the last one is called first; NiceGUI adds its own behind these
    app.add_middleware(SessionMiddleware, secret, f"mckibben-session-{port}", max_age=None, same_site="strict")
    app.add_middleware(Guard, access)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOCAL))

    async def announce() -> None:
        while not Server.instance.started:
            await asyncio.sleep(0.01)
        ready(f"http://{HOST}:{port}/?token={access.token}")
        await asyncio.to_thread(importlib.import_module, "xarray")  # seconds that the first file would wait for

    def stop(number: int) -> None:
        signals.append(number)
        Server.instance.handle_exit(number, None)

    app.on_startup(lambda: background_tasks.create(announce(), name="announce"))
    app.on_shutdown(end_sessions)
    with handle_signals(stop):  # a closed terminal too, which would otherwise leave the files of sessions
        ui.run(
            host=HOST,
            port=port,
            show=f"/?token={access.once}" if show else False,
            reload=False,
            title="mckibben",
            storage_secret=secret,  # of this server alone: cookies of an earlier one are void
            show_welcome_message=False,
            timeout_graceful_shutdown=2,  # s for open requests
            reconnect_timeout=20,  # s, as compiling may hold the server up for seconds
        )
    if signals:
        sys.exit(128 + signals[0])


def _check_free(port: int) -> None:
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((HOST, port))
        except OSError as error:
            raise ParameterError(
                f"port {port} of {HOST}: {error.strerror}", value=port, remedy="choose another with --port"
            ) from None
