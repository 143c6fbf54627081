"""A page in headless Chromium, driven over its WebSocket protocol: its requests, its errors, and what it shows."""

import asyncio
import base64
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

from tests.report.chromium import BROWSER

_LONGEST_S = 60.0


class Browser:
    """Chromium without a window."""

    def __init__(self, folder: Path, *, behind: int) -> None:
        # Drawing without a graphics card occupies a whole processor, which a simulated rig may need.
        command = [
            "nice", "-n", str(behind), BROWSER or "", "--headless", "--no-sandbox", "--disable-gpu",
            "--hide-scrollbars", "--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank",
        ]  # fmt: skip
        # Chromium keeps no pipe of the test open, and never waits for a reader of its own output.
        quiet = subprocess.DEVNULL
        self.process = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
        self.loop = asyncio.new_event_loop()
        try:
            self.address = self._listening(folder / "DevToolsActivePort")
        except BaseException:
            self.close()
            raise

    def _listening(self, port: Path) -> str:
        end_s = time.monotonic() + _LONGEST_S
        while not (port.exists() and (lines := port.read_text().split())):
            assert time.monotonic() < end_s, "Chromium does not start"
            time.sleep(0.05)
        return f"127.0.0.1:{lines[0]}"

    def open(self, address: str, *, width_px: int = 1280, height_px: int = 900, dark: bool = False) -> "Page":
        """Open a page in a new tab."""
        page = Page(self, width_px, height_px, dark)
        page.go(address)
        return page

    def close(self) -> None:
        os.killpg(self.process.pid, signal.SIGKILL)  # including the processes of its tabs, which survive a plain end
        self.process.wait(_LONGEST_S)
        self.loop.close()


class Page:
    """A tab; `requests` are the addresses that it requested, `said` the errors on its console."""

    def __init__(self, browser: Browser, width_px: int, height_px: int, dark: bool) -> None:
        self.requests: list[str] = []
        self.said: list[str] = []
        self._loop, self._number = browser.loop, 0
        self._line = self._run(self._connect(browser.address))
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._ask(f"{domain}.enable")
        self._ask(
            "Emulation.setDeviceMetricsOverride", width=width_px, height=height_px, deviceScaleFactor=1, mobile=False
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._ask("Emulation.setEmulatedMedia", features=[scheme])

    def go(self, address: str) -> None:
        self._ask("Page.navigate", url=address)

    def reload(self) -> None:
        self._ask("Page.reload")

    def value(self, script: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self._ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, script: str) -> Any:
        """Wait until an expression is true in the page, and return its value."""

        async def waiting() -> Any:
            end_s = self._loop.time() + _LONGEST_S
            while True:
                answer = await self._asked("Runtime.evaluate", {"expression": script, "returnByValue": True})
                if found := answer["result"].get("value"):
                    return found
                assert self._loop.time() < end_s, f"waited in vain for {script}: {answer} {self.said}"
                await asyncio.sleep(0.05)

        return self._run(waiting())

    def click(self, selector: str) -> None:
        """Press the mouse on an element, as a person does."""
        x, y = self.value(
            f"(() => {{ const box = document.querySelector({selector!r}).getBoundingClientRect(); "
            "return [box.x + box.width / 2, box.y + box.height / 2] })()"
        )
        self._ask("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def wheel(self, x: float, y: float, *, delta: float) -> None:
        """Turn the wheel over a place; a negative `delta` turns it away from the user."""
        self._ask("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=delta)

    def picture(self) -> bytes:
        """Return a PNG of the page."""
        return base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        self._ask("Page.close")
        self._line.close()

    def _run(self, coroutine: Any) -> Any:
        return self._loop.run_until_complete(asyncio.wait_for(coroutine, 2 * _LONGEST_S))

    async def _connect(self, address: str) -> WebSocketClientConnection:
        from tornado.httpclient import AsyncHTTPClient

        new = await AsyncHTTPClient().fetch(f"http://{address}/json/new", method="PUT", body="")
        return await websocket_connect(json.loads(new.body)["webSocketDebuggerUrl"], max_message_size=1 << 27)

    def _ask(self, method: str, **parameters: Any) -> Any:
        return self._run(self._asked(method, parameters))

    async def _asked(self, method: str, parameters: dict[str, Any]) -> Any:
        self._number += 1
        await self._line.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = await self._line.read_message()
            assert message is not None, "Chromium ended"
            content = json.loads(message)
            if content.get("id") == self._number:
                if method == "Runtime.evaluate" and "error" in content:  # the page was left in the meantime
                    return {"result": {}}
                assert "error" not in content, content
                return content["result"]
            self._note(content)

    def _note(self, event: dict[str, Any]) -> None:
        told = event.get("params", {})
        match event.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(told["request"]["url"])
            case "Network.webSocketCreated":
                self.requests.append(told["url"])
            case "Runtime.exceptionThrown":
                self.said.append(str(told["exceptionDetails"]))
            case "Log.entryAdded" if told["entry"]["level"] == "error":
                self.said.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
            case "Runtime.consoleAPICalled" if told["type"] in ("error", "assert"):
                self.said.append(str(told["args"]))


@contextmanager
def browser_in(folder: Path, *, behind: int = 10) -> Iterator[Browser]:
    """Start Chromium with its profile in a folder, at a niceness `behind` above that of the test."""
    browser = Browser(folder, behind=behind)
    try:
        yield browser
    finally:
        browser.close()
