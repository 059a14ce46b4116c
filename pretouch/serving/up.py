"""All four services of one machine in the foreground."""

from __future__ import annotations

import asyncio
import logging
import os
import secrets
import socket
import sys
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

from pretouch.errors import DeadlineExceeded, InvalidInput
from pretouch.results import check_folder
from pretouch.serving.child import READY_WITHIN, Child, serve_command
from pretouch.serving.live_view import NOTHING_SHOWN, LiveView
from pretouch.serving.logs import configure_logs
from pretouch.serving.memory import find_total_memory
from pretouch.serving.probing import PATIENT, Probing
from pretouch.serving.process import ended_by_signals
from pretouch.serving.settings import Settings
from pretouch.serving.tokens import read_tokens
from pretouch.tls import server_credentials

_NOT_FOR_CHILDREN = {
    f"PRETOUCH_{option}"
    for option in (
        "METRICS_PORT",
        "TLS_CERT",
        "TLS_KEY",
        "TLS_CLIENT_CA",
        "ORCHESTRATOR_TLS_CA",
        "TOKEN",
        "TOKENS_FILE",
        "OPEN_METRICS",
    )
}
"""Variables that would clash between the children; on loopback they use no TLS."""


@dataclass(frozen=True)
class Stack:
    """What `pretouch up` brings up.

    Attributes:
        settings: of the orchestrator. Its host is REST's too; its token and log level are all services'; its TLS is for
            those who call it: the other services are on loopback, where they speak plainly.
        rest_port, gateway_port: 0 for free ones.
        state: directory of the orchestrator's sessions.
        devices: `name=port` of each serial device, for the gateway.
        probing: how it is found out that a service hangs.
        view: what shows the sessions to viewers.

    Raises:
        InvalidInput: an invalid port or device, or a view that cannot be had with the settings.
        Unavailable: what the view needs is not installed.
    """

    settings: Settings
    rest_port: int
    gateway_port: int
    state: Path
    devices: Sequence[str] = ()
    probing: Probing = PATIENT
    view: LiveView = NOTHING_SHOWN

    def __post_init__(self) -> None:
        if self.view:
            self.view.check(self.settings)
        ports = {"REST": self.rest_port, "gRPC": self.settings.port, "the gateway": self.gateway_port}
        for port in ports.values():
            replace(self.settings, port=port)
        for (one, port), (other, same) in combinations(ports.items(), 2):
            if port == same != 0:
                raise InvalidInput(f"{one} and {other} both have port {port}.", "Give them different ports.")
        for device in self.devices:
            name, _, url = device.partition("=")
            if not name or not url or "," in device:
                raise InvalidInput(
                    f"The device {device!r} is not name=port.", "Give a name and a path or URL: finger=/dev/ttyACM0."
                )
        names = [device.partition("=")[0] for device in self.devices]
        if len(set(names)) < len(names):
            raise InvalidInput(f"Two devices have the same name: {', '.join(names)}.", "Give each its own name.")


async def up(stack: Stack, announce: Callable[[str], None], *, until_stdin_closes: bool = False) -> None:
    """Runs `stack` until SIGTERM or SIGINT; `announce` is given one line once all services are ready.

    `until_stdin_closes` ends it too when standard input does, so that it cannot outlive who started it.

    Raises:
        InvalidInput: TLS material or a file of tokens that cannot be used, or a state directory that cannot be written.
        Unavailable: a service ended before it was ready.
        DeadlineExceeded: a service was not ready after five minutes.
    """
    outer = stack.settings
    if outer.tls_cert is not None and outer.tls_key is not None:
        server_credentials(outer.tls_cert, outer.tls_key, outer.tls_client_ca)
    if outer.tokens_file is not None:
        read_tokens(outer.tokens_file)
    check_folder(stack.state)
    configure_logs("up", outer.log_level)
    children: list[Child] = []
    try:
        with _reserved_port(outer.host, stack.rest_port) as rest_port:
            async with ended_by_signals(until_stdin_closes=until_stdin_closes):
                async with asyncio.timeout(READY_WITHIN):
                    line = await _start(stack, rest_port, children)
                announce(line)
                async with _shown(stack, rest_port):
                    await asyncio.Event().wait()
    except TimeoutError as error:
        raise DeadlineExceeded(
            f"The services were not ready after {READY_WITHIN:g} s.", "Try again with --log-level info and see why."
        ) from error
    finally:
        while children:  # the orchestrator first: it calls the others
            last = children.pop()
            await last.stop()


async def _start(stack: Stack, rest_port: int, children: list[Child]) -> str:
    """Starts the children, each as soon as what it needs is there; the ready line."""
    common = {key: value for key, value in os.environ.items() if key not in _NOT_FOR_CHILDREN}
    common.setdefault("GRPC_VERBOSITY", "ERROR")  # gRPC's core logs every peer that leaves, in its own format
    common.setdefault("PRETOUCH_MEMORY", str(find_total_memory() // 4))
    common["PRETOUCH_LOG_LEVEL"] = "debug" if stack.settings.log_level == "debug" else "info"
    common |= _pass_tokens_on(stack.settings)

    def start(name: str, host: str, port: int, own: dict[str, str]) -> Child:
        command = serve_command(name, "--host", host)
        forward = _forward(stack.settings.log_level)
        child = Child(name, command, port, common | own, forward, probing=stack.probing)
        children.append(child)
        return child

    devices = {"PRETOUCH_GATEWAY_DEVICES": ",".join(stack.devices)} if stack.devices else {}
    inner = [
        start("detector", "127.0.0.1", 0, {}),
        start("registrar", "127.0.0.1", 0, {}),
        start("gateway", "127.0.0.1", stack.gateway_port, devices),
    ]
    addresses = {child.name: f"127.0.0.1:{await child.wait_until_ready()}" for child in inner}
    outer = stack.settings
    own = {"REST_HOST": outer.host, "REST_PORT": str(rest_port), "STATE": str(stack.state)}
    own |= {name.upper(): address for name, address in addresses.items()}
    tls = {"CERT": outer.tls_cert, "KEY": outer.tls_key, "CLIENT_CA": outer.tls_client_ca}
    variables = {f"PRETOUCH_ORCHESTRATOR_{key}": value for key, value in own.items()}
    if outer.open_metrics:
        variables["PRETOUCH_OPEN_METRICS"] = "1"
    variables |= {f"PRETOUCH_TLS_{key}": str(path) for key, path in tls.items() if path is not None}
    orchestrator = start("orchestrator", outer.host, outer.port, variables)
    grpc_port = await orchestrator.wait_until_ready()
    reachable = replace(outer, host=_reachable_address(outer.host))
    rest = f"{'http' if outer.tls_cert is None else 'https'}://{reachable.address(rest_port)}"
    return f"pretouch is ready: REST {rest}, gRPC {reachable.address(grpc_port)}, gateway {addresses['gateway']}"


@asynccontextmanager
async def _shown(stack: Stack, rest_port: int) -> AsyncIterator[None]:
    """Shows the sessions while the block lasts, if that is wanted."""
    if not stack.view:
        yield
        return
    url = f"http://{replace(stack.settings, host=_reachable_address(stack.settings.host)).address(rest_port)}"
    environment = {key: value for key, value in os.environ.items() if key not in _NOT_FOR_CHILDREN}
    async with stack.view.running(url, environment | _pass_tokens_on(stack.settings)):
        yield


def _pass_tokens_on(settings: Settings) -> dict[str, str]:
    """The children's variables: they know the same tokens, and one by which the orchestrator calls the others."""
    if settings.tokens_file is None:
        return {} if settings.token is None else {"PRETOUCH_TOKEN": settings.token}
    return {
        "PRETOUCH_TOKENS_FILE": str(settings.tokens_file.absolute()),
        "PRETOUCH_TOKEN": settings.token or secrets.token_urlsafe(32),
    }


def _reachable_address(host: str) -> str:
    """An address under which this machine reaches `host`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)


@contextmanager
def _reserved_port(host: str, port: int) -> Iterator[int]:
    """`port`; for 0 a free one, which nobody is given while the block lasts.

    It is bound and does not listen, so that only a server with SO_REUSEADDR, as the orchestrator's, can bind it too.
    """
    if port:
        yield port
        return
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as reservation:
        reservation.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            reservation.bind((host, 0))
        except OSError as error:
            raise InvalidInput(
                f"{host} is no address of this machine: {error.strerror}.", "Give 127.0.0.1, or 0.0.0.0 for all."
            ) from error
        yield int(reservation.getsockname()[1])


def _forward(level: str) -> Callable[[bytes, dict[str, Any]], None]:
    """Writes log lines of at least `level`, and lines that are no log lines, to standard error."""
    lowest = logging.getLevelNamesMapping()[level.upper()]

    def forward(line: bytes, fields: dict[str, Any]) -> None:
        name = str(fields.get("level", "critical")).upper()
        if logging.getLevelNamesMapping().get(name, logging.CRITICAL) >= lowest:
            with suppress(OSError):  # nobody may read our log any more; the services go on
                sys.stderr.buffer.write(line)
                sys.stderr.buffer.flush()

    return forward
