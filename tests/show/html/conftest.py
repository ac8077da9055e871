"""A headless browser at the other end of two pipes: the DevTools protocol without a driver, and without a package that pytest does not have."""

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = ("gpu", "quic", "background-networking", "component-update", "sync", "dev-shm-usage", "extensions")
LIMIT = 300  # s after which a browser that does not answer is taken for dead; a loaded machine starts one slowly
PIPES = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
os.dup2(ends[0], 3)
os.dup2(ends[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""  # the browser reads from 3 and writes to 4


def installed():
    """Path of a browser, playwright's where no other is there, or None."""
    found = [path for path in map(shutil.which, NAMES) if path]
    kept = Path(os.environ.get("PLAYWRIGHT_BROWSERS_PATH") or Path.home() / ".cache" / "ms-playwright")
    return next(iter(found + sorted(map(str, kept.glob("chromium-*/chrome-linux*/chrome")))), None)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A Browser, where one is installed."""
    if installed() is None:
        pytest.skip("no chromium is installed")
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


class Browser:
    """One tab; use it in a `with`. folder: of the profile. errors: what the console said that is no mere log."""

    def __init__(self, folder):
        self.errors, self.seen, self.rest, self.last = [], [], b"", 0
        (out, self.to), (self.answers, back) = os.pipe(), os.pipe()
        options = ["--headless", "--no-sandbox", "--no-first-run", "--remote-debugging-pipe", f"--user-data-dir={folder}"]
        command = [sys.executable, "-c", PIPES, str(out), str(back), installed(), *options, *(f"--disable-{what}" for what in QUIET)]
        self.process = subprocess.Popen(command, pass_fds=(out, back), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(out)
        os.close(back)
        self.session = None

    def __enter__(self):
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")
        return self

    def __exit__(self, *exception):
        self.process.kill()
        self.process.wait()
        os.close(self.to)
        os.close(self.answers)

    def ask(self, method, **parameters):
        """The result of a method of the protocol."""
        self.last += 1
        message = {"id": self.last, "method": method, "params": parameters} | ({"sessionId": self.session} if self.session else {})
        os.write(self.to, json.dumps(message).encode() + b"\0")
        answer = self._until(lambda said: said.get("id") == self.last)
        assert "error" not in answer, (method, answer["error"])
        return answer["result"]

    def open(self, path, width, scheme="light", height=900, motion="reduce"):
        """Show a file in a window so wide, light or dark; what was said before is forgotten."""
        self.errors.clear()
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500)
        media = {"prefers-color-scheme": scheme, "prefers-reduced-motion": motion}
        self.ask("Emulation.setEmulatedMedia", features=[{"name": name, "value": value} for name, value in media.items()])
        self.seen.clear()
        self.ask("Page.navigate", url=Path(path).resolve().as_uri())
        self._until(lambda said: said.get("method") == "Page.loadEventFired")

    def value(self, script):
        """What an expression of JavaScript is in the page."""
        answer = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def press(self, key, code, text=""):
        """A key of the keyboard."""
        for kind in ("keyDown", "keyUp"):
            typed = {"text": text} if text and kind == "keyDown" else {}
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **typed)

    def screenshot(self, path):
        """The whole page as PNG."""
        taken = self.ask("Page.captureScreenshot", captureBeyondViewport=True)
        Path(path).write_bytes(base64.b64decode(taken["data"]))

    def printed(self):
        """The page on paper: the bytes of a PDF."""
        return base64.b64decode(self.ask("Page.printToPDF")["data"])

    def _until(self, wanted):
        """The first message that is wanted, of those that nobody has waited for yet."""
        end = time.monotonic() + LIMIT
        while True:
            for said in self.seen:
                if wanted(said):
                    self.seen.remove(said)
                    return said
            ready, _, _ = select.select([self.answers], [], [], max(0.0, end - time.monotonic()))
            if not ready or not (read := os.read(self.answers, 1 << 20)):
                raise TimeoutError("the browser does not answer")
            *whole, self.rest = (self.rest + read).split(b"\0")
            for message in map(json.loads, whole):
                self._heed(message)
                self.seen.append(message)

    def _heed(self, message):
        """Keep what the console says of errors and warnings, and exceptions of scripts."""
        said = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(said["exceptionDetails"].get("exception", {}).get("description") or said["exceptionDetails"]["text"])
        elif message.get("method") == "Log.entryAdded" and said["entry"]["level"] in ("error", "warning"):
            self.errors.append(said["entry"]["text"])
        elif message.get("method") == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning", "assert"):
            self.errors.append(str(said["args"]))
