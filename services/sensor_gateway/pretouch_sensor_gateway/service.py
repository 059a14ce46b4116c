"""The sensor gateway as a service: reads its devices from the environment and serves them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext

import grpc.aio

from pretouch.serving import ServiceContext
from pretouch.v1.sensor_gateway_pb2_grpc import add_SensorGatewayServiceServicer_to_server
from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.configuration import DeviceSetting, GatewaySetting, gateway_from
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.metrics import DeviceCollector
from pretouch_sensor_gateway.recording.writer import RecordingWriter
from pretouch_sensor_gateway.replayed_source import ReplayedSource
from pretouch_sensor_gateway.serial_source import SerialSource
from pretouch_sensor_gateway.servicer import SensorGatewayServicer
from pretouch_sensor_gateway.source import Source
from pretouch_sensor_gateway.subscription import Delivery
from pretouch_sensor_gateway.wire_formats.recognition import format_named


def running(server: grpc.aio.Server, context: ServiceContext) -> AbstractAsyncContextManager[tuple[str, ...]]:
    """The gateway of the devices that `PRETOUCH_GATEWAY_DEVICES` names; none is fine.

    Raises:
        InvalidInput: the variable cannot be read.
    """
    return serving(server, context, gateway_from(os.environ))


@asynccontextmanager
async def serving(
    server: grpc.aio.Server, context: ServiceContext, setting: GatewaySetting
) -> AsyncIterator[tuple[str, ...]]:
    """Opens the ports of `setting` and answers for them.

    A port that cannot be opened is no reason not to start: ListDevices says what is wrong, and it is tried again.
    """
    folder = setting.recordings
    with nullcontext() if folder is None else RecordingWriter(folder, context.log) as writer:
        devices = [_device(one, writer, context) for one in setting.devices]
        context.metrics.registry.register(DeviceCollector(devices, f"pretouch_{context.name}"))
        add_SensorGatewayServiceServicer_to_server(SensorGatewayServicer(devices, context), server)
        tasks = [asyncio.create_task(_kept_running(device, context)) for device in devices]
        tasks.append(asyncio.create_task(_wake_listeners(devices, context)))
        try:
            yield ("pretouch.v1.SensorGatewayService",)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def _device(setting: DeviceSetting, writer: RecordingWriter | None, context: ServiceContext) -> Device:
    recorder = None if writer is None else writer.recorder(setting.name)
    device = Device(setting.name, setting.address, setting.tip_T_module, setting.calibration, recorder)
    if recorder is not None and setting.record:
        recorder.start()
    device.source = _source(setting, device, context)
    return device


def _source(setting: DeviceSetting, device: Device, context: ServiceContext) -> Source:
    if setting.recording is not None:
        return ReplayedSource(setting.recording, device.deliver)

    def deliver(batch: Batch) -> None:
        device.deliver(Delivery(batch))

    log = context.log.bind(device=setting.name)
    wire_format = format_named(setting.wire_format)
    return SerialSource(setting.address, wire_format, setting.baud, setting.calibration, deliver, device.happened, log)


async def _kept_running(device: Device, context: ServiceContext) -> None:
    try:
        await device.run()
    except Exception:
        context.log.exception("a device met a defect and is no longer read", device=device.name)


async def _wake_listeners(devices: Sequence[Device], context: ServiceContext) -> None:
    """Streams have no end of their own: once the service is told to stop, they look up and end."""
    await context.draining.wait()
    for device in devices:
        device.wake()
