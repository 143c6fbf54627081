"""Serves the page on this computer's loopback: Bokeh's server behind the gate, with the page and the stop."""

import asyncio
import logging
import signal
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from socket import socket
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.iostream import IOStream
from tornado.web import RequestHandler

from cfid.errors import ConfigError
from cfid.watch.door import LOOPBACK, Door, Gate
from cfid.watch.live_run import ShownRun
from cfid.watch.page import HEADERS, SCRIPT, facts_html, page_html
from cfid.watch.picture import EVERY_MS, Picture
from cfid.watch.stop import MotorStop

_PLOTS = "/plots"
_STREAM = b"GET /plots/ws"  # the one connection that outlives its request
_MOST_LOADS, _WITHIN_S = 8, 10.0  # of the plots, each of which takes a quarter of a second to draw
_DENIALS = {
    403: "This page is open on this computer alone, at the address that cfid watch printed.\n",
    503: "The plots were loaded too often: reload this page later.\n",
}


def serve(shown: ShownRun, *, campaign: Path | None, port: int, ready: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C; `ready` gets its address. Port 0 is any free one.

    `campaign` is the folder of the page's campaign, for the button. Raises ConfigError when the port cannot be taken.
    """
    try:
        door = Door(port)
    except OSError as error:
        raise ConfigError(f"`port` {port}: cannot be taken: {error.strerror}. Leave it out for a free one.") from None
    for name in ("bokeh", "tornado.access"):  # the page shows what was refused
        logging.getLogger(name).setLevel(logging.ERROR)
    settings.resources = "server"  # whatever the environment sets: nothing is loaded from elsewhere
    asyncio.run(_serving(shown, door, MotorStop(shown, campaign), ready))


async def _serving(shown: ShownRun, door: Door, stop: MotorStop, ready: Callable[[str], None]) -> None:
    gate = door.gate

    def draw(document: Document) -> None:
        context = document.session_context
        arguments = context.request.arguments if context is not None and context.request is not None else {}
        Picture(document, shown, dark=arguments.get("dark") == [b"1"])

    def facts() -> str:
        if not shown.viewers:  # the plots were not loaded
            shown.look()
        return facts_html(shown.run, refused=gate.refused, stops=stop.vehicles())

    application = _Gated(
        {_PLOTS: Application(FunctionHandler(draw))},
        gate=gate,
        use_index=False,
        extra_patterns=[
            ("/", _Text, {"kind": "text/html", "text": lambda: page_html(gate.token)}),
            ("/page.js", _Text, {"kind": "text/javascript", "text": lambda: SCRIPT}),
            ("/facts", _Text, {"kind": "text/html", "text": facts}),
        ],
        extra_websocket_origins=gate.hosts,
    )
    # A press of the button that came over the connection of a page load would wait for it: that one is not kept open.
    streaming, loading = HTTPServer(application), HTTPServer(application, no_keep_alive=True)
    loop = asyncio.get_running_loop()

    def take(connection: socket, address: Any, begin: bytes) -> None:
        (streaming if begin.startswith(_STREAM) else loading).handle_stream(IOStream(connection), address)

    def pass_on(*arrived: Any) -> None:
        with suppress(RuntimeError):  # raised once the page has ended
            loop.call_soon_threadsafe(take, *arrived)

    server = BaseServer(IOLoop.current(), application, streaming)
    server.start()
    door.open(stop, pass_on)
    reading = PeriodicCallback(shown.read, EVERY_MS)
    reading.start()
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, ended.set)
    ready(f"http://{LOOPBACK}:{door.server_address[1]}/")
    await ended.wait()
    door.shutdown()
    door.server_close()
    reading.stop()
    server.stop()
    for http in (streaming, loading):
        await http.close_all_connections()


class _Gated(BokehTornado):
    """Bokeh's server, which answers 403 to every request that the gate does not admit, 503 to one load too many."""

    def __init__(self, applications: Any, *, gate: Gate, **more: Any) -> None:
        super().__init__(applications, **more)
        self._gate = gate
        self._loaded_s: deque[float] = deque(maxlen=_MOST_LOADS)

    def find_handler(self, request: HTTPServerRequest, **more: Any) -> Any:
        if not self._gate.admits(request.path, request.headers):
            return self._denied(request, 403)
        if request.path.startswith(_PLOTS) and not request.path.endswith("/ws"):
            now_s = time.monotonic()
            if len(self._loaded_s) == _MOST_LOADS and now_s - self._loaded_s[0] < _WITHIN_S:
                return self._denied(request, 503)
            self._loaded_s.append(now_s)
        return super().find_handler(request, **more)

    def _denied(self, request: HTTPServerRequest, status: int) -> Any:
        return self.get_handler_delegate(request, _Text, {"text": lambda: _DENIALS[status], "status": status})


class _Text(RequestHandler):
    """Answers any method, so that a denial does too."""

    def initialize(self, text: Callable[[], str], kind: str = "text/plain", status: int = 200) -> None:
        self._text, self._kind = text, kind
        self.set_status(status)

    def prepare(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.set_header("Content-Type", f"{self._kind}; charset=utf-8")
        self.finish(self._text())
