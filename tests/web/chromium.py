"""Headless Chromium over its debugging protocol: open a page, evaluate, wait, take a picture."""

import base64
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager

from websockets.sync.client import connect

PROGRAM = shutil.which("chromium")


class Tab:
    """A tab; `errors` are the errors that its scripts have reported."""

    def __init__(self, line):
        self._line, self._numbers = line, itertools.count(1)
        self.errors: list[str] = []
        for domain in ("Page", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method, **parameters):
        """Call a method of the protocol; its result."""
        number = next(self._numbers)
        self._line.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._line.recv(timeout=60))
            entry = answer.get("params", {}).get("entry", {})
            if answer.get("method") == "Runtime.exceptionThrown" or entry.get("level") == "error":
                self.errors.append(json.dumps(answer["params"])[:500])
            if answer.get("id") == number:
                return answer["result"]

    def open(self, address, width):
        """Open an address in a window of a width."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.send("Emulation.setDeviceMetricsOverride", **size)
        self.send("Page.navigate", url=address)

    def evaluate(self, script):
        """The value of an expression, or of its promise."""
        return self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)["result"].get(
            "value"
        )

    def wait(self, condition, seconds=60.0):
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.evaluate(condition):
            assert time.monotonic() < end, f"not in time: {condition}"
            time.sleep(0.1)

    def picture(self, path):
        """Save what is shown."""
        content = self.send("Page.captureScreenshot", captureBeyondViewport=True)["data"]
        path.write_bytes(base64.b64decode(content))


@contextmanager
def browser(folder):
    """A tab of a browser that is ended afterwards; its profile is in a folder."""
    options = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0", f"--user-data-dir={folder}"]
    with subprocess.Popen([str(PROGRAM), *options], stderr=subprocess.DEVNULL) as process:
        try:
            port, end = folder / "DevToolsActivePort", time.monotonic() + 60
            while not (port.exists() and port.read_text().count("\n")):
                assert time.monotonic() < end, "Chromium does not start"
                time.sleep(0.1)
            where = f"http://127.0.0.1:{port.read_text().splitlines()[0]}/json"
            with urllib.request.urlopen(where) as answer:
                page = next(one for one in json.load(answer) if one["type"] == "page")
            with connect(page["webSocketDebuggerUrl"], max_size=None) as line:
                yield Tab(line)
        finally:
            process.terminate()
