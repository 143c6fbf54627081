"""The page's port: who may ask for what, and who answers. A stop has a thread of its own, the rest goes to Bokeh."""

import hmac
import secrets
import sys
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler
from json import dumps
from socket import MSG_PEEK, socket
from socketserver import ThreadingTCPServer
from threading import Thread
from typing import Any

from tornado.httputil import HTTPHeaders

from cfid.watch.stop import MotorStop

LOOPBACK = "127.0.0.1"
TOKEN_HEADER = "X-Cfid-Token"

_STOP = b"POST /stop "
_SLOWEST_S = 10.0  # from the connection to the request, which a browser may open in advance, and for the answer
_LOOKED_AT = 16  # bytes of a request


class Gate:
    """Knows this server's names and its token; `refused` counts the requests that it turned away.

    Host reveals the name of another site that leads here (DNS rebinding); Origin, or for a request without one the site
    that the browser states, a request from another site's page.
    """

    def __init__(self, port: int) -> None:
        """Take the port of the server, and draw a token."""
        self.token = secrets.token_urlsafe(32)
        self.refused = 0
        self.hosts = [f"{name}:{port}" for name in (LOOPBACK, "localhost")]  # under which the page may be open

    def admits(self, path: str, headers: Mapping[str, str]) -> bool:
        """Return whether a request comes from a browser of this computer for this server's own page; count others.

        The page itself, whose address an operator types, has no origin. Anything else without an origin or a site, as
        from a program, needs the token.
        """
        if "Origin" in headers:
            return self._counted(headers, self._is_own(headers))
        site = headers.get("Sec-Fetch-Site", "none" if path == "/" else "")
        return self._counted(headers, site in ("same-origin", "none") or self._has_token(headers))

    def admits_stop(self, headers: Mapping[str, str]) -> bool:
        """Return whether a button of the page made a request; count others. A browser states the origin of each."""
        return self._counted(headers, self._is_own(headers) and self._has_token(headers))

    def _has_token(self, headers: Mapping[str, str]) -> bool:
        given = headers.get(TOKEN_HEADER) or ""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def _is_own(self, headers: Mapping[str, str]) -> bool:
        scheme, _, host = headers.get("Origin", "").partition("://")
        return scheme == "http" and host in self.hosts

    def _counted(self, headers: Mapping[str, str], trusted: bool) -> bool:
        admitted = trusted and headers.get("Host") in self.hosts
        self.refused += not admitted
        return admitted


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
