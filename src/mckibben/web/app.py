"""Start of the local server."""

from __future__ import annotations

import asyncio
import contextvars
import ctypes
import gc
import secrets
import socket
import sys
from collections.abc import Callable

from fastapi.dependencies import models
from nicegui import app, background_tasks, ui
from nicegui.server import Server
from starlette.middleware.sessions import SessionMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware

from mckibben.errors import ParameterError
from mckibben.storage.files import handle_signals
from mckibben.web import identify, joint, leg, rig, run, tune
from mckibben.web.security import LOCAL, Access, Guard
from mckibben.web.session import collect_warnings, end_sessions

HOST = LOCAL[0]
_SHUTDOWN = 2  # s for open requests
_M_ARENA_MAX, _M_MMAP_THRESHOLD = -8, -3  # of malloc.h
_MAPPED = 2**17  # bytes of an array with a mapping of its own
_COLLECTED_AFTER = 1.0  # s after a page was left; those left in the meantime are freed with it
_TAB_STORAGE = 60.0  # s that NiceGUI keeps its storage of a tab, which is empty; its default is 30 days


def pages() -> None:
    """Register the pages."""
    collect_warnings()
    app.on_delete(forget_routes)
    app.on_delete(_Collector())
    app.storage.max_tab_storage_age = _TAB_STORAGE
    ui.page("/")(joint.page)
    ui.page("/identify")(identify.page)
    ui.page("/run")(run.page)
    ui.page("/tune")(tune.page)
    ui.page("/rig")(rig.page)
    ui.page("/leg")(leg.page)


def forget_routes() -> None:
    """Clear FastAPI's caches, which keep the functions of removed routes, and with them uploads and their pages."""
    for cache in vars(models).values():
        if callable(clear := getattr(cache, "cache_clear", None)):
            clear()


class _Collector:
    """Frees pages that were left, and returns their memory to the system.

    They are cycles, and Python collects old ones only when a quarter of all objects are new.
    """

    def __init__(self) -> None:
        self._waiting = False

    def __call__(self) -> None:
        if not self._waiting:
            self._waiting = True
            asyncio.get_running_loop().call_later(_COLLECTED_AFTER, self._collect, context=contextvars.Context())

    def _collect(self) -> None:
        self._waiting = False
        gc.collect()
        if trim := _libc("malloc_trim"):
            trim(0)


def _use_one_arena() -> None:
    """Have glibc allocate in one arena: with one per thread, memory that closed pages freed is reused less.

    Arrays keep mappings of their own, which are returned when freed: by default, glibc stops that after the first.
    """
    if mallopt := _libc("mallopt"):
        mallopt(_M_ARENA_MAX, 1)
        mallopt(_M_MMAP_THRESHOLD, _MAPPED)


def _libc(name: str) -> Callable[..., int] | None:
    """A function of glibc; None with another C library."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


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
    pages()
    _use_one_arena()
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
            timeout_graceful_shutdown=_SHUTDOWN,
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
