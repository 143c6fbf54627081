"""Admits only this server's own page: checks Host and Origin of every request, and a token for the stop."""

import hmac
import secrets
from collections.abc import Mapping

LOOPBACK = "127.0.0.1"


class Gate:
    """Knows this server's names and its token; `refused` counts the requests that it turned away.

    Host reveals the name of another site that leads here (DNS rebinding), Origin a request from another site's page.
    """

    def __init__(self, port: int) -> None:
        """Take the port of the server, and draw a token."""
        self.token = secrets.token_urlsafe(32)
        self.refused = 0
        self._hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}

    @property
    def hosts(self) -> list[str]:
        """The names under which the page may be open."""
        return sorted(self._hosts)

    def admits(self, headers: Mapping[str, str]) -> bool:
        """Return whether a request comes from a browser of this computer for this server's own page; count others."""
        origin = headers.get("Origin")
        return self._counted(headers.get("Host") in self._hosts and (origin is None or self._is_own(origin)))

    def admits_stop(self, headers: Mapping[str, str], token: str) -> bool:
        """Return whether a request that `admits` let in was made by a button of the page; count others.

        A browser states the origin of every such request.
        """
        given = hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode())
        return self._counted(given and self._is_own(headers.get("Origin", "")))

    def _is_own(self, origin: str) -> bool:
        scheme, _, host = origin.partition("://")
        return scheme == "http" and host in self._hosts

    def _counted(self, admitted: bool) -> bool:
        self.refused += not admitted
        return admitted
