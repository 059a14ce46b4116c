"""How many files this process may have open, and how many connections that leaves."""

from __future__ import annotations

import resource
from contextlib import suppress

_ENOUGH = 65_536
_RESERVED = 128  # open files that are no connections of clients: the store, the other services, logs, libraries
_MOST_CONNECTIONS = 2048


def raise_open_file_limit() -> None:
    """Raises the limit of open files as far as this process may, up to more than it ever needs."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _ENOUGH if hard == resource.RLIM_INFINITY else min(hard, _ENOUGH)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(ValueError, OSError):  # some systems allow less than they say
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def get_connection_limit() -> int:
    """Connections that each of a service's two servers, gRPC and REST, may hold without running out of open files."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return _MOST_CONNECTIONS
    return max(1, min(_MOST_CONNECTIONS, (soft - _RESERVED) // 2))
