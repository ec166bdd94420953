"""A real browser without a window, for tests of pages: Chromium, told what to do by its protocol
(CDP) over a websocket."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

LIMIT = 90.0  # s; it only ends a test that would wait for ever
AGAIN = 20.0  # s; a browser on a busy machine is slow, and a second click lifts what the first left
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def browser() -> str | None:
    """Path of an installed Chromium, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """One page in a browser of its own."""

    def __init__(self, url: str, width: int = 800, height: int = 600):
        from websockets.sync.client import connect

        self._home = tempfile.mkdtemp()
        self._process = subprocess.Popen(
            [
                browser(), "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run",
                "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
                "--disable-background-networking", f"--user-data-dir={self._home}", "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._numbers = itertools.count(1)
        self.console: list[str] = []
        self.asked: list[str] = []  # addresses that the page has asked for
        file = Path(self._home, "DevToolsActivePort")
        self.until(lambda: file.exists() and file.read_text().count("\n") > 0, "browser")
        port = file.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            target = next(each for each in json.load(answer) if each["type"] == "page")
        self._socket = connect(target["webSocketDebuggerUrl"], max_size=None, ping_interval=None)
        for domain in ("Page", "Runtime", "Network"):
            self.tell(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.tell("Emulation.setDeviceMetricsOverride", **size)
        self.tell("Page.navigate", url=url)

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._home, ignore_errors=True)

    def tell(self, method: str, **parameters: object) -> dict:
        """Ask the browser for something; returns its answer."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(LIMIT))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            if message.get("method") == "Runtime.consoleAPICalled":
                words = [str(arg.get("value")) for arg in message["params"]["args"]]
                self.console.append(" ".join(words))
            if message.get("method") == "Network.requestWillBeSent":
                self.asked.append(message["params"]["request"]["url"])

    def script(self, code: str) -> object:
        """Value of an expression of JavaScript in the page."""
        answer = self.tell("Runtime.evaluate", expression=code, returnByValue=True)
        return answer["result"].get("value")

    def text(self) -> str:
        """All words on the page."""
        return str(self.script("document.body ? document.body.innerText : ''"))

    def contacts(self) -> list[list[str]]:
        """Rows of the tables of contacts that the page shows, cell by cell."""
        cells = "[...row.cells].map(cell => cell.innerText)"
        rows = self.script(f"[...document.querySelectorAll('tr')].map(row => {cells})")
        return [row for row in rows if len(row) > 3 and row[0].isdigit()]

    def until(self, happened: Callable[[], object], what: str) -> None:
        """Wait until something has happened."""
        end = time.monotonic() + LIMIT
        while not happened():
            assert time.monotonic() < end, f"in {LIMIT:g} s: no {what}"
            time.sleep(0.05)

    def says(self, words: str) -> None:
        """Wait until these words are on the page."""
        self.until(lambda: words in self.text(), f"'{words}' on the page")

    def click_until(self, happened: Callable[[], object], x: float, y: float) -> None:
        """Click on a place of the page, pixels, now and then until something has happened."""
        at = {"x": x, "y": y, "button": "left", "clickCount": 1}

        def click() -> None:
            for kind, held in (("mousePressed", 1), ("mouseReleased", 0)):
                self.tell("Input.dispatchMouseEvent", type=kind, buttons=held, **at)

        self._again_until(happened, click)

    def key_until(self, happened: Callable[[], object], selector: str, key: str, code: int) -> None:
        """Press a key in an element now and then until something has happened."""
        at = {"key": key, "code": key, "windowsVirtualKeyCode": code}

        def press() -> None:
            self.script(f"document.querySelector('{selector}').focus()")
            for kind in ("keyDown", "keyUp"):
                self.tell("Input.dispatchKeyEvent", type=kind, **at)

        self._again_until(happened, press)

    def _again_until(self, happened: Callable[[], object], act: Callable[[], None]) -> None:
        """Act again and again: what it is done to may not be there yet."""
        due = 0.0

        def acted() -> object:
            nonlocal due
            if not happened() and time.monotonic() > due:
                act()
                due = time.monotonic() + AGAIN
            return happened()

        self.until(acted, "answer")

    def picture(self, path: str | os.PathLike | None = None) -> bytes:
        """The page as PNG, also written to a file."""
        data = base64.b64decode(self.tell("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            Path(path).write_bytes(data)
        return data
