"""A bounded buffer that reaches far back and keeps recent items more densely than old ones."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

LEVELS = 4
PER_LEVEL = 12
"""Together 48 items that reach 12 (1 + 2 + 4 + 8) = 180 back."""

T = TypeVar("T")


class ThinningBuffer(Generic[T]):
    """Keeps the newest 12 items, before them 12 that are each the better of two, then 12 the best of four, 12 of eight.

    Keeping the best of several is NTP's clock filter (Mills, 2006), which keeps the best of the last eight only.

    Args:
        cost: of two items the one that costs less is the better.
    """

    def __init__(self, cost: Callable[[T], float]) -> None:
        self._cost = cost
        self._levels: list[deque[T]] = [deque() for _ in range(LEVELS)]

    def __len__(self) -> int:
        return sum(map(len, self._levels))

    def __iter__(self) -> Iterator[T]:
        """The oldest first."""
        for level in reversed(self._levels):
            yield from level

    def append(self, item: T) -> None:
        self._levels[0].append(item)
        for number, level in enumerate(self._levels):
            if len(level) <= PER_LEVEL:
                break
            better = min(level.popleft(), level.popleft(), key=self._cost)
            if number + 1 < LEVELS:
                self._levels[number + 1].append(better)

    def clear(self) -> None:
        for level in self._levels:
            level.clear()
