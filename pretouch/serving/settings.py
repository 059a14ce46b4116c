"""How a service is served: where, for whom, with how many threads."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass, field
from pathlib import Path

from pretouch.errors import InvalidInput
from pretouch.serving.memory import choose_default_memory

LOG_LEVELS = ("debug", "info", "warning", "error")


@dataclass(frozen=True)
class Settings:
    """What all services have in common; each reads its own options from `PRETOUCH_<SERVICE>_<OPTION>`.

    Raises:
        InvalidInput: an invalid port, token or number, or half a TLS configuration.
    """

    port: int = 0
    """gRPC port; 0 lets the system choose, and the ready line names it."""
    host: str = "127.0.0.1"
    metrics_port: int | None = None
    """Prometheus over HTTP on the same host; None is off, 0 lets the system choose."""
    token: str | None = field(default=None, repr=False)
    """Bearer token that every call but a health check must carry; None asks for none, but see `tokens_file`."""
    tokens_file: Path | None = None
    """More tokens, each with an owner and a role; see `pretouch.serving.tokens`."""
    open_metrics: bool = False
    """Whether metrics need no token."""
    tls_cert: Path | None = None
    tls_key: Path | None = None
    tls_client_ca: Path | None = None
    """Where given, a client must show a certificate that this authority signed."""
    workers: int = 2
    """Threads for CPU work."""
    max_queue: int = 16
    """CPU jobs that may wait for a thread; one more is refused as `Overloaded`."""
    memory: int = field(default_factory=choose_default_memory)
    """Bytes that the process may use; left out, half of the machine's or the container's."""
    deadline: float = 60.0
    """s, for a call with a single answer whose client set no deadline."""
    grace: float = 5.0
    """s that running calls are given to finish when the service is told to stop."""
    log_level: str = "info"
    health_socket: Path | None = None
    """A Unix socket on which a parent process asks for the health, besides the port."""

    def __post_init__(self) -> None:
        for name, port in (("port", self.port), ("metrics port", self.metrics_port or 0)):
            if not 0 <= port <= 65535:
                raise InvalidInput(f"The {name} is {port}.", "Give a port from 1 to 65535, or 0 for a free one.")
        if not self.host:
            raise InvalidInput("The host is empty.", "Give an address of this machine, such as 127.0.0.1.")
        if self.token is not None and not (self.token.isascii() and self.token.isprintable() and self.token.split()):
            raise InvalidInput("The token is empty or holds unprintable characters.", "Use printable ASCII characters.")
        if self.workers < 1 or self.max_queue < 0:
            raise InvalidInput(
                f"There are {self.workers} workers and {self.max_queue} places in the queue.",
                "Give at least one worker and a queue of zero or more.",
            )
        if self.memory < 1:
            raise InvalidInput(f"The memory is {self.memory} bytes.", "Give an amount such as 800M or 2G.")
        if not (self.deadline > 0 and self.grace >= 0):
            raise InvalidInput(
                f"The deadline is {self.deadline} s and the grace {self.grace} s.",
                "Give a positive deadline and a grace of zero or more.",
            )
        if (self.tls_cert is None) != (self.tls_key is None):
            raise InvalidInput("TLS has a certificate or a key, but not both.", "Give --tls-cert and --tls-key.")
        if self.tls_client_ca is not None and self.tls_cert is None:
            raise InvalidInput(
                "Client certificates are asked for, but the server has none.", "Give --tls-cert and --tls-key too."
            )
        if self.log_level not in LOG_LEVELS:
            raise InvalidInput(f"The log level is {self.log_level!r}.", f"Choose one of {', '.join(LOG_LEVELS)}.")

    def address(self, port: int) -> str:
        """`host:port` as gRPC and URLs write it."""
        return f"[{self.host}]:{port}" if ":" in self.host else f"{self.host}:{port}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach what listens on `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
