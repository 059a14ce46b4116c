"""The orchestrator's settings, from environment variables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pretouch.errors import InvalidInput

_PREFIX = "PRETOUCH_ORCHESTRATOR_"


@dataclass(frozen=True)
class OrchestratorSettings:
    """Where REST is served, where sessions are kept, and where the other services are.

    Attributes:
        allowed_hosts: names by which REST may be called, beside its own; "*" for all.
        rest_port: 0 chooses a free port, which the log names.
        store: where sessions are kept, as `store.open_store` takes it.
        detector, registrar: host:port.
        gateway: host:port; None: robots send their own samples.
        tls_ca: certificate authority of the other services; if given, they are called over TLS.
    """

    detector: str
    registrar: str
    store: str
    gateway: str | None = None
    rest_host: str = "127.0.0.1"
    rest_port: int = 8080
    tls_ca: Path | None = None
    allowed_hosts: tuple[str, ...] = ()

    @staticmethod
    def from_environment(environment: Mapping[str, str]) -> OrchestratorSettings:
        """Reads PRETOUCH_ORCHESTRATOR_{DETECTOR, REGISTRAR, STATE, STORE, GATEWAY, REST_HOST, REST_PORT, TLS_CA,
        ALLOWED_HOSTS}.

        Raises:
            InvalidInput: DETECTOR, REGISTRAR, or both STATE and STORE are missing, or REST_PORT is not a port.
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
            detector=get_required("DETECTOR"),
            registrar=get_required("REGISTRAR"),
            store=get_optional("STORE") or f"sqlite:{get_required('STATE')}",
            gateway=get_optional("GATEWAY"),
            rest_host=get_optional("REST_HOST") or "127.0.0.1",
            rest_port=int(port),
            tls_ca=None if ca is None else Path(ca),
            allowed_hosts=tuple(
                name.strip() for name in (get_optional("ALLOWED_HOSTS") or "").split(",") if name.strip()
            ),
        )


_MEANING = {
    "DETECTOR": "the detector's address as host:port",
    "REGISTRAR": "the registrar's address as host:port",
    "STATE": "a directory in which the orchestrator stores its sessions",
}
