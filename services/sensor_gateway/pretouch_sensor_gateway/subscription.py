"""What one listener of a device has not yet been given."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass

QUEUE_FRAMES = 256
"""Frames kept for a slow listener: 8 s at 30 Hz. Of more it loses the oldest, for a range is worth most fresh."""


@dataclass(frozen=True)
class TimedFrame:
    """One measurement of all modules of a device, at its time.

    Attributes:
        sequence: the device's own count; 32 bits, wraps.
        t: s since the Unix epoch on the host clock.
        ranges: m along each module's beam, NaN where it gave none.
        status: each module's status code, 0 is good.
    """

    sequence: int
    t: float
    ranges: tuple[float, ...]
    status: tuple[int, ...]


class Subscription:
    """A bounded queue of frames, and the count of those that its listener will never get.

    Attributes:
        changed: set whenever there is something new to take.
    """

    def __init__(self) -> None:
        self.changed = asyncio.Event()
        self._frames: deque[TimedFrame] = deque()
        self._lost = 0

    def offer(self, frame: TimedFrame) -> None:
        """Queues `frame`; the oldest goes if the queue is full."""
        if len(self._frames) == QUEUE_FRAMES:
            self._frames.popleft()
            self._lost += 1
        self._frames.append(frame)
        self.changed.set()

    def miss(self, count: int) -> None:
        """Counts frames that the device sent and nobody received."""
        self._lost += count

    def take(self) -> tuple[list[TimedFrame], int]:
        """All queued frames in their order, and how many were lost since the last call."""
        frames, lost = list(self._frames), self._lost
        self._frames.clear()
        self._lost = 0
        return frames, lost
