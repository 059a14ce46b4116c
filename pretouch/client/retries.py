"""The retry policy of one call. Every call is idempotent and can be retried: reads change nothing, a scan is identified
by its id, and a session's creation by its idempotency key."""

from __future__ import annotations

import time
from typing import Final

from pretouch.backoff import Backoff
from pretouch.errors import DeadlineExceeded, Overloaded, PretouchError, Unavailable

TIMEOUT: Final = 60.0
"""s for one call with all of its attempts, unless the client asks for another."""
_FIRST_DELAY: Final = 0.2
_MAX_DELAY: Final = 2.0
_JITTER: Final = 0.25
_RETRIES: Final = 5


class Attempts:
    """The attempts of one call within `timeout` seconds: at most 6, with delays of 0.2 s to 2 s between them."""

    def __init__(self, timeout: float) -> None:
        self._end = time.monotonic() + timeout
        self._failed = 0
        self._backoff = Backoff(_FIRST_DELAY, _MAX_DELAY, _JITTER)
        self._last: PretouchError | None = None

    def remaining(self) -> float:
        """s left until the call's timeout, at least a millisecond."""
        return max(self._end - time.monotonic(), 1e-3)

    def delay_after(self, error: PretouchError) -> float:
        """s to wait before the next attempt.

        Raises:
            PretouchError: `error` itself, if a retry cannot help or comes too late; if a retry ran out of time, the
                error of the attempt before it.
        """
        if isinstance(error, DeadlineExceeded) and self._last is not None:
            raise self._last from error
        delay = self._backoff.next_delay()
        self._failed += 1
        transient = isinstance(error, Unavailable | Overloaded)
        if not transient or self._failed > _RETRIES or delay >= self.remaining():
            raise error
        self._last = error
        return delay
