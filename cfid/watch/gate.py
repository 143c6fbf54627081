"""Admits only this server's own page: checks Host, Origin and site of every request, and a token for the stop."""

import hmac
import secrets
from collections.abc import Mapping

LOOPBACK = "127.0.0.1"
TOKEN_HEADER = "X-Cfid-Token"


class Gate:
    """Knows this server's names and its token; `refused` counts the requests that it turned away.

    Host reveals the name of another site that leads here (DNS rebinding); Origin, or for a request without one the site
    that the browser states, a request from another site's page.
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

    def admits(self, path: str, headers: Mapping[str, str]) -> bool:
        """Return whether a request comes from a browser of this computer for this server's own page; count others.

        The page itself, whose address an operator types, has no origin. Anything else without an origin or a site, as
        from a program, needs the token.
        """
        origin = headers.get("Origin")
        if origin is None and not self._has_token(headers):
            site = headers.get("Sec-Fetch-Site", "none" if path == "/" else "")
            return self._counted(headers.get("Host") in self._hosts and site in ("same-origin", "none"))
        return self._counted(headers.get("Host") in self._hosts and (origin is None or self._is_own(origin)))

    def admits_stop(self, headers: Mapping[str, str]) -> bool:
        """Return whether a button of the page made a request; count others. A browser states the origin of each."""
        is_own = headers.get("Host") in self._hosts and self._is_own(headers.get("Origin") or "")
        return self._counted(is_own and self._has_token(headers))

    def _has_token(self, headers: Mapping[str, str]) -> bool:
        given = headers.get(TOKEN_HEADER) or ""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def _is_own(self, origin: str) -> bool:
        scheme, _, host = origin.partition("://")
        return scheme == "http" and host in self._hosts

    def _counted(self, admitted: bool) -> bool:
        self.refused += not admitted
        return admitted
