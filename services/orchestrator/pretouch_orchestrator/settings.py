"""The orchestrator's settings, from environment variables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pretouch.errors import InvalidInput
from pretouch.serving.quantities import parse_bytes, parse_seconds
from pretouch_orchestrator.upstream.addresses import Addresses

_PREFIX = "PRETOUCH_ORCHESTRATOR_"


@dataclass(frozen=True)
class OrchestratorSettings:
    """Where REST is served, where sessions are kept, and where the other services are.

    Attributes:
        allowed_hosts: names by which REST may be called, beside its own; "*" for all.
        rest_port: 0 chooses a free port, which the log names.
        store: where sessions are kept, as `store.open_store` takes it.
        detector, registrar: where their copies are.
        keep: s after its last change for which a session is kept.
        max_store: bytes that all sessions together may take.
        gateway: host:port; None: robots send their own samples.
        tls_ca: certificate authority of the other services; if given, they are called over TLS.
    """

    detector: Addresses
    registrar: Addresses
    store: str
    keep: float = 30 * 86400.0
    max_store: int = 10 * 2**30
    gateway: str | None = None
    rest_host: str = "127.0.0.1"
    rest_port: int = 8080
    tls_ca: Path | None = None
    allowed_hosts: tuple[str, ...] = ()

    @staticmethod
    def from_environment(environment: Mapping[str, str]) -> OrchestratorSettings:
        """Reads PRETOUCH_ORCHESTRATOR_ with DETECTOR, REGISTRAR, STATE, STORE, KEEP, MAX_STORE, GATEWAY, REST_HOST,
        REST_PORT, ALLOWED_HOSTS and TLS_CA.

        Raises:
            InvalidInput: DETECTOR, REGISTRAR, or both STATE and STORE are missing, or another one cannot be read.
        """

        def get_required(name: str) -> str:
            if not environment.get(_PREFIX + name):
                raise InvalidInput(f"{_PREFIX}{name} is not set.", f"Set it; {_MEANING[name]}.")
            return environment[_PREFIX + name]

        def get_optional(name: str) -> str | None:
            return environment.get(_PREFIX + name) or None

        port = get_optional("REST_PORT") or "8080"
        if not (port.isascii() and port.isdigit() and int(port) < 65536):
            raise InvalidInput(f"{_PREFIX}REST_PORT is {port!r}.", "Give a port from 1 to 65535, or 0 for a free one.")
        ca = get_optional("TLS_CA")
        return OrchestratorSettings(
            detector=Addresses.parse(get_required("DETECTOR")),
            registrar=Addresses.parse(get_required("REGISTRAR")),
            store=get_optional("STORE") or f"sqlite:{get_required('STATE')}",
            keep=parse_seconds(get_optional("KEEP") or "30d", f"{_PREFIX}KEEP"),
            max_store=parse_bytes(get_optional("MAX_STORE") or "10GiB", f"{_PREFIX}MAX_STORE"),
            gateway=get_optional("GATEWAY"),
            rest_host=get_optional("REST_HOST") or "127.0.0.1",
            rest_port=int(port),
            tls_ca=None if ca is None else Path(ca),
            allowed_hosts=tuple(
                name.strip() for name in (get_optional("ALLOWED_HOSTS") or "").split(",") if name.strip()
            ),
        )


_MEANING = {
    "DETECTOR": "the detector's address as host:port, or those of its copies",
    "REGISTRAR": "the registrar's address as host:port, or those of its copies",
    "STATE": "a directory in which the orchestrator stores its sessions",
}
