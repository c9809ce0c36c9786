"""Request filter of the server: only its own pages, in a browser that was given the token, and limited size.

It stands against pages of other sites (cross-site requests, DNS rebinding, framing), other users of the machine, and
uploads that would fill the memory. It is no protection against programs of the same user.
"""

from __future__ import annotations

import secrets
from urllib.parse import parse_qs, quote, urlencode, urlsplit

from python_multipart.exceptions import FormParserError
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, cookie_parser
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOCAL = ("127.0.0.1", "localhost")
LARGEST = 32 * 2**20
"""Bytes of an upload."""

_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; font-src 'self' data:; object-src 'none'; base-uri 'self'; "
    "form-action 'self'; frame-ancestors 'none'"
)


_NO_ACCESS = (
    "this browser has no access to the page.\n\nOpen the address that `mckibben web` printed in its terminal, with its "
    "token: http://.../?token=...\nEach start of the server has a new token. Links on other pages work only with it."
)


class _TooLargeError(Exception):
    """A request body is too long."""


class Access:
    """Who may use the server: browsers that once opened its address with the token, by a cookie.

    `once` is a second token, for the address that a browser is started with: other users see it in the list of
    processes, so it is void after its first use.
    """

    def __init__(self, port: int) -> None:
        self.token, self.once = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        self.cookie = f"mckibben-{port}"  # browsers send a cookie to every port of a host
        self._value = secrets.token_urlsafe(32)

    def holds(self, headers: Headers) -> bool:
        """Whether a request has the cookie."""
        return _equal(cookie_parser(headers.get("cookie", "")).get(self.cookie, ""), self._value)

    def admit(self, scope: Scope, headers: Headers) -> Response | None:
        """Answer to an address with the token: the cookie, and the same address without it; None to others.

        Parameters
        ----------
        scope, headers
            Request, as of ASGI, and its headers.
        """
        if scope["type"] != "http" or scope["method"] != "GET":
            return None
        query = parse_qs(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        token = query.pop("token", [""])[0]
        if not (navigates(headers) and (_equal(token, self.token) or _equal(token, self.once))):
            return None
        if _equal(token, self.once):
            self.once = ""
        where = "/" + quote(scope["path"].lstrip("/\\")) + ("?" + urlencode(query, doseq=True) if query else "")
        if foreign(headers):  # a redirect would still count as the other site's, and go without the cookie
            answer = HTMLResponse(headers={"Refresh": f"0; url={where}"})
        else:
            answer = RedirectResponse(where, 303)
        answer.headers["Cache-Control"] = "no-store"
        answer.set_cookie(self.cookie, self._value, httponly=True, samesite="strict")
        return answer


def _equal(sent: str, expected: str) -> bool:
    """Whether a secret was given, compared in constant time."""
    return bool(expected) and secrets.compare_digest(sent.encode(), expected.encode())


def foreign(headers: Headers) -> bool:
    """Whether a page of another site, or of another port, is the cause of a request."""
    return headers.get("sec-fetch-site") in ("cross-site", "same-site")


def navigates(headers: Headers) -> bool:
    """Whether a request opens a page, unlike an image or a frame; old browsers do not say."""
    mode, target = headers.get("sec-fetch-mode", "navigate"), headers.get("sec-fetch-dest", "document")
    return (mode, target) == ("navigate", "document")


class Guard:
    """Refuses other sites, requests without access and oversized bodies; pages cannot load external content.

    It stands in front of all routes, also of NiceGUI's websocket and uploads: answers are 403 without access, 413 for a
    body of more than `largest` bytes, and 400 for an upload that is not a form.

    Parameters
    ----------
    app
        Application behind it.
    access
        Who may use it.
    largest
        Largest body [bytes].
    """

    def __init__(self, app: ASGIApp, access: Access, largest: int = LARGEST) -> None:
        self._app, self._access, self._largest = app, access, largest

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
        if (admitted := self._access.admit(scope, headers)) is not None:
            await admitted(scope, receive, send)
            return
        if foreign(headers) or not self._access.holds(headers):
            await _refuse(scope, receive, send, 403, _NO_ACCESS)
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
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = _POLICY
                headers["X-Content-Type-Options"] = "nosniff"
                headers["Referrer-Policy"] = "no-referrer"
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
