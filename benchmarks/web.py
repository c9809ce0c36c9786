"""The local page in headless Chromium: time from a slider to the drawn curve, hostile uploads, and pictures.

    python benchmarks/web.py                      # latency
    python benchmarks/web.py --images docs/images # pictures for the docs
    python benchmarks/web.py --hostile 1000       # damaged and hostile uploads
    python benchmarks/web.py --loads 1000         # memory of the server; without Chromium
    python benchmarks/web.py --attack             # a hostile page on another port

Chromium is driven through its DevTools protocol; nothing but Chromium and the extra `web` is needed.
"""

from __future__ import annotations

import argparse
import base64
import collections
import http.client
import http.server
import io
import itertools
import json
import os
import random
import re
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from websockets.sync.client import connect

ROOT = Path(__file__).parents[1]
DATA = ROOT / "examples" / "rig.csv"
COLLECTED = 4.0  # s after which the server has returned the memory of pages that were left
MEDIAN, PERCENTILE_95 = 40.0, 80.0  # ms


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@contextmanager
def served() -> Iterator[str]:
    """Address of a server in a process of its own, with its token."""
    with started() as (_, address):
        yield address


@contextmanager
def started() -> Iterator[tuple[int, str]]:
    """Number of the process of a server, and its address with the token."""
    command = [sys.executable, "-m", "mckibben", "web", "--no-browser", "--port", str(free_port())]
    ours = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=ours) as process:
        try:
            assert process.stdout is not None
            yield process.pid, process.stdout.readline().split()[0]
        finally:
            process.terminate()


class Tab:
    """A tab of a browser; `errors` has what its console reported, `requests` the addresses asked for."""

    def __init__(self, address: str) -> None:
        self._socket = connect(address, max_size=None, legacy=True)
        self._number = itertools.count(1)
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.statuses: list[tuple[str, int]] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Answer to a command."""
        number = next(self._number)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._notice(answer)

    def _notice(self, event: dict[str, Any]) -> None:
        told = event.get("params", {})
        if event["method"] == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        elif event["method"] == "Network.responseReceived":
            self.statuses.append((told["response"]["url"], told["response"]["status"]))
        elif event["method"] == "Runtime.exceptionThrown":
            self.errors.append(str(told["exceptionDetails"])[:400])
        elif event["method"] == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")

    def evaluate(self, script: str) -> Any:
        """Value of an expression; a promise is awaited."""
        found = self.send("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"])[:500])
        return found["result"].get("value")

    def wait(self, condition: str, seconds: float = 60.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.evaluate(f"!!({condition})"):
            if time.monotonic() > end:
                raise TimeoutError(condition)
            time.sleep(0.05)

    def enter(self, address: str) -> str:
        """Open an address with its token; that without it."""
        self.open(address)
        self.wait("location.search === '' && document.querySelector('.nicegui-content')")
        return address.partition("/?")[0]

    def open(self, address: str, width: int = 1200, height: int = 900, *, wait: bool = True) -> None:
        """Open an address in a window of a size, and wait for the connection to the server."""
        self.resize(width, height)
        self.send("Emulation.setScrollbarsHidden", hidden=True)
        self.send("Page.navigate", url=address)
        if wait:
            self.wait("document.readyState === 'complete' && window.did_handshake !== false")

    def resize(self, width: int, height: int) -> None:
        """Change the size of the window."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )

    def press(self, key: str, code: int) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def click(self, element: str) -> None:
        """Click the middle of an element."""
        x, y = self.evaluate(f"(r => [r.x + r.width / 2, r.y + r.height / 2])(({element}).getBoundingClientRect())")
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def picture(self, path: Path) -> None:
        """Save the whole page, in 128 colours."""
        found = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        image = Image.open(io.BytesIO(base64.b64decode(found["data"]))).convert("RGB")
        image.quantize(128).save(path, optimize=True)


def chromium() -> str | None:
    """Program of the browser."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def browser() -> Iterator[Tab]:
    """A tab of a new Chromium."""
    program = chromium()
    if program is None:
        sys.exit("no Chromium is installed")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
            "--remote-debugging-port=0",
            f"--user-data-dir={profile}",
        ]
        process = subprocess.Popen([program, *options, "about:blank"], stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            port = next(m[1] for one in process.stderr if (m := re.search(r"ws://127\.0\.0\.1:(\d+)/", one)))
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                pages = [one for one in json.load(answer) if one["type"] == "page"]
            yield Tab(pages[0]["webSocketDebuggerUrl"])
        finally:
            process.terminate()
            process.wait()


CHARTS = "[...document.querySelectorAll('[_echarts_instance_]')]"
FIRST_CURVE = f"{CHARTS}.length && {CHARTS}[0].querySelector('canvas')"
DRAWING = "document.querySelector('svg[role=img] polyline')"
# From the key to the end of the task in which the first chart was drawn anew; the frame is shown right after it.
HOOK = """(() => {
  const canvas = [...document.querySelectorAll('[_echarts_instance_] canvas')][0];
  const stroke = CanvasRenderingContext2D.prototype.stroke;
  window.__pressed = 0; window.__drawn = 0;
  CanvasRenderingContext2D.prototype.stroke = function () {
    if (this.canvas === canvas && window.__pressed && !window.__drawn) {
      window.__drawn = -1;
      const channel = new MessageChannel();  // after the frame's own work, in which the chart is drawn
      channel.port1.onmessage = () => { window.__drawn = performance.now(); };
      channel.port2.postMessage(0);
    }
    return stroke.apply(this, arguments);
  };
  document.addEventListener('keydown', () => { window.__drawn = 0; window.__pressed = performance.now(); }, true);
})()"""


def latency(tab: Tab, address: str, slider: str, presses: int) -> list[float]:
    """Times [ms] from a key on a slider of the joint's page to its drawn curve."""
    tab.open(address)
    tab.wait(DRAWING)  # the first computation compiles
    time.sleep(2.0)
    tab.evaluate(HOOK)
    tab.evaluate(f"document.querySelector('.q-slider[aria-label=\"{slider}\"]').focus()")
    tab.evaluate(
        f"(document.querySelector('.q-slider[aria-label=\"{slider}\"] [tabindex]') || "
        f"document.querySelector('.q-slider[aria-label=\"{slider}\"]')).focus()"
    )
    found = []
    for i in range(presses):
        tab.press(*(("ArrowRight", 39) if i % 40 < 20 else ("ArrowLeft", 37)))
        tab.wait("window.__drawn > 0", 5)
        found.append(tab.evaluate("window.__drawn - window.__pressed"))
        time.sleep(0.12)
    return found[5:]


def computation() -> float:
    """Median time [ms] of what the server computes for a slider."""
    from mckibben.web.design import JointDesign, compute, muscles

    design, times = JointDesign(), []
    muscle = muscles(None)[design.muscle]
    for i in range(60):
        design.torque = 0.1 * i
        start = time.perf_counter()
        compute(design, muscle)
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[10:])


def settle(tab: Tab, condition: str) -> None:
    tab.wait(condition)
    time.sleep(1.5)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--images", type=Path, help="folder of the pictures, in place of the latency")
    parser.add_argument("--width", type=int, default=1200)
    parser.add_argument("--hostile", type=int, metavar="N", help="upload so many damaged files instead")
    parser.add_argument(
        "--loads", type=int, metavar="N", help="load so many pages, each in a session of its own, instead"
    )
    parser.add_argument("--pages", nargs="+", default=["/", "/identify", "/run", "/rig"], help="pages of --loads")
    parser.add_argument("--attack", action="store_true", help="open a hostile page of another port instead")
    asked = parser.parse_args()
    if asked.loads:
        loads(asked.loads, asked.pages)
        return
    with served() as printed, browser() as tab:
        address = tab.enter(printed)
        if asked.images:
            asked.images.mkdir(parents=True, exist_ok=True)
            pictures(tab, address, asked.images, asked.width)
        elif asked.attack:
            attack(tab, address)
        elif asked.hostile:
            hostile(tab, address, asked.hostile)
        else:
            print(f"computation alone: median {computation():.1f} ms; load of the machine {os.getloadavg()[0]:.1f}")
            for slider in ("radius of the anchors", "torque of the load", "angle"):
                times = sorted(latency(tab, address, slider, asked.presses))
                median, late = statistics.median(times), times[int(0.95 * len(times))]
                verdict = "met" if median <= MEDIAN and late <= PERCENTILE_95 else "NOT met"
                print(f"{slider}: median {median:.0f} ms, 95 % {late:.0f} ms, {len(times)} presses: {verdict}")
        outside = [
            one
            for one in tab.requests
            if not one.startswith((address, address.replace("http", "ws"), "data:", "blob:", "about:"))
        ]
        print(f"{len(tab.requests)} requests, to others {len(outside)} {outside[:3]}; errors {tab.errors[:3]}")


def loads(count: int, pages: list[str]) -> None:
    """Memory of the server after each tenth of the loads of pages: shown by a websocket, and left, in a new session."""
    with started() as (process, printed):
        address, _, query = printed.partition("/?")
        host = address.partition("//")[2]
        cookie = get(host, f"/?{query}", "")[1][0]

        def memory() -> float:
            found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
            assert found is not None
            return int(found[1]) / 1024

        for path in pages:
            print(f"{path}: {count} loads, memory [MiB] {memory():.0f}", end="", flush=True)
            for number in range(count):
                text, cookies = get(host, path, cookie)
                client = re.search(r'"client_id": ?"([0-9a-f-]{36})"', text) or re.search(
                    r"client_id\D{1,9}([0-9a-f-]{36})", text
                )
                assert client is not None
                words = f"client_id={client[1]}&tab_id={number}&document_id={number}&next_message_id=0"
                where = f"ws://{host}/_nicegui_ws/socket.io/?EIO=4&transport=websocket&implicit_handshake=true&{words}"
                with connect(
                    where, origin=address, additional_headers={"Cookie": "; ".join([cookie, *cookies])}
                ) as line:
                    line.recv(timeout=60)
                    line.send("40")
                    while (answer := line.recv(timeout=60)) == "2":  # a ping of a slow server
                        line.send("3")
                    assert str(answer).startswith("40"), "the handshake was refused"
                    if path == "/run":
                        time.sleep(0.05)  # the simulation has begun
                if (number + 1) % max(1, count // 10) == 0:
                    time.sleep(COLLECTED)
                    print(f" {memory():.0f}", end="", flush=True)
            print()


def get(host: str, path: str, cookie: str) -> tuple[str, list[str]]:
    """Text of a page, and the cookies that it sets."""
    with closing(http.client.HTTPConnection(host, timeout=60)) as line:
        line.request("GET", path, headers={"Cookie": cookie})
        answer = line.getresponse()
        assert answer.status in (200, 303), answer.status
        return answer.read().decode(), [one.split(";")[0] for one in answer.headers.get_all("Set-Cookie", [])]


_ATTACK = """<!doctype html><title>hostile</title><body><script>
  const site = %s, count = {tried: 0};
  for (let i = 0; i < 40; i++) {
    const image = new Image();
    image.src = site + ['/', '/run', '/identify', '/rig'][i %% 4] + '?' + i;
    document.body.append(image);
    count.tried++;
  }
  for (const path of ['/', '/run']) {
    const frame = document.createElement('iframe'), form = document.createElement('form');
    frame.name = 'f' + path; form.target = frame.name; form.method = 'post'; form.action = site + path;
    document.body.append(frame, form);
    form.submit();
    fetch(site + path, {mode: 'no-cors', credentials: 'include'}).catch(() => 0);
    const other = document.createElement('iframe');
    other.src = site + path;
    document.body.append(other);
  }
  const line = new WebSocket(site.replace('http', 'ws') + '/_nicegui_ws/socket.io/?EIO=4&transport=websocket');
  window.opened = false;
  line.onopen = () => { window.opened = true; };
  setTimeout(() => { window.done = true; }, 4000);
</script>"""


def attack(tab: Tab, address: str) -> None:
    """Data of a session after a page of another port, and one of another site, tried to reach the server."""
    tab.open(f"{address}/identify")
    tab.wait("document.querySelector('input[type=file]')")
    time.sleep(1.0)
    upload(tab, DATA)
    points = "document.body.innerText.includes('204 points, 31 slack')"
    tab.wait(points)
    page = (_ATTACK % json.dumps(address)).encode()

    class Hostile(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *args: Any) -> None:
            return

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hostile) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for host in ("127.0.0.1", "localhost"):
            before, folders = len(tab.statuses), session_folders()
            tab.open(f"http://{host}:{server.server_port}/", wait=False)
            tab.wait("window.done === true")
            opened = tab.evaluate("window.opened")
            tab.evaluate("1")
            seen = collections.Counter(code for url, code in tab.statuses[before:] if url.startswith(address))
            print(f"from {host}, another port: answers {dict(seen)}; websocket opened: {opened}")
            if opened or set(seen) - {403} or session_folders() != folders:
                raise RuntimeError("the page was reached")
        server.shutdown()
    tab.errors.clear()
    tab.open(f"{address}/identify")
    tab.wait(points)
    print("the uploaded data are still there")


def session_folders() -> set[str]:
    return {one.name for one in Path(tempfile.gettempdir()).glob("mckibben-web-*")}


def upload(tab: Tab, path: Path, selector: str = "input[type=file]") -> None:
    """Choose a file in the first upload of the page that a selector finds."""
    root = tab.send("DOM.getDocument")["root"]["nodeId"]
    field = tab.send("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
    tab.send("DOM.setFileInputFiles", files=[str(path)], nodeId=field)


def hostile(tab: Tab, address: str, count: int) -> None:
    """Upload damaged files of every format, some under hostile names; each gives points or an error that is shown."""
    sys.path.insert(0, str(ROOT))
    from tests.dataset.conftest import FILES
    from tests.dataset.test_hostile import damaged

    chance, names, seen = random.Random(7), sorted(FILES), collections.Counter[str]()
    scripts = ("<img src=x onerror=alert(1)>", "'; DROP TABLE x; --", "{{7*7}}", "a" * 200, "\u202egnp", "CON")
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            if number % 50 == 0:
                tab.open(f"{address}/identify")
                tab.wait("document.querySelector('input[type=file]')")
                tab.evaluate("window.alert = () => { window.__struck = true; }")
                time.sleep(0.5)
            name = names[number % len(names)]
            content = damaged(FILES[name], chance)
            if number % 10 == 0:  # such a word in every cell of the header
                content = content.replace(b"pressure", chance.choice(scripts).encode("utf-8", "replace"))
            path = Path(folder) / f"{number} {chance.choice(scripts)}{Path(name).suffix}"
            path.write_bytes(content)
            upload(tab, path)
            tab.wait(f"[...document.querySelectorAll('.heading')].some(h => h.innerText.startsWith('{number} '))", 30)
            text = tab.evaluate("document.body.innerText")
            if "Traceback" in text or "fault of mckibben" in text or tab.evaluate("window.__struck"):
                raise RuntimeError(f"{path.name}: {text[:2000]}")
            seen["points" if " slack" in text else "refused with a message"] += 1
            path.unlink()
        tab.open(f"{address}/identify")
        time.sleep(1.0)
        (good := Path(folder) / "good.csv").write_bytes(DATA.read_bytes())
        upload(tab, good)
        tab.wait("document.body.innerText.includes('204 points, 31 slack')")
    print(f"{count} uploads in {time.monotonic() - start:.0f} s: {dict(seen)}; afterwards a good file is read")


def click(tab: Tab, text: str) -> None:
    """Click the button with a text."""
    tab.evaluate(
        f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() === {json.dumps(text)}).click()"
    )


PASTE = """(() => {
  const field = document.querySelector('textarea');
  Object.getOwnPropertyDescriptor(HTMLTextAreaElement.prototype, 'value').set.call(field, %s);
  field.dispatchEvent(new Event('input', { bubbles: true }));
})()"""
"""Text into the first text area, as if typed."""


def pictures(tab: Tab, address: str, folder: Path, width: int) -> None:
    """The pages, after what a user would do first."""
    end = "" if width > 500 else f"-{width}"
    tab.open(f"{address}/", width, 900)
    settle(tab, DRAWING)
    tab.picture(folder / f"web-joint{end}.png")
    tab.open(f"{address}/identify", width, 900)
    tab.wait("document.querySelector('.q-expansion-item')")
    time.sleep(1.0)
    tab.evaluate("document.querySelector('.q-expansion-item .q-item').click()")
    time.sleep(0.6)
    tab.evaluate(PASTE % json.dumps(DATA.read_text(encoding="utf-8")))
    time.sleep(0.6)
    click(tab, "Read")
    settle(tab, "document.body.innerText.includes(' slack')")
    tab.evaluate("document.querySelector('.q-expansion-item .q-item').click()")
    click(tab, "Rank all laws")
    settle(tab, "document.body.innerText.includes('ranked')")
    click(tab, "Fit")
    settle(tab, FIRST_CURVE)
    tab.picture(folder / f"web-muscle{end}.png")
    tab.open(f"{address}/run", width, 900)
    settle(tab, FIRST_CURVE + " && document.body.innerText.includes('completed')")
    click(tab, "Keep this run")
    tab.click("document.querySelector('[aria-label^=\"controller\"]').closest('.q-field__control')")
    item = "[...document.querySelectorAll('.q-menu .q-item')].find(i => i.innerText.includes('decoupling'))"
    tab.wait(item)
    time.sleep(0.4)
    tab.click(item)
    tab.wait("document.querySelector('textarea').value.includes('decoupling')")
    time.sleep(2.0)
    tab.picture(folder / f"web-run{end}.png")
    tab.open(f"{address}/rig", width, 900)
    time.sleep(1.0)
    click(tab, "Start")
    settle(tab, "document.body.innerText.includes('points measured')")
    tab.picture(folder / f"web-rig{end}.png")
    tab.open(f"{address}/tune", width, 900)
    time.sleep(1.0)
    for button, found in (("Tune", "points evaluated"), ("Compare", "on the same unseen runs, each")):
        click(tab, button)
        tab.wait(f"document.body.innerText.includes('{found}')", 600)
    time.sleep(1.5)
    tab.picture(folder / f"web-tune{end}.png")
    tab.open(f"{address}/leg", width, 900)
    time.sleep(1.0)
    click(tab, "Compute")
    tab.wait("document.body.innerText.includes('Motion')", 600)
    time.sleep(1.5)
    slider = "document.querySelector('.q-slider').getBoundingClientRect()"
    x, y = tab.evaluate(f"(r => [r.x + 0.15 * r.width, r.y + r.height / 2])({slider})")
    for kind in ("mousePressed", "mouseReleased"):
        tab.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    time.sleep(1.5)
    tab.picture(folder / f"web-leg{end}.png")


if __name__ == "__main__":
    main()
