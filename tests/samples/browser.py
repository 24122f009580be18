"""A headless Chromium, told what to do by its own protocol: pictures and faults."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1000,700",
    "--remote-debugging-port=0",
    "--disable-component-update",
    "--mute-audio",
)
_STARTS_S, _ANSWERS_S = 90.0, 180.0


class Page:
    """One page of a browser.

    Attributes
    ----------
    faults : list of str
        Errors of the console, and exceptions that nothing caught.
    requested : list of str
        Addresses of all requests of the page.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._number = socket, 0
        self.faults: list[str] = []
        self.requested: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.do(f"{domain}.enable")

    def do(self, method: str, **given: Any) -> dict[str, Any]:
        """Send a command and wait for what comes of it; what happens meanwhile is noted."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": given}))
        while True:
            heard = json.loads(self._socket.recv(timeout=_ANSWERS_S))
            if heard.get("id") == self._number:
                if "error" in heard:
                    raise RuntimeError(f"{method}: {heard['error']['message']}")
                return dict(heard["result"])
            self._note(heard)

    def _note(self, event: dict[str, Any]) -> None:
        name, told = event.get("method"), event.get("params", {})
        if name == "Runtime.exceptionThrown":
            self.faults.append(str(told["exceptionDetails"].get("text")))
        elif name == "Runtime.consoleAPICalled" and told["type"] == "error":
            self.faults.append(" ".join(str(arg.get("value")) for arg in told["args"]))
        elif name == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.faults.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif name == "Network.requestWillBeSent":
            self.requested.append(str(told["request"]["url"]))

    def open(self, address: str, settle_s: float = 0.0) -> None:
        """Load an address, and leave it some time."""
        self.do("Page.navigate", url=address)
        self.wait(settle_s)

    def wait(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.value("0")
            time.sleep(min(0.2, max(0.0, end - time.monotonic())))

    def until(self, expression: str, seconds: float = 60.0) -> bool:
        """Wait until something holds in the page; whether it did in time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.value(expression):
                return True
            time.sleep(0.2)
        return False

    def value(self, expression: str) -> Any:
        """What an expression of JavaScript is in the page."""
        found = self.do("Runtime.evaluate", expression=expression, returnByValue=True)
        return found["result"].get("value")

    def picture(self) -> bytes:
        """A screenshot, PNG."""
        return base64.b64decode(self.do("Page.captureScreenshot", format="png")["data"])


@contextmanager
def browser(profile: Path) -> Iterator[Page]:
    """A page of a browser of its own, which ends with it.

    Raises
    ------
    RuntimeError
        If there is no Chromium, or it does not start.
    """
    from websockets.sync.client import connect

    if CHROMIUM is None:
        raise RuntimeError("no Chromium here")
    command = [CHROMIUM, *OPTIONS, f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        address = _page_address(profile)
        with connect(address, max_size=None, open_timeout=_STARTS_S) as socket:
            yield Page(socket)
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
        if process.stderr is not None:
            process.stderr.close()


def _page_address(profile: Path) -> str:
    """Where the browser listens for its page, once it does."""
    from urllib.request import urlopen

    file, end = profile / "DevToolsActivePort", time.monotonic() + _STARTS_S
    while time.monotonic() < end:
        if file.is_file() and (found := re.match(r"(\d+)\n", file.read_text())):
            with urlopen(f"http://127.0.0.1:{found[1]}/json/list", timeout=_STARTS_S) as answer:
                pages = [each for each in json.load(answer) if each["type"] == "page"]
            if pages:
                return str(pages[0]["webSocketDebuggerUrl"])
        time.sleep(0.2)
    raise RuntimeError("Chromium does not start")
