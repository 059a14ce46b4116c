"""A cache of recent results by key, shared between threads and bounded in bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class LruCache(Generic[K, V]):
    """Keeps the results that were used last, and at least the last one.

    Args:
        limit: bytes of all results.
        weigh: the bytes of a result.
    """

    def __init__(self, limit: int, weigh: Callable[[V], int]) -> None:
        self._limit = limit
        self._weigh = weigh
        self._results: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, key: K) -> V | None:
        """The result for `key`; None if it is not cached."""
        with self._lock:
            if key not in self._results:
                return None
            self._results.move_to_end(key)
            return self._results[key][0]

    def put(self, key: K, result: V) -> None:
        """Keeps the result, in place of those that were used least recently."""
        weight = self._weigh(result)
        with self._lock:
            self._bytes += weight - self._results.pop(key, (result, 0))[1]
            self._results[key] = result, weight
            while self._bytes > self._limit and len(self._results) > 1:
                self._bytes -= self._results.popitem(last=False)[1][1]

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """The result for `key`, made if it is not cached; two threads may make the same one at the same time."""
        result = self.get(key)
        if result is None:
            result = make()
            self.put(key, result)
        return result
