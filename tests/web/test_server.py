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
from contextlib import closing

import pytest

pytest.importorskip("nicegui")
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from mckibben.web import layout
from mckibben.web.security import LARGEST

OUTSIDE = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it


def command(port):
    return [sys.executable, "-m", "mckibben", "web", "--no-browser", "--port", str(port)]


@pytest.fixture(scope="module")
def port():
    """Port of a server; in the end Ctrl-C ends it, and it has printed its address and no traceback."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        free = one.getsockname()[1]
    with subprocess.Popen(
        command(free), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=OUTSIDE
    ) as server:
        try:
            first = server.stdout.readline()
            assert first.startswith(f"http://127.0.0.1:{free}"), server.stderr.read()
            yield free
            server.send_signal(signal.SIGINT)
            out, err = server.communicate(timeout=20)
            assert out == "" and "Traceback" not in err, err
            assert server.returncode in (0, 130)
        finally:
            server.kill()


def ask(port, path="/", *, method="GET", body=None, **headers):
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=20)) as line:
        sent = {name.replace("_", "-"): value for name, value in headers.items()}
        line.request(method, path, body, sent, encode_chunked="Transfer_Encoding" in headers)
        answer = line.getresponse()
        return answer, answer.read().decode(errors="replace")


@pytest.mark.slow
def test_it_answers_on_this_machine_and_loads_nothing_from_others(port):
    for path in ("/", "/identify", "/run"):
        answer, text = ask(port, path)
        assert answer.status == 200
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert not re.search(r"(src|href)=[\"'](https?:)?//", text)


@pytest.mark.parametrize("host", ["example.com", "127.0.0.1.example.com", "example.com:80", "10.0.0.1"])
@pytest.mark.slow
def test_a_foreign_host_is_refused(port, host):
    answer, text = ask(port, Host=host)
    assert answer.status == 400
    assert "Traceback" not in text and "host" in text.lower()


@pytest.mark.parametrize("origin", ["http://example.com", "null", "http://127.0.0.1:1", "https://localhost"])
@pytest.mark.slow
def test_a_foreign_origin_is_refused(port, origin):
    answer, text = ask(port, "/", method="POST", Origin=origin)
    assert answer.status == 403 and text.startswith("refused")
    with pytest.raises(InvalidStatus) as found, connect(socket_of(port), origin=origin):
        pass
    assert found.value.response.status_code == 403


def upload_of(port):
    """Path for uploads of a new visit."""
    return re.search(r"/_nicegui/client/[0-9a-f-]{36}/upload/\d+", ask(port, "/identify")[1])[0]


def socket_of(port):
    return f"ws://127.0.0.1:{port}/_nicegui_ws/socket.io/?EIO=4&transport=websocket"


def test_an_upload_that_is_broken_off_leaves_the_server_alive(port):
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=20)) as line:
        line.putrequest("POST", upload_of(port))
        line.putheader("Content-Length", "1000")
        line.putheader("Content-Type", "multipart/form-data; boundary=x")
        line.endheaders(b"--x\r\n")
    assert ask(port)[0].status == 200


def test_its_own_pages_may_open_a_websocket(port):
    with connect(socket_of(port), origin=f"http://127.0.0.1:{port}") as line:
        assert line.recv(timeout=10).startswith("0{")


@pytest.mark.slow
def test_a_large_body_is_refused(port):
    answer, text = ask(port, "/", method="POST", body=b"", Content_Length=str(LARGEST + 1))
    assert answer.status == 413 and "MiB" in text

    def endless():
        yield b'--x\r\nContent-Disposition: form-data; name="f"; filename="a.csv"\r\n\r\n'
        for _ in range(LARGEST // 2**20 + 1):
            yield bytes(2**20)

    headers = {"Transfer_Encoding": "chunked", "Content_Type": "multipart/form-data; boundary=x"}
    try:
        answer, _ = ask(port, upload_of(port), method="POST", body=endless(), **headers)
    except (BrokenPipeError, ConnectionResetError):
        pass  # it hung up
    else:
        assert answer.status == 413
    assert ask(port)[0].status == 200


def test_an_upload_that_is_no_form_is_refused(port):
    for body in (b"", bytes(100), b"--x\r\nContent-Disposition: nothing\r\n\r\n1\r\n--x--", b"--x--"):
        headers = {"Content_Type": "multipart/form-data; boundary=x", "Content_Length": str(len(body))}
        answer, text = ask(port, upload_of(port), method="POST", body=body, **headers)
        assert answer.status in (200, 400), text
        assert "Traceback" not in text


@pytest.mark.slow
def test_a_taken_port_is_an_error_with_a_remedy(port):
    done = subprocess.run(command(port), capture_output=True, text=True, env=OUTSIDE)
    assert done.returncode == 2
    assert "--port" in done.stderr and "Traceback" not in done.stderr


def test_sessions_are_apart(port):
    cookies = {ask(port)[0].headers["Set-Cookie"].split(";")[0] for _ in range(2)}
    assert len(cookies) == 2


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
