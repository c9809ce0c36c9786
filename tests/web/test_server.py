"""The server in a process of its own: whom it answers, how it starts and ends."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import closing, contextmanager
from functools import partial

import pytest

pytest.importorskip("nicegui")
from starlette.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from mckibben.web import layout
from mckibben.web.security import LARGEST, Access

pytestmark = pytest.mark.slow

OUTSIDE = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it
TO_PAGE = {"Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "document"}


def command(port):
    return [sys.executable, "-m", "mckibben", "web", "--no-browser", "--port", str(port)]


@contextmanager
def running(**environment):
    """A server, and the address that it prints; it is killed in the end, if it still runs."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        free = one.getsockname()[1]
    with subprocess.Popen(
        command(free),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=OUTSIDE | environment,
        preexec_fn=partial(signal.signal, signal.SIGHUP, signal.SIG_DFL),  # nohup ignores it, and that is inherited
    ) as process:
        try:
            found = re.match(rf"(http://127\.0\.0\.1:{free}/)\?token=(\S{{40,}}) ", process.stdout.readline())
            assert found, process.stderr.read()
            yield process, Site(free, found[2])
        finally:
            process.kill()


class Site:
    """Requests to a server; `cookie` is that of a browser that opened the address with the token."""

    def __init__(self, port, token):
        self.port, self.token, self.cookie = port, token, ""
        self.cookie = self.login()[0].headers["Set-Cookie"].split(";")[0]
        self.socket = f"ws://127.0.0.1:{port}/_nicegui_ws/socket.io/?EIO=4&transport=websocket"

    def login(self, path="/", **headers):
        """Answer to the address with the token."""
        return self.ask(f"{path}?token={self.token}", Cookie="", **headers)

    def ask(self, path="/", *, method="GET", body=None, **headers):
        """Answer to a request, with the cookie unless another is given."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)) as line:
            sent = {name.replace("_", "-"): value for name, value in {"Cookie": self.cookie, **headers}.items()}
            line.request(method, path, body, sent, encode_chunked="Transfer_Encoding" in headers)
            answer = line.getresponse()
            return answer, answer.read().decode(errors="replace")

    def upload(self):
        """Path for uploads of a new visit."""
        return re.search(r"/_nicegui/client/[0-9a-f-]{36}/upload/\d+", self.ask("/identify")[1])[0]


@pytest.fixture(scope="module")
def site():
    """A server; in the end Ctrl-C ends it, and it has printed its address and no traceback."""
    with running() as (process, found):
        yield found
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
        assert out == "" and "Traceback" not in err, err
        assert process.returncode == 130


def test_it_answers_on_this_machine_and_loads_nothing_from_others(site):
    for path in ("/", "/identify", "/run", "/tune", "/rig", "/leg"):
        answer, text = site.ask(path)
        assert answer.status == 200
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert not re.search(r"(src|href)=[\"'](https?:)?//", text)


@pytest.mark.parametrize("host", ["example.com", "127.0.0.1.example.com", "example.com:80", "10.0.0.1"])
def test_a_foreign_host_is_refused(site, host):
    answer, text = site.ask(Host=host)
    assert answer.status == 400
    assert "Traceback" not in text and "host" in text.lower()


@pytest.mark.parametrize("origin", ["http://example.com", "null", "http://127.0.0.1:1", "https://localhost"])
def test_a_foreign_origin_is_refused(site, origin):
    answer, text = site.ask("/", method="POST", Origin=origin)
    assert answer.status == 403 and text.startswith("refused")
    with (
        pytest.raises(InvalidStatus) as found,
        connect(site.socket, origin=origin, additional_headers={"Cookie": site.cookie}),
    ):
        pass
    assert found.value.response.status_code == 403


def test_an_upload_that_is_broken_off_leaves_the_server_alive(site):
    with closing(http.client.HTTPConnection("127.0.0.1", site.port, timeout=20)) as line:
        line.putrequest("POST", site.upload())
        line.putheader("Cookie", site.cookie)
        line.putheader("Content-Length", "1000")
        line.putheader("Content-Type", "multipart/form-data; boundary=x")
        line.endheaders(b"--x\r\n")
    assert site.ask()[0].status == 200


FORM = b'--x\r\nContent-Disposition: form-data; name="f"; filename="a.csv"\r\n\r\n' + b"1,2\n" * 1000 + b"\r\n--x--\r\n"


@contextmanager
def half_sent(site):
    """A connection that has sent half of an upload."""
    with closing(http.client.HTTPConnection("127.0.0.1", site.port, timeout=20)) as line:
        line.putrequest("POST", site.upload())
        line.putheader("Cookie", site.cookie)
        line.putheader("Content-Length", str(len(FORM)))
        line.putheader("Content-Type", "multipart/form-data; boundary=x")
        line.endheaders(FORM[: len(FORM) // 2])
        yield line


def test_a_slow_upload_holds_up_nobody(site):
    with half_sent(site) as line:
        for place in range(len(FORM) // 2, len(FORM), 500):
            assert site.ask("/identify")[0].status == 200
            line.send(FORM[place : place + 500])
        assert line.getresponse().status == 200


def test_a_slow_upload_does_not_keep_the_server_from_its_end():
    with running() as (process, site), half_sent(site):
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 130


def test_its_own_pages_may_open_a_websocket(site):
    own = f"http://127.0.0.1:{site.port}"
    with connect(site.socket, origin=own, additional_headers={"Cookie": site.cookie}) as line:
        assert line.recv(timeout=10).startswith("0{")


def test_a_large_body_is_refused(site):
    answer, text = site.ask("/", method="POST", body=b"", Content_Length=str(LARGEST + 1))
    assert answer.status == 413 and "MiB" in text

    def endless():
        yield b'--x\r\nContent-Disposition: form-data; name="f"; filename="a.csv"\r\n\r\n'
        for _ in range(LARGEST // 2**20 + 1):
            yield bytes(2**20)

    headers = {"Transfer_Encoding": "chunked", "Content_Type": "multipart/form-data; boundary=x"}
    try:
        answer, _ = site.ask(site.upload(), method="POST", body=endless(), **headers)
    except (BrokenPipeError, ConnectionResetError):
        pass  # it hung up
    else:
        assert answer.status == 413
    assert site.ask()[0].status == 200


def test_an_upload_that_is_no_form_is_refused(site):
    for body in (b"", bytes(100), b"--x\r\nContent-Disposition: nothing\r\n\r\n1\r\n--x--", b"--x--"):
        headers = {"Content_Type": "multipart/form-data; boundary=x", "Content_Length": str(len(body))}
        answer, text = site.ask(site.upload(), method="POST", body=body, **headers)
        assert answer.status in (200, 400), text
        assert "Traceback" not in text


def test_a_taken_port_is_an_error_with_a_remedy(site):
    done = subprocess.run(command(site.port), capture_output=True, text=True, env=OUTSIDE)
    assert done.returncode == 2
    assert "--port" in done.stderr and "Traceback" not in done.stderr


def test_sessions_are_apart(site):
    cookies = {site.ask()[0].headers["Set-Cookie"].split(";")[0] for _ in range(2)}
    assert len(cookies) == 2


def is_refused(answer, text):
    return (
        answer.status == 403 and text.startswith("refused") and "?token=" in text and "Set-Cookie" not in answer.headers
    )


def test_the_token_becomes_a_cookie_and_leaves_the_address(site):
    answer, _ = site.login("/run")
    assert (answer.status, answer.headers["Location"]) == (303, "/run")
    cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=strict" in cookie and site.token not in cookie
    assert site.ask(f"//evil.example/%0d?a=1&token={site.token}")[0].headers["Location"] == "/evil.example/%0D?a=1"
    answer, _ = site.login(**TO_PAGE | {"Sec_Fetch_Site": "cross-site"})  # such as a file that a program opens
    assert (answer.status, answer.headers["Refresh"]) == (200, "0; url=/") and answer.headers["Set-Cookie"]


@pytest.mark.parametrize("path", ["/", "/run", "/?token=", "/?token=x", "/favicon.ico", "/nothing", "/_nicegui/x"])
def test_without_the_token_nothing_is_answered(site, path):
    name = site.cookie.split("=")[0]
    for cookie in ("", f"{name}=", f"{name}=x", f"{name}={site.token}", f"{name}=\xe4", site.cookie[:-1]):
        assert is_refused(*site.ask(path, Cookie=cookie)), cookie


def test_a_token_in_another_request_than_that_of_a_page_is_worth_nothing(site):
    assert is_refused(*site.ask(f"/?token={site.token}", method="POST", Cookie=""))
    for mode, target in (("no-cors", "image"), ("navigate", "iframe"), ("cors", "empty")):
        assert is_refused(*site.login(Sec_Fetch_Mode=mode, Sec_Fetch_Dest=target)), target
    with pytest.raises(InvalidStatus) as found, connect(f"{site.socket}&token={site.token}"):
        pass
    assert found.value.response.status_code == 403


@pytest.mark.parametrize("where", ["cross-site", "same-site"])
def test_requests_of_other_sites_are_refused_though_they_have_the_cookie(site, where):
    for headers in (TO_PAGE, {"Sec_Fetch_Mode": "no-cors", "Sec_Fetch_Dest": "image"}, {}):
        assert is_refused(*site.ask("/run", Sec_Fetch_Site=where, **headers))
    sent = {"Cookie": site.cookie, "Sec-Fetch-Site": where, "Sec-Fetch-Mode": "websocket"}
    with pytest.raises(InvalidStatus) as found, connect(site.socket, additional_headers=sent):
        pass
    assert found.value.response.status_code == 403
    for own in ("same-origin", "none"):
        assert site.ask("/identify", Sec_Fetch_Site=own, **TO_PAGE)[0].status == 200


def test_a_websocket_without_the_cookie_is_refused(site):
    for origin in (None, f"http://127.0.0.1:{site.port}"):
        with pytest.raises(InvalidStatus) as found, connect(site.socket, origin=origin):
            pass
        assert found.value.response.status_code == 403


def test_the_token_of_a_started_browser_is_void_after_its_first_use():
    access = Access(8080)
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": f"token={access.once}".encode()}
    first, second = (access.admit(scope, Headers({})) for _ in range(2))
    assert first.status_code == 303 and second is None
    scope["query_string"] = b"token="
    assert access.admit(scope, Headers({})) is None


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_server_that_is_ended_removes_the_folders_of_its_sessions(tmp_path, name):
    with running(TMPDIR=str(tmp_path)) as (process, site):
        assert site.ask("/identify")[0].status == 200
        (folder,) = tmp_path.glob("mckibben-web-*")
        (folder / "data.csv").write_text("an upload")
        process.send_signal(signal.Signals[name])
        assert process.wait(timeout=20) == 128 + signal.Signals[name]
    assert not list(tmp_path.iterdir())


def test_requests_that_are_refused_make_no_session(tmp_path):
    with running(TMPDIR=str(tmp_path)) as (_, site):
        for _ in range(40):
            site.ask("/run", Cookie="")
            site.ask("/run", Sec_Fetch_Site="same-site", Sec_Fetch_Mode="no-cors", Sec_Fetch_Dest="image")
        assert not list(tmp_path.glob("mckibben-web-*"))


def test_the_help_imports_neither_the_page_nor_numpy():
    code = "import json, sys, mckibben.cli; print(json.dumps([m for m in ('nicegui', 'numpy') if m in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=OUTSIDE)
    assert json.loads(done.stdout) == []


def test_without_nicegui_the_error_names_the_extra():
    code = "import sys; sys.modules['nicegui'] = None; sys.argv[1:] = ['web']; from mckibben.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=OUTSIDE)
    assert done.returncode == 2
    assert "mckibben[web]" in done.stderr


def test_the_palette_is_that_of_the_report():
    from mckibben.report import style

    names = ("BLACK", "ORANGE", "SKY", "GREEN", "BLUE", "VERMILLION", "PURPLE")
    assert all(getattr(layout, name) == getattr(style, name) for name in names)
