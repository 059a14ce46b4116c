"""By which names REST may be called, so that no page of another site makes a visitor's browser call it.

A browser sends the page's origin along, and, where a foreign name was made to point here (DNS rebinding), that name as
`Host`. An address cannot be made to point elsewhere, and a name that public DNS cannot hold belongs to whoever runs the
network; other names must be listed.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.types import Scope

from pretouch.errors import Forbidden
from pretouch.serving.settings import is_loopback

_LOOPBACK_NAMES = ("localhost", "localhost.localdomain", "ip6-localhost", "ip6-loopback")
_NETWORK_SUFFIXES = (".local", ".localhost", ".internal", ".home.arpa")
_VARIABLE = "PRETOUCH_ORCHESTRATOR_ALLOWED_HOSTS"


class HostCheck:
    """Refuses requests by a foreign name or from another origin.

    Args:
        host: the address that REST listens on.
        allowed: more names; "*" allows all names and origins.
    """

    def __init__(self, host: str = "127.0.0.1", allowed: Collection[str] = ()) -> None:
        self._listed = {name.lower() for name in allowed}
        self._names = {*self._listed, *_LOOPBACK_NAMES, host.lower(), socket.gethostname().lower()}
        self._on_network = not is_loopback(host)

    def find_refusal(self, scope: Scope) -> Forbidden | None:
        """The error for a request, None if it may pass; one without `Host` or `Origin` comes from no browser."""
        if "*" in self._listed:
            return None
        headers = {name: value.decode("latin-1").lower() for name, value in scope["headers"]}
        host, origin = headers.get(b"host"), headers.get(b"origin")
        if host is not None and not self._is_ours(_parse_name(host)):
            return Forbidden(
                f"This service is not called {_parse_name(host)!r:.200}.", f"List the name in {_VARIABLE} if it is."
            )
        if origin is None or is_same_origin(origin, host) or _parse_name(origin.partition("://")[2]) in self._listed:
            return None
        return Forbidden(
            f"The request comes from a page of {origin!r:.200}.",
            f"Call from this service's own pages or from a program, or list that page's host in {_VARIABLE}.",
        )

    def _is_ours(self, name: str) -> bool:
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return self._on_network and ("." not in name or name.endswith(_NETWORK_SUFFIXES))
        return True


def is_same_origin(origin: str, host: str | None) -> bool:
    """Whether a page of this `Origin` was served under this `Host`; a proxy before us may have added TLS."""
    return "://" in origin and origin.partition("://")[2] == host


def _parse_name(host: str) -> str:
    """`Host` without its port, brackets and final dot; "" if it is no host."""
    try:
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return ""
