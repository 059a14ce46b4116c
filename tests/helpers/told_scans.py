"""Samples that are told while the robot moves, for tests of all that takes them."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Generator

from helpers.box_session import WORLD
from pretouch.client import ScanPiece
from pretouch.session import SampleChunk, ScanPlan
from pretouch.tof import RangeSamples, Sensor

NOTHING = RangeSamples.concatenate([])
PIECE = 8
"""Samples of a piece."""


def measured(plan: ScanPlan) -> RangeSamples:
    """A quick finger's samples along the plan, so that even a short one has many pieces."""
    return WORLD.scanned(plan.path, Sensor(rate=150.0))


def chunk(samples: RangeSamples, start: int, end: int | None = None) -> SampleChunk:
    """The samples from number `start` up to `end`."""
    return SampleChunk(start, samples.select(slice(start, end)))


def pieces(samples: RangeSamples, size: int = PIECE) -> list[RangeSamples]:
    return [samples.select(slice(k, k + size)) for k in range(0, len(samples), size)]


class StreamingRobot:
    """A robot that yields what it measures piece by piece.

    Attributes:
        yielded: pieces that were taken from it.
        stopped: how often its motion ended, in whatever way.
    """

    def __init__(self) -> None:
        self.yielded = self.stopped = 0

    def scan(self, plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        try:
            for piece in pieces(measured(plan)):
                self.yielded += 1
                yield piece
        finally:
            self.stopped += 1

    async def scan_async(self, plan: ScanPlan) -> AsyncGenerator[ScanPiece, None]:
        try:
            for piece in pieces(measured(plan)):
                self.yielded += 1
                yield piece
        finally:
            self.stopped += 1
