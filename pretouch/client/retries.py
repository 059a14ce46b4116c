"""The retry policy of one call.

Every call is idempotent and can be repeated: reads change nothing, and a cancellation nothing the second time; a scan
is identified by its id, a chunk of told samples by where it starts, and a session's creation by its idempotency key.
"""

from __future__ import annotations

import random
import time
from typing import Final

from pretouch.backoff import Backoff
from pretouch.errors import DeadlineExceeded, Overloaded, PretouchError, Unavailable

TIMEOUT: Final = 60.0
"""s for one call with all of its attempts, unless the client asks for another."""
_FIRST_DELAY: Final = 0.2
_MAX_DELAY: Final = 2.0
_JITTER: Final = 0.25
_BLIND_RETRIES: Final = 5


class Attempts:
    """The attempts of one call within `timeout` s.

    After a passing fault the call is repeated: when the service asks for it, at the earliest after 0.2 s to 2 s, and up
    to a quarter later, so that robots that were refused together do not come back together. That goes on until the
    timeout if the service was reached before or says when to come back; if not, the address may be wrong, and six
    attempts are enough.
    """

    def __init__(self, timeout: float) -> None:
        self._end = time.monotonic() + timeout
        self._failed = 0
        self._backoff = Backoff(_FIRST_DELAY, _MAX_DELAY)
        self._last: PretouchError | None = None

    def remaining(self) -> float:
        """s left until the call's timeout, at least a millisecond."""
        return max(self._end - time.monotonic(), 1e-3)

    def delay_after(self, error: PretouchError, reached: bool = False) -> float:
        """s to wait before the next attempt.

        Args:
            reached: the service has answered this client before.

        Raises:
            PretouchError: `error` itself, if a retry cannot help or comes too late; if a retry ran out of time, the
                error of the attempt before it.
        """
        self._failed += 1
        delay = max(self._backoff.next_delay(), error.retry_after or 0.0) * random.uniform(1.0, 1.0 + _JITTER)
        patient = reached or error.retry_after is not None or self._failed <= _BLIND_RETRIES
        passing = isinstance(error, Unavailable | Overloaded | DeadlineExceeded)
        if passing and patient and delay < self.remaining():
            self._last = error
            return delay
        if isinstance(error, DeadlineExceeded) and self._last is not None:
            raise self._last from error
        raise error
