"""What a stream's listener has received, in columns whose memory is bounded."""

from __future__ import annotations

import asyncio
from array import array
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Received:
    """Frames of one stream: a key of each, ns of the steady clock at which it was in hand, and how many were lost."""

    keys: NDArray[np.int64]
    stamps: NDArray[np.int64]
    lost: int


class Inbox:
    """Frames of one stream.

    Args:
        key: type code of an array of the frames' keys.
    """

    def __init__(self, key: str) -> None:
        self._keys = array(key)
        self._stamps = array("q")
        self._lost = 0
        self._wanted = 0
        self._enough = asyncio.Event()

    def add(self, keys: bytes, stamp: int, lost: int = 0) -> None:
        """Frames that came together, by their keys, packed."""
        self._keys.frombytes(keys)
        self._stamps.extend([stamp] * (len(self._keys) - len(self._stamps)))
        self._lost += lost
        if len(self._keys) >= self._wanted:
            self._enough.set()

    async def take(self, count: int, patience: float) -> Received:
        """All frames since the last time, as soon as they are `count`, and at the latest after `patience` s."""
        self._wanted = count
        self._enough.clear()
        if len(self._keys) < count:
            with suppress(TimeoutError):
                async with asyncio.timeout(patience):
                    await self._enough.wait()
        received = Received(np.array(self._keys, dtype=np.int64), np.array(self._stamps), self._lost)
        del self._keys[:], self._stamps[:]
        self._lost = 0
        return received
