"""The batches that a subscriber has not taken yet."""

from __future__ import annotations

import asyncio
from collections import deque

from pretouch_sensor_gateway.range_batch import RangeBatch

QUEUE_MEASUREMENTS = 256
"""Measurements kept for a slow subscriber: 8 s at 30 Hz. Beyond that the oldest go: fresh ranges matter most."""


class SubscriptionQueue:
    """A bounded queue of batches, and the count of measurements that its subscriber will never get.

    Attributes:
        changed: set whenever there is something new to take.
        overrun: measurements dropped so far because the queue was full, including those already missing among them.
    """

    def __init__(self) -> None:
        self.changed = asyncio.Event()
        self.overrun = 0
        self._batches: deque[RangeBatch] = deque()
        self._measurements = 0
        self._reported = 0

    def put(self, batch: RangeBatch) -> None:
        """Queues a batch, and drops the oldest ones while the queue is too long."""
        self._batches.append(batch)
        self._measurements += len(batch)
        while self._measurements > QUEUE_MEASUREMENTS and len(self._batches) > 1:
            dropped = self._batches.popleft()
            self._measurements -= len(dropped)
            self.overrun += len(dropped) + dropped.lost
        self.changed.set()

    def take(self) -> tuple[list[RangeBatch], int]:
        """All queued batches in their order, and how many measurements were dropped before them since the last call."""
        taken, overrun = list(self._batches), self.overrun - self._reported
        self._batches.clear()
        self._measurements, self._reported = 0, self.overrun
        return taken, overrun
