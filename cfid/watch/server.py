"""Serves the page on this computer's loopback: Bokeh's server behind the gate, with the page and the stop."""

import asyncio
import logging
import signal
from collections.abc import Callable
from pathlib import Path
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
from tornado.netutil import bind_sockets
from tornado.web import RequestHandler

from cfid.errors import ConfigError
from cfid.watch.facts import facts_html
from cfid.watch.gate import LOOPBACK, Gate
from cfid.watch.page import HEADERS, SCRIPT, page_html
from cfid.watch.picture import EVERY_MS, Picture
from cfid.watch.stop import MotorStop
from cfid.watch.watched import Watched

_PLOTS = "/plots"


def serve(watched: Watched, *, campaign: Path | None, port: int, ready: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C; `ready` gets its address. Port 0 is any free one.

    The button stops the vehicles of the shown run and of those recorded beside it; where no run drives one, the
    vehicle of the folder `campaign`. Raises ConfigError when the port cannot be taken.
    """
    try:
        sockets = bind_sockets(port, LOOPBACK)
    except OSError as error:
        raise ConfigError(f"`port` {port}: cannot be taken: {error.strerror}. Leave it out for a free one.") from None
    port = sockets[0].getsockname()[1]
    for name in ("bokeh", "tornado.access"):  # the page shows what was refused
        logging.getLogger(name).setLevel(logging.ERROR)
    settings.resources = "server"  # whatever the environment sets: nothing is loaded from elsewhere
    asyncio.run(_serving(watched, campaign, sockets, port, ready))


async def _serving(
    watched: Watched, campaign: Path | None, sockets: list[Any], port: int, ready: Callable[[str], None]
) -> None:
    gate = Gate(port)
    stop = MotorStop(campaign)

    def draw(document: Document) -> None:
        context = document.session_context
        arguments = context.request.arguments if context is not None and context.request is not None else {}
        Picture(document, watched, dark=arguments.get("dark") == [b"1"])

    application = _Gated(
        {_PLOTS: Application(FunctionHandler(draw))},
        gate=gate,
        use_index=False,
        extra_patterns=[
            ("/", _Page, {"gate": gate}),
            ("/page.js", _Script),
            ("/facts", _FactsPage, {"watched": watched, "gate": gate}),
            ("/stop", _Stop, {"gate": gate, "stop": stop, "watched": watched}),
        ],
        extra_websocket_origins=gate.hosts,
    )
    http = HTTPServer(application)
    http.add_sockets(sockets)
    server = BaseServer(IOLoop.current(), application, http)
    server.start()
    reading = PeriodicCallback(watched.read, EVERY_MS)
    reading.start()
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    ready(f"http://{LOOPBACK}:{port}/")
    await ended.wait()
    reading.stop()
    server.stop()
    http.stop()
    await http.close_all_connections()
    watched.close()


class _Gated(BokehTornado):
    """Bokeh's server, which answers 403 to every request that the gate does not admit."""

    def __init__(self, applications: Any, *, gate: Gate, **more: Any) -> None:
        super().__init__(applications, **more)
        self._gate = gate

    def find_handler(self, request: HTTPServerRequest, **more: Any) -> Any:
        if not self._gate.admits(request.headers):
            return self.get_handler_delegate(request, _Refused)
        return super().find_handler(request, **more)


class _Refused(RequestHandler):
    def prepare(self) -> None:
        self.set_status(403)
        self.finish("This page is open on this computer alone, at the address that cfid watch printed.\n")


class _Page(RequestHandler):
    def initialize(self, gate: Gate) -> None:
        self._gate = gate

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def get(self) -> None:
        self.finish(page_html(self._gate))


class _Script(RequestHandler):
    def get(self) -> None:
        self.set_header("Content-Type", "text/javascript; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.finish(SCRIPT)


class _FactsPage(RequestHandler):
    def initialize(self, watched: Watched, gate: Gate) -> None:
        self._watched, self._gate = watched, gate

    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.finish(facts_html(self._watched.run, refused=self._gate.refused))


class _Stop(RequestHandler):
    def initialize(self, gate: Gate, stop: MotorStop, watched: Watched) -> None:
        self._gate, self._stop, self._watched = gate, stop, watched

    async def post(self) -> None:
        if not self._gate.admits_stop(self.request.headers, self._token()):
            self.set_status(403)
            self.finish("Not stopped: no button of the page sent this request.\n")
            return
        self._watched.look_for_newer()  # nothing has looked where the plots were not loaded
        report = await self._stop.press(self._watched.run)
        self.finish({"stopped": report.stopped, "text": report.text})

    def _token(self) -> str:
        return self.request.headers.get("X-Cfid-Token", "")
