"""The server in a process of its own: whom it answers, how it starts and ends."""

import http.client
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

from mckibben.web.layout import PAGES
from mckibben.web.security import LARGEST, Access
from tests.web import chromium

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
    for path in PAGES:
        answer, text = site.ask(path)
        assert answer.status == 200
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert not re.search(r"(src|href)=[\"'](https?:)?//", text)


FOREIGN = {"Sec_Fetch_Mode": "no-cors", "Sec_Fetch_Dest": "image"}
REFUSED = {
    "host": (400, "/", {"Host": "example.com"}),
    "host that begins as ours": (400, "/", {"Host": "127.0.0.1.example.com"}),
    "origin": (403, "/", {"method": "POST", "Origin": "http://example.com"}),
    "no origin": (403, "/", {"method": "POST", "Origin": "null"}),
    "origin on another port": (403, "/", {"method": "POST", "Origin": "http://127.0.0.1:1"}),
    "page of another site": (403, "/run", {"Sec_Fetch_Site": "cross-site", **TO_PAGE}),
    "picture of another port": (403, "/run", {"Sec_Fetch_Site": "same-site", **FOREIGN}),
    "no token": (403, "/", {"Cookie": ""}),
    "empty token": (403, "/?token=", {"Cookie": ""}),
    "wrong token": (403, "/?token=x", {"Cookie": ""}),
    "unknown path without a token": (403, "/_nicegui/x", {"Cookie": ""}),
    "wrong cookie": (403, "/", {"Cookie": "{name}=x"}),
    "cookie with the token": (403, "/", {"Cookie": "{name}={token}"}),
    "shortened cookie": (403, "/", {"Cookie": "{short}"}),
    "token in a picture": (403, "/?token={token}", {"Cookie": "", **FOREIGN}),
    "token in a frame": (403, "/?token={token}", {"Cookie": "", **TO_PAGE, "Sec_Fetch_Dest": "iframe"}),
    "token in a form": (403, "/?token={token}", {"Cookie": "", "method": "POST"}),
    "large body": (413, "/", {"method": "POST", "body": b"", "Content_Length": str(LARGEST + 1)}),
}
"""Status, path and headers of requests that get no page, no cookie, and no session."""


@pytest.mark.parametrize("kind", REFUSED)
def test_a_request_is_refused(site, kind):
    status, path, options = REFUSED[kind]
    secrets = {"token": site.token, "name": site.cookie.split("=")[0], "short": site.cookie[:-1]}
    given = {key: text.format(**secrets) if isinstance(text, str) else text for key, text in options.items()}
    answer, text = site.ask(path.format(**secrets), **given)
    assert answer.status == status
    assert "Set-Cookie" not in answer.headers and "Traceback" not in text and "<html" not in text


@pytest.mark.parametrize(
    "options",
    [
        {"origin": "http://example.com", "cookie": True},
        {"cookie": False},
        {"cookie": True, "headers": {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "websocket"}},
    ],
)
def test_a_websocket_is_refused(site, options):
    headers = options.get("headers", {}) | ({"Cookie": site.cookie} if options["cookie"] else {})
    with (
        pytest.raises(InvalidStatus) as found,
        connect(site.socket, origin=options.get("origin"), additional_headers=headers),
    ):
        pass
    assert found.value.response.status_code == 403


def test_its_own_pages_may_open_a_websocket(site):
    own = f"http://127.0.0.1:{site.port}"
    with connect(site.socket, origin=own, additional_headers={"Cookie": site.cookie}) as line:
        assert line.recv(timeout=10).startswith("0{")
    for origin in ("same-origin", "none"):
        assert site.ask("/identify", Sec_Fetch_Site=origin, **TO_PAGE)[0].status == 200


def test_an_upload_that_is_broken_off_endless_or_no_form_leaves_the_server_alive(site):
    with closing(http.client.HTTPConnection("127.0.0.1", site.port, timeout=20)) as line:
        line.putrequest("POST", site.upload())
        for name, value in {"Cookie": site.cookie, "Content-Length": "1000", **FORM}.items():
            line.putheader(name, value)
        line.endheaders(b"--x\r\n")

    def endless():
        yield b'--x\r\nContent-Disposition: form-data; name="f"; filename="a.csv"\r\n\r\n'
        for _ in range(LARGEST // 2**20 + 1):
            yield bytes(2**20)

    try:
        answer, _ = site.ask(site.upload(), method="POST", body=endless(), Transfer_Encoding="chunked", **FORM)
    except (BrokenPipeError, ConnectionResetError):
        pass  # it hung up
    else:
        assert answer.status == 413
    for body in (b"", bytes(100), b"--x--"):
        answer, text = site.ask(site.upload(), method="POST", body=body, **FORM)
        assert answer.status in (200, 400) and "Traceback" not in text
    assert site.ask()[0].status == 200


FORM = {"Content-Type": "multipart/form-data; boundary=x"}


def test_a_taken_port_is_an_error_with_a_remedy(site):
    done = subprocess.run(command(site.port), capture_output=True, text=True, env=OUTSIDE)
    assert done.returncode == 2
    assert "--port" in done.stderr and "Traceback" not in done.stderr


def test_sessions_are_apart(site):
    cookies = {site.ask()[0].headers["Set-Cookie"].split(";")[0] for _ in range(2)}
    assert len(cookies) == 2


def test_the_token_becomes_a_cookie_and_leaves_the_address(site):
    answer, _ = site.login("/run")
    assert (answer.status, answer.headers["Location"]) == (303, "/run")
    cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=strict" in cookie and site.token not in cookie
    assert site.ask(f"//evil.example/%0d?a=1&token={site.token}")[0].headers["Location"] == "/evil.example/%0D?a=1"
    answer, _ = site.login(**TO_PAGE | {"Sec_Fetch_Site": "cross-site"})  # such as a file that a program opens
    assert (answer.status, answer.headers["Refresh"]) == (200, "0; url=/") and answer.headers["Set-Cookie"]


def test_the_token_of_a_started_browser_is_void_after_its_first_use():
    access = Access(8080)
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": f"token={access.once}".encode()}
    first, second = (access.admit(scope, Headers({})) for _ in range(2))
    assert first.status_code == 303 and second is None
    scope["query_string"] = b"token="
    assert access.admit(scope, Headers({})) is None


_OUTLINE = """[
  document.querySelectorAll("h1").length,
  document.querySelectorAll("main").length,
  [...document.querySelectorAll("input:not(.hidden), textarea, button, [role=button], [role=img]")].filter(
    (one) => !(one.getAttribute("aria-label") || one.innerText?.trim() || one.closest("label"))
  ).length,
]"""


_SMALL = """[...document.querySelectorAll(".q-btn, a.tab, a.next, .q-checkbox, .q-slider, .q-expansion-item .q-item")]
  .filter((one) => one.offsetParent).map((one) => [one.innerText, one.getBoundingClientRect()])
  .filter(([, box]) => Math.min(box.width, box.height) < 43.5).map(([text, box]) => [text, box.width, box.height])"""


@pytest.mark.skipif(chromium.PROGRAM is None, reason="no Chromium is installed: apt-get install chromium")
def test_the_pages_work_in_a_browser_on_a_desk_and_on_a_phone(site, tmp_path):
    """Scripts run under the policy of the pages, the server's data are drawn, and nothing is wider than the window."""
    shown = {
        "/": "document.body.innerText.includes('Example data')",
        "/joint": "!!document.querySelector('canvas, svg[role=img] polyline')",
        "/identify": "document.body.innerText.includes('No points yet')",
        "/run": "document.body.innerText.includes('completed')",
        "/tune": "document.body.innerText.includes('counts as 1')",
        "/rig": "document.body.innerText.includes('no data yet') || !!document.querySelector('canvas')",
        "/robot": "!!document.querySelector('canvas') && document.body.innerText.includes('knee1 at')",
    }
    address = f"http://127.0.0.1:{site.port}"
    with chromium.browser(tmp_path) as tab:
        tab.open(f"{address}/?token={site.token}", 1200)
        for path, condition in shown.items():
            for width in (1200, 390):
                tab.wait("document.readyState === 'complete'")
                tab.open(address + path, width)
                tab.wait(f"document.readyState === 'complete' && ({condition})", 120)
                assert tab.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), (path, width)
                assert width > 820 or not tab.evaluate(_SMALL), (path, "targets of a finger are 44 px wide")
                assert tab.evaluate(_OUTLINE) == [1, 1, 0], (
                    path,
                    "one h1, one main, no field or button without a name",
                )
                if path == "/run" and width == 1200:
                    chart = "+document.querySelector('.nicegui-echart').id.slice(1)"
                    csv, svg, png = (
                        tab.evaluate(f"saveChart({chart}, '{kind}', 'x')") for kind in ("csv", "svg", "png")
                    )
        assert csv.startswith('"curve","time [s]","angle [°]"\n"now",0,') and '\n"desired",5.996,' in csv
        assert svg.startswith("<svg") and png.startswith("data:image/png;base64,")
        assert tab.errors == []


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_server_that_is_ended_removes_the_folders_of_its_sessions(tmp_path, name):
    with running(TMPDIR=str(tmp_path)) as (process, site):
        assert site.ask("/identify")[0].status == 200
        (folder,) = tmp_path.glob("mckibben-web-*")
        (folder / "data.csv").write_text("an upload")
        process.send_signal(signal.Signals[name])
        assert process.wait(timeout=20) == 128 + signal.Signals[name]
    assert not list(tmp_path.iterdir())


def test_without_nicegui_the_error_names_the_extra():
    code = "import sys; sys.modules['nicegui'] = None; sys.argv[1:] = ['web']; from mckibben.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=OUTSIDE)
    assert done.returncode == 2
    assert "mckibben[web]" in done.stderr
