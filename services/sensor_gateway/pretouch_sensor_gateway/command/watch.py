"""`pretouch gateway watch`: shows a gateway's devices in a terminal."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from pretouch.channel import open_channel
from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.errors import InvalidInput, Unavailable
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch_sensor_gateway.command.defaults import DEFAULT_GATEWAY
from pretouch_sensor_gateway.transport.address import DEFAULT_BAUD
from pretouch_sensor_gateway.watch.feed import Feed
from pretouch_sensor_gateway.watch.state import Watch
from pretouch_sensor_gateway.watch.terminal import show


class Access(NamedTuple):
    """A gateway's address and the credentials for it; fields as `open_channel` takes them."""

    address: str
    token: str | None = None
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None


def watch(
    gateway: Annotated[
        str | None, typer.Option(help="host:port of a running gateway.", show_default=DEFAULT_GATEWAY)
    ] = None,
    device: Annotated[str, typer.Option(help="Only the device of this name.", show_default="all")] = "",
    port: Annotated[
        str | None,
        typer.Option(
            help="Read a device without a running gateway: its path, usb:VID:PID, socket://host:port, or "
            "replay:FILE for a recording of one."
        ),
    ] = None,
    wire_format: Annotated[
        str, typer.Option("--format", help="With --port: the device's wire format; auto recognises it.")
    ] = "auto",
    baud: Annotated[int, typer.Option(help="With --port: bits a second of a real UART.")] = DEFAULT_BAUD,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="End by itself after so long.", show_default="when told to")
    ] = None,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Show live ranges, rates, drops and clock of the devices, or log them line by line where there is no terminal."""
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # gRPC's own messages would disturb the view
    if port is None:
        asyncio.run(_watch(Access(gateway or DEFAULT_GATEWAY, token, tls_ca, tls_cert, tls_key), device, seconds))
        return
    if gateway is not None or device:
        raise InvalidInput("--port reads a device without a running gateway.", "Leave out --gateway and --device.")
    from pretouch_sensor_gateway.command.local_gateway import (
        run_local_gateway,  # needs what reads ports, which watching does not
    )

    with run_local_gateway(port, wire_format, baud) as address:
        watched = asyncio.run(_watch(Access(address), "", seconds))
    if not any(each.readings for each in watched.devices):
        problems = [each.status.device.problem for each in watched.devices if each.status.device.problem]
        raise Unavailable(" ".join(problems) or f"No range came from {port}.", "Check the port and what is on it.")


async def _watch(access: Access, device: str, seconds: float | None) -> Watch:
    """Watches until the user quits or `seconds` have passed; what was seen.

    Raises:
        PretouchError: an error that a retry does not fix, or the gateway never answered.
    """
    watched = Watch(access.address)
    async with open_channel(*access) as channel:
        feeding = asyncio.create_task(Feed(SensorGatewayServiceStub(channel), watched, device).run())
        showing = asyncio.create_task(show(watched, seconds))
        await asyncio.wait({feeding, showing}, return_when=asyncio.FIRST_COMPLETED)
        for task in (feeding, showing):
            task.cancel()
        for result in await asyncio.gather(feeding, showing, return_exceptions=True):
            if isinstance(result, Exception):
                raise result
    if not watched.heard:
        raise Unavailable(watched.problem or f"No gateway answers at {access.address}.", "Check that it runs.")
    return watched
