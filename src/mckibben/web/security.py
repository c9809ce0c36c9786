"""Request filter of the server: only its own pages on this machine, and limited size."""

from __future__ import annotations

from urllib.parse import urlsplit

from python_multipart.exceptions import FormParserError
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOCAL = ("127.0.0.1", "localhost")
LARGEST = 32 * 2**20
"""Bytes of an upload."""

_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; object-src 'none'; base-uri 'self'; form-action 'self'; "
    "frame-ancestors 'none'"
)


class _TooLargeError(Exception):
    """A request body is too long."""


class Guard:
    """Refuses other origins and oversized bodies; prevents pages from loading external content."""

    def __init__(self, app: ASGIApp, largest: int = LARGEST) -> None:
        self._app, self._largest = app, largest

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a request, or answer it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers, began = Headers(scope=scope), False
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != headers.get("host"):
            await _refuse(scope, receive, send, 403, "another site may not use this page")
            return
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > self._largest:
            await _refuse(scope, receive, send, 413, self._too_large)
            return
        size = 0

        async def limited() -> Message:
            nonlocal size
            message = await receive()
            size += len(message.get("body", b"")) if message["type"] == "http.request" else 0
            if size > self._largest:
                raise _TooLargeError
            return message

        async def marked(message: Message) -> None:
            nonlocal began
            if message["type"] == "http.response.start":
                began = True
                found = MutableHeaders(scope=message)
                found["Content-Security-Policy"] = _POLICY
                found["X-Content-Type-Options"] = "nosniff"
                found["Referrer-Policy"] = "no-referrer"
            await send(message)

        try:
            await self._app(scope, limited, marked)
        except* (ClientDisconnect, FormParserError):  # an aborted upload gets an answer that nobody reads
            if not began:
                await _refuse(scope, receive, send, 400, "the upload is not a form, or is incomplete")
        except* _TooLargeError:
            if not began:
                await _refuse(scope, receive, send, 413, self._too_large)

    @property
    def _too_large(self) -> str:
        return f"larger than {self._largest // 2**20} MiB"


async def _refuse(scope: Scope, receive: Receive, send: Send, code: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send(
            {"type": "websocket.close", "code": 1008, "reason": reason}
        )  # before it is accepted: answered by 403
    else:
        await PlainTextResponse(f"refused: {reason}", code)(scope, receive, send)
