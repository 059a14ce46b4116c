"""The sensor gateway as a service: reads its devices from the environment and serves them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext

import grpc.aio

from pretouch.serving import ServiceContext
from pretouch.v1.sensor_gateway_pb2_grpc import add_SensorGatewayServiceServicer_to_server
from pretouch_sensor_gateway.configuration import DeviceSetting, GatewaySetting, load_configuration
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.metrics import DeviceCollector
from pretouch_sensor_gateway.recording.writer import RecordingWriter
from pretouch_sensor_gateway.replay_source import ReplaySource
from pretouch_sensor_gateway.serial_source import SerialSource
from pretouch_sensor_gateway.servicer import SensorGatewayServicer
from pretouch_sensor_gateway.source import Source
from pretouch_sensor_gateway.wire_formats.registry import create_parser


def running(server: grpc.aio.Server, context: ServiceContext) -> AbstractAsyncContextManager[tuple[str, ...]]:
    """The gateway of the devices that `PRETOUCH_GATEWAY_DEVICES` names; none is fine.

    Raises:
        InvalidInput: the variable cannot be read.
    """
    return serve(server, context, load_configuration(os.environ))


@asynccontextmanager
async def serve(
    server: grpc.aio.Server, context: ServiceContext, setting: GatewaySetting
) -> AsyncIterator[tuple[str, ...]]:
    """Opens the ports of `setting` and serves their devices.

    The gateway starts even if a port cannot be opened: ListDevices says what is wrong, and the port is tried again.
    """
    folder = setting.recordings
    with nullcontext() if folder is None else RecordingWriter(folder, context.log) as writer:
        devices = [_create_device(one, writer, context) for one in setting.devices]
        context.metrics.registry.register(DeviceCollector(devices, f"pretouch_{context.name}"))
        add_SensorGatewayServiceServicer_to_server(SensorGatewayServicer(devices, context), server)
        tasks = [asyncio.create_task(_run_device(device, context)) for device in devices]
        tasks.append(asyncio.create_task(_wake_subscribers(devices, context)))
        try:
            yield ("pretouch.v1.SensorGatewayService",)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def _create_device(setting: DeviceSetting, writer: RecordingWriter | None, context: ServiceContext) -> Device:
    recorder = None if writer is None else writer.create_recorder(setting.name)
    device = Device(setting.name, setting.address, setting.tip_T_module, setting.calibration, recorder)
    if recorder is not None and setting.record:
        recorder.start()
    device.source = _create_source(setting, device, context)
    return device


def _create_source(setting: DeviceSetting, device: Device, context: ServiceContext) -> Source:
    if setting.recording is not None:
        return ReplaySource(setting.recording, device)

    log = context.log.bind(device=setting.name)
    parser = create_parser(setting.wire_format, setting.modules, setting.no_target)
    return SerialSource(
        setting.address,
        parser,
        setting.baud,
        setting.latency,
        setting.calibration,
        device.deliver,
        device.record_event,
        log,
    )


async def _run_device(device: Device, context: ServiceContext) -> None:
    try:
        await device.run()
    except Exception:
        context.log.exception("a device failed with a defect and is no longer read", device=device.name)


async def _wake_subscribers(devices: Sequence[Device], context: ServiceContext) -> None:
    """Wakes all subscribers once the service is shutting down: their streams have no other reason to end."""
    await context.draining.wait()
    for device in devices:
        device.wake_subscribers()
