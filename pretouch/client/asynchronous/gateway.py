"""The client of the sensor gateway."""

# ruff: noqa: ASYNC109 -- a call's timeout covers its retries, which a timeout around the call could not tell apart

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterable, AsyncIterator, Callable, Sequence
from typing import Any

from pretouch.channel import open_channel
from pretouch.client.api import Call
from pretouch.client.arguments import FilePath, as_path, failing_as
from pretouch.client.asynchronous.calls import REPORT, AsyncCalls
from pretouch.client.gateway_api import (
    GATEWAY_ADDRESS,
    Points,
    Ranges,
    RobotClock,
    TimedPose,
    configure_request,
    first_request,
    points_of,
    pose_request,
    ranges_of,
    samples_request,
)
from pretouch.client.grpc_api import RpcMessage
from pretouch.client.retries import TIMEOUT
from pretouch.client.rpc_errors import raising_rpc_errors
from pretouch.client.signals import AsyncSignal
from pretouch.errors import Internal
from pretouch.geometry import Pose
from pretouch.tof import RangeSamples
from pretouch.tracing import propagated
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import samples_from_proto


class AsyncGatewayClient(AsyncCalls[RpcMessage, Any]):
    """A client of the sensor gateway; an asynchronous one is opened in the event loop that it is used in.

    `device` is a device's name; left out: the gateway's only one. All methods raise the errors of `pretouch.errors`.

    Args:
        address: `host:port`.
        token: the gateway's bearer token, if it requires one.
        tls_ca: PEM file of the certificate authority to trust; left out: the connection is not encrypted.
        tls_cert, tls_key: PEM files of this client's certificate, if the gateway requires one.
        timeout: s for a whole call, retries included; streams go on for as long as they are read.
    """

    def __init__(
        self,
        address: str = GATEWAY_ADDRESS,
        *,
        token: str | None = None,
        tls_ca: FilePath | None = None,
        tls_cert: FilePath | None = None,
        tls_key: FilePath | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(timeout)
        self._channel = open_channel(address, token, as_path(tls_ca), as_path(tls_cert), as_path(tls_key))
        self._stub = SensorGatewayServiceStub(self._channel)

    async def close(self) -> None:
        await super().close()
        await self._channel.close()

    async def devices(self, *, timeout: float | None = None) -> tuple[pb.Device, ...]:
        """Returns the devices, each with its state and what is wrong with it."""
        message = RpcMessage("ListDevices", pb.ListDevicesRequest())
        return await self._run(lambda: Call(message, lambda answer: tuple(answer.devices)), timeout)

    async def status(self, device: str = "", *, timeout: float | None = None) -> pb.GetStatusResponse:
        """Returns all that is known about a device."""
        message = RpcMessage("GetStatus", pb.GetStatusRequest(device=device))
        answer: pb.GetStatusResponse = await self._run(lambda: Call(message, lambda answer: answer), timeout)
        return answer

    async def configure(
        self,
        device: str = "",
        *,
        tip_T_module: Sequence[Pose] = (),
        calibration: pb.Calibration | None = None,
        recording: bool | None = None,
        timeout: float | None = None,
    ) -> pb.DeviceConfiguration:
        """Changes what is given of a device's configuration until the gateway ends; returns the whole of it."""
        configuration: pb.DeviceConfiguration = await self._run(
            lambda: Call(
                RpcMessage("Configure", configure_request(device, tip_T_module, calibration, recording)),
                lambda answer: answer.configuration,
            ),
            timeout,
        )
        return configuration

    async def samples(
        self, start: float, end: float, device: str = "", *, timeout: float | None = None
    ) -> RangeSamples:
        """Returns the samples of a past span of time, s by the gateway's clock, with the tip poses that it was sent."""
        message = RpcMessage("GetSamples", samples_request(device, start, end))
        return await self._run(lambda: Call(message, lambda answer: samples_from_proto(answer.samples)), timeout)

    async def ranges(self, device: str = "") -> AsyncIterator[Ranges]:
        """Yields a device's ranges as they arrive, until the program stops reading or the gateway ends."""
        self._check_open()
        call = self._stub.StreamRanges(pb.StreamRangesRequest(device=device), metadata=tuple(propagated().items()))
        try:
            with failing_as(Internal, "The stream of ranges failed", REPORT), raising_rpc_errors():
                async for response in call:
                    yield ranges_of(response)
        finally:
            call.cancel()

    async def points(
        self,
        poses: AsyncIterable[TimedPose],
        device: str = "",
        *,
        tip_T_module: Sequence[Pose] = (),
        clock_offset: float | None = None,
        clock: Callable[[], float] | None = None,
    ) -> AsyncIterator[Points]:
        """Sends tip poses and yields points in base, until the last pose's samples have come.

        Poses that are given as the robot moves are sent as they come; those of a planned motion at once.

        Args:
            poses: times, s, and base_T_tip, in the order of time, 10 a second or more.
            tip_T_module: pose of each module in the tip frame; left out: as the gateway is configured.
            clock_offset: the clock of the poses' times minus the gateway's, s; left out: they are the same clock.
            clock: the clock of the poses' times, from which that offset is estimated instead, such as `time.time` of
                a machine without NTP.
        """
        self._check_open()
        robot_clock, answered = RobotClock(clock), AsyncSignal()
        first = first_request(device, tip_T_module, clock_offset, robot_clock)
        failures: list[Exception] = []

        async def tell() -> AsyncGenerator[pb.StreamPointsRequest]:
            yield first
            if robot_clock.told:
                await answered.wait()
            try:
                async for pose in poses:
                    yield pose_request(pose, robot_clock)
            except Exception as failure:  # gRPC would only say that the call was cancelled
                failures.append(failure)

        call = self._stub.StreamPoints(tell(), metadata=tuple(propagated().items()))
        try:
            with failing_as(Internal, "The stream of points failed", REPORT), raising_rpc_errors():
                async for response in call:
                    robot_clock.note(response)
                    answered.set()
                    yield points_of(response)
        finally:
            call.cancel()
            answered.set()
        if failures:
            raise failures[0]

    async def _send(self, message: RpcMessage, seconds: float) -> Any:
        with raising_rpc_errors():
            return await getattr(self._stub, message.method)(
                message.request, timeout=seconds, metadata=tuple(propagated().items())
            )
