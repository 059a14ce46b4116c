"""The sensor gateway as a service: reads its devices from the environment and serves them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import grpc.aio

from pretouch.serving import Kit
from pretouch.v1.sensor_gateway_pb2_grpc import add_SensorGatewayServiceServicer_to_server
from pretouch_sensor_gateway.configuration import devices_from
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.metrics import DeviceCollector
from pretouch_sensor_gateway.servicer import SensorGatewayServicer


@asynccontextmanager
async def running(server: grpc.aio.Server, kit: Kit) -> AsyncIterator[tuple[str, ...]]:
    """Opens the ports that `PRETOUCH_GATEWAY_DEVICES` names (none is fine) and answers for them.

    A port that cannot be opened is no reason not to start: ListDevices says what is wrong, and it is tried again.

    Raises:
        InvalidInput: the variable cannot be read.
    """
    devices = [Device(setting.name, setting.port, kit.log) for setting in devices_from(os.environ)]
    kit.metrics.registry.register(DeviceCollector(devices, f"pretouch_{kit.name}"))
    add_SensorGatewayServiceServicer_to_server(SensorGatewayServicer(devices, kit), server)
    tasks = [asyncio.create_task(_kept_running(device, kit)) for device in devices]
    tasks.append(asyncio.create_task(_wake_listeners(devices, kit)))
    try:
        yield ("pretouch.v1.SensorGatewayService",)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _kept_running(device: Device, kit: Kit) -> None:
    try:
        await device.run()
    except Exception:
        kit.log.exception("a device met a defect and is no longer read", device=device.name)


async def _wake_listeners(devices: Sequence[Device], kit: Kit) -> None:
    """Streams have no end of their own: once the service is told to stop, they look up and end."""
    await kit.draining.wait()
    for device in devices:
        device.wake()
