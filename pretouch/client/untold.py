"""What a robot has measured of one scan and not told yet."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Awaitable, Generator
from typing import Any

from pretouch.session import GatewaySpan, SampleChunk, ScanProgress, Skipped, Submission, Telling
from pretouch.tof import RangeSamples

ScanPiece = RangeSamples | GatewaySpan | Skipped
"""What a robot measured since the last piece, or that it cannot follow the path any further."""
Execution = Submission | Generator[ScanPiece, Any, Any]
AsyncExecution = Awaitable[Submission] | AsyncGenerator[ScanPiece, Any]
"""What a robot's function for a scan returns: what it measured, or its pieces while the tip moves."""
NOTHING = RangeSamples.concatenate([])
"""Closes a scan of which everything was told."""


class UntoldSamples:
    """Collects pieces, and says what to tell next. A telling that failed is simply repeated, with what came since."""

    def __init__(self) -> None:
        self._told = 0
        self._waiting: list[RangeSamples | GatewaySpan] = []

    def ask(self) -> SampleChunk:
        """A telling without samples, which asks for the progress."""
        return SampleChunk(0, NOTHING)

    def add(self, piece: RangeSamples | GatewaySpan) -> None:
        """Adds a piece after the others; raises `InvalidInput` if its samples go back in time."""
        last = self._waiting[-1] if self._waiting else None
        if isinstance(piece, RangeSamples) and isinstance(last, RangeSamples):
            self._waiting[-1] = RangeSamples.concatenate([last, piece])
        else:
            self._waiting.append(piece)

    def next(self) -> Telling | None:
        """What to tell next; None if everything was told."""
        if not self._waiting:
            return None
        first = self._waiting[0]
        return SampleChunk(self._told, first) if isinstance(first, RangeSamples) else first

    def note(self, progress: ScanProgress) -> bool:
        """Notes the answer to `next`; whether the samples are enough."""
        del self._waiting[0]
        self._told = progress.told
        return progress.enough
