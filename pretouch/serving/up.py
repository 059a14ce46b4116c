"""All four services of one machine in the foreground."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from pretouch.errors import DeadlineExceeded, InvalidInput
from pretouch.serving.child import Child
from pretouch.serving.logs import configure_logs
from pretouch.serving.settings import Settings

_READY_WITHIN = 300.0  # s; a first start may compile the registrar's kernels
_NOT_FOR_CHILDREN = {
    f"PRETOUCH_{option}"
    for option in ("METRICS_PORT", "TLS_CERT", "TLS_KEY", "TLS_CLIENT_CA", "ORCHESTRATOR_TLS_CA", "TOKEN")
}
"""Variables that would clash between the children; on loopback they use no TLS."""


@dataclass(frozen=True)
class Stack:
    """What `pretouch up` brings up.

    Attributes:
        host: where REST and gRPC of the orchestrator are served; the other services are on loopback.
        rest_port, grpc_port: of the orchestrator; 0 for free ones.
        state: directory of the orchestrator's sessions.
        devices: `name=port` of each serial device, for the gateway.
        token: bearer token that every service asks for; None for none.
        log_level: log lines below it are left out.

    Raises:
        InvalidInput: an invalid port, token or device.
    """

    host: str
    rest_port: int
    grpc_port: int
    state: Path
    devices: Sequence[str] = ()
    token: str | None = None
    log_level: str = "warning"

    def __post_init__(self) -> None:
        for port in (self.rest_port, self.grpc_port):
            Settings(host=self.host, port=port, token=self.token, log_level=self.log_level)
        if self.rest_port == self.grpc_port != 0:
            raise InvalidInput(f"REST and gRPC both have port {self.rest_port}.", "Give them different ports.")
        for device in self.devices:
            name, _, url = device.partition("=")
            if not name or not url or "," in device:
                raise InvalidInput(
                    f"The device {device!r} is not name=port.", "Give a name and a path or URL: finger=/dev/ttyACM0."
                )


async def up(stack: Stack, announce: Callable[[str], None]) -> None:
    """Runs `stack` until SIGTERM or SIGINT; `announce` is given one line once REST says that it is ready.

    Raises:
        Unavailable: a service ended before it was ready.
        DeadlineExceeded: a service was not ready after five minutes.
    """
    configure_logs("up", stack.log_level)
    logging.getLogger("httpx").setLevel(logging.WARNING)
    task = asyncio.current_task()
    assert task is not None
    stopping = False

    def stop() -> None:
        nonlocal stopping
        if not stopping:
            stopping = True
            task.cancel()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop)
    children: list[Child] = []
    try:
        async with asyncio.timeout(_READY_WITHIN):
            line = await _start(stack, children)
        announce(line)
        await asyncio.Event().wait()
    except asyncio.CancelledError:
        if not stopping:
            raise
        task.uncancel()
    except TimeoutError as error:
        raise DeadlineExceeded(
            f"The services were not ready after {_READY_WITHIN:g} s.", "Try again with --log-level info and see why."
        ) from error
    finally:
        while children:  # the orchestrator first: it calls the others
            last = children.pop()
            await last.stop()


async def _start(stack: Stack, children: list[Child]) -> str:
    """Starts the children, each as soon as what it needs is there; the ready line."""
    common = {key: value for key, value in os.environ.items() if key not in _NOT_FOR_CHILDREN}
    common.setdefault("GRPC_VERBOSITY", "ERROR")  # gRPC's core logs every peer that leaves, in its own format
    common["PRETOUCH_LOG_LEVEL"] = "debug" if stack.log_level == "debug" else "info"
    if stack.token is not None:
        common["PRETOUCH_TOKEN"] = stack.token

    def start(name: str, host: str, port: int, own: dict[str, str]) -> Child:
        prefix = f"PRETOUCH_{name.upper()}_"
        environment = common | {prefix + key: value for key, value in own.items()}
        children.append(Child(name, host, port, environment, _forward(stack.log_level)))
        return children[-1]

    inner = [
        start("detector", "127.0.0.1", 0, {}),
        start("registrar", "127.0.0.1", 0, {}),
        start("gateway", "127.0.0.1", 0, {"DEVICES": ",".join(stack.devices)} if stack.devices else {}),
    ]
    addresses = {child.name.upper(): f"127.0.0.1:{await child.wait_until_ready()}" for child in inner}
    rest_port = stack.rest_port or _free_port(stack.host)
    own = {"REST_HOST": stack.host, "REST_PORT": str(rest_port), "STATE": str(stack.state), **addresses}
    grpc_port = await start("orchestrator", stack.host, stack.grpc_port, own).wait_until_ready()
    rest = f"http://{Settings(host=_reachable_address(stack.host)).address(rest_port)}"
    await _wait_for_rest(rest)
    grpc = Settings(host=_reachable_address(stack.host)).address(grpc_port)
    return f"pretouch is ready: REST {rest}, gRPC {grpc}, gateway {addresses['GATEWAY']}"


async def _wait_for_rest(rest: str) -> None:
    async with httpx.AsyncClient(timeout=5.0, trust_env=False) as client:
        while True:
            with suppress(httpx.HTTPError):
                if (await client.get(f"{rest}/readyz")).status_code == 200:
                    return
            await asyncio.sleep(0.1)


def _reachable_address(host: str) -> str:
    """An address under which this machine reaches `host`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)


def _free_port(host: str) -> int:
    with socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET) as server:
        return int(server.getsockname()[1])


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
