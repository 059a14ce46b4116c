"""What one listener of a device has not yet been given."""

from __future__ import annotations

import asyncio
from collections import deque

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.wire import batch_to_proto

QUEUE_FRAMES = 256
"""Frames kept for a slow listener: 8 s at 30 Hz. Of more it loses the oldest, for a range is worth most fresh."""


class Delivery:
    """A batch on its way to all listeners, packed once for all of them, when the first one wants it.

    Args:
        packed: the batch's message, where it came as one.
    """

    def __init__(self, batch: Batch, packed: pb.RangeBatch | None = None) -> None:
        self.batch = batch
        self._packed = packed

    @property
    def message(self) -> pb.RangeBatch:
        if self._packed is None:
            self._packed = batch_to_proto(self.batch)
        return self._packed


class Subscription:
    """A bounded queue of batches, and the count of frames that its listener will never get.

    Attributes:
        changed: set whenever there is something new to take.
        overrun: frames lost so far because the queue was full, with those missing among them.
    """

    def __init__(self) -> None:
        self.changed = asyncio.Event()
        self.overrun = 0
        self._queue: deque[Delivery] = deque()
        self._frames = 0
        self._told = 0

    def offer(self, delivery: Delivery) -> None:
        """Queues a batch; the oldest ones go while the queue is too long."""
        self._queue.append(delivery)
        self._frames += len(delivery.batch)
        while self._frames > QUEUE_FRAMES and len(self._queue) > 1:
            dropped = self._queue.popleft().batch
            self._frames -= len(dropped)
            self.overrun += len(dropped) + dropped.lost
        self.changed.set()

    def take(self) -> tuple[list[Delivery], int]:
        """All queued batches in their order, and the frames lost before them since the last call."""
        taken, overrun = list(self._queue), self.overrun - self._told
        self._queue.clear()
        self._frames, self._told = 0, self.overrun
        return taken, overrun
