"""A real Chromium, driven over its own protocol: what a reader's hands and eyes do."""

import json
import shutil
import subprocess
import urllib.request
from pathlib import Path
from typing import Any

import pytest
import websocket

from tests.process_tree import wait_until

CHROMIUM = shutil.which("chromium")
QUIET = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--remote-debugging-port=0", "--remote-allow-origins=*",
)  # fmt: skip


class NavigatedError(Exception):
    """The page was left while it computed an answer."""


class Browser:
    """One tab. Everything that the page reports to its console is kept in ``messages``."""

    def __init__(self, profile: Path) -> None:
        command = [str(CHROMIUM), *QUIET, f"--user-data-dir={profile}", "about:blank"]
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.messages: list[str] = []
        self.requests: list[str] = []
        self._number = 0
        self._socket = websocket.create_connection(self._address(profile), timeout=60)
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def _address(self, profile: Path) -> str:
        port_file = profile / "DevToolsActivePort"
        wait_until(lambda: port_file.exists() and port_file.read_text().strip() != "", 60)
        port = port_file.read_text().splitlines()[0]

        def tabs() -> list[str]:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                found = json.load(answer)
            return [tab["webSocketDebuggerUrl"] for tab in found if tab["type"] == "page"]

        wait_until(lambda: tabs() != [], 60)
        return tabs()[0]

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Give one command and return its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv())
            if message.get("id") == self._number:
                if "navigated" in message.get("error", {}).get("message", ""):
                    raise NavigatedError
                assert "error" not in message, message
                return dict(message["result"])
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method = message.get("method", "")
        if method in ("Log.entryAdded", "Runtime.exceptionThrown", "Runtime.consoleAPICalled"):
            self.messages.append(json.dumps(message["params"]))
        if method == "Network.requestWillBeSent":
            self.requests.append(message["params"]["request"]["url"])

    def open(self, page: Path, fragment: str = "") -> None:
        """Open a file and wait until it is there, what was said of the page before forgotten."""
        self.call("Page.navigate", url="about:blank")
        wait_until(lambda: self.run("location.href") == "about:blank", 60)
        self.messages.clear()
        self.requests.clear()
        self.call("Page.navigate", url=page.as_uri() + fragment)
        there = "document.readyState == 'complete' && location.href != 'about:blank'"
        wait_until(lambda: self.run(there), 60)

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page, or in the one that follows it; return its value."""
        how = {"returnByValue": True, "awaitPromise": True, "userGesture": True}
        try:
            result = self.call("Runtime.evaluate", expression=script, **how)
        except NavigatedError:
            return self.run(script)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def click(self, selector: str) -> None:
        """Click where an element is, as a hand does."""
        place = self.run(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center', behavior: 'instant'});"
            "const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            where = {"x": place[0], "y": place[1], "button": "left", "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=kind, **where)

    def press(self, key: str) -> None:
        code = {"Enter": 13, "ArrowRight": 39, "End": 35}[key]
        text = {"text": "\r"} if key == "Enter" else {}
        for kind, typed in (("keyDown", text), ("keyUp", {})):
            pressed = {"key": key, "code": key, "windowsVirtualKeyCode": code, **typed}
            self.call("Input.dispatchKeyEvent", type=kind, **pressed)

    def write(self, text: str) -> None:
        """Type into what has the focus."""
        self.call("Input.insertText", text=text)

    def screen(self, width: int, height: int) -> None:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def close(self) -> None:
        try:
            self.call("Browser.close")
            self._socket.close()
        except (OSError, websocket.WebSocketException, AssertionError):
            pass
        try:
            self._process.wait(15)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(15)


@pytest.fixture(scope="module")
def started_browser(tmp_path_factory):
    if CHROMIUM is None:
        pytest.skip("needs a browser: apt-get install chromium")
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


@pytest.fixture
def browser(started_browser):
    started_browser.screen(1280, 900)
    return started_browser
