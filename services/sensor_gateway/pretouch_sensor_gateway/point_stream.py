"""One StreamPoints call: tip poses in, fused samples out, each at its own pace."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import suppress
from dataclasses import dataclass

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_from_proto
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.fusion import FusedSamples, Fusion
from pretouch_sensor_gateway.measurements import Measurements
from pretouch_sensor_gateway.subscription_queue import SubscriptionQueue
from pretouch_sensor_gateway.tip_pose_receiver import TipPoseReceiver

LINGER = 1.0
"""Seconds after the last pose's time within which the last measurements must arrive, once no more poses are sent."""


@dataclass(frozen=True, eq=False)
class FusedBatch:
    """What is to be told at once.

    Attributes:
        lost, overrun: measurements lost before these, and dropped because the call reads slowly.
        out_of_order: tip poses dropped since the last batch because one of a later time had come before.
        clock_offset, clock_offset_std: the robot's clock minus the gateway's, s, and one standard deviation of it.
        now: by the gateway's clock, s.
    """

    fused: FusedSamples
    lost: int
    overrun: int
    out_of_order: int
    clock_offset: float
    clock_offset_std: float
    now: float


class PointStream:
    """Fuses a device's measurements with the poses of one call.

    A call that sends no pose to a recording in a device's place gets the recorded ones.

    Args:
        device: whose measurements.
        first: the call's first message, which may hold poses already.
        requests: the messages that follow.
    """

    def __init__(
        self,
        device: Device,
        subscription: SubscriptionQueue,
        first: pb.StreamPointsRequest,
        requests: AsyncIterator[pb.StreamPointsRequest],
    ) -> None:
        modules = [pose_from_proto(pose, "tip_t_module") for pose in first.tip_t_module]
        self._device = device
        self._subscription = subscription
        self._receiver = TipPoseReceiver(device, first)
        self._fusion = Fusion(self._receiver.path, modules or device.tip_T_module)
        self._first = first
        self._requests = requests
        self._answer_due = False
        self._recorded = False  # whether the poses are those of a recording

    async def fuse(self, draining: asyncio.Event) -> AsyncGenerator[FusedBatch, None]:
        """Fused samples, and what was lost or dropped, whenever there are any; and the answers to who tells its clock.

        Ends when no more samples can follow the last pose, or when the service shuts down.

        Raises:
            InvalidInput: poses that cannot be used, or modules that were not described.
        """
        changed, told = self._subscription.changed, 0
        reader = asyncio.create_task(self._read_requests())
        reader.add_done_callback(lambda _: changed.set())
        try:
            while not draining.is_set():
                with suppress(TimeoutError):
                    async with asyncio.timeout(self._time_left() if reader.done() and not self._recorded else None):
                        await changed.wait()
                changed.clear()
                ended = self._device.ended
                if reader.done():
                    reader.result()
                    self._recorded = self._device.recorded_path is not None and self._receiver.path.end is None
                batches, overrun = self._subscription.take()
                for batch in batches:
                    self._fusion.add(Measurements.from_batch(batch))
                self._follow()
                fused, lost = self._fusion.take(), sum(batch.lost for batch in batches)
                out_of_order, told = self._receiver.out_of_order - told, self._receiver.out_of_order
                if len(fused.samples) or fused.unposed or lost or overrun or out_of_order or self._answer_due:
                    self._answer_due = False
                    self._device.record_points(fused)
                    yield self._batch(fused, lost, overrun, out_of_order)
                if reader.done() and (ended or (not self._recorded and self._is_over())):
                    return
        finally:
            reader.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await reader

    def _follow(self) -> None:
        """Takes the poses that were sent, or the recorded ones, of which those of another call are another path."""
        if self._recorded and self._device.recorded_path is not None:
            self._fusion.follow(self._device.recorded_path, self._device.recorded_time_std)
        else:
            self._fusion.follow(self._receiver.path, self._receiver.clock_offset_std)

    def _is_over(self) -> bool:
        """Whether no measurement that the poses enclose can follow."""
        return self._fusion.complete or self._time_left() <= 0

    def _time_left(self) -> float:
        """Seconds until no measurement that the poses enclose can arrive any more."""
        end = self._receiver.path.end
        return 0.0 if end is None else max(0.0, end + LINGER - self._device.now())

    def _batch(self, fused: FusedSamples, lost: int, overrun: int, out_of_order: int) -> FusedBatch:
        receiver = self._receiver
        now = self._device.now()
        return FusedBatch(fused, lost, overrun, out_of_order, receiver.clock_offset, receiver.clock_offset_std, now)

    async def _read_requests(self) -> None:
        self._take(self._first)
        async for request in self._requests:
            if (
                request.tip_t_module
                or request.HasField("clock_offset")
                or request.device not in ("", self._first.device)
            ):
                raise InvalidInput(
                    "A later message names a device, its modules or a clock offset.",
                    "Say them in the first message only, or start another call.",
                )
            self._take(request)

    def _take(self, request: pb.StreamPointsRequest) -> None:
        self._answer_due |= self._receiver.add(request)
        self._subscription.changed.set()
