"""A headless Chromium, spoken to over a pipe: what tests need to see a page as its readers do.

The DevTools protocol over two pipes needs no library, no port and no driver: each message is JSON
that a zero byte ends (https://chromedevtools.github.io/devtools-protocol).
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Self

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_SWITCHES = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--no-first-run",
    "--no-default-browser-check",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "--remote-debugging-pipe",
)
# Chromium reads its file 3 and writes its file 4.
_LAUNCH = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
os.dup2(ends[0], 3)
os.dup2(ends[1], 4)
os.closerange(5, 32)
os.execv(sys.argv[3], sys.argv[3:])
"""
_PATIENCE = 60.0


def find_chromium() -> str | None:
    """Give the path of a Chromium, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


def require_chromium() -> str:
    """Give the Chromium here; without one the test is skipped, or fails where one is required."""
    program = find_chromium()
    if program is None:
        reason = "there is no Chromium here (Debian: apt-get install chromium)"
        if os.environ.get("DYNSR_REQUIRE_CHROMIUM") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return program


class Browser:
    """A running Chromium with one open tab; ``with`` ends its processes and deletes its profile."""

    def __init__(self, program: str) -> None:
        """Start it with a profile of its own and open a tab."""
        self.events: list[dict[str, Any]] = []
        self.profile = Path(tempfile.mkdtemp(prefix="dynsr-chromium-"))
        self._count, self._read, self._session = 0, b"", None
        theirs, self._to = os.pipe()
        self._from, back = os.pipe()
        command = [sys.executable, "-c", _LAUNCH, str(theirs), str(back), program]
        self.process = subprocess.Popen(
            [*command, *_SWITCHES, f"--user-data-dir={self.profile}", "about:blank"],
            pass_fds=(theirs, back),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, "HOME": str(self.profile)},
        )
        os.close(theirs)
        os.close(back)
        try:
            target = self.ask("Target.createTarget", url="about:blank")["targetId"]
            attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
            self._session = attached["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.ask(f"{domain}.enable")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Give the browser itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()

    def close(self) -> None:
        """End every process of the browser and delete its profile."""
        try:
            self._session = None
            self.ask("Browser.close")
            self.process.wait(10)
        except (OSError, EOFError, TimeoutError, subprocess.TimeoutExpired):
            pass
        with contextlib.suppress(ProcessLookupError):
            # Its session is its own, so that no other process is in the group.
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self._to)
        os.close(self._from)
        shutil.rmtree(self.profile, ignore_errors=True)

    def survivors(self, patience: float = 5.0) -> list[str]:
        """Give the processes of the browser's group that still run after some seconds."""
        end = time.monotonic() + patience
        while True:
            running = []
            for file in Path("/proc").glob("[0-9]*/stat"):
                try:
                    name, _, rest = file.read_text().rpartition(") ")
                except OSError:
                    continue
                state, _, group = rest.split()[:3]
                if group == str(self.process.pid) and state not in "ZX":
                    running.append(name)
            if not running or time.monotonic() > end:
                return running
            time.sleep(0.05)

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and give its answer; events that come meanwhile are kept."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + _PATIENCE
        while b"\0" not in self._read:
            if not select.select([self._from], [], [], max(0.0, end - time.monotonic()))[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._from, 1 << 16)
            if not part:
                raise EOFError("the browser has ended")
            self._read += part
        message, self._read = self._read.split(b"\0", 1)
        return json.loads(message)

    def open(
        self,
        page: Path | str,
        width: int,
        height: int = 844,
        dark: bool = False,
        media: str = "screen",
    ) -> None:
        """Load a file or an address, as a device of this width shows it; a phone's has touch."""
        phone = width < 600
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=phone,
        )
        self.ask("Emulation.setTouchEmulationEnabled", enabled=phone)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", media=media, features=[scheme])
        self.events.clear()
        url = page if isinstance(page, str) else page.resolve().as_uri()
        self.ask("Page.navigate", url=url)
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._next())

    def run(self, script: str) -> Any:
        """Evaluate JavaScript in the page and give its value, when a promise has it."""
        answer = self.ask(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, script: str, patience: float = _PATIENCE) -> Any:
        """Evaluate JavaScript again and again until it gives something true."""
        end = time.monotonic() + patience
        while not (found := self.run(script)):
            assert time.monotonic() < end, (
                f"in vain: {script}: {self.run('document.body.innerText')}"
            )
            time.sleep(0.05)
        return found

    def choose_file(self, selector: str, file: Path) -> None:
        """Give a file to an input of the page, as a reader does who picks it."""
        root = self.ask("DOM.getDocument")["root"]["nodeId"]
        node = self.ask("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.ask("DOM.setFileInputFiles", nodeId=node, files=[str(file.resolve())])

    def tap(self, x: float, y: float) -> None:
        """Touch the screen at a point of the viewport, and let go."""
        points = [{"x": x, "y": y}]
        self.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=points)
        self.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def press(self, key: str) -> None:
        """Press one key and let it go."""
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def screenshot(self, target: Path, whole: bool = True) -> Path:
        """Write what is seen as PNG, the whole page or the viewport."""
        shot = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        target.write_bytes(base64.b64decode(shot["data"]))
        return target

    def print_pdf(self, target: Path) -> Path:
        """Write the page as it is printed on A4 paper."""
        self.ask("Emulation.clearDeviceMetricsOverride")
        self.ask("Emulation.setEmulatedMedia", media="", features=[])
        paper = {"paperWidth": 8.27, "paperHeight": 11.69, "printBackground": False}
        printed = self.ask("Page.printToPDF", **paper)
        target.write_bytes(base64.b64decode(printed["data"]))
        return target

    def requests(self) -> list[str]:
        """Give the addresses that were asked for since the page was opened."""
        return [
            event["params"]["request"]["url"]
            for event in self.events
            if event.get("method") == "Network.requestWillBeSent"
        ]

    def wait_for_complaint(self) -> None:
        """Wait until the console says something; TimeoutError when it does not."""
        while not self.complaints():
            self.events.append(self._next())

    def complaints(self) -> list[str]:
        """Give errors and warnings of the console and uncaught exceptions since the opening."""
        found = []
        for event in self.events:
            method, parameters = event.get("method"), event.get("params", {})
            if method == "Runtime.exceptionThrown":
                found.append(json.dumps(parameters["exceptionDetails"]))
            elif method == "Runtime.consoleAPICalled" and parameters["type"] in (
                "error",
                "warning",
            ):
                found.append(json.dumps(parameters["args"]))
            elif method == "Log.entryAdded" and parameters["entry"]["level"] in (
                "error",
                "warning",
            ):
                found.append(parameters["entry"]["text"])
        return found
