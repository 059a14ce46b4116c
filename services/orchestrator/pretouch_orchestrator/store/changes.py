"""Tells those who wait for a session that it has changed, whichever process changed it."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from weakref import WeakValueDictionary


class Changes:
    """Wakes waiting tasks. Waking says "look again": what has changed is in the store, so nothing is lost or repeated.

    Topics are session ids, and names of leases that are not a session's.
    """

    def __init__(self) -> None:
        self._expected: WeakValueDictionary[str, asyncio.Event] = WeakValueDictionary()

    def expect(self, topic: str) -> asyncio.Event:
        """An event that the topic's next change sets. Get it before looking, so that no change falls in between."""
        return self._expected.setdefault(topic, asyncio.Event())

    def announce(self, topic: str) -> None:
        """Wakes those who wait for the topic."""
        change = self._expected.pop(topic, None)
        if change is not None:
            change.set()

    def announce_all(self) -> None:
        """Wakes everyone: anything may have changed."""
        for topic in list(self._expected):
            self.announce(topic)


async def wait_for_change(change: asyncio.Event, seconds: float | None) -> bool:
    """Whether the change came within `seconds`."""
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await change.wait()
    return change.is_set()
