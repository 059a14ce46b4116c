"""SensorGatewayService over gRPC."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing
from typing import Any

from pretouch.errors import InvalidInput, NotFound, Unavailable
from pretouch.serving import ServiceContext
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceServicer
from pretouch.wire.common import pose_from_proto, samples_to_proto
from pretouch_sensor_gateway.calibration.proto_conversion import calibration_from_proto
from pretouch_sensor_gateway.configuration import VARIABLE
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.fusion import fuse_span
from pretouch_sensor_gateway.point_stream import PointStream
from pretouch_sensor_gateway.proto_conversion import device_to_proto, points_to_proto, status_to_proto


class SensorGatewayServicer(SensorGatewayServiceServicer):
    """Serves `devices`."""

    def __init__(self, devices: Sequence[Device], context: ServiceContext) -> None:
        self._devices = {device.name: device for device in devices}
        self._context = context

    async def ListDevices(self, request: pb.ListDevicesRequest, context: Any) -> pb.ListDevicesResponse:
        return pb.ListDevicesResponse(devices=[device_to_proto(device) for device in self._devices.values()])

    async def GetStatus(self, request: pb.GetStatusRequest, context: Any) -> pb.GetStatusResponse:
        return status_to_proto(self._device(request.device))

    async def Configure(self, request: pb.ConfigureRequest, context: Any) -> pb.ConfigureResponse:
        device = self._device(request.device)
        device.configure(
            tip_T_module=[pose_from_proto(pose, f"tip_t_module[{k}]") for k, pose in enumerate(request.tip_t_module)],
            calibration=calibration_from_proto(request.calibration) if request.HasField("calibration") else None,
            recording=request.recording if request.HasField("recording") else None,
        )
        return pb.ConfigureResponse(configuration=device.configuration())

    async def StreamRanges(
        self, request: pb.StreamRangesRequest, context: Any
    ) -> AsyncIterator[pb.StreamRangesResponse]:
        with self._device(request.device).subscribe() as subscription:
            await context.send_initial_metadata(())  # lets the client know that from now on it gets every batch
            while True:
                await subscription.changed.wait()
                subscription.changed.clear()
                if self._context.draining.is_set():
                    raise _explain_shutdown()
                batches, overrun = subscription.take()
                for batch in batches:
                    yield pb.StreamRangesResponse(batch=batch.message, overrun=overrun)
                    overrun = 0

    async def StreamPoints(
        self, request_iterator: AsyncIterator[pb.StreamPointsRequest], context: Any
    ) -> AsyncIterator[pb.StreamPointsResponse]:
        requests = aiter(request_iterator)
        first = await anext(requests, None)
        if first is None:
            raise InvalidInput("The call ended without a message.", "Send a first message that names the device.")
        device = self._device(first.device)
        with device.subscribe() as subscription:
            await context.send_initial_metadata(())
            stream = PointStream(device, subscription, first, requests)
            async with aclosing(stream.fuse(self._context.draining)) as responses:
                async for batch in responses:
                    yield points_to_proto(batch)
            if self._context.draining.is_set():
                raise _explain_shutdown()

    async def GetSamples(self, request: pb.GetSamplesRequest, context: Any) -> pb.GetSamplesResponse:
        start, end = getattr(request, "from"), request.to
        if not (math.isfinite(start) and math.isfinite(end) and start <= end):
            raise InvalidInput(
                f"The span from {start:g} to {end:g} is not valid.", "Send Unix times in seconds, from before to."
            )
        span = self._device(request.device).history.between(start, end)
        return pb.GetSamplesResponse(samples=samples_to_proto(await self._context.run_in_thread(fuse_span, *span)))

    def _device(self, name: str) -> Device:
        """The device of that name; the only one if the name is empty."""
        if not self._devices:
            raise NotFound("The gateway has no device.", f"Start it with {VARIABLE}=name=port.")
        known = ", ".join(self._devices)
        if name == "" and len(self._devices) > 1:
            raise InvalidInput(
                f"The gateway has {len(self._devices)} devices.", f"Name one of {known}: ListDevices tells how each is."
            )
        if name and name not in self._devices:
            raise NotFound(f"There is no device {name!r}.", f"Name one of {known}: ListDevices tells how each is.")
        return self._devices[name or next(iter(self._devices))]


def _explain_shutdown() -> Unavailable:
    return Unavailable("The gateway is shutting down.", "Connect again in a few seconds.")
