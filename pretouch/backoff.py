"""How long to wait before something that failed is tried again."""

from __future__ import annotations

import random


class Backoff:
    """Exponential backoff: each delay is twice the one before, up to a limit.

    Args:
        first, longest: s, the first delay and the limit.
        jitter: the share by which a delay may at random be shorter, so that clients that failed together do not all
            come back at the same moment.
    """

    def __init__(self, first: float, longest: float, jitter: float = 0.0) -> None:
        self._first = first
        self._longest = longest
        self._jitter = jitter
        self._following = first

    def next_delay(self) -> float:
        """s to wait before the next try."""
        delay = min(self._following, self._longest)
        self._following = 2 * delay
        return delay * random.uniform(1.0 - self._jitter, 1.0)

    def reset(self) -> None:
        """Starts with the first delay again, after a success."""
        self._following = self._first
