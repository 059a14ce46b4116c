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
from pretouch_sensor_gateway.fusion import FusedSamples, Fusion
from pretouch_sensor_gateway.history import SPAN
from pretouch_sensor_gateway.measurements import Measurements
from pretouch_sensor_gateway.pose_path import PosePath
from pretouch_sensor_gateway.subscription_queue import SubscriptionQueue

LINGER = 1.0
"""Seconds after the last pose's time within which the last measurements must arrive, once no more poses are sent."""


class PointStream:
    """Fuses a device's measurements with the poses of one call.

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
        self._path = PosePath()
        self._fusion = Fusion(self._path, modules or device.tip_T_module)
        self._first = first
        self._requests = requests

    async def fuse(self, draining: asyncio.Event) -> AsyncGenerator[tuple[FusedSamples, int, int], None]:
        """Fused samples, and how many measurements were lost and overrun, whenever there are any.

        Ends when no more samples can follow the last pose, or when the service shuts down.

        Raises:
            InvalidInput: poses that cannot be used, or modules that were not described.
        """
        changed = self._subscription.changed
        reader = asyncio.create_task(self._read_requests())
        reader.add_done_callback(lambda _: changed.set())
        try:
            while not draining.is_set():
                with suppress(TimeoutError):
                    async with asyncio.timeout(self._time_left() if reader.done() else None):
                        await changed.wait()
                changed.clear()
                if reader.done():
                    reader.result()
                batches, overrun = self._subscription.take()
                for batch in batches:
                    self._fusion.add(Measurements.from_batch(batch))
                fused, lost = self._fusion.take(), sum(batch.lost for batch in batches)
                if len(fused.samples) or fused.unposed or lost or overrun:
                    yield fused, lost, overrun
                if reader.done() and (self._fusion.complete or self._time_left() <= 0):
                    return
        finally:
            reader.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await reader

    def _time_left(self) -> float:
        """Seconds until no measurement that the poses enclose can arrive any more."""
        return 0.0 if self._path.end is None else max(0.0, self._path.end + LINGER - self._device.now())

    async def _read_requests(self) -> None:
        self._add_poses(self._first)
        async for request in self._requests:
            if request.tip_t_module or request.device not in ("", self._first.device):
                raise InvalidInput(
                    "A later message names a device or its modules.",
                    "Say both in the first message only, or start another call.",
                )
            self._add_poses(request)
            self._subscription.changed.set()

    def _add_poses(self, request: pb.StreamPointsRequest) -> None:
        for tip in request.tip_poses:
            now = self._device.now()
            if not (math.isfinite(tip.t) and abs(tip.t - now) <= SPAN):
                raise InvalidInput(
                    f"A tip pose is of {tip.t:.3f} s, not within {SPAN:g} s of the device's {now:.3f} s.",
                    "Send Unix time in seconds, and keep the robot's clock and the gateway's in step (NTP).",
                )
            if self._path.end is None:
                self._device.history.add_path(self._path)
            self._path.append(tip.t, pose_from_proto(tip.base_t_tip, "base_t_tip"))
