"""Takes the connections to the page: a stop is answered at once, in a thread of its own; the rest goes to Bokeh."""

import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from json import dumps
from socket import MSG_PEEK, socket
from socketserver import ThreadingTCPServer
from threading import Thread
from typing import Any

from tornado.httputil import HTTPHeaders

from cfid.watch.gate import LOOPBACK, Gate
from cfid.watch.stop import MotorStop

_STOP = b"POST /stop "
_SLOWEST_S = 10.0  # from the connection to the request, which a browser may open in advance, and for the answer
_LOOKED_AT = 16  # bytes of a request


class Door(ThreadingTCPServer):
    """The page's port. Each request comes over a connection of its own, which its first bytes sort."""

    allow_reuse_address = daemon_threads = True
    request_queue_size = 128

    def __init__(self, port: int) -> None:
        """Take the port, 0 for any free one. Raises OSError when it cannot be taken."""
        super().__init__((LOOPBACK, port), _StopRequest)
        self.gate = Gate(self.server_address[1])

    def open(self, stop: MotorStop, pass_on: Callable[[socket, Any, bytes], object]) -> None:
        """Begin to accept; `pass_on` gets a connection that is no stop, its address, and the request's beginning."""
        self.stop, self._pass_on = stop, pass_on
        Thread(target=self.serve_forever, daemon=True).start()

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Sort a connection, in its own thread."""
        request.settimeout(_SLOWEST_S)
        try:
            begin = request.recv(_LOOKED_AT, MSG_PEEK)
        except OSError:
            begin = b""
        if begin.startswith(_STOP):
            super().process_request_thread(request, client_address)
        elif begin:
            self._pass_on(request, client_address, begin)
        else:
            self.shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report errors of this program, not those of a client that went away."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _StopRequest(BaseHTTPRequestHandler):
    """A press of the button."""

    timeout = _SLOWEST_S
    server: Door

    def do_POST(self) -> None:
        """Stop the motors, if a button of the page sent the request."""
        if self.server.gate.admits_stop(HTTPHeaders(dict(self.headers.items()))):
            report = self.server.stop.press()
            status, kind, text = 200, "application/json", dumps(report._asdict())
        else:
            status, kind, text = 403, "text/plain", "Not stopped: no button of the page sent this request.\n"
        content = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Print nothing: the page shows what was refused."""
