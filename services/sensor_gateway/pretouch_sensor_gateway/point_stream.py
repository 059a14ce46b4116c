"""One StreamPoints call: tip poses in, fused samples out, each at its own pace."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import suppress

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_from_proto
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.frames import Frames
from pretouch_sensor_gateway.fusion import Fused, Fusion
from pretouch_sensor_gateway.history import SPAN
from pretouch_sensor_gateway.poses import PosePath
from pretouch_sensor_gateway.subscription import Subscription

LINGER = 1.0
"""Seconds after the last pose's time in which the last frames must have come, once the robot sends no more poses."""


class PointStream:
    """Fuses a device's frames with the poses of one call.

    Args:
        device: whose frames.
        first: the call's first message, which may hold poses already.
        requests: the messages that follow.
    """

    def __init__(
        self,
        device: Device,
        subscription: Subscription,
        first: pb.StreamPointsRequest,
        requests: AsyncIterator[pb.StreamPointsRequest],
    ) -> None:
        modules = [pose_from_proto(pose, "tip_t_module") for pose in first.tip_t_module]
        self._device = device
        self._subscription = subscription
        self._path = PosePath()
        self._fusion = Fusion(self._path, modules or device.tip_T_module, device.std_at)
        self._first = first
        self._requests = requests

    async def batches(self, draining: asyncio.Event) -> AsyncGenerator[tuple[Fused, int, int], None]:
        """What was fused, and how many frames were lost and overrun, whenever there is any.

        Ends with the last pose, or with the service.

        Raises:
            InvalidInput: poses that cannot be used, or modules that were not described.
        """
        changed = self._subscription.changed
        reader = asyncio.create_task(self._read())
        reader.add_done_callback(lambda _: changed.set())
        try:
            while not draining.is_set():
                with suppress(TimeoutError):
                    async with asyncio.timeout(self._patience() if reader.done() else None):
                        await changed.wait()
                changed.clear()
                if reader.done():
                    reader.result()
                deliveries, overrun = self._subscription.take()
                for delivery in deliveries:
                    self._fusion.add(Frames.of(delivery.batch))
                fused, lost = self._fusion.take(), sum(delivery.batch.lost for delivery in deliveries)
                if len(fused.samples) or fused.unposed or lost or overrun:
                    yield fused, lost, overrun
                if reader.done() and (self._fusion.complete or self._patience() <= 0):
                    return
        finally:
            reader.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await reader

    def _patience(self) -> float:
        """Seconds until no frame that the poses enclose can come any more."""
        return 0.0 if self._path.end is None else max(0.0, self._path.end + LINGER - self._device.now())

    async def _read(self) -> None:
        self._take_poses(self._first)
        async for request in self._requests:
            if request.tip_t_module or request.device not in ("", self._first.device):
                raise InvalidInput(
                    "A later message names a device or its modules.",
                    "Say both in the first message only, or start another call.",
                )
            self._take_poses(request)
            self._subscription.changed.set()

    def _take_poses(self, request: pb.StreamPointsRequest) -> None:
        for tip in request.tip_poses:
            now = self._device.now()
            if not (math.isfinite(tip.t) and abs(tip.t - now) <= SPAN):
                raise InvalidInput(
                    f"A tip pose is of {tip.t:.3f} s, not within {SPAN:g} s of the device's {now:.3f} s.",
                    "Send seconds since the Unix epoch, and keep the robot's clock and the gateway's in step (NTP).",
                )
            if self._path.end is None:
                self._device.history.remember(self._path)
            self._path.append(tip.t, pose_from_proto(tip.base_t_tip, "base_t_tip"))
