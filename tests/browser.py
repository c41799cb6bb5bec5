"""A page in a real browser without a screen, by Chromium's DevTools protocol."""

import base64
import io
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",  # draws without a GPU
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
    "--window-size=1000,800",
)


class Page:
    """An open page; all that it says and asks for is kept in ``events``."""

    def __init__(self, socket: Any) -> None:
        self.socket, self.count, self.events = socket, 0, []

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Ask for something, and wait for the answer."""
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": params}))
        while True:
            message = json.loads(self.socket.recv(timeout=30))
            if message.get("id") == self.count:
                if "error" in message:
                    raise RuntimeError(message["error"]["message"])
                return message["result"]
            self.events.append(message)

    def wait_for(self, method: str) -> None:
        """Wait until the browser says something."""
        while not any(event["method"] == method for event in self.events):
            self.events.append(json.loads(self.socket.recv(timeout=30)))

    def picture(self) -> np.ndarray:
        """What is seen, ``(height, width, 3)``."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def complaints(self) -> list[dict[str, Any]]:
        """Exceptions and errors in the console."""
        return [
            event
            for event in self.events
            if event["method"] == "Runtime.exceptionThrown"
            or (
                event["method"] == "Log.entryAdded" and event["params"]["entry"]["level"] == "error"
            )
            or (
                event["method"] == "Runtime.consoleAPICalled" and event["params"]["type"] == "error"
            )
        ]

    def asked_for(self) -> list[str]:
        """Addresses of all that was loaded."""
        return [
            event["params"]["request"]["url"]
            for event in self.events
            if event["method"] == "Network.requestWillBeSent"
        ]


@contextmanager
def opened(path: Path, profile: Path) -> Iterator[Page]:
    """Open a file in a browser; skips the test where there is none."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser is installed: none of {', '.join(NAMES)} is found")
    client = pytest.importorskip("websockets.sync.client")
    command = [program, *OPTIONS, f"--user-data-dir={profile}", "about:blank"]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    browser = subprocess.Popen(command, **silent)
    try:
        with client.connect(_address(browser, profile), max_size=None) as socket:
            root = Page(socket)
            (target, *_) = (
                each["targetId"]
                for each in root.call("Target.getTargets")["targetInfos"]
                if each["type"] == "page"
            )
            port = _port(profile)
        address = f"ws://127.0.0.1:{port}/devtools/page/{target}"
        with client.connect(address, max_size=None) as socket:
            page = Page(socket)
            for domain in ("Page", "Runtime", "Log", "Network"):
                page.call(f"{domain}.enable")
            page.call("Page.navigate", url=path.as_uri())
            page.wait_for("Page.loadEventFired")
            yield page
    finally:
        browser.terminate()
        browser.wait(10)


def _port(profile: Path) -> str:
    return (profile / "DevToolsActivePort").read_text().split()[0]


def _address(browser: subprocess.Popen, profile: Path) -> str:
    """Where the browser listens; it takes a while to say so."""
    until = time.monotonic() + 30
    while not (profile / "DevToolsActivePort").exists():
        assert browser.poll() is None and time.monotonic() < until, "the browser did not start"
        time.sleep(0.05)
    time.sleep(0.1)
    port, place = (profile / "DevToolsActivePort").read_text().split()
    return f"ws://127.0.0.1:{port}{place}"
